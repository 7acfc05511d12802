"""The log of one motion on a target, put together from streamed and downloaded samples."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Protocol

import numpy as np

from rigtool.rigs.base import Block

SEGMENT_SAMPLES = 16384
"""Samples that are read at a time, and whose CRC-32 is compared with the target's, at most."""

STREAM_INTERVAL = 0.5
"""Streamed samples are handed on, and compared, about as often as this, s."""


class Memory(Protocol):
    """The log in the memory of a target."""

    def read_log(self, first: int, count: int, size: int) -> bytes:
        """Return samples of `size` bytes, verified by CRC-32."""

    def matches(self, first: int, count: int, data: bytes) -> bool:
        """Return whether the target's log holds these samples, by their CRC-32."""


class Log:
    """Samples in order, handed on as blocks; `period` is the time between two, s.

    Without a `memory` the target discards streamed samples: gaps become NaN, and are counted in
    `missing`. With one they are read, counted in `read_again`; `damaged` counts segments whose
    CRC-32 was wrong.
    """

    def __init__(self, sample: np.dtype[np.void], period: float, memory: Memory | None) -> None:
        self._sample, self._period, self._memory = sample, period, memory
        self._segment = min(SEGMENT_SAMPLES, max(64, round(STREAM_INTERVAL / period)))
        self._first = 0  # of the segment in hand
        self._data = bytearray()
        self._time = 0.0
        self._seen, self._seen_time = 0, 0.0  # samples that `fresh` gave
        self.missing = self.read_again = self.damaged = 0

    def fetch(self, count: int) -> Iterator[Block]:
        """Yield all of the target's log, `count` samples."""
        assert self._memory is not None
        for first in range(0, count, SEGMENT_SAMPLES):
            number = min(SEGMENT_SAMPLES, count - first)
            yield self._block(self._memory.read_log(first, number, self._sample.itemsize))

    def take(self, first: int, data: bytes) -> None:
        """Add streamed samples; fill the gap before them."""
        if first > self._here:
            self._fill(first)
        self._data += data[(self._here - first) * self._sample.itemsize :]

    def complete(self) -> Iterator[Block]:
        """Yield the segments that are complete."""
        while len(self._data) >= self._segment * self._sample.itemsize:
            yield self._next(self._segment)

    def fresh(self) -> Block:
        """Return the samples that came since the last call, as they came."""
        size = self._sample.itemsize
        data = bytes(self._data[(self._seen - self._first) * size :])
        time, self._time, self._seen = self._time, self._seen_time, self._here
        block = self._block(data)
        self._time, self._seen_time = time, self._time
        return block

    def rest(self, count: int) -> Iterator[Block]:
        """Yield the rest when a motion of `count` samples is over."""
        if count > self._here:
            self._fill(count)
        yield from self.complete()
        if self._data:
            yield self._next(len(self._data) // self._sample.itemsize)

    @property
    def _here(self) -> int:
        """Number of the sample that comes next."""
        return self._first + len(self._data) // self._sample.itemsize

    def _next(self, count: int) -> Block:
        size = count * self._sample.itemsize
        data = bytes(self._data[:size])
        if self._memory is not None and not self._memory.matches(self._first, count, data):
            self.damaged += 1
            data = self._memory.read_log(self._first, count, self._sample.itemsize)
        del self._data[:size]
        self._first += count
        return self._block(data)

    def _fill(self, end: int) -> None:
        """Read the missing samples up to sample `end`, or put NaN."""
        begin = self._here
        if self._memory is not None:
            self._data += self._memory.read_log(begin, end - begin, self._sample.itemsize)
            self.read_again += end - begin
            return
        gap = np.zeros(end - begin, self._sample)
        for name in self._sample.names or ():
            gap[name] = np.nan
        self._data += gap.tobytes()
        self.missing += end - begin

    def _block(self, data: bytes) -> Block:
        rows = np.frombuffer(data, self._sample)
        block = {name: rows[name].astype(np.float64) for name in self._sample.names or ()}
        # A gap has no signals, but its place in time is known.
        time = block["time"]
        for row in np.flatnonzero(np.isnan(time)):
            time[row] = (time[row - 1] if row else self._time) + self._period
        if len(time):
            self._time = float(time[-1])
        return block
