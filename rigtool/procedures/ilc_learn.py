"""`ilc-learn`: learn the repeatable disturbance by position and speed [7.2.4.2].

Implementation C, 'limited rotation angle': at each speed the rig moves to and fro, one learning
update makes two rows of the table, low speeds give the amplitude table. Then the same moves are
made with the table switched on, and what remains is reported.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rigtool.analysis.learning import (
    Amplitudes,
    Moves,
    Row,
    assemble,
    at_positions,
    cut_moves,
    fit_amplitudes,
    learned_rows,
    torque_rows,
)
from rigtool.analysis.learning_filter import Learning
from rigtool.analysis.lookup_table import LookupTable
from rigtool.errors import InsufficientDataError, RunFileError, UsageError
from rigtool.procedures.calibration import torque_per_ampere
from rigtool.procedures.ilc_design import design
from rigtool.procedures.ilc_residual import Remaining
from rigtool.procedures.learned_tables import feedforward, friction_results, tables_of
from rigtool.procedures.outcome import Outcome
from rigtool.procedures.session import channels, record
from rigtool.quantity import Quantity
from rigtool.recipe import Recipe
from rigtool.rigs import Rig, Task
from rigtool.rigs.motion import Triangle
from rigtool.runfile import Recording, RecordingSpec, Run, RunWriter

Array = NDArray[np.float64]

COMMAND = "ilc-learn"

IMPLEMENTATIONS = {"C": "limited angle, both directions, by position and speed"}
"""Ways to learn that exist, by the thesis's letter."""

MAX_TRACKING_ERROR = 0.1
"""Largest distance of rotor and set point while a table is learned, rad."""


def require_implementation(name: str) -> None:
    """Raise `UsageError` unless learning of this name exists."""
    if name not in IMPLEMENTATIONS:
        known = ", ".join(f"{key} ({what})" for key, what in IMPLEMENTATIONS.items())
        raise UsageError(f"--implementation {name} does not exist yet; there is {known}")


# -- measuring


def recordings(recipe: Recipe) -> tuple[RecordingSpec, ...]:
    """List the learning runs, the low-speed runs and the validation runs."""
    settings = recipe.ilc_learn
    return (
        *_specs(recipe, "learn", settings.speeds_rev_per_s, settings.moves),
        *_specs(recipe, "low", settings.low_speeds_rev_per_s, settings.low_speed_moves),
        *_specs(recipe, "validate", settings.speeds_rev_per_s, settings.moves),
    )


def _specs(
    recipe: Recipe, kind: str, speeds_rev_per_s: Iterable[float], moves: int
) -> list[RecordingSpec]:
    recorded = channels(
        "time",
        "current_setpoint",
        "feedforward_current",
        "table_current",
        "position_setpoint",
        "encoder",
    )
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
    plain = feedforward(recipe.rig.nominal_inertia, friction_results(friction))
    kinds: dict[str, list[RecordingSpec]] = {"learn": [], "low": [], "validate": []}
    for spec in recordings(recipe):
        kinds[spec.name.partition("_")[0]].append(spec)
    for spec in (*kinds["learn"], *kinds["low"]):
        record(rig, Task(_motion(recipe, spec), plain), recorder, spec.name)
    learned = _learn(
        [recorder.recording(spec.name) for spec in kinds["learn"]],
        [recorder.recording(spec.name) for spec in kinds["low"]],
        recipe,
        torque_per_ampere(kt).value,
        learning,
    )
    compensated = replace(plain, table=learned.table)
    for spec in kinds["validate"]:
        record(rig, Task(_motion(recipe, spec), compensated), recorder, spec.name)


def _motion(recipe: Recipe, spec: RecordingSpec) -> Triangle:
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
    if len(runs) > 1:
        raise UsageError(f"{len(runs)} run files: ilc-learn takes one, with all its speeds")
    run, torque_constant, filters = runs[0], torque_per_ampere(kt).value, design(recipe, plant)
    fed = friction_results(friction)
    recorded = _found(run, "learn")
    _require_feedforward(recorded[0], recipe, torque_constant, fed)
    learned = _learn(
        recorded, run.recordings_named("low_"), recipe, torque_constant, filters.learning
    )
    remaining = _remaining(
        learned, _found(run, "validate"), recipe, torque_constant, filters.learning
    )
    return Outcome(
        {**remaining.results(), **filters.results(), **fed},
        {
            **tables_of(learned.table, learned.u, learned.amplitudes),
            **remaining.tables(),
            **filters.tables(),
        },
        (*_notes(learned.table), *filters.notes(), *remaining.notes(learned.table)),
    )


@dataclass(frozen=True, eq=False)
class _Learned:
    """The table, its standard uncertainty, and the moves it was learned from, by speed."""

    table: LookupTable
    u: Array
    amplitudes: Amplitudes
    moves: dict[float, Moves]


def _learn(
    learn: Sequence[Recording],
    low: Sequence[Recording],
    recipe: Recipe,
    torque_constant: float,
    learning: Learning,
) -> _Learned:
    """Make the table from the runs at the learned and at the low speeds."""
    settings = recipe.ilc_learn
    position = _positions(recipe, settings.turn_angle)
    rows: list[Row] = []
    low_rows: list[Row] = []
    moves = {
        r.condition("speed"): _moves(r, recipe, torque_constant, settings.moves) for r in learn
    }
    for speed, cut in moves.items():
        rows += learned_rows(cut, speed, learning, position)
    for recording in low:
        cut = _moves(recording, recipe, torque_constant, settings.low_speed_moves)
        low_rows += learned_rows(cut, recording.condition("speed"), learning, position)
    rows.sort(key=lambda row: row.speed)
    amplitudes = fit_amplitudes(low_rows, rows)
    u = np.stack([row.u for row in rows])
    return _Learned(assemble(position, rows, amplitudes), u, amplitudes, moves)


def _remaining(
    learned: _Learned,
    validate: Sequence[Recording],
    recipe: Recipe,
    torque_constant: float,
    learning: Learning,
) -> Remaining:
    """Compare the moves with the table switched on with those that it was learned from."""
    settings = recipe.ilc_learn
    position = _positions(recipe, settings.end_angle)
    found: list[tuple[Row, Row, Array]] = []
    for recording in validate:
        speed = recording.condition("speed")
        if speed not in learned.moves:
            raise RunFileError(
                f"recording {recording.name}: its speed of {speed:.4g} rad/s was not learned, only "
                f"{', '.join(f'{known:.4g}' for known in learned.moves)}: record both at one speed"
            )
        after = _moves(recording, recipe, torque_constant, settings.moves)
        table = cut_moves(
            recording.read("time"),
            recording.read("position_setpoint"),
            torque_constant * recording.read("table_current"),
            moves=1,
        )
        applied = [at_positions(table, table.torque[0], position, sign) for sign in (-1, 1)]
        found += zip(
            torque_rows(learned.moves[speed], speed, learning, position),
            torque_rows(after, speed, learning, position),
            applied,
            strict=True,
        )
    found.sort(key=lambda item: item[0].speed)
    rows_before, rows_after, torques = zip(*found, strict=True)
    return Remaining(position, rows_before, rows_after, np.stack(torques))


def _positions(recipe: Recipe, end_angle: float) -> Array:
    """Return the motor angles of all quad counts, rad, with `end_angle` left out at each end.

    `end_angle` is one of the output, deg.
    """
    rig, settings = recipe.rig, recipe.ilc_learn
    per_degree = rig.angle_ratio * rig.encoder_counts / 360
    first = math.ceil(end_angle * per_degree)
    last = math.floor((settings.angle - end_angle) * per_degree)
    return np.arange(float(first), last + 1) * (2 * math.pi / rig.encoder_counts)


def _moves(recording: Recording, recipe: Recipe, torque_constant: float, moves: int) -> Moves:
    """Cut a recording into moves of the controller's torque, after a look at its health.

    Controller torque = torque constant * (set point - feed-forward - table).
    """
    asked, setpoint = recording.read("current_setpoint"), recording.read("position_setpoint")
    limit = recipe.rig.current_limit
    if asked.size and np.abs(asked).max() >= 0.999 * limit:
        raise InsufficientDataError(
            f"recording {recording.name}: the current set point reaches the limit of {limit} A, so "
            "the controller saturates: lower the speed, or raise ilc_learn.turn_angle"
        )
    rotor = recording.read("encoder") * (2 * math.pi / recipe.rig.encoder_counts)
    distance = float(np.abs(setpoint - rotor).max(initial=0))
    if distance > MAX_TRACKING_ERROR:
        raise InsufficientDataError(
            f"recording {recording.name}: the rotor is up to {distance:.3g} rad off its set point, "
            f"more than {MAX_TRACKING_ERROR} rad, so the loop does not hold it: check the encoder "
            "and [rig.controller]"
        )
    controller = asked - recording.read("feedforward_current") - recording.read("table_current")
    try:
        return cut_moves(recording.read("time"), setpoint, torque_constant * controller, moves)
    except InsufficientDataError as error:
        raise InsufficientDataError(f"recording {recording.name}: {error}") from None


def _require_feedforward(
    recording: Recording, recipe: Recipe, torque_constant: float, fed: dict[str, Quantity]
) -> None:
    """Raise `RunFileError` unless the moves were made with the friction that is given.

    A table belongs to the friction that was fed forward beside it.
    """
    setpoint, current = recording.read("position_setpoint"), recording.read("feedforward_current")
    used = _positions(recipe, recipe.ilc_learn.end_angle)
    # At constant speed there is no acceleration; what is fed forward is friction.
    straight = (setpoint[1:] > used[0]) & (setpoint[1:] < used[-1]) & (np.diff(setpoint) > 0)
    recorded = torque_constant * float(np.mean(current[1:][straight])) if straight.any() else 0.0
    speed = recording.condition("speed")
    friction = feedforward(0.0, fed)
    expected = friction.coulomb * math.tanh(speed) + friction.viscous * speed
    if not math.isclose(recorded, expected, rel_tol=0.02, abs_tol=1e-9):
        raise RunFileError(
            f"recording {recording.name}: friction of {recorded * 1e3:.3g} mN m was fed forward at "
            f"{speed:.4g} rad/s, {expected * 1e3:.3g} mN m are expected"
            + (" without --friction" if not fed else "")
            + ": give the --friction that the moves were recorded with"
        )


def _notes(table: LookupTable) -> tuple[str, ...]:
    low, high = math.degrees(table.position[0]), math.degrees(table.position[-1])
    return (
        f"learned from {low:.4g} to {high:.4g} deg of the motor at up to "
        f"{table.speed[-1]:.4g} rad/s; the table does not extrapolate",
    )


def _found(run: Run, kind: str) -> list[Recording]:
    """Return the recordings of a kind; `RunFileError` where there are none."""
    found = run.recordings_named(f"{kind}_")
    if not found:
        raise RunFileError(
            f"{run.path}: has no recording {kind}_000: give the run file in which ilc-learn "
            "recorded its signals"
        )
    return found
