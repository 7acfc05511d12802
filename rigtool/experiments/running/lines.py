"""Rows of values as lines of JSON on stdout, while a command measures.

A thread of its own writes them: a reader that is slow, blocked or gone does not disturb the
measurement.
"""

from __future__ import annotations

import contextlib
import io
import json
import math
import queue
import sys
import threading
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

MAX_WAITING_BLOCKS = 256
"""Blocks of lines that wait for the reader at most."""

CLOSING_TIME = 1.0
"""Longest time that a reader still has when all is measured, s, where it is not waited for."""

LOOK_INTERVAL = 0.1
"""Time between two looks at whether the reader is still there, s."""


@contextlib.contextmanager
def open_lines(*, waits: bool) -> Iterator[JsonLines]:
    """Return a writer of rows to stdout, for a `with` block; see `JsonLines`.

    It states on stderr how many lines had no reader.
    """
    sys.stdout.flush()
    with open(sys.stdout.fileno(), "wb", buffering=0, closefd=False) as out:
        lines, complete = JsonLines(out, waits=waits), False
        try:
            yield lines
            complete = True
        finally:
            lines.close(at_once=not complete)
    if lines.missed:
        print(f"--stream: {lines.missed} lines were not read", file=sys.stderr)


class JsonLines:
    """Writes rows to `out`, unbuffered; `waits` for a slow reader, or else leaves lines out.

    `missed` counts the lines that no reader got.
    """

    def __init__(self, out: io.RawIOBase, *, waits: bool) -> None:
        self._out, self._waits = out, waits
        self._blocks: queue.Queue[tuple[bytes, int]] = queue.Queue(MAX_WAITING_BLOCKS)
        self._gone, self._closed = threading.Event(), threading.Event()
        self.missed = 0
        self._thread = threading.Thread(target=self._run, name="lines", daemon=True)
        self._thread.start()

    def show(self, recording: str, rows: Mapping[str, Any]) -> None:
        """Take rows: arrays (r,) by name."""
        names = list(rows)
        lines = [
            json.dumps(dict(zip(names, map(_plain, values), strict=True))) + "\n"
            for values in zip(*(np.asarray(rows[name]).tolist() for name in names), strict=True)
        ]
        if lines:
            self._put("".join(lines).encode("ascii"), len(lines))

    def _put(self, text: bytes, count: int) -> None:
        while not self._gone.is_set():
            with contextlib.suppress(queue.Full):
                self._blocks.put((text, count), timeout=LOOK_INTERVAL if self._waits else 0)
                return
            if not self._waits:
                break
        self.missed += count

    def close(self, *, at_once: bool = False) -> None:
        """Write waiting rows, as far as there is time; with `at_once`, none of them."""
        if at_once:
            self._gone.set()
        self._closed.set()
        self._thread.join(0 if at_once else None if self._waits else CLOSING_TIME)
        self._gone.set()
        with contextlib.suppress(queue.Empty):
            while True:
                self.missed += self._blocks.get_nowait()[1]

    def _run(self) -> None:
        while True:
            try:
                text, count = self._blocks.get(timeout=LOOK_INTERVAL)
            except queue.Empty:
                if self._closed.is_set():
                    return
                continue
            try:
                data = memoryview(b"" if self._gone.is_set() else text)
                while data:
                    data = data[self._out.write(data) or 0 :]
            except (OSError, ValueError):  # the reader has closed it
                self._gone.set()
            if self._gone.is_set():
                self.missed += count


def _plain(value: float) -> float | int | None:
    """Return a number that JSON has; null for none."""
    if not math.isfinite(value):
        return None
    return value
