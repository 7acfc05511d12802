"""What remains with the table on, by speed, beside numpy and scipy."""

import numpy as np
from scipy.stats import sem

from rigtool.experiments.learning.results_residual import Remaining
from rigtool.experiments.learning.rows import Row

SPEEDS = (-3.0, 3.0, 6.0)
POSITION = np.linspace(0, 2, 21)
TORQUE = np.outer(SPEEDS, 1e-3 * np.sin(2 * POSITION))


def remaining(applied=TORQUE):
    rng = np.random.default_rng(1)

    def rows(size, moves):
        return [
            Row(v, size * np.sin(v * POSITION) + 1e-4 * rng.standard_normal((n, 21)))
            for v, n in zip(SPEEDS, moves, strict=True)
        ]

    return Remaining(POSITION, rows(2e-3, (5, 5, 5)), rows(3e-4, (5, 9, 4)), applied)


def test_numbers_by_speed_are_those_of_the_moves():
    found = remaining()
    numbers = found.tables()["residual_by_speed"]
    waves = found.tables()["residual_waveforms"]
    assert numbers["speed"].tolist() == list(SPEEDS)
    assert numbers["dof"].tolist() == [4, 8, 3]
    for name, key, rows in (
        ("before", "before", found.before),
        ("residual", "residual", found.after),
    ):
        means = np.array([np.mean(row.moves, axis=0) for row in rows])
        np.testing.assert_allclose(waves[key], means, rtol=1e-12)
        np.testing.assert_allclose(numbers[f"{name}_peak"], np.max(np.abs(means), axis=1))
        np.testing.assert_allclose(numbers[f"{name}_rms"] ** 2, np.mean(means**2, axis=1))
    for number, row in enumerate(found.after):
        at = np.argmax(np.abs(row.moves.mean(axis=0)))
        assert np.isclose(numbers["residual_peak_u"][number], sem(row.moves[:, at]))
        scatter = np.sqrt(np.mean(np.var(row.moves, axis=0, ddof=1)))
        assert np.isclose(numbers["non_repeatable_rms"][number], scatter)
    np.testing.assert_array_equal(waves["table"], TORQUE)


def test_another_table_than_the_recorded_one_is_reported():
    assert remaining(TORQUE * (1 + 0.9e-3)).notes(TORQUE) == ()
    other = TORQUE.copy()
    other[1, 4] += 1e-4
    (note,) = remaining(other).notes(TORQUE)
    assert "differs from this one by up to 0.1 mN m" in note
