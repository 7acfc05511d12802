"""What residuals show beside a model: found where it is, and not where it is chance."""

import numpy as np
import pytest
from scipy.signal import lfilter

from rigtool.experiments.friction.model_doubt import (
    RESIDUAL_RANGES,
    RIPPLES_A_STROKE,
    STRIBECK_VELOCITIES,
    TIME_PARTS,
    curvature,
    long_ripple,
    own_part,
    structure,
)

COUNT = 6000
TIME = np.linspace(0, 60, COUNT)
PLACES = np.sin(0.7 * 2 * np.pi * TIME) + 0.6 * np.sin(0.31 * 2 * np.pi * TIME + 1)
PARTS = np.arange(COUNT) * TIME_PARTS // COUNT
DESIGN = np.column_stack([PLACES, np.ones(COUNT)])


def left(values):
    """Return what a line over position leaves of values."""
    return values - DESIGN @ np.linalg.lstsq(DESIGN, values, rcond=None)[0]


def coloured(random, memory):
    white = random.normal(size=COUNT + 2000)
    return lfilter([np.sqrt(1 - memory**2)], [1, -memory], white)[2000:]


def test_own_part_is_what_a_correlation_leaves():
    random = np.random.default_rng(0)
    a, b = random.normal(size=(2, COUNT))
    design = np.column_stack([a + 2 * b, a, np.ones(COUNT)])
    r = np.corrcoef(design[:, 0] - design[:, 0].mean(), design[:, 1])[0, 1]
    centred = design[:, [0, 1]] - design[:, [0, 1]].mean(axis=0)
    assert own_part(centred, 0) == pytest.approx(1 - r**2, rel=1e-9)


@pytest.mark.parametrize("memory", [0.0, 0.9, 0.99])
@pytest.mark.parametrize("part", [0.2, 0.5, 0.9])
def test_a_function_of_position_is_found_in_coloured_noise(memory, part):
    random = np.random.default_rng(int(100 * memory) + 1)
    shape = left(np.sin(5 * PLACES))
    shape *= np.sqrt(part) / shape.std()
    found = [
        structure(PLACES, left(shape + np.sqrt(1 - part) * coloured(random, memory)), DESIGN, PARTS)
        for _ in range(20)
    ]
    assert np.mean([share for share, _ in found]) == pytest.approx(part, abs=0.05)


@pytest.mark.parametrize("memory", [0.0, 0.9, 0.99])
def test_noise_is_not_taken_for_a_function(memory):
    random = np.random.default_rng(2)
    found = [structure(PLACES, left(coloured(random, memory)), DESIGN, PARTS)[0] for _ in range(20)]
    assert np.mean(found) < 0.05


def test_what_was_passed_once_may_be_a_function():
    """One slow pass: noise that keeps for long and a function of position look the same."""
    residual = np.sin(np.linspace(0, 20, COUNT))
    share, _ = structure(TIME, residual, np.ones((COUNT, 1)), PARTS)
    assert share > 0.9


def test_a_single_sample_in_each_range_shows_no_chance():
    residual = np.random.default_rng(6).normal(size=RESIDUAL_RANGES)
    once = np.zeros(RESIDUAL_RANGES, dtype=np.intp)
    share, _ = structure(np.arange(RESIDUAL_RANGES), residual, np.ones((RESIDUAL_RANGES, 1)), once)
    assert share == pytest.approx(1.0, rel=1e-12)


def test_without_a_residual_nothing_is_in_doubt():
    speed = np.gradient(PLACES, TIME)
    for doubt in (
        curvature(speed, np.sign(speed), np.zeros(COUNT), DESIGN, 100.0),
        long_ripple(PLACES, np.ones(COUNT), np.zeros(COUNT), DESIGN, 100.0),
    ):
        np.testing.assert_array_equal(doubt, np.zeros(2))


def test_doubts_scale_with_what_shows_and_go_to_what_is_alike():
    random = np.random.default_rng(3)
    shape = left(np.sin(5 * PLACES))
    design = np.column_stack([PLACES, random.normal(size=COUNT)])
    share, doubt = structure(PLACES, shape, design, PARTS)
    assert share > 0.95
    # The first is a function of position throughout, the second as little as chance makes it.
    assert doubt[0] > 10 * doubt[1]
    np.testing.assert_allclose(structure(PLACES, 3 * shape, design, PARTS)[1], 3 * doubt, rtol=1e-9)


def test_the_doubt_covers_the_error():
    """Ripple of any phase and order against a line over position: on the safe side, by a few."""
    random = np.random.default_rng(4)
    errors, doubts = [], []
    for _ in range(100):
        ripple = np.sin(random.uniform(2, 6) * PLACES + random.uniform(0, 6))
        line = np.linalg.lstsq(DESIGN, ripple, rcond=None)[0]
        errors.append(line[0])
        doubts.append(structure(PLACES, ripple - DESIGN @ line, DESIGN, PARTS)[1][0])
    covered = np.abs(errors) < 2 * np.array(doubts)
    assert np.mean(covered) > 0.95
    assert np.sqrt(np.mean(np.square(doubts))) < 6 * np.std(errors)


def friction_of(speed, height):
    velocity = STRIBECK_VELOCITIES[6] * np.max(np.abs(speed))
    return height * np.sign(speed) * np.exp(-((speed / velocity) ** 2))


def test_curvature_is_the_error_of_the_straight_line():
    random = np.random.default_rng(5)
    speed = 20 * np.sin(2 * np.pi * 0.31 * TIME) + 3 * np.sin(2 * np.pi * 1.1 * TIME)
    weight = (np.abs(speed) > 1).astype(float)
    design = np.column_stack([speed, np.sign(speed), np.ones(COUNT)]) * weight[:, None]

    def error_and_doubt(height):
        torque = weight * (friction_of(speed, height) + random.normal(0, 0.01, COUNT))
        line = np.linalg.lstsq(design, torque, rcond=None)[0]
        return np.abs(line), curvature(speed, design[:, 1], torque - design @ line, design, 1000.0)

    error, doubt = error_and_doubt(1.0)
    np.testing.assert_allclose(doubt[:2], error[:2], rtol=0.02)
    nothing = np.mean([error_and_doubt(0.0)[1] for _ in range(20)], axis=0)
    assert np.all(nothing[:2] < 0.02 * doubt[:2])


@pytest.mark.parametrize("kind", ["curvature", "long ripple"])
def test_a_doubt_is_without_what_chance_gives(kind):
    """Change^2 (1 - 4 / F), F that of least squares in white noise that resembles no term."""
    speed = np.gradient(PLACES, TIME)
    speed[np.abs(speed) < 1] = 0
    moves = (speed != 0) * 1.0
    design = np.column_stack([speed, np.sign(speed), moves])
    if kind == "curvature":
        heights = speed[:, None] / (STRIBECK_VELOCITIES * np.max(np.abs(speed)))
        terms = np.sign(speed)[:, None, None] * np.exp(-(heights**2))[:, :, None]
    else:
        turns = 2 * np.pi * (PLACES - PLACES[speed != 0].mean()) / np.ptp(PLACES[speed != 0])
        angles = np.multiply.outer(turns, RIPPLES_A_STROKE)
        terms = moves[:, None, None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    count = terms.shape[2]
    everything = np.column_stack([design, terms.reshape(COUNT, -1)])
    basis, size, _ = np.linalg.svd(everything, full_matrices=False)
    basis = basis[:, size > 1e-9 * size[0]]
    term = terms[:, 4] @ np.full(count, 0.7)
    line = np.linalg.lstsq(design, term, rcond=None)[0]
    rest = term - design @ line
    random = np.random.default_rng(8)
    for fisher in (40.0, 8.0, 2.0):
        deviation, found = np.sqrt(rest @ rest / count / fisher), []
        for _ in range(8):
            noise = moves * random.normal(0, deviation, COUNT)
            left = rest + noise - basis @ (basis.T @ noise)
            if kind == "curvature":
                found.append(curvature(speed, design[:, 1], left, design, COUNT))
            else:
                found.append(long_ripple(PLACES, moves, left, design, COUNT))
        expected = np.abs(line) * np.sqrt(max(1 - 4 / fisher, 0))
        np.testing.assert_allclose(np.mean(found, axis=0), expected, rtol=0.06)
