"""Standard learning: torque by time along one repeated move, from the error [7.2.4.1, Fig. 37].

    f(k+1) = Q (f(k) + p L e(k)),   L the inverse of Sp = P/(1 + C P) = T/C   [eq. 1-6]

so that L is C times the inverse of T: L Sp is the same as for learning from the controller's torque
[eq. 12], and converges like it. Friction, ripple and acceleration are all learned. An integrator
leaves no mean error, from which nothing could be learned: the mean torque stays with it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rigtool.control.position_loop import TransferFunction
from rigtool.errors import InsufficientDataError
from rigtool.experiments.controller_torque import CHANNELS, SIGNAL, TABLE
from rigtool.experiments.learning.convergence import Cycles, LearningRun, learning_run
from rigtool.experiments.learning.filters import Learning
from rigtool.experiments.learning.implementations import runs as iterations
from rigtool.experiments.learning.implementations import signals as common
from rigtool.experiments.learning.procedure_design import Design, design
from rigtool.experiments.learning.stored_table import TRAJECTORY, feedforward, friction_results
from rigtool.experiments.outcome import Outcome
from rigtool.experiments.procedure import channels, record
from rigtool.experiments.torque_per_ampere import torque_per_ampere
from rigtool.quantity import Quantity
from rigtool.recipe import Recipe
from rigtool.rigs import Feedforward, Rig, Task
from rigtool.rigs.motion import Triangle
from rigtool.runfile import Column, Recording, RecordingSpec, Run, RunWriter, Table

Array = NDArray[np.float64]

RUN_IN = 1
"""Moves that are made first and left out."""

# -- measuring


def recordings(recipe: Recipe) -> tuple[RecordingSpec, ...]:
    """List the learning runs, and one with the final signal."""
    most = iterations.runs_at_most(recipe)
    kinds = [*(iterations.kind_of(updates) for updates in range(most)), "validate"]
    names = [SIGNAL if name == TABLE else name for name in CHANNELS]
    motion = move(recipe)
    conditions = {
        "speed": (motion.speed, "rad/s"),
        "moves": (float(motion.cycles - RUN_IN), "1"),
        "samples": (float(samples(recipe)), "1"),
    }
    return tuple(RecordingSpec(f"{kind}_000", channels(*names), conditions) for kind in kinds)


def samples(recipe: Recipe) -> int:
    """Return how many samples a move to and fro lasts: a whole number, as the signal repeats."""
    settings = recipe.ilc_learn.trajectory
    # A stroke lasts (angle + 2 turn_angle)/speed.
    strokes = 2 * (settings.angle + 2 * settings.turn_angle) / 360
    return round(strokes / settings.speed_rev_per_s / recipe.rig.sample_time)


def move(recipe: Recipe) -> Triangle:
    """Return the repeated move, at the speed that makes it last whole samples."""
    settings, ratio = recipe.ilc_learn.trajectory, recipe.rig.angle_ratio
    angle, turn = (math.radians(a) * ratio for a in (settings.angle, settings.turn_angle))
    speed = 2 * (angle + 2 * turn) / (samples(recipe) * recipe.rig.sample_time)
    return Triangle(0.0, angle, speed, turn, settings.moves + RUN_IN)


def measure(
    rig: Rig,
    recipe: Recipe,
    recorder: RunWriter,
    *,
    kt: Run,
    friction: Run | None = None,
    plant: Run | None = None,
) -> None:
    """Make the move again and again, each run with what was learned so far."""
    filters = design(recipe, plant)
    constant = torque_per_ampere(kt).value
    friction_alone = feedforward(0.0, friction_results(friction))

    def perform(kind: str, signal: Array | None) -> Recording:
        fed = Feedforward(
            coulomb=friction_alone.coulomb, viscous=friction_alone.viscous, signal=signal
        )
        record(rig, Task(move(recipe), fed), recorder, f"{kind}_000")
        return recorder.recording(f"{kind}_000")

    learned = iterations.run_by_run(
        recipe,
        perform("learn", None),
        lambda runs: _learn(runs, recipe, constant, filters),
        lambda kind, so_far: perform(kind, so_far.torque),
    )
    perform("validate", learned.torque)


# -- analysing


@dataclass(frozen=True, eq=False)
class _Moves:
    """A run's moves: error (m, n) rad, and the same as cycles of torque C e."""

    setpoint: Array
    error: Array
    cycles: Cycles


@dataclass(frozen=True, eq=False)
class _Learned:
    """The learned signal (n,) N m, its standard uncertainty, and all runs."""

    torque: Array
    u: Array
    runs: list[_Moves]
    history: list[LearningRun]


def analyse(
    runs: Sequence[Run],
    recipe: Recipe,
    *,
    kt: Run,
    friction: Run | None = None,
    plant: Run | None = None,
) -> Outcome:
    """Learn from the stored moves, and say what error remained, run by run."""
    run, filters = common.only_run(runs), design(recipe, plant)
    constant, fed = torque_per_ampere(kt).value, friction_results(friction)
    recorded = [recordings[0] for recordings in iterations.recorded_runs(run, recipe)]
    learned = _learn(recorded, recipe, constant, filters)
    final = _cut(common.found(run, "validate")[0], recipe, constant, filters.controller)
    updates = len(learned.history)
    check = _judge(final, filters.learning, updates)
    history = learned.history
    if updates == 1 or not history[-1].finished:
        history = [*history, check]
    first = learned.history[0]
    ratio = check.rms / first.rms
    relative = math.hypot(check.rms_u / check.rms, first.rms_u / first.rms)
    dof = float(len(final.error) - 1)
    results = {
        "error_peak": Quantity(check.peak, "rad", check.peak_u, dof),
        "error_rms": Quantity(check.rms, "rad", check.rms_u, dof),
        "error_reduction": Quantity(1 - ratio, "1", ratio * relative, dof),
        **filters.results(),
        **fed,
    }
    tables = {
        TRAJECTORY: _trajectory(learned, final, recipe, filters.learning),
        "iterations": iterations.iterations_table(history, "rad", "error"),
        **filters.tables(),
    }
    most = iterations.runs_at_most(recipe)
    notes = (
        "learned by time: what was learned holds for this one move only",
        *filters.notes(),
        *iterations.iterations_notes(learned.history, 1e3, "mrad", most),
    )
    return Outcome(results, tables, notes)


def _learn(
    recorded: Sequence[Recording], recipe: Recipe, torque_constant: float, filters: Design
) -> _Learned:
    """Return what all runs so far teach."""
    learning = filters.learning
    runs = [_cut(r, recipe, torque_constant, filters.controller) for r in recorded]
    history = [_judge(run, learning, updates) for updates, run in enumerate(runs)]
    last = iterations.last_to_learn_from(history)
    cycles = runs[last].cycles
    each = learning.updated(cycles.signal, cycles.period, cycles.before)
    spread = iterations.spread(last + 1, learning.factor)
    u = np.sqrt(spread * each.var(axis=0, ddof=1) / len(each))
    return _Learned(each.mean(axis=0), u, runs, history)


def _judge(run: _Moves, learning: Learning, updates: int) -> LearningRun:
    return learning_run([run.cycles], learning, updates, shown=[_centred(run.error)])


def _centred(error: Array) -> Array:
    """Take the mean off: half a count of the encoder, and what the integrator sees to."""
    centred: Array = error - error.mean()
    return centred


def _cut(
    recording: Recording, recipe: Recipe, torque_constant: float, controller: TransferFunction
) -> _Moves:
    """Cut a recording into moves of a whole number of samples."""
    found = common.signals(recording, recipe)
    count, moves = (int(recording.condition(name)) for name in ("samples", "moves"))
    if len(found.time) < (moves + RUN_IN) * count:
        raise InsufficientDataError(
            f"recording {recording.name}: {len(found.time)} samples, {moves + RUN_IN} moves of "
            f"{count} are needed: record them all"
        )
    used = slice(RUN_IN * count, (RUN_IN + moves) * count)
    error = (found.setpoint - found.rotor)[used].reshape(moves, count)
    before = (torque_constant * found.learned)[used].reshape(moves, count).mean(axis=0)
    period = count * recipe.rig.sample_time
    torque = _through(error, period, controller)
    everything = np.ones(count, dtype=np.bool_)
    cycles = Cycles(period, torque, before, everything)
    return _Moves(found.setpoint[used][:count], error, cycles)


def _through(error: Array, period: float, controller: TransferFunction) -> Array:
    """Return C e (m, n), without its mean: that of an integrator is not defined."""
    count = error.shape[1]
    frequency = np.fft.rfftfreq(count, period / count)
    response = np.zeros(frequency.size, dtype=np.complex128)
    response[1:] = controller.response(frequency[1:])
    torque: Array = np.fft.irfft(np.fft.rfft(error, axis=1) * response, count, axis=1)
    return torque


def _trajectory(learned: _Learned, final: _Moves, recipe: Recipe, learning: Learning) -> Table:
    count = learned.torque.size
    period = final.cycles.period

    def mean_error(run: _Moves) -> Array:
        mean: Array = learning.smoothed(_centred(run.error), period).mean(axis=0)
        return mean

    return Table(
        ("time",),
        {
            "time": Column(np.arange(float(count)) * recipe.rig.sample_time, "s", "of the move"),
            "position": Column(final.setpoint, "rad", "set point of the motor shaft"),
            "torque": Column(learned.torque, "N m", "feed-forward torque that was learned"),
            "u": Column(learned.u, "N m", "standard uncertainty"),
            "error_before": Column(mean_error(learned.runs[0]), "rad", "mean of the moves"),
            "error_after": Column(mean_error(final), "rad", "mean of the moves"),
        },
        "torque",
        "learned torque along the repeated move, and its error within the band of Q",
    )
