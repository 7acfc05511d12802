"""The recording that is unlike all others, by residuals written out; how often one is by chance."""

from dataclasses import replace

import numpy as np
import pytest

from rigtool.experiments.imported_load.learning import learn_load_model
from rigtool.experiments.imported_load.odd_recording import FALSE_ALARMS, limit, ratios
from rigtool.experiments.imported_load.side import Sums
from tests.experiments.imported_load.loaded_drive import observations


def test_ratios_are_those_of_residuals_without_the_recording():
    random = np.random.default_rng(4)
    columns, effort, weight = random.normal(size=(60, 3)), random.normal(size=60), np.ones(60)
    recording, centre = np.arange(60) % 5, random.normal(size=3)
    sums = Sums.of(columns, effort, weight, recording, 0.01 * np.eye(3), centre)
    for number, found in enumerate(ratios(sums, 6)[:5]):
        others = np.setdiff1d(np.arange(5), [number])
        residual = effort - columns @ sums.solve(others)
        squares = np.array([np.mean(residual[recording == n] ** 2) for n in range(5)])
        assert found == pytest.approx(np.sqrt(3 * squares[number] / squares[others].sum()))
    assert ratios(sums, 6)[5] == 0  # no rows


def test_one_in_a_hundred_sets_has_an_odd_recording_by_chance():
    random, count, draws = np.random.default_rng(5), 8, 2000
    one, numbers = np.ones((count, 1)), np.arange(count)
    odd = 0
    for effort in random.normal(size=(draws, count)):
        sums = Sums.of(one, effort, one[:, 0], numbers, 1e-9 * np.eye(1), np.zeros(1))
        odd += ratios(sums, count).max() > limit(count)
    assert 0.5 * FALSE_ALARMS < odd / draws < 2.5 * FALSE_ALARMS


SPOILED = {
    "as recorded": lambda one: one,
    "sign of the current": lambda one: replace(one, effort=-one.effort),
    "sign of the sensor": lambda one: replace(one, reference=-one.reference),
    "mA": lambda one: replace(one, effort=1e3 * one.effort),
    "load": lambda one: replace(one, reference=1.5 * one.reference),
}


@pytest.mark.parametrize("kind", SPOILED)
def test_a_recording_with_a_wrong_sign_or_unit_is_odd(kind):
    signals = observations(frequencies=(0.2, 0.3))
    signals[4] = SPOILED[kind](signals[4])
    odd = learn_load_model(signals).odd
    assert (odd.max() > limit(len(signals))) == (kind != "as recorded")
    assert kind == "as recorded" or odd.argmax() == 4
