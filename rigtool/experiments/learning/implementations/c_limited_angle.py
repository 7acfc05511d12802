"""Implementation C, 'limited rotation angle' [7.2.4.2, Fig. 55, 56].

At each speed the rig moves to and fro, one learning update makes two rows of the table, low speeds
give the amplitude table. Then the same moves are made with the table switched on, and what remains
is reported.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rigtool.control.lookup_table import LookupTable
from rigtool.errors import InsufficientDataError, RunFileError
from rigtool.experiments.controller_torque import CHANNELS
from rigtool.experiments.learning.convergence import Cycles, LearningRun, learning_run
from rigtool.experiments.learning.filters import Learning
from rigtool.experiments.learning.implementations import runs as iterations
from rigtool.experiments.learning.implementations import signals as common
from rigtool.experiments.learning.implementations.validation import (
    Steady,
    midpoints,
    steady_outcome,
)
from rigtool.experiments.learning.procedure_design import design
from rigtool.experiments.learning.results_residual import Remaining
from rigtool.experiments.learning.rows import (
    Amplitudes,
    Row,
    assemble,
    fit_amplitudes,
    learned_rows,
    torque_rows,
)
from rigtool.experiments.learning.stored_table import feedforward, friction_results, tables_of
from rigtool.experiments.outcome import Outcome
from rigtool.experiments.procedure import channels, record
from rigtool.experiments.torque_per_ampere import torque_per_ampere
from rigtool.numerics.moves import Moves, at_positions, cut_moves
from rigtool.quantity import Quantity
from rigtool.recipe import Recipe
from rigtool.rigs import Feedforward, Rig, Task
from rigtool.rigs.motion import Triangle
from rigtool.runfile import Recording, RecordingSpec, Run, RunWriter, Table

Array = NDArray[np.float64]

# -- measuring


def recordings(recipe: Recipe) -> tuple[RecordingSpec, ...]:
    """List the learning runs, the low-speed runs and the validation runs."""
    settings = recipe.ilc_learn
    speeds, low = settings.speeds_rev_per_s, settings.low_speeds_rev_per_s
    later = [
        spec
        for updates in range(1, iterations.runs_at_most(recipe))
        for spec in specs(recipe, iterations.kind_of(updates), speeds, settings.moves)
    ]
    between = midpoints((*low, *speeds)) if settings.validation else ()
    return (
        *specs(recipe, "learn", speeds, settings.moves),
        *specs(recipe, "low", low, settings.low_speed_moves),
        *later,
        *specs(recipe, "validate", speeds, settings.moves),
        *specs(recipe, "off", between, settings.moves),
        *specs(recipe, "on", between, settings.moves),
    )


def specs(
    recipe: Recipe, kind: str, speeds_rev_per_s: Iterable[float], moves: int
) -> list[RecordingSpec]:
    """Return recordings of moves to and fro at these speeds of the output, rev/s."""
    recorded = channels(*CHANNELS)
    ratio = recipe.rig.angle_ratio
    return [
        RecordingSpec(
            f"{kind}_{number:03d}",
            recorded,
            {
                "speed": (2 * math.pi * speed * ratio, "rad/s"),
                "moves": (float(moves), "1"),
            },
        )
        for number, speed in enumerate(speeds_rev_per_s)
    ]


def measure(
    rig: Rig,
    recipe: Recipe,
    recorder: RunWriter,
    *,
    kt: Run,
    friction: Run | None = None,
    plant: Run | None = None,
) -> None:
    """Learn at each speed, build the table, and move again with the table switched on."""
    learning = design(recipe, plant).learning
    constant = torque_per_ampere(kt).value
    plain = feedforward(recipe.rig.nominal_inertia, friction_results(friction))
    kinds: dict[str, list[RecordingSpec]] = {}
    for spec in recordings(recipe):
        kinds.setdefault(spec.name.rpartition("_")[0], []).append(spec)

    def move(kind: str, fed: Feedforward) -> list[Recording]:
        specs = kinds.get(kind, [])
        for spec in specs:
            record(rig, Task(motion(recipe, spec), fed), recorder, spec.name)
        return [recorder.recording(spec.name) for spec in specs]

    first = move("learn", plain)
    low = move("low", plain)
    learned = iterations.run_by_run(
        recipe,
        first,
        lambda runs: _learn(runs, low, recipe, constant, learning),
        lambda kind, so_far: move(kind, replace(plain, table=so_far.table)),
    )
    compensated = replace(plain, table=learned.table)
    move("validate", compensated)
    move("off", plain)
    move("on", compensated)


def motion(recipe: Recipe, spec: RecordingSpec) -> Triangle:
    """Return the moves of a recording: one more than is used, since the first one runs in."""
    settings, ratio = recipe.ilc_learn, recipe.rig.angle_ratio
    return Triangle(
        low=0.0,
        high=math.radians(settings.angle) * ratio,
        speed=spec.conditions["speed"][0],
        turn_angle=math.radians(settings.turn_angle) * ratio,
        cycles=int(spec.conditions["moves"][0]) + 1,
    )


# -- analysing


def analyse(
    runs: Sequence[Run],
    recipe: Recipe,
    *,
    kt: Run,
    friction: Run | None = None,
    plant: Run | None = None,
) -> Outcome:
    """Learn from the stored moves, and say what remained with the table switched on."""
    run, constant, filters = (
        common.only_run(runs),
        torque_per_ampere(kt).value,
        design(recipe, plant),
    )
    fed = friction_results(friction)
    recorded = iterations.recorded_runs(run, recipe)
    require_feedforward(recorded[0][0], recipe, constant, fed)
    learned = _learn(recorded, common.filled(run, "low"), recipe, constant, filters.learning)
    remaining = _remaining(
        learned, common.found(run, "validate"), recipe, constant, filters.learning
    )
    between = steady_outcome(_validated(run, remaining, recipe, constant, filters.learning))
    repeated: dict[str, Table] = {}
    if iterations.runs_at_most(recipe) > 1:
        repeated["iterations"] = iterations.iterations_table(
            learned.history, "N m", "controller torque"
        )
    return Outcome(
        {**remaining.results(), **between.results, **filters.results(), **fed},
        {
            **tables_of(learned.table, learned.u, learned.amplitudes),
            **remaining.tables(),
            **repeated,
            **between.tables,
            **filters.tables(),
        },
        (
            *_notes(learned.table),
            *filters.notes(),
            *remaining.notes(learned.table),
            *iterations.iterations_notes(
                learned.history, 1e3, "mN m", iterations.runs_at_most(recipe)
            ),
            *between.notes,
        ),
    )


@dataclass(frozen=True, eq=False)
class _Learned:
    """The table, its standard uncertainty, the first run's moves by speed, and all runs judged."""

    table: LookupTable
    u: Array
    amplitudes: Amplitudes
    moves: dict[float, Moves]
    history: list[LearningRun]


def _learn(
    runs: Sequence[Sequence[Recording]],
    low: Sequence[Recording],
    recipe: Recipe,
    torque_constant: float,
    learning: Learning,
) -> _Learned:
    """Make the table from the learning runs and from those at the low speeds."""
    settings = recipe.ilc_learn
    position = positions(recipe, settings.turn_angle)
    cut = [
        [(r.condition("speed"), *_moves(r, recipe, torque_constant, settings.moves)) for r in run]
        for run in runs
    ]
    history = [
        learning_run([_cycles(recipe, m, before) for _, m, before in run], learning, updates)
        for updates, run in enumerate(cut)
    ]
    rows: list[Row] = []
    low_rows: list[Row] = []
    last = iterations.last_to_learn_from(history)
    for speed, moves, before in cut[last]:
        rows += learned_rows(moves, speed, learning, position, before if last else 0.0)
    for recording in low:
        moves, _ = _moves(recording, recipe, torque_constant, settings.low_speed_moves)
        low_rows += learned_rows(moves, recording.condition("speed"), learning, position)
    rows.sort(key=lambda row: row.speed)
    amplitudes = fit_amplitudes(low_rows, rows)
    wider = math.sqrt(iterations.spread(last + 1, learning.factor))
    u = wider * np.stack([row.u for row in rows])
    first = {speed: moves for speed, moves, _ in cut[0]}
    return _Learned(assemble(position, rows, amplitudes), u, amplitudes, first, history)


def _cycles(recipe: Recipe, moves: Moves, before: Array) -> Cycles:
    """Return moves as cycles, of which the part counts where the table is learned."""
    position = positions(recipe, recipe.ilc_learn.end_angle)
    used = (moves.setpoint >= position[0]) & (moves.setpoint <= position[-1])
    return Cycles(moves.period, moves.torque, before, used)


def _remaining(
    learned: _Learned,
    validate: Sequence[Recording],
    recipe: Recipe,
    torque_constant: float,
    learning: Learning,
) -> Remaining:
    """Compare the moves with the table switched on with those that it was learned from."""
    settings = recipe.ilc_learn
    position = positions(recipe, settings.end_angle)
    found: list[tuple[Row, Row, Array]] = []
    for recording in validate:
        speed = recording.condition("speed")
        if speed not in learned.moves:
            raise RunFileError(
                f"recording {recording.name}: its speed of {speed:.4g} rad/s was not learned, only "
                f"{', '.join(f'{known:.4g}' for known in learned.moves)}: record both at one speed"
            )
        after, table = _moves(recording, recipe, torque_constant, settings.moves)
        applied = [at_positions(after, table, position, sign) for sign in (-1, 1)]
        found += zip(
            torque_rows(learned.moves[speed], speed, learning, position),
            torque_rows(after, speed, learning, position),
            applied,
            strict=True,
        )
    found.sort(key=lambda item: item[0].speed)
    rows_before, rows_after, torques = zip(*found, strict=True)
    return Remaining(position, rows_before, rows_after, np.stack(torques))


def rows(
    recording: Recording,
    recipe: Recipe,
    torque_constant: float,
    learning: Learning,
    position: Array,
) -> list[Row]:
    """Return what one update learns from a recording at these positions, falling moves first."""
    moves, _ = _moves(recording, recipe, torque_constant, recipe.ilc_learn.moves)
    return learned_rows(moves, recording.condition("speed"), learning, position)


def _validated(
    run: Run,
    remaining: Remaining,
    recipe: Recipe,
    torque_constant: float,
    learning: Learning,
) -> list[Steady]:
    """Compare moves without and with the table, at learned speeds and in between."""
    settings = recipe.ilc_learn
    position = positions(recipe, settings.end_angle)
    off, on = (
        [
            row
            for recording in common.filled(run, kind)
            for row in torque_rows(
                _moves(recording, recipe, torque_constant, settings.moves)[0],
                recording.condition("speed"),
                learning,
                position,
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


def positions(recipe: Recipe, end_angle: float) -> Array:
    """Return the motor angles of all quad counts, rad, with `end_angle` left out at each end.

    `end_angle` is one of the output, deg.
    """
    rig, settings = recipe.rig, recipe.ilc_learn
    per_degree = rig.angle_ratio * rig.encoder_counts / 360
    first = math.ceil(end_angle * per_degree)
    last = math.floor((settings.angle - end_angle) * per_degree)
    return np.arange(float(first), last + 1) * (2 * math.pi / rig.encoder_counts)


def _moves(
    recording: Recording, recipe: Recipe, torque_constant: float, moves: int
) -> tuple[Moves, Array]:
    """Cut a recording into moves of the controller's torque; return what the table added, too."""
    found = common.signals(recording, recipe)
    try:
        cut = cut_moves(found.time, found.setpoint, torque_constant * found.controller, moves)
        table = cut_moves(found.time, found.setpoint, torque_constant * found.learned, moves=1)
    except InsufficientDataError as error:
        raise InsufficientDataError(f"recording {recording.name}: {error}") from None
    return cut, table.torque[0]


def require_feedforward(
    recording: Recording, recipe: Recipe, torque_constant: float, fed: dict[str, Quantity]
) -> None:
    """Raise `RunFileError` unless the moves were made with the friction that is given.

    A table belongs to the friction that was fed forward beside it.
    """
    setpoint, current = recording.read("position_setpoint"), recording.read("feedforward_current")
    used = positions(recipe, recipe.ilc_learn.end_angle)
    # At constant speed there is no acceleration; what is fed forward is friction.
    straight = (setpoint[1:] > used[0]) & (setpoint[1:] < used[-1]) & (np.diff(setpoint) > 0)
    recorded = torque_constant * float(np.mean(current[1:][straight])) if straight.any() else 0.0
    speed = recording.condition("speed")
    common.require_friction_fed(recording.name, recorded, speed, fed)


def _notes(table: LookupTable) -> tuple[str, ...]:
    low, high = math.degrees(table.position[0]), math.degrees(table.position[-1])
    return (
        f"learned from {low:.4g} to {high:.4g} deg of the motor at up to "
        f"{table.speed[-1]:.4g} rad/s; the table does not extrapolate",
    )
