"""Torque at the shaft from the current: it is late by the learned delay."""

import numpy as np
import pytest

from rigtool.experiments.force_model.drive import LARGEST_LEAD, MotorMap

SAMPLE, CONSTANT = 0.5e-3, 0.05


def torque_of(delay, current, lagging=None):
    drive = MotorMap(np.zeros((9, 5)), 0.05, 0.0, delay)
    return drive.torque(np.zeros(len(current)), current, CONSTANT, SAMPLE, lagging)[0]


@pytest.mark.parametrize("delay", [-0.1e-3, 0.0, 0.1e-3, 2e-3])
def test_a_current_that_grows_evenly_shows_the_delay(delay):
    time = np.arange(200) * SAMPLE
    torque = torque_of(delay, 3.0 * time)
    late = time - torque / (3.0 * CONSTANT)
    np.testing.assert_allclose(late[100:], delay, rtol=0, atol=1e-9)


def test_a_lead_is_a_part_of_a_sample_at_most():
    torque = torque_of(-1.0, np.ones(50))
    assert np.abs(torque / CONSTANT - 1).max() <= LARGEST_LEAD / (1 - LARGEST_LEAD) + 1e-12
    assert torque[-1] == pytest.approx(CONSTANT)


def test_blocks_of_any_length_give_the_same():
    current, lagging = np.random.default_rng(1).standard_normal(60), np.zeros(2)
    parts = [torque_of(0.2e-3, block, lagging) for block in np.split(current, [1, 17, 17])]
    np.testing.assert_array_equal(np.concatenate(parts), torque_of(0.2e-3, current))
