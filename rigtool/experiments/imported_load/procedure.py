"""Implementation D on imported runs: effort by motion and load, from runs with a reference torque.

For instruments on other people's rigs whose runs hold `reference_torque`, a sensor at the load. The
model is learned from the motor's current (or torque) and its own encoder; `measure-force` then
measures with it, without the sensor.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rigtool.errors import RunFileError, UsageError
from rigtool.experiments.imported import is_linear, require_one_rig, signals_of
from rigtool.experiments.imported_load.imported_accuracy import (
    FAST,
    REFERENCE,
    WIDE,
    Accuracy,
    Judged,
    LoadSignals,
    accuracy,
    accuracy_columns,
    carries,
    levels_of,
    read_signals,
)
from rigtool.experiments.imported_load.learning import Learned, Validation, learn_load_model
from rigtool.experiments.imported_load.model import NORMAL_95, LoadModel
from rigtool.experiments.imported_load.stored import (
    MODEL,
    RANDOM,
    WIDE_MODEL,
    load_model_from,
    tables_of,
)
from rigtool.experiments.learning.procedure import PROCEDURE as LEARNING
from rigtool.experiments.outcome import Outcome
from rigtool.numerics.arrays import Array, Mask
from rigtool.quantity import Quantity
from rigtool.recipe import Recipe
from rigtool.recipe.commands import MeasureForce
from rigtool.runfile import Column, Run, Table, dof_column


def analyse_imported(
    runs: Sequence[Run],
    *,
    kt: Run | None = None,
    friction: Run | None = None,
    plant: Run | None = None,
    prior: Run | None = None,
    bandwidth_hz: float = MeasureForce().lowpass_hz,
) -> Outcome:
    """Learn effort by motion and load, from signals with this bandwidth.

    `prior` holds the tables of another mounting of the instrument. Raises `RunFileError` for runs
    without a reference torque, `InsufficientDataError` where they do not show how effort grows with
    load, `UsageError` for options of the bench's own rig and a prior of other signals.
    """
    for name, given in (("friction", friction), ("plant", plant)):
        if given is not None:
            raise UsageError(f"--{name}: is of the bench's own rig, imported runs do without")
    recordings_ = signals_of(runs)
    require_one_rig(recordings_, runs)
    for run, recording in zip(runs, recordings_, strict=True):
        if not recording.has(REFERENCE):
            raise RunFileError(
                f"{run.path}: has no channel {REFERENCE}, so it does not show the load: learn "
                "from runs with a sensor at the load, imported with that channel mapped"
            )
    signals = [
        read_signals(run, recording, kt, bandwidth_hz)
        for run, recording in zip(runs, recordings_, strict=True)
    ]
    levels = levels_of(signals)
    turn = 0.0 if is_linear(recordings_[0]) else 2 * math.pi
    unit = signals[0].effort_unit
    learned = _learn(signals, levels, turn, _prior(prior, MODEL, unit, bandwidth_hz))
    tables = tables_of(learned.model, unit)
    random = [(bandwidth_hz, _random_half(signals, learned))]
    if carries(recordings_, WIDE) and (prior is None or WIDE_MODEL in prior.tables):
        wide = [
            read_signals(run, recording, kt, WIDE)
            for run, recording in zip(runs, recordings_, strict=True)
        ]
        again = _learn(wide, levels, turn, _prior(prior, WIDE_MODEL, unit, WIDE))
        random.append((WIDE, _random_half(wide, again)))
        tables |= tables_of(again.model, unit, WIDE_MODEL)
    tables |= {
        "load_friction": _friction_table(learned),
        "left_out": _level_table(learned.validation, levels, learned.model.direction),
        RANDOM: _random_table(random),
    }
    return Outcome(_results(learned, levels), tables, tuple(_notes(learned, levels)))


def _prior(prior: Run | None, name: str, unit: str, bandwidth_hz: float) -> LoadModel | None:
    """Return the model of a prior run; `UsageError` where it is of other signals."""
    if prior is None:
        return None
    model, prior_unit = load_model_from(prior, name)
    if (prior_unit, model.bandwidth_hz) != (unit, bandwidth_hz):
        raise UsageError(
            f"{prior.path}: was learned from effort in {prior_unit} at {model.bandwidth_hz:g} Hz, "
            f"these runs have {unit} at {bandwidth_hz:g} Hz: give --kt and "
            "measure_force.lowpass_hz as there"
        )
    return model


def _learn(
    signals: Sequence[LoadSignals], levels: Sequence[int], turn: float, prior: LoadModel | None
) -> Learned:
    observations = [item.observation(n) for item, n in zip(signals, levels, strict=True)]
    return learn_load_model(observations, turn=turn, prior=prior)


def _random_half(signals: Sequence[LoadSignals], learned: Learned) -> Accuracy:
    """Return the errors at the random half of the samples that was kept from learning."""
    found, judged = learned.random, []
    for number, item in enumerate(signals):
        own = found.recording == number
        speed = learned.model.direction * item.output_speed[found.row[own]]
        judged.append(
            Judged(
                error=found.error[own],
                closing=speed > FAST,
                opening=speed < -FAST,
                moving=np.ones(len(speed), dtype=bool),
                sure=np.abs(found.error[own]) <= NORMAL_95 * found.u[own],
            )
        )
    return accuracy(judged)


# -- what is reported


def _results(learned: Learned, levels: Sequence[int]) -> dict[str, Quantity]:
    validation, friction = learned.validation, learned.friction
    direction = learned.model.direction
    found = {
        "load_levels": Quantity(len(set(levels)), "1", reason="a count"),
        "load_friction": Quantity(
            float(friction.mu.mean()), "1", float(np.sqrt(np.mean(friction.u**2)))
        ),
    }
    for name, side in (("resisting", direction), ("driving", -direction)):
        error = validation.error[side * validation.speed > 0]
        found[f"rmse_left_out_{name}"] = Quantity(
            float(np.sqrt(np.mean(error**2))), "N m", reason="itself a measure of uncertainty"
        )
    return found


def _notes(learned: Learned, levels: Sequence[int]) -> list[str]:
    model = learned.model
    scales = model.scales
    notes = [
        f"learned from {len(levels)} runs at {len(set(levels))} load levels, up to "
        f"{scales.torque * 1e3:.4g} mN m, position {scales.low:.4g} to {scales.high:.4g} rad",
        "u is widened by the errors at levels and speeds that were left out, most by "
        f"{max(side.factors.max() for side in model.sides):.3g}; slower and faster than learned "
        "there is no value",
        f"below {scales.standstill:.3g} rad/s friction is undetermined: no value there, only a "
        "dead band",
    ]
    if learned.paces == 2:
        notes.append(
            "recorded at two speeds: none can be left out, so u does not state what errors are "
            "between them; record at three speeds or more"
        )
    return notes


def _friction_table(learned: Learned) -> Table:
    friction = learned.friction
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


def _level_table(validation: Validation, levels: Sequence[int], direction: int) -> Table:
    level = np.array(levels)[validation.recording]
    numbers = np.unique(level)
    against = direction * validation.speed > 0

    def by_level(values: Array, mask: Mask) -> Array:
        return np.array([float(np.mean(values[mask & (level == n)])) for n in numbers])

    squares = validation.error**2
    hit = (np.abs(validation.error) <= 1.96 * validation.u).astype(float)
    return Table(
        ("level",),
        {
            "level": Column(numbers, "1", "lowest first"),
            "torque": Column(by_level(validation.torque, against | ~against), "N m", "mean"),
            "rmse_resisting": Column(
                np.sqrt(by_level(squares, against)), "N m", "while the load resists"
            ),
            "rmse_driving": Column(
                np.sqrt(by_level(squares, ~against)), "N m", "while the load drives"
            ),
            "coverage_95": Column(by_level(hit, against | ~against), "1", "of 95 % intervals"),
        },
        "rmse_resisting",
        "errors at each level, from all others",
    )


def _random_table(found: Sequence[tuple[float, Accuracy]]) -> Table:
    return Table(
        ("bandwidth",),
        {
            "bandwidth": Column(np.array([bandwidth for bandwidth, _ in found]), "Hz"),
            **accuracy_columns([item for _, item in found]),
        },
        "rmse_closing",
        "errors at random halves of the samples, learned from the other half",
    )


def _analyse(
    runs: Sequence[Run], recipe: Recipe, *, prior: Run | None = None, **inputs: Run
) -> Outcome:
    """Analyse the bench's own runs."""
    if prior is not None:
        raise UsageError("--prior: is for imported runs, the bench's own rig is learned anew")
    return LEARNING.analyse(runs, recipe, **inputs)


PROCEDURE = replace(
    LEARNING,
    analyse=_analyse,
    analyse_imported=analyse_imported,
    imported_settings={"measure_force.lowpass_hz": "bandwidth_hz"},
)
