"""The path of an arm that swings after each step, and friction along it."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

from rigtool.experiments.torque_constant.staircases.swings import (
    _behind,
    _torque_changes,
    friction_state,
    longest_lag,
    mean_courses,
    paths,
    without_noise,
)

PARTS = 96


def swinging(size, swings=6.0):
    """Return courses of one staircase whose arm overshoots each step by `size` of it, and would
    swing so many times on a plateau."""
    torque = np.array([[0.0, 1.0, 2.0, 1.0, 0.0]])
    time = (np.arange(PARTS) + 0.5) / PARTS
    swing = size * np.exp(-12 * time) * -np.cos(2 * np.pi * swings * time)
    step = np.diff(torque, axis=1, prepend=0.0)
    course = torque[:, :, None] + step[:, :, None] * swing
    return mean_courses(torque, torque, course, np.ones(torque.shape), np.zeros(1), noise=1e-6)


def test_the_path_leads_from_plateau_to_plateau_by_its_turns():
    courses = swinging(0.8)
    (swings,) = paths(courses, courses.torque, courses.course, [1e-6])
    # exp(-12 t) cos(12 pi t) has this damping ratio and this lag of its velocity
    damping = 12 / np.hypot(12, 12 * np.pi)
    lag = 2 * damping / np.hypot(12, 12 * np.pi)
    assert lag < longest_lag(courses) < 5 * lag
    assert_allclose(np.sum(swings, axis=0)[0, 1:], np.diff(courses.torque[0]), atol=1e-12)
    # The first turn of exp(-12 t) cos(12 pi t) is half a period after the step.
    course = courses.course[0, 1]
    assert_allclose(swings[0, 0, 1], course.max(), rtol=1e-9)
    assert_allclose(swings[0, 0, 1] + swings[1, 0, 1], course[course.argmax() :].min(), rtol=1e-9)


def test_paths_of_several_lags_are_those_of_each():
    courses, lags = swinging(0.8), [1e-6, 0.02, 0.1]
    found = paths(courses, courses.torque, courses.course, lags)
    for path, lag in zip(found, lags, strict=True):
        assert_allclose(path, paths(courses, courses.torque, courses.course, [lag])[0])
    assert np.abs(np.diff(found, axis=0)).max(axis=(1, 2, 3)).min() > 0.01


def test_an_arm_that_turns_once_on_a_plateau_has_swung_half_a_period_since_the_step():
    courses = swinging(0.8, swings=0.9)
    damping = 12 / np.hypot(12, 1.8 * np.pi)
    lag = 2 * damping / np.hypot(12, 1.8 * np.pi)
    assert lag < longest_lag(courses) < 5 * lag


@pytest.mark.parametrize("more", [0, 1])
def test_a_lag_needs_more_than_half_of_the_steps_to_swing(more):
    steps = swinging(0.8).torque.shape[1] - 1
    shown = np.arange(steps + 1) <= steps // 2 + more  # the first plateau has no step
    assert steps % 2 == 0
    assert (longest_lag(swinging(0.8 * shown[:, None])) is not None) == more


def test_an_arm_that_does_not_swing_goes_straight():
    courses = swinging(0.0)
    assert longest_lag(courses) is None
    assert_allclose(
        np.abs(paths(courses, courses.torque, courses.course, [1e-6])[0]).sum(axis=0)[0, 1:],
        1.0,
        rtol=1e-9,
    )


def test_friction_follows_each_swing():
    # Dahl's law along one swing up by x and one down by y has this closed form.
    x, y, s = 1.3, 0.4, 0.7
    swings = np.zeros((2, 1, 2))
    swings[:, 0, 1] = x, -y
    a, b = friction_state(swings, s, 1.0)
    up = 1 - np.exp(-x / s)
    assert_allclose(a[0, 1], -1 + (up + 1) * np.exp(-y / s), rtol=1e-12)
    assert_allclose(b[0, 1], np.exp(-(x + y) / s), rtol=1e-12)


@pytest.mark.parametrize("exponent", [0.6, 1.0, 1.7])
def test_the_law_of_friction_is_that_of_its_exponent(exponent):
    # dz = |1 - z|^i dx/s upwards and -|1 + z|^i |dx|/s downwards, by scipy's integrator
    swings = np.zeros((2, 1, 3))
    swings[:, 0, 1:] = [[0.8, 0.3], [-0.5, -0.6]]

    def along(z: float) -> list[float]:
        reached = [z]
        for j in (1, 2):
            for swing in swings[:, 0, j]:
                side = np.sign(swing)
                solved = solve_ivp(
                    lambda _, z, d=side: d * np.abs(1 - d * z) ** exponent / 0.7,
                    (0, abs(swing)),
                    [z],
                    rtol=1e-10,
                    atol=1e-12,
                )
                z = float(solved.y[0, -1])
            reached.append(z)
        return reached

    a, b = friction_state(swings, 0.7, exponent)
    assert_allclose(a[0], along(0.0), atol=1e-8)
    assert_allclose(b[0], np.subtract(along(1e-4), along(-1e-4)) / 2e-4, atol=1e-5)


def test_noise_of_courses_is_taken_off_and_swings_are_kept():
    rng = np.random.default_rng(4)
    courses = swinging(0.8)
    true = courses.course[0] - courses.torque[0][:, None]
    rows = np.tile(true, (12, 1)) * np.linspace(0.8, 1.2, 60)[:, None]
    found, left = without_noise(rows + 0.01 * rng.standard_normal(rows.shape), 0.01)
    error = np.sqrt(np.mean((found - rows) ** 2))
    assert error < 0.4 * 0.01
    assert_allclose(left, error, rtol=0.5)


@pytest.mark.parametrize("shape", [(40, 40), (20, 40), (60, 15)])
@pytest.mark.parametrize(("part", "kept"), [(0.995, False), (1.005, True)])
def test_what_stands_out_of_noise_is_beyond_the_optimal_hard_threshold(shape, part, kept):
    """Gavish and Donoho 2014: 4/sqrt(3) for square matrices, equation 11 for others."""
    ratio = min(shape) / max(shape)
    limit = np.sqrt(2 * (ratio + 1) + 8 * ratio / (ratio + 1 + np.sqrt(ratio**2 + 14 * ratio + 1)))
    if ratio == 1:
        assert_allclose(limit, 4 / np.sqrt(3))
    rng = np.random.default_rng(2)
    left, right = (np.linalg.qr(rng.standard_normal((n, 1)))[0] for n in shape)
    values = part * limit * np.sqrt(max(shape)) * 0.1 * left @ right.T
    found, noise = without_noise(values, 0.1)
    assert_allclose(found, values if kept else 0.0, atol=1e-12)
    # of the noise, one singular vector either side is left
    expected = 0.1 * np.sqrt(sum(shape) / (shape[0] * shape[1])) if kept else 0.0
    assert_allclose(noise, expected, rtol=1e-9)


def test_behind_a_low_pass_the_torque_of_the_plateau_before_fades():
    torque, lag = np.array([0.5, 2.0, 1.0]), np.array([1.0, 3.0, 20.0])
    found = _behind(np.zeros((3, 12)), torque, lag)
    middle = np.arange(12) + 0.5  # a value is the mean over its part of the time
    before = np.array([0.0, 0.5 - 2.0, 2.0 - 1.0])
    assert_allclose(found, before[:, None] * np.exp(-middle / lag[:, None]), rtol=1e-9)
    swing = np.random.default_rng(1).standard_normal((3, 12))
    at_once = _behind(swing, torque, np.zeros(3))
    assert_allclose(at_once, swing, atol=1e-12)
    # what comes is followed by the same law
    late, keeps = _behind(swing, 0 * torque, lag), np.exp(-1 / lag)[:, None]
    assert_allclose(late[:, 1:], swing[:, 1:] * (1 - keeps) + keeps * late[:, :-1], rtol=1e-9)


@pytest.mark.parametrize("count", [4, 8])
def test_staircases_differ_by_temperature_and_by_ripple_that_bends_them(count):
    rng = np.random.default_rng(2)
    setpoint = np.array([0.0, 1.0, 2.0, 3.0, 2.0, 1.0, 0.0, 0.0])
    degc = 20 + 5.0 * np.arange(count)
    ripple, bend = 1e-3 * rng.standard_normal((2, count))
    constant = 0.05 * (1 - 1e-3 * (degc - degc.mean())) + ripple
    torque = constant[:, None] * setpoint + bend[:, None] * setpoint * np.abs(setpoint)
    score, rate, grown, begins = _torque_changes(setpoint, torque, degc)
    assert_allclose(begins, 0, atol=1e-12)
    assert_allclose(torque.mean(axis=0) + score @ rate, torque, atol=1e-12)
    warm = (degc - degc.mean()) / np.linalg.norm(degc - degc.mean())
    assert_allclose(score[:, 0], warm, rtol=1e-12)
    assert_allclose(warm @ score[:, 1:], 0, atol=1e-15)  # all that goes with it is temperature
    # what each step adds, relative to the mean; a plateau that lasts adds nothing
    steps = np.diff(torque, axis=1)
    moving = np.diff(setpoint) != 0
    relative = (steps / np.where(moving, steps.mean(axis=0), 1.0) - 1)[:, moving]
    assert_allclose(grown.sum(axis=0)[:, 1:][:, moving], relative, rtol=1e-9, atol=1e-12)
    assert_allclose(grown[:, :, 1:][:, :, ~moving], 0)
    assert_allclose(grown[:, :, 0], 0)
    assert_allclose(np.einsum("m,mp->p", warm, grown[1]), 0, atol=1e-12)


RIPPLE = 0.02 * np.tile([1.0, 0.3, -1.0, -0.3], 4)
WARM = np.repeat([20.0, 40.0], 8)


@pytest.mark.parametrize("lag", [0.0, 0.03, 0.2])
def test_swings_follow_the_constant_at_once_and_ripple_with_its_lag(lag):
    """Against the courses of a linear arm whose torque is k i, and k i r behind a low-pass."""
    rng = np.random.default_rng(7)
    setpoint = np.array([0.0, 1.0, 2.0, 3.0, 2.0, 1.0, 0.0])
    time = np.arange(1, PARTS * 8 + 1) / (PARTS * 8)
    answer = late = 1 - np.exp(-12 * time) * np.cos(2 * np.pi * 6 * time)
    if lag:
        kernel = np.exp(-time / lag)
        late = np.convolve(answer, kernel / kernel.sum() * -np.expm1(-1 / lag))[: len(time)]
    step = np.diff(setpoint, prepend=0.0)
    at_once, behind = (np.reshape(each, (PARTS, 8)).mean(axis=1) for each in (answer, late))
    constant = 1 - 1e-3 * (WARM - 30)
    torque = constant[:, None] * (1 + RIPPLE)[:, None] * setpoint

    def of(size, response):
        before = size[:, None] * (setpoint - step)
        return before[:, :, None] + (size[:, None] * step)[:, :, None] * response

    course = of(constant, at_once) + of(constant * RIPPLE, behind)
    noisy = course + 0.02 * rng.standard_normal(course.shape)
    found = mean_courses(
        np.tile(setpoint, (16, 1)), torque, noisy, np.ones(torque.shape), WARM, noise=0.02
    )
    own_torque, own_course, without_lag = found.of_each()
    assert_allclose(own_torque, torque, atol=1e-9)
    swift = (without_lag - of(constant * (1 + RIPPLE), at_once))[:, 1:]
    assert np.sqrt(np.mean(swift**2)) < 0.02 / 4
    error = (own_course - course)[:, 1:]
    assert np.sqrt(np.mean(error**2)) < 0.02 / 4  # the mean has the noise of 16, or less
    response = np.tensordot(RIPPLE, error, 1) / np.sum(RIPPLE**2)
    assert np.abs(response).max() < 0.12


def test_swings_by_the_torque_with_which_a_staircase_begins_are_no_lag_of_ripple():
    """That torque, and the friction before the first step, may be in phase with the ripple."""
    rng = np.random.default_rng(9)
    setpoint = np.array([0.0, 1.0, 2.0, 3.0, 2.0, 1.0, 0.0])
    time = np.arange(1, PARTS + 1) / PARTS
    swing = -np.exp(-12 * time) * np.cos(2 * np.pi * 6 * time)
    begins = RIPPLE + 0.01 * rng.standard_normal(16)
    begins -= begins.mean()
    torque = (1 + RIPPLE)[:, None] * setpoint
    step = np.diff(torque, axis=1, prepend=torque[:, :1])[:, :, None]
    course = begins[:, None, None] + torque[:, :, None] + step * swing
    rubbed = np.exp(-8 * time) * np.cos(2 * np.pi * 6 * time)
    course[:, 1:3] += begins[:, None, None] * rubbed
    every = np.tile(setpoint, (16, 1)), begins[:, None] + torque
    noisy = course + 1e-4 * rng.standard_normal(course.shape)
    found = mean_courses(*every, noisy, np.ones(torque.shape), np.full(16, 20.0), noise=1e-4)
    own_torque, own_course, without_lag = found.of_each()
    swings = course - (begins[:, None] + torque)[:, :, None]
    assert_allclose(own_course - own_torque[:, :, None], swings, atol=1e-3)
    assert_allclose(without_lag, own_course, atol=1e-3)


def test_what_else_goes_with_the_temperature_is_no_lag_of_ripple():
    """Friction changes swings with the constant, by more than these grow."""
    setpoint = np.array([0.0, 1.0, 2.0, 3.0, 2.0, 1.0, 0.0])
    time = np.arange(1, PARTS + 1) / PARTS
    swing = -np.exp(-12 * time) * np.cos(2 * np.pi * 6 * time)
    rubbed = 0.2 * np.exp(-8 * time) * np.sin(2 * np.pi * 6 * time)
    constant = 1 - 1e-3 * (WARM - 30)
    torque = constant[:, None] * setpoint
    step = np.diff(torque, axis=1, prepend=0.0)[:, :, None]
    course = torque[:, :, None] + step * (swing + (constant[:, None, None] - 1) * rubbed)
    found = mean_courses(
        np.tile(setpoint, (16, 1)), torque, course, np.ones(torque.shape), WARM, noise=1e-7
    )
    _, own_course, without_lag = found.of_each()
    assert_allclose(own_course, course, atol=1e-4)
    assert_allclose(without_lag, own_course, atol=1e-5)


def test_what_is_taken_off_the_mean_course_as_noise_is_kept():
    rng = np.random.default_rng(8)
    one = swinging(0.8)
    course = one.course + 0.05 * rng.standard_normal((8, *one.course.shape[1:]))
    every = [np.tile(values, (8, 1)) for values in (one.setpoint, one.torque, one.part * PARTS)]
    found = mean_courses(*every[:2], course, every[2], np.zeros(8), noise=0.05)
    assert_allclose(np.std(found.dropped), 0.05 / np.sqrt(8), rtol=0.3)
    # of noise in the mean of eight, one way to swing keeps its part
    assert_allclose(found.noise, 0.05 / np.sqrt(8) * np.sqrt((5 + PARTS) / (5 * PARTS)), rtol=1e-9)
    assert_allclose((found.course + found.dropped)[0], course.mean(axis=0), atol=1e-12)


def test_few_staircases_swing_as_their_torque_is_large():
    one, factor = swinging(0.8), np.array([0.97, 1.0, 1.03])
    torque = one.torque * factor[:, None]
    course = one.course * factor[:, None, None]
    setpoint = np.tile(one.setpoint, (3, 1))
    warm = np.array([20.0, 30.0, 40.0])
    found = mean_courses(setpoint, torque, course, np.ones(torque.shape), warm, noise=1e-9)
    for mean, own in zip((torque, course, course), found.of_each(), strict=True):
        assert_allclose(own, mean, rtol=0, atol=1e-6)
