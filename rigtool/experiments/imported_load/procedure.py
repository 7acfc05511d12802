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
    REFERENCE,
    WIDE,
    Accuracy,
    LoadSignals,
    accuracy,
    accuracy_columns,
    carries,
    judge,
    levels_of,
    read_signals,
)
from rigtool.experiments.imported_load.learning import (
    Learned,
    Observation,
    Validation,
    learn_load_model,
)
from rigtool.experiments.imported_load.model import LoadModel
from rigtool.experiments.imported_load.stored import RANDOM, WIDE_MODEL, tables_of
from rigtool.experiments.learning.procedure import PROCEDURE as LEARNING
from rigtool.experiments.outcome import Outcome
from rigtool.numerics.arrays import Array, Mask
from rigtool.quantity import Quantity
from rigtool.recipe.commands import MeasureForce
from rigtool.runfile import Column, Run, Table

SEED = 1
"""Of the random halves; the result hardly depends on it."""


def analyse_imported(
    runs: Sequence[Run],
    *,
    kt: Run | None = None,
    friction: Run | None = None,
    plant: Run | None = None,
    bandwidth_hz: float = MeasureForce().lowpass_hz,
) -> Outcome:
    """Learn effort by motion and load, from signals with this bandwidth.

    Raises `RunFileError` for runs without a reference torque, `InsufficientDataError` where they do
    not show how effort grows with load, `UsageError` for options of the bench's own rig.
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
    observations = [item.observation(n) for item, n in zip(signals, levels, strict=True)]
    turn = 0.0 if is_linear(recordings_[0]) else 2 * math.pi
    learned = learn_load_model(observations, turn=turn)
    model = learned.model
    unit = signals[0].effort_unit
    tables = tables_of(model, unit)
    random = [_random_split(signals, observations, model, turn)]
    if carries(recordings_, WIDE):
        wide = [
            read_signals(run, recording, kt, WIDE)
            for run, recording in zip(runs, recordings_, strict=True)
        ]
        again = [item.observation(level) for item, level in zip(wide, levels, strict=True)]
        random.append(_random_split(wide, again, model, turn))
        tables |= tables_of(learn_load_model(again, turn=turn, like=model).model, unit, WIDE_MODEL)
    tables |= {
        "load_friction": _friction_table(learned),
        "left_out": _level_table(learned.validation, levels, model.direction),
        RANDOM: _random_table(random),
    }
    return Outcome(_results(learned, levels), tables, tuple(_notes(learned, levels)))


def _random_split(
    signals: Sequence[LoadSignals],
    observations: Sequence[Observation],
    model: LoadModel,
    turn: float,
) -> tuple[float, Accuracy]:
    """Learn from half of the samples, chosen at random; return bandwidth and errors of the rest.

    As neighbouring samples are alike, this proves less than levels that were left out; publications
    split in this way.
    """
    random = np.random.default_rng(SEED)
    halves = [random.random(len(item.used)) < 0.5 for item in observations]
    chosen = [replace(o, used=o.used & h) for o, h in zip(observations, halves, strict=True)]
    half = learn_load_model(chosen, turn=turn, like=model).model
    judged = []
    for item, rest in zip(signals, halves, strict=True):
        estimate = half.estimate(item.effort, item.path)
        judged.append(judge(replace(item, counts=item.counts & ~rest), estimate, half.direction))
    return signals[0].path.bandwidth_hz, accuracy(judged)


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
    used = "; ".join(
        f"speed {'+-'[number]}: "
        + ", ".join(f"{name} {degree:g}" for name, degree in side.degree.items())
        for number, side in enumerate(model.sides)
    )
    scales = model.scales
    return [
        f"learned from {len(levels)} runs at {len(set(levels))} load levels, up to "
        f"{scales.torque * 1e3:.4g} mN m, position {scales.low:.4g} to {scales.high:.4g} rad",
        f"functions in use and their degree of smoothing, chosen by levels left out: {used}",
        f"below {scales.standstill:.3g} rad/s friction is undetermined: no value there, only a "
        "dead band",
    ]


def _friction_table(learned: Learned) -> Table:
    friction = learned.friction
    return Table(
        ("position",),
        {
            "position": Column(friction.position, "rad", "of the motor"),
            "mu": Column(friction.mu, "1", "effort = ratio*torque*(1 + mu) against the load"),
            "u": Column(friction.u, "1", "standard uncertainty, from leaving out levels"),
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


PROCEDURE = replace(
    LEARNING,
    analyse_imported=analyse_imported,
    imported_settings={"measure_force.lowpass_hz": "bandwidth_hz"},
)
