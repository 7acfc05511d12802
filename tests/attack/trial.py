"""One attack: a command in a process of its own, and what must not be seen of it.

The process is a fork of one that has everything imported: what is attacked is the command. A hang
is judged by the time of the processor, which a busy machine does not change; a process that waits
for ever is ended after `PATIENCE`.
"""

from __future__ import annotations

import os
import resource
import select
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from rigtool import cli
from rigtool.interrupts import SIGNALS

HANG = 20
"""Seconds of the processor after which a command hangs."""

PATIENCE = 180
"""Seconds of the clock after which a command that waits is ended."""

MEMORY = 2**30
"""Bytes that a command may take."""

CODES = {0, 1, 2, 3, 4, 5}
"""Exit codes of a command that nobody interrupts."""

Strike = Callable[[int], None]
"""What is done to a running process, by its number."""


@dataclass(frozen=True)
class Trial:
    """A command that ran: exit code (minus the signal), output, and `faults` that were seen."""

    code: int
    out: str
    err: str
    faults: tuple[str, ...]


def run(
    line: Sequence[object],
    strike: Strike | None = None,
    expected: frozenset[int] = frozenset(CODES),
    before: Callable[[], None] | None = None,
) -> Trial:
    """Run a command line, `before` first; `strike` is called with the process when it begins."""
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        ready, begun = os.pipe()
        child = os.fork()
        if child == 0:
            _command([str(word) for word in line], out.fileno(), err.fileno(), begun, before)
        os.close(begun)
        os.read(ready, 1)
        os.close(ready)
        if strike is not None:
            strike(child)
        code, waited, used = _wait(child)
        texts = []
        for stream in (out, err):
            stream.seek(0)
            texts.append(stream.read().decode(errors="replace"))
    faults = []
    if waited or code == -signal.SIGXCPU:
        faults.append("hang")
    elif code not in expected:
        faults.append("crash" if code < 0 else f"exit code {code}")
    if "Traceback (most recent" in texts[1] or "internal error" in texts[1]:
        faults.append("traceback")
    if used > MEMORY:
        faults.append("memory")
    return Trial(code, texts[0], texts[1], tuple(faults))


def at(seconds: float, number: int) -> Strike:
    """Return a strike that sends a signal after a time."""

    def strike(process: int) -> None:
        time.sleep(seconds)
        os.kill(process, number)

    return strike


def _command(
    line: list[str], out: int, err: int, begun: int, before: Callable[[], None] | None
) -> None:
    """Be the process of the command; never returns."""
    code = 99
    try:
        resource.setrlimit(resource.RLIMIT_CPU, (HANG, HANG + 5))
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        os.dup2(out, 1)
        os.dup2(err, 2)
        sys.stdout, sys.stderr = open(1, "w", closefd=False), open(2, "w", closefd=False)  # noqa: SIM115
        sys.argv = ["rigtool", *line]
        # What arrives before the command handles signals, or after its end, is not its own.
        for number in SIGNALS:
            signal.signal(number, _leave)
        os.write(begun, b".")
        if before is not None:
            before()
        cli.main(line)
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 0 if end.code is None else 1
    finally:
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError):  # it takes nothing
                stream.flush()
        os._exit(code)


def _leave(number: int, frame: object) -> None:
    os._exit(128 + number)


def _wait(child: int) -> tuple[int, bool, int]:
    """Return the exit code, whether it had to be ended, and its memory beyond that of a fork."""
    handle = os.pidfd_open(child)
    ended = bool(select.select([handle], [], [], PATIENCE)[0])
    os.close(handle)
    if not ended:
        os.kill(child, signal.SIGKILL)
    _, status, usage = os.wait4(child, 0)
    return os.waitstatus_to_exitcode(status), not ended, usage.ru_maxrss * 1024


def content(path: Path) -> str | None:
    """Return the hash of what a run file holds, None where there is no file."""
    from rigtool.runfile import open_run

    if not path.exists():
        return None
    with open_run(path) as found:
        return found.content_sha256
