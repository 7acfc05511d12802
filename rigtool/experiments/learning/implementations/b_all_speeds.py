"""Implementation B: a table by position and speed, learned while turning [7.2.4.2, Fig. 49-54].

The bare motor turns steadily at each speed, in either direction; one learning update of the mean
turn makes a row, Coulomb and viscous friction as functions of position included. Below the lowest
of these speeds its rows are scaled by an amplitude table that is found from slower runs [Fig. 53].
Orders that do not repeat above chance are not learned.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rigtool.control.lookup_table import LookupTable
from rigtool.experiments.learning.convergence import LearningRun
from rigtool.experiments.learning.filters import Learning
from rigtool.experiments.learning.implementations import runs as iterations
from rigtool.experiments.learning.implementations import signals as common
from rigtool.experiments.learning.implementations import turning
from rigtool.experiments.learning.procedure_design import design
from rigtool.experiments.learning.rows import Amplitudes, Row, fit_amplitudes
from rigtool.experiments.learning.stored_table import (
    feedforward,
    friction_results,
    period_results,
    tables_of,
)
from rigtool.experiments.learning.turns import TURN, repeatable_row, turn_angles
from rigtool.experiments.outcome import Outcome
from rigtool.experiments.torque_per_ampere import torque_per_ampere
from rigtool.recipe import Recipe
from rigtool.rigs import Rig
from rigtool.runfile import Recording, RecordingSpec, Run, RunWriter

Array = NDArray[np.float64]

# -- measuring


def recordings(recipe: Recipe) -> tuple[RecordingSpec, ...]:
    """List the learning runs, the runs at low speeds, those with the table on, and the sweeps."""
    return tuple(spec for specs in _kinds(recipe).values() for spec in specs)


def _kinds(recipe: Recipe) -> dict[str, list[RecordingSpec]]:
    settings = recipe.ilc_learn
    learned = turning.both(settings.turning.speeds_rev_per_s)
    low = turning.both(settings.turning.low_speeds_rev_per_s)
    speeds = {
        iterations.kind_of(updates): learned for updates in range(iterations.runs_at_most(recipe))
    }
    speeds |= {"low": low, "validate": learned}
    if settings.validation:
        speeds |= {"off": turning.between(recipe), "on": [*low, *turning.between(recipe)]}
    kinds = {kind: turning.steady_specs(recipe, kind, v) for kind, v in speeds.items()}
    if settings.validation:
        kinds["sweep"] = turning.sweep_specs(recipe)
    return kinds


def measure(
    rig: Rig,
    recipe: Recipe,
    recorder: RunWriter,
    *,
    kt: Run,
    friction: Run | None = None,
    plant: Run | None = None,
) -> None:
    """Learn at each speed, build the table, and turn again with the table switched on."""
    learning = design(recipe, plant).learning
    constant = torque_per_ampere(kt).value
    plain = feedforward(recipe.rig.nominal_inertia, friction_results(friction))
    kinds = _kinds(recipe)
    bench = turning.Bench(rig, recipe, recorder)
    first = bench.turn(kinds["learn"], plain)
    low = bench.turn(kinds["low"], plain)
    learned = iterations.run_by_run(
        recipe,
        first,
        lambda runs: _learn(runs, low, recipe, constant, learning),
        lambda kind, so_far: bench.turn(kinds[kind], replace(plain, table=so_far.table)),
    )
    bench.check(kinds, plain, without_low_speeds(learned.table), learned.table)


def without_low_speeds(table: LookupTable) -> LookupTable:
    """Return a table whose lowest rows fade in proportion to speed [Fig. 49]."""
    lowest = table.low_speed[-1]
    return replace(table, low_speed=np.array([0.0, lowest]), amplitude=np.array([0.0, 1.0]))


# -- analysing


def analyse(
    runs: Sequence[Run],
    recipe: Recipe,
    *,
    kt: Run,
    friction: Run | None = None,
    plant: Run | None = None,
) -> Outcome:
    """Learn from the stored turns, and say what remained with the table switched on."""
    run, filters = common.only_run(runs), design(recipe, plant)
    constant, counts = torque_per_ampere(kt).value, recipe.rig.encoder_counts
    fed, learning = friction_results(friction), filters.learning
    recorded = iterations.recorded_runs(run, recipe)
    turning.require_friction_fed(recorded[0][0], recipe, constant, fed)
    learned = _learn(recorded, common.filled(run, "low"), recipe, constant, learning)
    after = [turning.turned(r, recipe, constant) for r in common.found(run, "validate")]
    remaining = turning.remaining(learned.first, after, learning, counts)
    validated = turning.validated(run, remaining, learned.table.speed, recipe, constant, learning)
    swept = turning.sweep(run, recipe, constant, learning)
    sweep = Outcome({}) if swept is None else swept.outcome()
    return Outcome(
        {
            **remaining.results(),
            **period_results(learned.table),
            **validated.results,
            **sweep.results,
            **filters.results(),
            **fed,
        },
        {
            **tables_of(learned.table, learned.u, learned.amplitudes),
            **remaining.tables(),
            "iterations": iterations.iterations_table(
                turning.with_check(learned.history, after, learning), "N m", "controller torque"
            ),
            **validated.tables,
            **sweep.tables,
            **filters.tables(),
        },
        (
            *learned.notes(),
            *filters.notes(),
            *turning.notes_on_table(remaining, learned.table, recipe),
            *iterations.iterations_notes(
                learned.history, 1e3, "mN m", iterations.runs_at_most(recipe)
            ),
            *validated.notes,
        ),
    )


@dataclass(frozen=True, eq=False)
class _Learned:
    """The table, its standard uncertainty, the first run's turns, and all runs judged."""

    table: LookupTable
    u: Array
    amplitudes: Amplitudes
    first: list[turning.Turned]
    history: list[LearningRun]

    def notes(self) -> tuple[str, ...]:
        """Say where the table holds, and where it is zero."""
        table = self.table
        notes = [
            f"learned over the whole turn at {np.abs(table.speed).min():.4g} to "
            f"{np.abs(table.speed).max():.4g} rad/s; the table does not extrapolate"
        ]
        zero = table.speed[~table.torque.any(axis=1)] / TURN
        if zero.size:
            listed = ", ".join(f"{speed:.3g}" for speed in zero)
            notes.append(f"nothing repeats above chance at {listed} rev/s: the table is zero there")
        return tuple(notes)


def _learn(
    runs: Sequence[Sequence[Recording]],
    low: Sequence[Recording],
    recipe: Recipe,
    torque_constant: float,
    learning: Learning,
) -> _Learned:
    """Make the table from the learning runs and from those at the low speeds."""
    counts = recipe.rig.encoder_counts
    cut = [[turning.turned(r, recipe, torque_constant) for r in run] for run in runs]
    history = [turning.judge(run, learning, updates) for updates, run in enumerate(cut)]
    last = iterations.last_to_learn_from(history)
    spread = iterations.spread(last + 1, learning.factor)
    updated = [turning.learned_by(item, learning, counts, first=last == 0) for item in cut[last]]
    updated.sort(key=lambda row: row.speed)
    rows = [repeatable_row(row, spread) for row in updated]
    slow = (turning.turned(r, recipe, torque_constant) for r in low)
    low_rows = [turning.learned_by(item, learning, counts, first=True) for item in slow]
    amplitudes = _amplitudes(low_rows, rows)
    table = LookupTable(
        turn_angles(counts),
        np.array([row.speed for row in rows]),
        np.stack([row.mean for row in rows]),
        amplitudes.speed,
        amplitudes.amplitude,
        period=TURN,
    )
    u = math.sqrt(spread) * np.stack([row.u for row in updated])
    return _Learned(table, u, amplitudes, cut[0], history)


def _amplitudes(low: Sequence[Row], rows: Sequence[Row]) -> Amplitudes:
    """Fit the amplitude table; where nothing was learned at the lowest speed, nothing is scaled."""
    lowest = min(abs(row.speed) for row in rows)
    if any(not row.mean.any() for row in rows if abs(row.speed) == lowest):
        return Amplitudes(np.array([0.0, lowest]), np.array([0.0, 1.0]), np.zeros(2))
    return fit_amplitudes(low, rows)
