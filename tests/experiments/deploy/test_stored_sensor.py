"""The sensor of a stored run: what is in it, and what is refused."""

import math
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rigtool.errors import RunFileError, UsageError
from rigtool.experiments.deploy import stored_sensor
from rigtool.experiments.deploy.stored_export import SENSOR_FORMAT, chosen_format, export_table
from rigtool.experiments.force_model.deviations import Deviations
from rigtool.experiments.force_model.force_model import ForceModel
from rigtool.experiments.force_model.learning import LearnedModel
from rigtool.experiments.force_model.model import Kind, Known, Shape, Term
from rigtool.experiments.force_model.sliding_problem import SLIDING_PARAMETERS
from rigtool.experiments.force_model.stored import (
    CONSTANT,
    COVARIANCE,
    MODEL_PREFIX,
    MODEL_UNITS,
    OFFSET,
    TERMS,
    model_from,
    model_results,
    model_tables,
)
from rigtool.experiments.force_model.stored import (
    SCALES as SCALES_TABLE,
)
from rigtool.experiments.force_sensor import procedure_calibration
from rigtool.experiments.force_sensor.procedure_calibration import with_zero_of
from rigtool.experiments.force_sensor.procedure_over_time import reach_of
from rigtool.experiments.force_sensor.procedure_reading import instrument_of
from rigtool.experiments.torque_per_ampere import torque_per_ampere_at
from rigtool.quantity import REFERENCE_DEGC, Quantity
from rigtool.recipe import load_recipe
from rigtool.runfile import RunWriter, open_run
from tests.experiments.deploy.sensors import INTERVAL, SCALES, compiled, expected, moved
from tests.experiments.virtual_runs import RECIPE

FIXTURES = Path(__file__).parents[2] / "fixtures"
COEFFICIENTS = {
    (Kind.OFFSET, 0): 1e-4,
    (Kind.INERTIA, 0): 1e-7,
    (Kind.VISCOUS, 0): 5e-5,
    (Kind.COGGING, 7): 3e-4,
    (Kind.RIPPLE, 1): 5e-5,
    (Kind.GAIN_RIPPLE, 2): 2e-3,
    (Kind.SQUARE_RIPPLE, 0): 1e-4,
    (Kind.BEARING, 0): 2e-3,
    (Kind.STRIBECK, 0): 1e-3,
    (Kind.BEARING_DAMPING, 0): 1e-6,
    (Kind.HOUSING, 0): 9e-3,
    (Kind.HOUSING, 1): 9e-4,
    (Kind.LOAD_FRICTION, 0): 0.1,
    (Kind.CARRIED, 0): 2e-3,
}
LIMITS = np.array([[1e-3, 4.0], [np.inf, np.inf], [8e-3, 6.0]])
"""A motion of which too little was recorded has no threshold."""

SHAPE = Shape(2e-3, 8e-3, 5e-3, 0.3, 0.05, 0.2, 8e-4, 1e-3, 2e-6, 1.8e-3, 1.06)


def force_model(rig):
    size = len(SLIDING_PARAMETERS) + len(COEFFICIENTS)
    learned = LearnedModel(
        tuple(Term(kind, 1e-3, order) for kind, order in COEFFICIENTS),
        SHAPE,
        Known(rig.angle_ratio, rig.torque_factor, rig.nominal_inertia, 1e-3),
        np.array(list(COEFFICIENTS.values())),
        1e-6 * np.eye(size),
        np.full(2, 0.01),
    )
    return ForceModel(learned, Deviations(3e-4, 1e-3, 1e-4, 0.15))


def learned_run(path, *overrides, without=None):
    """Write a run of implementation D that holds a force model and no recordings."""
    recipe, text = load_recipe(RECIPE, overrides)
    scales = np.stack([SCALES[::-1], SCALES])
    model = replace(force_model(recipe.rig), scales=scales, limits=LIMITS)
    with RunWriter(path, command="ilc-learn", recipe=recipe, recipe_text=text) as writer:
        results = {name: one for name, one in model_results(model).items() if name != without}
        writer.finish(results, model_tables(model))
    return path


@pytest.fixture(scope="module")
def tables(tmp_path_factory):
    with open_run(learned_run(tmp_path_factory.mktemp("learned") / "d.h5")) as run:
        yield run


@pytest.fixture(scope="module")
def kt():
    with open_run(FIXTURES / "kt.h5") as run:
        yield run


def export(run, path, kt=None, speed=None):
    chosen = chosen_format(run, path, None, SENSOR_FORMAT)
    return export_table(run, path, chosen, speed=speed, kt=kt, overwrite=False)


@pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler cc")
def test_the_sensor_of_a_run_reads_what_python_reads(tables, kt, tmp_path):
    remarks = export(tables, tmp_path / "sensor.h", kt)
    assert any("every 0.000125 s" in remark for remark in remarks)
    text = (tmp_path / "sensor.h").read_text()
    for part in (
        tables.content_sha256,
        kt.content_sha256,
        "briaire-2006",
        "up to 10 Hz: low-pass at 30 Hz",
    ):
        assert part in text.partition("*/")[0]
    time = np.arange(round(1.5 / INTERVAL)) * INTERVAL
    samples = moved(0.4 - 0.3 * np.cos(4 * time), np.where(time > 0.8, 0.02, 0.0))
    recipe, model = tables.recipe, with_zero_of(model_from(tables, tables.recipe), kt)
    np.testing.assert_array_equal(model.scales, [SCALES[::-1], SCALES])
    np.testing.assert_array_equal(model.limits, LIMITS)
    assert model.learned.shape == SHAPE
    own = instrument_of(recipe, kt, model, reach_of(tables, kt), recipe.rig.sample_time)
    wanted = expected(own, samples)
    found = compiled(tmp_path, text).add(samples)
    assert np.isfinite(wanted).mean() > 0.5
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-9 * own.reach.torque)


@pytest.mark.parametrize("value", [0.0, -1.0, 1e300, -1e300])
@pytest.mark.parametrize("name", [MODEL_PREFIX + name for name in MODEL_UNITS])
def test_an_edited_number_is_used_or_refused(tables, monkeypatch, name, value):
    edited = replace(tables.results[name], value=value)
    monkeypatch.setattr(tables, "results", {**tables.results, name: edited})
    may = name[len(MODEL_PREFIX) :] in ("stroke", "load", "noise", "offset_current")
    if may and abs(value) < 10:
        model_from(tables, tables.recipe)
    else:
        with pytest.raises(RunFileError, match=name):
            model_from(tables, tables.recipe)


@pytest.mark.parametrize("value", [math.nan, math.inf, 1e300])
@pytest.mark.parametrize(
    ("table", "column"),
    [
        (TERMS, "kind"),
        (TERMS, "coefficient"),
        (SCALES_TABLE, "smoothed"),
        (COVARIANCE, "covariance"),
    ],
)
def test_an_edited_column_is_refused(tables, monkeypatch, table, column, value):
    stored = tables.tables[table]
    wrong = replace(stored.columns[column], values=np.full_like(stored[column], value))
    edited = replace(stored, columns={**stored.columns, column: wrong})
    monkeypatch.setattr(tables, "_tables", {**tables.tables, table: edited})
    with pytest.raises(RunFileError, match=column):
        model_from(tables, tables.recipe)


@pytest.mark.parametrize("name", ["stiffness", "bearing_length"])
def test_tables_that_lack_a_parameter_are_refused(tmp_path, name):
    with (
        open_run(learned_run(tmp_path / "d.h5", without=f"model_{name}")) as run,
        pytest.raises(RunFileError, match=f"model_{name}"),
    ):
        model_from(run, run.recipe)


@pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler cc")
def test_names_of_a_run_do_not_leave_the_comment(kt, tmp_path):
    hostile = "*/ #error ??/"
    rig = learned_run(tmp_path / "x?? *.h5", f"rig.name={hostile!r}")
    calibrated = tmp_path / "*??.h5"
    with RunWriter(calibrated, command="calibrate-kt") as writer:
        writer.finish(dict(kt.results), {})
    with open_run(rig) as run, open_run(calibrated) as own:
        export(run, tmp_path / "sensor.h", own)
    text = (tmp_path / "sensor.h").read_text()
    assert "#error" in text
    assert len(compiled(tmp_path, text).add(np.zeros((3, 100)))) == 12


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, "--kt is missing: .*give the run of calibrate-kt"),
        ({"speed": 3.0}, "--speed is for moteus, odrive, fourier"),
    ],
)
def test_what_does_not_go_together_is_refused(tables, tmp_path, options, message):
    with pytest.raises(UsageError, match=message):
        export(tables, tmp_path / "sensor.h", **options)
    assert list(tmp_path.iterdir()) == []


def test_a_calibration_of_another_motor_is_refused(tables, kt, tmp_path, monkeypatch):
    """45.8 mN m/A, where the data sheet has 45."""
    monkeypatch.setattr(procedure_calibration, "OTHER_MOTOR", 1.01)
    with pytest.raises(RunFileError, match=r"is another motor: give the calibration of this one"):
        export(tables, tmp_path / "sensor.h", kt)
    monkeypatch.setattr(procedure_calibration, "OTHER_MOTOR", 1.03)
    export(tables, tmp_path / "sensor.h", kt)


def test_a_later_calibration_widens_u_and_is_remarked(tables, kt, tmp_path, monkeypatch):
    """As `measure-force` does: either torque constant may be wrong."""
    now = torque_per_ampere_at(kt, REFERENCE_DEGC)
    then = {
        MODEL_PREFIX + CONSTANT: replace(now, value=1.05 * now.value),
        MODEL_PREFIX + OFFSET: Quantity(-3e-3, "A", 0.0),
    }
    monkeypatch.setattr(tables, "results", {**tables.results, **then})
    given = []
    header = stored_sensor.sensor_header
    monkeypatch.setattr(
        stored_sensor, "sensor_header", lambda own, *more: given.append(own) or header(own, *more)
    )
    notes = export(tables, tmp_path / "sensor.h", kt)
    np.testing.assert_allclose(given[0].model.scales[1, :, 0], SCALES[:, 0], rtol=1e-12, atol=0)
    np.testing.assert_allclose(
        given[0].model.scales[1, :, 1],
        np.hypot(SCALES[:, 1], 0.05),
        rtol=1e-12,
        atol=0,
    )
    assert any("torque constant that differs by -5.00 %" in note for note in notes)
    assert any("a zero of the current that has moved by" in note for note in notes)


def test_another_run_is_no_calibration(tables, tmp_path):
    with (
        open_run(FIXTURES / "friction.h5") as other,
        pytest.raises(RunFileError, match="calibrate-kt"),
    ):
        export(tables, tmp_path / "sensor.h", other)
    assert list(tmp_path.iterdir()) == []


def test_tables_without_the_force_model_are_refused(kt, tmp_path):
    with (
        open_run(FIXTURES / "tables.h5") as run,
        pytest.raises(RunFileError, match="learn again with ilc-learn --implementation D"),
    ):
        export(run, tmp_path / "sensor.h", kt)
    assert list(tmp_path.iterdir()) == []


def test_a_loop_that_is_too_slow_is_refused(kt, tmp_path):
    slow = learned_run(tmp_path / "slow.h5", "rig.sample_time=2e-3")
    with open_run(slow) as run, pytest.raises(RunFileError, match="a loop of 500 Hz come from"):
        export(run, tmp_path / "sensor.h", kt)
    assert not (tmp_path / "sensor.h").exists()
