"""Ripple that an amplifier off its line seems to have, and what its calibration shows of that."""

import numpy as np
import pytest

from rigtool.experiments.ripple.distortion import (
    Distortion,
    amplifier_distortion,
    distorted_orders,
    distortion_note,
)
from rigtool.experiments.ripple.orders import cell_centres, coefficients
from tests.experiments.ripple.fine import FINE

LEVELS = np.linspace(0, 2, 11)
ANGLE = cell_centres(500)
RIPPLE = 0.1 + 6e-3 * np.cos(ANGLE) + 4e-3 * np.cos(3 * ANGLE + 1)
ORDERS = 6


def test_what_levels_off_their_neighbours_show():
    squares = []
    for seed in range(200):
        phase, period = np.random.default_rng(seed).uniform((0, 0.01), (2 * np.pi, 0.03))
        sine = 3e-3 * np.sin(2 * np.pi * LEVELS / period + phase)
        squares.append((amplifier_distortion(LEVELS, sine, 1e-6).between / 3e-3) ** 2)
    assert np.mean(squares) == pytest.approx(1, abs=0.15)


def test_a_smooth_bend_and_scatter_are_no_course_between_levels():
    assert amplifier_distortion(LEVELS, 5e-3 * (LEVELS - 1) ** 2, 1e-6).between < 3e-4
    noise = 1e-5 * np.random.default_rng(1).standard_normal(LEVELS.size)
    assert amplifier_distortion(LEVELS, noise, 2e-5).between == 0.0


@pytest.mark.parametrize("period", [8e-3, 15e-3, 40e-3])
def test_u_covers_a_sine_of_any_period(period):
    size = 2e-3
    shown = distorted_orders(
        RIPPLE[None], Distortion(LEVELS, np.zeros(LEVELS.size), size), ORDERS, FINE
    )
    phases = np.linspace(0, 2 * np.pi, 60, endpoint=False)[:, None]
    waves = np.concatenate(
        [RIPPLE[None], RIPPLE + size * np.sin(2 * np.pi / period * RIPPLE + phases)]
    )
    found = coefficients(waves, ORDERS, FINE)
    off = np.sqrt(np.mean((np.abs(found[1:]) - np.abs(found[0])) ** 2, axis=0))
    assert (off[[0, 2]] <= shown[[0, 2]]).all()
    assert (shown <= size).all()


def test_u_is_that_of_the_worst_period_over_its_phase():
    """A cosine of amplitude a has order 1 of 2 e J1(2 pi a/period) cos(phase) behind e."""
    size, ripple = 2e-3, 6e-3 * np.cos(ANGLE)
    shown = distorted_orders(
        ripple[None], Distortion(LEVELS, np.zeros(LEVELS.size), size), ORDERS, FINE
    )
    assert shown[0] == pytest.approx(np.sqrt(2) * 0.5819 * size, rel=0.02)  # the highest of J1


def test_set_points_that_scatter_by_a_period_average_it_out():
    still = Distortion(LEVELS, np.zeros(LEVELS.size), 2e-3)
    turns = np.random.default_rng(2).uniform(-0.2, 0.2, (400, 1)) + RIPPLE
    mean = distorted_orders(turns, still, ORDERS, FINE)
    assert (mean < 0.7 * distorted_orders(RIPPLE[None], still, ORDERS, FINE)).all()


def test_a_smooth_bend_is_what_it_does_to_the_amplitude():
    slope = 0.02  # 2 % less current for a change of the set point
    bent = Distortion(LEVELS, slope * LEVELS, 0.0)
    assert distorted_orders(RIPPLE[None], bent, ORDERS, FINE)[[0, 2]] == pytest.approx(
        slope * np.array([6e-3, 4e-3]), rel=1e-3
    )


def test_the_note_names_both_sizes():
    distortion = Distortion(LEVELS, np.zeros(LEVELS.size), 1e-3)
    assert distortion_note(distortion, np.array([0.02, 0.03])) == []
    (note,) = distortion_note(distortion, np.array([0.02, 5e-3]))
    assert "1 mA off" in note
    assert "5 mA rms" in note
