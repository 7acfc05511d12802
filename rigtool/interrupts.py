"""Ctrl-C, SIGTERM and their kin: never swallowed, and never in the middle of a write.

A handler that raises is not enough. Inside a weakref callback or a finaliser, Python prints the
exception and goes on (`sys.unraisablehook`); inside a write, the exception leaves half-written
data. So the handler also keeps the signal: `raise_swallowed`, called for each block of samples,
raises what was swallowed, and inside `held` the signal waits until the block of code is left.
"""

from __future__ import annotations

import math
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import NoReturn

NAMES = ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT")
SIGNALS = tuple(getattr(signal, name) for name in NAMES if hasattr(signal, name))

BURST_TIME = 0.5
"""Time after a signal was raised within which others are not, s: the way out is being tidied. They
are kept for `raise_swallowed`."""


class Terminated(BaseException):
    """SIGTERM, SIGHUP or SIGQUIT arrived: files are closed on the way out, as with Ctrl-C."""


class _State:
    """State of the process: whether signals come here, the signal that is not handled yet, open
    `held`s, and when a signal was raised, s."""

    active = False
    waiting: int | None = None
    depth = 0
    raised = -math.inf


def _receive(number: int, frame: FrameType | None) -> None:
    _State.waiting = number
    hooked = frame is not None and frame.f_code is _without_interrupts.__code__
    if _State.depth or hooked:  # what that hook raises is swallowed too, and printed
        return
    if (now := time.monotonic()) > _State.raised + BURST_TIME:
        _State.raised = now
        _raise(number)


def _raise(number: int) -> NoReturn:
    raise _exception(number)


def _exception(number: int) -> BaseException:
    return KeyboardInterrupt() if number == signal.SIGINT else Terminated()


@contextmanager
def handled() -> Iterator[None]:
    """Handle signals as this module does; outside the main thread nothing changes.

    A signal that is ignored stays ignored, as under `nohup` and in background jobs.
    """
    if threading.current_thread() is not threading.main_thread() or _State.active:
        yield
        return
    before = {number: signal.getsignal(number) for number in SIGNALS}
    hook = sys.unraisablehook
    _State.active, _State.waiting, _State.raised = True, None, -math.inf
    try:
        for number, handler in before.items():
            if handler is not signal.SIG_IGN:
                signal.signal(number, _receive)
        sys.unraisablehook = _without_interrupts
        yield
    except Exception as error:
        # A compiled function that notices a signal on its way out makes another error of it.
        if _State.waiting is None:
            raise
        raised = _exception(_State.waiting)
        behind: BaseException | None = error
        while behind is not None:
            for note in getattr(behind, "__notes__", ()):
                raised.add_note(note)
            behind = behind.__cause__
        raise raised from error
    finally:
        _State.depth += 1  # one more signal leaves no handler behind, whose exception nobody takes
        sys.unraisablehook = hook
        for number, handler in before.items():
            signal.signal(number, handler)
        _State.active = False
        _State.depth -= 1


def _without_interrupts(unraisable: sys.UnraisableHookArgs) -> None:
    """Print nothing of an interrupt that `raise_swallowed` is going to raise again."""
    if not issubclass(unraisable.exc_type, KeyboardInterrupt | Terminated):
        sys.__unraisablehook__(unraisable)


def may_fork() -> bool:
    """Return whether a copy of this process is whole: on Linux, without other threads."""
    return sys.platform == "linux" and len(os.listdir("/proc/self/task")) == 1


def begin_anew() -> None:
    """Let signals do in a forked copy what they do in a program that starts.

    A copy that was made while they were `held` takes the one that has arrived since.
    """
    for number in SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, signal.SIG_DFL)
    arrived, _State.waiting = _State.waiting, None
    _State.active, _State.depth = False, 0
    if arrived is not None:
        signal.raise_signal(arrived)


def raise_swallowed() -> None:
    """Raise the `KeyboardInterrupt` or `Terminated` whose exception was swallowed, if any."""
    if _State.waiting is not None and not _State.depth:
        number, _State.waiting = _State.waiting, None
        _raise(number)


class held:
    """Keep signals waiting until the block of code is left; then the last of them is raised.

    For a write, and for switching a motor off. Only the main thread receives signals: in other
    threads this does nothing.
    """

    def __enter__(self) -> None:
        self._counts = threading.current_thread() is threading.main_thread()
        if not self._counts:
            return
        self._own = None if _State.active else handled()
        if self._own is not None:
            self._own.__enter__()
        _State.depth += 1
        self._before, _State.waiting = _State.waiting, None

    def __exit__(self, *error: object) -> None:
        if not self._counts:
            return
        _State.depth -= 1
        arrived = _State.waiting
        if arrived is None:
            _State.waiting = self._before
        if self._own is not None:
            self._own.__exit__(None, None, None)
            if arrived is not None:
                signal.raise_signal(arrived)
        elif arrived is not None and not _State.depth:
            _raise(arrived)
