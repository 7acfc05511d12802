"""One step of the filter beside matrices, differences and a truncated normal of scipy."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import truncnorm

from rigtool.experiments.force_filter import kalman, passed, smoother
from rigtool.experiments.force_filter.linear import ROW_LENGTH, forwards
from rigtool.experiments.force_filter.plant import (
    ANGLE,
    BRISTLE,
    COSINE,
    FACTOR_COUNT,
    GRASPER,
    GRASPER_SPEED,
    HOUSING,
    LOAD,
    NOISE,
    SINE,
    SPEED,
    STATES,
    TIP,
    TORQUE,
    advance,
    as_record,
)
from tests.experiments.force_filter.plants import PLANT, UNCERTAINTY

SAMPLES, JOINT = 8, passed.JOINT_STATES
SPAN = SAMPLES * PLANT.sample_time
LOW_PASS = passed.section(10.0, SPAN)
DRIVE = np.linspace(10e-3, 12e-3, SAMPLES)[None]
DRAG = np.full((1, SAMPLES), 5e-5)
U = replace(UNCERTAINTY, undecided=1e-9)
SIZES = np.ones(JOINT)
SIZES[[ANGLE, SPEED, BRISTLE, HOUSING]] = 1e-3, 0.05, 0.05, 0.03
SIZES[[GRASPER, GRASPER_SPEED, TIP]] = 1e-3, 0.05, 0.04
SIZES[[SINE, COSINE, LOAD, NOISE, TORQUE]] = 3e-4, 2e-4, 0.02, 1e-4, 3e-3
SIZES[STATES:] = 2e-3


def moved(joint):
    """Return states and q (14,) after a step, by the plant's equations."""
    x, q = joint[:STATES].copy(), joint[STATES:]
    after = LOW_PASS[:2, :2] @ q + LOW_PASS[:2, 2] * x[TORQUE]
    for torque, drag in zip(DRIVE[0], DRAG[0], strict=True):
        advance(x, as_record(PLANT)[0], PLANT.friction_map, torque, drag, None, 0, 0.0, 0.0)
    x[NOISE] *= np.exp(-SPAN / U.friction_noise_time)
    return np.concatenate([x, after])


def started(seed):
    """Return mean (14,) and covariance (14, 14) of a rotor that slides."""
    rng = np.random.default_rng(seed)
    mean = SIZES * rng.normal(0, 0.3, JOINT)
    mean[[ANGLE, SPEED, BRISTLE, HOUSING]] = 1.234, 0.4, 0.7, 0.8
    mean[[GRASPER, GRASPER_SPEED, TIP]] = 1.234 / PLANT.angle_ratio - 0.05, 0.5, 0.6
    mean[TORQUE] = 0.02
    root = rng.normal(size=(JOINT, JOINT)) / np.sqrt(JOINT) * SIZES[:, None]
    return mean, root @ root.T


def step(mean, covariance, width, low, least=0.0, uncertainty=U, idle=False, begun=None):
    """Return mean, covariance, and outputs of the filter after one step, of a state that begins
    with other values."""
    state = kalman.begin(PLANT, uncertainty, low, width, LOW_PASS)
    state["mean"][0], state["passed"][0] = mean[:STATES], mean[STATES:]
    state["covariance"][0, :, :JOINT] = covariance
    for name, value in (begun or {}).items():
        state[name] = value
    means, outputs = np.empty((1, STATES)), np.empty((1, kalman.OUTPUTS))
    kalman.run(
        state,
        as_record(PLANT),
        as_record(uncertainty),
        PLANT.friction_map,
        DRIVE,
        DRAG,
        np.array([low]),
        width,
        np.array([idle]),
        LOW_PASS,
        np.array([least]),
        means,
        outputs,
        smoother.room(0, SAMPLES),
    )
    found = np.concatenate([state["mean"][0], state["passed"][0]])
    return found, state["covariance"][0, :, :JOINT], outputs[0]


def predicted(mean, covariance, walk):
    """Return f(x) and Phi P Phi' + Q."""
    steps = 1e-4 * SIZES
    columns = [(moved(mean + own) - moved(mean - own)) / (2 * own.max()) for own in np.diag(steps)]
    slope = np.stack(columns, axis=1)
    kept = np.exp(-SPAN / U.friction_noise_time)
    noise = np.zeros(JOINT)
    for states, rate in (
        ([ANGLE], U.angle_rate),
        ([SPEED, GRASPER_SPEED], U.speed_rate),
        ([GRASPER], U.grasper_rate),
        ([BRISTLE], U.bristle_rate),
        ([HOUSING, TIP], U.slip_rate),
        ([TORQUE], walk),
    ):
        noise[states] = rate**2 * SPAN
    noise[NOISE] = U.friction_noise**2 * (1 - kept**2)
    return moved(mean), slope @ covariance @ slope.T + np.diag(noise)


def assert_covariance(found, expected, part):
    """Compare covariances, each number relative to both standard deviations."""
    sizes = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(found / sizes, expected / sizes, rtol=0, atol=part)


RATES = {0.0: U.torque_rate, 1.0: U.slow_torque_rate, 2.0: U.step_torque_rate}


@pytest.mark.parametrize("least", RATES)
@pytest.mark.parametrize("seed", [1, 2])
def test_a_step_without_a_count_is_that_of_the_equations(seed, least):
    mean, covariance = started(seed)
    found, spread, outputs = step(mean, covariance, 1e6, -5e5, least)
    expected, whole = predicted(mean, covariance, RATES[least])
    np.testing.assert_allclose(found / SIZES, expected / SIZES, rtol=0, atol=1e-6)
    assert_covariance(spread, whole, 2e-4)
    # random walks are small beside what was there: they show by themselves
    quiet = step(mean, 1e-12 * covariance, 1e6, -5e5, least)[1]
    noise = predicted(mean, 0 * covariance, RATES[least])[1]
    np.testing.assert_allclose(np.diag(quiet), np.diag(noise), rtol=1e-2, atol=1e-12)
    row = LOW_PASS[2, :2] @ np.eye(JOINT)[STATES:]
    row[TORQUE] = LOW_PASS[2, 2]
    assert outputs[0] == pytest.approx(row @ expected, rel=1e-6)
    assert outputs[1] == pytest.approx(np.sqrt(row @ whole @ row), rel=1e-4)


@pytest.mark.parametrize("side", [-0.7, 0.1, 1.2])
def test_a_count_truncates_the_angle_and_moves_the_rest_with_it(side):
    mean, covariance = started(3)
    before, whole = predicted(mean, covariance, U.torque_rate)
    width = 1.5 * np.sqrt(whole[ANGLE, ANGLE])
    low = before[ANGLE] + side * width - width / 2
    found, spread, outputs = step(mean, covariance, width, low)
    deviation = np.sqrt(whole[ANGLE, ANGLE] + (U.edge * width) ** 2)
    ends = (np.array([low, low + width]) - before[ANGLE]) / deviation
    inside = truncnorm(*ends, loc=0, scale=deviation)
    gain = whole[ANGLE] / deviation**2
    expected = before + gain * inside.mean()
    size = np.sqrt(np.diag(whole))
    np.testing.assert_allclose(found / size, expected / size, rtol=0, atol=1e-3)
    less = whole - np.outer(gain, gain) * (deviation**2 - inside.var())
    assert_covariance(spread, less, 1e-3)
    share = 1 - inside.var() / deviation**2
    np.testing.assert_allclose(
        outputs[kalman.FIRST_GAIN :], share * gain[list(kalman.FOLLOWED)], rtol=5e-3, atol=1e-6
    )


def test_a_stroke_begins_where_the_long_bristle_has_turned():
    mean, covariance = started(4)
    mean[[SPEED, HOUSING]] = -0.4, -0.6  # the filter begins in the direction of motion
    found, spread, _ = step(mean, covariance, 1e6, -5e5)
    for state, size in ((SINE, U.stroke), (COSINE, U.stroke), (LOAD, U.load_stroke)):
        assert found[state] == 0
        only = np.eye(JOINT)[state] * size**2
        np.testing.assert_allclose(spread[state], only, rtol=1e-9)
        np.testing.assert_allclose(spread[:, state], only, rtol=1e-9)


@pytest.mark.parametrize("side", [-0.6, 0.3])
@pytest.mark.parametrize("earlier", [-0.4, 0.0, 0.6])
@pytest.mark.parametrize("repeats", [0.0, 1.0])
def test_a_count_again_shows_what_it_adds(side, earlier, repeats):
    """What the last step learned from the same count is known already, but for another sign."""
    mean, covariance = started(3)
    before, whole = predicted(mean, covariance, U.torque_rate)
    width = 1.5 * np.sqrt(whole[ANGLE, ANGLE])
    low = before[ANGLE] + side * width - width / 2
    angle, own = low + (0.5 + earlier) * width, 0.7 * np.sqrt(whole[ANGLE, ANGLE])
    found, _, outputs = step(
        mean,
        covariance,
        width,
        low,
        uncertainty=replace(U, repeats=repeats),
        begun={"low": low, "angle": angle, "variance": own**2},
    )

    def inside(place, deviation):
        ends = (np.array([low, low + width]) - place) / deviation
        return truncnorm(*ends, loc=0, scale=deviation)

    deviation = np.sqrt(whole[ANGLE, ANGLE] + (U.edge * width) ** 2)
    now, last = inside(before[ANGLE], deviation), inside(angle, own)
    shift, left = now.mean(), now.var() / deviation**2
    if not repeats:
        fresh = shift - last.mean()
        shift = fresh if np.sign(fresh) == np.sign(shift) else 0.0
        left = min(left / (last.var() / own**2), 1.0)
    gain = whole[ANGLE] / deviation**2
    size = np.sqrt(np.diag(whole))
    np.testing.assert_allclose(found / size, (before + gain * shift) / size, rtol=0, atol=1e-3)
    np.testing.assert_allclose(
        outputs[kalman.FIRST_GAIN :],
        (1 - left) * gain[list(kalman.FOLLOWED)],
        rtol=5e-3,
        atol=1e-5,
    )


SUMS = (
    ("step", kalman.SHORT, kalman.STEP_THRESHOLD, 2),
    ("slow", kalman.LONG, kalman.SLOW_THRESHOLD, 1),
)


@pytest.mark.parametrize(("name", "memory", "threshold", "level"), SUMS)
@pytest.mark.parametrize("times", [0.99, 1.01, -0.99, -1.01])
def test_corrections_that_add_up_raise_the_noise_of_the_torque(
    name, memory, threshold, level, times
):
    """A leaky sum of corrections, in standard deviations, over time."""
    mean, covariance = started(3)
    before, whole = predicted(mean, covariance, U.torque_rate)
    width = 1.5 * np.sqrt(whole[ANGLE, ANGLE])
    low = before[ANGLE] - 0.2 * width
    deviation = np.sqrt(whole[ANGLE, ANGLE] + (U.edge * width) ** 2)
    ends = (np.array([low, low + width]) - before[ANGLE]) / deviation
    added = truncnorm(*ends).mean() * SPAN
    sums = {f"{name}_sum": (times * threshold - added) / np.exp(-SPAN / memory)}
    _, _, outputs = step(mean, covariance, width, low, begun={"low": low, **sums})
    assert outputs[2] == (level if abs(times) > 1 else 0)


@pytest.mark.parametrize(("moved", "idle", "level"), [(1, True, 1), (0, True, 0), (1, False, 0)])
def test_a_count_that_passes_without_current_is_a_slow_change(moved, idle, level):
    mean, covariance = started(3)
    width = 1e6
    begun = {"low": -5e5 - moved * width}
    _, _, outputs = step(mean, covariance, width, -5e5, idle=idle, begun=begun)
    assert outputs[2] == level


@pytest.mark.parametrize(
    ("name", "level", "rate"), [("step", 2, U.step_torque_rate), ("slow", 1, U.slow_torque_rate)]
)
def test_a_change_lasts_for_its_time(name, level, rate):
    """The noise of a step is that of the level at its beginning."""
    mean, covariance = started(1)
    for left, after in ((1.0, 0), (2.0, level)):
        begun = {f"{name}_left": left}
        _, spread, outputs = step(mean, 1e-12 * covariance, 1e6, -5e5, begun=begun)
        assert outputs[2] == after
        assert spread[TORQUE, TORQUE] == pytest.approx(rate**2 * SPAN, rel=1e-3)


@pytest.mark.parametrize("slow", [SPEED, GRASPER_SPEED])
def test_the_direction_of_a_slow_shaft_is_as_uncertain_as_its_speed(slow):
    """Within half of the deviation of either speed before the step; as matrices."""
    mean, covariance = started(2)
    mean[[SPEED, GRASPER_SPEED]] = 0.4, 0.5
    mean[slow] = 1e-3
    spreads = 0.5 * np.sqrt(np.diag(covariance)[[SPEED, GRASPER_SPEED]])
    _, found, _ = step(mean, covariance, 1e6, -5e5, uncertainty=replace(U, undecided=0.5))
    noise = predicted(mean, 0 * covariance, U.torque_rate)[1][:STATES, :STATES]

    def after(spread, outer):
        x, factors = mean[:STATES].copy(), np.zeros((SAMPLES, FACTOR_COUNT))
        rows = np.eye(STATES, ROW_LENGTH).ravel()
        for k, (torque, drag) in enumerate(zip(DRIVE[0], DRAG[0], strict=True)):
            given = torque, drag, factors, k, spread, outer
            advance(x, as_record(PLANT)[0], PLANT.friction_map, *given)
            forwards(rows, STATES, factors, k)
        slope = rows.reshape(STATES, ROW_LENGTH)[:, :STATES]
        slope[NOISE] *= np.exp(-SPAN / U.friction_noise_time)
        return slope @ covariance[:STATES, :STATES] @ slope.T + noise

    assert_covariance(found[:STATES, :STATES], after(*spreads), 1e-9)
    assert np.abs(after(*(2 * spreads)) / after(*spreads) - 1).max() > 1e-6


def run(state, lows, width, steps):
    """Filter steps of a state, which changes; return their means."""
    count = len(lows)
    means, outputs = np.empty((count, STATES)), np.empty((count, kalman.OUTPUTS))
    given = np.repeat(DRIVE, count, 0), np.repeat(DRAG, count, 0), np.array(lows), width
    quiet = np.zeros(count, dtype=bool), LOW_PASS, np.zeros(count)
    records = as_record(PLANT), as_record(U), PLANT.friction_map
    kalman.run(state, *records, *given, *quiet, means, outputs, steps)
    return means


@pytest.mark.parametrize("busy", [0.0, 0.6, 1.0])
@pytest.mark.parametrize("left", [0.0, 200.0])
def test_a_torque_that_has_changed_for_long_is_expected_to_change_for_long(busy, left):
    """A change goes on by the part of the time, of 0.5 s, in which there was one. Rounding does not
    add a step to a time of whole steps, 0.6 s at most."""
    state = kalman.begin(PLANT, U, -5e5, 1e6, LOW_PASS)
    state["busy"], state["slow_left"], state["slow_sum"] = busy, left, 1.0
    run(state, [-5e5], 1e6, smoother.room(0, SAMPLES))
    part = 1 + (busy - 1) * np.exp(-SPAN / 0.5) if left else busy * np.exp(-SPAN / 0.5)
    assert state["busy"][0] == pytest.approx(part, rel=1e-9)
    lasting = U.busy_time / (1 - min(part, 0.9))
    assert state["slow_left"][0] == max(left - 1, np.ceil(lasting / SPAN - 1e-3))


def test_each_step_keeps_what_the_smoother_needs():
    """Of two steps, a stroke begins with the first; each beside the filter before and after it."""
    mean, covariance = started(3)
    before, whole = predicted(mean, covariance, U.torque_rate)
    width = 1.5 * np.sqrt(whole[ANGLE, ANGLE])
    lows = before[ANGLE] + np.array([-0.4, 0.8]) * width
    kept = smoother.room(2, SAMPLES)
    for part in kept:
        part[:] = np.nan
    state = kalman.begin(PLANT, U, lows[0], width, LOW_PASS)
    state["mean"][0], state["passed"][0] = mean[:STATES], mean[STATES:]
    state["covariance"][0, :, :JOINT] = covariance
    state["direction"] = -1.0
    together = run(state.copy(), lows, width, kept)
    derivative, fresh, correction, weight, variance, gains, torque_row, passed_row = kept
    assert derivative.shape == (2 * SAMPLES, FACTOR_COUNT)
    assert fresh.tolist() == [1.0, 0.0]
    row = np.zeros(JOINT)
    row[STATES:], row[TORQUE] = LOW_PASS[2, :2], LOW_PASS[2, 2]
    for k, low in enumerate(lows):
        ahead, far = state.copy(), smoother.room(1, SAMPLES)
        (x,) = run(ahead, [-5e5], 1e6, far)  # a count that shows nothing: the prediction alone
        p = ahead["covariance"][0, :, :JOINT]
        (own,) = run(state, [low], width, smoother.room(0, SAMPLES))
        after, square = state["covariance"][0, :, :JOINT], variance[k]
        np.testing.assert_allclose(together[k], own, rtol=1e-12)
        np.testing.assert_allclose(derivative[k * SAMPLES : (k + 1) * SAMPLES], far[0], rtol=1e-12)
        assert square == pytest.approx(p[ANGLE, ANGLE] + (U.edge * width) ** 2, rel=1e-6)
        np.testing.assert_allclose(gains[k], p[ANGLE, :STATES] / square, rtol=1e-6)
        assert correction[k] * p[ANGLE, ANGLE] == pytest.approx((own - x)[ANGLE], rel=1e-6)
        less = 1 - after[ANGLE, ANGLE] / p[ANGLE, ANGLE]
        assert weight[k] == pytest.approx(less * square / p[ANGLE, ANGLE], rel=1e-6)
        np.testing.assert_allclose(torque_row[k], after[TORQUE, :STATES], rtol=1e-9)
        np.testing.assert_allclose(passed_row[k], (row @ after)[:STATES], rtol=1e-9, atol=1e-18)
