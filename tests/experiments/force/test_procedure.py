"""measure-force on a rig whose truth is known exactly, and on the virtual rig."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from rigtool.control.lookup_table import LookupTable
from rigtool.errors import InsufficientDataError, RunFileError, UsageError
from rigtool.experiments.force import procedure as measure_force
from rigtool.experiments.force.procedure import PROCEDURE as MEASURE_FORCE
from rigtool.experiments.learning.rows import Amplitudes
from rigtool.experiments.learning.stored_table import tables_of
from rigtool.experiments.outcome import Outcome
from rigtool.experiments.running.options import CommonOptions
from rigtool.experiments.running.session import run_command
from rigtool.quantity import Quantity
from rigtool.recipe import Recipe, load_recipe
from rigtool.rigs import Block, Task
from rigtool.runfile import Run, RunWriter, open_run, recording
from tests.unchanged import require_unchanged

RECIPE = Path(__file__).parents[3] / "recipes" / "briaire-2006.toml"
SHORT = (
    "measure_force.forces=[0.25, 2.5]",
    "measure_force.cycles=6",
    "measure_force.extra_cycles=2",
)
PULLEY = "rig.attachment=pulley"
CONSTANT = 45.4e-3


def recipe_with(*sets: str) -> Recipe:
    return load_recipe(RECIPE, (*SHORT, *sets))[0]


class KnownRig:
    """Torque by formula: load with friction and a spring, scatter by cycle; nothing else."""

    def __init__(self, recipe: Recipe, *, friction: float, stiffness: float, scatter: float):
        self.recipe, self.friction, self.stiffness = recipe, friction, stiffness
        self.scatter = scatter
        self.deviations = np.random.default_rng(4).standard_normal
        self.setpoint_error = 0.0
        self.offset = 0.0

    def perform(self, task: Task) -> Iterator[Block]:
        rig, motion = self.recipe.rig, task.motion
        time = np.arange(0, motion.duration, rig.sample_time * task.record_every)
        position, speed, acceleration = motion.setpoint(time)
        fed = task.feedforward.inertia * acceleration
        table = task.feedforward.table.evaluate(position, speed)
        load = self._load(task.load.force, position / rig.angle_ratio, speed)
        stroke = np.floor(time / (2 * motion.stroke_time)).astype(int)
        deviation = self.scatter * self.deviations(stroke.max() + 1)
        controller = (load + deviation[stroke] + self.offset) / rig.torque_factor
        # The controller also brings what was fed forward; a perfect table leaves nothing of it.
        yield {
            "time": time,
            "position_setpoint": position + self.setpoint_error,
            "encoder": position * rig.encoder_counts / (2 * math.pi),
            "current_setpoint": (controller + fed + table) / CONSTANT,
            "feedforward_current": fed / CONSTANT,
            "table_current": table / CONSTANT,
            "temperature": np.full(time.size, 27.0),
        }

    def _load(self, force: float, angle: np.ndarray, speed: np.ndarray) -> np.ndarray:
        moment = force * self.recipe.rig.load_arm
        if self.recipe.rig.attachment == "pulley":
            return np.full(angle.size, moment)
        factor = 1 + self.friction * np.sign(speed)
        twist = np.zeros(angle.size)
        for _ in range(100):
            before, twist = twist, moment * np.sin(angle - twist / self.stiffness)
            if np.array_equal(twist, before):
                break
        return factor * twist


@pytest.fixture(scope="module")
def inputs(tmp_path_factory) -> Iterator[Callable[..., dict[str, Run]]]:
    """Write and open a calibration and learned tables for a recipe, once for all tests."""
    folder, known = tmp_path_factory.mktemp("inputs"), {}
    with ExitStack() as stack:

        def write(command: str, recipe: Recipe, results, tables, used=()) -> Run:
            path = folder / f"{command}-{len(list(folder.iterdir()))}.h5"
            with RunWriter(
                path, command=command, recipe=recipe, recipe_text="", inputs=used
            ) as writer:
                writer.finish(results, tables)
            return stack.enter_context(open_run(path))

        def make(
            recipe: Recipe, torque_constant: float = CONSTANT, ripple: float = 0.0
        ) -> dict[str, Run]:
            calibration = {
                "torque_constant_mean": Quantity(torque_constant, "N m/A", 1e-3 * torque_constant),
                "amplifier_gain": Quantity(1.0, "1", 0.0),
                "torque_constant_ripple": Quantity(ripple, "1", 0.25 * ripple, 7.0),
            }
            kt = write("calibrate-kt", recipe, calibration, {})
            speed = 2 * math.pi * recipe.rig.angle_ratio * np.array([-0.2, 0.2])
            count = 2 * math.pi / recipe.rig.encoder_counts
            position = np.arange(0, round(math.pi * recipe.rig.angle_ratio / count) + 1) * count
            torque = np.sign(speed)[:, None] * (12e-3 + 1e-3 * np.sin(position))
            low, amplitude = np.array([0, speed[1]]), np.array([0.0, 1.0])
            table = LookupTable(position, speed, torque, low, amplitude)
            u = np.full(torque.shape, 0.05e-3)
            lookup = tables_of(
                table, u, Amplitudes.fading(low[-1]), np.full(len(table.speed), np.inf)
            )
            return {"kt": kt, "tables": write("ilc-learn", recipe, {}, lookup, [kt])}

        def made(recipe: Recipe, *given: float, **more: float) -> dict[str, Run]:
            key = (recipe.model_dump_json(), given, *more.items())
            if key not in known:
                known[key] = make(recipe, *given, **more)
            return known[key]

        yield made


def measured(tmp_path: Path, rig: KnownRig, inputs: dict[str, Run]) -> tuple[Outcome, Path]:
    recipe, path = rig.recipe, tmp_path / "force.h5"
    plan = measure_force.recordings(recipe)
    with RunWriter(
        path,
        command="measure-force",
        recipe=recipe,
        recipe_text="",
        recordings=plan,
        inputs=list(inputs.values()),
    ) as writer:
        measure_force.measure(rig, recipe, writer, **inputs)
        outcome = measure_force.analyse([writer.recorded()], recipe, **inputs)
        writer.finish(outcome.results, outcome.tables, outcome.notes)
    return outcome, path


def test_every_load_is_recorded_and_two_more_with_the_instrument():
    names = [spec.name for spec in measure_force.recordings(recipe_with())]
    assert names == ["load_000", "load_001", "load_002", "hysteresis", "shift"]
    names = [spec.name for spec in measure_force.recordings(recipe_with(PULLEY))]
    assert names == ["load_000", "load_001", "load_002"]


def test_a_stiff_pulley_without_friction_reads_what_hangs_on_it(tmp_path, inputs):
    recipe = recipe_with(PULLEY)
    rig = KnownRig(recipe, friction=0, stiffness=1, scatter=0.1e-3)
    outcome, _ = measured(tmp_path, rig, inputs(recipe))
    loads = outcome.tables["loads"]
    np.testing.assert_allclose(loads["applied_force"], [0, 0.25, 2.5], rtol=1e-12, atol=0)
    np.testing.assert_allclose(loads["applied_torque"], [0, 3.5e-3, 35e-3], rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(loads["error_torque"], 0, rtol=0, atol=0.15e-3)
    assert (np.abs(loads["error_torque"]) < 4 * loads["mean_torque_u"]).all()
    assert (loads["std_torque"] > 0.03e-3).all()
    assert (loads["std_torque"] < 0.25e-3).all()
    assert "lifting_torque" not in outcome.results
    require_unchanged("known-pulley", outcome)


def test_torque_below_zero_has_an_uncertainty_above_it(tmp_path, inputs):
    """As where a spring pulls harder than the load, or somebody wired the motor the other way."""
    recipe = recipe_with()
    rig = KnownRig(recipe, friction=0.09, stiffness=0.2, scatter=0.1e-3)
    rig.offset = -0.2
    results = measured(tmp_path, rig, inputs(recipe))[0].results
    assert results["lifting_torque"].value == pytest.approx(1.09 * 60e-3 - 0.2, rel=0.01)
    # The torque constant is known to 0.1 %.
    assert results["lifting_torque"].u == pytest.approx(0.1346e-3, rel=0.2)


def test_the_instrument_gives_friction_and_stiffness_back(tmp_path, inputs):
    recipe = recipe_with()
    rig = KnownRig(recipe, friction=0.09, stiffness=0.2, scatter=1e-6)
    outcome, _ = measured(tmp_path, rig, inputs(recipe))
    results = outcome.results
    assert results["lifting_torque"].value == pytest.approx(1.09 * 60e-3, rel=0.01)
    assert results["lowering_torque"].value == pytest.approx(0.91 * 60e-3, rel=0.01)
    assert results["load_friction"].value == pytest.approx(0.09 * 60e-3, rel=0.02)
    assert results["peak_angle_shift"].value == pytest.approx(0.5, rel=0.02)
    assert results["peak_shift_counts"].value == pytest.approx(0.5 / math.pi * 1700, rel=0.02)
    assert results["stiffness"].value == pytest.approx(0.2, rel=0.02)
    assert results["stiffness"].reason is not None
    require_unchanged("known-instrument", outcome)
    twist = 0.05
    for _ in range(100):
        twist = 0.05 * math.sin(math.pi / 2 - twist / 0.2)
    assert outcome.tables["loads"]["mean_torque"][2] == pytest.approx(1.09 * twist, rel=2e-3)


def test_uncertainty_holds_scatter_constant_and_table(tmp_path, inputs):
    recipe = recipe_with("measure_force.zero=false")
    rig = KnownRig(recipe, friction=0, stiffness=1e3, scatter=0.3e-3)
    outcome, _ = measured(tmp_path, rig, inputs(recipe))
    loads = outcome.tables["loads"]
    scatter = loads["std_torque"] / np.sqrt(loads["effective_cycles"])
    others = np.hypot(1e-3 * loads["mean_torque"], 1.18 * 0.05e-3)
    np.testing.assert_allclose(loads["mean_torque_u"], np.hypot(scatter, others), rtol=1e-6, atol=0)
    assert (loads["mean_torque_dof"] >= loads["effective_cycles"] - 1 - 1e-9).all()


def test_uncertainty_holds_the_ripple_of_the_torque_constant(tmp_path, inputs):
    recipe = recipe_with(PULLEY)
    rig = KnownRig(recipe, friction=0, stiffness=1, scatter=1e-6)
    outcome, _ = measured(tmp_path, rig, inputs(recipe, ripple=0.01))
    loads = outcome.tables["loads"]
    assert loads["mean_torque_u"][2] == pytest.approx(35e-3 * math.hypot(0.01, 1e-3), rel=1e-3)
    assert loads["mean_torque_dof"][2] == pytest.approx(7, rel=0.05)
    require_unchanged("known-ripple", outcome)


def test_a_zero_reading_takes_off_what_remains_without_load(tmp_path, inputs):
    recipe = recipe_with("measure_force.zero=true")
    rig = KnownRig(recipe, friction=0, stiffness=1e3, scatter=0.3e-3)
    outcome, _ = measured(tmp_path, rig, inputs(recipe))
    loads, values = outcome.tables["loads"], outcome.tables["values"]["torque"]
    zero = values[0].mean()
    np.testing.assert_allclose(
        loads["mean_torque"][1:], values[1:].mean(axis=1) - zero, rtol=1e-9, atol=0
    )
    assert loads["mean_torque"][0] == pytest.approx(zero, rel=1e-9)
    require_unchanged("known-zero", outcome)
    # The table's error is in the zero reading too: its scatter counts instead.
    scatter = loads["std_torque"] / np.sqrt(loads["effective_cycles"])
    expected = np.sqrt(scatter[1:] ** 2 + scatter[0] ** 2 + (1e-3 * loads["mean_torque"][1:]) ** 2)
    np.testing.assert_allclose(loads["mean_torque_u"][1:], expected, rtol=1e-6, atol=0)
    parts = scatter**4 / (loads["effective_cycles"] - 1)
    dof = expected**4 / (parts[1:] + parts[0])  # Welch and Satterthwaite; the constant is known
    np.testing.assert_allclose(loads["mean_torque_dof"][1:], dof, rtol=1e-6, atol=0)


def test_tables_for_the_figures(tmp_path, inputs):
    recipe = recipe_with()
    rig = KnownRig(recipe, friction=0.09, stiffness=0.2, scatter=0.1e-3)
    outcome, _ = measured(tmp_path, rig, inputs(recipe))
    tables = outcome.tables
    position = tables["feedforward"]["position"]
    np.testing.assert_allclose(position, np.linspace(0, 3400, 341), atol=1e-9)
    for name in ("cycles_no_load", "mean_cycles"):
        np.testing.assert_array_equal(tables[name]["position"], position)
    assert tables["feedforward"]["torque"][85] == pytest.approx(12e-3 + 1e-3, rel=0.05)
    assert tables["feedforward"]["torque"][255] == pytest.approx(-13e-3, rel=0.05)
    assert tables["cycles_no_load"].shape == (6, 341)
    last = tables["cycles_no_load"]["torque"][-1] / recipe.rig.torque_factor
    np.testing.assert_allclose(tables["feedforward"]["residual"], last, rtol=1e-12)
    mean = tables["cycles_no_load"]["torque"].mean(axis=0)
    np.testing.assert_allclose(tables["mean_cycles"]["torque"][0], mean, rtol=1e-12)
    assert tables["values"].shape == (3, 6)
    mean = np.mean(tables["values"]["torque"], axis=1)
    np.testing.assert_allclose(mean[0], tables["loads"]["mean_torque"][0], rtol=1e-9)
    np.testing.assert_allclose(
        tables["hysteresis"]["applied"], 60e-3 * np.sin(np.pi * np.arange(171) / 170), atol=1e-12
    )


def test_a_stored_run_gives_the_same_again(tmp_path, inputs):
    recipe = recipe_with()
    rig = KnownRig(recipe, friction=0.09, stiffness=0.2, scatter=0.1e-3)
    given = inputs(recipe)
    outcome, path = measured(tmp_path, rig, given)
    again = run_command(
        MEASURE_FORCE,
        [str(path)],
        str(tmp_path / "again.h5"),
        options=CommonOptions(),
        inputs=given,
    )
    assert again.results == outcome.results
    assert again.notes == outcome.notes
    for name, table in outcome.tables.items():
        for column, values in table.columns.items():
            np.testing.assert_array_equal(again.tables[name][column], values.values)


def test_a_load_without_a_peak_costs_its_results_only(tmp_path, inputs):
    recipe = recipe_with()
    rig = KnownRig(recipe, friction=0.09, stiffness=0.05, scatter=0.1e-3)
    outcome, _ = measured(tmp_path, rig, inputs(recipe))
    assert "stiffness" not in outcome.results
    assert "shift" in outcome.tables
    assert any(
        note.startswith("no result: recording shift: the torque has no peak")
        for note in outcome.notes
    )


def test_a_load_that_saturates_costs_its_results_only(tmp_path, inputs):
    recipe = recipe_with("rig.current_limit=1.7")
    rig = KnownRig(recipe, friction=0.09, stiffness=0.2, scatter=0.1e-3)
    outcome, _ = measured(tmp_path, rig, inputs(recipe))
    assert "lifting_torque" in outcome.results
    assert "stiffness" not in outcome.results
    assert any("recording shift: the current set point reaches" in n for n in outcome.notes)


def test_readings_that_are_not_normal_are_remarked(tmp_path, inputs):
    recipe = recipe_with(PULLEY, "measure_force.cycles=12")
    rig = KnownRig(recipe, friction=0, stiffness=1, scatter=0.1e-3)
    rig.deviations = lambda count: 1.0 * (np.arange(count) == 3)
    outcome, _ = measured(tmp_path, rig, inputs(recipe))
    assert any("not normally distributed" in note for note in outcome.notes)


@pytest.mark.parametrize(
    ("sets", "message"),
    [
        (("rig.name=other",), "calibration of rig other"),
        ((PULLEY,), "attachment pulley"),
        (("rig.encoder_counts=2000",), "encoder 2000"),
    ],
)
def test_inputs_of_another_rig_are_refused(tmp_path, inputs, sets, message):
    recipe = recipe_with()
    rig = KnownRig(recipe, friction=0, stiffness=1, scatter=0)
    with pytest.raises(RunFileError, match=message):
        measured(tmp_path, rig, inputs(recipe_with(*sets)))
    assert not (tmp_path / "force.h5").exists()


def test_tables_of_another_calibration_are_remarked(tmp_path, inputs):
    recipe = recipe_with(PULLEY)
    rig = KnownRig(recipe, friction=0, stiffness=1, scatter=0.1e-3)
    ours, theirs = inputs(recipe), inputs(recipe, 44e-3)
    outcome, _ = measured(tmp_path, rig, {"kt": ours["kt"], "tables": theirs["tables"]})
    (note,) = (note for note in outcome.notes if "another calibration" in note)
    assert "currents are not those that were learned" in note  # the tables state no constant


def test_a_saturated_current_is_refused(tmp_path, inputs):
    recipe = recipe_with(PULLEY, "rig.current_limit=0.5")
    rig = KnownRig(recipe, friction=0, stiffness=1, scatter=0.1e-3)
    with pytest.raises(InsufficientDataError, match="load_002: the current set point reaches"):
        measured(tmp_path, rig, inputs(recipe))


def test_a_rotor_far_from_its_set_point_is_refused(tmp_path, inputs):
    recipe = recipe_with(PULLEY)
    rig = KnownRig(recipe, friction=0, stiffness=1, scatter=0.1e-3)
    rig.setpoint_error = 0.2
    with pytest.raises(InsufficientDataError, match=r"up to 0\.2 rad off its set point"):
        measured(tmp_path, rig, inputs(recipe))


def test_two_run_files_are_refused(inputs):
    recipe = recipe_with()
    with pytest.raises(UsageError, match="2 run files"):
        measure_force.analyse([None, None], recipe, **inputs(recipe))


def test_signals_at_the_full_rate_give_what_averaged_ones_give(tmp_path, inputs):
    found = []
    for every in (16, 1):
        recipe = recipe_with(
            f"measure_force.record_every={every}", "measure_force.cycles=3", "rig.sample_time=5e-4"
        )
        rig = KnownRig(recipe, friction=0.09, stiffness=0.2, scatter=0.1e-3)
        (tmp_path / str(every)).mkdir()
        found.append(measured(tmp_path / str(every), rig, inputs(recipe))[0])
    few, all_samples = (outcome.tables["loads"] for outcome in found)
    for column in ("mean_torque", "std_torque", "mean_torque_u"):
        np.testing.assert_allclose(
            all_samples[column], few[column], rtol=0, atol=0.01 * few["mean_torque_u"].min()
        )


def test_a_clock_that_stands_between_two_blocks_is_refused(tmp_path, inputs, monkeypatch):
    monkeypatch.setattr(recording, "BLOCK_SAMPLES", 1000)
    recipe = recipe_with(PULLEY)
    rig = KnownRig(recipe, friction=0, stiffness=1, scatter=0.1e-3)
    perform = rig.perform

    def stuck(task):
        for block in perform(task):
            block["time"][1000:] -= block["time"][1000] - block["time"][999]
            yield block

    rig.perform = stuck
    with pytest.raises(InsufficientDataError, match="load_000: time does not rise at sample 1000"):
        measured(tmp_path, rig, inputs(recipe))


@pytest.mark.parametrize("current", [0.0, 1.0, 2.5, 4.0])
def test_ripple_that_grows_with_the_current_is_smaller_at_small_currents(current):
    """Two parts, one in proportion to the current, with phases that have nothing in common."""
    low, grown = 0.003, 0.008
    sizes = {
        "torque_constant_ripple_small_current": low,
        "torque_constant_ripple": math.hypot(low, grown),
    }
    calibration = SimpleNamespace(
        results=sizes,
        tables={"hysteresis": None},
        result=lambda name, unit: Quantity(sizes[name], unit, 0.0),
        table=lambda name, *axes, **units: {"current": np.array([0.0, 2.0, 4.0])},
    )
    found = measure_force._ripple_part(calibration)(current) * math.hypot(low, grown)
    assert found == pytest.approx(math.hypot(low, grown * current / 4), rel=1e-12)
    sizes.pop("torque_constant_ripple_small_current")
    assert measure_force._ripple_part(calibration)(current) == 1.0
