"""Implementation A: one map by position, learned at one low speed [7.2.4.2, Fig. 42-48].

The bare motor turns at one speed and in one direction; friction is fed forward by its model, and
the map holds only what varies with position. Played at another speed its orders pass at another
frequency: Q cuts off where the fastest turns bring them to the bandwidth of the loop. Amplitude and
phase tables by speed are found from runs at other speeds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rigtool.control.lookup_table import LookupTable
from rigtool.errors import InsufficientDataError, UsageError
from rigtool.experiments.learning.convergence import LearningRun
from rigtool.experiments.learning.filters import Learning
from rigtool.experiments.learning.implementations import runs as iterations
from rigtool.experiments.learning.implementations import signals as common
from rigtool.experiments.learning.implementations import turning
from rigtool.experiments.learning.implementations.turning import Turned
from rigtool.experiments.learning.procedure_design import Design, design
from rigtool.experiments.learning.rows import Amplitudes, Row
from rigtool.experiments.learning.speed_tuning import Tuning, tune, written_out
from rigtool.experiments.learning.stored_table import (
    feedforward,
    friction_results,
    period_results,
    tables_of,
)
from rigtool.experiments.learning.turns import TURN, repeatable_row, turn_angles
from rigtool.experiments.outcome import Outcome
from rigtool.experiments.torque_per_ampere import torque_per_ampere
from rigtool.quantity import Quantity
from rigtool.recipe import Recipe
from rigtool.rigs import Rig
from rigtool.runfile import Column, Recording, RecordingSpec, Run, RunWriter, Table

Array = NDArray[np.float64]

# -- measuring


def recordings(recipe: Recipe) -> tuple[RecordingSpec, ...]:
    """List the learning runs, those at other speeds, those with the table on, and the sweeps."""
    return tuple(spec for specs in _kinds(recipe).values() for spec in specs)


def _kinds(recipe: Recipe) -> dict[str, list[RecordingSpec]]:
    settings = recipe.ilc_learn
    one = min(settings.turning.speeds_rev_per_s)
    every = turning.both(turning.low_and_learned(recipe))
    speeds = {
        iterations.kind_of(updates): [one] for updates in range(iterations.runs_at_most(recipe))
    }
    speeds |= {"tune": [speed for speed in every if speed != one], "validate": every}
    if settings.validation:
        speeds |= {kind: turning.between(recipe) for kind in ("off", "on")}
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
    """Learn at one speed, tune at the others, and turn again with the table switched on."""
    _require_friction(friction)
    learning = narrowed(design(recipe, plant), recipe)
    constant = torque_per_ampere(kt).value
    plain = feedforward(recipe.rig.nominal_inertia, friction_results(friction))
    kinds = _kinds(recipe)
    bench = turning.Bench(rig, recipe, recorder)
    learned = iterations.run_by_run(
        recipe,
        bench.turn(kinds["learn"], plain),
        lambda runs: _learn(runs, recipe, constant, learning),
        lambda kind, so_far: bench.turn(
            kinds[kind], replace(plain, table=untuned(so_far.row, recipe))
        ),
    ).row
    others = bench.turn(kinds["tune"], plain)
    tuned = _tune(learned, [turning.turned(r, recipe, constant) for r in others], recipe, learning)
    bench.check(kinds, plain, untuned(learned, recipe), tuned.table)


def _require_friction(friction: Run | None) -> None:
    if friction is None:
        raise UsageError(
            "implementation A learns what varies with position and leaves friction to its model: "
            "give --friction, a run of stribeck"
        )


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


def narrowed(filters: Design, recipe: Recipe) -> Learning:
    """Return the filters with Q cut off where the fastest turns bring orders to the bandwidth.

    fQ = bandwidth/(fastest speed/speed of learning)
    """
    speeds = recipe.ilc_learn.turning.speeds_rev_per_s
    band = min(bandwidth(filters.learning), filters.learning.cutoff_hz)
    return replace(filters.learning, cutoff_hz=band * min(speeds) / max(speeds))


def untuned(learned: Row, recipe: Recipe) -> LookupTable:
    """Return the map as a table that does not depend on speed [Fig. 47]."""
    speeds = TURN * np.array(turning.both(turning.low_and_learned(recipe)))
    ends = np.array([speeds.min(), -np.abs(speeds).min(), np.abs(speeds).min(), speeds.max()])
    ends = np.unique(ends)
    lowest = np.array([0.0, np.abs(ends).min()])
    rows = np.tile(learned.mean, (len(ends), 1))
    position = turn_angles(recipe.rig.encoder_counts)
    return LookupTable(position, ends, rows, lowest, np.array([0.0, 1.0]), period=TURN)


# -- analysing


def analyse(
    runs: Sequence[Run],
    recipe: Recipe,
    *,
    kt: Run,
    friction: Run | None = None,
    plant: Run | None = None,
) -> Outcome:
    """Learn and tune from the stored turns, and say what remained with the table switched on."""
    _require_friction(friction)
    run, filters = common.only_run(runs), design(recipe, plant)
    constant, counts = torque_per_ampere(kt).value, recipe.rig.encoder_counts
    fed, learning = friction_results(friction), filters.learning
    recorded = iterations.recorded_runs(run, recipe)
    turning.require_friction_fed(recorded[0][0], recipe, constant, fed)
    narrow = narrowed(filters, recipe)
    taught = _learn(recorded, recipe, constant, narrow)
    learned, history = taught.row, taught.history
    others = [turning.turned(r, recipe, constant) for r in common.found(run, "tune")]
    tuned = _tune(learned, others, recipe, narrow)
    after = [turning.turned(r, recipe, constant) for r in common.found(run, "validate")]
    before = [*others, turning.turned(recorded[0][0], recipe, constant)]
    remaining = turning.remaining(before, after, learning, counts)
    at_one = [_ripple(item) for item in after if item.speed == learned.speed]
    validated = turning.validated(run, remaining, (learned.speed,), recipe, constant, learning)
    swept = turning.sweep(run, recipe, constant, learning)
    sweep = Outcome({}) if swept is None else swept.outcome()
    return Outcome(
        {
            **remaining.results(),
            **period_results(tuned.table),
            **_cutoff_results(learning, narrow),
            **validated.results,
            **sweep.results,
            **filters.results(),
            **fed,
        },
        {
            **tables_of(tuned.table, tuned.u, tuned.amplitudes),
            **tuned.tables(),
            "iterations": iterations.iterations_table(
                turning.with_check(history, at_one, narrow), "N m", "ripple of the controller"
            ),
            **remaining.tables(),
            **validated.tables,
            **sweep.tables,
            **filters.tables(),
        },
        (
            *tuned.notes(),
            *filters.notes(),
            *turning.notes_on_table(remaining, tuned.table, recipe),
            *iterations.iterations_notes(history, 1e3, "mN m", iterations.runs_at_most(recipe)),
            *validated.notes,
        ),
    )


def _ripple(item: Turned) -> Turned:
    """Take the mean off each turn: it is friction, which A does not learn."""
    signal = item.cycles.signal - item.cycles.signal.mean(axis=1, keepdims=True)
    return replace(
        item,
        turns=replace(item.turns, torque=signal),
        cycles=replace(item.cycles, signal=signal),
    )


@dataclass(frozen=True, eq=False)
class _Learned:
    """The map at the speed of learning, with its uncertainty, and all runs judged."""

    row: Row
    history: list[LearningRun]


def _learn(
    runs: Sequence[Sequence[Recording]], recipe: Recipe, torque_constant: float, learning: Learning
) -> _Learned:
    """Return what all runs so far teach."""
    counts = recipe.rig.encoder_counts
    cut = [[_ripple(turning.turned(r, recipe, torque_constant)) for r in run] for run in runs]
    history = [turning.judge(run, learning, updates) for updates, run in enumerate(cut)]
    last = iterations.last_to_learn_from(history)
    spread = iterations.spread(last + 1, learning.factor)
    updated = turning.learned_by(cut[last][0], learning, counts, first=last == 0)
    # The scatter of single turns, as wide as what several updates carry.
    mean = repeatable_row(updated, spread).mean
    wider = mean + np.sqrt(spread) * (updated.moves - updated.mean)
    return _Learned(Row(updated.speed, wider), history)


@dataclass(frozen=True, eq=False)
class _Tuned:
    """The map with its amplitude and phase tables, and the same written out by speed."""

    learned: Row
    tuning: Tuning
    table: LookupTable
    u: Array

    @property
    def amplitudes(self) -> Amplitudes:
        """Below the lowest speed the table fades to zero at standstill."""
        return Amplitudes(self.table.low_speed, self.table.amplitude, np.zeros(2))

    def tables(self) -> dict[str, Table]:
        """Return the map, and its amplitude and phase tables."""
        position = Column(self.table.position, "rad", "set point of the motor shaft")
        t = self.tuning
        return {
            "tuning": Table(
                ("speed",),
                {
                    "speed": Column(t.speed, "rad/s", "of the motor shaft"),
                    "amplitude": Column(t.amplitude, "1", "factor on the map"),
                    "amplitude_u": Column(t.amplitude_u, "1", "standard uncertainty"),
                    "shift": Column(t.shift, "rad", "added to the position"),
                    "shift_u": Column(t.shift_u, "rad", "standard uncertainty"),
                    "correlation": Column(
                        t.correlation, "1", "of the turned map with what repeats at this speed"
                    ),
                },
                "amplitude",
                "amplitude and phase tables, by least squares at each speed; linear between",
            ),
            "learned_map": Table(
                ("position",),
                {
                    "position": position,
                    "torque": Column(self.learned.mean, "N m", "feed-forward torque"),
                    "u": Column(self.learned.u, "N m", "standard uncertainty"),
                },
                "torque",
                f"map by position as it was learned at {self.learned.speed:.4g} rad/s",
            ),
        }

    def notes(self) -> tuple[str, ...]:
        """Say where the table holds, and where it is zero."""
        t = self.tuning
        notes = [
            f"learned at {self.learned.speed:.4g} rad/s, tuned from {t.speed[0]:.4g} to "
            f"{t.speed[-1]:.4g} rad/s over the whole turn; the table does not extrapolate"
        ]
        zero = t.speed[t.amplitude == 0] / TURN
        if zero.size:
            listed = ", ".join(f"{speed:.3g}" for speed in zero)
            notes.append(
                f"nothing like the map repeats above chance at {listed} rev/s: the table is zero "
                "there"
            )
        return tuple(notes)


def _tune(learned: Row, others: Sequence[Turned], recipe: Recipe, learning: Learning) -> _Tuned:
    """Find amplitude and phase at the other speeds, within the band of the map."""
    counts = recipe.rig.encoder_counts
    fastest = max(abs(item.speed) for item in others)
    rows = []
    for item in others:
        # The same orders at each speed: Q moves with the speed of turning, as far as it may.
        cutoff = learning.cutoff_hz * max(1.0, abs(item.speed / learned.speed))
        wide = replace(learning, cutoff_hz=min(cutoff, learning.cutoff_hz * fastest))
        rows.append(turning.learned_by(_ripple(item), wide, counts, first=True))
    tuning = tune(learned, rows)
    table, u = written_out(turn_angles(counts), learned, tuning)
    return _Tuned(learned, tuning, table, u)


def _cutoff_results(learning: Learning, narrow: Learning) -> dict[str, Quantity]:
    why = "follows from the loop's model and the recipe's speeds"
    return {
        "loop_bandwidth": Quantity(bandwidth(learning), "Hz", reason=why),
        "learning_cutoff": Quantity(narrow.cutoff_hz, "Hz", reason=why),
    }
