"""From recordings of known loads to the model of motor and instrument that force is read with."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import constants

from rigtool.experiments.controller_torque import CHANNELS as LOOP_CHANNELS
from rigtool.experiments.controller_torque import LoopSignals, loop_signals, naming
from rigtool.experiments.force_over_time.deviations import deviations
from rigtool.experiments.force_over_time.force_model import ForceModel
from rigtool.experiments.force_over_time.learning import Sliding, learn_sliding
from rigtool.experiments.force_over_time.model import Known
from rigtool.experiments.force_over_time.procedure_exploration import exploration
from rigtool.experiments.force_over_time.records import Condition, Record, repeated, single
from rigtool.experiments.force_over_time.rest import Exploration, learn_rest
from rigtool.experiments.torque_per_ampere import torque_per_ampere_at
from rigtool.recipe import Recipe
from rigtool.rigs.motion import SpeedProfile
from rigtool.runfile import Recording, Run

CHANNELS = (*LOOP_CHANNELS, "temperature")
"""What is recorded of a hanging load."""

FREE_TIME = 14.0
"""Of the exploration's free motion, s."""

FREE_SPEED = 2.0
"""Highest speed of free motion, rev/s of the output, where that was learned."""

STEP_TIME = 1e-3
"""Of the filter, s."""


def exploring(recipe: Recipe) -> SpeedProfile:
    """Return the motion without load that shows rest and reversals, from the lower end on."""
    rig, settings = recipe.rig, recipe.ilc_learn
    high = math.radians(recipe.measure_force.angle) * rig.angle_ratio
    fastest = 2 * math.pi * rig.angle_ratio * min(FREE_SPEED, max(settings.speeds_rev_per_s))
    return exploration(0.0, high, 2 * math.pi / rig.encoder_counts, fastest, FREE_TIME)


@dataclass(frozen=True)
class LearnedForce:
    """The `model` of motor and instrument, and what `sliding` alone shows, from the strokes under
    known loads `strokes` by the names of their recordings."""

    model: ForceModel
    sliding: Sliding
    strokes: dict[str, Record]


def learn_force(
    strokes: Sequence[Recording],
    moves: Sequence[Recording],
    explored: Recording,
    recipe: Recipe,
    kt: Run,
) -> LearnedForce:
    """Learn from strokes under known loads, moves without one, and the exploration.

    Raises `InsufficientDataError` where they do not carry it.
    """
    rig = recipe.rig
    warm = float(np.mean([np.mean(recording.read("temperature")) for recording in strokes]))
    loaded = {r.name: stroke_record(r, recipe, kt, r.condition("force")) for r in strokes}
    records = [*loaded.values(), *(_repeated(r, recipe, kt, warm, 0.0) for r in moves)]
    own = _condition(recipe, kt, float(np.mean(explored.read("temperature"))), 0.0)
    signals = _signals(explored, recipe)
    interval = _interval(signals)
    records.append(single(signals.encoder, signals.total, signals.setpoint, interval, own))
    offset = kt.results.get("amplifier_offset")
    known = Known(
        rig.angle_ratio,
        rig.torque_factor,
        rig.nominal_inertia,
        offset.value if offset is not None else 0.0,
    )
    deviating = deviations(records, known.angle_ratio, known.torque_factor)
    sliding = learn_sliding(records, known, own.count, deviating)
    shown = Exploration(signals.encoder, signals.total, interval, own.torque_constant, own.count)
    uncertainty = ForceModel(sliding.learned, deviating).uncertainty
    rested = learn_rest(sliding.learned, shown, uncertainty, STEP_TIME)
    return LearnedForce(ForceModel(rested, deviating), sliding, loaded)


def stroke_record(recording: Recording, recipe: Recipe, kt: Run, force: float = 0.0) -> Record:
    """Lay the strokes of a recording over each other, under the load of a known force, N.

    The torque constant is that at the motor's temperature in this recording. Raises
    `InsufficientDataError` for less than a cycle, and where the loop saturates or is not held.
    """
    temperature = float(np.mean(recording.read("temperature")))
    return _repeated(recording, recipe, kt, temperature, force)


def _repeated(
    recording: Recording, recipe: Recipe, kt: Run, temperature: float, force: float
) -> Record:
    under = _condition(recipe, kt, temperature, force)
    signals = _signals(recording, recipe)
    with naming(recording):
        return repeated(signals.encoder, signals.total, signals.setpoint, _interval(signals), under)


def _signals(recording: Recording, recipe: Recipe) -> LoopSignals:
    with naming(recording):
        return loop_signals(recording, recipe)


def _condition(recipe: Recipe, kt: Run, temperature: float, force: float) -> Condition:
    rig = recipe.rig
    return Condition(
        torque_per_ampere_at(kt, temperature).value,
        force * rig.load_arm,
        force * rig.load_arm**2 / constants.g,
        2 * math.pi / rig.encoder_counts,
    )


def _interval(signals: LoopSignals) -> float:
    time = signals.time
    return float((time[-1] - time[0]) / (len(time) - 1))
