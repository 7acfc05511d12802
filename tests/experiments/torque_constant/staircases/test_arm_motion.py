"""The arm's motion after each step of a staircase."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

from rigtool.experiments.torque_constant.staircases.arm_motion import Arm, Contacts, arm_of
from rigtool.experiments.torque_constant.staircases.swings import mean_courses

PARTS, TIME = 96, 0.4
LEVELS = np.array([0.0, 1.0, 2.0, 3.0, 4.0, 3.0, 2.0, 1.0, 0.0])
"""Torques at rest of a staircase, in steps of 10 mN m."""

ARM = Arm(frequency=55.0, lag=0.011, steps=8)
CONTACTS = Contacts(6e-3, np.array([[0.0, 0.4, 0.7, 0.8, 0.9, 0.3, -0.2, -0.5, -0.7]]), 0.02, 1.0)


def staircase(rng=None, noise=0.0, arm=ARM):
    """Return courses whose swings are those of an arm, with noise."""
    torque = 0.01 * LEVELS[None]
    bare = mean_courses(
        LEVELS[None],
        torque,
        np.repeat(torque[:, :, None], PARTS, axis=2),
        np.full(torque.shape, TIME),
        np.zeros(1),
        noise=1e-9,
    )
    swings = arm.swings(bare, CONTACTS)
    if rng is not None:
        swings = swings + noise * rng.standard_normal(swings.shape)
    return replace(bare, course=torque[:, :, None] + swings, dropped=np.zeros(swings.shape))


@pytest.mark.parametrize(("exponent", "asymmetry"), [(0.7, 0.0), (1.0, -0.2), (1.6, 0.2)])
def test_what_is_kept_of_friction_before_is_its_derivative(exponent, asymmetry):
    """By differences, where friction is too small to change the motion."""
    weak = replace(CONTACTS, level=1e-9, exponent=exponent, asymmetry=asymmetry)

    def after(z):
        moved = replace(weak, state=np.where(np.arange(len(LEVELS)) > 0, weak.state, z))
        a, b = ARM.friction_state(staircase(), moved)
        before = z * (1 + asymmetry * z)
        return before, a[0] + b[0] * before, b[0]

    (high, above, _), (low, below, _), (_, _, kept) = after(0.3001), after(0.2999), after(0.3)
    assert_allclose(kept, (above - below) / (high - low), atol=1e-4)
    assert 0.05 < kept[1] < 0.9


def test_friction_of_many_hypotheses_is_that_of_each():
    """Brittle contacts slide here: little is kept of what was before, yet never nothing."""
    exponent = np.array([[0.5], [0.7], [1.0], [1.6], [2.0]])
    transition = np.array([[0.004], [0.02], [0.004], [0.02], [0.1]])
    state = np.linspace(0.2, 1, 5)[:, None, None] * CONTACTS.state
    many = Contacts(np.full((5, 1), 6e-3), state, transition, exponent, asymmetry=0.1)
    found = np.stack(ARM.friction_state(staircase(), many))
    alone = [
        ARM.friction_state(staircase(), Contacts(6e-3, z, float(s), float(i), 0.1))
        for z, s, i in zip(state, transition[:, 0], exponent[:, 0], strict=True)
    ]
    assert_allclose(found, np.stack(alone, axis=1), atol=1e-12)
    assert 1e-20 < found[1, 0, 0, -1] < 1e-10 < found[1, 4, 0, -1]


@pytest.mark.parametrize(("exponent", "asymmetry"), [(0.7, 0.0), (1.0, -0.2), (1.6, 0.2)])
def test_swings_and_friction_are_those_of_the_equation_of_motion(exponent, asymmetry):
    """By scipy's integrator, plateau by plateau."""
    contacts = replace(CONTACTS, exponent=exponent, asymmetry=asymmetry)
    found = ARM.swings(staircase(), contacts)[0]
    a, b = ARM.friction_state(staircase(), contacts)
    first = contacts.state[0, 0]
    friction = a[0] + b[0] * first * (1 + asymmetry * first)
    held = contacts.state[0] * (1 + asymmetry * contacts.state[0])
    drive = 0.01 * LEVELS + contacts.level * held

    def change(_, at, push):
        x, speed, z = at
        side = 1.0 if speed > 0 else -1.0
        slides = max(1 - side * z, 0.0) ** exponent * abs(speed) / contacts.transition
        force = push - x - contacts.level * z * (1 + asymmetry * z) - ARM.lag * speed
        return [speed, ARM.frequency**2 * force, side * slides]

    at, edges = [0.0, 0.0, contacts.state[0, 0]], np.linspace(0, TIME, PARTS * 8 + 1)
    for j, push in enumerate(drive):
        solved = solve_ivp(change, (0, TIME), at, t_eval=edges, args=(push,), max_step=1e-3)
        torque = solved.y[0] + ARM.lag * solved.y[1]
        course = (torque[1:] + torque[:-1]).reshape(PARTS, 8).mean(axis=1) / 2
        course -= course[PARTS // 2 :].mean()
        assert_allclose(found[j], course, atol=0.02 * 0.01)
        at = solved.y[:, -1]
        assert friction[j] == pytest.approx(at[2] * (1 + asymmetry * at[2]), abs=2e-3)


def test_the_arm_is_found_in_courses_with_noise():
    courses = staircase(np.random.default_rng(3), 1e-4)
    found = arm_of(courses, CONTACTS)
    assert found.frequency == pytest.approx(ARM.frequency, rel=0.01)
    assert found.lag == pytest.approx(ARM.lag, rel=0.03)


def test_an_arm_too_slow_to_turn_on_a_plateau_is_found_where_noise_turns():
    slow = replace(ARM, frequency=12.0, lag=0.03)
    rng = np.random.default_rng(3)
    courses = replace(staircase(rng, 2e-4, slow), noise=np.array([2e-5]))
    found = arm_of(courses, CONTACTS)
    assert found.frequency == pytest.approx(slow.frequency, rel=0.02)
    assert found.lag == pytest.approx(slow.lag, rel=0.05)


def test_an_arm_that_does_not_swing_is_none():
    torque = 0.01 * LEVELS[None]
    still = replace(staircase(), course=np.repeat(torque[:, :, None], PARTS, axis=2))
    assert arm_of(still, CONTACTS) is None


def test_moved_courses_have_what_all_steps_share_and_hardly_any_noise():
    rng, noise = np.random.default_rng(5), 1e-4
    courses = staircase(rng, noise)
    step = np.diff(courses.torque, axis=1, prepend=0.0)[..., None]
    shared = 0.02 * step * np.exp(-np.arange(PARTS) / 10)
    true = staircase().course + shared
    moved = ARM.moved(replace(courses, course=courses.course + shared), CONTACTS)
    assert np.sqrt(np.mean((moved.course - true) ** 2)) < noise / 2
    assert_allclose(moved.course + moved.dropped, courses.course + shared, atol=1e-15)
    assert moved.noise[0] == pytest.approx(noise / len(LEVELS) ** 0.5, rel=0.2)


def test_an_arm_under_several_hypotheses_moves_as_under_each_alone():
    laws = [(6e-3, 0.02, 1.0), (3e-3, 0.05, 0.6), (0.0, 0.02, 1.7)]
    each = [Contacts(f, CONTACTS.state * f / 6e-3, s, i, 0.1) for f, s, i in laws]
    level, transition, exponent = np.array(laws).T[:, :, None]
    state = np.stack([one.state for one in each])
    a, b = ARM.friction_state(staircase(), Contacts(level, state, transition, exponent, 0.1))
    alone = [ARM.friction_state(staircase(), one) for one in each]
    assert_allclose(a, [one[0] for one in alone], rtol=1e-12, atol=1e-15)
    assert_allclose(b, [one[1] for one in alone], rtol=1e-12)
    assert np.abs(np.diff(a, axis=0)).max(axis=(1, 2)).min() > 0.05
