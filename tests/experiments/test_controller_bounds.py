"""How far a rotor may be off its set point, and when a current is at its limit."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from rigtool.control.position_loop import position_loop
from rigtool.errors import InsufficientDataError
from rigtool.experiments import controller_torque as module
from rigtool.experiments.controller_torque import (
    SMALLER_FORCE,
    UNEXPLAINED_DISTANCE,
    SaturationWatch,
    _part_of_sample,
    _speed_of_noise,
    loop_answer,
    loop_blocks,
    require_tracking,
    require_unlimited,
    smallest_gain,
    usual_current,
)
from rigtool.recipe import load_recipe
from tests.experiments.virtual_runs import RECIPE

OWN = load_recipe(RECIPE)[0]
SAMPLE = OWN.rig.sample_time


def test_the_smallest_gain_is_that_of_the_controller_below_its_crossover():
    """From half a hertz, or from the crossover where that is lower."""
    answer = position_loop(**OWN.rig.loop_design).controller.response
    crossover = OWN.rig.controller.crossover_hz
    fine = np.abs(answer(np.geomspace(min(0.5, crossover), crossover, 4001)))
    assert smallest_gain(OWN) == pytest.approx(fine.min(), rel=1e-3)


@pytest.mark.parametrize(("integrator", "turn"), [(4.0, 0.25), (0.0, 0.0)])
def test_a_loop_answers_with_its_gain_ahead_by_its_lead_and_late_by_its_integrator(
    integrator, turn
):
    recipe = load_recipe(RECIPE, [f"rig.controller.integrator_hz={integrator}"])[0]
    controller = recipe.rig.controller
    answer = loop_answer(recipe)
    assert (answer.gain, answer.turn) == (smallest_gain(recipe), turn)
    zero, pole = (2 * math.pi * controller.crossover_hz * controller.lead_ratio**k for k in (-1, 1))
    # the slope of the lead's phase at low frequencies
    slow = 1e-3 * zero
    phase = math.atan(slow / zero) - math.atan(slow / pole)
    assert answer.lead == pytest.approx(phase / slow, rel=1e-5)


@pytest.mark.parametrize(("times", "refused"), [(0.99, False), (1.01, True)])
@pytest.mark.parametrize("controlled", [0.0, 0.4])
def test_a_rotor_is_off_by_what_the_controllers_torque_explains(times, refused, controlled):
    allowed = UNEXPLAINED_DISTANCE + OWN.rig.torque_constant * controlled / smallest_gain(OWN)
    given = {
        "largest_controller": controlled,
        "distance": times * allowed,
    }
    if not refused:
        require_tracking(OWN, **given)
        return
    with pytest.raises(InsufficientDataError, match=f"more than the {allowed:.3g} rad"):
        require_tracking(OWN, **given)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_current_is_at_the_limit_from_a_thousandth_below_it(sign):
    limit = OWN.rig.current_limit
    require_unlimited(0.998 * limit, OWN, "less")
    for usual, text in ((0.26, "less, or raise"), (0.24, "the loop shakes")):
        with pytest.raises(InsufficientDataError, match=text):
            require_unlimited(0.9995 * limit, OWN, "less", usual * limit)
    assert usual_current(sign * np.repeat([1.0, 2.0, -3.0, 4.0], 50)) == pytest.approx(2.5)
    assert usual_current(np.empty(0)) == 0
    assert usual_current(np.array([sign * 3.0])) == pytest.approx(3.0)


LIMIT = OWN.rig.current_limit
EVEN = 1e-3 * np.arange(1000)
LOOP = "time", "current_setpoint", "feedforward_current"


@pytest.mark.parametrize(
    ("total", "modelled", "text"),
    [
        (np.where(EVEN < 0.8, 0.4 * LIMIT, LIMIT), 0.0, "move slower, or raise rig.current_limit"),
        (LIMIT * np.sign(np.sin(2 * np.pi * 80 * EVEN)), 0.0, "the loop shakes"),
        (np.where(np.abs(EVEN - 0.5) < 5e-3, LIMIT, 0.1), 0.8 * LIMIT, "or raise"),
        (np.where(np.abs(EVEN - 0.5) < 5e-3, LIMIT, 0.1), 0.1 * LIMIT, "the loop shakes"),
    ],
)
def test_what_takes_the_current_is_told_from_a_loop_that_shakes(total, modelled, text):
    """A load that stays, a loop at 80 Hz, a short turn that feed-forward asks for, and a peak that
    nothing does; to and fro, whatever the direction, in blocks as in one."""
    whole = np.concatenate([total, -total]), np.full(2000, modelled)
    time = 1e-3 * np.arange(2000)
    watch = SaturationWatch(OWN, SMALLER_FORCE)
    watch.add(time, *whole)
    with pytest.raises(InsufficientDataError, match=text):
        watch.require()
    first = {name: part[:500] for name, part in zip(LOOP, (time, *whole), strict=True)}
    parts = SaturationWatch(OWN, SMALLER_FORCE)
    if np.abs(total[:500]).max() < LIMIT:
        parts.block(first)
        first = {name: part[500:] for name, part in zip(LOOP, (time, *whole), strict=True)}
    with pytest.raises(InsufficientDataError, match=text):
        parts.block(first)


def test_a_current_below_the_limit_is_no_reason_to_stop():
    watch = SaturationWatch(OWN, SMALLER_FORCE)
    watch.add(EVEN[:0], EVEN[:0], EVEN[:0])
    watch.add(EVEN, np.full(1000, 0.998 * LIMIT), EVEN)
    watch.require()


@pytest.mark.parametrize(("every", "part"), [(1, 1.0), (4, 0.25)])
def test_a_sample_of_the_loop_is_a_part_of_a_recorded_one(every, part):
    time = 2.0 + every * SAMPLE * np.arange(50)
    assert _part_of_sample(time, OWN) == pytest.approx(part)
    assert _part_of_sample(2.0 + SAMPLE / 3 * np.arange(50), OWN) == 1.0
    assert _part_of_sample(time[:1], OWN) == 1.0
    assert _part_of_sample(time[:0], OWN) == 1.0


def test_signals_are_checked_over_all_blocks(monkeypatch):
    """Largest currents, and the distance less the way of the set point in a sample of the loop."""
    given, rng = {}, np.random.default_rng(1)
    monkeypatch.setattr(module, "require_tracking", lambda recipe, **own: given.update(own))
    every, blocks = 4, []
    for number in range(3):
        time = number + every * SAMPLE * np.arange(40)
        total, modelled, learned = rng.standard_normal((3, 40))
        setpoint = np.cumsum(rng.uniform(-0.1, 0.1, 40))
        encoder = setpoint / (2 * math.pi) * OWN.rig.encoder_counts + rng.integers(-90, 90, 40)
        blocks.append((time, total, modelled, learned, setpoint, encoder))
    recording = SimpleNamespace(blocks=lambda *names: iter(blocks), has=lambda name: False)
    found = list(loop_blocks(recording, OWN))
    assert len(found) == 3
    far, controlled = 0.0, 0.0
    for own, (_, total, modelled, learned, setpoint, encoder) in zip(found, blocks, strict=True):
        np.testing.assert_allclose(own.controller, total - modelled - learned)
        rotor = encoder / OWN.rig.encoder_counts * 2 * math.pi
        np.testing.assert_allclose(own.rotor, rotor)
        controlled = max(controlled, np.abs(own.controller).max())
        for k in range(40):
            way = abs(setpoint[k] - setpoint[k - 1]) if k else 0.0
            far = max(far, abs(setpoint[k] - rotor[k]) - way / every)
    assert given["largest_controller"] == pytest.approx(controlled)
    assert given["distance"] == pytest.approx(far)


def test_noise_of_the_encoder_is_a_speed_by_the_answer_of_the_loop():
    """White noise of step^2/12 up to half the rate: the rms of 2 pi f |T(f)|, by integration."""
    answer = position_loop(**OWN.rig.loop_design).complementary_sensitivity.response
    frequency = np.linspace(0, 0.5 / SAMPLE, 40_001)[1:]
    swing = (2 * np.pi * frequency * np.abs(answer(frequency))) ** 2
    expected = math.sqrt(np.trapezoid(swing, frequency) / (0.5 / SAMPLE) / 12)
    assert _speed_of_noise(**OWN.rig.loop_design) == pytest.approx(expected, rel=0.05)
