"""Learning on the virtual rig, from recipe to table and back from the file."""

import math
from types import SimpleNamespace
from typing import get_args

import numpy as np
import pytest

from rigtool.errors import InsufficientDataError, RecipeError, RunFileError, UsageError
from rigtool.experiments.force.procedure import PROCEDURE as MEASURE_FORCE
from rigtool.experiments.learning import procedure as ilc_learn
from rigtool.experiments.learning.procedure import PROCEDURE as ILC_LEARN
from rigtool.experiments.learning.stored_table import (
    feedforward_from,
    lookup_table_from,
    require_same_rig,
)
from rigtool.experiments.running.options import CommonOptions
from rigtool.experiments.torque_per_ampere import CONSTANT
from rigtool.recipe import load_recipe
from rigtool.recipe.commands import IlcLearn
from rigtool.runfile import Column, Table, open_run
from tests.experiments.virtual_runs import (
    COULOMB,
    QUIET,
    RECIPE,
    TORQUE_CONSTANT,
    VISCOUS,
    run,
    write_results,
)
from tests.thorough import first_of
from tests.unchanged import require_unchanged

PULLEY = "rig.attachment=pulley"
SHORT = (
    PULLEY,
    "ilc_learn.speeds_rev_per_s=[1, 5]",
    "ilc_learn.low_speeds_rev_per_s=[0.5]",
    "ilc_learn.moves=3",
)


@pytest.fixture(scope="module")
def learned(folder, kt):
    """A short run on the thesis's rig: its path and outcome."""
    path = folder / "tables.h5"
    return path, run(ILC_LEARN, RECIPE, path, *SHORT, kt=kt)


@pytest.fixture(scope="module")
def compensated(folder, kt, friction):
    """Learned on a rig of friction only, which is fed forward: nothing is left to learn."""
    path = folder / "compensated.h5"
    return path, run(ILC_LEARN, RECIPE, path, *SHORT, *QUIET, kt=kt, friction=friction)


def test_no_other_number_has_changed(learned, compensated):
    require_unchanged("C", learned[1])
    require_unchanged("C-compensated", compensated[1])


def test_little_remains_of_the_disturbance(learned):
    """[7.2.4.2]: below 1 mN m at all learned speeds."""
    _, outcome = learned
    assert outcome.results["residual_peak"].value < 1e-3
    assert outcome.results["reduction"].value > 0.9
    assert 0 < outcome.results["convergence_peak"].value < 1
    table = outcome.tables["residual_by_speed"]
    expected = 2 * np.pi * np.array([-5, -1, 1, 5])
    np.testing.assert_allclose(table["speed"], expected, rtol=1e-12, atol=0)
    assert (table["before_peak"] > 2e-3).all()
    assert outcome.results["residual_peak"].value == table["residual_peak"].max()
    for name in ("residual_peak", "residual_rms", "reduction"):
        assert outcome.results[name].u > 0
        assert outcome.results[name].dof == 2


@pytest.mark.parametrize("seed", first_of([7, 8]))
def test_other_rigs_learn_as_well(folder, kt, seed):
    outcome = run(
        ILC_LEARN,
        RECIPE,
        folder / f"seed-{seed}.h5",
        *SHORT,
        "virtual.motor.coulomb_friction=4e-3",
        "rig.encoder_counts=8192",
        seed=seed,
        kt=kt,
    )
    assert outcome.results["residual_peak"].value < 1e-3
    assert outcome.results["reduction"].value > 0.9


def test_the_table_is_the_friction_that_is_there(folder, kt):
    """Without ripple the learned torque is Coulomb + viscous friction at any position."""
    outcome = run(ILC_LEARN, RECIPE, folder / "quiet.h5", *SHORT, *QUIET, kt=kt)
    lookup = outcome.tables["lookup"]
    speed = lookup["speed"][:, None]
    expected = COULOMB * np.sign(speed) + VISCOUS * speed
    inner = slice(200, -200)  # away from the reversals
    off = lookup["torque"][:, inner] - expected
    # What the encoder's counts do to the torque repeats too: they beat with the sampling.
    assert np.sqrt(np.mean(off**2)) < 0.15e-3
    np.testing.assert_allclose(
        lookup["torque"][:, inner].mean(axis=1), expected[:, 0], rtol=0.01, atol=0
    )
    # Friction at half the lowest speed: nearly the Coulomb part
    factor = (COULOMB + VISCOUS * np.pi) / (COULOMB + VISCOUS * 2 * np.pi)
    assert outcome.tables["amplitude"]["amplitude"][1] == pytest.approx(factor, rel=0.01, abs=0)


def test_one_entry_a_quad_count_over_the_constant_speed(learned):
    lookup = learned[1].tables["lookup"]
    counts = lookup["position"] * 4000 / (2 * np.pi)
    np.testing.assert_allclose(
        counts, np.arange(math.ceil(20 / 0.09), math.floor(160 / 0.09) + 1), rtol=1e-12, atol=0
    )
    assert lookup["torque"].shape == lookup["u"].shape == (4, len(counts))
    assert (lookup["u"] > 0).all()
    valid = learned[1].tables["residual_waveforms"]["position"] * 180 / np.pi
    assert (valid.min(), valid.max()) == pytest.approx((45, 135), rel=0, abs=0.09)


def test_the_stored_moves_give_the_same_again(learned, folder, kt):
    path, outcome = learned
    again = run(ILC_LEARN, path, folder / "again.h5", kt=kt)
    assert again.results == outcome.results
    np.testing.assert_array_equal(
        again.tables["lookup"]["torque"], outcome.tables["lookup"]["torque"]
    )
    with open_run(path) as stored:
        table = lookup_table_from(stored)
    np.testing.assert_array_equal(table.torque, outcome.tables["lookup"]["torque"])
    np.testing.assert_array_equal(table.amplitude, outcome.tables["amplitude"]["amplitude"])


def test_currents_are_those_that_were_learned_whatever_a_later_calibration_states(
    learned, folder, kt
):
    """The table and the loop make current with the constant that the table was learned with."""
    assert learned[1].results[CONSTANT].value == pytest.approx(TORQUE_CONSTANT, rel=1e-12)
    other = write_results(
        folder / "other.h5",
        "calibrate-kt",
        torque_constant_mean=(0.92 * TORQUE_CONSTANT, "N m/A"),
        amplifier_gain=(1.0, "1"),
    )
    short = (PULLEY, "measure_force.cycles=3", "measure_force.forces=[1]")
    signals = []
    for number, calibration in enumerate((kt, other)):
        path = folder / f"force-{number}.h5"
        found = run(MEASURE_FORCE, RECIPE, path, *short, kt=calibration, tables=learned[0])
        with open_run(path) as stored:
            recorded = stored.recordings["load_001"]
            signals.append([recorded.read(name) for name in ("table_current", "encoder")])
    assert np.ptp(signals[0][0]) > 0
    np.testing.assert_array_equal(signals[1][0], signals[0][0])
    np.testing.assert_array_equal(signals[1][1], signals[0][1])
    assert any("turned into the currents that were learned" in note for note in found.notes)


def test_another_filter_is_distinguished_from_the_one_that_was_recorded(learned, folder, kt):
    path, outcome = learned
    other = run(ILC_LEARN, path, folder / "other.h5", "ilc_learn.robustness_hz=20", kt=kt)
    assert any("residual belongs to the recorded one" in note for note in other.notes)
    assert not any("residual belongs" in note for note in outcome.notes)


def test_the_table_is_the_recorded_one_however_coarse_the_samples(folder, kt):
    """A loop of 1 ms passes a table of 400 counts in steps over which it bends."""
    coarse = "rig.sample_time=1e-3", "rig.encoder_counts=400", "rig.controller.crossover_hz=20"
    outcome = run(ILC_LEARN, RECIPE, folder / "coarse.h5", *SHORT, *coarse, kt=kt)
    assert not any("residual belongs" in note for note in outcome.notes)


def test_friction_that_is_fed_forward_is_not_learned(compensated):
    path, outcome = compensated
    left = outcome.tables["lookup"]["torque"][:, 200:-200]
    assert np.sqrt(np.mean(left**2)) < 0.2e-3  # the scatter of one cycle
    np.testing.assert_allclose(left.mean(axis=1), 0, rtol=0, atol=0.02e-3)
    with open_run(path) as stored:
        used = feedforward_from(stored, 1e-5)
    assert (used.inertia, used.coulomb, used.viscous) == (1e-5, COULOMB, VISCOUS)
    assert used.table is not None


def test_a_table_belongs_to_the_friction_fed_forward(compensated, learned, folder, kt, friction):
    with pytest.raises(RunFileError, match="are expected without --friction"):
        run(ILC_LEARN, compensated[0], folder / "no.h5", kt=kt)
    with pytest.raises(RunFileError, match="friction of 0 mN m was fed forward"):
        run(ILC_LEARN, learned[0], folder / "no.h5", kt=kt, friction=friction)
    assert not (folder / "no.h5").exists()


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("ilc_learn.cancel_radius=0.5", "does not converge"),
        ("rig.current_limit=0.1", "saturates"),
        ("rig.controller.integrator_hz=200", "unstable"),
        ("rig.encoder_counts=1000", "off its set point"),
    ],
)
def test_what_cannot_be_learned_from_is_refused(learned, folder, kt, override, message):
    """Stored signals against settings under which they mean nothing."""
    path = learned[0]
    with open_run(path) as stored:
        recipe = load_recipe(RECIPE, [*SHORT, override])[0]
        with open_run(kt) as constant, pytest.raises(InsufficientDataError, match=message):
            ilc_learn.analyse([stored], recipe, kt=constant)


def test_learning_that_cannot_converge_does_not_even_move(folder, kt):
    output = folder / "refused.h5"
    with pytest.raises(InsufficientDataError, match="must be below 1"):
        run(ILC_LEARN, RECIPE, output, *SHORT, "ilc_learn.cancel_radius=0.5", kt=kt)
    assert not output.exists()
    assert not output.with_name("refused.h5.part").exists()


def test_more_moves_than_were_recorded_are_refused(learned, kt):
    recipe = load_recipe(RECIPE, [*SHORT, "ilc_learn.moves=9"])[0]
    with (
        open_run(learned[0]) as stored,
        open_run(kt) as constant,
        pytest.raises(InsufficientDataError, match=r"learn_000: 3 whole moves.* 9 are needed"),
    ):
        ilc_learn.analyse([stored], recipe, kt=constant)


def test_inputs_that_do_not_fit_are_refused(learned, folder, kt, friction):
    with open_run(learned[0]) as stored, open_run(kt) as constant:
        with pytest.raises(UsageError, match="takes one"):
            ilc_learn.analyse([stored, stored], stored.recipe, kt=constant)
        with pytest.raises(RunFileError, match="no recording 'learn_000'"):
            ilc_learn.analyse([constant], stored.recipe, kt=constant)
        with pytest.raises(RunFileError, match="calibrate-kt"):
            ilc_learn.analyse([stored], stored.recipe, kt=stored)
        with pytest.raises(RunFileError, match="stribeck"):
            ilc_learn.analyse([stored], stored.recipe, kt=constant, friction=constant)


@pytest.mark.parametrize(
    ("name", "validate", "expected"),
    [
        (None, False, ("rig.name=mine",)),
        ("C", False, ("rig.name=mine", "ilc_learn.implementation=C")),
        (None, True, ("rig.name=mine", "ilc_learn.validation=true")),
    ],
)
def test_the_command_line_chooses_before_the_recipe(name, validate, expected):
    """A motor that has to turn freely takes the pulley unless the attachment is given."""
    given = CommonOptions(overrides=("rig.name=mine",))
    assert ilc_learn.asked(given, name, validate=validate).overrides == expected
    bare = ilc_learn.asked(given, "A", validate=validate).overrides
    assert bare[:3] == ("rig.attachment=pulley", "rig.name=mine", "ilc_learn.implementation=A")


def test_every_letter_of_the_recipe_has_its_implementation():
    letters = get_args(IlcLearn.model_fields["implementation"].annotation)
    assert set(ilc_learn.IMPLEMENTATIONS) == set(letters)
    with pytest.raises(RecipeError, match=r"ilc_learn\.implementation"):
        load_recipe(RECIPE, ["ilc_learn.implementation=Z"])


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("ilc_learn.low_speeds_rev_per_s=[0.1, 0.3]", "below the lowest of speeds_rev_per_s, 0.2"),
        ("ilc_learn.speeds_rev_per_s=[1, 1]", "listed twice"),
        ("ilc_learn.turn_angle=50", "below end_angle"),
        ("ilc_learn.end_angle=90", "leaves nothing"),
    ],
)
def test_settings_that_contradict_each_other_are_mistakes(setting, message):
    with pytest.raises(RecipeError, match=message):
        load_recipe(RECIPE, [setting])


def test_tables_fit_the_rig_they_were_learned_on(learned):
    recipe = load_recipe(RECIPE, [PULLEY])[0]
    with open_run(learned[0]) as tables:
        require_same_rig(tables, recipe)


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("rig.name=another", "rig briaire-2006, the recipe has another"),
        ("rig.attachment=instrument", "attachment pulley, the recipe has instrument"),
        ("rig.encoder_counts=2000", "encoder 4000, the recipe has 2000"),
        ("measure_force.speed_rev_per_s=6", "learned up to 31.42 rad/s"),
        ("measure_force.turn_angle=10", "learned from 20.07 to 159.9 deg"),
        ("measure_force.angle=200", "uses 20 to 180 deg"),
    ],
)
def test_tables_of_another_rig_are_refused(learned, override, message):
    recipe = load_recipe(RECIPE, [PULLEY, override])[0]
    with open_run(learned[0]) as tables, pytest.raises(RunFileError, match=message):
        require_same_rig(tables, recipe)


def test_tables_of_one_direction_are_refused(learned):
    recipe = load_recipe(RECIPE, [PULLEY])[0]
    with open_run(learned[0]) as tables:
        whole = tables.table("lookup")
        columns = {
            name: Column(column.values if name == "position" else column.values[2:], column.unit)
            for name, column in whole.columns.items()
        }
        half = {"lookup": Table(whole.axes, columns, whole.signal, "")}
        stand_in = SimpleNamespace(
            path=tables.path,
            recipe=tables.recipe,
            results=tables.results,
            tables=tables.tables,
            require_command=tables.require_command,
            table=lambda name, *_, **__: half.get(name) or tables.table(name),
        )
        with pytest.raises(RunFileError, match="nothing for the negative direction"):
            require_same_rig(stand_in, recipe)


def test_a_run_without_a_recipe_is_no_table(kt):
    recipe = load_recipe(RECIPE, [PULLEY])[0]
    with open_run(kt) as other, pytest.raises(RunFileError, match="ilc-learn"):
        require_same_rig(other, recipe)


def test_a_broken_table_is_refused(learned):
    with open_run(learned[0]) as tables:
        whole = tables.table("lookup")
        columns = {**whole.columns, "speed": Column(whole["speed"][::-1], "rad/s")}
        broken = {"lookup": Table(whole.axes, columns, whole.signal, "")}
        stand_in = SimpleNamespace(
            path=tables.path,
            results=tables.results,
            tables=tables.tables,
            require_command=tables.require_command,
            table=lambda name, *_, **__: broken.get(name) or tables.table(name),
        )
        with pytest.raises(RunFileError, match="must rise"):
            lookup_table_from(stand_in)


@pytest.mark.parametrize(("asked", "name"), [("D", "A"), ("D", "C"), ("B", "C"), ("C", "B")])
def test_a_run_of_one_implementation_is_not_analysed_as_another(asked, name):
    recipe, _ = load_recipe(RECIPE, [f"ilc_learn.implementation={name}"])
    with pytest.raises(UsageError, match=f"{asked}: c.h5 was recorded with implementation {name}"):
        ilc_learn.of_stored(asked).analyse([SimpleNamespace(path="c.h5")], recipe, kt=None)


def test_a_run_of_an_implementation_is_analysed_with_all_that_was_given(monkeypatch):
    given = {"kt": object(), "friction": object(), "plant": None}
    monkeypatch.setattr(ilc_learn, "analyse", lambda runs, recipe, **inputs: (runs, inputs))
    recipe, _ = load_recipe(RECIPE, ["ilc_learn.implementation=B"])
    assert ilc_learn.of_stored("B").analyse(["run"], recipe, **given) == (["run"], given)


@pytest.mark.parametrize("name", get_args(IlcLearn.model_fields["implementation"].annotation))
def test_d_alone_learns_from_imported_runs_with_known_loads(name):
    """Others make a map of the turn from them."""
    own = ilc_learn.of_stored(name)
    if name == "D":
        assert own.analyse_imported is not ILC_LEARN.analyse_imported
        assert own.imported_settings == {"measure_force.lowpass_hz": "bandwidth_hz"}
    else:
        assert own.analyse_imported is ILC_LEARN.analyse_imported
        assert own.imported_settings == ILC_LEARN.imported_settings
