"""Cycles of a load: statistics by their formula, and where cycles, readings and peaks end."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize_scalar

from rigtool.errors import InsufficientDataError
from rigtool.experiments.force import cycles as force


@given(
    st.lists(st.floats(-1, 1), min_size=3, max_size=40).filter(lambda v: np.ptp(v) > 1e-3),
    st.floats(-50, 50),
)
def test_statistics_are_those_of_an_autoregression_about_any_mean(values, level):
    """m = n (1 - r)/(1 + r), r >= 0 from each reading to the next, m >= 2; u = S/sqrt(m)."""
    x = np.array(values)
    n, off = len(x), x - x.mean()
    r = max(0.0, np.dot(off[1:], off[:-1]) / np.dot(off, off))
    m = max(2.0, n * (1 - r) / (1 + r))
    spread = math.sqrt(np.dot(off, off) / (n - 1))
    found = force.statistics(x + level)
    assert found.mean == pytest.approx(x.mean() + level, abs=1e-9)
    assert found.std == pytest.approx(spread, rel=1e-6)
    assert found.effective_count == pytest.approx(m, rel=1e-5)
    assert found.u == pytest.approx(spread / math.sqrt(m), rel=1e-5)
    assert found.dof == pytest.approx(m - 1, rel=1e-5)


def test_readings_that_are_all_the_same_have_no_scatter():
    found = force.statistics(np.full(7, 0.25))
    assert (found.mean, found.std, found.u, found.dof) == (0.25, 0.0, 0.0, 6.0)


@pytest.mark.parametrize("back", [False, True])
def test_a_swing_about_the_middle_by_less_than_a_tenth_is_part_of_the_stroke(back):
    """One that goes further is a cycle by itself, which does not end low."""

    def position(swing):
        parts = [np.linspace(0, 50 + swing, 40), np.linspace(50, 50 - swing, 20)]
        whole = np.concatenate([*parts, np.linspace(50, 100, 40), np.linspace(100, 0, 80)])
        return whole[::-1] if back else whole

    assert force.find_cycles(position(8)) == [force.Cycle(0, 79 if back else 99, 179)]
    with pytest.raises(InsufficientDataError, match="between 0 and 100 makes no full"):
        force.find_cycles(position(12))


def test_cycles_go_from_lowest_to_highest_to_lowest_point():
    position = np.array([3.0, 0.9, 2, 5, 9, 10, 7, 2, 0, 4, 8, 9.5, 5, 1, 0.5, 2.0])
    assert force.find_cycles(position) == [force.Cycle(1, 5, 8), force.Cycle(8, 11, 14)]
    # a motion that starts high has its first cycle behind the first low point
    assert force.find_cycles(position[4:]) == [force.Cycle(4, 7, 10)]


def test_a_cycle_that_does_not_come_down_is_left_out():
    position = np.array([0.0, 5, 10, 5, 0, 5, 10, 5, 1.5])
    assert force.find_cycles(position) == [force.Cycle(0, 2, 4)]
    position[-1] = 0.9  # within a tenth of the stroke it is down
    assert len(force.find_cycles(position)) == 2


def test_three_samples_are_a_cycle():
    assert force.find_cycles([0.0, 1.0, 0.0]) == [force.Cycle(0, 1, 2)]
    with pytest.raises(InsufficientDataError):
        force.find_cycles([0.0, 1.0])


def test_an_angle_at_the_end_of_a_stroke_is_not_passed():
    position = np.array([0.0, 0.5, 1.0, 0.5, 0.0])
    found = force.find_cycles(position)
    torque = np.array([1.0, 2.0, 3.0, 9.0, 9.0])
    for angle, expected in ((1e-9, 1.0), (0.25, 1.5), (1 - 1e-9, 3.0)):
        assert force.readings(position, torque, found, angle) == pytest.approx([expected])
    for angle in (0.0, 1.0):
        with pytest.raises(InsufficientDataError, match=r"cycle 0 moves from 0 to 57\.3 deg"):
            force.readings(position, torque, found, angle)


def test_a_rise_that_shakes_is_read_where_it_first_passes():
    position = np.array([0.0, 2.0, 1.0, 3.0, 4.0, 2.0, 0.0])
    torque = np.array([0.0, 1.0, 5.0, 2.0, 3.0, 7.0, 8.0])
    found = force.readings(position, torque, [force.Cycle(0, 4, 6)], 1.0)
    assert found == pytest.approx([0.5])


def test_curves_hold_their_last_values_at_both_ends():
    position = np.array([0.0, 1.0, 2.0, 3.0, 2.0, 1.0, 0.0])
    signal = np.array([10.0, 11, 12, 13, 22, 21, 20])
    grid = np.array([-1.0, 0.5, 1.5, 4.0])
    up, down = force.curves(position, signal, [force.Cycle(0, 3, 6)], grid)
    np.testing.assert_allclose(up, [[10, 10.5, 11.5, 13]])
    np.testing.assert_allclose(down, [[20, 20.5, 21.5, 13]])


@given(
    top=st.floats(0.9, 2.2),
    width=st.floats(0.8, 1.2),
    height=st.floats(0.01, 10.0),
    skew=st.floats(-0.08, 0.08),
)
def test_the_top_of_a_skewed_curve_is_that_of_scipy(top, width, height, skew):
    """A cubic over 30 degrees on either side is off by some thousandths of the width."""

    def curve(angle):
        off = (angle - top) / width
        return height * (np.cos(off) + skew * off**3)

    grid = np.linspace(0.3, 2.9, 241)
    found = force.find_peak(grid, curve(grid))
    exact = minimize_scalar(lambda a: -curve(a), bounds=(top - 0.4, top + 0.4), method="bounded")
    assert found.angle == pytest.approx(exact.x, abs=8e-3)
    assert found.torque == pytest.approx(curve(exact.x), rel=1e-3)


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize(("inside", "found"), [(13.0, False), (17.0, True)])
def test_three_quarters_of_the_window_about_a_peak_are_within_the_curve(side, inside, found):
    """The window has 30 degrees on either side: the top is 15 degrees or more from the ends."""
    angle = np.radians(np.linspace(0, 120, 481))
    top = math.radians(inside if side > 0 else 120 - inside)
    curve = np.cos(angle - top)
    if found:
        peak = force.find_peak(angle, curve)
        assert peak.angle == pytest.approx(top, abs=2e-3)
        assert peak.torque == pytest.approx(1.0, rel=1e-3)
        return
    with pytest.raises(InsufficientDataError, match="no peak between 0 and 120 deg"):
        force.find_peak(angle, curve)


def test_noise_at_the_highest_point_does_not_move_the_top():
    """The window follows the top of the cubic, not the highest sample."""
    angle = np.radians(np.linspace(0, 180, 721))
    curve = np.sin(angle)
    curve[260] += 0.2  # at 65 degrees
    assert force.find_peak(angle, curve).angle == pytest.approx(np.pi / 2, abs=5e-3)


def test_peaks_are_those_of_each_stroke():
    angle = np.radians(np.linspace(20, 160, 281))
    up = np.stack([np.cos(angle - 1.4), 2 * np.cos(angle - 1.5)])
    down = np.stack([3 * np.cos(angle - 1.6), 4 * np.cos(angle - 1.7)])
    found = force.peaks(angle, up, down)
    expected = ([1.4, 1.5], [1, 2], [1.6, 1.7], [3, 4])
    names = ("lifting_angle", "lifting_torque", "lowering_angle", "lowering_torque")
    for name, values in zip(names, expected, strict=True):
        np.testing.assert_allclose(getattr(found, name), values, rtol=1e-3)


def test_plotting_positions_are_those_of_filliben():
    found = force.normality([3.0, 1.0, 2.0, 7.0])
    last = 0.5 ** (1 / 4)
    expected = [1 - last, 1.6825 / 4.365, 2.6825 / 4.365, last]
    np.testing.assert_allclose(found.probability, expected, rtol=1e-12)
