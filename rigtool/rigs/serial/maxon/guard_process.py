"""The process beside rigtool that switches a drive off where rigtool is killed or hangs.

`guard.Guard` starts it, with the drive's port, and feeds its standard input.
"""

from __future__ import annotations

import contextlib
import os
import queue
import signal
import sys
import threading
import time
from collections.abc import Callable

from rigtool.interrupts import SIGNALS
from rigtool.rigs.serial.drivers import driver
from rigtool.rigs.serial.line import Line
from rigtool.rigs.serial.maxon.guard import ON, READY_BYTE

WINDOWS = os.name == "nt"

ATTEMPT_TIME = 30.0
"""Time for which the process tries to switch the drive off, s: the port may be gone for a while."""

ATTEMPT_PAUSE = 0.05
"""Time between attempts, s."""


def main(kind: str, port: str, baud_rate: str, node: str, silence: str) -> None:
    """Watch over standard input, and switch the drive off where that ends or falls silent."""
    for number in SIGNALS:  # it ends with the program that it watches
        signal.signal(number, signal.SIG_IGN)
    words: queue.Queue[bytes] = queue.Queue()
    threading.Thread(target=_listen, args=(words,), daemon=True).start()
    off = driver(kind).switch_off
    assert off is not None, "a drive with a watchdog needs no guard"
    os.write(1, READY_BYTE)
    os.close(1)
    on = False
    while True:
        try:
            word = words.get(timeout=float(silence) if on else None)
        except queue.Empty:
            _free_port()
            break
        if not word:
            break
        on = word[-1:] == ON
    if on:
        switch_off(off, port, int(baud_rate), int(node))


def _free_port() -> None:
    """End a rigtool that hangs on Windows, where it keeps its port from everybody else."""
    if WINDOWS:
        os.kill(os.getppid(), signal.SIGTERM)


def _listen(words: queue.Queue[bytes]) -> None:
    while True:
        word = os.read(0, 64)
        words.put(word)
        if not word:
            return


def switch_off(off: Callable[[Line, int], None], port: str, baud_rate: int, node: int) -> None:
    """Open a port that another program may have, switch off the drive, report on stderr."""
    deadline = time.monotonic() + ATTEMPT_TIME
    report = f"{port}: rigtool was killed, hangs or lost the line while the drive was on: "
    while True:
        try:
            with Line(port, baud_rate, timeout=0.1, exclusive=False) as line:
                off(line, node)
            report += "it is switched off now"
            break
        except Exception as error:  # whatever it is, the drive is still on
            if time.monotonic() > deadline:
                report += f"it could not be switched off ({error}): switch off its supply"
                break
        time.sleep(ATTEMPT_PAUSE)
    with contextlib.suppress(OSError):
        print(report, file=sys.stderr, flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
