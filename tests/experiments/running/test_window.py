"""Signals drawn in a window: its process, what it draws, and that it never disturbs."""

import os
import shutil
import signal
import subprocess
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from rigtool.errors import UsageError
from rigtool.experiments.running import terminal as live
from rigtool.experiments.running.terminal import MAX_WAITING_BLOCKS, Feed, Window, open_live
from rigtool.experiments.running.window import LINE_POINTS, TIME_SPAN, Panel, thinned
from tests.cli.called import call
from tests.experiments.running.test_terminal import fft_ripple

ROOT = Path(__file__).parents[3]


def block(start, **signals):
    """Return 0.25 s of signals at 8 kHz that start at a time."""
    time = start + np.arange(2000) / 8000
    return {"time": time, **{name: np.full(2000, value) for name, value in signals.items()}}


# -- what is drawn


@pytest.fixture
def panel():
    figure = Figure()
    FigureCanvasAgg(figure)
    return Panel(figure), figure


def drawn(axes):
    return np.array(axes.lines[0].get_data())


def test_a_plot_a_channel_with_unit_and_latest_value(panel):
    panel, figure = panel
    panel.draw()  # nothing yet
    panel.add("sweep", block(3.0, encoder=7.0, current=0.25))
    panel.draw()
    assert [axes.get_title(loc="left") for axes in figure.axes] == [
        "encoder [count]",
        "current [A]",
    ]
    assert [axes.get_title(loc="right") for axes in figure.axes] == ["7", "0.25"]
    assert figure.get_suptitle() == "sweep, 3.2 s"
    assert figure.axes[0].get_xlim() == (3.0, 3.0 + TIME_SPAN)


def test_the_last_seconds_are_shown_and_the_rest_forgotten(panel):
    panel, figure = panel
    for number in range(200):
        panel.add("sweep", block(number / 4, current=float(number)))
    panel.draw()
    times, values = drawn(figure.axes[0])
    assert times[0] >= times[-1] - TIME_SPAN
    assert times[-1] - times[0] == pytest.approx(TIME_SPAN, abs=0.05)
    assert values[-1] == 199
    assert len(panel._blocks) <= TIME_SPAN * 4 + 2


def test_another_recording_or_other_channels_begin_anew(panel):
    panel, figure = panel
    for recording, signals in (("a", ["current"]), ("b", ["current"]), ("b", ["current", "force"])):
        panel.add(recording, block(1.0, **dict.fromkeys(signals, 1.0)))
        panel.draw()
        assert len(figure.axes) == len(signals)
        assert drawn(figure.axes[0])[0][-1] < 1.3
    panel.add("b", {"time": np.empty(0), "current": np.empty(0), "force": np.empty(0)})
    panel.draw()


def test_no_line_over_what_is_missing_or_was_left_out(panel):
    panel, figure = panel
    first, later = block(0.0, current=1.0), block(5.0, current=1.0)
    first["current"][500:900] = np.nan
    panel.add("sweep", first)
    panel.add("sweep", later)
    panel.draw()
    times, values = drawn(figure.axes[0])
    crossing = np.flatnonzero(np.diff(times) > 1)
    assert crossing.size == 0 or np.isnan(values[crossing]).any()
    here = np.isfinite(times)
    inside = (times[here] > 550 / 8000) & (times[here] < 850 / 8000)
    assert np.isnan(values[here][inside]).all()
    assert inside.sum() > 2


@given(st.integers(0, 20000), st.integers(0, 2**32 - 1))
def test_thinned_lines_keep_their_extremes(count, seed):
    values = np.random.default_rng(seed).normal(size=count)
    time = np.arange(count) / 8000
    times, few = thinned(time, values)
    assert len(times) == len(few) <= 2 * LINE_POINTS + LINE_POINTS // 2
    if count:
        assert few.max() == values.max()
        assert few.min() == values.min()
        assert (np.diff(times) >= 0).all()


# -- handing on


class Slow:
    def __init__(self):
        self.go, self.seen = threading.Event(), []

    def show(self, recording, block):
        self.go.wait(60)
        self.seen.append(recording)


def test_a_view_that_hangs_holds_nobody_up_and_blocks_are_left_out(monkeypatch):
    monkeypatch.setattr(live, "CLOSING_TIME", 0.1)
    view = Slow()
    feed = Feed(view)
    for number in range(1000):
        feed.show(str(number), {})
    feed.close()
    assert view.seen == []  # nobody has waited for it
    view.go.set()
    feed._thread.join(5)
    assert MAX_WAITING_BLOCKS <= len(view.seen) <= MAX_WAITING_BLOCKS + 1
    assert view.seen[:3] == ["0", "1", "2"]


def test_a_view_that_is_gone_stays_gone():
    class Gone:
        def show(self, recording, block):
            raise BrokenPipeError

    feed = Feed(Gone())
    feed.show("a", {})
    feed._thread.join(5)
    assert not feed._thread.is_alive()
    feed.show("a", {})
    feed.close()


def test_what_waits_at_the_end_is_drawn():
    view = Slow()
    view.go.set()
    feed = Feed(view)
    for number in range(MAX_WAITING_BLOCKS):
        feed.show(str(number), {})
    feed.close()
    assert len(view.seen) == MAX_WAITING_BLOCKS


# -- the process


@pytest.fixture
def imagined(tmp_path, monkeypatch):
    """A desktop that is not there; the window's pictures are files."""
    monkeypatch.setenv("MPLBACKEND", "module://tests.experiments.running.live_canvas")
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.setenv("LIVE_PICTURE", str(tmp_path / "window.png"))
    # a busy machine gives a nice process little time
    for patience in ("OPENING_TIME", "CLOSING_TIME"):
        monkeypatch.setattr(f"rigtool.experiments.running.terminal.{patience}", 600.0)
    return tmp_path / "window.txt"


def texts_with(path, word, patience=60.0):
    """Wait until a word is drawn; return all that was."""
    end = time.monotonic() + patience
    while time.monotonic() < end:
        if path.exists() and word in (text := path.read_text()):
            return text.split("\n")
        time.sleep(0.02)
    raise AssertionError(f"{word} was never drawn")


def test_blocks_arrive_in_the_window_which_ends_with_the_run(imagined):
    """It ends by itself where its input does; Ctrl-C is for the measurement."""
    with open_live("window") as feed:
        process = feed._view._process
        os.kill(process.pid, signal.SIGINT)
        feed.show("sweep_up", block(12.0, temperature=21.5))
        texts = texts_with(imagined, "sweep_up")
        assert "sweep_up, 12.2 s" in texts
        assert "temperature [degC]" in texts
        assert "21.5" in texts
        assert process.poll() is None
    assert process.poll() == 0


def test_a_window_that_is_closed_ends_no_measurement(imagined, monkeypatch):
    monkeypatch.setenv("LIVE_CLOSE", "1")
    with open_live("window") as feed:
        feed.show("a", block(0.0, current=1.0))
        assert feed._view._process.wait(60) == 0
        for number in range(100):
            feed.show("a", block(number, current=1.0))
            time.sleep(0.001)
        feed._thread.join(5)
        assert not feed._thread.is_alive()


def test_a_window_that_hangs_ends_with_the_run(imagined, monkeypatch):
    monkeypatch.setattr(live, "CLOSING_TIME", 0.2)
    with open_live("window") as feed:
        process = feed._view._process
        os.kill(process.pid, signal.SIGSTOP)
        for number in range(300):  # who waited for it would wait for ever
            feed.show("a", block(number, current=1.0, force=1.0))
        os.kill(process.pid, signal.SIGCONT)
    assert process.poll() is not None


def test_no_desktop_is_said_at_once(monkeypatch):
    monkeypatch.setenv("MPLBACKEND", "nonsense")
    message = "no window can be opened: .*nonsense.*; run rigtool on a desktop"
    with pytest.raises(UsageError, match=message):
        Window()


def test_process_that_does_not_start_is_said(monkeypatch):
    monkeypatch.setattr("sys.executable", shutil.which("false"))
    with pytest.raises(UsageError, match="its process ended; run rigtool on a desktop"):
        Window()


# -- the option


def test_option_draws_in_a_window(tmp_path, capsys, imagined):
    code, _, err = call(capsys, *fft_ripple(tmp_path, "--live-window"))
    assert code == 0, err
    assert "encoder [count]" in texts_with(imagined, "encoder", 0.1)
    assert "\x1b[K" not in err


def test_option_is_refused_before_anything_happens(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("MPLBACKEND", "agg")
    code, _, err = call(capsys, *fft_ripple(tmp_path, "--live-window"))
    assert code == 2
    assert "--live-window: no window can be opened" in err
    assert "or MPLBACKEND selects agg; run rigtool on a desktop, or use --live, which" in err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(shutil.which("Xvfb") is None, reason="needs Xvfb, a desktop without a screen")
def test_on_a_desktop(tmp_path, capsys, monkeypatch):
    pytest.importorskip("tkinter")
    monkeypatch.delenv("MPLBACKEND", raising=False)
    with subprocess.Popen(
        ["Xvfb", "-displayfd", "1"], stdout=subprocess.PIPE, text=True, stderr=subprocess.DEVNULL
    ) as desktop:
        try:
            monkeypatch.setenv("DISPLAY", f":{desktop.stdout.readline().strip()}")
            code, _, err = call(capsys, *fft_ripple(tmp_path, "--live-window"))
        finally:
            desktop.terminate()
    assert code == 0, err
