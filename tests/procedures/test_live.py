"""Signals drawn at the terminal."""

import io
import math
from collections import deque

import numpy as np

from rigtool.procedures.live import BARS, INTERVAL, Live, sparkline


def test_sparkline_runs_from_lowest_to_highest():
    assert sparkline(deque(range(8))) == BARS
    assert sparkline(deque([-1.0, math.nan, 1.0])) == BARS[0] + " " + BARS[-1]
    assert sparkline(deque([2.0, 2.0])) == BARS[0] * 2
    assert sparkline(deque([math.nan])) == " "


def test_it_draws_means_over_the_interval_and_draws_again_above():
    now = iter([0.0, 0.0, INTERVAL / 2, INTERVAL, INTERVAL])
    out = io.StringIO()
    live = Live(out, columns=4, clock=lambda: next(now))
    for first in range(3):
        live.show("sweep", {"time": np.array([0.5, 1.0]) + first, "current": np.full(2, first)})
    drawn = out.getvalue().split("\n")
    assert drawn[0].endswith("sweep  1.0 s")
    assert "current" in drawn[1]
    assert drawn[1].rstrip(BARS).split()[-2:] == ["0", "A"]
    assert drawn[2].startswith("\x1b[2A")
    assert drawn[2].endswith("sweep  3.0 s")
    assert drawn[3].endswith("1.5 A     " + BARS[0] + BARS[-1])  # of the last two blocks


def test_another_recording_begins_below():
    now = iter([0.0, 0.0, 1.0, 1.0])
    out = io.StringIO()
    live = Live(out, clock=lambda: next(now))
    block = {"time": np.array([1.0]), "encoder": np.array([math.nan])}
    live.show("a", block)
    live.show("b", block)
    assert "\x1b[2A" not in out.getvalue()
    assert out.getvalue().count("nan count") == 2
