"""`export --format c-sensor`: the force sensor in C, from a run of implementation D."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from rigtool.errors import RunFileError, UsageError
from rigtool.experiments.deploy.force_sensor import sensor_header
from rigtool.experiments.force_filter import passed
from rigtool.experiments.force_filter.accuracy import COVERAGE_FACTOR
from rigtool.experiments.force_filter.motion_states import Reach
from rigtool.experiments.force_model.force_model import ForceModel
from rigtool.experiments.force_model.stored import model_from
from rigtool.experiments.force_sensor.procedure_calibration import (
    changed_constant,
    changed_zero,
    require_calibration,
    with_zero_of,
)
from rigtool.experiments.force_sensor.procedure_over_time import reach_of
from rigtool.experiments.force_sensor.procedure_reading import instrument_of
from rigtool.experiments.learning.stored_table import origin_of, recipe_of
from rigtool.recipe import Recipe
from rigtool.runfile import Run


def sensor(tables: Run, kt: Run | None) -> tuple[str, tuple[str, ...], list[Path]]:
    """Return the header of the sensor that these tables and this calibration make, remarks, and
    the files that it is made of.

    It is for the loop of the recipe that the tables were learned with. Where the calibration is not
    the tables' own, u is wider by what `changed_constant` states. Raises `UsageError` without a
    calibration, `RunFileError` for tables without the force model, a calibration of another rig,
    and what no sensor can be made of.
    """
    recipe = recipe_of(tables)
    model = model_from(tables, recipe)
    if kt is None:
        raise UsageError(
            "--kt is missing: the sensor reads torque from current; give the run of calibrate-kt "
            "that the tables were learned with"
        )
    require_calibration(kt, recipe)
    share, notes = changed_constant(tables, kt)
    notes += _moved_zero(tables, kt, model)
    model = _widened(with_zero_of(model, kt), share)
    reach = reach_of(tables, kt)
    instrument = instrument_of(recipe, kt, model, reach, recipe.rig.sample_time)
    calibration = f"Torque constant of {kt.path.name}, content sha256 {kt.content_sha256}."
    origin = (*origin_of(tables), *_about(recipe, reach), calibration)
    try:
        text = sensor_header(instrument, COVERAGE_FACTOR, origin)
    except ValueError as error:
        raise RunFileError(f"{tables.path}: no sensor can be made of it: {error}") from None
    return text, (*_about(recipe, reach), *notes), [tables.path, kt.path]


def _widened(model: ForceModel, share: float) -> ForceModel:
    """Return the model with u wider by a share of the torque."""
    scales = model.scales.copy()
    scales[..., 1] = np.hypot(scales[..., 1], share)
    return replace(model, scales=scales)


def _moved_zero(tables: Run, kt: Run, model: ForceModel) -> list[str]:
    by, moved = changed_zero(tables, kt, model)
    if not by:
        return []
    return [
        f"{kt.path} states a zero of the current that has moved by {moved * 1e3:.3g} mA since "
        f"{tables.path} was learned: it is taken from there; u does not include that it may have "
        f"moved again, {by * 1e3:.3g} mN m for as much"
    ]


def _about(recipe: Recipe, reach: Reach) -> tuple[str, ...]:
    rig, motion, (low, high) = recipe.rig, recipe.measure_force.motion, reach.angle
    cold, warm = reach.temperature_degc
    return (
        f"Call it once in each sample of the loop, every {rig.sample_time:g} s; the encoder has "
        f"{rig.encoder_counts:g} counts a turn.",
        f"Amplitudes are right within 5 % up to {motion.bandwidth_hz:g} Hz: low-pass at "
        f"{motion.corner_hz:g} Hz, {1e3 * passed.delay(motion.corner_hz):.2g} ms late.",
        f"Force at the tip is torque over {rig.load_arm:g} m.",
        f"No value outside {low:.4g} to {high:.4g} rad of the motor, {reach.speed:.4g} rad/s, "
        f"{reach.torque * 1e3:.4g} mN m and {cold:g} to {warm:g} degC.",
    )
