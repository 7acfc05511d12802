"""The disturbance of a load by closed forms: lagging ripple, friction, a tendon that stretches."""

from dataclasses import replace

import numpy as np
import pytest

from rigtool.experiments.force_model.learning import LearnedModel
from rigtool.experiments.force_model.model import Kind, Shape, Term
from rigtool.experiments.force_model.sliding_problem import SLIDING_PARAMETERS, stepped_shape
from rigtool.experiments.load_disturbance.sliding import disturbance, grid_of
from tests.experiments.load_disturbance.known_drive import CONSTANT, KNOWN

ANGLE = np.linspace(0.3, 2.9, 12)
LOAD = np.array([-0.04, 0.0, 0.03, 0.06])
SHAPE = Shape(1e-3, 1e-2, 1e-2, 0.5, 0.02, 0.25, 1e-3, 1e-9, 1e-7, 2e-3)
TERMS = (
    Term(Kind.GAIN_RIPPLE, 1.0, 3, 1),
    Term(Kind.HOUSING, 1.0, 2, 0),
    Term(Kind.LOAD_FRICTION, 1.0),
    Term(Kind.STRIBECK, 1.0),
)
ELSEWHERE = [SLIDING_PARAMETERS.index(name) for name in ("ripple_time", "tip_friction")]
"""Not by differences: the first moves the points of the path; the second is not followed."""


def model_of(coefficient, shape=SHAPE):
    count = len(SLIDING_PARAMETERS) + len(TERMS)
    root = np.random.default_rng(3).normal(0, 1e-2, (count, count))
    return LearnedModel(TERMS, shape, KNOWN, np.array(coefficient), root @ root.T, np.ones(2))


@pytest.mark.parametrize("speed", [-8.0, -0.4, 0.4, 3.0, 30.0])
def test_ripple_that_grows_with_the_torque_lags_behind_the_angle(speed):
    """g T sin(3 b) behind a lag t: g T Im exp(3ib) / (1 + 3i v t), to first order in g."""
    gain = 1e-3
    found, by = disturbance(model_of([gain, 0, 0, 0]), ANGLE, LOAD, speed, CONSTANT)
    late = 3j * speed * SHAPE.ripple_time
    wave = np.exp(3j * KNOWN.angle_ratio * ANGLE) / (1 + late)
    np.testing.assert_allclose(found, gain * np.outer(wave.imag, LOAD), atol=0.02 * gain * 0.06)
    by_time = by[SLIDING_PARAMETERS.index("ripple_time")]
    wave *= -late / (1 + late)
    np.testing.assert_allclose(by_time, gain * np.outer(wave.imag, LOAD), atol=0.02 * gain * 0.06)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_friction_grows_with_the_load_and_is_that_of_the_angle_the_tendon_leaves(side):
    found, _ = disturbance(model_of([0, 5e-3, 0.1, 4e-3]), ANGLE, LOAD, side * 2.0, CONSTANT)
    onset = SHAPE.load_onset
    grown = 0.1 * (np.sqrt(LOAD**2 + onset**2) - onset)
    output = ANGLE[:, None] - LOAD / SHAPE.stiffness
    moved = KNOWN.torque_factor * 5e-3 * (np.cos(2 * output) - np.cos(2 * ANGLE[:, None]))
    np.testing.assert_allclose(found, side * (grown + moved), atol=0.02 * 5e-3)
    # what is alike with and without a load is no disturbance of it
    np.testing.assert_allclose(found[:, LOAD == 0], 0, atol=1e-9)


def test_without_a_load_the_joints_own_friction_hangs_on_the_tendon():
    shape = replace(SHAPE, tip_friction=0.03)
    found, _ = disturbance(model_of([0, 5e-3, 0.1, 0], shape), ANGLE, LOAD, 2.0, CONSTANT)
    np.testing.assert_allclose(found[:, LOAD == 0.03], 0, atol=1e-12)
    found, _ = disturbance(model_of([0, 5e-3, 0.1, 0], shape), ANGLE, -LOAD, -2.0, CONSTANT)
    np.testing.assert_allclose(found[:, LOAD == 0.03], 0, atol=1e-12)


def test_derivatives_are_those_of_differences():
    model = model_of([1e-3, 5e-3, 0.1, 4e-3])
    _, by = disturbance(model, ANGLE, LOAD, 2.0, CONSTANT)

    def moved(number, step):
        if number < len(SLIDING_PARAMETERS):
            shape = stepped_shape(SHAPE, step * np.eye(len(SLIDING_PARAMETERS))[number])
            other = replace(model, shape=shape)
        else:
            change = step * np.eye(len(TERMS))[number - len(SLIDING_PARAMETERS)]
            other = replace(model, coefficient=model.coefficient + change)
        return disturbance(other, ANGLE, LOAD, 2.0, CONSTANT)[0]

    for number, own in enumerate(by):
        if number in ELSEWHERE:
            continue
        difference = (moved(number, 1e-3) - moved(number, -1e-3)) / 2e-3
        np.testing.assert_allclose(own, difference, rtol=0.02, atol=3e-3 * np.abs(own).max() + 1e-9)


def test_a_grid_holds_both_directions_and_half_of_what_they_differ_by():
    model, speeds = model_of([1e-3, 5e-3, 0.1, 4e-3]), [3.0, 0.5]
    grid = grid_of(model, speeds, ANGLE, LOAD, CONSTANT)
    assert grid.signed.tolist() == [-3.0, -0.5, 0.5, 3.0]
    ways = {speed: disturbance(model, ANGLE, LOAD, speed, CONSTANT) for speed in grid.signed}
    root = np.linalg.cholesky(model.covariance)

    def u_of(by):
        return np.linalg.norm(np.tensordot(root.T, by, 1), axis=0)

    for row, speed in enumerate(grid.signed):
        value, by = ways[speed]
        np.testing.assert_allclose(grid.torque[row], value, rtol=1e-12)
        np.testing.assert_allclose(grid.u[row], u_of(by), rtol=1e-6, atol=1e-12)
    for row, speed in enumerate(sorted(speeds)):
        (up, up_by), (down, down_by) = ways[speed], ways[-speed]
        np.testing.assert_allclose(grid.friction[row], (up - down) / 2, rtol=1e-12)
        np.testing.assert_allclose(
            grid.friction_u[row], u_of(up_by - down_by) / 2, rtol=1e-6, atol=1e-12
        )
