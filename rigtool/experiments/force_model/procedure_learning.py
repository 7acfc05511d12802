"""From recordings of known loads to the model of motor and instrument that force is read with."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import constants

from rigtool.experiments.controller_torque import CHANNELS as LOOP_CHANNELS
from rigtool.experiments.controller_torque import LoopSignals, loop_signals, naming
from rigtool.experiments.force_filter.estimate import Filter, smoothed
from rigtool.experiments.force_filter.motion_states import Judge, Moments, Reach, State, States
from rigtool.experiments.force_filter.plant import HOUSING, SPEED
from rigtool.experiments.force_model.deviations import deviations, kept_by_mean
from rigtool.experiments.force_model.force_model import ForceModel
from rigtool.experiments.force_model.learning import Sliding, learn_sliding
from rigtool.experiments.force_model.model import Known
from rigtool.experiments.force_model.model import State as Swing
from rigtool.experiments.force_model.procedure_exploration import exploration
from rigtool.experiments.force_model.records import Condition, Record, repeated, single
from rigtool.experiments.force_model.rest import SETTLING, Exploration, learn_rest
from rigtool.experiments.force_model.steps import Grid, Sampler
from rigtool.experiments.torque_per_ampere import torque_per_ampere_at
from rigtool.recipe import Recipe
from rigtool.rigs.motion import SpeedProfile
from rigtool.runfile import Recording, Run

Array = NDArray[np.float64]

CHANNELS = (*LOOP_CHANNELS, "temperature")
"""What is recorded of a hanging load."""

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

ANYWHERE = Reach((-math.inf, math.inf), math.inf, math.inf, (-math.inf, math.inf))


def exploring(recipe: Recipe, number: int = 0) -> SpeedProfile:
    """Return the motion that shows rest and reversals, from the lower end on.

    The model is learned from number 0, without load, and checked with the others.
    """
    rig, settings = recipe.rig, recipe.ilc_learn
    high = math.radians(recipe.measure_force.angle) * rig.angle_ratio
    fastest = 2 * math.pi * rig.angle_ratio * min(FREE_SPEED, max(settings.speeds_rev_per_s))
    count = 2 * math.pi / rig.encoder_counts
    return exploration(0.0, high, count, fastest, FREE_TIME, number)


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
    checks: Sequence[Recording],
    recipe: Recipe,
    kt: Run,
) -> LearnedForce:
    """Learn from strokes under known loads, moves without one, and the exploration.

    `checks` are motions under known loads that nothing is fitted to: they show what u is.
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
    kept = math.sqrt(kept_by_mean(records, known.angle_ratio))
    of_means = replace(deviating, stroke=kept * deviating.stroke, load=kept * deviating.load)
    sliding = learn_sliding(records, known, own.count, of_means)
    shown = Exploration(signals.encoder, signals.total, interval, own.torque_constant, own.count)
    uncertainty = ForceModel(sliding.learned, deviating).uncertainty
    rested = learn_rest(sliding.learned, shown, uncertainty, STEP_TIME)
    model = ForceModel(rested, deviating)
    if checks:
        model = replace(model, scales=scales([_errors(r, recipe, kt, model) for r in checks]))
    return LearnedForce(model, sliding, loaded)


def _errors(
    recording: Recording, recipe: Recipe, kt: Run, model: ForceModel
) -> tuple[Array, States]:
    """Return errors of smoothed and causal torque over their deviations (2, m), and states (m,).

    What acts is a hanging load that swings on its tendon: F r sin a + J a''.
    """
    from scipy.signal import butter, sosfilt, sosfiltfilt

    degc, force = recording.read("temperature"), recording.condition("force")
    own, under = _signals(recording, recipe), _condition(recipe, kt, float(np.mean(degc)), force)
    grid, bandwidth = Grid.of(_interval(own)), recipe.measure_force.motion.bandwidth_hz
    known = np.array([own.encoder, own.total, np.full(len(degc), under.torque_constant)])
    signals, _ = Sampler(grid, under.count, model.drive).add(known, last=True)
    filtered = model.plant(grid.sample_time), model.uncertainty, grid.step_samples, bandwidth
    causal = Filter(*filtered).add(signals)
    torque, deviation = smoothed(*filtered, signals)
    moving, zeros = (causal.states[:, SPEED], causal.states[:, HOUSING]), np.zeros(len(torque))
    judge = Judge(ANYWHERE, under.count, grid.step_time)
    states = judge.states(Moments(causal.low, *moving, torque, zeros, zeros))
    record = single(own.encoder, own.total, own.setpoint, _interval(own), under)
    output = Swing.of(model.learned.shape, model.learned.known, record).output
    speed = np.gradient(output, record.interval)
    acting = under.moment * np.sin(output)
    acting += under.load_inertia * np.gradient(speed, record.interval)
    time = (1 + np.arange(len(torque))) * grid.step_time
    truth = np.interp(time, (0.5 + np.arange(len(acting))) * record.interval, acting)
    sections = butter(2, bandwidth, fs=1 / grid.step_time, output="sos")
    later = sosfiltfilt(sections, torque - truth) / deviation
    at_once = (causal.passed - sosfilt(sections, truth)) / causal.deviation
    margin, every = round(SETTLING / grid.step_time), max(1, round(APART / grid.step_time))
    chosen = slice(margin, -margin, every)
    return np.stack([later, at_once])[:, chosen], states[chosen]


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
