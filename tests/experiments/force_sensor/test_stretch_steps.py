"""How a stretch holds its ends, fills its reference, and gives rows whatever its blocks are."""

import math
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.signal import butter, sosfiltfilt

from rigtool.experiments.force_filter.motion_states import Moments
from rigtool.experiments.force_sensor import stretch as module
from rigtool.experiments.force_sensor.stretch import (
    Stretch,
    filled,
    held_lowpass,
    shortest_stretch,
    weight_ahead,
)
from tests.experiments.deploy.sensors import Model, instrument

RATE = 500.0


@given(st.floats(0.1, 60.0))
def test_two_seconds_or_two_periods_of_the_corner_are_the_shortest(corner):
    assert shortest_stretch(corner) == pytest.approx(max(2.0, 2.01 / corner))


@pytest.mark.parametrize("corner", [5.0, 20.0])
def test_ends_are_filtered_as_if_they_were_held(corner):
    """By scipy's filter forward and backward over a longer signal that stays at its ends."""
    rng = np.random.default_rng(1)
    values = np.cumsum(rng.standard_normal(800))
    sections = butter(2, corner, fs=RATE, output="sos")
    longer = np.pad(values, 2000, mode="edge")
    expected = sosfiltfilt(sections, longer)[2000:-2000]
    found = held_lowpass(RATE, values, corner)
    assert_allclose(found, expected, atol=0.02 * np.ptp(values))
    assert_allclose(held_lowpass(RATE, np.full(300, 3.0), corner), 3.0)


@pytest.mark.parametrize("size", [20, 5000])
def test_the_weight_ahead_is_that_of_the_held_last_value(size):
    """The change of the filtered values by one of what is held behind them."""
    corner = 10.0
    length = min(size, round(RATE / corner))
    found = weight_ahead(RATE, size, corner)
    assert len(found) == length
    before = held_lowpass(RATE, np.zeros(6 * length), corner)
    step = np.concatenate([np.zeros(3 * length), np.ones(3 * length)])
    expected = (held_lowpass(RATE, step, corner) - before)[2 * length : 3 * length]
    assert_allclose(found, expected, atol=2e-3)
    assert found[0] < 0.01
    assert 0.4 < found[-1] < 0.6


def test_a_reference_is_judged_where_it_is_known_on_both_sides():
    reference = np.arange(40.0)
    whole, known = filled(reference, 3)
    assert whole is reference
    assert known.all()
    holed = reference.copy()
    holed[[7, 20, 21, 39]] = np.nan
    whole, known = filled(holed, 3)
    assert_allclose(whole[:39], np.arange(39.0))
    assert whole[39] == 38.0
    near = [any(abs(k - n) <= 3 for n in (7, 20, 21, 39)) for k in range(40)]
    assert known.tolist() == [not one for one in near]


class Sensed:
    """A sensor of which each step is one sample, numbered."""

    def __init__(self, own, *, before):
        assert before == "ripple"
        self.steps, self.last_deviation = 0, 0.0

    def add(self, samples, *, last=False):
        number = self.steps + np.arange(float(samples.shape[1]))
        self.steps += samples.shape[1]
        estimate = SimpleNamespace(low=number, opened=number % 3 == 0)
        names = ("less", "torque", "u", "unfollowed", "grown", "unbent", "swing")
        columns = {name: number + 1000 * k for k, name in enumerate(names)}
        columns["states"] = number % 5
        moments = Moments(*[number] * 7)
        return SimpleNamespace(estimate=estimate, moments=moments, others=samples[3:], **columns)


@pytest.mark.parametrize("every", [1, 3, 7])
@pytest.mark.parametrize("blocks", [[40], [1, 2, 30, 7], [5, 0, 5, 5, 5, 20]])
def test_rows_are_every_so_many_steps_whatever_the_blocks_are(every, blocks, monkeypatch):
    monkeypatch.setattr(Model, "limits", np.full((3, 2), np.inf), raising=False)
    monkeypatch.setattr(module, "Sensor", Sensed)
    asked = []
    monkeypatch.setattr(module, "steps_of_a_row", lambda *given: asked.append(given) or every)
    monkeypatch.setattr(Stretch, "_smooth", lambda self, sensed, last: None)
    own = instrument(interval=1e-3, loop_time=1e-3, current_limit=1.5)
    with ThreadPoolExecutor(1) as one, ThreadPoolExecutor(1) as other:
        found = Stretch("a", own, 3.0, 40, (one, other), before=(None, "ripple"))
        found._untouched = None
        samples = np.random.default_rng(2).standard_normal((4, 40))
        first = 0
        for size in blocks:
            found.add(samples[:, first : first + size])
            first += size
        found._settle()
    assert found._steps == 40
    assert asked == [(own.grid.step_time, own.corner_hz)]
    rows = np.arange(0.0, 40.0, every)
    kept = ("less", "causal", "causal_u", "unfollowed", "grown", "unbent", "swing")
    for number, name in enumerate(kept):
        expected = np.arange(40.0) if name == "less" else rows
        assert_allclose(found._taken(name), expected + 1000 * number)
    assert_allclose(found._taken("passed"), rows + own.count / 2)
    assert_allclose(found._taken("causal_states"), rows % 5)
    np.testing.assert_array_equal(found._taken("opened"), np.arange(40) % 3 == 0)
    angle = np.remainder(np.arange(40.0) + own.count / 2, 2 * math.pi)
    assert_allclose(found._taken("angle"), angle, atol=1e-5)
    assert_allclose(found._taken("reference"), samples[3])
    assert found._began == pytest.approx(3.0 - own.interval / 2)
    limited = int(np.sum(np.abs(samples[1]) >= 0.999 * own.current_limit))
    assert found._limited == limited
