"""Standard learning: torque by time along one repeated move, from the error [7.2.4.1, Fig. 37].

    f(k+1) = Q (f(k) + p L e(k)),   L the inverse of Sp = P/(1 + C P) = T/C   [eq. 1-6]

so that L is C times the inverse of T: L Sp is the same as for learning from the controller's torque
[eq. 12], and converges like it. Friction, ripple and acceleration are all learned. An integrator
leaves no mean error, from which nothing could be learned: the mean torque stays with it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rigtool.control.position_loop import TransferFunction
from rigtool.errors import InsufficientDataError
from rigtool.experiments.controller_torque import LOOP_CHANNELS, SIGNAL, TABLE
from rigtool.experiments.learning.convergence import Cycles, LearningRun, learning_run
from rigtool.experiments.learning.filters import Learning
from rigtool.experiments.learning.implementations import signals as common
from rigtool.experiments.learning.implementations.runs import (
    iterations_table,
    kind_of,
    last_update,
    runs_at_most,
)
from rigtool.experiments.learning.implementations.skeleton import Implementation, LearningReport
from rigtool.experiments.learning.stored_table import TRAJECTORY_TABLE
from rigtool.experiments.procedure import channels
from rigtool.numerics.arrays import Array
from rigtool.quantity import combined, error_line, scattered
from rigtool.recipe import Recipe
from rigtool.rigs import Feedforward, Task
from rigtool.rigs.motion import Triangle
from rigtool.runfile import Column, Recording, RecordingSpec, Run, Table, dof_column

RUN_IN = 1
"""Moves that are made first and left out."""


@dataclass(frozen=True, eq=False)
class _Moves:
    """A run's moves: error (m, n) rad, and the same as cycles of torque C e."""

    setpoint: Array
    error: Array
    cycles: Cycles


@dataclass(frozen=True, eq=False)
class TaughtSignal:
    """The learned signal (n,) N m, its standard uncertainty with `dof`, and all runs."""

    torque: Array
    u: Array
    dof: int
    runs: list[_Moves]
    history: list[LearningRun]


class RepeatedMove(Implementation[TaughtSignal]):
    """Learning by time along one move."""

    RIG_NEED = "signal"
    UNIT = "mrad"

    @staticmethod
    def kinds(recipe: Recipe) -> dict[str, list[RecordingSpec]]:
        """Return the learning runs, and one with the final signal."""
        kinds = [*(kind_of(updates) for updates in range(runs_at_most(recipe))), "validate"]
        recorded = channels(*(SIGNAL if name == TABLE else name for name in LOOP_CHANNELS))
        motion = move(recipe)
        conditions = {
            "speed": (motion.speed, "rad/s"),
            "moves": (float(motion.cycles - RUN_IN), "1"),
            "samples": (float(samples(recipe)), "1"),
        }
        return {kind: [RecordingSpec(f"{kind}_000", recorded, conditions)] for kind in kinds}

    def task(self, spec: RecordingSpec, fed: Feedforward) -> Task:
        """Return the move with this fed forward; acceleration is learned, not modelled."""
        return Task(move(self.recipe), replace(fed, inertia=0.0))

    def fed(self, taught: TaughtSignal) -> Feedforward:
        """Return the feed-forward with the learned signal."""
        return replace(self.plain, signal=taught.torque)

    def learn(
        self, runs: Sequence[Sequence[Recording]], slower: Sequence[Recording]
    ) -> TaughtSignal:
        """Return the signal that all runs so far teach."""
        learning = self.learning
        cut = [self._cut(run[0]) for run in runs]
        history = [self._judge(run, updates) for updates, run in enumerate(cut)]
        last, variance = last_update(history, learning.factor)
        cycles = cut[last].cycles
        each = learning.updated(cycles.signal, cycles.period, cycles.before)
        u = np.sqrt(variance * each.var(axis=0, ddof=1) / len(each))
        return TaughtSignal(each.mean(axis=0), u, len(each) - 1, cut, history)

    def report(
        self, run: Run, taught: TaughtSignal, recorded: Sequence[Sequence[Recording]]
    ) -> LearningReport:
        """Report the remaining error, run by run."""
        final = self._cut(run.recordings_of("validate")[0])
        history, first = taught.history, taught.history[0]
        check = self._judge(final, len(history))
        if len(history) == 1 or not history[-1].finished:
            history = [*history, check]
        ratio, dof = check.rms / first.rms, float(len(final.error) - 1)
        runs = {"scatter of the first run": first, "scatter of the last run": check}
        lines = [
            error_line(name, ratio * one.rms_u / one.rms, "1", dof) for name, one in runs.items()
        ]
        return LearningReport(
            {
                "error_peak": scattered(check.peak, "rad", check.peak_u, dof),
                "error_rms": scattered(check.rms, "rad", check.rms_u, dof),
                "error_reduction": combined(1 - ratio, "1", lines),
            },
            {
                TRAJECTORY_TABLE: _trajectory(taught, final, self.recipe, self.learning),
                "iterations": iterations_table(history, "rad", "error"),
            },
            ("learned by time: the table is valid for this one move only",),
        )

    def _judge(self, run: _Moves, updates: int) -> LearningRun:
        return learning_run([run.cycles], self.learning, updates, shown=[_centred(run.error)])

    def _cut(self, recording: Recording) -> _Moves:
        """Cut a recording into moves of a whole number of samples."""
        found = common.signals(recording, self.recipe)
        count, moves = (int(recording.condition(name)) for name in ("samples", "moves"))
        if len(found.time) < (moves + RUN_IN) * count:
            raise InsufficientDataError(
                f"recording {recording.name}: {len(found.time)} samples, {moves + RUN_IN} moves of "
                f"{count} are needed: record them all"
            )
        used = slice(RUN_IN * count, (RUN_IN + moves) * count)
        error = (found.setpoint - found.rotor)[used].reshape(moves, count)
        learned = (self.torque_constant * found.learned)[used].reshape(moves, count)
        period = count * self.recipe.rig.sample_time
        torque = _through(error, period, self.filters.controller)
        everything = np.ones(count, dtype=np.bool_)
        cycles = Cycles(period, torque, learned.mean(axis=0), everything)
        return _Moves(found.setpoint[used][:count], error, cycles)


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


def _centred(error: Array) -> Array:
    """Subtract the mean: half a count of the encoder, and the part that the integrator controls."""
    return error - error.mean()


def _through(error: Array, period: float, controller: TransferFunction) -> Array:
    """Return C e (m, n), without its mean: that of an integrator is not defined."""
    count = error.shape[1]
    frequency = np.fft.rfftfreq(count, period / count)
    response = np.zeros(frequency.size, dtype=np.complex128)
    response[1:] = controller.response(frequency[1:])
    return np.fft.irfft(np.fft.rfft(error) * response, count)


def _trajectory(learned: TaughtSignal, final: _Moves, recipe: Recipe, learning: Learning) -> Table:
    count = learned.torque.size
    period = final.cycles.period

    def mean_error(run: _Moves) -> Array:
        return learning.smoothed(_centred(run.error), period).mean(axis=0)

    return Table(
        ("time",),
        {
            "time": Column(np.arange(float(count)) * recipe.rig.sample_time, "s", "of the move"),
            "position": Column(final.setpoint, "rad", "set point of the motor shaft"),
            "torque": Column(learned.torque, "N m", "feed-forward torque that was learned"),
            "u": Column(learned.u, "N m", "standard uncertainty"),
            "dof": dof_column(np.full(count, learned.dof)),
            "error_before": Column(mean_error(learned.runs[0]), "rad", "mean of the moves"),
            "error_after": Column(mean_error(final), "rad", "mean of the moves"),
        },
        "torque",
        "learned torque along the repeated move, and its error within the band of Q",
    )
