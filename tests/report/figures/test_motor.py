"""Figures of motor and friction: residuals, breakaway, and what is not drawn through zero speed."""

from pathlib import Path

import numpy as np
import pytest

from rigtool.report.figures import PLOTS
from rigtool.report.figures.plots import FIRST_OWN_NUMBER
from rigtool.runfile import open_run

FIXTURES = Path(__file__).parents[2] / "fixtures"


@pytest.fixture(scope="module")
def friction():
    with open_run(FIXTURES / "friction.h5") as run:
        yield run


@pytest.fixture(scope="module")
def calibration():
    with open_run(FIXTURES / "kt.h5") as run:
        yield run


def test_breakaway_is_marked_where_the_shaft_runs_off(friction):
    torque, position = PLOTS[22].draw(friction).axes
    (mark,) = [line for line in torque.lines if line.get_label() == "breakaway"]
    (time,), (level,) = mark.get_data()
    # The table is that of the ramp with the highest breakaway torque.
    assert abs(level) == pytest.approx(
        1e3 * friction.result("breakaway_torque_max").value, rel=0.01
    )
    shown = position.lines[0].get_xydata()
    moved = np.abs(shown[:, 1] - shown[0, 1])
    assert moved[shown[:, 0] <= time].max() < 0.5 * moved.max()


@pytest.mark.parametrize("number", [30, 32])
def test_no_line_goes_through_zero_speed(friction, number):
    (axes,) = PLOTS[number].draw(friction).axes
    drawn = [line for line in axes.lines if line.get_linestyle() not in ("None", "none")]
    assert len(drawn) == 2
    for line in drawn:
        assert len(set(np.sign(line.get_xdata()))) == 1


def test_residuals_are_the_measured_constants_over_the_fit(calibration):
    (axes,) = PLOTS[FIRST_OWN_NUMBER + 6].draw(calibration).axes
    points = axes.containers[0][0].get_xydata()
    table = calibration.table("torque_constant")
    slope = calibration.result("torque_constant_temperature_coefficient").value
    at_20 = calibration.result("torque_constant").value
    fitted = at_20 * (1 + slope * (table["temperature"] - 20))
    expected = 100 * (table["torque_constant"] / fitted - 1)
    np.testing.assert_allclose(points[:, 1], expected, rtol=0, atol=1e-9)
    assert np.abs(expected).max() < 0.1


def test_the_ways_up_and_down_are_symmetric_about_their_mean(calibration):
    (axes,) = PLOTS[FIRST_OWN_NUMBER + 8].draw(calibration).axes
    rising, falling = (line.get_ydata() for line in axes.lines[:2])
    np.testing.assert_allclose(rising, -falling, rtol=0, atol=1e-12)
    half = 1e3 * calibration.result("hysteresis_torque").value / 2
    assert np.abs(rising).max() == pytest.approx(half, rel=0.1)


def test_breakaway_by_position_covers_the_turn(friction):
    (axes,) = PLOTS[FIRST_OWN_NUMBER + 9].draw(friction).axes
    table = friction.table("breakaway")
    np.testing.assert_allclose(axes.lines[0].get_xdata(), np.degrees(table["position"]))
    np.testing.assert_allclose(axes.lines[0].get_ydata(), 1e3 * table["positive"])


def test_the_stribeck_zone_has_a_panel_for_each_direction(friction):
    left, right = PLOTS[FIRST_OWN_NUMBER + 10].draw(friction).axes
    slow, fast = (axes.containers[0][0].get_xdata() for axes in (left, right))
    assert slow.max() < 0 < fast.min()
    assert len(slow) >= 3
    assert len(fast) >= 3
