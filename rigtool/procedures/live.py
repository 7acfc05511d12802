"""Signals drawn at the terminal while they are recorded: a line a channel, newest on the right."""

from __future__ import annotations

import contextlib
import math
import os
import time
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, TextIO

import numpy as np

from rigtool.rigs import CHANNELS

INTERVAL = 0.2
"""Time between two drawings, s: each adds a column."""

BARS = "▁▂▃▄▅▆▇█"
PLAIN = "_.:-=+*#"
"""Bars for a terminal that has no others."""

LABEL = 42
"""Characters of a line in front of its bars."""

COLUMNS = 60
"""Bars of a line at most."""

FORGOTTEN = 3.0
"""Time after which something else may have been written below a drawing, s: begin a new one."""


class Live:
    """Draws the channels of the recording that grows; `clock` is replaced in tests."""

    def __init__(
        self, out: TextIO, columns: int | None = None, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._out, self._clock = out, clock
        self._columns = columns or _room(out)
        self._bars = BARS if _can_write(out, BARS) else PLAIN
        self._recording = ""
        self._history: dict[str, deque[float]] = {}
        self._blocks: list[Mapping[str, Any]] = []
        self._drawn = -math.inf
        self._lines = 0

    def show(self, recording: str, block: Mapping[str, Any]) -> None:
        """Take a block of a recording; draw if the last drawing is old enough."""
        if recording != self._recording:
            self._recording, self._lines = recording, 0
            self._history = {name: deque(maxlen=self._columns) for name in block if name != "time"}
            self._blocks.clear()
        self._blocks.append(block)
        now = self._clock()
        if now - self._drawn >= INTERVAL:
            if now - self._drawn > FORGOTTEN:
                self._lines = 0
            self._drawn = now
            with contextlib.suppress(OSError):  # a terminal that is gone ends no measurement
                self._draw()

    def _draw(self) -> None:
        for name, values in self._history.items():
            values.append(_mean(np.concatenate([block[name] for block in self._blocks])))
        moment = float(self._blocks[-1]["time"][-1]) if len(self._blocks[-1]["time"]) else math.nan
        self._blocks.clear()
        lines = [f"{self._recording}  {moment:.1f} s"]
        for name, values in self._history.items():
            unit = CHANNELS[name][0] if name in CHANNELS else ""
            lines.append(
                f"  {name:<20}{values[-1]:>12.5g} {unit:<6}{sparkline(values, self._bars)}"
            )
        up = f"\x1b[{self._lines}A" if self._lines else ""
        self._out.write(up + "".join(f"\r\x1b[K{line}\n" for line in lines))
        self._out.flush()
        self._lines = len(lines)


def _room(out: TextIO) -> int:
    """Return how many bars a line of the terminal holds: a line that wraps could not be redrawn."""
    try:
        width = os.get_terminal_size(out.fileno()).columns
    except OSError:
        width = 0
    return max(1, min(COLUMNS, (width or 80) - LABEL))


def _can_write(out: TextIO, text: str) -> bool:
    try:
        text.encode(getattr(out, "encoding", None) or "utf-8")
    except UnicodeEncodeError:
        return False
    return True


def sparkline(values: deque[float], bars: str = BARS) -> str:
    """Return values as bars between their lowest and highest; a gap where there is none."""
    known = [value for value in values if math.isfinite(value)]
    if not known:
        return " " * len(values)
    low, span = min(known), max(known) - min(known)
    top = len(bars) - 1
    return "".join(
        (bars[round((value - low) / span * top) if span > 0 else 0])
        if math.isfinite(value)
        else " "
        for value in values
    )


def _mean(values: Any) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else math.nan
