"""On stored runs only settings of the analysis may change; all others are refused by name."""

import json
from contextlib import ExitStack
from pathlib import Path

import pytest
from pydantic import BaseModel

from rigtool.cli import main
from rigtool.errors import RigtoolError, UsageError
from rigtool.experiments.force.procedure import PROCEDURE as MEASURE_FORCE
from rigtool.experiments.force_sensor.procedure_over_time import over_time
from rigtool.experiments.friction.procedure import PROCEDURE as STRIBECK
from rigtool.experiments.learning.check.procedure import PROCEDURE as ILC_CHECK
from rigtool.experiments.learning.procedure import PROCEDURE as ILC_LEARN
from rigtool.experiments.ripple.procedure import PROCEDURE as FFT_RIPPLE
from rigtool.experiments.running.dry_run import rehearse
from rigtool.experiments.suspension.procedure import PROCEDURE as SUSPENSION
from rigtool.experiments.torque_constant.procedure import PROCEDURE as CALIBRATE_KT
from rigtool.recipe import load_recipe, override_recipe
from rigtool.runfile import open_run
from tests.experiments.virtual_runs import RECIPE, run

FIXTURES = Path(__file__).parents[2] / "fixtures"
KT, TABLES, FORCE = (FIXTURES / f"{name}.h5" for name in ("kt", "tables", "force"))

OTHER = {
    "calibrate_kt.settle_time": 0.2,
    "calibrate_kt.reference_range_degc": [22, 33],
    "rig.arm.length_u": 1e-3,
    "rig.arm.gauge_relative_u": 1e-3,
    "rig.arm.gauge_linearity": 1e-3,
    "rig.thermometer_u": 0.3,
    "rig.current_reading_relative_u": 1e-3,
    "rig.weights_relative_u": 1e-3,
    "suspension.speeds_rev_per_s": [0.3],
    "rig.suspension.elasticity_relative_u": 0.1,
    "rig.suspension.dimension_u": 1e-3,
    "rig.suspension.thickness_u": 1e-4,
    "ilc_learn.robustness_hz": 50,
    "ilc_learn.robustness_order": 2,
    "ilc_learn.learning_factor": 0.5,
    "ilc_learn.learning_filter": "frf",
    "ilc_learn.cancel_radius": 0.9,
    "measure_force.measure_angle": 80,
    "measure_force.lowpass_hz": 4,
    "measure_force.correction": "load",
    "measure_force.zero": False,
    "measure_force.motion.bandwidth_hz": 5,
    "rig.pulley_radius_u": 1e-4,
    "rig.instrument.grasper_length_u": 1e-4,
    "rig.instrument.angle_ratio_relative_u": 1e-3,
}
"""Another value of each setting of an analysis."""

OTHER_RUNS = {"measure_force.motion.bandwidth_hz", "rig.pulley_radius_u"}
"""Settings that only runs without known loads read, or without an instrument."""


@pytest.fixture(scope="module")
def springs(tmp_path_factory):
    path = tmp_path_factory.mktemp("springs") / "springs.h5"
    run(SUSPENSION, RECIPE, path)
    return path


class Watched:
    """A recipe that notes which of its keys are read."""

    def __init__(self, model, keys, path=""):
        self._model, self._keys, self._path = model, keys, path

    def __getattr__(self, name):
        own = getattr(type(self._model), name, None)
        if isinstance(own, property):  # reads keys itself
            return own.fget(self)
        value, path = getattr(self._model, name), f"{self._path}{name}"
        self._keys.add(path)
        return Watched(value, self._keys, f"{path}.") if isinstance(value, BaseModel) else value


@pytest.fixture(
    params=[CALIBRATE_KT, SUSPENSION, ILC_LEARN, MEASURE_FORCE], ids=lambda p: p.command
)
def stored(request, springs):
    """Give a procedure, the run that it made, and the inputs of its analysis."""
    procedure = request.param
    source = {"calibrate-kt": KT, "suspension": springs, "ilc-learn": TABLES}
    with ExitStack() as stack:
        inputs = {name: stack.enter_context(open_run(KT)) for name in procedure.needed}
        if procedure is MEASURE_FORCE:
            inputs["tables"] = stack.enter_context(open_run(TABLES))
        yield procedure, stack.enter_context(open_run(source.get(procedure.command, FORCE))), inputs


def test_each_setting_of_the_analysis_is_read_there(stored):
    procedure, source, inputs = stored
    read = set()
    procedure.analyse([source], Watched(source.recipe, read), **inputs)
    assert set(procedure.analysis_settings) - read <= OTHER_RUNS


def test_no_setting_of_the_analysis_changes_a_motion(stored):
    procedure, source, inputs = stored

    def motions(recipe):
        return str(rehearse(procedure, recipe, 0.045, inputs))

    before = motions(source.recipe)
    for key in procedure.analysis_settings:
        other = override_recipe(source.recipe, [f"{key}={json.dumps(OTHER[key])}"])
        assert other != source.recipe
        assert procedure.recordings(other) == procedure.recordings(source.recipe)
        try:
            planned = motions(other)
        except RigtoolError:  # inputs that do not carry it: nothing moves
            continue
        assert planned == before


def exit_code(tmp_path, *options):
    with pytest.raises(SystemExit) as caught:
        main(["calibrate-kt", str(KT), *options, "-o", str(tmp_path / "again.h5")])
    return caught.value.code or 0


@pytest.mark.parametrize(
    "options",
    [
        ("--seed", "5"),
        ("--spy", "line.txt"),
        ("--set", "rig.name=other"),
        ("--set", "rig.attachment=instrument"),
        ("--set", "rig={name='other'}"),
        ("--set", "rig.arm.length=0.27"),
        ("--set", "measure_force.cycles=20"),
        ("--set", "calibrate_kt.record_every=7"),
        ("--set", "virtual.seed=7"),
    ],
)
def test_what_was_recorded_stays(tmp_path, capsys, options):
    assert exit_code(tmp_path, *options) == 2
    message = capsys.readouterr().err
    assert " ".join(options) in message
    assert "stored run" in message
    assert list(tmp_path.iterdir()) == []


def test_a_setting_of_the_analysis_may_change(tmp_path):
    assert exit_code(tmp_path, "--set", "calibrate_kt.settle_time=0.2") == 0
    with open_run(KT) as before, open_run(tmp_path / "again.h5") as after:
        assert after.recipe == override_recipe(before.recipe, ["calibrate_kt.settle_time=0.2"])
        assert after.results["hysteresis_torque"] != before.results["hysteresis_torque"]


def test_a_setting_that_states_what_was_recorded_is_taken(tmp_path):
    with open_run(KT) as stored:
        name = stored.recipe.rig.name
    assert exit_code(tmp_path, "--set", f"rig.name={name}") == 0


def test_settings_of_every_procedure_are_keys_of_the_recipe():
    recipe, _ = load_recipe(RECIPE)
    for key, value in OTHER.items():
        assert override_recipe(recipe, [f"{key}={json.dumps(value)}"]) != recipe


@pytest.mark.parametrize(
    "procedure",
    [
        STRIBECK,
        FFT_RIPPLE,
        ILC_LEARN,
        ILC_CHECK,
        MEASURE_FORCE,
        over_time(5.0, observed=False),
        over_time(5.0, observed=True),
    ],
)
def test_what_states_torque_needs_a_calibration(procedure, tmp_path):
    with pytest.raises(UsageError, match="--kt is missing"):
        run(procedure, RECIPE, tmp_path / "out.h5")
    assert not list(tmp_path.iterdir())
