"""From recordings of known loads to the force model of motor and instrument."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rigtool.experiments.controller_torque import LOOP_CHANNELS as LOOP_CHANNELS
from rigtool.experiments.controller_torque import LoopSignals, loop_signals, naming
from rigtool.experiments.force_filter.estimate import Filter
from rigtool.experiments.force_filter.motion_states import (
    CREEP_SPEED_RATIO,
    Judge,
    Moments,
    Reach,
    State,
)
from rigtool.experiments.force_filter.plant import HOUSING, SPEED
from rigtool.experiments.force_filter.smoothed import smoothed
from rigtool.experiments.force_model.contacts import Trial, thresholds, trial
from rigtool.experiments.force_model.deviations import (
    MAX_SCATTER_RATIO,
    deviations,
    kept_by_mean,
    scatter_ratios,
    unseen_deviations,
)
from rigtool.experiments.force_model.force_model import ForceModel
from rigtool.experiments.force_model.intervals import TIME_APART, Errors, beyond, scales
from rigtool.experiments.force_model.learning import SlidingFit, learn_sliding
from rigtool.experiments.force_model.model import Known
from rigtool.experiments.force_model.model import RecordState as Swing
from rigtool.experiments.force_model.procedure_exploration import exploration
from rigtool.experiments.force_model.records import (
    LoadCase,
    Record,
    repeated,
    single,
    slowest_taught,
)
from rigtool.experiments.force_model.rest import (
    FILTER_SETTLING_TIME,
    Exploration,
    learn_rest,
    learn_turns,
)
from rigtool.experiments.torque_per_ampere import torque_per_ampere_at
from rigtool.numerics.lowpass import delayed, lowpass
from rigtool.quantity import STANDARD_GRAVITY
from rigtool.recipe import Recipe
from rigtool.rigs.motion import SpeedProfile
from rigtool.runfile import Recording, Run

LOADED_CHANNELS = (*LOOP_CHANNELS, "temperature")
"""Channels that are recorded under a hanging load."""

FREE_TIME = 14.0
"""Time of the exploration's free motion, s."""

FREE_SPEED = 2.0
"""Highest speed of free motion, rev/s of the output, where that was learned."""

COMPARED_SPEEDS = 2
"""Number of slowest speeds whose strokes, without load and under the largest one, also show u."""

TURNING_SPEED_RATIO = 0.35
"""Part of the highest speed from which on the turns of moves show the inertia: at a third of the
speed it takes a tenth of the torque."""

UNLIMITED_REACH = Reach((-math.inf, math.inf), math.inf, math.inf, (-math.inf, math.inf))


def exploring(recipe: Recipe, number: int = 0) -> SpeedProfile:
    """Return the motion that shows rest and reversals, from the lower end on.

    The model is learned from number 0, without load, and checked with the others.
    """
    rig, settings = recipe.rig, recipe.ilc_learn
    high = math.radians(recipe.measure_force.angle) * rig.angle_ratio
    fastest = 2 * math.pi * rig.angle_ratio * min(FREE_SPEED, max(settings.speeds_rev_per_s))
    return exploration(0.0, high, rig.count_angle, fastest, FREE_TIME, number)


@dataclass(frozen=True)
class LearnedForce:
    """The `model` of motor and instrument; the result of `sliding` alone; the `strokes` under known
    loads by the names of their recordings; the `scatter` of their cycles over that of most strokes;
    and whether they have `shown` how strokes deviate."""

    model: ForceModel
    sliding: SlidingFit
    strokes: dict[str, Record]
    scatter: dict[str, float]
    shown: bool


def learn_force(
    strokes: Sequence[Recording],
    moves: Sequence[Recording],
    switched: Sequence[Recording],
    explored: Recording,
    checks: Sequence[Recording],
    recipe: Recipe,
    kt: Run,
) -> LearnedForce:
    """Learn from strokes under known loads, moves without one, and the exploration.

    `switched` are moves with the learned table switched on, `checks` motions under known loads to
    which nothing is fitted: they show u. Raises `InsufficientDataError` where they do not carry it.
    """
    rig = recipe.rig
    warm = float(np.mean([np.mean(recording.read("temperature")) for recording in strokes]))
    loaded = {r.name: stroke_record(r, recipe, kt, r.condition("force")) for r in strokes}
    scatter = dict(zip(loaded, scatter_ratios(list(loaded.values())), strict=True))
    records = [
        mean
        if scatter[r.name] <= MAX_SCATTER_RATIO
        else replace(_whole(*_known(r, recipe, kt)), passes=mean.cycles)
        for r, mean in zip(strokes, loaded.values(), strict=True)
    ]
    records += [_repeated(r, recipe, kt, warm, 0.0) for r in moves]
    own = _condition(recipe, kt, float(np.mean(explored.read("temperature"))), 0.0)
    signals = _signals(explored, recipe)
    interval = _interval(signals)
    records.append(single(signals.encoder, signals.total, signals.setpoint, interval, own))
    known = Known(
        rig.angle_ratio,
        rig.torque_factor,
        rig.nominal_inertia,
        kt.result("amplifier_offset", "A").value if "amplifier_offset" in kt.results else 0.0,
    )
    seen = deviations(records, known.angle_ratio, known.torque_factor)
    deviating = seen or unseen_deviations(records)
    kept = math.sqrt(kept_by_mean(records, known.angle_ratio))
    of_means = replace(deviating, stroke=kept * deviating.stroke, load=kept * deviating.load)
    sliding = learn_sliding(records, known, own.count, of_means)
    uncertainty = ForceModel(sliding.learned, deviating).uncertainty
    resting = _motion(signals, own)
    under = _condition(recipe, kt, warm, 0.0)
    slow_moves = sorted(switched, key=lambda r: r.condition("speed"))[:1]
    turning = _as_long(resting, slow_moves, recipe, under)
    found = learn_rest(sliding.learned, [resting, *turning], uncertainty)
    if moves:
        least = TURNING_SPEED_RATIO * max(r.condition("speed") for r in moves)
        turns = [_signals(r, recipe) for r in moves if r.condition("speed") >= least]
        found = learn_turns(found, [_motion(turn, under) for turn in turns], uncertainty)
    model = ForceModel(found, deviating)
    speeds = [r.condition("speed") for r in strokes]
    creeping = CREEP_SPEED_RATIO * slowest_taught(speeds, own.count)
    if checks:
        errors = [_errors(r, recipe, kt, model, creeping) for r in checks]
        fitted = [_errors(r, recipe, kt, model, creeping) for r in _compared(strokes)]
        parts = [*errors, *(replace(own, fitted=True) for own in fitted)]
        widths = scales(parts, shown=seen is not None)
        # an error of the known loads is one of all that is read in terms of them
        widths[..., 1] = np.hypot(widths[..., 1], rig.loads_relative_u)
        model = replace(model, scales=widths)
    slow, faster = untouched_motions(strokes, moves, checks)
    free = [_known(r, recipe, kt) for r in (explored, *slow)]
    free += [(_signals(r, recipe), _condition(recipe, kt, warm, 0.0)) for r in faster]
    tried = [_trial(*one, recipe, model, creeping) for one in free]
    # Faster motion with smaller errors must not lower the thresholds of slow motion
    limits = np.maximum(thresholds(tried), thresholds(tried[: 1 + len(slow)]))
    return LearnedForce(replace(model, limits=limits), sliding, loaded, scatter, seen is not None)


def _as_long(
    motion: Exploration, recordings: Sequence[Recording], recipe: Recipe, under: LoadCase
) -> list[Exploration]:
    """Return the first samples of recordings, as many as a motion has, where they have one length
    with it."""
    size, every = len(motion.encoder), [_motion(_signals(r, recipe), under) for r in recordings]
    return [
        replace(one, encoder=one.encoder[:size], current=one.current[:size])
        for one in every
        if math.isclose(one.sample_time, motion.sample_time, rel_tol=1e-6)
    ]


def untouched_motions(
    strokes: Sequence[Recording], moves: Sequence[Recording], checks: Sequence[Recording]
) -> tuple[list[Recording], list[Recording]]:
    """Return the checks without load with the strokes without load at the slowest speed, and the
    faster moves: an error that looks like a contact may show at some speeds only.

    Nothing is fitted to a check: errors of the exploration alone, to which rest is fitted, would
    state too low a threshold.
    """
    slowest = min(r.condition("speed") for r in strokes)
    slow = [r for r in checks if r.condition("force") == 0]
    slow += [r for r in strokes if (r.condition("speed"), r.condition("force")) == (slowest, 0)]
    return slow, [r for r in moves if r.condition("speed") > slowest]


def _compared(strokes: Sequence[Recording]) -> list[Recording]:
    """Return one recording without load and one under the largest, at the slowest speeds."""
    speeds = sorted({r.condition("speed") for r in strokes})[:COMPARED_SPEEDS]
    largest = max(r.condition("force") for r in strokes)
    found = {
        (r.condition("speed"), r.condition("force")): r
        for r in strokes
        if r.condition("speed") in speeds and r.condition("force") in (0.0, largest)
    }
    return list(found.values())


def _known(recording: Recording, recipe: Recipe, kt: Run) -> tuple[LoopSignals, LoadCase]:
    degc, force = float(np.mean(recording.read("temperature"))), recording.condition("force")
    return _signals(recording, recipe), _condition(recipe, kt, degc, force)


def _motion(own: LoopSignals, under: LoadCase) -> Exploration:
    """Return a recording as the filter takes it."""
    interval, constant = _interval(own), under.torque_constant
    return Exploration(own.encoder, own.total, interval, constant, under.count, 2 * under.lead)


def _trial(
    own: LoopSignals, under: LoadCase, recipe: Recipe, model: ForceModel, slow: float
) -> Trial:
    """Return the tests for contacts along a motion in which nothing touches; a sliding rotor
    creeps below `slow` rad/s."""
    motion, corner_hz = _motion(own, under), recipe.measure_force.motion.corner_hz
    grid, signals = motion.grid, motion.under(model.drive)
    plant = model.plant(grid.sample_time)
    causal, untouched = (
        Filter(plant, u, grid.step_samples, corner_hz).add(signals)
        for u in (model.uncertainty, model.untouched)
    )
    moving, zeros = (causal.states[:, SPEED], causal.states[:, HOUSING]), np.zeros(len(causal.low))
    judge = Judge(replace(UNLIMITED_REACH, slow=slow), under.count, grid.step_time, causal=True)
    moments = Moments(causal.low, *moving, causal.passed, zeros, zeros, causal.idle)
    kinds = judge.judged(moments).kinds
    return trial(untouched.torque, untouched.deviation, kinds, grid.step_time)


def _errors(
    recording: Recording, recipe: Recipe, kt: Run, model: ForceModel, slow: float
) -> Errors:
    """Return the errors under a known load; a sliding rotor creeps below `slow` rad/s.

    The torque that acts is that of a hanging load that swings on its tendon: F r sin a + J a''.
    """
    own, under = _known(recording, recipe, kt)
    motion, corner_hz = _motion(own, under), recipe.measure_force.motion.corner_hz
    grid, signals = motion.grid, motion.under(model.drive)
    filtered = model.plant(grid.sample_time), model.uncertainty, grid.step_samples, corner_hz
    causal = Filter(*filtered).add(signals)
    torque, deviation = smoothed(*filtered, signals)
    moving, zeros = (causal.states[:, SPEED], causal.states[:, HOUSING]), np.zeros(len(torque))
    judge = Judge(replace(UNLIMITED_REACH, slow=slow), under.count, grid.step_time)
    moments = Moments(causal.low, *moving, torque, zeros, zeros, causal.idle)
    kinds = judge.judged(moments).kinds
    record = _whole(own, under)
    output = Swing.of(model.learned.shape, model.learned.known, record).output
    speed = np.gradient(output, record.interval)
    acting = under.moment * np.sin(output)
    acting += under.load_inertia * np.gradient(speed, record.interval)
    time = (1 + np.arange(len(torque))) * grid.step_time
    truth = np.interp(time, (0.5 + np.arange(len(acting))) * record.interval, acting)
    later = lowpass(1 / grid.step_time, torque - truth, corner_hz)
    at_once = causal.passed - delayed(1 / grid.step_time, truth, corner_hz)
    margin, every = (round(time / grid.step_time) for time in (FILTER_SETTLING_TIME, TIME_APART))
    chosen = slice(margin, -margin, every)
    return Errors(
        beyond(np.stack([later, at_once]), model.rest_variance * (kinds == State.STILL))[:, chosen],
        np.stack([deviation, causal.deviation])[:, chosen],
        truth[chosen],
        kinds[chosen],
    )


def stroke_record(recording: Recording, recipe: Recipe, kt: Run, force: float = 0.0) -> Record:
    """Average the strokes of a recording under the load of a known force, N.

    The torque constant is that at the motor's temperature in this recording. Raises
    `InsufficientDataError` for less than a cycle, and where the loop saturates or is not held.
    """
    temperature = float(np.mean(recording.read("temperature")))
    return _repeated(recording, recipe, kt, temperature, force)


def _whole(own: LoopSignals, under: LoadCase) -> Record:
    """Return a recording as one motion, whether or not it repeats."""
    return single(own.encoder, own.total, own.setpoint, _interval(own), under)


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


def _condition(recipe: Recipe, kt: Run, temperature: float, force: float) -> LoadCase:
    rig = recipe.rig
    return LoadCase(
        torque_per_ampere_at(kt, temperature).value,
        force * rig.load_arm,
        force * rig.load_arm**2 / STANDARD_GRAVITY,
        rig.count_angle,
        rig.sample_time / 2,
    )


def _interval(signals: LoopSignals) -> float:
    time = signals.time
    return float((time[-1] - time[0]) / (len(time) - 1))
