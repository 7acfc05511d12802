"""Implementation C, 'limited rotation angle' [7.2.4.2, Fig. 55, 56].

At each speed the rig moves to and fro, one learning update makes two rows of the table, low speeds
give the amplitude table. Then the rig repeats the moves with the table switched on, and the
remaining disturbance is reported.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rigtool.control.lookup_table import LookupTable
from rigtool.errors import RunFileError
from rigtool.experiments.controller_torque import LOOP_CHANNELS, naming
from rigtool.experiments.learning.convergence import Cycles, learning_run
from rigtool.experiments.learning.implementations import signals as common
from rigtool.experiments.learning.implementations.runs import (
    iterations_table,
    kind_of,
    last_update,
    runs_at_most,
)
from rigtool.experiments.learning.implementations.skeleton import (
    Implementation,
    LearningReport,
    TaughtTable,
)
from rigtool.experiments.learning.implementations.validation import (
    Steady,
    midpoints,
    steady_outcome,
)
from rigtool.experiments.learning.results_residual import Remaining
from rigtool.experiments.learning.rows import (
    Row,
    assemble,
    fit_amplitudes,
    learned_rows,
    torque_rows,
)
from rigtool.experiments.learning.stored_table import tables_of
from rigtool.experiments.procedure import channels
from rigtool.numerics.arrays import Array
from rigtool.numerics.moves import Moves, at_positions, cut_moves
from rigtool.quantity import Quantity
from rigtool.recipe import Recipe
from rigtool.rigs import Feedforward, Task
from rigtool.rigs.motion import Triangle
from rigtool.runfile import Recording, RecordingSpec, Run, Table


@dataclass(frozen=True, eq=False)
class TaughtMoves(TaughtTable):
    """The table, and the first run's moves by speed, without it."""

    moves: dict[float, Moves]


class LimitedAngle(Implementation[TaughtMoves]):
    """Learning from moves to and fro."""

    @staticmethod
    def kinds(recipe: Recipe) -> dict[str, list[RecordingSpec]]:
        """Return the learning runs, the low-speed runs and the validation runs."""
        settings = recipe.ilc_learn
        speeds, low = settings.speeds_rev_per_s, settings.low_speeds_rev_per_s
        between = midpoints((*low, *speeds)) if settings.validation else ()
        later = [kind_of(updates) for updates in range(1, runs_at_most(recipe))]
        return {
            "learn": specs(recipe, "learn", speeds, settings.moves),
            "low": specs(recipe, "low", low, settings.low_speed_moves),
            **{kind: specs(recipe, kind, speeds, settings.moves) for kind in (*later, "validate")},
            **{kind: specs(recipe, kind, between, settings.moves) for kind in ("off", "on")},
        }

    def task(self, spec: RecordingSpec, fed: Feedforward) -> Task:
        """Return the moves of a recording with this feed-forward."""
        return Task(motion(self.recipe, spec), fed)

    def fed(self, taught: TaughtMoves) -> Feedforward:
        """Return the feed-forward with the table on."""
        return replace(self.plain, table=taught.table)

    def require_friction_fed(self, recording: Recording) -> None:
        """Raise `RunFileError` unless the friction that is given was fed forward."""
        require_feedforward(recording, self.recipe, self.torque_constant, self.friction)

    def learn(
        self, runs: Sequence[Sequence[Recording]], slower: Sequence[Recording]
    ) -> TaughtMoves:
        """Make the table from the learning runs and from those at the low speeds."""
        settings, learning = self.recipe.ilc_learn, self.learning
        position = positions(self.recipe, settings.turn_angle)
        cut = [[(r.condition("speed"), *self._moves(r)) for r in run] for run in runs]
        history = [
            learning_run([self._cycles(m, before) for _, m, before in run], learning, updates)
            for updates, run in enumerate(cut)
        ]
        rows: list[Row] = []
        low_rows: list[Row] = []
        last, variance = last_update(history, learning.factor)
        for speed, moves, before in cut[last]:
            rows += learned_rows(moves, speed, learning, position, before)
        for recording in slower:
            moves, _ = self._moves(recording, settings.low_speed_moves)
            low_rows += learned_rows(moves, recording.condition("speed"), learning, position)
        rows.sort(key=lambda row: row.speed)
        amplitudes = fit_amplitudes(low_rows, rows)
        wider = math.sqrt(variance)
        u = wider * np.stack([row.u for row in rows])
        first = {speed: moves for speed, moves, _ in cut[0]}
        dof = np.array([row.dof for row in rows])
        return TaughtMoves(assemble(position, rows, amplitudes), u, dof, amplitudes, history, first)

    def report(
        self, run: Run, taught: TaughtMoves, recorded: Sequence[Sequence[Recording]]
    ) -> LearningReport:
        """Report the table, and the remaining disturbance with it on."""
        remaining = self._remaining(taught, run.recordings_of("validate"))
        between = steady_outcome(self._validated(run, remaining))
        repeated: dict[str, Table] = {}
        if runs_at_most(self.recipe) > 1:
            repeated["iterations"] = iterations_table(taught.history, "N m", "controller torque")
        table = taught.table
        low, high = math.degrees(table.position[0]), math.degrees(table.position[-1])
        return LearningReport(
            {**remaining.results(), **between.results},
            {
                **tables_of(table, taught.u, taught.amplitudes, taught.dof),
                **remaining.tables(),
                **repeated,
                **between.tables,
            },
            (
                f"learned from {low:.4g} to {high:.4g} deg of the motor at up to "
                f"{table.speed[-1]:.4g} rad/s; the table does not extrapolate",
            ),
            remaining.notes(self._fed(table, run.recordings_of("validate"))),
            between,
        )

    def _moves(self, recording: Recording, moves: int | None = None) -> tuple[Moves, Array]:
        count = self.recipe.ilc_learn.moves if moves is None else moves
        return moves_of(recording, self.recipe, self.torque_constant, count)

    def _cycles(self, moves: Moves, before: Array) -> Cycles:
        """Return moves as cycles, of which the part counts where the table is learned."""
        position = positions(self.recipe, self.recipe.ilc_learn.end_angle)
        used = (moves.setpoint >= position[0]) & (moves.setpoint <= position[-1])
        return Cycles(moves.period, moves.torque, before, used)

    def _remaining(self, taught: TaughtMoves, validate: Sequence[Recording]) -> Remaining:
        """Compare the moves with the table switched on with those that it was learned from."""
        position = positions(self.recipe, self.recipe.ilc_learn.end_angle)
        found: list[tuple[Row, Row, Array]] = []
        for recording in validate:
            speed = recording.condition("speed")
            if speed not in taught.moves:
                raise RunFileError(
                    f"recording {recording.name}: its speed of {speed:.4g} rad/s was not learned, "
                    f"only {', '.join(f'{known:.4g}' for known in taught.moves)}: record both at "
                    "one speed"
                )
            after, table = self._moves(recording)
            applied = [at_positions(after, table, position, sign) for sign in (-1, 1)]
            found += zip(
                torque_rows(taught.moves[speed], speed, self.learning, position),
                torque_rows(after, speed, self.learning, position),
                applied,
                strict=True,
            )
        found.sort(key=lambda item: item[0].speed)
        rows_before, rows_after, torques = zip(*found, strict=True)
        return Remaining(position, rows_before, rows_after, np.stack(torques))

    def _fed(self, table: LookupTable, validate: Sequence[Recording]) -> Array:
        """Return what a table adds, N m (rows, n), read as the table's recorded current is.

        Both are samples of the loop, between which a straight line leaves out how a table bends.
        """
        position = positions(self.recipe, self.recipe.ilc_learn.end_angle)
        found: list[tuple[float, Array]] = []
        for recording in validate:
            speed = recording.condition("speed")
            time, setpoint = recording.read("time"), recording.read("position_setpoint")
            fed = table.evaluate(setpoint, speed * np.sign(np.gradient(setpoint)))
            cut = cut_moves(time, setpoint, fed, moves=1)
            found += [
                (sign * speed, at_positions(cut, cut.torque[0], position, sign)) for sign in (-1, 1)
            ]
        return np.stack([torque for _, torque in sorted(found, key=lambda item: item[0])])

    def _validated(self, run: Run, remaining: Remaining) -> list[Steady]:
        """Compare moves without and with the table, at learned speeds and in between."""
        position = positions(self.recipe, self.recipe.ilc_learn.end_angle)
        off, on = (
            [
                row
                for r in run.recordings_named(f"{kind}_")
                for row in torque_rows(
                    self._moves(r)[0], r.condition("speed"), self.learning, position
                )
            ]
            for kind in ("off", "on")
        )
        if not on:
            return []
        known = zip(remaining.before, remaining.after, strict=True)
        return [
            *(Steady(before, after, "learned") for before, after in known),
            *(Steady(before, after) for before, after in zip(off, on, strict=True)),
        ]


def specs(
    recipe: Recipe, kind: str, speeds_rev_per_s: Iterable[float], moves: int
) -> list[RecordingSpec]:
    """Return recordings of moves to and fro at these speeds of the output, rev/s."""
    count = float(moves), "1"
    speeds = [recipe.rig.motor_speed(speed) for speed in speeds_rev_per_s]
    return [
        RecordingSpec(
            f"{kind}_{number:03d}",
            channels(*LOOP_CHANNELS),
            {"speed": (speed, "rad/s"), "moves": count},
        )
        for number, speed in enumerate(speeds)
    ]


def motion(recipe: Recipe, spec: RecordingSpec) -> Triangle:
    """Return the moves of a recording: one more than is used, since the first one runs in."""
    settings, ratio = recipe.ilc_learn, recipe.rig.angle_ratio
    speed, moves = (spec.conditions[name][0] for name in ("speed", "moves"))
    return Triangle.of_output(settings.angle, settings.turn_angle, ratio, speed, int(moves) + 1)


def positions(recipe: Recipe, end_angle: float) -> Array:
    """Return the motor angles of all quad counts, rad, with `end_angle` left out at each end.

    `end_angle` is one of the output, deg.
    """
    rig, settings = recipe.rig, recipe.ilc_learn
    per_degree = rig.angle_ratio * rig.encoder_counts / 360
    first = math.ceil(end_angle * per_degree)
    last = math.floor((settings.angle - end_angle) * per_degree)
    return np.arange(float(first), last + 1) * rig.count_angle


def moves_of(
    recording: Recording, recipe: Recipe, torque_constant: float, moves: int
) -> tuple[Moves, Array]:
    """Cut a recording into moves of the controller's torque, and of the table's."""
    found = common.signals(recording, recipe)
    with naming(recording):
        cut = cut_moves(found.time, found.setpoint, torque_constant * found.controller, moves)
        table = cut_moves(found.time, found.setpoint, torque_constant * found.learned, moves=1)
    return cut, table.torque[0]


def require_feedforward(
    recording: Recording, recipe: Recipe, torque_constant: float, fed: dict[str, Quantity]
) -> None:
    """Raise `RunFileError` unless the moves were made with the friction that is given.

    A table belongs to the friction that was fed forward beside it.
    """
    setpoint, current = recording.read("position_setpoint"), recording.read("feedforward_current")
    used = positions(recipe, recipe.ilc_learn.end_angle)
    # At constant speed there is no acceleration; only friction is fed forward.
    straight = (setpoint[1:] > used[0]) & (setpoint[1:] < used[-1]) & (np.diff(setpoint) > 0)
    recorded = torque_constant * float(np.mean(current[1:][straight])) if straight.any() else 0.0
    speed = recording.condition("speed")
    common.require_friction_fed(recording.name, recorded, speed, fed)
