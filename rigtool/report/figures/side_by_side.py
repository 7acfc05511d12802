"""Figures drawn on two cores: matplotlib takes a tenth of a second for each, most of it Python.

A forked copy of the process has all figures at once, without a start of its own. Where a fork is
not safe or not of use (other threads, one core, few figures, not Linux), one process draws all.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING

from rigtool.interrupts import SIGNALS, held
from rigtool.report.figures.style import render

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FEWEST = 4
"""Figures from which a second process takes less time than it costs."""

Drawn = tuple[str, bytes]


def render_all(figures: Sequence[Figure]) -> list[Drawn]:
    """Return each figure as SVG and PNG, byte for byte as `render` does."""
    if len(figures) < FEWEST or not _may_fork():
        return [render(figure) for figure in figures]
    with _second_process(figures[1::2]) as receiver:
        own = [render(figure) for figure in figures[::2]]
        try:
            others = receiver.recv()
        except (EOFError, OSError):  # the copy ended early, for want of memory for example
            others = [render(figure) for figure in figures[1::2]]
    drawn: list[Drawn] = [*own, *others]
    drawn[::2], drawn[1::2] = own, others
    return drawn


def _may_fork() -> bool:
    """Return whether there is a second core, and no thread that the copy would miss."""
    if sys.platform != "linux" or len(os.sched_getaffinity(0)) < 2:
        return False
    return len(list(Path("/proc/self/task").iterdir())) == 1


@contextmanager
def _second_process(figures: Sequence[Figure]) -> Iterator[Connection]:
    """Draw figures in a copy of this process, which is gone when the context is left."""
    import multiprocessing

    receiver, sender = multiprocessing.Pipe(duplex=False)
    copy = 0
    try:
        with held():  # no signal between the fork and its number
            copy = os.fork()
            if not copy:
                receiver.close()  # or a copy whose original was killed would wait for a reader
                _draw_and_exit(figures, sender)
        sender.close()
        yield receiver
    finally:
        if copy:
            os.kill(copy, signal.SIGKILL)
            os.waitpid(copy, 0)
        receiver.close()


def _draw_and_exit(figures: Sequence[Figure], sender: Connection) -> None:
    """Send what is drawn and end the copy; files that are open stay to the original."""
    code = 1
    try:
        for number in SIGNALS:
            signal.signal(number, signal.SIG_IGN)  # the original decides, and ends the copy
        sender.send([render(figure) for figure in figures])
        code = 0
    finally:
        os._exit(code)
