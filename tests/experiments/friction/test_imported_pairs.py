"""What is stated of a change between two runs of one motion, from a change that is known."""

import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from rigtool.errors import UsageError
from rigtool.experiments.friction import imported_pairs
from rigtool.experiments.friction.paired import ParameterChange
from rigtool.experiments.friction.results import Findings, Scale
from rigtool.quantity import Quantity

NAMES = ("inertia", "viscous", "coulomb", "offset", "gravity_cosine", "gravity_sine")
RESULTS = {
    "inertia": ("inertia_difference", "kg m2"),
    "viscous": ("viscous_friction_difference", "N m s/rad"),
    "coulomb": ("coulomb_friction_difference", "N m"),
    "offset": ("friction_offset_difference", "N m"),
    "gravity_cosine": ("gravity_cosine_difference", "N m"),
    "gravity_sine": ("gravity_sine_difference", "N m"),
}


def change(names=NAMES, count=4500, seed=1, dof=30, turns=True):
    rng = np.random.default_rng(seed)
    root = 0.1 * rng.standard_normal((len(names), len(names)))
    return ParameterChange(
        names,
        rng.uniform(1, 2, len(names)),
        root @ root.T,
        dof,
        -0.0123,
        np.arange(count) * 0.01,
        *rng.standard_normal((2, count)),
        *rng.standard_normal((2, count)),
        rng.random(count) < 0.7,
        300.0,
        0.01,
        turns,
    )


def recording(name, linear=False, **more):
    channels = {"time": np.arange(5.0), "position": np.linspace(0, 20, 5), **more}
    return SimpleNamespace(
        name=name,
        run=SimpleNamespace(path=Path("run.h5")),
        read=channels.__getitem__,
        has=channels.__contains__,
        linear=linear,
    )


@pytest.fixture
def compare(monkeypatch):
    """Compare recordings whose changes are given; return findings and the signals compared."""
    asked = []
    monkeypatch.setattr(imported_pairs, "place", lambda one: one.name)
    monkeypatch.setattr(imported_pairs, "is_linear", lambda one: one.linear)
    monkeypatch.setattr(imported_pairs, "position_of", lambda one: one.read("position"))
    effort = SimpleNamespace(values=np.ones(5), unit="N m")
    monkeypatch.setattr(imported_pairs, "effort_of", lambda one, kt: effort)
    monkeypatch.setattr(
        imported_pairs, "rig_property", lambda one, name: getattr(one, "gear", None)
    )

    def made(changes, recordings, against, reference=None):
        def given(first, others):
            asked.append([first, *others])
            return changes

        monkeypatch.setattr(imported_pairs, "changes", given)
        found = Findings(Scale(Quantity(1.0, "1", 0.0)))
        imported_pairs.add_changes(recordings, against, reference, None, found)
        return found, asked[-1]

    return made


def test_each_parameter_is_stated_with_its_u(compare):
    own = change()
    found, _ = compare([own], [recording("here")], recording("before"))
    for n, name in enumerate(NAMES):
        stated, unit = RESULTS[name]
        result = found.results[stated]
        assert (result.value, result.unit) == (pytest.approx(own.parameters[n]), unit)
        assert result.u == pytest.approx(math.sqrt(own.covariance[n, n]))
        assert result.dof == 30
    gravity = found.results["gravity_difference"]
    cosine, sine = own.parameters[4:]
    assert gravity.value == pytest.approx(math.hypot(cosine, sine))
    step, moved = 1e-6, []  # by differences of the amplitude
    for way in np.eye(2):
        moved.append((math.hypot(*(own.parameters[4:] + step * way)) - gravity.value) / step)
    expected = math.sqrt(np.array(moved) @ own.covariance[4:, 4:] @ moved)
    assert gravity.u == pytest.approx(expected, rel=1e-4)
    left = (own.difference - own.model)[own.used]
    assert found.results["difference_rms"].value == pytest.approx(np.sqrt(np.mean(left**2)))
    assert "ratio" not in " ".join(found.results)
    (note,) = (note for note in found.notes if "minus" in note)
    assert note.startswith("here minus before, at the same points of one motion; the second")
    assert note.endswith("is 0.0123 s later")
    assert not any("does not separate" in note for note in found.notes)


def test_the_table_has_2000_points_at_most_and_none_near_standstill(compare):
    for count, every in ((2000, 1), (2001, 2), (4500, 3)):
        own = change(count=count)
        found, _ = compare([own], [recording("here")], recording("before"))
        table, kept = found.tables["paired_difference"], own.used[::every]
        np.testing.assert_array_equal(table["time"], own.time[::every])
        np.testing.assert_array_equal(table["position"], own.position[::every])
        for name in ("difference", "model"):
            expected = np.where(kept, getattr(own, name)[::every], np.nan)
            np.testing.assert_array_equal(table[name], expected)


def test_what_the_motion_does_not_separate_is_named(compare):
    own = change(names=("inertia", "coulomb", "offset"))
    for linear in (False, True):
        found, _ = compare([own], [recording("here", linear)], recording("before"))
        (note,) = (note for note in found.notes if "does not separate" in note)
        assert "viscous_friction_difference" in note
        assert ("gravity_cosine_difference" in note) != linear
        assert ("gravity along the axis" in found.notes[-1]) == linear
        assert "gravity_difference" not in found.results
        # gravity that is not separated is part of the inertia's change
        assert "inertia_difference" not in found.results
    alone = change(names=("inertia", "coulomb", "offset"), turns=False)
    found, _ = compare([alone], [recording("here")], recording("before"))
    assert found.results["inertia_difference"].value == alone.parameters[0]


def test_a_reference_scales_the_change(compare, monkeypatch):
    own, known = change(), change(seed=2)
    monkeypatch.setattr(
        imported_pairs, "ratio", lambda a, b: (1.5, 0.1, 9) if (a, b) == (own, known) else None
    )
    reference = recording("weight")
    found, signals = compare([own, known], [recording("here")], recording("before"), reference)
    result = found.results[imported_pairs.RATIO_RESULT]
    assert (result.value, result.u, result.dof) == (1.5, 0.1, 9)
    assert any("to the change in weight, both against before" in note for note in found.notes)
    assert len(signals) == 3


def test_gravity_sees_the_angle_of_the_output(compare):
    rotor = np.linspace(0, 20, 5)
    small = recording("small", position=np.linspace(0, 4 * np.pi, 5))
    geared = recording("geared")
    geared.gear = 5.0
    output = recording("output", output_position=np.arange(5.0))
    linear = recording("linear", linear=True, output_position=np.arange(5.0))
    for one, expected in (
        (small, small.read("position")),
        (geared, rotor / 5),
        (output, np.arange(5.0)),
        (linear, None),
    ):
        found, signals = compare([change()], [one], one)
        for own in signals:
            assert own.angle is None if expected is None else np.array_equal(own.angle, expected)
            np.testing.assert_array_equal(own.position, one.read("position"))
        assert not any("gravity is not separated" in note for note in found.notes)
    found, signals = compare([change()], [recording("far")], recording("before"))
    assert signals[0].angle is None
    assert sum("gravity is not separated" in note for note in found.notes) == 1


def test_several_recordings_are_not_compared(compare):
    with pytest.raises(UsageError, match="2 recordings: --against"):
        compare([], [recording("one"), recording("two")], recording("before"))
