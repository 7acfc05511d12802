"""What is stated of a motion beside its parameters: means by speed, notes with their numbers."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import binned_statistic

from rigtool.experiments.friction.imported_motion import (
    NOTED_POWER,
    TABLE_RANGES,
    _fit_table,
    _notes,
)


def motions():
    rng = np.random.default_rng(1)
    made = []
    for count in (900, 600):
        speed = np.concatenate([rng.uniform(-9, -2, count // 2), rng.uniform(3, 11, count // 2)])
        design = np.column_stack([np.zeros(count), speed])
        torque = 2e-3 * np.sign(speed) + 1e-4 * rng.standard_normal(count)
        used = rng.random(count) < 0.8
        made.append(SimpleNamespace(design=design, torque=torque, used=used))
    return made


def test_torque_and_model_are_means_by_range_of_speed():
    given = motions()
    dynamics = SimpleNamespace(motions=given, torque=lambda own: 1.7e-3 * np.sign(own.design[:, 1]))
    table = _fit_table(dynamics)
    speed, torque = (
        np.concatenate([values(own)[own.used] for own in given])
        for values in (lambda own: own.design[:, 1], lambda own: own.torque)
    )
    edges = np.linspace(speed.min(), speed.max(), TABLE_RANGES + 1)
    count = binned_statistic(speed, speed, "count", edges).statistic
    assert (count == 0).sum() > 0  # none between the directions
    for name, values in (("torque", torque), ("model", 1.7e-3 * np.sign(speed))):
        means = binned_statistic(speed, values, "mean", edges).statistic
        np.testing.assert_allclose(table[name], means[count > 0], rtol=1e-9)
    middles = (edges[:-1] + np.diff(edges) / 2)[count > 0]
    np.testing.assert_allclose(table["speed"], middles, rtol=1e-9)


@pytest.mark.parametrize("share", [NOTED_POWER * 0.99, NOTED_POWER * 1.01])
def test_notes_state_what_was_left_out_and_what_else_acts(share):
    parts = [
        SimpleNamespace(cutoff=12.0, left_out=30, samples=100, resampled=True),
        SimpleNamespace(cutoff=9.5, left_out=12, samples=400, resampled=False),
    ]
    dynamics = SimpleNamespace(
        motions=parts,
        explained=0.9876,
        standstill=0.05,
        by_speed=share,
        by_position=0.0,
        is_late=True,
        estimate=lambda name: (2.5e-3, 3e-4),
    )
    notes = _notes(dynamics)
    assert "explain 98.8 % of its variance up to 9.5 Hz or more" in notes[0]
    assert notes[2].startswith("42 of 500 samples left out: below 5 % of the highest speed")
    assert any(f"{100 * share:.0f} % of the unexplained power" in note for note in notes) == (
        share > NOTED_POWER
    )
    assert "the effort is 2.5 ms (u 0.3 ms) later" in notes[-2]
    assert notes[-1].startswith("1 irregular time axes")
