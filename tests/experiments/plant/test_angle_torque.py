"""Torque by the shaft's angle is taken off the input, and nothing else is."""

from dataclasses import replace

import numpy as np
import pytest

from rigtool.control.plant_models import PlantModel
from rigtool.experiments.plant.angle_torque import without_angle_torque
from rigtool.experiments.plant.fit import PlantFit
from rigtool.experiments.plant.frequency_response import Experiment

SAMPLE_TIME, PERIODS, SAMPLES = 1e-3, 4, 500
COUNT = PERIODS * SAMPLES
LINES = np.array([3, 5, 8, 13, 21, 34, 55])
FIT = PlantFit(
    PlantModel(2e-5, 1e-4), 1e-4, 1e-8, 0.0, SAMPLE_TIME, np.ones(7, dtype=bool), 1.0, 1.0
)
TIME = SAMPLE_TIME * np.arange(COUNT)


def low(values):
    """Return the spectrum up to the last line."""
    return np.fft.rfft(np.ravel(values))[1 : PERIODS * LINES[-1] + 1]


def experiment(turns, seed, by_angle, noise=1e-6, beside=0.0):
    """Return a shaft that turns evenly while it swings at the lines, and by `beside` rad at others,
    and its input without and with the torque that depends on its angle."""
    rng = np.random.default_rng(seed)
    others = np.setdiff1d(np.arange(1, PERIODS * LINES[-1]), PERIODS * LINES) / PERIODS
    number = np.append(LINES, others)
    frequency = number / (SAMPLES * SAMPLE_TIME)
    size = np.repeat([0.05, beside], [len(LINES), len(others)]) * LINES[0] / number
    swing = size * np.exp(2j * np.pi * rng.random(len(number)))
    waves = np.exp(2j * np.pi * np.outer(TIME, frequency))
    output = (waves @ swing).real
    plain = (waves @ (swing / FIT.response(frequency))).real + noise * rng.standard_normal(COUNT)
    rate = 2 * np.pi * turns / (COUNT * SAMPLE_TIME)
    angle = 0.4 + rate * TIME + output
    speed = rate + (waves @ (swing * 2j * np.pi * frequency)).real
    whole = plain + by_angle(angle, speed)
    shape = (PERIODS, SAMPLES)
    parts = (signal.reshape(shape) for signal in (plain, whole, output, angle))
    plain, whole, output, angle = parts
    return plain, Experiment(plain[0], whole, output, angle)


def by_angle(angle, speed):
    """Ripple at once, friction by the sign of the speed, and friction that grows with it."""
    return (
        2e-3 * np.cos(angle)
        - 1e-3 * np.sin(12 * angle)
        + 0.5e-3 * np.sign(np.mean(speed)) * np.sin(2 * angle)
        + 4e-5 * speed * np.cos(3 * angle)
    )


@pytest.mark.parametrize(
    ("turns", "beside"), [((5, -9), 0.0), ((-6, -12), 0.0), ((7, 16), 0.0), ((5, -9), 1e-3)]
)
def test_what_the_angle_adds_is_taken_off(turns, beside):
    made = [
        experiment(n, seed, by_angle, beside=beside) for seed, n in enumerate((*turns, -turns[0]))
    ]
    found = without_angle_torque([own for _, own in made], LINES, FIT)
    for (plain, own), after in zip(made, found, strict=True):
        added = np.abs(low(own.input - plain))
        left = np.abs(low(after.input - plain))
        assert np.sqrt(np.mean(left**2)) < 0.01 * np.sqrt(np.mean(added**2))
        assert after.output is own.output


@pytest.mark.parametrize("turned", [1.0, -37.0])
def test_it_does_not_matter_how_far_the_shaft_has_turned_before(turned):
    own = [experiment(n, seed, by_angle)[1] for seed, n in enumerate((5, -9))]
    moved = [replace(one, angle=one.angle + 2 * np.pi * turned) for one in own]
    first, then = (without_angle_torque(each, LINES, FIT) for each in (own, moved))
    for one, before, after in zip(own, first, then, strict=True):
        assert before is not one
        np.testing.assert_allclose(after.input, before.input, rtol=0, atol=1e-12)


def test_speeds_that_are_alike_do_not_separate_it():
    own = [experiment(n, seed, by_angle)[1] for seed, n in enumerate((8, -8))]
    assert list(map(id, without_angle_torque(own, LINES, FIT))) == list(map(id, own))


def test_an_input_without_it_stays_as_it_is():
    none = np.zeros_like
    made = [experiment(n, seed, lambda a, _: none(a), 1e-4) for seed, n in enumerate((5, -9, 12))]
    for (plain, _), after in zip(
        made, without_angle_torque([own for _, own in made], LINES, FIT), strict=True
    ):
        # of 850 values of noise, what 72 terms explain by chance, or less
        change, noise = np.abs(low(after.input - plain)), 1e-4 * np.sqrt(COUNT)
        assert np.mean(change**2) < 72 / 850 * noise**2


@pytest.mark.parametrize("turns", [(5, -5), (5, 6), (5.3, 9), (5, 0)])
def test_it_needs_whole_turns_at_different_speeds(turns):
    given = [experiment(n, 1, by_angle)[1] for n in turns]
    found = without_angle_torque(given, LINES, FIT)
    assert all(after is before for after, before in zip(found, given, strict=True))


def test_it_needs_experiments_of_one_length():
    _, own = experiment(5, 1, by_angle)
    _, other = experiment(9, 1, by_angle)
    short = Experiment(other.reference, *(s[:2] for s in (other.input, other.output, other.angle)))
    assert without_angle_torque([own, short], LINES, FIT) == [own, short]
