"""Excitations: speeds that suit the period, and a multisine beside the loop filtered in time."""

import math
from fractions import Fraction

import numpy as np
import pytest
from scipy.signal import lfilter

from rigtool.control.position_loop import position_loop
from rigtool.errors import RecipeError
from rigtool.experiments.plant.procedure_excitation import (
    RUN_UP,
    Excitation,
    excitations,
    excited_lines,
    multisine,
    period_samples,
    tasks,
)
from rigtool.recipe import load_recipe
from tests.experiments.virtual_runs import RECIPE


def recipe(*overrides, attachment="pulley"):
    sets = [f"identify_plant.{setting}" for setting in overrides]
    return load_recipe(RECIPE, (f"rig.attachment={attachment}", *sets))[0]


@pytest.mark.parametrize("periods", [2, 3, 5, 6, 8, 12, 16])
@pytest.mark.parametrize("wished", [0.2, 3.0, 10.0, 25.3, 27.9])
def test_a_speed_is_the_closest_whose_periods_begin_at_equal_spaces(periods, wished):
    own = recipe(f"periods={periods}", f"speeds=[{wished}]", "realisations=1")
    (found,) = excitations(own)
    duration = periods * 0.25
    turns = found.speed * duration / (2 * math.pi)
    assert turns == pytest.approx(round(turns), rel=1e-9)
    begins = {Fraction(round(turns) * n, periods) % 1 for n in range(periods)}
    assert len(begins) == periods  # equally spaced: no two alike
    asked = wished * duration / (2 * math.pi)
    for other in range(max(1, math.floor(asked) - periods), math.ceil(asked) + periods + 1):
        if len({Fraction(other * n, periods) % 1 for n in range(periods)}) == periods:
            assert abs(turns - asked) <= abs(other - asked) + 1e-9


def test_each_speed_has_sets_of_phases_of_its_own():
    found = excitations(recipe("speeds=[10, 15]", "realisations=3"))
    assert [each.number for each in found] == [0, 1, 2, 3, 4, 5]
    assert found[0].speed == found[2].speed < found[3].speed
    own = recipe()
    signals = [multisine(own, Excitation(10.0, n), number) for n in (0, 1) for number in (0, 1)]
    alike = np.corrcoef(signals) - np.eye(4)
    assert np.abs(alike).max() < 0.7


def test_strokes_of_each_direction_and_pair_of_cycles_have_phases_of_their_own():
    own = recipe(attachment="instrument")
    found = [task for plan in excitations(own) for task in tasks(own, plan)]
    strokes = np.stack([task.feedforward.signal.reshape(4, -1) for task in found])
    assert {task.motion.cycles for task in found} == {2}
    assert strokes.shape[2] == round(found[0].motion.stroke_time / own.rig.sample_time)
    np.testing.assert_array_equal(strokes[:, 2:], -strokes[:, :2])
    alike = np.corrcoef(strokes[:, :2].reshape(-1, strokes.shape[2])) - np.eye(2 * len(found))
    assert np.abs(alike).max() < 0.8


@pytest.mark.parametrize("share", [0.5, 1e-3])
def test_a_multisine_swings_the_speed_at_all_lines_alike_within_its_limits(share):
    """Torque into the loop in time, until the transient has gone: the shaft's speed, and what the
    controller asks for on top."""
    own = recipe(f"current_share={share}")
    rig, settings, speed = own.rig, own.identify_plant, 10.0
    torque, count = multisine(own, Excitation(speed, 1)), period_samples(own)
    loop = position_loop(**rig.loop_design)

    def through(system):
        pad = len(system.den) - len(system.num)
        return lfilter(np.pad(system.num, (pad, 0)), system.den, np.tile(torque, 8))[-count:]

    assert count * rig.sample_time == pytest.approx(0.25)
    spectrum = np.fft.rfft(through(loop.process_sensitivity)) * 2 / count
    lines = excited_lines(own)
    frequency = np.fft.rfftfreq(count, rig.sample_time)
    assert frequency[lines[0]] == 4.0
    assert frequency[lines[-1]] == pytest.approx(250.0, abs=2.0)
    amplitude = np.abs(spectrum * 2 * np.pi * frequency)
    np.testing.assert_allclose(amplitude[lines], amplitude[lines].mean(), rtol=1e-3)
    assert np.delete(amplitude, lines)[1:].max() < 1e-3 * amplitude[lines].mean()
    swing = np.abs(np.fft.irfft(spectrum * 2j * np.pi * frequency, count) * count / 2).max()
    asked = np.abs(through(loop.sensitivity)).max()
    limits = settings.swing * speed, share * rig.current_limit * rig.torque_constant
    assert swing <= limits[0] * (1 + 1e-3)
    assert asked <= limits[1] * (1 + 1e-3)
    assert max(swing / limits[0], asked / limits[1]) == pytest.approx(1, rel=1e-3)
    assert (share < 0.1) == (asked / limits[1] > swing / limits[0])


def test_both_directions_turn_for_all_periods():
    own = recipe()
    forward, backward = tasks(own, Excitation(10.0, 0))
    settings = own.identify_plant
    steady = settings.settle_time + settings.periods * 0.25
    for task, sign in ((forward, 1.0), (backward, -1.0)):
        profile = task.motion
        np.testing.assert_allclose(
            profile.times, np.cumsum([0.0, RUN_UP, steady, RUN_UP]), rtol=1e-12
        )
        assert profile.speeds == (0.0, 10.0 * sign, 10.0 * sign, 0.0)


@pytest.mark.parametrize(("wished", "settle"), [(2.0, 0.2), (3.0, 0.2), (3.0, 0.05), (4.4, 0.1)])
def test_a_stroke_lasts_whole_periods_and_holds_them_all(wished, settle):
    speeds, settling = f"stroke_speeds=[{wished}]", f"settle_time={settle}"
    own = recipe(speeds, settling, "realisations=1", attachment="instrument")
    (found,) = excitations(own)
    pairs = list(tasks(own, found))
    motion, settings = pairs[0].motion, own.identify_plant
    periods = motion.stroke_time / 0.25
    assert periods == pytest.approx(round(periods), rel=1e-9)
    span = math.radians(settings.angle) * own.rig.angle_ratio
    turn = math.radians(settings.turn_angle) * own.rig.angle_ratio
    assert motion.high - motion.low == pytest.approx(span)
    # from a rest to the speed takes twice the time of constant speed
    lasts = (span - 2 * turn) / found.speed + 4 * turn / found.speed
    assert motion.stroke_time == pytest.approx(lasts)
    asked = ((span - 2 * turn) + 4 * turn) / wished / 0.25
    assert round(periods) == round(asked)
    straight = (span - 2 * turn) / found.speed - settings.settle_time
    each = math.floor(straight / 0.25)
    assert motion.cycles == 2
    cycles = 2 * len(pairs)
    assert each * cycles >= settings.periods > each * (cycles - 2)
    signal, count = pairs[0].feedforward.signal, period_samples(own)
    assert len(signal) == 4 * round(periods) * count  # a cycle, and one the other way
    np.testing.assert_array_equal(signal[: len(signal) // 2], -signal[len(signal) // 2 :])
    np.testing.assert_array_equal(signal[:count], signal[count : 2 * count])


def test_what_does_not_fit_is_refused():
    with pytest.raises(RecipeError, match="must lie below half the sampling rate, 4000 Hz"):
        excited_lines(recipe("frequency_max=4000"))
    assert excited_lines(recipe("frequency_max=3990"))[-1] < 1000
    with pytest.raises(RecipeError, match="lower the speed, or the period"):
        excitations(recipe("stroke_speeds=[30]", attachment="instrument"))


def test_a_band_of_few_lines_is_refused_before_the_rig_moves():
    assert len(excited_lines(recipe("frequency_max=32"))) == 8
    with pytest.raises(RecipeError, match=r"hold 7 lines of a period of 0\.25 s, 8"):
        excited_lines(recipe("frequency_max=28"))
