"""Torque constants from plateaus and ramps of drawn motors: u covers the error."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import t as student

from rigtool.errors import InsufficientDataError
from rigtool.experiments.torque_constant.current_levels import _Column, _Fit, fit_constant
from rigtool.experiments.torque_constant.current_points import Course, Points, _one_way, find_points

PER_LEVEL = 60


def course(kind, top):
    """Current (n,) of a course up to a largest one."""
    up = np.linspace(0, top, 8)
    if kind == "staircase":
        return np.repeat(np.concatenate([up, up[-2::-1]]), PER_LEVEL)
    if kind == "one way":
        return np.repeat(np.linspace(top / 8, top, 8), 2 * PER_LEVEL)
    return top * np.concatenate([np.linspace(0, 1, 600), np.linspace(1, 0, 600)])


def draw(kind, seed):
    """Constant at 20 degC and coefficient of a motor, and what a bench of others would record."""
    random = np.random.default_rng(seed)
    constant, change = random.uniform(0.02, 0.2), -random.uniform(2e-4, 2e-3)
    top = random.uniform(1, 10)
    span, current = constant * top, course(kind, top)
    friction, length = span * random.uniform(0.005, 0.05), top * random.uniform(0.005, 0.2)
    state, states = 0.0, np.zeros(len(current))
    for index, step in enumerate(np.diff(current, prepend=current[0])):
        if step:
            state = np.sign(step) + (state - np.sign(step)) * np.exp(-abs(step) / length)
        states[index] = state
    degc = 22 + (60 if kind == "one way" else 15) * np.cumsum(current**2) / np.sum(current**2)
    saturation = random.uniform(0, 0.02)
    iron = 1 - saturation * (current / top) ** 2
    torque = constant * (1 + change * (degc - 20)) * current * iron - friction * states
    drift = np.cumsum(random.normal(size=len(current)))
    torque = torque + 0.1 * span + 0.001 * span * drift / drift.std()
    torque = torque + random.normal(0, 0.005 * span, len(current))
    measured = current + random.normal(0, 0.003 * top, len(current))
    time = np.arange(len(current)) * 0.1
    return (constant * (1 - saturation / 3), change), Course(time, measured, torque, degc.round(1))


@pytest.mark.parametrize(
    ("kind", "plateaus", "largest"),
    [("staircase", True, 0.015), ("one way", True, 0.06), ("ramp", False, 0.04)],
)
def test_intervals_of_drawn_motors_hold(kind, plateaus, largest):
    errors, held, referred, changed, draws = [], 0, 0, 0, 12
    for seed in range(draws):
        (constant, change), recorded = draw(kind, seed)
        points = find_points(recorded)
        assert points.plateaus == plateaus
        fit = fit_constant([points])
        true = constant * (1 + change * (fit.temperature - 20))
        u = np.hypot(fit.constant_u, fit.constant * fit.curvature_u)
        errors.append(fit.constant / true - 1)
        at_reference, at_u = fit.reference
        bound = student.ppf(0.975, fit.dof) * np.hypot(at_u, at_reference * fit.curvature_u)
        referred += abs(at_reference - constant) < bound
        coefficient, coefficient_u = fit.coefficient
        changed += abs(coefficient - change) < student.ppf(0.975, fit.dof) * coefficient_u
        held += abs(fit.constant - true) < student.ppf(0.975, fit.dof) * u
        assert fit.one_way == (kind == "one way")
    assert min(held, referred, changed) >= draws - 2
    assert np.max(np.abs(errors)) < largest


@pytest.mark.parametrize(("samples", "levels", "cycles"), [(5, 40, 5), (10, 16, 2)])
def test_short_plateaus_are_plateaus(samples, levels, cycles):
    """As ramps they are 1 % off; with few lengths of the transition, beyond their u."""
    off = []
    for seed in range(4):
        random = np.random.default_rng(seed)
        up = np.linspace(0, 4, levels)
        cycle = np.concatenate([up, up[-2:0:-1]])
        current = np.append(np.tile(cycle, cycles), 0).repeat(samples)
        length, state, states = random.uniform(0.02, 0.8), 0.0, np.zeros(len(current))
        for index, step in enumerate(np.diff(current, prepend=0.0)):
            if step:
                state = np.sign(step) + (state - np.sign(step)) * np.exp(-abs(step) / length)
            states[index] = state
        torque = 0.05 * current - 0.006 * states + random.normal(0, 6e-4, len(current))
        measured = current + random.normal(0, 2e-3, len(current))
        points = find_points(Course(np.arange(len(current)) * 0.02, measured, torque))
        assert points.plateaus
        fit = fit_constant([points])
        assert abs(fit.constant - 0.05) < 2.5 * np.hypot(fit.constant_u, 0.05 * fit.curvature_u)
        off.append(fit.constant / 0.05 - 1)
    assert np.sqrt(np.mean(np.square(off))) < 0.004


def test_a_ramp_that_is_read_in_steps_is_a_ramp():
    current = course("ramp", 3.0)
    torque = 0.05 * current + np.random.default_rng(2).normal(0, 1e-4, len(current))
    read = np.round(current / 0.1) * 0.1
    points = find_points(Course(np.arange(len(current)) * 0.02, read, torque))
    assert not points.plateaus


def test_a_motor_that_drives_a_brake_both_ways_without_a_recorded_speed():
    """Friction has the sign of the current; without it in the model k is 3.5 % off."""
    random = np.random.default_rng(4)
    levels = np.linspace(0.5, 5, 10)
    current = np.repeat(np.concatenate([levels, levels[::-1], -levels, -levels[::-1]]), PER_LEVEL)
    torque = 0.1 * current - 0.01 * np.sign(current) + random.normal(0, 1e-3, len(current))
    fit = fit_constant([find_points(Course(np.arange(len(current)) * 0.1, current, torque))])
    assert abs(fit.constant - 0.1) < 2 * fit.constant_u
    assert fit.constant == pytest.approx(0.1, rel=0.005, abs=0)


def test_a_turning_shaft_has_friction_by_its_speed():
    """A dynamometer: current of both signs at speeds of both signs."""
    random = np.random.default_rng(3)
    levels = random.permutation(np.linspace(-2, 2, 20)), random.permutation([50.0, -80.0] * 10)
    current, speed = (np.repeat(level, PER_LEVEL) for level in levels)
    torque = 0.05 * current - 0.004 * np.sign(speed) - 1e-4 * speed
    torque = 0.3 + torque + random.normal(0, 1e-4, len(current))  # zero of the sensor
    time = np.arange(len(current)) * 0.01
    points = find_points(Course(time, current, torque, speed=speed))
    fit = fit_constant([points])
    assert fit.turning
    assert fit.hysteresis is None
    assert fit.constant == pytest.approx(0.05, rel=0, abs=3 * fit.constant_u)
    assert fit.constant_u < 0.01 * fit.constant
    # the model is a sum of its functions, all that is left is scatter
    i, course = points.current, np.linspace(-1, 1, len(points.current))
    columns = [i, points.speed, np.sign(points.speed), i * np.abs(i), course, course**2, i**0]
    design = np.column_stack(columns)
    left = [
        each - design @ np.linalg.lstsq(design, each, rcond=None)[0]
        for each in (fit.model, fit.measured)
    ]
    assert np.abs(left[0]).max() < 1e-9 < 1e-6 < np.abs(left[1]).max()
    assert fit.model.mean() == pytest.approx(fit.measured.mean(), abs=1e-6)
    assert np.abs(fit.measured).max() < 0.2  # without the zero


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda i, y: (i * 0 + 1, y), "step it, or ramp it"),
        (lambda i, y: (i, -y), "correct a sign"),
        (lambda i, y: (i, np.random.default_rng(1).normal(size=len(y))), "residuals"),
    ],
)
def test_data_that_do_not_carry_it(change, message):
    _, recorded = draw("staircase", 1)
    current, torque = change(recorded.current, recorded.torque)
    with pytest.raises(InsufficientDataError, match=message):
        fit_constant([find_points(Course(recorded.time, current, torque))])


@pytest.mark.parametrize("ripple", [0.0, 0.01])
def test_ramps_with_friction_that_turns_at_once_and_slow_ripple(ripple):
    """The noise of the current does not make its turn late, nor ripple a part of the constant."""
    random, constant, errors = np.random.default_rng(7), 0.05, []
    for _ in range(6):
        current = course("ramp", 3.0)
        torque = constant * current - 0.03 * constant * 3 * np.sign(np.gradient(current))
        torque += ripple * constant * 3 * np.sin(current * random.uniform(0.5, 2) + 1)
        measured = current + random.normal(0, 0.006, len(current))
        fit = fit_constant([find_points(Course(np.arange(len(current)) * 0.02, measured, torque))])
        errors.append((fit.constant - constant) / fit.constant_u)
        assert abs(fit.constant / constant - 1) < 0.008 + 2.5 * ripple
    assert np.max(np.abs(errors)) < 2.5


def test_a_fit_weighs_residuals_and_prior_sizes_by_their_variance():
    """Linear regression with normal priors (A. Gelman et al., Bayesian Data Analysis, 14.8)."""
    random = np.random.default_rng(5)
    count = 400
    x, z = random.standard_normal((2, count))
    torque = 2.0 * x + 0.3 * z + 0.5 * random.standard_normal(count)
    size, prior = 0.02, 0.1
    fit = _Fit([_Column("constant", x), _Column("change", z, prior, size)], torque)
    design, precision = np.column_stack([x, z]), np.diag([0.0, size**-2])
    share = fit.independent / count
    assert 0.7 < share <= 1  # white residuals
    inverse = np.linalg.inv(share / fit.variance * design.T @ design + precision)
    right = share / fit.variance * design.T @ torque + precision @ [0.0, prior]
    np.testing.assert_allclose(fit.found, inverse @ right, rtol=1e-4)
    assert fit.variance == pytest.approx(0.25, rel=0.2)
    assert fit.free == pytest.approx(fit.independent - 1, rel=1e-9)
    left = torque - design @ fit.found
    penalty = ((fit.found[1] - prior) / size) ** 2
    expected = np.mean(left**2) + penalty * fit.variance / fit.independent
    assert fit.misfit == pytest.approx(expected, rel=1e-4)
    value, u = fit.estimate({"constant": 1.0, "change": 3.0})
    assert value == pytest.approx(fit.found @ [1.0, 3.0], rel=1e-9)
    assert u == pytest.approx(np.sqrt([1.0, 3.0] @ inverse @ [1.0, 3.0]), rel=1e-4)
    flat = _Fit([_Column("constant", x), _Column("zero", z)], torque)
    line = np.linalg.lstsq(design, torque, rcond=None)[0]
    np.testing.assert_allclose(flat.found, line, rtol=1e-9)
    variance = np.sum((torque - design @ line) ** 2) / (count - 2)
    u = np.sqrt(variance * np.linalg.inv(design.T @ design)[0, 0])
    u /= np.sqrt(flat.independent / count)
    assert flat.estimate({"constant": 1.0})[1] == pytest.approx(u, rel=0.02)


def test_a_current_goes_one_way_between_turns_beyond_the_band():
    values = np.array([0.0, 1.0, 0.9, 2.0, 3.0, 2.95, 2.0, 2.05, 1.0, 1.5])
    followed = _one_way(values, 0.2)
    np.testing.assert_array_equal(followed, [0, 1, 1, 2, 3, 2.95, 2, 2, 1, 1.5])
    np.testing.assert_array_equal(_one_way(-values, 0.2), -followed)
    points = Points(values, values, None, None, np.diff(followed, prepend=0.0), np.arange(10), True)
    assert points.ways == pytest.approx((3.5, 2.0))


@pytest.mark.parametrize("kind", ["staircase", "ramp"])
def test_units_of_current_and_torque_change_nothing_else(kind):
    _, recorded = draw(kind, 4)
    amperes, unit = 16.0, 2.0**-20
    moved = replace(recorded, current=amperes * recorded.current, torque=unit * recorded.torque)
    one, other = (fit_constant([find_points(each)]) for each in (recorded, moved))
    size = unit / amperes
    for name, factor in (
        ("constant", size),
        ("constant_u", size),
        ("dof", 1.0),
        ("curvature_u", 1.0),
        ("temperature", 1.0),
        ("reference", size),
        ("coefficient", 1.0),
        ("hysteresis", unit),
        ("current", amperes),
        ("measured", unit),
        ("model", unit),
    ):
        a, b = (np.array(getattr(fit, name)) for fit in (one, other))
        within = 1e-6 * factor * np.abs(a).max()  # a search ends with that much left
        np.testing.assert_allclose(b, factor * a, rtol=1e-4, atol=within, err_msg=name)


def test_a_clamped_shaft_that_leaped_once_does_not_turn():
    _, recorded = draw("staircase", 1)
    speed = 1e-4 * np.random.default_rng(1).normal(size=len(recorded.time))
    speed[200:230] = 1.0
    fit, plain = (
        fit_constant([find_points(each)]) for each in (replace(recorded, speed=speed), recorded)
    )
    assert not fit.turning
    assert fit.constant == pytest.approx(plain.constant, rel=1e-9, abs=0)
