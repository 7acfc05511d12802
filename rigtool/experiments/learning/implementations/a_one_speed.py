"""Implementation A: one map by position, learned at one low speed [7.2.4.2, Fig. 42-48].

The bare motor turns at one speed and in one direction; friction is fed forward by its model, and
the map holds only the part that varies with position. At another speed the orders of the map have
another frequency: Q cuts off where the fastest turns bring them to the bandwidth of the loop.
Amplitude and phase tables by speed are found from runs at other speeds.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from rigtool.control.lookup_table import LookupTable
from rigtool.errors import InsufficientDataError, UsageError
from rigtool.experiments.learning.filters import Learning
from rigtool.experiments.learning.implementations import bare_motor
from rigtool.experiments.learning.implementations.bare_motor import BareMotor, Turned, learned_by
from rigtool.experiments.learning.implementations.runs import kind_of, last_update, runs_at_most
from rigtool.experiments.learning.implementations.skeleton import TaughtTable
from rigtool.experiments.learning.procedure_design import FilterDesign
from rigtool.experiments.learning.rows import Amplitudes, Row
from rigtool.experiments.learning.speed_tuning import Tuning, tune, written_out
from rigtool.experiments.learning.stored_table import LEARNING_CUTOFF
from rigtool.experiments.learning.turns import TURN, repeatable_row, turn_angles
from rigtool.quantity import Quantity
from rigtool.recipe import Recipe
from rigtool.runfile import Column, Recording, RecordingSpec, Run, Table, dof_column


@dataclass(frozen=True, eq=False)
class TaughtMap(TaughtTable):
    """The map at the speed of learning; once it is tuned, also the tuning and the turns behind it.

    Until then the table does not depend on speed.
    """

    row: Row
    tuning: Tuning | None = None
    others: list[Turned] = field(default_factory=list)


class OneSpeed(BareMotor[TaughtMap]):
    """Learning at one speed, in one direction, with amplitude and phase tuned by speed."""

    LEARNED_FROM = "ripple of the controller"

    @staticmethod
    def kinds(recipe: Recipe) -> dict[str, list[RecordingSpec]]:
        """Return the learning runs, those at other speeds, with the table on, and the sweeps."""
        settings = recipe.ilc_learn
        one = min(settings.turning.speeds_rev_per_s)
        every = bare_motor.both(bare_motor.low_and_learned(recipe))
        speeds = {kind_of(updates): [one] for updates in range(runs_at_most(recipe))}
        speeds |= {"tune": [speed for speed in every if speed != one], "validate": every}
        if settings.validation:
            speeds |= {kind: bare_motor.between(recipe) for kind in ("off", "on")}
        kinds = {kind: bare_motor.steady_specs(recipe, kind, v) for kind, v in speeds.items()}
        return kinds | (bare_motor.sweep_specs(recipe) if settings.validation else {})

    def require(self, recipe: Recipe, friction: Run | None) -> None:
        """Raise `UsageError` without friction."""
        if friction is None:
            raise UsageError(
                "implementation A learns the part that varies with position and leaves friction to "
                "its model: give --friction, a run of stribeck"
            )

    @property
    def learning(self) -> Learning:
        """The filters with Q cut off where orders reach the bandwidth at the highest speed."""
        return narrowed(self.filters, self.recipe)

    def learn(self, runs: Sequence[Sequence[Recording]], slower: Sequence[Recording]) -> TaughtMap:
        """Return the map learned from all runs so far, as a table that does not depend on speed."""
        counts, learning = self.recipe.rig.encoder_counts, self.learning
        cut = [[_ripple(item) for item in self.turned(run)] for run in runs]
        history = [self.judge(run, updates) for updates, run in enumerate(cut)]
        last, variance = last_update(history, learning.factor)
        updated = learned_by(cut[last][0], learning, counts)
        # The scatter of single turns, enlarged to that of several updates.
        mean = repeatable_row(updated, variance).mean
        row = Row(updated.speed, mean + np.sqrt(variance) * (updated.moves - updated.mean))
        table = untuned(row, self.recipe)
        u = np.broadcast_to(row.u, table.torque.shape)
        dof = np.full(len(table.speed), row.dof)
        return TaughtMap(table, u, dof, Amplitudes.fading(table.low_speed[-1]), history, row)

    def finish(self, taught: TaughtMap, others: Sequence[Recording]) -> TaughtMap:
        """Find amplitude and phase at the other speeds, within the band of the map."""
        counts, learning, learned = self.recipe.rig.encoder_counts, self.learning, taught.row
        turned = self.turned(others)
        rows = []
        for item in turned:
            # The same orders at each speed: Q moves with the speed of turning, to the bandwidth of
            # the loop at the fastest one (`narrowed`).
            cutoff = learning.cutoff_hz * max(1.0, abs(item.speed / learned.speed))
            wide = replace(learning, cutoff_hz=cutoff)
            rows.append(learned_by(_ripple(item), wide, counts))
        tuning = tune(learned, rows)
        table, u = written_out(turn_angles(counts), learned, tuning)
        return TaughtMap(
            table,
            u,
            np.full(len(table.speed), learned.dof),
            Amplitudes.fading(table.low_speed[-1]),
            taught.history,
            learned,
            tuning=tuning,
            others=turned,
        )

    def without_tuning(self, taught: TaughtMap) -> LookupTable:
        """Return the map as a table that does not depend on speed."""
        return untuned(taught.row, self.recipe)

    def before(self, taught: TaughtMap, first: Sequence[Recording]) -> list[Turned]:
        """Return the turns at the other speeds, and those at the speed of learning."""
        return [*taught.others, *self.turned(first[:1])]

    def judged(self, taught: TaughtMap, after: Sequence[Turned]) -> Sequence[Turned]:
        """Return the ripple at the speed of learning."""
        return [_ripple(item) for item in after if item.speed == taught.row.speed]

    def learned_speeds(self, taught: TaughtMap) -> Collection[float]:
        """Return the one speed of learning."""
        return (taught.row.speed,)

    def extra_results(self) -> dict[str, Quantity]:
        """Return the bandwidth of the loop, and the cut-off of Q that follows from it."""
        why = "follows from the loop's model and the recipe's speeds"
        return {
            "loop_bandwidth": Quantity(bandwidth(self.filters.learning), "Hz", reason=why),
            LEARNING_CUTOFF: Quantity(self.learning.cutoff_hz, "Hz", reason=why),
        }

    def learned_tables(self, taught: TaughtMap) -> dict[str, Table]:
        """Return the map, and its amplitude and phase tables."""
        learned, t = taught.row, taught.tuning
        assert t is not None
        position = Column(taught.table.position, "rad", "set point of the motor shaft")
        return {
            "tuning": Table(
                ("speed",),
                {
                    "speed": Column(t.speed, "rad/s", "of the motor shaft"),
                    "amplitude": Column(t.amplitude, "1", "factor on the map"),
                    "amplitude_u": Column(t.amplitude_u, "1", "standard, for this map"),
                    "dof": dof_column(t.dof),
                    "shift": Column(t.shift, "rad", "added to the position"),
                    "shift_u": Column(t.shift_u, "rad", "standard, for this map"),
                    "correlation": Column(
                        t.correlation, "1", "of the shifted map with the repeatable part"
                    ),
                },
                "amplitude",
                "amplitude and phase tables, by least squares at each speed; linear between",
            ),
            "learned_map": Table(
                ("position",),
                {
                    "position": position,
                    "torque": Column(learned.mean, "N m", "feed-forward torque"),
                    "u": Column(learned.u, "N m", "standard uncertainty"),
                    "dof": dof_column(np.full(learned.u.size, learned.dof)),
                },
                "torque",
                f"map by position as it was learned at {learned.speed:.4g} rad/s",
            ),
        }

    def learned_notes(self, taught: TaughtMap) -> list[str]:
        """State where the map was learned and tuned, and where its amplitude is zero."""
        t = taught.tuning
        assert t is not None
        notes = [
            f"learned at {taught.row.speed:.4g} rad/s, tuned from {t.speed[0]:.4g} to "
            f"{t.speed[-1]:.4g} rad/s over the whole turn; the table does not extrapolate"
        ]
        zero = t.speed[t.amplitude == 0] / TURN
        if zero.size:
            listed = ", ".join(f"{speed:.3g}" for speed in zero)
            notes.append(
                f"nothing similar to the map repeats above the noise at {listed} rev/s: the table "
                "is zero there"
            )
        return notes


def bandwidth(learning: Learning) -> float:
    """Return the frequency at which |T| has fallen to -3 dB, Hz.

    Raises `InsufficientDataError` where it never does.
    """
    nyquist = 0.5 / learning.system.sample_time
    frequency = np.geomspace(nyquist * 1e-4, nyquist * 0.999, 20000)
    gain = np.abs(learning.loop_response(frequency))
    below = np.flatnonzero(gain < np.sqrt(0.5))
    if not below.size or not below[0]:
        raise InsufficientDataError(
            "the loop has no bandwidth below half the sampling rate: change [rig.controller]"
        )
    return float(frequency[below[0]])


def narrowed(filters: FilterDesign, recipe: Recipe) -> Learning:
    """Return the filters with Q cut off where the fastest turns bring orders to the bandwidth.

    fQ = bandwidth/(fastest speed/speed of learning)
    """
    speeds = recipe.ilc_learn.turning.speeds_rev_per_s
    band = min(bandwidth(filters.learning), filters.learning.cutoff_hz)
    return replace(filters.learning, cutoff_hz=band * min(speeds) / max(speeds))


def untuned(learned: Row, recipe: Recipe) -> LookupTable:
    """Return the map as a table that does not depend on speed [Fig. 47]."""
    speeds = TURN * np.array(bare_motor.both(bare_motor.low_and_learned(recipe)))
    ends = np.array([speeds.min(), -np.abs(speeds).min(), np.abs(speeds).min(), speeds.max()])
    ends = np.unique(ends)
    lowest = np.array([0.0, np.abs(ends).min()])
    rows = np.tile(learned.mean, (len(ends), 1))
    position = turn_angles(recipe.rig.encoder_counts)
    return LookupTable(position, ends, rows, lowest, np.array([0.0, 1.0]), period=TURN)


def _ripple(item: Turned) -> Turned:
    """Subtract the mean of each turn: it is friction, which A does not learn."""
    signal = item.cycles.signal - item.cycles.signal.mean(axis=1, keepdims=True)
    return replace(
        item, turns=replace(item.turns, torque=signal), cycles=replace(item.cycles, signal=signal)
    )
