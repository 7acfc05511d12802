"""The window of `--live-window`, in a process of its own: signals of the last seconds by channel.

Run with `python -m`; reads pickled `(recording, block)` from stdin until it ends, and prints
`ready` or an error to stdout.
"""

from __future__ import annotations

import os
import pickle
import signal
import sys
import threading
from collections import deque
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np

from rigtool.experiments.running.terminal import CHANNEL_UNITS, READY_LINE
from rigtool.numerics.arrays import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D


TIME_SPAN = 20.0
"""Time span of the plots, s."""

REDRAW_INTERVAL = 0.4
"""Time between two drawings, s: each takes about 0.09 s of a core."""

LINE_POINTS = 1000
"""Points of a drawn line, about: more samples are drawn as lowest and highest of a few."""

GAP_TIME = 0.5
"""Time without samples over which no line is drawn, s."""

MAX_WAITING_BLOCKS = 256
"""Blocks that wait to be drawn at most."""

BAND_CHANNELS = {"low": "torque", "high": "torque"}
"""Channels that are drawn as the band of another channel."""

NICENESS = 10
"""Niceness of the process: the rig has priority."""


class Panel:
    """Draws into a figure: a plot a channel, all over the same time."""

    def __init__(self, figure: Figure) -> None:
        self._figure = figure
        self._recording = ""
        self._blocks: deque[Mapping[str, Array]] = deque()
        self._lines: dict[str, tuple[Axes, Line2D]] = {}

    def add(self, recording: str, block: Mapping[str, Array]) -> None:
        """Take a block; with another recording or other channels, begin a new drawing."""
        if len(block["time"]) == 0:
            return
        if recording != self._recording or block.keys() - {"time"} != self._lines.keys():
            self._recording = recording
            self._blocks.clear()
            self._set_up([name for name in block if name != "time"])
        self._blocks.append(block)
        while self._blocks[0]["time"][-1] < block["time"][-1] - TIME_SPAN:
            self._blocks.popleft()

    def draw(self) -> None:
        """Draw the blocks; `Figure.canvas` is to be drawn afterwards."""
        if not self._blocks:
            return
        time = np.concatenate([block["time"] for block in self._blocks])
        shown = time >= time[-1] - TIME_SPAN
        time = time[shown]
        breaks = np.flatnonzero(np.diff(time) > GAP_TIME) + 1
        self._figure.suptitle(f"{self._recording}, {time[-1]:.1f} s", x=0.02, ha="left")
        for name, (axes, line) in self._lines.items():
            values = np.concatenate([block[name] for block in self._blocks])[shown]
            line.set_data(
                *thinned(np.insert(time, breaks, np.nan), np.insert(values, breaks, np.nan))
            )
            if name not in BAND_CHANNELS:
                axes.set_title(f"{values[-1]:.5g}", loc="right", fontsize="medium", weight="bold")
            axes.relim()
            axes.autoscale_view(scalex=False)
            axes.set_xlim(time[0], max(time[-1], time[0] + TIME_SPAN))

    def _set_up(self, names: list[str]) -> None:
        self._figure.clear()
        alone = [name for name in names if name not in BAND_CHANNELS]
        plots = self._figure.subplots(len(alone), 1, sharex=True, squeeze=False)[:, 0]
        self._lines = {}
        for axes, name in zip(plots, alone, strict=True):
            unit = CHANNEL_UNITS.get(name, "")
            axes.set_title(f"{name.replace('_', ' ')} [{unit}]", loc="left", fontsize="medium")
            axes.ticklabel_format(useOffset=False)
            axes.grid(visible=True, alpha=0.4)
            (line,) = axes.plot([], [], linewidth=0.9)
            self._lines[name] = (axes, line)
        for name in BAND_CHANNELS.keys() & set(names):
            axes, _ = self._lines[BAND_CHANNELS[name]]
            (line,) = axes.plot([], [], linewidth=0.6, linestyle="--", color="0.5")
            self._lines[name] = (axes, line)
        plots[-1].set_xlabel("time [s]")
        # Measured: computing the layout again each time takes as long as the drawing.
        self._figure.subplots_adjust(left=0.1, right=0.97, top=0.92, bottom=0.07, hspace=0.5)


def thinned(time: Array, values: Array) -> tuple[Array, Array]:
    """Return about `LINE_POINTS` points (m,) that look like all of them (n,): lowest and highest of
    few.

    NaN among them stays, as a gap.
    """
    few = len(time) // (LINE_POINTS // 2)
    if few < 3:
        return time, values
    whole = len(time) // few * few
    groups = values[:whole].reshape(-1, few)
    with np.errstate(invalid="ignore"):
        ends = np.column_stack([groups.min(axis=1), groups.max(axis=1)])
    moments = np.repeat(time[:whole].reshape(-1, few)[:, 0], 2)
    return np.append(moments, time[whole:]), np.append(ends.ravel(), values[whole:])


class _Inbox:
    """Blocks from stdin, taken by a thread of their own, so that the pipe never fills up."""

    def __init__(self, source: BinaryIO) -> None:
        self._source = source
        self._blocks: deque[tuple[str, Mapping[str, Array]]] = deque(maxlen=MAX_WAITING_BLOCKS)
        self.ended = False
        threading.Thread(target=self._run, daemon=True).start()

    def _run(self) -> None:
        try:
            while True:
                self._blocks.append(pickle.load(self._source))
        except (EOFError, OSError, pickle.UnpicklingError):
            self.ended = True

    def empty_into(self, panel: Panel) -> bool:
        """Hand on the blocks that have come; return whether there were any."""
        come = bool(self._blocks)
        while self._blocks:
            panel.add(*self._blocks.popleft())
        return come


def main() -> int:
    """Open the window and draw until it is closed or stdin ends; return an exit code."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C ends the measurement, and that this
    try:
        figure = _open()
    except Exception as error:  # any error of a toolkit
        print(" ".join(str(error).split()) or type(error).__name__, flush=True)
        return 1
    if hasattr(os, "nice"):
        os.nice(NICENESS)
    panel, inbox = Panel(figure), _Inbox(sys.stdin.buffer)

    def turn() -> None:
        import matplotlib.pyplot as plt

        ended = inbox.ended  # before its blocks are taken: the last ones come before it
        if inbox.empty_into(panel):
            panel.draw()
            figure.canvas.draw_idle()
        elif ended:
            plt.close(figure)

    import matplotlib.pyplot as plt

    timer = figure.canvas.new_timer(interval=round(REDRAW_INTERVAL * 1e3))
    timer.add_callback(turn)
    timer.start()
    print(READY_LINE, flush=True)
    plt.show()
    return 0


def _open() -> Any:
    """Return a figure in a window; raises where there is no toolkit or no desktop."""
    import matplotlib.pyplot as plt
    from matplotlib.backend_bases import FigureManagerBase

    plt.rcParams["toolbar"] = "None"
    figure = plt.figure("rigtool", figsize=(9, 8))
    if type(figure.canvas.manager) is FigureManagerBase:  # one that shows nothing
        raise RuntimeError(
            "matplotlib finds no desktop (DISPLAY), or no toolkit such as tkinter"
            + (
                f", or MPLBACKEND selects {backend}"
                if (backend := os.environ.get("MPLBACKEND"))
                else ""
            )
        )
    return figure


if __name__ == "__main__":
    os._exit(main())  # at once: the thread that waits for stdin would make an orderly end abort
