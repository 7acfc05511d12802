"""The log in an emulated target's memory, and the frames that stream it."""

from __future__ import annotations

import numpy as np

from rigtool.rigs.base import Block
from rigtool.rigs.serial.target import link
from rigtool.rigs.serial.target.frames import Frame, encode

FRAME_SAMPLES = 64
"""Samples in a streamed frame at most: a small target has memory for so many."""

AT_ONCE = 4
"""Largest number of frames streamed before the line is read again: answers come between."""


class TargetLog:
    """Samples of one motion with the channels of `mask`, packed as they go over the line.

    Streamed ones are forgotten unless it `keeps` them.
    """

    def __init__(self, mask: int = 0, *, keeps: bool = True, streams: bool = False) -> None:
        self.sample = link.sample_type(mask)
        self._keeps, self._streams = keeps, streams
        self._data = bytearray()
        self.first = self._sent = 0

    @property
    def recorded(self) -> int:
        """Samples so far, discarded ones included."""
        return self.first + len(self._data) // max(1, self.sample.itemsize)

    def behind(self, visible: int) -> bool:
        """Return whether there is more to stream, up to sample `visible`."""
        return self._streams and self._sent < visible

    def add(self, block: Block) -> None:
        """Record a block."""
        rows = np.zeros(len(block["time"]), self.sample)
        for name in self.sample.names or ():
            rows[name] = block.get(name, np.nan)
        self._data += rows.tobytes()

    def read(self, first: int, count: int) -> bytes:
        """Return stored samples."""
        begin = (first - self.first) * self.sample.itemsize
        return bytes(self._data[begin : begin + count * self.sample.itemsize])

    def frames(self, visible: int) -> bytes:
        """Return the next frames of recorded samples, up to sample `visible`."""
        if not self._streams:
            return b""
        out: list[bytes] = []
        while self._sent < visible and len(out) < AT_ONCE:
            count = min(FRAME_SAMPLES, visible - self._sent)
            payload = link.FIRST.pack(self._sent) + self.read(self._sent, count)
            out.append(encode(Frame(link.SAMPLES, self._sent // FRAME_SAMPLES & 0xFFFF, payload)))
            self._sent += count
        if not self._keeps and self._sent > self.first:
            del self._data[: (self._sent - self.first) * self.sample.itemsize]
            self.first = self._sent
        return b"".join(out)
