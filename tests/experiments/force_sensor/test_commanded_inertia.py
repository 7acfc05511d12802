"""An inertia that was not learned, by the accelerations of a set point."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rigtool.experiments.force_sensor.commanded_inertia import (
    POINTS,
    CommandedTurns,
    commanded_inertia,
)
from tests.experiments.force_sensor.test_unknown_inertia import (
    STEP,
    TIME,
    U,
    drawn,
    strokes,
)

ANGLE, ACCELERATION, SPEED = strokes()
ANGLE -= SPEED * STEP / 2  # where the rotor is at the time of its speed


def turns(torque):
    known, u = np.ones(len(TIME), bool), np.full(len(TIME), U)
    return CommandedTurns.of(STEP, ANGLE, known, torque, u)


def pulses(rng):
    """Forces of 0.1 to 1.5 s, 1 s apart or more, that act in half of all changes of speed."""
    torque, at = np.zeros(len(TIME)), 0.0
    while at < TIME[-1]:
        length = rng.uniform(0.1, 1.5)
        torque[(at < TIME) & (at + length > TIME)] = rng.uniform(2e-3, 40e-3)
        at += length + rng.uniform(1.0, 2.0)
    return torque


@settings(max_examples=10)
@given(seed=st.integers(0, 2**31), inertia=st.floats(20e-6, 60e-6))
def test_an_inertia_is_found_below_pulses(seed, inertia):
    rng = np.random.default_rng(seed)
    found = commanded_inertia([turns(drawn(rng) + pulses(rng) + inertia * ACCELERATION)])
    assert found is not None
    assert found.inertia == pytest.approx(inertia, rel=0.6)
    assert found.torque == pytest.approx(found.inertia * np.abs(ACCELERATION).max(), rel=0.5)


@settings(max_examples=10)
@given(seed=st.integers(0, 2**31), stiffness=st.floats(0, 0.05), friction=st.floats(-5e-3, 5e-3))
def test_pulses_springs_at_either_end_and_friction_are_no_inertia(seed, stiffness, friction):
    rng = np.random.default_rng(seed)
    beyond = np.maximum(ANGLE - 0.8 * ANGLE.max(), 0)
    other = drawn(rng) + pulses(rng) + friction * np.sign(SPEED)
    for spring in (stiffness * beyond, -stiffness * beyond):
        assert commanded_inertia([turns(other + spring)]) is None


@pytest.mark.parametrize("phase", [0.0, 1.0, 2.0, 3.0])
@pytest.mark.parametrize("hertz", [5.0, 7.1, 10.0, 10.2])
def test_a_force_that_swings_the_rotor_is_no_inertia_in_step_with_the_strokes_either(hertz, phase):
    force = 20e-3 * np.sin(2 * np.pi * hertz * TIME + phase)
    own = turns(drawn(np.random.default_rng(3)) + force)
    assert len(own.u) >= 20
    assert commanded_inertia([own]) is None


@pytest.mark.parametrize(
    ("turn", "over_u", "is_found"), [(0.1, 0.6, 0), (0.1, 0.9, 1), (0.3, 1.4, 0)]
)
def test_an_inertia_is_stated_only_by_what_a_line_in_time_does_not_hold(turn, over_u, is_found):
    _, acceleration, speed = strokes(turn)
    torque = over_u * U * acceleration / np.abs(acceleration).max()
    torque += drawn(np.random.default_rng(5)) / 3
    angle, known, u = STEP * np.cumsum(speed), np.ones(len(TIME), bool), np.full(len(TIME), U)
    found = commanded_inertia([CommandedTurns.of(STEP, angle, known, torque, u)])
    assert (found is not None) == is_found


@pytest.mark.parametrize("part", ["few", "unknown", "coarse", "short", "held"])
def test_where_no_turns_are_asked_for_nothing_is_said(part):
    torque, u, known = 40e-6 * ACCELERATION, np.full(len(TIME), U), np.ones(len(TIME), bool)
    span = slice(0, {"few": 900, "short": 70}.get(part, 4000), {"coarse": 4}.get(part, 1))
    if part == "unknown":
        known = np.abs(ACCELERATION) < 1
    setpoint = 0 * ANGLE + 1.0 if part == "held" else ANGLE
    rows = (row[span] for row in (setpoint, known, torque, u))
    own = CommandedTurns.of(STEP * (span.step or 1), *rows)
    assert commanded_inertia([own]) is None
    if part == "few":
        assert commanded_inertia([own, own]) is not None


def test_stretches_of_several_rates_are_taken_together():
    torque, u, known = 40e-6 * ACCELERATION, np.full(len(TIME), U), np.ones(len(TIME), bool)
    rows = ANGLE, known, torque, u
    coarse = CommandedTurns.of(2 * STEP, *(row[:800:2] for row in rows))
    found = commanded_inertia([coarse, CommandedTurns.of(STEP, *(row[800:1600] for row in rows))])
    assert found is not None
    assert found.inertia == pytest.approx(40e-6, rel=0.1)


def alike_turns(own, left):
    """Turns of both signs, ten each, that show the inertias `own` (10,) and besides `left`."""
    motion = np.sin(2 * np.pi * np.linspace(0, 1, POINTS, endpoint=False))
    signs = np.repeat([1.0, -1.0], len(own))
    windows = [
        (s * motion, s * (one * motion + left))
        for s, one in zip(signs, np.tile(own, 2), strict=True)
    ]
    return CommandedTurns(signs, np.full(len(signs), 1e-9), np.array(windows))


@pytest.mark.parametrize(("errors", "is_found"), [(1.5, False), (2.0, True)])
def test_an_inertia_is_stated_from_two_and_a_half_errors_of_both_sides_on(errors, is_found):
    """Each side has `errors` standard errors, both together sqrt(2) of that."""
    scatter = 1 / (1.4826 * np.sqrt(np.pi / 2 / 10) * errors)
    own = 40e-6 * (1 + scatter * np.tile([-1, 1], 5))
    found = commanded_inertia([alike_turns(own, 0.0)])
    assert (found is not None) == is_found


@pytest.mark.parametrize(("part", "is_found"), [(3.0, False), (0.1, True)])
def test_what_repeats_with_the_strokes_is_in_the_error_of_an_inertia(part, is_found):
    """Torque that repeats, of the frequency of the motion, with another phase."""
    left = part * 40e-6 * np.cos(2 * np.pi * np.linspace(0, 1, POINTS, endpoint=False))
    found = commanded_inertia([alike_turns(np.full(10, 40e-6), left)])
    assert (found is not None) == is_found


@pytest.mark.parametrize(
    ("at_ends", "is_found"), [((0.35, 0.75), True), ((0.3, 0.6), False), ((0.2, 1.2), False)]
)
def test_the_torque_of_an_inertia_is_beyond_half_of_u_in_the_mean_of_ends_that_are_alike(
    at_ends, is_found
):
    left = 0.4e-6 * np.cos(2 * np.pi * np.linspace(0, 1, POINTS, endpoint=False))
    first, last = (alike_turns(np.full(10, 40e-6 * end), left) for end in at_ends)
    windows = np.concatenate([first.windows[:10], last.windows[10:]])
    own = CommandedTurns(first.acceleration, np.full(20, 40e-6), windows)
    assert (commanded_inertia([own]) is not None) == is_found
