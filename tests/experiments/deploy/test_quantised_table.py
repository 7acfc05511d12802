"""Codes of drives: what they stand for, and that the loss stated is the loss there is."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from rigtool.experiments.deploy.position_map import TURN, PositionMap, position_map
from rigtool.experiments.deploy.quantised_table import (
    held_values,
    interpolated_codes,
    quantise,
)
from tests.control.test_lookup_table import points, table
from tests.experiments.deploy.periodic_tables import turning


@given(
    values=arrays(np.float64, st.integers(1, 50), elements=st.floats(-1e3, 1e3)),
    largest=st.sampled_from([1, 127, 32767]),
)
def test_codes_are_in_range_and_off_by_half_a_step(values, largest):
    found = quantise(values, largest)
    assert np.abs(found.codes).max() <= largest
    # The scale is rounded to 4 bytes, so that the largest value may be cut by as much.
    slack = 2**-23 * np.abs(values).max() + 1e-40
    assert np.abs(found.values - values).max() <= found.scale / 2 + slack


def test_nothing_is_all_zeros():
    found = quantise(np.zeros(4), 127)
    assert found.scale == 0
    assert not found.codes.any()


@pytest.mark.parametrize("keep", [slice(None), slice(3, None), slice(0, 3)])
def test_nodes_written_out_are_the_table(keep):
    """Linear between nodes, by numpy: the same as the table's own interpolation."""
    learned = table()
    learned = table(speed=learned.speed[keep], torque=learned.torque[keep])
    at = learned.nodes
    rows = at.rows(learned.torque)
    position, speed = points(500)
    across = np.stack([np.interp(position, learned.position, row) for row in rows])
    expected = [np.interp(v, at.speed, column) for v, column in zip(speed, across.T, strict=True)]
    np.testing.assert_allclose(learned.evaluate(position, speed), expected, rtol=1e-9, atol=1e-15)


def moteus_current(codes, scale, turns):
    """What the drive adds: scale*code, linear between codes at i/1024 of a turn."""
    place = np.mod(turns, 1.0) * 1024
    left = np.floor(place).astype(int) % 1024
    part = place - np.floor(place)
    return scale * (codes[left] * (1 - part) + codes[(left + 1) % 1024] * part)


def test_the_loss_is_what_the_drive_is_off_by():
    turn = position_map(*turning(), 2.0)
    found = interpolated_codes(turn, 1024, 127)
    at = np.random.default_rng(2).uniform(0, 1, 20_000)
    off = moteus_current(found.stored.codes, found.stored.scale, at) - turn.at(at * TURN)
    assert np.abs(off).max() <= found.loss.largest * 1.001
    assert np.abs(off).max() > 0.9 * found.loss.largest
    assert np.sqrt(np.mean(off**2)) == pytest.approx(found.loss.rms, rel=0.02, abs=0)
    assert np.abs(found.stored.codes).max() == 127


def test_samples_sit_at_the_codes_not_between_them():
    """Sampled in the middle of bins, order 84 would be off by a quarter."""
    angle = np.arange(4096) * TURN / 4096
    turn = PositionMap(0.0, np.cos(84 * angle), np.zeros(4096), 0.0, 1.0, True)
    found = interpolated_codes(turn, 1024, 127)
    at = np.arange(1024) / 1024
    used = moteus_current(found.stored.codes, found.stored.scale, at)
    order = np.fft.rfft(used)[84] * 2 / 1024
    assert abs(order - 1) < 0.01


def test_held_values_are_those_of_the_middle():
    turn = position_map(*turning(), 2.0)
    values, lost = held_values(turn, 3600)
    at = np.random.default_rng(3).uniform(0, 1, 50_000)
    off = values[np.floor(at * 3600).astype(int)] - turn.at(at * TURN)
    assert np.abs(off).max() == pytest.approx(lost.largest, rel=0.1, abs=0)
    assert np.sqrt(np.mean(off**2)) == pytest.approx(lost.rms, rel=0.02, abs=0)
    # No delay: held from the beginning of a cell it would be half a cell, 7*pi/3600 of phase.
    orders = np.fft.rfft(np.repeat(values.astype(float), 4))[7]
    there = np.fft.rfft(turn.at((np.arange(14400) + 0.5) * TURN / 14400))[7]
    assert np.angle(orders / there) == pytest.approx(0, abs=1e-4)


@given(st.lists(st.floats(-3, 3), min_size=2, max_size=20), st.sampled_from([1e-6, 1e-3]))
def test_scale_is_a_multiple_of_the_step_and_codes_fit(values, step):
    array = np.array(values)
    found = quantise(array, 127, step)
    steps = found.scale / step
    assert steps == pytest.approx(round(steps), abs=1e-2)
    assert np.abs(found.codes).max() <= 127
    # half a code, and the last digits of a 4-byte scale
    assert np.abs(found.values - array).max() <= 0.5 * found.scale + 1e-6
