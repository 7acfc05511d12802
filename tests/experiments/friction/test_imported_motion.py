"""What is stated of a motion beside its parameters: means by speed, notes with their numbers."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import binned_statistic

from rigtool.experiments.friction import imported_motion
from rigtool.experiments.friction.direction_fit import DIRECTION_NAMES
from rigtool.experiments.friction.imported_motion import (
    NOTED_POWER,
    TABLE_RANGES,
    _fit_table,
    _notes,
)
from rigtool.experiments.friction.offset import ASYMMETRY_U_LIMIT
from rigtool.experiments.friction.results import SAME_COULOMB, Findings, Scale
from rigtool.quantity import Quantity


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


def dynamics_of(values, **more):
    """Return dynamics whose parameters are known: by name, value and u."""

    def estimate(*names):
        return values["+".join(names)]

    made = {
        "estimate": estimate,
        "dof": 40,
        "residual_rms": 3e-4,
        "by_direction": False,
        "without_inertia": None,
        "single_frequency": False,
        "explained": 0.9,
        "standstill": 0.05,
        "by_speed": 0.0,
        "by_position": 0.0,
        "is_late": False,
        "motions": [
            SimpleNamespace(**vars(one), cutoff=9.0, left_out=1, samples=9, resampled=False)
            for one in motions()
        ],
        "torque": lambda own: own.torque,
    }
    return SimpleNamespace(**(made | more))


@pytest.fixture
def stated(monkeypatch):
    def made(dynamics):
        monkeypatch.setattr(imported_motion, "identify_dynamics", lambda motions: dynamics)
        found = Findings(Scale(Quantity(1.0, "1", 0.0)))
        imported_motion.add_dynamics((), found)
        return found

    return made


VALUES = {
    "inertia": (2e-5, 1e-6),
    "viscous": (5e-5, 2e-6),
    "coulomb": (2e-3, 4e-5),
    "offset": (3e-4, 5e-5),
}


def test_parameters_of_a_motion_are_stated_with_what_stays_unknown(stated):
    found = stated(dynamics_of(VALUES))
    names = {"inertia": "inertia", "viscous": "viscous_friction", "coulomb": "coulomb_friction"}
    for name, result in (names | {"offset": "friction_offset"}).items():
        own = found.results[result]
        assert (own.value, own.u, own.dof) == (*VALUES[name], 40)
    # half of what directions may differ by looks like the offset
    unknown = max(3e-4 / 2e-3, ASYMMETRY_U_LIMIT) * 2e-3
    for direction in DIRECTION_NAMES.values():
        own = found.results[f"coulomb_friction_{direction}"]
        assert own.value == 2e-3
        assert own.u == pytest.approx(np.hypot(4e-5, unknown))
        assert f"viscous_friction_{direction}" not in found.results
    assert found.results["residual_rms"].value == 3e-4
    assert SAME_COULOMB in found.notes
    assert found.tables["dynamics_fit"].signal == "torque"
    assert not any("frequency" in note for note in found.notes)


def test_directions_differ_in_viscous_friction_by_both_signs(stated):
    both = {
        "viscous+viscous_difference": (7e-5, 3e-6),
        "viscous+-viscous_difference": (3e-5, 4e-6),
    }
    found = stated(dynamics_of(VALUES | both, by_direction=True))
    for direction, key in zip(DIRECTION_NAMES.values(), both, strict=True):
        own = found.results[f"viscous_friction_{direction}"]
        assert (own.value, own.u) == both[key]
    assert any("viscous friction differs by direction" in note for note in found.notes)


@pytest.mark.parametrize(
    ("inertia", "more", "note"),
    [
        ((-2.9e-6, 1e-6), {}, None),
        ((-3.1e-6, 1e-6), {}, "it comes out as -3.1e-06 (SI), below zero, so a spring"),
        ((2e-5, 1e-6), {"without_inertia": "no motion"}, "no inertia is stated: no motion"),
        ((2e-5, 1e-6), {"single_frequency": True}, "a spring would look like less inertia"),
    ],
)
def test_an_inertia_is_stated_where_the_motion_shows_one(stated, inertia, more, note):
    found = stated(dynamics_of(VALUES | {"inertia": inertia}, **more))
    absent = note is not None and "single_frequency" not in more
    assert ("inertia" in found.results) != absent
    said = [one for one in found.notes if "inertia" in one and "J a" not in one]
    assert len(said) == (note is not None)
    assert note is None or note in said[0]
