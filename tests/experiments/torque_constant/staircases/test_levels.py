"""Lines, levels and branches of staircases beside polyfit and scipy; what is refused of them."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from rigtool.errors import InsufficientDataError
from rigtool.experiments.torque_constant.staircases.levels import (
    DEFLECTION_U,
    branches,
    by_level,
    deflection,
    hysteresis,
    levels,
    lines_through,
    off_trend,
    straight_slope,
)
from rigtool.experiments.torque_constant.staircases.refusals import (
    require_dithered,
    require_resolution,
    require_shown,
    require_straight,
)

UP = np.linspace(0.0, 4.0, 17)
COURSE = np.concatenate([UP, UP[-2::-1]])
CONSTANT = 0.05


def staircases(friction=2e-3, count=5, seed=1, noise=5e-5, top=4.0, **more):
    """Return staircases up to a current; the last has ended one plateau before the others."""
    rng = np.random.default_rng(seed)
    setpoint = np.tile(COURSE * top / 4, (count, 1))
    weight = np.ones_like(setpoint)
    weight[-1, -1] = 0.0
    current = setpoint + 1e-3 * rng.standard_normal(setpoint.shape)
    way = np.where(np.arange(33) <= 16, -1.0, 1.0) * (np.arange(33) != 0)
    torque = CONSTANT * current + friction * way + noise * rng.standard_normal(setpoint.shape)
    made = {
        "setpoint": setpoint,
        "current": current,
        "torque": torque,
        "weight": weight,
        "position": np.full(setpoint.shape, np.nan),
        "count": 0.0,
        "temperature": np.full(setpoint.shape, 22.0),
        "rotor_angle": np.arange(count) * 0.5,
        "resolution": 0.0,
        "noise": noise,
    }
    return SimpleNamespace(**(made | more))


def test_lines_are_those_of_polyfit():
    stairs = staircases()
    values = stairs.torque + 0.3
    expected = [
        np.polyfit(current, own, 1, w=weight)[0]
        for current, own, weight in zip(stairs.current, values, stairs.weight, strict=True)
    ]
    np.testing.assert_allclose(lines_through(stairs, values), expected, rtol=1e-9)
    used = stairs.weight > 0
    line = stats.linregress(stairs.current[used], stairs.torque[used])
    assert straight_slope(stairs) == pytest.approx(line.slope, rel=1e-12)


def test_off_trend_is_ripple_less_what_the_temperature_does():
    stairs, rise = staircases(count=6, noise=0.0, friction=0.0), np.array([-2.0, -2, 0, 0, 2, 2])
    turn = np.array([1.0, -1, 1, -1, 1, -1]) * 0.01
    factor = 1 - 1e-3 * rise + turn
    np.testing.assert_allclose(off_trend(stairs, 0 * rise), np.zeros(6), atol=1e-9)
    stairs.torque = stairs.torque * factor[:, None]
    np.testing.assert_allclose(off_trend(stairs, rise), turn, atol=1e-9)
    np.testing.assert_allclose(off_trend(stairs, 0 * rise), factor - 1, atol=1e-9)


def test_the_arm_gives_way_by_the_line_of_positions():
    stairs = staircases(count=200)
    off = 1e-4 * np.random.default_rng(2).standard_normal(stairs.current.shape)
    stairs.position = 1.0 + np.arange(200)[:, None] + 0.01 * stairs.current + off
    stairs.count = 4e-4
    angle, u = deflection(stairs)
    assert angle == pytest.approx(0.04, rel=1e-2)
    # what positions lie off a line, and an edge of the encoder anywhere in a count, at both ends
    assert u == pytest.approx(np.hypot(1e-4, np.sqrt(2) * 4e-4 / np.sqrt(12)), rel=0.02)
    stairs.position[3, 4] = np.nan
    assert deflection(stairs) == (0.0, DEFLECTION_U)


def test_levels_hold_plateaus_of_one_set_point():
    stairs = staircases()
    current, level = levels(stairs)
    np.testing.assert_allclose(current, UP, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(level, np.tile(np.abs(np.r_[:17, 15:-1:-1]), (5, 1)))
    mean, count = by_level(level, stairs.torque, stairs.weight)
    for number in range(17):
        own = (level == number) & (stairs.weight > 0)
        assert count[number] == own.sum()
        assert mean[number] == pytest.approx(stairs.torque[own].mean(), rel=1e-9)
    assert np.isnan(by_level(level, stairs.torque, stairs.weight * (level != 3))[0][3])


def test_branches_meet_where_the_current_turns():
    stairs = staircases(noise=0.0)
    off = stairs.torque - CONSTANT * stairs.current
    current, rising, falling = branches(stairs, off)
    np.testing.assert_allclose(current, UP, rtol=0, atol=1e-12)
    np.testing.assert_allclose(rising[1:], -2e-3, rtol=1e-6)
    np.testing.assert_allclose(falling[:-1], 2e-3, rtol=1e-6)
    assert falling[-1] == rising[-1]
    assert rising[0] == falling[0]


def test_hysteresis_is_that_of_the_middle_third_with_the_scatter_of_staircases():
    stairs = staircases()
    rng = np.random.default_rng(3)
    friction = 2e-3 + 0.3e-3 * rng.standard_normal(5)
    way = np.where(np.arange(33) <= 16, -1.0, 1.0)
    off = friction[:, None] * way
    middle = np.abs(stairs.setpoint - 2.0) < 4.0 / 6 + 0.01
    off[~middle] = 1.0  # outside of it nothing counts
    # wherever the current begins
    moved = SimpleNamespace(**vars(stairs) | {"setpoint": stairs.setpoint - 1.5})
    assert hysteresis(moved, off) == hysteresis(stairs, off)
    found, u, dof = hysteresis(stairs, off)
    assert found == pytest.approx(2 * friction.mean(), rel=1e-9)
    assert u == pytest.approx(stats.sem(2 * friction), rel=1e-9)
    assert dof == 4
    stairs.weight[1:] = 0
    found, u, dof = hysteresis(stairs, off)
    assert found == pytest.approx(2 * friction[0], rel=1e-9)
    assert np.isnan(u)
    assert dof == 0
    stairs.weight[:] = ~middle
    with pytest.raises(InsufficientDataError, match="no plateau lies in the middle third"):
        hysteresis(stairs, off)


def plateaus(span, step):
    return SimpleNamespace(torque=np.array([0.1, 0.1 + span]), resolution=np.array([0.0, step]))


@pytest.mark.parametrize(
    ("span", "step", "message"),
    [(0.2, 0.0199, None), (0.2, 0.0201, "fewer than 10 steps"), (0.0, 0.01, "reads 100 mN m")],
)
def test_a_gauge_of_few_steps_is_refused(span, step, message):
    if message is None:
        require_resolution(plateaus(span, step))
    else:
        with pytest.raises(InsufficientDataError, match=message):
            require_resolution(plateaus(span, step))


@pytest.mark.parametrize(
    ("part", "noise", "refused"),
    [
        (1.0, 0.0, False),
        (0.252, 0.0, False),
        (0.248, 0.0, True),
        (0.248, 0.098, True),
        (0, 0.102, False),
    ],
)
def test_readings_that_follow_the_steps_of_a_gauge_are_refused(part, noise, refused):
    """Rounding leaves what lies evenly within a step."""
    step = 1e-3
    stairs = staircases(resolution=step, noise=noise * step)
    left = np.random.default_rng(4).uniform(-0.5, 0.5, stairs.torque.shape)
    left *= part * step / math.sqrt(12 * np.mean(left[stairs.weight > 0] ** 2))
    left[-1, -1] = 1.0  # without weight
    if refused:
        with pytest.raises(InsufficientDataError, match="steps off a line, where rounding"):
            require_dithered(stairs, left)
    else:
        require_dithered(stairs, left)


def judged(stairs, slope=CONSTANT, bend=None, slope_u=1e-4):
    """Judge staircases whose fit found this slope and left what they are off it."""
    count = len(stairs.torque)
    off = stairs.torque - CONSTANT * stairs.current
    left = np.zeros_like(off) if bend is None else bend
    require_straight(stairs, np.full(count, slope), np.full(count, slope_u), left, off)


def test_a_straight_staircase_passes():
    judged(staircases())


@pytest.mark.parametrize(("part", "refused"), [(0.98, False), (1.02, True)])
def test_a_level_off_the_line_is_refused(part, refused):
    """By a two-hundredth of the span, or a step of the gauge where that is more."""
    for resolution in (0.0, 4e-3):
        stairs = staircases(resolution=resolution)
        limit = max(5e-3 * np.ptp(stairs.torque), resolution)
        bend = np.where(np.isclose(stairs.setpoint, 3.0), -part * limit, 0.0)
        if refused:
            with pytest.raises(InsufficientDataError, match=r"torque at 3 A is -.* off the line"):
                judged(stairs, bend=bend)
        else:
            judged(stairs, bend=bend)


def test_friction_is_named_where_a_level_is_off_the_line():
    stairs = staircases(friction=0.026)
    bend = np.where(np.isclose(stairs.setpoint, 3.0), -2e-2 * np.ptp(stairs.torque), 0.0)
    with pytest.raises(InsufficientDataError, match=r"off the line .* friction of the shaft"):
        judged(stairs, bend=bend)


@pytest.mark.parametrize(("part", "refused"), [(0.098, False), (0.102, True)])
def test_large_friction_may_leave_a_tenth_of_itself(part, refused):
    stairs = staircases(friction=0.026)
    bend = np.where(np.isclose(stairs.setpoint, 3.0), -part * 0.026, 0.0)
    if refused:
        with pytest.raises(InsufficientDataError, match=r"off the line .* friction of the shaft"):
            judged(stairs, bend=bend)
    else:
        judged(stairs, bend=bend)


@pytest.mark.parametrize(("change", "refused"), [(1.48, False), (1.52, True)])
def test_large_friction_may_change_a_slope_by_a_half(change, refused):
    stairs = staircases(friction=0.026)
    slope = change * straight_slope(stairs)
    if refused:
        with pytest.raises(InsufficientDataError, match=r"by 50 %: friction of the shaft"):
            judged(stairs, slope)
    else:
        judged(stairs, slope)


def test_a_level_that_scatters_is_not_off():
    stairs = staircases()
    scatter = np.random.default_rng(6).choice([-1.0, 1.0], stairs.torque.shape)
    bend = np.where(np.isclose(stairs.setpoint, 3.0), 1.1e-3 + 4e-3 * scatter, 0.0)
    judged(stairs, bend=bend)


@pytest.mark.parametrize(
    ("change", "refused"), [(1.24, False), (1.26, True), (0.76, False), (0.74, True)]
)
def test_heat_may_change_a_slope_by_a_quarter(change, refused):
    stairs = staircases(friction=1e-6)
    slope = change * straight_slope(stairs)
    if refused:
        with pytest.raises(InsufficientDataError, match="once friction and heat are taken out"):
            judged(stairs, slope)
    else:
        judged(stairs, slope)


@pytest.mark.parametrize(
    ("friction", "resolution", "message"),
    [
        (0.026, 0.0, "friction of the shaft shows 26 mN m"),
        (1e-3, 0.0, "torque is not linear in current"),
        (1e-3, 6e-3, "too coarse to separate friction"),
    ],
)
def test_a_slope_that_changes_by_more_is_explained(friction, resolution, message):
    stairs = staircases(friction=friction, resolution=resolution)
    with pytest.raises(InsufficientDataError, match=message):
        judged(stairs, 2 * CONSTANT)
    stairs.noise = 0.49 * np.ptp(stairs.torque)
    with pytest.raises(InsufficientDataError, match=message):
        judged(stairs, 2 * CONSTANT)


@pytest.mark.parametrize(("part", "refused"), [(0.9, True), (1.1, False)])
def test_a_slope_that_scatter_hides_is_refused(part, refused):
    """The standard uncertainty of a line is scipy's; ten times that has to be seen."""
    stairs = staircases(friction=0.0, noise=CONSTANT, seed=8)
    used = stairs.weight > 0
    line = stats.linregress(stairs.current[used], stairs.torque[used])
    stairs.torque += (10 * part * line.stderr - line.slope) * stairs.current
    if refused:
        with pytest.raises(InsufficientDataError, match="hold steps longer"):
            require_shown(stairs)
    else:
        require_shown(stairs)


def test_a_sign_is_to_be_reversed():
    stairs = staircases()
    stairs.torque *= -1
    with pytest.raises(InsufficientDataError, match="reverse the sign"):
        judged(stairs)


@pytest.mark.parametrize(("change", "refused"), [(0.24, False), (0.27, True), (-0.27, True)])
def test_a_staircase_with_a_slope_of_its_own_is_named(change, refused):
    stairs = staircases(slope_u=0.0)
    stairs.torque[3] *= 1 + change
    if refused:
        with pytest.raises(InsufficientDataError, match=r"staircase 3 .* at 1\.5 rad"):
            judged(stairs)
        judged(stairs, slope_u=1e-3)  # with an uncertainty that allows it
    else:
        judged(stairs)


@pytest.mark.parametrize(("rise", "refused"), [(0.6, False), (0.4, True)])
def test_torque_that_stops_rising_at_the_top_is_refused(rise, refused):
    stairs = staircases()
    beyond = np.maximum(stairs.current - 3.0, 0)
    stairs.torque -= CONSTANT * (1 - rise) * beyond
    if refused:
        with pytest.raises(InsufficientDataError, match=r"from 3 A on by 0\.0"):
            judged(stairs)
    else:
        judged(stairs)


@pytest.mark.parametrize("times", [0.98, 1.02])
def test_a_slope_at_the_top_is_uncertain_by_what_levels_scatter(times):
    """A line through the top five of 17 levels, by four standard uncertainties."""
    stairs = staircases(noise=0.0)
    stairs.current = stairs.setpoint.copy()
    scatter = 3e-3 * np.random.default_rng(7).standard_normal(stairs.torque.shape)
    used = stairs.weight > 0
    each = [scatter[used & np.isclose(stairs.setpoint, level)] for level in UP]
    level_u = np.array([own.std(ddof=1) / np.sqrt(own.size) for own in each])
    top = UP[-5:] - UP[-5:].mean()
    slope_u = np.sqrt(np.mean(level_u**2) / np.sum(top**2))
    rise = 0.5 - times * 4 * slope_u / CONSTANT
    stairs.torque = CONSTANT * (stairs.current - (1 - rise) * np.maximum(stairs.current - 3.0, 0))
    if times > 1:
        with pytest.raises(InsufficientDataError, match=r"torque rises with current by 0\.05"):
            judged(stairs, bend=scatter)
    else:
        judged(stairs, bend=scatter)
