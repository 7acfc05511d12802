"""Figures made and drawn on two cores: matplotlib takes a tenth of a second for each, most of it
Python.

A forked copy of the process has all runs at once, without a start of its own. The process begins
with the first figure, its copy with the last; each marks what it takes, until they meet. Where a
fork is not safe or not of use (other threads, one core, few figures, not Linux), one draws all.
"""

from __future__ import annotations

import mmap
import os
import signal
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection

from rigtool.interrupts import SIGNALS, held, may_fork

MIN_FIGURES = 4
"""Figures from which a second process takes less time than it costs."""

Drawn = tuple[str, bytes]
Figures = Sequence[Callable[[], Drawn]]
"""A function for each figure, which makes and draws it."""


def draw_all(figures: Figures) -> list[Drawn]:
    """Return each figure as SVG and PNG, whichever process drew it."""
    if len(figures) < MIN_FIGURES or not _may_fork():
        return [draw() for draw in figures]
    taken = mmap.mmap(-1, len(figures))  # both processes see it
    with _second_process(figures, taken) as receiver:
        drawn = _draw_until_met(figures, range(len(figures)), taken)
        with suppress(EOFError, OSError):  # the copy ended early, for want of memory for example
            drawn |= receiver.recv()
        return [drawn[n] if n in drawn else figures[n]() for n in range(len(figures))]


def _draw_until_met(figures: Figures, order: Iterable[int], taken: mmap.mmap) -> dict[int, Drawn]:
    """Draw figures in this order, until one is taken by the other process; return them by number.

    Where both take the last one at the same time, it is drawn twice, equally.
    """
    drawn = {}
    for number in order:
        if taken[number]:
            break
        taken[number] = 1
        drawn[number] = figures[number]()
    return drawn


def _may_fork() -> bool:
    """Return whether there is a second core, and no thread that the copy would miss."""
    return may_fork() and len(os.sched_getaffinity(0)) > 1


@contextmanager
def _second_process(figures: Figures, taken: mmap.mmap) -> Iterator[Connection]:
    """Draw figures in a copy of this process, which is gone when the context is left."""
    import multiprocessing

    receiver, sender = multiprocessing.Pipe(duplex=False)
    copy = 0
    try:
        with held():  # no signal between the fork and its number
            copy = os.fork()
            if not copy:
                receiver.close()  # or a copy whose original was killed would wait for a reader
                _draw_and_exit(figures, taken, sender)
        sender.close()
        yield receiver
    finally:
        if copy:
            os.kill(copy, signal.SIGKILL)
            os.waitpid(copy, 0)
        receiver.close()


def _draw_and_exit(figures: Figures, taken: mmap.mmap, sender: Connection) -> None:
    """Send what is drawn and end the copy; files that are open stay to the original."""
    code = 1
    try:
        for number in SIGNALS:
            signal.signal(number, signal.SIG_IGN)  # the original decides, and ends the copy
        sender.send(_draw_until_met(figures, reversed(range(len(figures))), taken))
        code = 0
    finally:
        os._exit(code)
