"""What changed between two runs of one motion: a payload on an arm, and friction at held speeds."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from rigtool.errors import InsufficientDataError, RunFileError, UsageError
from rigtool.experiments.friction.paired import MotionSignals, changes, ratio
from rigtool.experiments.friction.results import Findings, Scale
from rigtool.experiments.friction.results_difference import HOLD_TABLE, add_curve_difference
from rigtool.quantity import Quantity
from rigtool.recipe.mapping import parse_mapping
from rigtool.runfile import Column, Table, open_run
from tests.experiments.friction.test_imported import HELD, analyse, hold
from tests.experiments.imported_runs import take
from tests.unchanged import require_unchanged

ARM = 0.3
"""From the shaft to the payload, m."""

TWO_SINES = ((0.8, 0.2, 0.0), (0.3, 0.53, 1.0))


def arm(payload, seed, later=0.0, noise=0.02, sines=TWO_SINES):
    """An arm that lifts a payload, kg: inertia, gravity, and what both runs share: friction with a
    Stribeck effect, ripple."""
    random = np.random.default_rng(seed)
    time = np.arange(0, 40, 5e-3)
    phases = [(a, 2 * np.pi * f, 2 * np.pi * f * (time - later) + p) for a, f, p in sines]
    position = 0.2 + sum(a * np.sin(phase) for a, _, phase in phases)
    speed = sum(a * w * np.cos(phase) for a, w, phase in phases)
    acceleration = sum(-a * w**2 * np.sin(phase) for a, w, phase in phases)
    sliding = np.sign(speed) * (0.5 + 0.2 * payload + 0.3 * np.exp(-((speed / 0.1) ** 2)))
    gravity = (0.4 + payload * 9.81 * ARM) * np.cos(position)
    torque = (0.05 + payload * ARM**2) * acceleration + 0.3 * speed + sliding + gravity
    torque += 0.1 + 0.05 * np.sin(24 * position) + random.normal(0, noise, len(time))
    return MotionSignals(time, position, torque, position)


def test_a_payload_is_weighed_by_another_one():
    """Inertia, gravity and friction of a payload; 205 g by 105 g to 1 %, in other phases of time.

    n = 8; a standard deviation within a factor of two of the stated u: 99.9 % of chi2(8)/8.
    """
    pulls, apart = [], []
    for seed in range(8):
        light = arm(0.105, 3 * seed + 1, later=0.7)
        heavy = arm(0.205, 3 * seed + 2, later=-0.0371)
        change, known = changes(arm(0.0, 3 * seed), [heavy, light])
        value, u, _ = ratio(change, known)
        apart.append(value / (205 / 105) - 1)
        expected = {"inertia": 0.205 * ARM**2, "coulomb": 0.041, "viscous": 0.0}
        pulls.append((value - 205 / 105) / u)
        for name, truth in expected.items():
            found, u = change.estimate(name)
            assert abs(found - truth) < 5 * u
        gravity, u = change.gravity()
        assert abs(gravity - 0.205 * 9.81 * ARM) < 5 * u < 0.3
        assert change.shift == pytest.approx(-0.0371, rel=0, abs=1e-3)
    assert np.sqrt(np.mean(np.square(apart))) < 0.01
    assert 0.4 < np.sqrt(np.mean(np.square(pulls))) < 2


def test_the_unit_of_torque_changes_no_ratio():
    unit, runs = 64.0, (arm(0.0, 1), arm(0.205, 2), arm(0.105, 3))
    larger = [replace(run, effort=unit * run.effort) for run in runs]
    pairs = list(zip(changes(runs[0], runs[1:]), changes(larger[0], larger[1:]), strict=True))
    for one, other in pairs:
        for name in ("inertia", "viscous", "coulomb"):
            scaled = np.array(other.estimate(name)) / unit
            np.testing.assert_allclose(scaled, one.estimate(name), rtol=1e-6)
        np.testing.assert_allclose(np.array(other.gravity()) / unit, one.gravity(), rtol=1e-6)
        assert other.residual_rms / unit == pytest.approx(one.residual_rms, rel=1e-6)
    (heavy, heavy_too), (light, light_too) = pairs
    np.testing.assert_allclose(ratio(heavy_too, light_too), ratio(heavy, light), rtol=1e-5)


def test_one_frequency_separates_no_gravity():
    sines = ((0.05, 0.5, 0.0),)
    (change,) = changes(arm(0, 1, sines=sines), [arm(0.2, 2, sines=sines)])
    assert change.gravity() is None
    assert change.estimate("inertia") is None
    assert change.estimate("coulomb") is not None


def test_runs_that_are_no_pair_are_refused():
    other = arm(0.1, 2, sines=((0.8, 0.31, 0.5), (0.3, 0.11, 0.0)))
    with pytest.raises(InsufficientDataError, match="not of one motion"):
        changes(arm(0, 1), [other])
    change, same = changes(arm(0, 1), [arm(0.2, 2), arm(0, 3)])
    with pytest.raises(InsufficientDataError, match="not larger than the scatter"):
        ratio(change, same)


MAPPING = """mapping = 1
[rig]
name = "arm"
gear_ratio = 50
[signals]
time = { column = "t", unit = "s" }
position = { column = "x", unit = "rad" }
current = { column = "i", unit = "A" }
"""


def test_runs_by_the_command(tmp_path):
    """A geared motor, whose current is torque at the arm over 5 N m/A."""
    arrays = {
        name: {"t": run.time, "x": 50 * run.position, "i": run.effort / 5}
        for name, run in (
            ("bare", arm(0.0, 1)),
            ("known", arm(0.105, 2)),
            ("unknown", arm(0.205, 3, 0.2)),
        )
    }
    bare, known, unknown = take(tmp_path, MAPPING, arrays)
    with open_run(bare) as against, open_run(known) as reference:
        outcome = analyse([unknown], tmp_path / "d.h5", against=against, reference=reference)
        found = outcome.results["ratio_of_differences"]
        assert abs(found.value - 205 / 105) < 3 * found.u < 0.2
        gravity = outcome.results["gravity_difference"]
        assert gravity.unit == "A"
        assert abs(gravity.value - 0.205 * 9.81 * ARM / 5) < 4 * gravity.u
        assert outcome.results["inertia_difference"].unit == "A s2/rad"
        assert any("coupling to other joints" in note for note in outcome.notes)
        require_unchanged("paired-motion", outcome)
        with pytest.raises(UsageError, match="one recording with one"):
            analyse([unknown, known], tmp_path / "e.h5", against=against)
        with pytest.raises(UsageError, match="given twice"):
            analyse([bare], tmp_path / "e.h5", against=against)
        with pytest.raises(UsageError, match="--reference"):
            analyse([unknown], tmp_path / "e.h5", reference=reference)
    with open_run(tmp_path / "d.h5") as stored, pytest.raises(RunFileError, match="no recording"):
        analyse([unknown], tmp_path / "e.h5", against=stored)
    assert not (tmp_path / "e.h5").exists()


def test_curves_at_constant_speeds(tmp_path):
    """A seal that adds 0.4 mN m and 0.01 mN m s/rad, and twice as much."""
    steps = np.array([20.0, 40, 60, 80, 120, 160, -20, -40, -60, -80, -120, -160])
    files = {}
    for number, name in enumerate(("bare", "once", "twice")):
        parts = [hold(rpm, 1000 * number + int(rpm) + 500, 0) for rpm in steps]
        seal = [0.4 * np.sign(rpm) + 0.01 * rpm * np.pi / 30 for rpm in steps]
        files[name] = {
            "t": np.arange(len(steps) * 500) * 0.01,
            "v": np.concatenate([part["v"] for part in parts]),
            "f": np.concatenate(
                [part["f"] + number * more for part, more in zip(parts, seal, strict=True)]
            ),
        }
    paths = take(tmp_path, HELD, files)
    for path, name in zip(paths, files, strict=True):
        analyse([path], tmp_path / f"{name}.h5")
    with open_run(tmp_path / "bare.h5") as bare, open_run(tmp_path / "once.h5") as once:
        outcome = analyse([paths[2]], tmp_path / "d.h5", against=bare, reference=once)
    results = outcome.results
    assert outcome.tables["hold_differences"].shape == (12,)
    require_unchanged("paired-holds", outcome)
    for name, truth in (
        ("coulomb_friction_difference", 0.8e-3),
        ("viscous_friction_difference", 0.02e-3),
        ("friction_offset_difference", 0.0),
        ("ratio_of_differences", 2.0),
    ):
        assert abs(results[name].value - truth) < 4 * results[name].u
    assert results["ratio_of_differences"].u < 0.05


def test_the_mapping_states_the_gear():
    assert parse_mapping(MAPPING).rig.gear_ratio == 50


def test_runs_that_do_not_move_exactly_alike():
    """A loaded arm that swings 4 % further: what the bare arm needs for that is no change."""
    sines = ((0.832, 0.2, 0.0), (0.312, 0.53, 1.0))
    (change,) = changes(arm(0.0, 1), [arm(0.205, 2, noise=0.005, sines=sines)])
    for name, truth in (("inertia", 0.205 * ARM**2), ("viscous", 0.0), ("coulomb", 0.041)):
        found, u = change.estimate(name)
        assert abs(found - truth) < 4 * u
    viscous, u = change.estimate("viscous")
    # Without the correction it would be 4 % of 0.3 N m s/rad.
    assert abs(viscous) < 0.006 > 2 * u


def test_noise_of_the_known_change_does_not_enlarge_the_ratio():
    """Least squares against a noisy column would give 2 / (1 + 0.7**2)."""
    (known,) = changes(arm(0.0, 1), [arm(0.1, 2)])
    random = np.random.default_rng(4)
    size = np.sqrt(np.mean(known.model[known.used] ** 2))
    noisy = known.model + random.normal(0, 0.7 * size, len(known.model))
    twice = replace(known, difference=2 * known.model)
    value, _, _ = ratio(twice, replace(known, difference=noisy, independent=1e4))
    assert value == pytest.approx(2, rel=0.05)


def test_a_known_change_may_be_a_fifth_uncertain():
    (known,) = changes(arm(0.0, 1), [arm(0.1, 2)])
    seen = known.model[known.used]
    noise = np.random.default_rng(4).normal(0, np.linalg.norm(seen), len(known.model))

    def against(relative_u):
        noisy = known.model + relative_u * noise
        return ratio(known, replace(known, difference=noisy, fitted_noise=0.0, independent=1e4))

    assert abs(against(0.12)[0] - 1) < 4 * 0.12
    with pytest.raises(InsufficientDataError, match="not larger than the scatter"):
        against(0.33)


def test_noise_that_the_fit_takes_for_a_change_does_not_move_the_ratio():
    """Three runs of the same noise, all of it fitted: a quarter of the known change's power is each
    run's noise, and that of the first run is in both changes."""
    (known,) = changes(arm(0.0, 1), [arm(0.1, 2)])
    random, count = np.random.default_rng(6), len(known.model)
    size = np.sqrt(np.mean(known.model[known.used] ** 2))
    first, second, third = random.normal(0, size / 2, (3, count))
    x, y = known.model + second - first, 2 * known.model + third - first
    noise = np.count_nonzero(known.used) * size**2 / 2
    known = replace(known, difference=x, model=x, fitted_noise=noise, independent=1e4)
    value, _, _ = ratio(replace(known, difference=y), known)
    assert value == pytest.approx(2, rel=0.05)


def held(speed, torque, u):
    """Return the table of a curve of constant speeds."""
    columns = {"speed": Column(speed, "rad/s"), "torque": Column(torque, "N m")}
    columns["u"] = Column(np.full(len(speed), u), "N m")
    columns["dof"] = Column(np.full(len(speed), 9.0), "1")
    return Table(("speed",), columns, "torque", "")


def stored(table):
    """Return what the comparison reads of a stored run."""
    run = SimpleNamespace(path="b.h5", tables={HOLD_TABLE: table}, require_command=str)
    run.table = lambda name, *axes, **units: run.tables[name]
    return run


def test_the_curve_that_both_differences_share_does_not_move_their_ratio():
    """A known change of 5 u at each speed, and one in the other direction, over 100 draws."""
    speed = np.concatenate([np.geomspace(2, 60, 20), -np.geomspace(2, 60, 20)])
    pulls = []
    for seed in range(100):
        random = np.random.default_rng(seed)
        bare, known, unknown = (
            held(speed, change * np.sign(speed) + random.normal(0, 1e-5, len(speed)), 1e-5)
            for change in (0.0, 5e-5, -5e-5)
        )
        found = Findings(Scale(Quantity(0.045, "N m/A", 0.0)), tables={HOLD_TABLE: unknown})
        add_curve_difference(found, stored(bare), stored(known))
        ratio = found.results["ratio_of_differences"]
        pulls.append((ratio.value + 1) / ratio.u)
    assert abs(np.mean(pulls)) < 0.3  # three standard deviations
    assert 0.8 < np.std(pulls) < 1.2


def test_scatter_beyond_the_stated_one_widens_differences():
    """Curves of which the torques scatter three times as much as their u states."""
    speed = np.concatenate([np.geomspace(2, 60, 12), -np.geomspace(2, 60, 12)])
    pulls = []
    for seed in range(40):
        random = np.random.default_rng(seed)

        this, other = (held(speed, random.normal(0, 3e-5, len(speed)), 1e-5) for _ in range(2))
        found = Findings(Scale(Quantity(0.045, "N m/A", 0.0)), tables={HOLD_TABLE: this})
        add_curve_difference(found, stored(other), None)
        pulls += [found.results[f"{n}_friction_difference"] for n in ("coulomb", "viscous")]
    # 80 pulls; a third of the true u would give 3.
    assert 0.75 < np.sqrt(np.mean([(q.value / q.u) ** 2 for q in pulls])) < 1.3
