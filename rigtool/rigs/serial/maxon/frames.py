"""How maxon drives frame commands: EPOS4 between DLE and CRC, EPOS2 and DES 70/10 in lock-step.

A command is an op code and words of 16 bit, low byte first; so is its answer. The CRC is CCITT,
0x1021, started at 0, over the words, high byte first.

EPOS4 (RS232, USB) [maxon, EPOS4 Communication Guide]:

    90 02 | op code | length in words | data | CRC        0x90 after the start is doubled

An answer begins with an error code; a damaged command is answered with that of a wrong CRC or of an
unknown op code, and not carried out [rel8759, 2.2.2, 6].

EPOS2 and DES (RS232) [implementations of others, two agree]: the host sends the op code, the device
answers `O` (ready) or `F`; the host sends length - 1, data and CRC, the device answers `O` or `F`.
An answer is a command of the device, with the op code 0, and acknowledged by the host.
"""

from __future__ import annotations

import binascii
from abc import ABC, abstractmethod

from rigtool.rigs.serial.line import DamagedReply, Line, LineTimeout

START = b"\x90\x02"
DLE = 0x90
OKAY, FAILED = b"O", b"F"
ANSWER = 0x00

DAMAGED_CODES = {0x05040001: "an unknown op code", 0x05040004: "a wrong CRC"}
"""Error codes of a command that an EPOS4 did not receive as it was sent."""

FRAME_TIMEOUT = 0.5
"""Time after which a device in lock-step gives up a frame that does not go on, s."""

TIMEOUT_RATIO = 1.2
"""How much longer the host waits than the device."""


def crc(header: bytes, data: bytes) -> bytes:
    """Return the CRC of a header of two bytes, in the order given, and of words; low byte first."""
    swapped = bytearray(data)
    swapped[0::2], swapped[1::2] = data[1::2], data[0::2]
    return binascii.crc_hqx(bytes(header + swapped), 0).to_bytes(2, "little")


def dle_frame(opcode: int, data: bytes) -> bytes:
    """Return the bytes of a command or an answer of an EPOS4."""
    length = len(data) // 2
    body = bytes([opcode, length]) + data + crc(bytes([length, opcode]), data)
    return START + body.replace(bytes([DLE]), bytes([DLE, DLE]))


def lock_step_frame(opcode: int, data: bytes) -> bytes:
    """Return the bytes after the op code: length - 1, data, CRC."""
    length = bytes([len(data) // 2 - 1])
    return length + data + crc(bytes([opcode]) + length, data)


class Frames(ABC):
    """Sends commands and returns the data of their answers."""

    def __init__(self, line: Line) -> None:
        self.line = line

    def command(
        self, opcode: int, data: bytes, reply: int | None, retries: int | None = None
    ) -> bytes:
        """Send a command; return the `reply` bytes of its answer, where it has one.

        Repeats it where an answer is missing or damaged. Raises `LineLost` where none comes.
        """
        before = self.line.counts.retries
        answer = self.line.exchange(
            self._request(opcode, data), lambda: self._answer(opcode, data, reply), retries=retries
        )
        if self.line.counts.retries > before:
            self.line.settle()  # an answer to the first attempt may still come
        return answer

    @abstractmethod
    def _request(self, opcode: int, data: bytes) -> bytes:
        """Return the bytes that begin a command."""

    @abstractmethod
    def _answer(self, opcode: int, data: bytes, reply: int | None) -> bytes:
        """Read the answer of a command that was begun."""


class DleFrames(Frames):
    """The framing of an EPOS4."""

    def _request(self, opcode: int, data: bytes) -> bytes:
        return dle_frame(opcode, data)

    def _answer(self, opcode: int, data: bytes, reply: int | None) -> bytes:
        return self._receive(reply or 0)

    def _receive(self, size: int) -> bytes:
        self.line.read_until(START)
        opcode, length = self._take(2)
        data = self._take(2 * length)
        if self._take(2) != crc(bytes([length, opcode]), data):
            raise DamagedReply(f"{self.line.port}: wrong CRC of an answer of {length} words")
        if found := DAMAGED_CODES.get(int.from_bytes(data[:4], "little")):
            raise DamagedReply(f"{self.line.port}: the drive received {found}")
        if opcode != ANSWER or len(data) != size:
            raise DamagedReply(
                f"{self.line.port}: {len(data)} bytes with op code {opcode:#x} came as an answer, "
                f"not {size}: it belongs to another question"
            )
        return data

    def _take(self, size: int) -> bytes:
        """Return so many bytes, with doubled 0x90 made single."""
        data, doubled = bytearray(), False
        while len(data) < size:
            for byte in self.line.read_exactly(size - len(data)):
                if byte == DLE and not doubled:
                    doubled = True
                    continue
                if doubled and byte != DLE:
                    raise DamagedReply(f"{self.line.port}: a single 0x90 within an answer")
                doubled = False
                data.append(byte)
        return bytes(data)


class LockStepFrames(Frames):
    """The framing of an EPOS2 and a DES 70/10; `frame_timeout` [s] is the device's.

    Not every command has an answer.
    """

    def __init__(self, line: Line, frame_timeout: float) -> None:
        super().__init__(line)
        self.frame_timeout = frame_timeout

    def _request(self, opcode: int, data: bytes) -> bytes:
        return bytes([opcode])

    def _answer(self, opcode: int, data: bytes, reply: int | None) -> bytes:
        self._acknowledged("the op code")
        return self.complete(opcode, data, reply)

    def complete(self, opcode: int, data: bytes, reply: int | None) -> bytes:
        """Send the bytes after an acknowledged op code, and return the answer."""
        self.line.write(lock_step_frame(opcode, data))
        self._acknowledged("the data")
        return b"" if reply is None else self._receive(reply)

    def _acknowledged(self, what: str) -> None:
        """Wait for `O`. Where neither that nor `F` comes, wait until the device is idle again."""
        try:
            byte = self.line.read_exactly(1)
        except LineTimeout:
            self._let_pass()
            raise
        if byte == OKAY:
            return
        if byte != FAILED:
            self._let_pass()
        raise DamagedReply(f"{self.line.port}: the device answers {byte!r} to {what}")

    def _let_pass(self) -> None:
        """Wait until the device has given up a frame, to which all it gets would belong."""
        self.line.pause(TIMEOUT_RATIO * self.frame_timeout)

    def _receive(self, size: int) -> bytes:
        try:
            data = self._receive_frame(size)
        except (LineTimeout, DamagedReply):
            self.line.write(FAILED)  # it waits for a word: so it is idle again
            raise
        self.line.write(OKAY)
        return data

    def _receive_frame(self, size: int) -> bytes:
        opcode = self.line.read_exactly(1)
        if opcode[0] != ANSWER:
            raise DamagedReply(f"{self.line.port}: the device answers with the op code {opcode!r}")
        self.line.write(OKAY)
        length = self.line.read_exactly(1)
        if 2 * (length[0] + 1) != size:
            raise DamagedReply(f"{self.line.port}: {length[0] + 1} words came, not {size // 2}")
        frame = self.line.read_exactly(size + 2)
        if frame[size:] != crc(opcode + length, frame[:size]):
            raise DamagedReply(f"{self.line.port}: wrong CRC of an answer of {size // 2} words")
        return frame[:size]
