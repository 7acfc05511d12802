r"""The bytes on a rig's lines with time stamps, and the replay of such a file as the devices.

A spy file is text, a line an event, `seconds kind bytes`: `>` to the device, `<` from it, bytes
that are not printable as `\xNN`; `-` where the host waited and nothing came; `!` where the line was
lost, and why. `.` is a reading of the clock that went into set points or time stamps: played back,
host and device see the same times, so a run comes out as it was. Of an instrument beside the drive
the channel precedes the kind: `0.713 force< 4.285 N\r\n`. All times are of one clock, that
begins when the drive's line is opened.

The first line names the driver: `# rigtool spy 2 driver=...`; another line with `#` that of an
instrument. Files of version 1 have neither instruments, `-` nor `!`.
"""

from __future__ import annotations

import contextlib
import re
import threading
from collections import deque
from pathlib import Path
from typing import NamedTuple

from rigtool.errors import HardwareError, RecipeError, refusal
from rigtool.inputs import open_input
from rigtool.plugins import warn

HEAD = "# rigtool spy"
VERSION = 2
KINDS = "><-!."


class Event(NamedTuple):
    """Something on a line at `time`, s: `kind` is one of KINDS, `role` empty for the drive."""

    time: float
    kind: str
    data: bytes = b""
    role: str = ""


class RecordEnd(HardwareError):
    """The host continues where the record ends."""


class Spy:
    """Writes a spy file. Every event reaches the file at once, so that a kill loses none.

    Several lines write into it, each from a thread of its own. Raises `HardwareError` where it
    cannot be begun. A disk that is full later ends the file with a warning, and nothing else: what
    stops the motor is sent over the same line.
    """

    def __init__(self, path: str | Path, driver: str) -> None:
        self._path, self._lock, self._complete = path, threading.Lock(), True
        try:
            self._file = Path(path).open("w", encoding="ascii", buffering=1)  # noqa: SIM115
            self._file.write(f"{HEAD} {VERSION} driver={driver}\n")
        except OSError as error:
            raise HardwareError(f"--spy {path}: cannot be written: {refusal(error)}") from None

    def name(self, role: str, driver: str, port: str) -> None:
        """Write the driver and the port of an instrument."""
        self._write(f"# {role} driver={driver} port={port!a}\n")

    def note(self, event: Event) -> None:
        """Write an event."""
        text = event.data.decode("latin-1").encode("unicode_escape").decode("ascii")
        self._write(f"{event.time!r} {event.role}{event.kind} {text}\n")

    def _write(self, line: str) -> None:
        with self._lock:
            if not self._complete:
                return
            try:
                self._file.write(line)
            except OSError as error:
                self._complete = False
                warn(f"--spy {self._path}: ends here, what follows is lost: {refusal(error)}")

    def close(self) -> None:
        """Close the file."""
        with contextlib.suppress(OSError):  # of what is not complete
            self._file.close()


def read_spy(path: str | Path) -> tuple[str, list[Event]]:
    """Return the driver that a spy file was written with, and the events on all of its lines.

    Raises `RecipeError` for another kind of file, or one of a newer rigtool.
    """
    try:
        with open_input(path, RecipeError) as stream:
            lines = stream.read().decode("ascii").splitlines()
    except UnicodeDecodeError as error:
        raise RecipeError(f"{path}: cannot be read as a file of --spy: {error}") from None
    found = re.fullmatch(rf"{HEAD} (\d+) driver=(\S+).*", lines[0] if lines else "", re.ASCII)
    if found is None:
        raise RecipeError(f"{path}: is not a file of --spy: its first line is not {HEAD!r}")
    if int(found[1]) > VERSION:
        raise RecipeError(
            f"{path}: is a file of --spy of version {found[1]}, this rigtool knows {VERSION} and "
            "older: take a newer rigtool"
        )
    events = []
    for number, line in enumerate(lines[1:], start=2):
        if line.startswith("# "):
            continue
        try:
            events.append(_event(line))
        except ValueError:
            if number == len(lines):
                break  # the program was killed while it wrote its last line
            raise RecipeError(f"{path}:{number}: is not an event of --spy: {line[:60]!r}") from None
    return found[2], events


def _event(line: str) -> Event:
    """Return the event in a line; raises `ValueError` for anything else."""
    seconds, what, text = line.split(" ", 2)
    role, kind = what[:-1], what[-1:]
    if kind not in KINDS or not kind or not (role.isalpha() or not role):
        raise ValueError
    data = text.encode("ascii").decode("unicode_escape").encode("latin-1")
    return Event(float(seconds), kind, data, role)


class Replay:
    """A spy file as the other end of a line, with the methods of a serial port that `Line` uses.

    `role` chooses one of its lines: a `HardwareError` where it has none of that name. The host has
    to send the recorded requests; a `HardwareError` shows the difference otherwise.
    """

    def __init__(self, path: str | Path, role: str = "") -> None:
        self.path = path
        self._events = deque(event for event in read_spy(path)[1] if event.role == role)
        if role and not self._events:
            raise HardwareError(
                f"{path}: holds nothing of the {role} gauge: it was recorded without one, or "
                "by a rigtool that did not write the lines of instruments yet: record it again, or "
                f"take [serial.{role}] out of the recipe"
            )
        self._said = bytearray()
        self._now = 0.0

    def clock(self) -> float:
        """Return the reading of the clock as it was at this point, s."""
        while self._events and self._events[0].kind == "-":
            self._events.popleft()
        if self._events:
            self._now = self._events[0].time
            if self._events[0].kind == ".":
                self._events.popleft()
        return self._now

    def write(self, data: bytes) -> int:
        """Compare with the recorded request; the recorded answer can be read afterwards.

        Raises `HardwareError` where it differs, `RecordEnd` behind the last, and `OSError` where
        the line was lost then.
        """
        self._said += data
        while self._said:
            while self._events and self._events[0].kind not in ">!":
                self._events.popleft()  # bytes that arrived then, and were dropped unread
            self._raise_if_lost()
            if not self._events:
                raise RecordEnd(
                    f"{self.path}: the record ends here, the host continues with {data[:40]!r}"
                )
            event = self._events[0]
            said = bytes(self._said[: len(event.data)])
            if not event.data.startswith(said):
                self._said.clear()
                raise HardwareError(
                    f"{self.path}: at {event.time:.6f} s the host sent {event.data[:40]!r}, now "
                    f"it sends {said[:40]!r}: play a record back with the recipe it was made with; "
                    "one of a run that was interrupted ends where that was"
                )
            if len(said) < len(event.data):
                break
            del self._said[: len(said)]
            self._events.popleft()
        return len(data)

    def read(self, size: int = 1) -> bytes:
        """Return the bytes received at this point of the record, if any."""
        self._raise_if_lost()
        if not self.in_waiting:
            if self._events and self._events[0].kind == "-":
                self._events.popleft()
            return b""
        event = self._events.popleft()
        if len(event.data) > size:
            self._events.appendleft(event._replace(data=event.data[size:]))
        return event.data[:size]

    @property
    def in_waiting(self) -> int:
        """Bytes that can be read at this point."""
        return len(self._events[0].data) if self._events and self._events[0].kind == "<" else 0

    @property
    def over(self) -> bool:
        """Whether the record is at its end."""
        return not self._events

    def close(self) -> None:
        """Nothing to close."""

    def _raise_if_lost(self) -> None:
        """Fail as the port did; it stays lost."""
        if self._events and self._events[0].kind == "!":
            self._said.clear()
            raise OSError(self._events[0].data.decode("latin-1"))
