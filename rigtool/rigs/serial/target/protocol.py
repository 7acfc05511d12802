"""Requests and replies of the host-target link; each request takes effect once, however often it is
sent."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator

from rigtool.rigs.serial.line import DamagedReply, Line, LineTimeout, RequestRefused
from rigtool.rigs.serial.target import link
from rigtool.rigs.serial.target.frames import END, Frame, Splitter, encode
from rigtool.rigs.serial.target.link import FrameKind, Refusal

REPLY_TIMEOUT = 0.5
"""Longest wait for a reply, s."""

RETRIES = 8
"""Repeats of a request; more in proportion where `TargetProtocol.timeout` is shortened later."""


class TargetProtocol:
    """Requests and replies on a line; streamed samples that come between go to `samples`."""

    def __init__(self, line: Line, *, timeout: float | None = None, retries: int = RETRIES) -> None:
        self._line = line
        self.timeout = REPLY_TIMEOUT if timeout is None else timeout
        self._patience = retries * self.timeout
        self.streaming = False  # then a damaged frame need not be the reply
        self._splitter = Splitter()
        self._waiting: list[Frame] = []
        self._sequence = 0
        self.samples: Callable[[int, bytes], None] = lambda first, data: None

    def hello(self) -> link.Hello:
        """Begin a session."""
        self._line.write(END)  # ends an incomplete frame that may be on the line
        return link.Hello.unpack(self.call(FrameKind.HELLO, bytes([link.VERSION])))

    def call(self, kind: FrameKind, payload: bytes = b"") -> bytes:
        """Send a request and return the payload of its reply.

        A request goes out again with the same sequence number until it is answered: the target does
        it once. Raises `RequestRefused` with the target's reason where it refuses; what a
        `LineTimeout` or a `DamagedReply` spoils is repeated.
        """
        self._sequence = self._sequence % 0xFFFF + 1
        sequence = self._sequence

        def receive() -> bytes:
            deadline = time.monotonic() + self.timeout
            while True:
                damaged = self.damaged
                heard = self._hear(max(0.0, deadline - time.monotonic()))
                for frame in self._frames():
                    if frame.kind == link.SAMPLES:
                        self._take_samples(frame)
                    elif frame.sequence != sequence:
                        self._line.counts.stray_bytes += len(frame.payload)
                    elif frame.kind == link.REFUSED:
                        raise self._refused(frame.payload)
                    elif frame.kind == kind | link.REPLY:
                        return frame.payload
                if self.damaged > damaged and not self.streaming:
                    raise DamagedReply(f"a frame came damaged while {kind.name} waited")
                if not heard or time.monotonic() >= deadline:
                    raise LineTimeout(f"no reply to {kind.name} within {self.timeout:g} s")

        return self._line.exchange(
            encode(Frame(kind, sequence, payload)),
            receive,
            retries=math.ceil(self._patience / self.timeout),
            settle=False,
        )

    def listen(self, timeout: float) -> None:
        """Take the samples that come within this time, s."""
        self._hear(timeout)
        for frame in self._frames():
            if frame.kind == link.SAMPLES:
                self._take_samples(frame)

    def _hear(self, timeout: float) -> bool:
        """Read, unless frames wait already; return whether anything came within the time, s."""
        if self._waiting:
            return True
        data = self._line.read_some(timeout)
        self._waiting = self._splitter.feed(data)
        return bool(data)

    def _frames(self) -> Iterator[Frame]:
        """Yield frames that have come; those that are not taken wait for the next call."""
        while self._waiting:
            yield self._waiting.pop(0)

    def _refused(self, payload: bytes) -> RequestRefused:
        text = payload[1:].decode("utf-8", "replace")
        code = payload[0] if payload else 0
        if code == Refusal.NO_SESSION:
            text += "; its measured samples are lost: find out why it restarted"
        return RequestRefused(f"{self._line.port}: the target refuses: {text}", code)

    @property
    def damaged(self) -> int:
        """Frames that came damaged so far."""
        return self._splitter.damaged

    def _take_samples(self, frame: Frame) -> None:
        if len(frame.payload) >= link.FIRST.size:
            (first,) = link.FIRST.unpack_from(frame.payload)
            self.samples(first, frame.payload[link.FIRST.size :])
