"""Force from current: against the thesis's own numbers, scipy, and properties."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal, stats

from rigtool.errors import InsufficientDataError
from rigtool.experiments.force import cycles as force
from rigtool.numerics.steady_mean import weights

RATE = 500.0


def triangle(cycles: int, stroke_time: float = 3.0) -> tuple[np.ndarray, np.ndarray]:
    """Time and an output angle that goes from 0 to 180 deg and back."""
    time = np.arange(round(2 * cycles * stroke_time * RATE)) / RATE
    phase = np.mod(time / stroke_time, 2)
    return time, np.pi * np.minimum(phase, 2 - phase)


def half_sine(
    angle: np.ndarray, lifting: np.ndarray, load: float, friction: float, stiffness: float
) -> np.ndarray:
    """Torque of a load on a spring: grasper = angle - torque / stiffness."""
    factor = np.where(lifting, 1 + friction, 1 - friction)
    torque = np.zeros_like(angle)
    for _ in range(200):
        torque = factor * load * np.sin(angle - torque / stiffness)
    return torque


# --- cycles and readings


@settings(deadline=None, max_examples=40)
@given(
    cycles=st.integers(1, 8),
    span=st.floats(1e-3, 1e4),
    offset=st.floats(-1e4, 1e4),
    noise=st.floats(0, 0.02),
    seed=st.integers(0, 100),
)
def test_every_cycle_is_found_once_wherever_the_position_lies(cycles, span, offset, noise, seed):
    _, angle = triangle(cycles)
    rng = np.random.default_rng(seed)
    position = offset + span * (angle / np.pi + noise * rng.standard_normal(angle.size))
    found = force.find_cycles(position)
    assert len(found) == cycles
    stroke = 3.0 * RATE
    for number, cycle in enumerate(found):
        assert cycle.top == pytest.approx((2 * number + 1) * stroke, abs=0.1 * stroke)
    assert all(a.end == b.start for a, b in pairwise(found))


def test_incomplete_cycles_at_either_end_are_left_out():
    _, angle = triangle(4)
    cut = slice(round(1.5 * 3 * RATE), round(6.5 * 3 * RATE))  # begins falling, ends rising
    assert len(force.find_cycles(angle[cut])) == 2


@pytest.mark.parametrize("position", [np.zeros(100), np.linspace(0, 1, 100)])
def test_no_cycle_is_an_error(position):
    with pytest.raises(InsufficientDataError, match="no full up-and-down"):
        force.find_cycles(position)


def test_strokes_that_a_load_pulls_off_their_path_are_no_lack_of_cycles():
    """A load lets the shaft sag once, further than strokes differ in height."""
    position = 2000 * (1 - np.cos(np.linspace(0, 12 * np.pi, 3001)))
    position[:100] -= 900 * np.sin(np.linspace(0, np.pi, 100))
    with pytest.raises(InsufficientDataError, match=r"goes down to -6\d\d.*stiffer \[rig"):
        force.find_cycles(position)


def test_readings_are_interpolated_at_the_angle_of_the_rising_stroke():
    time, angle = triangle(3)
    torque = 1e-3 * angle + 1e-4 * np.floor(time / 6.0)
    torque[np.gradient(angle) < 0] = 1.0  # the falling stroke must not be read
    found = force.readings(angle, torque, force.find_cycles(angle), 1.2345)
    np.testing.assert_allclose(found, 1.2345e-3 + 1e-4 * np.arange(3), rtol=1e-9, atol=0)


def test_an_angle_outside_the_stroke_is_refused():
    _, angle = triangle(2)
    with pytest.raises(InsufficientDataError, match="never passes measure_angle 200 deg"):
        force.readings(angle, angle, force.find_cycles(angle), math.radians(200))


def test_nan_is_refused():
    _, angle = triangle(2)
    torque = angle.copy()
    torque[7] = np.nan
    with pytest.raises(InsufficientDataError, match="torque is nan at sample 7"):
        force.readings(angle, torque, force.find_cycles(angle), 1.0)


# --- statistics


def test_mean_and_scatter_of_forty_readings():
    rng = np.random.default_rng(3)
    noise = rng.standard_normal(40)
    noise = (noise - noise.mean()) / noise.std(ddof=1)
    row = force.statistics(22.4e-3 + 0.98e-3 * noise)
    assert row.mean == pytest.approx(22.4e-3, rel=1e-9)
    assert row.std == pytest.approx(0.98e-3, rel=1e-9)
    assert row.count == 40


def test_uncertainty_of_the_mean_covers_what_repetitions_show():
    rng = np.random.default_rng(11)
    for coefficient in (0.0, 0.6):
        white = rng.standard_normal((2000, 140))
        series = signal.lfilter([1], [1, -coefficient], white, axis=1)[:, 100:]
        means = [force.statistics(row) for row in series]
        actual = np.std([row.mean for row in means])
        stated = math.sqrt(np.mean([row.u**2 for row in means]))
        assert stated == pytest.approx(actual, rel=0.25)


@settings(deadline=None, max_examples=50)
@given(st.lists(st.floats(-1, 1), min_size=3, max_size=60))
def test_correlation_never_makes_the_uncertainty_smaller(values):
    row = force.statistics(values)
    assert row.u >= row.std / math.sqrt(len(values)) * (1 - 1e-12)
    assert row.dof <= len(values) - 1 + 1e-12


def test_strokes_that_pay_back_know_their_mean_better():
    """Deviations that the next stroke returns: the means of many series scatter as stated, which
    each series taken alone overstates by far."""
    rng = np.random.default_rng(5)
    found, alone = [], []
    for _ in range(200):
        drawn = rng.standard_normal((6, 21))
        series = drawn[:, 1:] - 0.8 * drawn[:, :-1]
        found += force.steady_statistics(list(series))
        alone += [force.statistics(row) for row in series]
    scatter = np.std([row.mean for row in found])
    assert math.sqrt(np.mean([row.u**2 for row in found])) == pytest.approx(scatter, rel=0.25)
    assert math.sqrt(np.mean([row.u**2 for row in alone])) > 2 * scatter
    last, own = found[-1], series[-1]
    assert last.std == pytest.approx(own.std(ddof=1), rel=1e-12)
    assert last.effective_count == pytest.approx((last.std / last.u) ** 2, rel=1e-12)
    assert last.mean == pytest.approx(np.average(own, weights=weights(20)), rel=1e-12)


# --- normality


def test_normality_agrees_with_scipy():
    x = 1e-3 * np.random.default_rng(5).standard_normal(40)
    found = force.normality(x)
    theirs = stats.probplot(x, fit=True)
    np.testing.assert_allclose(found.quantile, theirs[0][0], rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(found.ordered, theirs[0][1])
    assert found.p == pytest.approx(stats.shapiro(1e3 * x).pvalue, rel=1e-6)


def test_normality_is_rejected_where_it_should_be_and_at_the_rate_it_should_be():
    rng = np.random.default_rng(8)
    assert force.normality(rng.standard_exponential(40)).p < 0.01
    rejected = [force.normality(1e-3 * rng.standard_normal(40)).p < 0.05 for _ in range(400)]
    assert 0.02 < np.mean(rejected) < 0.09


def test_readings_without_scatter_have_no_distribution():
    with pytest.raises(InsufficientDataError, match="no distribution"):
        force.normality(np.full(40, 1e-3))


# --- curves and peaks


def test_up_and_down_runs_to_3400_counts():
    grid = np.linspace(0, 1700, 171)
    whole = force.up_and_down(grid[None], grid[None])
    assert whole.shape == (1, 341)
    np.testing.assert_array_equal(whole[0], 1700 - np.abs(np.arange(341) * 10 - 1700))


def test_curves_return_the_function_of_position_they_were_made_of():
    _, angle = triangle(3)
    lifting = np.gradient(angle) > 0
    torque = np.where(lifting, np.sin(angle), 2 * np.sin(angle))
    grid = np.linspace(0.1, 3.0, 50)
    up, down = force.curves(angle, torque, force.find_cycles(angle), grid)
    np.testing.assert_allclose(up, np.tile(np.sin(grid), (3, 1)), rtol=0, atol=1e-4)
    np.testing.assert_allclose(down, np.tile(2 * np.sin(grid), (3, 1)), rtol=0, atol=1e-4)


@settings(deadline=None, max_examples=40)
@given(
    load=st.floats(0.01, 0.11),
    friction=st.floats(0, 0.15),
    stiffness=st.floats(0.25, 50),
)
def test_peaks_give_friction_and_stiffness_back(load, friction, stiffness):
    grid = np.radians(np.linspace(20, 160, 281))
    up = half_sine(grid, np.array(True), load, friction, stiffness)
    down = half_sine(grid, np.array(False), load, friction, stiffness)
    found = force.peaks(grid, up[None], down[None])
    assert found.lifting_torque[0] == pytest.approx(load * (1 + friction), rel=5e-3)
    assert found.lowering_torque[0] == pytest.approx(load * (1 - friction), rel=5e-3)
    shift = (found.lifting_angle[0] + found.lowering_angle[0]) / 2 - np.pi / 2
    assert shift == pytest.approx(load / stiffness, rel=0.03, abs=1e-3)


def test_thesis_figure_62_shift_and_stiffness():
    # 5 N at 20 mm moves the peak from 850 to 1200 quad counts of 1700 for 180 deg
    grid = np.radians(np.linspace(20, 160, 281))
    shift = math.radians(350 / 1700 * 180)
    up = half_sine(grid, np.array(True), 0.1, 0.0, 0.1 / shift)
    found = force.find_peak(grid, up)
    assert math.degrees(found.angle - np.pi / 2) == pytest.approx(37.06, abs=0.6)


@pytest.mark.parametrize("curve", [np.linspace(0, 1, 50), np.cosh(np.linspace(-1, 1, 50))])
def test_a_curve_without_a_peak_is_refused(curve):
    with pytest.raises(InsufficientDataError, match="no peak"):
        force.find_peak(np.linspace(0.3, 2.8, 50), curve)
