r"""The bytes on a line with time stamps, and such a file as the other end of a line.

A spy file is text, a line an event, `seconds direction bytes`: `>` to the device, `<` from it,
bytes that are not printable as `\xNN`. `.` is a reading of the clock that went into set points or
time stamps: played back, host and device see the same times, so a run comes out as it was.
The first line says what was at the other end: `# rigtool spy 1 driver=... baud_rate=...`.
"""

from __future__ import annotations

from collections import deque
from pathlib import Path
from typing import NamedTuple

from rigtool.errors import HardwareError, RecipeError

HEAD = "# rigtool spy 1"


class Event(NamedTuple):
    """Something on the line at `time`, s: `kind` is `>`, `<` or `.`."""

    time: float
    kind: str
    data: bytes = b""


class Spy:
    """Writes a spy file. Every event reaches the file at once: a killed program leaves it whole.

    Raises `HardwareError` where it cannot be written.
    """

    def __init__(self, path: str | Path, driver: str) -> None:
        try:
            self._file = Path(path).open("w", encoding="ascii", buffering=1)  # noqa: SIM115
        except OSError as error:
            raise HardwareError(f"--spy {path}: cannot be written: {error.strerror}") from None
        self._file.write(f"{HEAD} driver={driver}\n")

    def note(self, event: Event) -> None:
        """Write an event."""
        text = event.data.decode("latin-1").encode("unicode_escape").decode("ascii")
        self._file.write(f"{event.time!r} {event.kind} {text}\n")

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def read_spy(path: str | Path) -> tuple[str, list[Event]]:
    """Return the driver that a spy file was written with, and its events.

    Raises `RecipeError` for another kind of file.
    """
    try:
        lines = Path(path).read_text(encoding="ascii").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise RecipeError(f"{path}: cannot be read as a file of --spy: {error}") from None
    if not lines or not lines[0].startswith(f"{HEAD} driver="):
        raise RecipeError(f"{path}: is not a file of --spy: its first line is not {HEAD!r}")
    events = []
    for number, line in enumerate(lines[1:], start=2):
        try:
            seconds, kind, text = line.split(" ", 2)
            data = text.encode("ascii").decode("unicode_escape").encode("latin-1")
            events.append(Event(float(seconds), kind, data))
        except ValueError:
            if number == len(lines):
                break  # the program was killed while it wrote its last line
            raise RecipeError(f"{path}:{number}: is not an event of --spy: {line[:60]!r}") from None
    return lines[0].partition("driver=")[2].split()[0], events


class Replay:
    """A spy file as the other end of a line, with the methods of a serial port that `Line` uses.

    The host has to say what was said then: where it does not, `HardwareError` tells the difference.
    """

    def __init__(self, path: str | Path) -> None:
        self.driver, events = read_spy(path)
        self._path = path
        self._events = deque(events)
        self._said = bytearray()
        self._now = 0.0

    def clock(self) -> float:
        """Return the reading of the clock as it was at this point, s."""
        if self._events:
            self._now = self._events[0].time
            if self._events[0].kind == ".":
                self._events.popleft()
        return self._now

    def write(self, data: bytes) -> int:
        """Compare with what was sent then; what was received then can be read afterwards."""
        self._said += data
        while self._said:
            while self._events and self._events[0].kind != ">":
                self._events.popleft()  # what arrived then, and was dropped unread
            if not self._events:
                raise HardwareError(
                    f"{self._path}: the record ends here, the host goes on with {data[:40]!r}"
                )
            event = self._events[0]
            said = bytes(self._said[: len(event.data)])
            if not event.data.startswith(said):
                raise HardwareError(
                    f"{self._path}: at {event.time:.6f} s the host sent {event.data[:40]!r}, now "
                    f"it sends {said[:40]!r}: play a record back with the recipe it was made with"
                )
            if len(said) < len(event.data):
                break
            del self._said[: len(said)]
            self._events.popleft()
        return len(data)

    def read(self, size: int = 1) -> bytes:
        """Return what was received at this point; nothing where nothing was."""
        if not self.in_waiting:
            return b""
        event = self._events.popleft()
        if len(event.data) > size:
            self._events.appendleft(event._replace(data=event.data[size:]))
        return event.data[:size]

    @property
    def in_waiting(self) -> int:
        """Bytes that can be read at this point."""
        return len(self._events[0].data) if self._events and self._events[0].kind == "<" else 0

    def close(self) -> None:
        """Nothing to close."""
