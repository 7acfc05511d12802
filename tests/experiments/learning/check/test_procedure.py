"""Tables checked on the virtual rig: unchanged, after a power cycle, a slip, and a drift."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from rigtool.errors import InsufficientDataError, RunFileError, UsageError
from rigtool.experiments.learning.check import procedure as ilc_check
from rigtool.experiments.learning.check.procedure import PROCEDURE as ILC_CHECK
from rigtool.experiments.learning.procedure import PROCEDURE as ILC_LEARN
from rigtool.experiments.learning.stored_table import learned_table_from
from rigtool.experiments.running.options import CommonOptions
from rigtool.recipe import load_recipe
from rigtool.runfile import open_run
from tests.experiments.virtual_runs import RECIPE, TORQUE_CONSTANT, run, write_results
from tests.thorough import first_of
from tests.unchanged import require_unchanged

PULLEY = "rig.attachment=pulley"
TURNING = (
    PULLEY,
    "ilc_learn.implementation=B",
    "ilc_learn.turning.speeds_rev_per_s=[1]",
    "ilc_learn.turning.low_speeds_rev_per_s=[]",
    "ilc_learn.turning.revolutions=8",
)
MOVING = (
    "ilc_learn.speeds_rev_per_s=[1]",
    "ilc_learn.low_speeds_rev_per_s=[]",
    "ilc_learn.moves=8",
)
SEEDS = (1, 2)


@pytest.fixture(scope="module", params=first_of(SEEDS))
def turned(request, folder, kt):
    """Return a table of whole turns, and the seed of its rig."""
    path = folder / f"turned-{request.param}.h5"
    run(ILC_LEARN, RECIPE, path, *TURNING, seed=request.param, kt=kt)
    return path, request.param


@pytest.fixture(scope="module", params=first_of(SEEDS))
def moved(request, folder, kt):
    """Return a table of a range, with the instrument, and the seed of its rig."""
    path = folder / f"moved-{request.param}.h5"
    run(ILC_LEARN, RECIPE, path, *MOVING, seed=request.param, kt=kt)
    return path, request.param


def check(tables, folder, kt, *overrides, seed=None, source=RECIPE):
    with open_run(tables) as stored:
        options = ilc_check.as_learned(CommonOptions(overrides=overrides), [str(source)], stored)
    inputs = {"tables": tables, "kt": kt}
    return run(ILC_CHECK, source, folder / "check.h5", *options.overrides, seed=seed, **inputs)


def test_an_unchanged_rig_fits(unchanged):
    """Other noise, the same motor and amplifier."""
    outcome = unchanged[1]
    results = outcome.results
    assert ilc_check.fits(outcome)
    assert outcome.notes[0].startswith("the table fits")
    assert abs(results["table_shift"].value) < 4 * results["table_shift"].u
    assert abs(results["friction_change"].value) < 0.1e-3
    assert results["mismatch_rms"].value < results["non_repeatable_rms"].value
    assert results["table_shift"].dof == ilc_check.MOVES_PER_SPEED - 1


def test_a_power_cycle_is_another_pattern(turned, folder, kt):
    tables, seed = turned
    outcome = check(tables, folder, kt, "virtual.power_cycle=1", seed=seed)
    verdict = outcome.notes[0]
    assert not ilc_check.fits(outcome)
    assert "another shape, as after a power cycle" in verdict
    assert "a shift is not enough" in verdict
    assert "friction has changed" not in verdict
    difference = outcome.results["shape_difference"]
    assert difference.value > 3 * difference.u
    if seed == SEEDS[0]:
        require_unchanged("check-power-cycle", outcome)


def test_friction_that_drifted_is_reported(turned, folder, kt):
    tables, seed = turned
    change = 0.6e-3 * (-1) ** seed
    drifted = f"virtual.motor.coulomb_friction={2.3e-3 + change}"
    outcome = check(tables, folder, kt, drifted, seed=seed)
    verdict, found = outcome.notes[0], outcome.results["friction_change"]
    assert not ilc_check.fits(outcome)
    assert "friction has changed" in verdict
    assert "power cycle" not in verdict
    assert "shifted by" not in verdict
    # The torque constant that --kt assumes is not the rig's, and static friction is still there.
    assert found.value == pytest.approx(change, rel=0.25, abs=0)


def test_another_calibration_is_no_change_of_the_rig(turned, folder, kt):
    """Currents are compared: what a later calibration states changes none."""
    tables, seed = turned
    other = write_results(
        folder / "other.h5",
        "calibrate-kt",
        torque_constant_mean=(0.9 * TORQUE_CONSTANT, "N m/A"),
        amplifier_gain=(1.0, "1"),
    )
    found = check(tables, folder, other, seed=seed)
    assert found.results == check(tables, folder, kt, seed=seed).results


class Slipped:
    """A stored run whose encoder found its index half a turn further on."""

    def __init__(self, stored, counts):
        self.path, self.recipe, self.counts = stored.path, stored.recipe, counts
        self._stored = stored

    def recordings_named(self, prefix):
        return [self._slip(recording) for recording in self._stored.recordings_named(prefix)]

    def _slip(self, recording):
        added = {"encoder": self.counts, "position_setpoint": self.counts * 2 * math.pi / 4000}
        return SimpleNamespace(
            name=recording.name,
            size=recording.size,
            conditions=recording.conditions,
            condition=recording.condition,
            has=recording.has,
            read=lambda channel: recording.read(channel) + added.get(channel, 0.0),
        )


@pytest.fixture(scope="module")
def unchanged(turned, folder, kt):
    """Return a check of an unchanged rig, in which moves are stored."""
    tables, seed = turned
    outcome = check(tables, folder, kt, seed=seed)
    stored = folder / f"unchanged-{seed}.h5"
    (folder / "check.h5").rename(stored)
    return stored, outcome


@pytest.mark.parametrize("counts", [2000, 300])
def test_a_slip_of_the_index_is_reported_with_its_counts(turned, unchanged, kt, counts):
    tables, _ = turned
    with open_run(unchanged[0]) as stored, open_run(tables) as table, open_run(kt) as k:
        outcome = ilc_check.analyse([Slipped(stored, counts)], stored.recipe, tables=table, kt=k)
    verdict, found = outcome.notes[0], outcome.results["table_shift_counts"]
    assert not ilc_check.fits(outcome)
    assert "the same pattern, shifted by" in verdict
    assert "shifting the table by that is enough" in verdict
    assert ("half a turn" in verdict) == (counts == 2000)
    assert "friction has changed" not in verdict
    assert abs(math.remainder(found.value - counts, 4000)) < 4 * found.u
    assert found.u < 40


def test_an_instrument_is_checked_on_its_range(moved, folder, kt):
    tables, seed = moved
    same = check(tables, folder, kt, seed=seed)
    assert ilc_check.fits(same)
    power = check(tables, folder, kt, "virtual.power_cycle=1", seed=seed)
    assert not ilc_check.fits(power)
    assert "another shape" in power.notes[0]
    assert "a part of the turn does not show which" in power.notes[0]
    stiff = check(tables, folder, kt, "virtual.instrument.friction=12.6e-3", seed=seed)
    assert not ilc_check.fits(stiff)
    change = stiff.results["friction_change"]
    stated = f"{change.value * 1e3:+.2g} +- {change.u * 1e3:.1g} mN m"
    assert f"friction has changed by {stated}" in stiff.notes[0]
    assert stated.startswith("+2")
    assert "another shape" not in stiff.notes[0]


def test_stored_runs_are_checked_as_well(turned, unchanged, folder, kt):
    """A check's own run again, and the learning run itself, whose moves made the table."""
    (tables, _), (stored, first) = turned, unchanged
    again = check(tables, folder, kt, source=stored)
    for name, quantity in first.results.items():
        assert again.results[name].value == pytest.approx(quantity.value, rel=1e-9, abs=1e-15)
    itself = check(tables, folder, kt, source=tables)
    assert ilc_check.fits(itself)
    assert abs(itself.results["table_shift"].value) < 1e-3


def test_it_moves_in_short_as_was_learned(folder, kt):
    path = folder / "three.h5"
    speeds = "ilc_learn.turning.speeds_rev_per_s=[1, 2, 3]"
    run(ILC_LEARN, RECIPE, path, *TURNING, speeds, "ilc_learn.turning.revolutions=3", kt=kt)
    with open_run(path) as tables:
        options = ilc_check.as_learned(CommonOptions(), [str(RECIPE)], tables)
        recipe = load_recipe(RECIPE, [PULLEY, *options.overrides])[0]
        speeds = sorted({spec.conditions["speed"][0] for spec in ilc_check.recordings(recipe)})
        np.testing.assert_allclose(speeds, 2 * np.pi * np.array([-2, -1, 1, 2]), rtol=1e-9, atol=0)
        mine = CommonOptions(overrides=("ilc_learn.turning.revolutions=9",))
        chosen = ilc_check.as_learned(mine, [str(RECIPE)], tables)
        assert load_recipe(RECIPE, chosen.overrides)[0].ilc_learn.turning.revolutions == 9
        assert ilc_check.as_learned(mine, ["a.h5"], tables) is mine
        assert learned_table_from(tables).table.period is not None


@pytest.fixture(scope="module")
def friction(folder):
    return write_results(
        folder / "friction.h5",
        "stribeck",
        coulomb_friction=(2.3e-3, "N m"),
        viscous_friction=(5.33e-5, "N m s/rad"),
    )


def test_a_table_of_one_speed_is_checked_there_within_its_band(folder, kt, friction):
    path = folder / "one.h5"
    speeds = "ilc_learn.turning.speeds_rev_per_s=[1, 4]"
    one = ("ilc_learn.implementation=A", "ilc_learn.iterations=1")
    run(ILC_LEARN, RECIPE, path, *TURNING, speeds, *one, kt=kt, friction=friction)
    same = check(path, folder, kt)
    assert ilc_check.fits(same)
    assert same.tables["table_health"]["speed"] == pytest.approx([2 * np.pi], rel=1e-9)
    assert "friction_change" not in same.results
    power = check(path, folder, kt, "virtual.power_cycle=1")
    assert "another shape, as after a power cycle" in power.notes[0]


def test_friction_that_was_fed_forward_is_again(folder, kt, friction):
    path = folder / "compensated.h5"
    run(ILC_LEARN, RECIPE, path, *TURNING, kt=kt, friction=friction)
    assert ilc_check.fits(check(path, folder, kt))
    plain = folder / "plain.h5"
    run(ILC_LEARN, RECIPE, plain, *TURNING, kt=kt)
    with pytest.raises(RunFileError, match="was fed forward"):
        check(path, folder, kt, source=plain)


def test_what_cannot_be_compared_is_refused(turned, moved, folder, kt):
    (tables, _), (other, _) = turned, moved
    with pytest.raises(RunFileError, match="attachment instrument, the recipe has pulley"):
        check(other, folder, kt, PULLEY)
    with pytest.raises(RunFileError, match="rig briaire-2006, the recipe has another"):
        check(tables, folder, kt, "rig.name=another")
    with pytest.raises(RunFileError, match="was written by calibrate-kt"):
        check(kt, folder, kt)
    with pytest.raises(RunFileError, match="a run of ilc-check or ilc-learn is needed"):
        check(tables, folder, kt, source=kt)
    with pytest.raises(UsageError, match="--kt is missing"):
        run(ILC_CHECK, RECIPE, folder / "no.h5", PULLEY, tables=tables)
    assert not (folder / "no.h5").exists()
    with open_run(other) as range_, open_run(tables) as turns, open_run(kt) as k:
        recipe = load_recipe(RECIPE, [PULLEY])[0]
        with pytest.raises(InsufficientDataError, match="holds whole turns"):
            ilc_check.analyse([range_], recipe, tables=turns, kt=k)
