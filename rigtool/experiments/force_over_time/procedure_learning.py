"""From recordings of known loads to the model of motor and instrument that force is read with."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy import constants

from rigtool.errors import InsufficientDataError
from rigtool.experiments.force_over_time.deviations import deviations
from rigtool.experiments.force_over_time.force_model import ForceModel
from rigtool.experiments.force_over_time.learning import learn_sliding
from rigtool.experiments.force_over_time.model import Known
from rigtool.experiments.force_over_time.procedure_exploration import exploration
from rigtool.experiments.force_over_time.records import Condition, Record, repeated, single
from rigtool.experiments.force_over_time.rest import Exploration, learn_rest
from rigtool.experiments.load_disturbance.tendon import Tendon
from rigtool.experiments.torque_per_ampere import torque_per_ampere_at
from rigtool.recipe import Recipe
from rigtool.rigs.motion import SpeedProfile
from rigtool.runfile import Recording, Run

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


def learn_force(
    strokes: Sequence[Recording],
    moves: Sequence[Recording],
    explored: Recording,
    recipe: Recipe,
    kt: Run,
    tendon: Tendon,
) -> ForceModel:
    """Learn from strokes under known loads, moves without one, and the exploration.

    `tendon` is the one that differences between loads show, where the search begins.
    Raises `InsufficientDataError` where they do not carry it.
    """
    rig = recipe.rig
    warm = float(np.mean([np.mean(recording.read("temperature")) for recording in strokes]))
    records = [
        *(_record(r, recipe, kt, float(np.mean(r.read("temperature")))) for r in strokes),
        *(_record(r, recipe, kt, warm) for r in moves),
    ]
    own = _condition(recipe, kt, float(np.mean(explored.read("temperature"))), 0.0)
    records.append(
        single(
            explored.read("encoder"),
            explored.read("current_setpoint"),
            explored.read("position_setpoint"),
            _interval(explored),
            own,
        )
    )
    offset = kt.results.get("amplifier_offset")
    known = Known(
        rig.angle_ratio,
        rig.torque_factor,
        rig.nominal_inertia,
        offset.value if offset is not None else 0.0,
    )
    deviating = deviations(records, known.angle_ratio, known.torque_factor)
    learned = learn_sliding(records, known, own.count, deviating, tendon)
    sliding = ForceModel(learned, deviating)
    shown = Exploration(
        explored.read("encoder"),
        explored.read("current_setpoint"),
        _interval(explored),
        own.torque_constant,
        own.count,
    )
    return ForceModel(learn_rest(sliding.learned, shown, sliding.uncertainty, STEP_TIME), deviating)


def _record(recording: Recording, recipe: Recipe, kt: Run, temperature: float) -> Record:
    force = recording.condition("force") if "force" in recording.conditions else 0.0
    try:
        return repeated(
            recording.read("encoder"),
            recording.read("current_setpoint"),
            recording.read("position_setpoint"),
            _interval(recording),
            _condition(recipe, kt, temperature, force),
        )
    except InsufficientDataError as error:
        raise InsufficientDataError(f"recording {recording.name}: {error}") from None


def _condition(recipe: Recipe, kt: Run, temperature: float, force: float) -> Condition:
    rig = recipe.rig
    return Condition(
        torque_per_ampere_at(kt, temperature).value,
        force * rig.load_arm,
        force * rig.load_arm**2 / constants.g,
        2 * math.pi / rig.encoder_counts,
    )


def _interval(recording: Recording) -> float:
    time = recording.read("time")
    return float((time[-1] - time[0]) / (len(time) - 1))
