"""From recordings of known loads to the model of motor and instrument that force is read with."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import constants

from rigtool.errors import InsufficientDataError
from rigtool.experiments.force_over_time.deviations import deviations
from rigtool.experiments.force_over_time.estimate import Filter, smoothed
from rigtool.experiments.force_over_time.force_model import ForceModel
from rigtool.experiments.force_over_time.learning import learn_sliding
from rigtool.experiments.force_over_time.model import Known
from rigtool.experiments.force_over_time.model import State as Swing
from rigtool.experiments.force_over_time.motion_states import State, States, moving_states
from rigtool.experiments.force_over_time.plant import HOUSING, SPEED
from rigtool.experiments.force_over_time.procedure_exploration import exploration
from rigtool.experiments.force_over_time.records import Condition, Record, repeated, single
from rigtool.experiments.force_over_time.rest import SETTLING, Exploration, learn_rest
from rigtool.experiments.force_over_time.steps import Grid
from rigtool.experiments.load_disturbance.tendon import Tendon
from rigtool.experiments.torque_per_ampere import torque_per_ampere_at
from rigtool.recipe import Recipe
from rigtool.rigs.motion import SpeedProfile
from rigtool.runfile import Recording, Run

Array = NDArray[np.float64]

FREE_TIME = 14.0
"""Of the exploration's free motion, s."""

FREE_SPEED = 2.0
"""Highest speed of free motion, rev/s of the output, where that was learned."""

STEP_TIME = 1e-3
"""Of the filter, s."""

COVERAGE_FACTOR = 1.96
"""Of an interval of 95 %, normal distribution (GUM 6.2.2)."""

FEWEST = 100
"""Steps of a state without which its factor is that of all states."""

APART = 20e-3
"""From one compared step to the next, s."""


def exploring(recipe: Recipe, number: int = 0) -> SpeedProfile:
    """Return the motion that shows rest and reversals, from the lower end on.

    The model is learned from number 0, without load, and checked with the others.
    """
    rig, settings = recipe.rig, recipe.ilc_learn
    high = math.radians(recipe.measure_force.angle) * rig.angle_ratio
    fastest = 2 * math.pi * rig.angle_ratio * min(FREE_SPEED, max(settings.speeds_rev_per_s))
    count = 2 * math.pi / rig.encoder_counts
    return exploration(0.0, high, count, fastest, FREE_TIME, number)


def learn_force(
    strokes: Sequence[Recording],
    moves: Sequence[Recording],
    explored: Recording,
    checks: Sequence[Recording],
    recipe: Recipe,
    kt: Run,
    tendon: Tendon,
) -> ForceModel:
    """Learn from strokes under known loads, moves without one, and the exploration.

    `checks` are motions under known loads that nothing is fitted to: they show what u is.
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
    records.append(_single(explored, own))
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
    whole = ForceModel(
        learn_rest(sliding.learned, shown, sliding.uncertainty, STEP_TIME), deviating
    )
    parts = [_errors(recording, recipe, kt, whole) for recording in checks]
    return replace(whole, scales=scales(parts)) if parts else whole


def _errors(
    recording: Recording, recipe: Recipe, kt: Run, model: ForceModel
) -> tuple[Array, States]:
    """Return errors of smoothed and causal torque over their deviations (2, m), and states (m,).

    What acts is a hanging load that swings on its tendon: F r sin a + J a''.
    """
    from scipy.signal import butter, sosfilt, sosfiltfilt

    force, degc = recording.condition("force"), float(np.mean(recording.read("temperature")))
    under, interval = _condition(recipe, kt, degc, force), _interval(recording)
    grid, bandwidth = Grid.of(interval), recipe.measure_force.motion.bandwidth_hz
    encoder, current = recording.read("encoder"), recording.read("current_setpoint")
    signals = grid.signals(encoder, current, under.count, model.drive, under.torque_constant)
    filtered = model.plant(grid.sample_time), model.uncertainty, grid.step_samples, bandwidth
    causal = Filter(*filtered).add(signals)
    torque, deviation = smoothed(*filtered, signals)
    step_time = grid.step_samples * grid.sample_time
    low = signals.low[grid.step_samples :: grid.step_samples][: len(torque)]
    moving = causal.states[:, SPEED], causal.states[:, HOUSING]
    states = moving_states(low, *moving, torque, under.count, step_time)
    record = _single(recording, under)
    output = Swing.of(model.learned.shape, model.learned.known, record).output
    acting = under.moment * np.sin(output)
    acting += under.load_inertia * np.gradient(
        np.gradient(output, record.interval), record.interval
    )
    time = (1 + np.arange(len(torque))) * step_time
    truth = np.interp(time, (0.5 + np.arange(len(acting))) * record.interval, acting)
    sections = butter(2, bandwidth, fs=1 / step_time, output="sos")
    later = sosfiltfilt(sections, torque - truth) / deviation
    at_once = (causal.passed - sosfilt(sections, truth)) / causal.deviation
    settled = slice(round(SETTLING / step_time), -round(SETTLING / step_time))
    every = max(1, round(APART / step_time))
    return np.stack([later, at_once])[:, settled][:, ::every], states[settled][::every]


def scales(parts: Sequence[tuple[Array, States]]) -> Array:
    """Return the factor of each state (2, states), see `ForceModel`.

    The 95 % quantile of |error| / deviation over that of a normal distribution; 1 at least, as
    hanging loads change less than others. `parts` are errors over deviations (2, m) and states.
    """
    ratio = np.abs(np.hstack([errors for errors, _ in parts]))
    states = np.concatenate([own for _, own in parts])
    factors = np.ones((2, len(State)))
    for state in State:
        chosen = states == state
        if chosen.sum() < FEWEST:
            chosen[:] = True
        quantile = np.quantile(ratio[:, chosen], 0.95, axis=1)
        factors[:, state] = np.maximum(quantile / COVERAGE_FACTOR, 1.0)
    return factors


def _single(recording: Recording, under: Condition) -> Record:
    return single(
        recording.read("encoder"),
        recording.read("current_setpoint"),
        recording.read("position_setpoint"),
        _interval(recording),
        under,
    )


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
