"""Signals drawn at the terminal."""

import fcntl
import io
import math
import os
import pty
import struct
import termios
import time
from collections import deque
from pathlib import Path

import numpy as np

from rigtool.experiments.running.session import STATUS_ONLY
from rigtool.experiments.running.terminal import (
    BARS,
    DRAWING_INTERVAL,
    PLAIN_BARS,
    STALE_TIME,
    Live,
    sparkline,
)
from rigtool.recipe import load_recipe
from rigtool.rigs.serial.emulators.server import serve
from rigtool.rigs.serial.emulators.target import TargetEmulator
from tests.cli.called import call
from tests.rigs.serial.recipes import overrides

ROOT = Path(__file__).parents[3]
RECIPE, KT = ROOT / "recipes" / "briaire-2006.toml", ROOT / "tests" / "fixtures" / "kt.h5"


def test_sparkline_runs_from_lowest_to_highest():
    assert sparkline(deque(range(8))) == BARS
    assert sparkline(deque([-1.0, math.nan, 1.0])) == BARS[0] + " " + BARS[-1]
    assert sparkline(deque([2.0, 2.0])) == BARS[0] * 2
    assert sparkline(deque([math.nan])) == " "


def test_it_draws_means_over_the_interval_and_draws_again_above():
    now = iter([0.0, DRAWING_INTERVAL / 2, DRAWING_INTERVAL])
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


def test_the_newest_state_is_drawn_as_between_two_numbers_lies_none():
    out = io.StringIO()
    live = Live(out, columns=4, clock=lambda: 1.0)
    live.show("hold", {"time": np.array([0.5, 1.0]), "state": np.array([1, 4], dtype=np.int32)})
    assert out.getvalue().split("\n")[1].rstrip(BARS).split()[1:] == ["state", "4"]


def test_another_recording_begins_below():
    now = iter([0.0, 1.0])
    out = io.StringIO()
    live = Live(out, clock=lambda: next(now))
    block = {"time": np.array([1.0]), "encoder": np.array([math.nan])}
    live.show("a", block)
    live.show("b", block)
    assert "\x1b[2A" not in out.getvalue()
    assert out.getvalue().count("nan count") == 2


BLOCK = {"time": np.array([1.0]), "signal_current": np.array([1.0])}


def test_what_was_written_below_meanwhile_stays():
    now = iter([0.0, 1.0, 1.0 + 2 * STALE_TIME])
    out = io.StringIO()
    live = Live(out, clock=lambda: next(now))
    live.show("a", BLOCK)
    live.show("a", BLOCK)
    assert out.getvalue().count("\x1b[2A") == 1
    out.write("hang 1 N on the cord\n")  # as an operator is asked
    live.show("a", BLOCK)
    assert out.getvalue().count("\x1b[2A") == 1


def test_lines_fit_a_narrow_terminal():
    """A line that wraps would leave its upper half behind when it is drawn again."""
    master, slave = pty.openpty()
    fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 60, 0, 0))
    now = iter(np.arange(100) * DRAWING_INTERVAL * 1.01)
    with open(slave, "w", encoding="utf-8") as out:
        live = Live(out, clock=lambda: next(now))
        drawn = ""
        for value in range(40):
            live.show("a", {**BLOCK, "signal_current": np.array([-1e-5 / (1 + value)])})
            while drawn.count("\n") < 2 * (value + 1):
                drawn += os.read(master, 10000).decode(errors="replace")
    os.close(master)
    lines = drawn.replace("\x1b[K", "").replace("\x1b[2A", "").split("\r\n")
    assert max(len(line.strip("\r")) for line in lines) == 59
    assert len(lines) == 2 * 40 + 1


def test_terminal_without_bars_gets_plain_ones():
    out = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    now = iter(np.arange(9) * DRAWING_INTERVAL * 1.01)
    live = Live(out, clock=lambda: next(now))
    for value in range(8):
        live.show("a", {**BLOCK, "signal_current": np.array([float(value)])})
    assert out.buffer.getvalue().decode("ascii").rstrip().endswith(PLAIN_BARS)


def test_terminal_that_is_gone_ends_no_measurement():
    class Gone(io.StringIO):
        def flush(self):
            raise OSError

    Live(Gone()).show("a", BLOCK)


def test_it_costs_next_to_nothing():
    block = {name: np.zeros(2000) for name in ("time", "encoder", "current", "force")}
    live = Live(io.StringIO())
    start = time.process_time()
    for _ in range(1000):  # 250 s at 8 kHz
        live.show("a", block)
    assert time.process_time() - start < 0.25


def fft_ripple(folder, *options):
    settings = ("rig.attachment=pulley", "fft_ripple.speeds=[3]", "fft_ripple.torques=[]")
    more = ("fft_ripple.power_cycles=0", "fft_ripple.revolutions=2")
    changed = [part for value in (*settings, *more) for part in ("--set", value)]
    return ["fft-ripple", RECIPE, "--kt", KT, "-o", folder / "x.h5", *changed, *options]


def test_option_draws_at_a_terminal(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("sys.stderr.isatty", lambda: True, raising=False)
    code, _, err = call(capsys, *fft_ripple(tmp_path, "--live"))
    assert code == 0, err
    assert "\x1b[K  encoder" in err


def test_target_that_keeps_its_log_is_drawn_by_what_it_tells(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("sys.stderr.isatty", lambda: True, raising=False)
    recipe = load_recipe(RECIPE, ["rig.attachment=pulley"])[0]
    with serve(TargetEmulator(recipe, paced=True)) as server:
        settings = overrides(server.port, "fft_ripple.speeds=[30]", "serial.watchdog=5")
        on_line = [part for value in settings for part in ("--set", value)]
        code, _, err = call(capsys, *fft_ripple(tmp_path, "--live", "--yes", *on_line))
    assert code == 0, err
    reported = [line for line in err.split("\n") if STATUS_ONLY in line]
    assert len(reported) >= 2
    times = [float(line.split()[-2]) for line in reported]
    assert times == sorted(times)
    drawn = err[err.index(STATUS_ONLY) :]
    assert all(f"\x1b[K  {name} " in drawn for name in ("encoder", "current", "temperature"))


def test_option_is_refused_where_there_is_no_terminal(tmp_path, capsys):
    code, _, err = call(capsys, *fft_ripple(tmp_path, "--live"))
    assert code == 2
    assert "--live draws at a terminal" in err
    assert not (tmp_path / "x.h5").exists()
