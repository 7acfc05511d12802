"""`ilc-learn --check`: does a learned table still fit the rig, and if not, what changed?

With the table off, the rig repeats moves from which the table was learned: at two of the speeds,
and fewer moves. The moves show the whole present disturbance. A stored run of `ilc-learn` or of a
check may take their place.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from rigtool.control.lookup_table import LookupTable
from rigtool.errors import InsufficientDataError
from rigtool.experiments.learning.check.imported import analyse_imported
from rigtool.experiments.learning.check.results import FITS, outcome_of
from rigtool.experiments.learning.check.table_health import judge_table, parts
from rigtool.experiments.learning.filters import Learning
from rigtool.experiments.learning.implementations import a_one_speed as one_speed
from rigtool.experiments.learning.implementations import bare_motor
from rigtool.experiments.learning.implementations import c_limited_angle as limited_angle
from rigtool.experiments.learning.procedure_design import design_filters
from rigtool.experiments.learning.rows import Row, learned_rows
from rigtool.experiments.learning.stored_table import (
    feedforward,
    friction_beside,
    learned_table_from,
    require_rig,
)
from rigtool.experiments.outcome import Outcome
from rigtool.experiments.procedure import Procedure, only_run, record
from rigtool.experiments.running.options import CommonOptions
from rigtool.experiments.torque_per_ampere import torque_per_ampere
from rigtool.numerics.arrays import Array
from rigtool.recipe import Recipe
from rigtool.rigs import Rig, Task
from rigtool.runfile import Recording, RecordingSpec, Run, RunWriter

MOVES_PER_SPEED = 6
"""Moves, or turns, that are recorded at each speed, unless `--set` changes it."""

WHOLE_TURN_IMPLEMENTATIONS = ("A", "B")
"""Implementations with whole turns: A at one speed, in one direction. The moves of C check the
others.
"""


def as_learned(options: CommonOptions, sources: Sequence[str], tables: Run) -> CommonOptions:
    """Return options under which a recipe repeats the moves of learning, but fewer of them.

    Settings of the user override these; stored sources stay as they are.
    """
    if any(Path(source).suffix != ".toml" for source in sources):
        return options
    table = learned_table_from(tables).table
    speeds = np.unique(np.abs(table.speed))
    chosen = sorted({speeds[0], speeds[len(speeds) // 2]})
    if _one_speed(tables) and tables.recipe is not None:  # the other speeds were tuned, not learned
        chosen = [2 * math.pi * min(tables.recipe.ilc_learn.turning.speeds_rev_per_s)]
    if table.period is None:
        ratio = 1.0 if tables.recipe is None else tables.recipe.rig.angle_ratio
        settings = {
            "ilc_learn.implementation": "C",
            "ilc_learn.speeds_rev_per_s": [float(v) / ratio / (2 * math.pi) for v in chosen],
            "ilc_learn.low_speeds_rev_per_s": [],
            "ilc_learn.moves": MOVES_PER_SPEED,
        }
    else:
        settings = {
            "rig.attachment": "pulley",  # no other recording turns continuously
            "ilc_learn.implementation": "A" if _one_speed(tables) else "B",
            "ilc_learn.turning.speeds_rev_per_s": [float(v) / (2 * math.pi) for v in chosen],
            "ilc_learn.turning.low_speeds_rev_per_s": [],
            "ilc_learn.turning.revolutions": MOVES_PER_SPEED,
        }
    overrides = [f"{name}={value}" for name, value in settings.items()]
    return replace(options, overrides=(*overrides, *options.overrides))


def _one_speed(tables: Run) -> bool:
    """Return whether a table was learned at one speed, by implementation A."""
    return tables.recipe is not None and tables.recipe.ilc_learn.implementation == "A"


def _filters(recipe: Recipe, plant: Run | None, tables: Run) -> Learning:
    """Return the filters that the table was learned with: those of A have a lower cut-off."""
    filters = design_filters(recipe, plant)
    if _one_speed(tables) and tables.recipe is not None:
        return one_speed.narrowed(filters, tables.recipe)
    return filters.learning


def fits(outcome: Outcome) -> bool:
    """Return whether the table fits; if not, the first note states the change."""
    return outcome.results[FITS].value == 1


# -- measuring


def recordings(recipe: Recipe) -> tuple[RecordingSpec, ...]:
    """List a recording for each speed, or for each speed and direction where the shaft turns."""
    settings = recipe.ilc_learn
    if settings.implementation in WHOLE_TURN_IMPLEMENTATIONS:
        speeds = settings.turning.speeds_rev_per_s
        ways = [min(speeds)] if settings.implementation == "A" else bare_motor.both(speeds)
        return tuple(bare_motor.steady_specs(recipe, "check", ways))
    return tuple(limited_angle.specs(recipe, "check", settings.speeds_rev_per_s, settings.moves))


def measure(
    rig: Rig, recipe: Recipe, recorder: RunWriter, *, tables: Run, kt: Run, plant: Run | None = None
) -> None:
    """Move as the table was learned: with the same feed-forward, without the table."""
    require_rig(tables, recipe)
    design_filters(recipe, plant)
    plain = feedforward(recipe.rig.nominal_inertia, tables.results)
    for spec in recordings(recipe):
        if _turns(spec.conditions):
            task = bare_motor.task(spec, plain)
        else:
            task = Task(limited_angle.motion(recipe, spec), plain)
        record(rig, task, recorder, spec.name)


# -- analysing


def analyse(
    runs: Sequence[Run], recipe: Recipe, *, tables: Run, kt: Run, plant: Run | None = None
) -> Outcome:
    """Compare the torque of the stored moves with the table.

    Raises `InsufficientDataError` where they cannot be compared.
    """
    require_rig(tables, recipe)
    run, learned = only_run(runs, "ilc-learn", "speeds"), learned_table_from(tables)
    constant = learned.constant or torque_per_ampere(kt).value  # currents are what is compared
    learning = _filters(recipe, plant, tables)
    recorded = run.recordings_named("check_") or run.recordings_of("learn")
    fed = friction_beside(tables)
    whole = learned.table.period is not None
    if whole != _turns(recorded[0].conditions):
        what, moved = ("whole turns", "to and fro") if whole else ("a range", "round and round")
        raise InsufficientDataError(
            f"{tables.path} holds {what}, {run.path} moved {moved}: record moves as the table was "
            "learned"
        )
    position = learned.table.position
    if whole:
        turned = [bare_motor.turned(recording, recipe, constant) for recording in recorded]
        rows = [bare_motor.learned_by(t, learning, position.size) for t in turned]
        bare_motor.require_friction_fed(recorded[0], constant, fed)
    else:
        position, rows = _moved_rows(recorded, recipe, constant, learning, learned.table)
        limited_angle.require_feedforward(recorded[0], recipe, constant, fed)
    compared = parts(learned.table, learned.u, rows, position)
    found = judge_table(compared, position, learned.table.period)
    return outcome_of(found, compared, rows, position, learned, recipe.rig.encoder_counts)


def _turns(conditions: Mapping[str, object]) -> bool:
    """Return whether a recording holds turns, by its conditions."""
    return "revolutions" in conditions


def _moved_rows(
    recorded: Sequence[Recording],
    recipe: Recipe,
    torque_constant: float,
    learning: Learning,
    table: LookupTable,
) -> tuple[Array, list[Row]]:
    """Return the positions that moves and table share, and the rows there."""
    here = limited_angle.positions(recipe, recipe.ilc_learn.turn_angle)
    position = here[(here >= table.position[0] - 1e-9) & (here <= table.position[-1] + 1e-9)]
    if position.size < here.size / 2:
        raise InsufficientDataError(
            f"the moves cover {here[0]:.4g} to {here[-1]:.4g} rad, the table "
            f"{table.position[0]:.4g} to {table.position[-1]:.4g} rad: check where it was learned"
        )
    rows: list[Row] = []
    for recording in recorded:
        count, speed = recipe.ilc_learn.moves, recording.condition("speed")
        moves, _ = limited_angle.moves_of(recording, recipe, torque_constant, count)
        rows += learned_rows(moves, speed, learning, position)
    return position, rows


PROCEDURE = Procedure(
    "ilc-check",
    recordings,
    measure,
    analyse,
    needed=("kt",),
    accepts=("ilc-learn",),
    analyse_imported=analyse_imported,
)
