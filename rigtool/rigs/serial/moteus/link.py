"""Requests to a moteus drive over an fdcanusb, or over its own UART, which speaks the same.

The protocol has no sequence numbers. But a drive answers to the 7-bit source address of a request:
it counts up here, which identifies late answers. A UART checks lines by CRC-8 once it was sent one;
an fdcanusb has no checksum: USB protects the bytes.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping
from typing import TypeVar

from rigtool.errors import HardwareError
from rigtool.rigs.serial.line import DamagedReply, Line, LineLost, LineTimeout, RequestRefused
from rigtool.rigs.serial.moteus import frames

T = TypeVar("T")

REPLY_WANTED = 0x8000
SOURCE_COUNT = 127

STRAY_LINES = 20
"""Lines that answer older questions before a request counts as not answered."""

POLL_INTERVAL = 0.002
"""Wait before text that is not there yet is asked for again, s."""

TEXT_TIMEOUT = 0.5
"""Longest wait for the answer to a line of text, s."""


class Link:
    """Talks to the drive of address `node` on a line."""

    def __init__(self, line: Line, node: int) -> None:
        self.line, self.node = line, node
        self.sealed = False
        self._source = 0

    @property
    def wire(self) -> str:
        """What is at the other end of the line, for the operator."""
        return "UART with checksums" if self.sealed else "fdcanusb"

    # -- frames

    def find_seal(self, question: bytes) -> None:
        """Find out whether the device accepts checksums, and use them if so."""
        self.sealed = True
        for _ in range(3):
            self.line.write(self._request(question, reply=True)[0])
            with contextlib.suppress(LineTimeout), self.line.within(TEXT_TIMEOUT):
                while True:
                    line = self.line.read_until(b"\n").rstrip(b"\r\n")
                    with contextlib.suppress(frames.BadFrame):
                        frames.unsealed(line)
                        self.line.settle()
                        return
                    if line.startswith((b"OK", b"rcv ", b"ERR")) and b"checksum" not in line:
                        self.sealed = frames.has_seal(line)
                        if not self.sealed:
                            self.line.settle()
                            return
        self.sealed = False
        self.line.settle()

    def query(self, frame: bytes, expected: tuple[int, ...]) -> Mapping[int, float]:
        """Send subframes and return the registers of the reply; `expected` have to be there.

        Raises `RequestRefused` where the drive refuses a register.
        """

        def understand(reply: bytes) -> Mapping[int, float]:
            try:
                found = frames.registers_of(reply)
            except frames.RegisterError as error:
                raise RequestRefused(f"moteus {self.node} refuses: {error}") from None
            if missing := [register for register in expected if register not in found]:
                raise frames.BadFrame(f"register 0x{missing[0]:03x} is not in the reply")
            return found

        return self._exchange(frame, understand)

    def _request(self, frame: bytes, *, reply: bool) -> tuple[bytes, int]:
        identifier, source = self._address(reply=reply)
        line = frames.send_line(identifier, frame)
        return (frames.sealed(line) if self.sealed else line) + b"\n", source

    def _address(self, *, reply: bool) -> tuple[int, int]:
        """Return the identifier of the next request, and the source in it."""
        self._source = self._source % SOURCE_COUNT + 1
        identifier = (REPLY_WANTED if reply else 0) | self._source << 8 | self.node
        return identifier, self._source

    def _exchange(
        self,
        frame: bytes,
        understand: Callable[[bytes], T] | None = None,
        *,
        retries: int | None = None,
    ) -> T:
        """Send a frame; return the result of `understand` for the reply, without it wait for OK."""
        request, source = self._request(frame, reply=understand is not None)

        def receive() -> T:
            for _ in range(STRAY_LINES):
                got = self._received()
                if got is None and understand is None:
                    return None  # type: ignore[return-value]
                if got is None or understand is None:
                    continue
                identifier, reply = got
                if (identifier >> 8 & 0x7F, identifier & 0x7F) == (self.node, source):
                    return understand(reply)
            raise DamagedReply(f"{STRAY_LINES} lines, none of them the answer")

        def checked() -> T:
            try:
                return receive()
            except frames.BadFrame as error:
                raise DamagedReply(str(error)) from None

        return self.line.exchange(request, checked, retries=retries)

    def _received(self) -> tuple[int, bytes] | None:
        """Return identifier and data of the next frame, None where one was sent."""
        line = self._line()
        if line.startswith(b"rcv "):
            return frames.received(line)
        if b"BusOn" in line:
            raise RequestRefused(f"{self.line.port}: the fdcanusb is off its bus: send it 'can on'")
        if line.startswith(b"ERR"):
            raise DamagedReply(f"{self.line.port}: {line.decode('latin-1')}")
        if line and line != b"OK":
            raise DamagedReply(f"{line[:60]!r}: is no answer of an fdcanusb")
        return None

    def _line(self) -> bytes:
        line = self.line.read_until(b"\n").rstrip(b"\r\n")
        if self.sealed or frames.has_seal(line):
            line = frames.unsealed(line)
        return line

    # -- text

    def get(self, name: str) -> str:
        """Return a setting as the drive prints it; raises `RequestRefused` for an unknown one."""
        return self._talk(f"conf get {name}", lambda answer: answer != "OK")

    def number(self, name: str) -> float:
        """Return a setting as number; raises `HardwareError` for anything else."""
        text = self.get(name)
        try:
            return float(text)
        except ValueError:
            raise HardwareError(
                f"moteus {self.node} reports {text!r} for {name}, which is not a number"
            ) from None

    def set(self, name: str, value: str) -> None:
        """Change a setting in the drive's memory."""
        self._talk(f"conf set {name} {value}", lambda answer: answer == "OK")

    def command(self, text: str) -> None:
        """Send a line of text that is answered by OK, e.g. `conf write`."""
        self._talk(text, lambda answer: answer == "OK")

    def flush(self) -> None:
        """Drop text that the drive still sends; raises `HardwareError` where it does not end."""
        for _ in range(100):
            if not self._exchange(frames.ask_text(), frames.text_from_drive):
                return
        raise HardwareError(
            f"moteus {self.node} does not stop sending text: another program talks to it?"
        )

    def _talk(self, text: str, fits: Callable[[str], bool]) -> str:
        """Send a line of text and return the line that answers; both may be repeated."""
        data = text.encode("ascii") + b"\n"
        problem: HardwareError | None = None
        for attempt in range(1 + self.line.retries):
            if attempt:
                self.line.counts.retries += 1
                self.line.settle()
                self.flush()
            try:
                self._exchange(frames.text_to_drive(data), retries=0)
                answer = self._answer()
            except RequestRefused:
                raise
            except (LineTimeout, DamagedReply, LineLost) as error:
                problem = error
                continue
            if answer.startswith("ERR"):
                raise RequestRefused(f"moteus {self.node} refuses {text!r}: {answer}")
            if fits(answer):
                return answer
            problem = DamagedReply(f"{answer!r} does not answer {text!r}")
        raise LineLost(
            f"{self.line.port}: no valid answer to {text!r} in {1 + self.line.retries} attempts: "
            f"{problem}"
        )

    def _answer(self) -> str:
        """Return the next line of text that is not empty."""
        text = b""
        for _ in range(math.ceil(TEXT_TIMEOUT / POLL_INTERVAL)):
            piece = self._exchange(frames.ask_text(), frames.text_from_drive, retries=0)
            if not piece:
                self.line.pause(POLL_INTERVAL)
            text += piece
            while b"\n" in text:
                line, _, text = text.partition(b"\n")
                if line.strip():
                    return line.strip().decode("latin-1")
        raise LineTimeout(f"{self.line.port}: moteus {self.node} answers no text")
