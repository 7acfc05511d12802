"""A serial line: one request at a time, each with a deadline, retries that are counted.

All communication with hardware goes through a `Line`, so that every byte can be written to a spy
file, and a port `replay://FILE` plays such a file back. Errors are `HardwareError`s: `LineTimeout`
and `DamagedReply` concern one reply, and the request is repeated if it may be; `RequestRefused` is
a reply as well; `LineLost` is final.
"""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from rigtool.errors import HardwareError
from rigtool.rigs.serial.transport import can_frames
from rigtool.rigs.serial.transport.opening import READ_TIME, USUAL_CHARACTER, open_port
from rigtool.rigs.serial.transport.spy import Event, Replay, Spy

T = TypeVar("T")

QUIET_TIME = 0.02
"""Silence after which the rest of an older reply has passed, s."""

MAX_EMPTY_READS = 30
"""Times in a row that a port may announce bytes and deliver none."""

LONGEST_REPLY = 1 << 20
"""Bytes without an end of line that mark the reply as damaged."""

STRAY_TIMEOUT_RATIO = 5.0
"""Multiple of the timeout of a line after which what came, and is no answer, counts as silence."""


class LineTimeout(HardwareError):
    """No reply, or only a part of one, came in time."""


class DamagedReply(HardwareError):
    """The received bytes are no valid reply: checksum, length, sequence or form."""


class LineLost(HardwareError):
    """The port is gone, or no valid reply comes in spite of retries."""


class RequestRefused(HardwareError):
    """The device refuses a request; `code` is the one that it gives, if any."""

    def __init__(self, message: str, code: int | None = None) -> None:
        super().__init__(message)
        self.code = code


@dataclass
class LineCounts:
    """Counts of the events on a line, stored in the run file."""

    requests: int = 0
    retries: int = 0
    timeouts: int = 0
    damaged: int = 0
    stray_bytes: int = 0
    bytes_sent: int = 0
    bytes_received: int = 0


class Line:
    """An open serial port, closed as a context manager. `port` may be any URL of pyserial.

    Raises `HardwareError` where it cannot be opened, with the remedy. Timeouts are in s. A line
    `beside` another shares its clock and its spy file, in which `role` marks its events; beside a
    line that is played back it is played back as well, whatever its port. A line that is not
    `exclusive` is opened although another program has the port. `frame` is that of a character.
    """

    def __init__(
        self,
        port: str,
        baud_rate: int = 115200,
        *,
        timeout: float = 0.2,
        retries: int = 3,
        spy: str | Path | None = None,
        driver: str = "unknown",
        beside: Line | None = None,
        role: str = "",
        exclusive: bool = True,
        frame: str = USUAL_CHARACTER,
    ) -> None:
        self.port = port
        self.timeout = timeout
        self.retries = retries
        self.counts = LineCounts()
        self.opened: float = time.monotonic() if beside is None else beside.opened
        self._baud_rate, self._frame = baud_rate, frame
        self._role = role
        if beside is not None and isinstance(beside._port, Replay):
            self._port: Any = Replay(beside._port.path, role)
        else:
            self._port = open_port(port, baud_rate, frame, exclusive or None)
        self._buffer = bytearray()
        self._until = math.inf
        self._snatched = 0
        self._spy: Spy | None = None if beside is None else beside._spy
        self._owns_spy = spy is not None
        try:
            if spy is not None:
                self._spy = Spy(spy, driver)
            elif self._spy is not None:
                self._spy.name(role, driver, port)
        except HardwareError:
            self._port.close()
            raise

    def __enter__(self) -> Line:
        return self

    def __exit__(self, *details: object) -> None:
        self.close()

    def close(self) -> None:
        """Let go of the port; closing twice does no harm."""
        with contextlib.suppress(OSError):  # it may be gone already
            self._port.close()
        if self._spy is not None and self._owns_spy:
            self._spy.close()
        self._spy = None

    def reopen(self, patience: float) -> None:
        """Open the port again: it may be lost when a device is switched off.

        Tries for `patience` s; raises `HardwareError` where it does not come back.
        """
        if isinstance(self._port, Replay):
            return
        with contextlib.suppress(OSError):
            self._port.close()
        self._buffer.clear()
        deadline = time.monotonic() + patience
        while True:
            try:
                self._port = open_port(self.port, self._baud_rate, self._frame)
                return
            except HardwareError:
                if time.monotonic() > deadline:
                    raise
                time.sleep(0.1)

    @property
    def replays(self) -> bool:
        """Whether a record is played back: then time passes as fast as it is read."""
        return isinstance(self._port, Replay)

    @property
    def over(self) -> bool:
        """Whether a record that is played back has come to its end; never on a port."""
        return isinstance(self._port, Replay) and self._port.over

    # -- time

    def now(self) -> float:
        """Return the time since the line was opened, s, for set points and time stamps.

        Played back from a spy file it is the recorded time: use it for every time that enters a
        command or a recording, and for nothing else.
        """
        if isinstance(self._port, Replay):
            return self._port.clock()
        now = time.monotonic() - self.opened
        self._note(".", b"", now)
        return now

    def sleep_until(self, moment: float) -> None:
        """Wait until `now` would return this, s; a played-back line does not wait."""
        if not isinstance(self._port, Replay):
            time.sleep(max(0.0, moment - (time.monotonic() - self.opened)))

    def pause(self, seconds: float) -> None:
        """Wait this long, s; a played-back line does not wait."""
        if not isinstance(self._port, Replay):
            time.sleep(seconds)

    # -- bytes

    def write(self, data: bytes) -> None:
        """Send bytes. Raises `LineLost` where the port is gone or takes nothing any more."""
        try:
            self._port.write(data)
        except HardwareError:
            raise
        except (OSError, TypeError) as error:
            raise self._lost(error) from None
        self.counts.bytes_sent += len(data)
        self._note(">", data)

    def read_some(self, timeout: float | None = None) -> bytes:
        """Return the received bytes, at least one; empty after the timeout, s."""
        if self._buffer:
            data = bytes(self._buffer)
            self._buffer.clear()
            return data
        return self._receive(self._deadline(timeout))

    def read_exactly(self, size: int, timeout: float | None = None) -> bytes:
        """Return this many bytes; raises `LineTimeout` where they do not come."""
        self._fill(lambda: len(self._buffer) >= size, f"{size} bytes", timeout)
        return self._take(size)

    def read_until(self, end: bytes = b"\n", timeout: float | None = None) -> bytes:
        """Return bytes up to and with `end`; raises `LineTimeout` where it does not come."""
        self._fill(lambda: end in self._buffer, f"the end {end!r}", timeout)
        return self._take(self._buffer.index(end) + len(end))

    def read_frame(self, timeout: float | None = None) -> can_frames.CanFrame:
        """Return the next frame of a CAN bus; raises `LineTimeout` or `DamagedReply`."""
        text = self.read_until(can_frames.END, timeout)
        try:
            return can_frames.decode(text)
        except ValueError as error:
            raise DamagedReply(f"{self.port}: {error}") from None

    @contextlib.contextmanager
    def within(self, seconds: float) -> Iterator[None]:
        """Let readings fail once this time is over, s, whatever else still comes on the line.

        Each reading has a timeout of its own, which begins anew where it is repeated because
        something else came: another node of a bus, a monitor that prints.
        """
        before = self._until
        self._until = min(before, self._deadline(seconds))
        try:
            yield
        finally:
            self._until = before

    def give_back(self, data: bytes) -> None:
        """Put back bytes that belong to the next reading."""
        self._buffer[:0] = data

    def settle(self, quiet: float = QUIET_TIME) -> int:
        """Drop bytes until the line is silent; count them and return their number.

        A line that is never silent is left after its timeout: others talk on it.
        """
        dropped = len(self._buffer)
        self._buffer.clear()
        limit = time.monotonic() + max(self.timeout, quiet)
        while time.monotonic() < limit:
            data = self._receive(time.monotonic() + quiet)
            if not data:
                break
            dropped += len(data)
        self.counts.stray_bytes += dropped
        return dropped

    # -- requests

    def exchange(
        self,
        request: bytes,
        receive: Callable[[], T],
        *,
        retries: int | None = None,
        settle: bool = True,
    ) -> T:
        """Send a request and return the result of `receive` for the reply.

        `receive` reads from this line and raises `LineTimeout` or `DamagedReply` where there is no
        valid reply; then the line is left to settle and the request is repeated, `retries` times,
        which is counted. Where `request` is empty, `receive` sends it by itself. A request that
        must not be done twice has `retries=0`. Raises `LineLost` at last.
        """
        attempts = 1 + (self.retries if retries is None else retries)
        self.counts.requests += 1
        for attempt in range(attempts):
            if attempt:
                self.counts.retries += 1
                if settle:
                    self.settle()
            if request:
                self.write(request)
            try:
                with self.within(STRAY_TIMEOUT_RATIO * self.timeout):
                    return receive()
            except LineTimeout as error:
                self.counts.timeouts += 1
                problem: HardwareError = error
            except DamagedReply as error:
                self.counts.damaged += 1
                problem = error
        raise LineLost(
            f"{self.port}: no valid reply to {request[:40]!r} in {attempts} "
            f"attempt{'s' if attempts > 1 else ''}: {problem}; check power, cable, driver "
            "(`rigtool devices` asks what is there), baud rate, and that no other program reads "
            "from this port"
        )

    def ask(
        self,
        request: bytes,
        accept: Callable[[bytes], T | None],
        *,
        end: bytes = b"\n",
        timeout: float | None = None,
        retries: int | None = None,
    ) -> T:
        """Send a request and return the result of `accept` for the line that answers it.

        `accept` gets a line without its end and returns None where that is not the answer to this
        request, e.g. a late one to an older question: the next line is tried until the timeout. It
        raises `DamagedReply` where the request is to be repeated, `HardwareError` where it was
        refused. See `exchange`.
        """

        def receive() -> T:
            deadline = self._deadline(timeout)
            while True:
                line = self.read_until(end, max(0.0, deadline - time.monotonic()))
                answer = accept(line.removesuffix(end).rstrip(b"\r"))
                if answer is not None:
                    return answer
                self.counts.stray_bytes += len(line)

        return self.exchange(request, receive, retries=retries)

    # -- inside

    def _deadline(self, timeout: float | None) -> float:
        return time.monotonic() + (self.timeout if timeout is None else timeout)

    def _fill(self, enough: Callable[[], bool], what: str, timeout: float | None) -> None:
        deadline = self._deadline(timeout)
        if time.monotonic() > self._until:
            raise LineTimeout(f"{self.port}: only messages of others came, not {what}")
        while not enough():
            data = self._receive(deadline)
            if not data:
                got = bytes(self._buffer[:40])
                raise LineTimeout(f"{self.port}: {what} did not come in time, only {got!r}")
            self._buffer += data
            if len(self._buffer) > LONGEST_REPLY:
                raise DamagedReply(f"{self.port}: {len(self._buffer)} bytes came without {what}")

    def _take(self, size: int) -> bytes:
        data = bytes(self._buffer[:size])
        del self._buffer[:size]
        return data

    def _receive(self, deadline: float) -> bytes:
        """Return the bytes received by the port, at least one; empty after the deadline."""
        while True:
            try:
                data: bytes = self._port.read(max(1, self._port.in_waiting))
            except HardwareError:
                raise
            except (OSError, TypeError) as error:  # pyserial's port, closed meanwhile, is None
                # Another program took the bytes first, which passes, or the device is gone, which
                # does not: pyserial raises the same error.
                self._snatched += 1
                if "multiple access" not in str(error) or self._snatched > MAX_EMPTY_READS:
                    raise self._lost(error) from None
                time.sleep(READ_TIME / 10)
                data = b""
            if data:
                self._snatched = 0
                self.counts.bytes_received += len(data)
                self._note("<", data)
                return data
            if time.monotonic() >= deadline or isinstance(self._port, Replay):
                self._note("-", b"")
                return b""

    def _note(self, kind: str, data: bytes, now: float | None = None) -> None:
        if self._spy is not None:
            moment = time.monotonic() - self.opened if now is None else now
            self._spy.note(Event(moment, kind, data, self._role))

    def _lost(self, error: Exception) -> LineLost:
        self._note("!", str(error).encode("latin-1", "replace"))
        return LineLost(
            f"{self.port}: the line is lost ({error}): cable pulled, device switched off or reset, "
            "or another program reads from this port"
        )
