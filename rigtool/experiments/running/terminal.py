"""Signals drawn while they are recorded, at the terminal or in a window.

The terminal shows a line for each channel, the newest sample on the right; the window is a process
of its own (`window`). A measurement hands blocks to a `Feed` and never waits for a drawing.
"""

from __future__ import annotations

import contextlib
import math
import os
import pickle
import queue
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, Literal, TextIO

import numpy as np

from rigtool.errors import UsageError
from rigtool.signals import CHANNELS

DRAWING_INTERVAL = 0.2
"""Time between two drawings, s: each adds a column."""

BARS = "▁▂▃▄▅▆▇█"
PLAIN_BARS = "_.:-=+*#"
"""Bars for a terminal without Unicode."""

LABEL_WIDTH = 42
"""Characters of a line in front of its bars."""

MAX_BARS = 60
"""Bars of a line at most."""

STALE_TIME = 3.0
"""Time after which other text may stand below a drawing, s: a new drawing begins."""


MAX_WAITING_BLOCKS = 64
"""Blocks that wait to be drawn at most: those beyond are not drawn."""

CLOSING_TIME = 1.0
"""Longest time that drawings may still take when all is measured, s."""

OPENING_TIME = 60.0
"""Time in which the window must be there, s: matplotlib's first start lists all fonts."""

READY_LINE = "ready"

CHANNEL_UNITS = {name: unit for name, (unit, _, _) in CHANNELS.items()} | dict.fromkeys(
    ("torque", "u", "low", "high"), "N m"
)
"""Of what is drawn."""


@contextmanager
def open_live(where: Literal["terminal", "window"]) -> Iterator[Feed]:
    """Return the receiver of blocks for a drawing, for a `with` block.

    Raises `UsageError` where there is nothing to open a window on.
    """
    with contextlib.ExitStack() as stack:
        view = Live(sys.stderr) if where == "terminal" else stack.enter_context(Window())
        feed = Feed(view)
        stack.callback(feed.close)
        yield feed


class Feed:
    """Hands blocks to a view from a thread of its own; `OSError` of the view means that it is gone.

    It never waits and never fails: blocks beyond its capacity are dropped, and a closed view stays
    closed.
    """

    def __init__(self, view: Live | Window) -> None:
        self._view = view
        self._blocks: queue.Queue[tuple[str, Mapping[str, Any]]] = queue.Queue(MAX_WAITING_BLOCKS)
        self._closed = False
        self._thread = threading.Thread(target=self._run, name="live", daemon=True)
        self._thread.start()

    def show(self, recording: str, block: Mapping[str, Any]) -> None:
        """Take a block of a recording."""
        with contextlib.suppress(queue.Full):
            self._blocks.put_nowait((recording, block))

    def close(self) -> None:
        """Draw waiting blocks, as far as there is time."""
        self._closed = True
        self._thread.join(CLOSING_TIME)

    def _run(self) -> None:
        with contextlib.suppress(OSError, ValueError):  # the drawing process is closed
            while True:
                try:
                    recording, block = self._blocks.get(timeout=DRAWING_INTERVAL / 4)
                except queue.Empty:
                    if self._closed:
                        return
                    continue
                self._view.show(recording, block)


class Window:
    """A window of the desktop, drawn by a process of its own; a context manager.

    Raises `UsageError` where none can be opened.
    """

    def __init__(self) -> None:
        command = [sys.executable, "-m", "rigtool.experiments.running.window"]
        self._process = subprocess.Popen(
            command,
            bufsize=0,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
        )
        replies: list[bytes] = []
        assert self._process.stdout is not None
        read = self._process.stdout.readline
        listener = threading.Thread(target=lambda: replies.append(read()), daemon=True)
        listener.start()
        listener.join(OPENING_TIME)
        answer = replies[0].decode("utf-8", "replace").strip() if replies else "it does not start"
        if answer != READY_LINE:
            self.__exit__()
            raise UsageError(
                f"--live-window: no window can be opened: {answer or 'its process ended'}; run "
                "rigtool on a desktop, or use --live, which draws at the terminal"
            )

    def __enter__(self) -> Window:
        return self

    def __exit__(self, *details: object) -> None:
        """Let the window draw the received blocks, and close it."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.close()
        try:
            self._process.wait(CLOSING_TIME)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._process.stdout.close()

    def show(self, recording: str, block: Mapping[str, Any]) -> None:
        """Send a block; raises `OSError` where the window was closed."""
        assert self._process.stdin is not None
        data = memoryview(pickle.dumps((recording, dict(block)), pickle.HIGHEST_PROTOCOL))
        while data:
            data = data[self._process.stdin.write(data) or 0 :]


class Live:
    """Draws the channels of the recording that grows; `clock` is replaced in tests."""

    def __init__(
        self, out: TextIO, columns: int | None = None, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._out, self._clock = out, clock
        self._columns = columns or _room(out)
        self._bars = BARS if _can_write(out, BARS) else PLAIN_BARS
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
        if now - self._drawn >= DRAWING_INTERVAL:
            if now - self._drawn > STALE_TIME:
                self._lines = 0
            self._drawn = now
            with contextlib.suppress(OSError):  # a terminal that is gone ends no measurement
                self._draw()

    def _draw(self) -> None:
        for name, values in self._history.items():
            values.append(_drawn(np.concatenate([block[name] for block in self._blocks]), name))
        moment = float(self._blocks[-1]["time"][-1]) if len(self._blocks[-1]["time"]) else math.nan
        self._blocks.clear()
        lines = [f"{self._recording}  {moment:.1f} s"]
        for name, values in self._history.items():
            unit = CHANNEL_UNITS.get(name, "")
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
    return max(1, min(MAX_BARS, (width or 80) - LABEL_WIDTH))


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


def _drawn(values: Any, name: str) -> float:
    """Return the mean of the known values (n,), or the newest of those that number something."""
    if values.size and np.issubdtype(values.dtype, np.integer) and name not in CHANNEL_UNITS:
        return float(values[-1])
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else math.nan
