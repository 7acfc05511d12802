"""What the way of reading brings to a reading of force, against signals whose parts are known."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from rigtool.errors import InsufficientDataError
from rigtool.experiments.between_set_points import UnsampledCurrent
from rigtool.experiments.force.cycles import find_cycles, readings
from rigtool.experiments.force.procedure import strokes
from rigtool.experiments.force.results_method import (
    lacking_torque,
    require_no_turning_back,
    resolution_u,
    unsteady_torque,
    ways,
)
from rigtool.numerics.lowpass import lowpass
from rigtool.recipe import load_recipe
from tests.experiments.virtual_runs import RECIPE

RATE = 500.0
FRICTION, INERTIA, LOAD = 3e-3, 4e-4, 14e-3


def stroked(rev_per_s, modelled, apparent=INERTIA, friction=FRICTION):
    """Return the uncertainty of readings at a speed, and by how much they are off, N m.

    `modelled` is the inertia that is fed forward, `apparent` that which the torque shows.
    """
    recipe = load_recipe(RECIPE, (f"measure_force.speed_rev_per_s={rev_per_s}",))[0]
    ratio = recipe.rig.angle_ratio
    motion = strokes(recipe, 4)
    time = (np.arange(round(motion.duration * RATE)) + 0.5) / RATE
    angle, speed, acceleration = (values / ratio for values in motion.setpoint(time))
    fed = modelled * acceleration
    wanted = 2 * math.pi * rev_per_s
    torque = LOAD + friction * speed / wanted + apparent * acceleration - fed
    cutoff = recipe.measure_force.lowpass_hz
    angle, torque, fed = (lowpass(RATE, values, cutoff) for values in (angle, torque, fed))
    cycles = find_cycles(angle)
    u = unsteady_torque(angle, torque, fed, rate=RATE, cycles=cycles, recipe=recipe)
    place = math.radians(recipe.measure_force.measure_angle)
    read = readings(angle, torque, cycles, place).mean()
    return u, abs(read - LOAD - friction)


@pytest.mark.parametrize("modelled", [0.0, INERTIA, 0.5 * INERTIA])
@pytest.mark.parametrize("rev_per_s", [0.2, 1.0, 1.5])
def test_it_is_what_the_ends_of_the_stroke_bring_and_hardly_more(rev_per_s, modelled):
    u, off = stroked(rev_per_s, modelled)
    assert off <= u + 1e-3 * FRICTION
    # Both of its parts are taken by magnitude, though they may work against each other.
    alone = stroked(rev_per_s, modelled, modelled)[1]
    inertia = stroked(rev_per_s, modelled, friction=0.0)[1]
    assert u == pytest.approx(alone + inertia, rel=0.02, abs=2e-3 * FRICTION)


@pytest.mark.parametrize(
    ("factor", "reason"), [(0.5, "ends of the stroke"), (2, "sticks and leaps")]
)
def test_a_speed_that_is_off_has_its_own_reason(factor, reason):
    """Ends of a stroke lower the speed; only a leap raises it."""
    recipe = load_recipe(RECIPE, ("measure_force.speed_rev_per_s=0.2",))[0]
    motion = strokes(recipe, 4)
    time = (np.arange(round(motion.duration * RATE)) + 0.5) / RATE
    angle = motion.setpoint(time)[0] / recipe.rig.angle_ratio
    middle = math.radians(recipe.measure_force.measure_angle)
    leaping = angle + (factor - 1) * 0.1 * np.tanh((angle - middle) / 0.1)
    with pytest.raises(InsufficientDataError, match=reason):
        unsteady_torque(
            leaping, angle, 0 * angle, rate=RATE, cycles=find_cycles(angle), recipe=recipe
        )


@pytest.mark.parametrize("sign", [1, -1])
def test_the_way_back_is_against_the_set_point(sign):
    """Three counts on and one back, while the set point moves; its turn does not count."""
    setpoint = sign * np.concatenate([np.arange(0, 9.0), [8.05, 8.06]])
    encoder = sign * np.array([0, 3, 2, 5, 4, 7, 6, 9, 8, 1, 0.0])
    np.testing.assert_array_equal(ways(encoder, setpoint, 0.9), [12, 4])


def test_a_rotor_that_turns_back_gives_no_reading():
    require_no_turning_back(np.array([99.1, 0.9]), 400)
    with pytest.raises(InsufficientDataError, match=r"turns back .* 1.1 % .* \(400 a turn\)"):
        require_no_turning_back(np.array([98.9, 1.1]), 400)


@pytest.mark.parametrize("every", [1, 8])
def test_steps_of_the_current_are_a_rectangle_at_the_output(every):
    """As wide as the step, which the means of several samples show in parts (GUM F.2.2.1); the
    first 8192 samples show it."""
    sets = ("rig.attachment=instrument", f"measure_force.record_every={every}")
    recipe = load_recipe(RECIPE, sets)[0]
    rng, step = np.random.default_rng(1), 2e-3
    asked = (step * rng.integers(0, 40, (9000, every))).mean(axis=1)
    asked[8192:] += 1e-6 * rng.standard_normal(9000 - 8192)
    recording = SimpleNamespace(size=9000, read=lambda name, first, last: asked[first:last])
    expected = recipe.rig.torque_factor * 0.046 * step / math.sqrt(12)
    assert resolution_u(recording, recipe, 0.046) == pytest.approx(expected, rel=1e-6)
    short = SimpleNamespace(size=400, read=lambda name, first, last: asked[first:last])
    assert resolution_u(short, recipe, 0.046) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize(
    ("part", "noted", "refused"),
    [(0.09, True, False), (0.11, True, True), (0.012, True, False), (0.0045, False, False)],
)
@pytest.mark.parametrize("sign", [1, -1])
def test_what_samples_lack_is_compared_with_the_loads(part, noted, refused, sign, monkeypatch):
    """At the speed of the motor: refused from a tenth of the largest load, and noted from a
    hundredth of the smallest, here half of it."""
    recipe = load_recipe(RECIPE, ("rig.attachment=instrument",))[0]
    rig, settings, asked = recipe.rig, recipe.measure_force, []
    largest = 4.0 * rig.load_arm * math.sin(math.radians(settings.measure_angle))
    current = sign * part * largest / (rig.torque_factor * 0.046)

    def at(speed):
        asked.append(speed)
        return current

    monkeypatch.setattr(UnsampledCurrent, "of", lambda runs: SimpleNamespace(at=at))
    if refused:
        with pytest.raises(InsufficientDataError, match=r"10 % of the largest load"):
            lacking_torque(None, recipe, 0.046, (0.0, 2.0, 4.0))
    else:
        found, notes = lacking_torque(None, recipe, 0.046, (0.0, 2.0, 4.0))
        assert found == pytest.approx(part * largest)
        assert bool(notes) == noted
    assert asked == [pytest.approx(2 * math.pi * settings.speed_rev_per_s * rig.angle_ratio)]
