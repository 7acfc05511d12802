"""Implementation B: a table by position and speed, learned while turning [7.2.4.2, Fig. 49-54].

The bare motor turns steadily at each speed, in either direction; one learning update of the mean
turn makes a row, Coulomb and viscous friction as functions of position included. Below the lowest
of these speeds its rows are scaled by an amplitude table that is found from slower runs [Fig. 53].
Orders that do not exceed the noise are not learned.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rigtool.control.lookup_table import LookupTable
from rigtool.experiments.learning.implementations import bare_motor
from rigtool.experiments.learning.implementations.bare_motor import BareMotor, Turned, learned_by
from rigtool.experiments.learning.implementations.runs import kind_of, last_update, runs_at_most
from rigtool.experiments.learning.implementations.skeleton import TaughtTable
from rigtool.experiments.learning.rows import Amplitudes, Row, assemble, fit_amplitudes
from rigtool.experiments.learning.turns import TURN, repeatable_row, turn_angles
from rigtool.recipe import Recipe
from rigtool.runfile import Recording, RecordingSpec


@dataclass(frozen=True, eq=False)
class TaughtSpeeds(TaughtTable):
    """The table, and the turns of the first run, without it."""

    first: list[Turned]


class AllSpeeds(BareMotor[TaughtSpeeds]):
    """Learning at each speed and in both directions."""

    @staticmethod
    def kinds(recipe: Recipe) -> dict[str, list[RecordingSpec]]:
        """Return the learning runs, those at low speeds, with the table on, and the sweeps."""
        settings = recipe.ilc_learn
        learned = bare_motor.both(settings.turning.speeds_rev_per_s)
        low = bare_motor.both(settings.turning.low_speeds_rev_per_s)
        speeds = {kind_of(updates): learned for updates in range(runs_at_most(recipe))}
        speeds |= {"low": low, "validate": learned}
        if settings.validation:
            midway = bare_motor.between(recipe)
            speeds |= {"off": midway, "on": [*low, *midway]}
        kinds = {kind: bare_motor.steady_specs(recipe, kind, v) for kind, v in speeds.items()}
        return kinds | (bare_motor.sweep_specs(recipe) if settings.validation else {})

    def learn(
        self, runs: Sequence[Sequence[Recording]], slower: Sequence[Recording]
    ) -> TaughtSpeeds:
        """Make the table from the learning runs and from those at the low speeds."""
        counts, learning = self.recipe.rig.encoder_counts, self.learning
        cut = [self.turned(run) for run in runs]
        history = [self.judge(run, updates) for updates, run in enumerate(cut)]
        last, variance = last_update(history, learning.factor)
        updated = [learned_by(item, learning, counts) for item in cut[last]]
        updated.sort(key=lambda row: row.speed)
        rows = [repeatable_row(row, variance) for row in updated]
        low = [learned_by(item, learning, counts) for item in self.turned(slower)]
        amplitudes = _amplitudes(low, rows)
        table = assemble(turn_angles(counts), rows, amplitudes, TURN)
        u = math.sqrt(variance) * np.stack([row.u for row in updated])
        dof = np.array([row.dof for row in updated])
        return TaughtSpeeds(table, u, dof, amplitudes, history, cut[0])

    def before(self, taught: TaughtSpeeds, first: Sequence[Recording]) -> list[Turned]:
        """Return the turns of the first learning run."""
        return taught.first

    def without_tuning(self, taught: TaughtSpeeds) -> LookupTable:
        """Return the table with lowest rows that fade in proportion to speed [Fig. 49]."""
        low_speed = np.array([0.0, taught.table.low_speed[-1]])
        return replace(taught.table, low_speed=low_speed, amplitude=np.array([0.0, 1.0]))

    def learned_speeds(self, taught: TaughtSpeeds) -> Collection[float]:
        """Return all speeds of the table."""
        return taught.table.speed.tolist()

    def learned_notes(self, taught: TaughtSpeeds) -> list[str]:
        """State where the table was learned, and where it is zero."""
        table = taught.table
        notes = [
            f"learned over the whole turn at {np.abs(table.speed).min():.4g} to "
            f"{np.abs(table.speed).max():.4g} rad/s; the table does not extrapolate"
        ]
        zero = table.speed[~table.torque.any(axis=1)] / TURN
        if zero.size:
            listed = ", ".join(f"{speed:.3g}" for speed in zero)
            notes.append(f"nothing exceeds the noise at {listed} rev/s: the table is zero there")
        return notes


def _amplitudes(low: Sequence[Row], rows: Sequence[Row]) -> Amplitudes:
    """Fit the amplitude table; where nothing was learned at the lowest speed, nothing is scaled."""
    lowest = min(abs(row.speed) for row in rows)
    if any(not row.mean.any() for row in rows if abs(row.speed) == lowest):
        return Amplitudes.fading(lowest)
    return fit_amplitudes(low, rows)
