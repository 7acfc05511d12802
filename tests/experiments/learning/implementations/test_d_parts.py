"""Parts of implementation D, without a rig: what is recorded, paired, and read from loads."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from rigtool.errors import InsufficientDataError, RunFileError
from rigtool.experiments.learning.implementations import d_known_loads
from rigtool.experiments.learning.implementations.d_known_loads import (
    KnownLoads,
    _friction_coefficient,
    _known_loads,
    _left_out,
    _loaded,
    _notes,
    _temperature,
)
from rigtool.quantity import Quantity
from rigtool.recipe import load_recipe
from tests.experiments.virtual_runs import RECIPE

SETTINGS = (
    "rig.attachment=instrument",
    "ilc_learn.loads.forces=[0.5, 1, 3]",
    "ilc_learn.loads.speeds_rev_per_s=[1, 2]",
    "ilc_learn.loads.cycles=7",
)
RIG = load_recipe(RECIPE, SETTINGS)[0]
ARM = RIG.rig.load_arm


def test_each_speed_begins_and_ends_without_load():
    specs = _loaded(RIG)
    names = [f"known_{row:03d}_{number:03d}" for row in (0, 1) for number in range(5)]
    assert [spec.name for spec in specs] == names
    assert [spec.conditions["force"] for spec in specs] == 2 * [
        (force, "N") for force in (0.0, 0.5, 1.0, 3.0, 0.0)
    ]
    ratio = RIG.rig.angle_ratio
    for spec, rev in zip(specs, np.repeat([1.0, 2.0], 5), strict=True):
        assert spec.conditions["speed"] == (pytest.approx(2 * math.pi * rev * ratio), "rad/s")
        assert spec.conditions["cycles"] == (7.0, "1")
    checks = [s for s in KnownLoads.recordings(RIG) if s.name.startswith(("explore", "check"))]
    assert [spec.name for spec in checks] == ["explore_000", "check_000", "check_001", "check_002"]
    assert [spec.conditions["force"][0] for spec in checks] == [0.0, 0.0, 1.0, 3.0]


def recording(name, speed, force, temperature=20.0):
    conditions = {"speed": speed, "force": force}
    return SimpleNamespace(
        name=name, condition=conditions.get, read=lambda _: np.array([temperature, temperature + 2])
    )


def sliding(name, slides=True):
    return SimpleNamespace(name=name, used=np.array([slides, False]))


def run_of(recordings):
    return SimpleNamespace(path="d.h5", recordings_named=lambda prefix: recordings)


def test_loads_are_paired_with_the_same_motion_without():
    made = [
        recording("a", 2.0, 0.0),
        recording("b", 2.0, 1.0),
        recording("c", 5.0, 0.0),
        recording("d", 5.0, 3.0),
        recording("e", 2.0, 0.0),
        recording("f", 2.0, 3.0),
    ]
    own = {each.name: sliding(each.name) for each in made}
    found = _known_loads(run_of(made), made, RIG, own)
    assert [(p.loaded.name, tuple(r.name for r in p.unloaded)) for p in found.pairs] == [
        ("b", ("a", "e")),
        ("f", ("a", "e")),
        ("d", ("c",)),
    ]
    assert {pair.arm for pair in found.pairs} == {ARM}
    np.testing.assert_array_equal(found.speed, [2.0, 2.0, 5.0])
    np.testing.assert_allclose(found.moment, [ARM, 3 * ARM, 3 * ARM], rtol=1e-12)
    with pytest.raises(RunFileError, match="nothing was recorded without load at 2 rad/s"):
        _known_loads(run_of([]), made[1:2], RIG, {"b": "b"})


def test_strokes_in_which_the_rotor_does_not_slide_are_no_pairs():
    """As with an encoder of few counts: nothing is learned of the slowest strokes."""
    made = [recording(f"{speed}, {n}", speed, float(n)) for speed in (2.0, 5.0) for n in range(3)]
    slow = {each.name: sliding(each.name, each.condition("speed") > 2.0) for each in made}
    found = _known_loads(run_of(made), made, RIG, slow)
    assert [pair.loaded.name for pair in found.pairs] == ["5.0, 1", "5.0, 2"]
    np.testing.assert_array_equal(found.speed, [5.0, 5.0])
    with pytest.raises(InsufficientDataError, match=r"slide evenly, by 160 counts.*higher"):
        _known_loads(run_of(made), made, RIG, {name: sliding(name, False) for name in slow})


def test_the_temperature_is_the_mean_over_all_strokes():
    made = [recording("a", 2.0, 0.0, 20.0), recording("b", 2.0, 1.0, 30.0)]
    assert _temperature(run_of(made)) == pytest.approx(26.0)


def test_friction_per_load_is_that_of_the_largest_load_at_the_slowest_speed():
    angle = np.radians([45.0, 135.0])
    friction = np.zeros((2, 2, 3))
    friction[0, :, -1] = [4e-3, 8e-3]
    friction_u = np.zeros((2, 2, 3))
    friction_u[0, :, -1] = [1e-4, 3e-4]
    grid = SimpleNamespace(
        angle=angle, friction=friction, friction_u=friction_u, load=np.array([0.0, 0.01, 0.05])
    )
    recipe = RIG.model_copy(
        update={"measure_force": RIG.measure_force.model_copy(update={"measure_angle": 90.0})}
    )
    found = _friction_coefficient(grid, recipe)
    assert (found.value, found.u) == pytest.approx((6e-3 / 0.05, 2e-4 / 0.05), rel=1e-9)


def test_each_load_is_read_with_what_the_others_show(monkeypatch):
    moments, speeds = np.array([0.01, 0.03, 0.01, 0.03]), np.array([2.0, 2.0, 5.0, 5.0])
    records = [SimpleNamespace(moment=m) for m in (0.01, 0.03, 0.0, 0.01, 0.03)]
    asked = []

    def learned_from(chosen):
        asked.append([r.moment for r, use in zip(records, chosen, strict=True) if use])
        return asked[-1]

    def read(model, pairs, largest, angle, bandwidth):
        (number,) = pairs
        assert moments[number] not in model
        assert (largest, bandwidth) == (0.03, RIG.measure_force.lowpass_hz)
        assert angle == pytest.approx(math.radians(RIG.measure_force.measure_angle))
        if number == 3:
            return [InsufficientDataError("not read")]
        value = moments[number] * (1 + 0.01 * (number + 1))
        return [SimpleNamespace(moment=value, quantity=Quantity(value, "N m", 2e-4, 7.0 + number))]

    monkeypatch.setattr(d_known_loads, "read_loads", read)
    sliding = SimpleNamespace(problem=SimpleNamespace(records=records), learned_from=learned_from)
    loads = SimpleNamespace(pairs=[0, 1, 2, 3], speed=speeds, moment=moments)
    table = _left_out(SimpleNamespace(sliding=sliding), loads, RIG)
    assert asked == [[0.03, 0.0, 0.03], [0.01, 0.0, 0.01]]
    np.testing.assert_array_equal(table["speed"], [2.0, 5.0])
    np.testing.assert_array_equal(table["load"], [0.01, 0.03])
    np.testing.assert_allclose(table["error_percent"], [[1.0, 2.0], [3.0, np.nan]], rtol=1e-9)
    np.testing.assert_allclose(table["u"], [[2.0, 2 / 3], [2.0, np.nan]], rtol=1e-9)
    np.testing.assert_allclose(table["dof"], [[7, 8], [9, np.nan]], rtol=1e-9)


def test_the_note_has_the_range_in_turns_of_the_output():
    ratio = RIG.rig.angle_ratio
    (note,) = _notes(0.06, 2 * math.pi * ratio * np.array([0.5, 1.0, 2.0]), RIG)
    assert note.startswith("loads were learned up to 60 mN m from 0.5 to 2 rev/s")
