"""Implementation D on imported runs: effort by motion and load, from runs with a reference torque.

For instruments on other people's rigs whose runs hold `reference_torque`, a sensor at the load. The
model is learned from the motor's current (or torque) and its own encoder; `measure-force` then
measures with it, without the sensor.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from rigtool.errors import InsufficientDataError, RunFileError, UsageError
from rigtool.experiments.force_filter.accuracy import COVERAGE_FACTOR, accuracy
from rigtool.experiments.imported import is_linear, place, recordings_of
from rigtool.experiments.imported_load.imported_signals import REFERENCE_CHANNEL, read_all
from rigtool.experiments.imported_load.learning import (
    LearnedEffort,
    LoadFriction,
    Validation,
    learn_load_model,
)
from rigtool.experiments.imported_load.model import LoadModel
from rigtool.experiments.imported_load.odd_recording import limit
from rigtool.experiments.imported_load.stored import load_model_from, model_tables
from rigtool.experiments.outcome import Outcome
from rigtool.numerics.arrays import Array
from rigtool.quantity import Quantity
from rigtool.recipe.commands import MeasureForce
from rigtool.runfile import Column, Recording, Run, Table, dof_column


def analyse_imported(
    runs: Sequence[Run],
    *,
    kt: Run | None = None,
    prior: Run | None = None,
    bandwidth_hz: float = MeasureForce().lowpass_hz,
) -> Outcome:
    """Learn effort by motion and load, from signals with this bandwidth.

    `prior` holds the tables of another mounting of the instrument. Raises `RunFileError` for runs
    without a reference torque, `InsufficientDataError` where they do not show how effort grows with
    load, `UsageError` for a prior of other signals.
    """
    recordings = recordings_of(runs)
    for recording in recordings:
        if not recording.has(REFERENCE_CHANNEL):
            raise RunFileError(
                f"{place(recording)}: has no channel {REFERENCE_CHANNEL}, so it does not show the "
                "load: learn from runs with a sensor at the load, imported with that channel mapped"
            )
    signals = read_all(runs, kt, bandwidth_hz)
    unit = signals[0].effort_unit
    known = None if prior is None else _prior(prior, unit, bandwidth_hz)
    turn = 0.0 if is_linear(recordings[0]) else 2 * math.pi
    learned = learn_load_model(signals, turn=turn, prior=known)
    _require_alike(learned.odd, recordings)
    _require_shown(learned.validation)
    tables = {
        **model_tables(learned.model, unit),
        "load_friction": _friction_table(learned.friction),
        "left_out": _level_table(learned.validation),
    }
    return Outcome(_results(learned), tables, tuple(_notes(learned, len(recordings))))


def _prior(prior: Run, unit: str, bandwidth_hz: float) -> LoadModel:
    """Return the model of a prior run; `UsageError` where it is of other signals."""
    model, prior_unit = load_model_from(prior)
    if (prior_unit, model.bandwidth_hz) != (unit, bandwidth_hz):
        raise UsageError(
            f"{prior.path}: was learned from effort in {prior_unit} at {model.bandwidth_hz:g} Hz, "
            f"these runs have {unit} at {bandwidth_hz:g} Hz: give --kt and "
            "measure_force.lowpass_hz as there"
        )
    return model


def _require_alike(odd: Array, recordings: Sequence[Recording]) -> None:
    """Raise `InsufficientDataError` where one of the recordings is odd by ratios (r,)."""
    worst, most = int(np.argmax(odd)), limit(len(odd))
    if odd[worst] > most:
        raise InsufficientDataError(
            f"{place(recordings[worst])}: is off {odd[worst]:.3g} times as far as the other "
            f"recordings, {most:.3g} times at most is by chance: correct its {REFERENCE_CHANNEL}, "
            "or a sign or a unit, which may differ from those of the others, or learn without it"
        )


def _require_shown(left_out: Validation) -> None:
    """Raise `InsufficientDataError` where the effort says no more of loads left out, in either
    direction, than that each is one of all loads."""
    ways = (left_out.against, ~left_out.against)
    half = COVERAGE_FACTOR * min(float(np.median(left_out.u[way])) for way in ways if way.any())
    loads = float(np.ptp(left_out.torque))
    if half >= loads:
        raise InsufficientDataError(
            f"the effort does not show the load: loads left out are read to {half * 1e3:.3g} mN m "
            f"(95 %), and all are within {loads * 1e3:.3g} mN m; see to it that effort, position "
            "and reference torque are of one motion, with one sign and one unit in all runs "
            "(`rigtool plot`)"
        )


# -- what is reported


def _results(learned: LearnedEffort) -> dict[str, Quantity]:
    validation, friction = learned.validation, learned.friction
    found = {
        "load_levels": Quantity(len(np.unique(validation.level)), "1", reason="a count"),
        "load_friction": Quantity(
            float(friction.mu.mean()), "1", float(np.sqrt(np.mean(friction.u**2)))
        ),
    }
    for name, rows in (("resisting", validation.against), ("driving", ~validation.against)):
        rms = float(np.sqrt(np.mean(validation.error[rows] ** 2)))
        reason = "itself a measure of uncertainty"
        found[f"rmse_left_out_{name}"] = Quantity(rms, "N m", reason=reason)
    return found


def _notes(learned: LearnedEffort, recordings: int) -> list[str]:
    model = learned.model
    scales, levels = model.scales, len(np.unique(learned.validation.level))
    largest = float(np.abs(learned.validation.torque).max())  # the scale may be that of a prior
    notes = [
        f"learned from {recordings} recordings at {levels} load levels, up to "
        f"{largest * 1e3:.4g} mN m, position {scales.low:.4g} to {scales.high:.4g} rad",
        "u is widened by the errors at levels and speeds that were left out, most by "
        f"{max(side.factors.max() for side in model.sides):.3g}; slower and faster than learned "
        "there is no value",
        f"below {scales.standstill:.3g} rad/s friction is undetermined: no value there, only a "
        "dead band",
    ]
    if any(side.bend for side in model.sides):
        notes.append(
            "learned at two loads: nothing shows how friction grows between them; u there includes "
            "that it may do so in any way; record a third load"
        )
    if learned.paces == 1 and len(model.strokes) == 1:
        notes.append(
            "recorded at one speed: nothing shows how friction changes with it, so other speeds "
            "have no value; record at three speeds or more"
        )
    if learned.paces == 2:
        notes.append(
            "recorded at two speeds, none of which is between others: at other speeds u is wider, "
            f"between them up to {max(side.at_other_speeds(0.25) for side in model.sides):.2g} "
            "times, by what leaving out either shows; record at three speeds or more"
        )
    return notes


def _friction_table(friction: LoadFriction) -> Table:
    return Table(
        ("position",),
        {
            "position": Column(friction.position, "rad", "of the motor"),
            "mu": Column(friction.mu, "1", "effort = ratio*torque*(1 + mu) against the load"),
            "u": Column(friction.u, "1", "standard uncertainty, from leaving out levels"),
            "dof": dof_column(np.full(friction.u.size, friction.dof)),
        },
        "mu",
        "friction that grows with load, as part of it",
    )


def _level_table(left_out: Validation) -> Table:
    covered = np.abs(left_out.error) <= COVERAGE_FACTOR * left_out.u
    numbers, found = np.unique(left_out.level), []
    for number in numbers:
        own = left_out.level == number
        resisting, driving, both = (
            accuracy(left_out.error, covered, own & rows)
            for rows in (left_out.against, ~left_out.against, own)
        )
        torque = float(left_out.torque[own].mean())
        found.append((torque, resisting.rmse, driving.rmse, both.coverage))
    torque, resisting, driving, coverage = np.array(found).T
    return Table(
        ("level",),
        {
            "level": Column(numbers, "1", "lowest first"),
            "torque": Column(torque, "N m", "mean"),
            "rmse_resisting": Column(resisting, "N m", "while the load resists"),
            "rmse_driving": Column(driving, "N m", "while the load drives"),
            "coverage_95": Column(coverage, "1", "of 95 % intervals"),
        },
        "rmse_resisting",
        "errors at each level, from all others",
    )
