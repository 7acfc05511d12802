"""`measure-force` on imported runs: torque at the load from the motor's current and encoder.

A load model that `ilc-learn --implementation D` learned on the same rig turns effort and motion
into torque. Where the runs hold a sensor's `reference_torque`, it judges the result and is used for
nothing else: errors by kind of stroke, and a Table 8 at one position of the closing strokes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rigtool.errors import InsufficientDataError, UsageError
from rigtool.experiments.force.imported_strokes import levels_table, read_strokes, scatter_results
from rigtool.experiments.force_filter.motion_states import State
from rigtool.experiments.force_sensor.results_over_time import Reading, over_time_tables
from rigtool.experiments.imported import RECORDING, require_one_rig, signals_of
from rigtool.experiments.imported_load.imported_accuracy import (
    FAST,
    REFERENCE,
    WIDE,
    Accuracy,
    LoadSignals,
    accuracy,
    accuracy_columns,
    carries,
    judge,
    levels_of,
    read_signals,
)
from rigtool.experiments.imported_load.loop import DOUBTED, REFUSED
from rigtool.experiments.imported_load.model import LoadModel, TorqueEstimate
from rigtool.experiments.imported_load.region import reached
from rigtool.experiments.imported_load.stored import RANDOM, WIDE_MODEL, load_model_from
from rigtool.experiments.outcome import Outcome
from rigtool.numerics.arrays import Array
from rigtool.quantity import Quantity
from rigtool.runfile import Column, Recording, Run, Table

MOST_BEYOND = 0.25
"""Part of the way beyond the learned stroke from which on the encoder was zeroed elsewhere."""

LEFT_OUT, RANDOM_HALF = 0, 1
"""How the samples that are judged were kept from learning: other runs, or random halves."""


@dataclass(frozen=True, eq=False)
class Measured:
    """One run: its signals and the model's estimate from them."""

    signals: LoadSignals
    estimate: TorqueEstimate


def analyse_imported(runs: Sequence[Run], *, tables: Run, kt: Run | None = None) -> Outcome:
    """Measure torque, and compare it with the sensor where there is one.

    Raises `UsageError` for tables of another rig, `InsufficientDataError` for those of another
    mounting and where all is outside what was learned.
    """
    recordings = signals_of(runs)
    require_one_rig(recordings, runs)
    model, unit = load_model_from(tables)
    _require_learned_here(runs, tables)
    measured = _measured(runs, recordings, model, kt, unit)
    _require_stroke(measured, model, tables)
    notes = [*_require_inside(measured, model), *_also_learned(runs, tables)]
    measured, remarks = _of_this_mounting(measured, model, tables)
    notes += remarks
    results, found = over_time_tables(
        [_reading(item) for item in measured], model.scales.torque, model.bandwidth_hz
    )
    found["force"] = _with_motion(found["force"], measured, unit, model.direction)
    results |= _own_results(measured)
    if all(item.signals.reference is not None for item in measured):
        more, judged_tables, remarks = _judged(runs, recordings, measured, tables, kt, unit)
        results |= more
        found |= judged_tables
        notes += remarks
    else:
        notes.append(f"not every run holds {REFERENCE}: the torque is not judged")
    return Outcome(results, found, tuple(notes))


def _measured(
    runs: Sequence[Run],
    recordings: Sequence[Recording],
    model: LoadModel,
    kt: Run | None,
    unit: str,
) -> list[Measured]:
    """Return signals and estimates; `UsageError` where the effort is not in the model's unit."""
    measured = []
    for run, recording in zip(runs, recordings, strict=True):
        signals = read_signals(run, recording, kt, model.bandwidth_hz)
        if signals.effort_unit != unit:
            raise UsageError(
                f"{run.path}: its effort is in {signals.effort_unit}, the tables were learned "
                f"in {unit}: give --kt to both commands or to neither"
            )
        measured.append(Measured(signals, model.estimate(signals.effort, signals.path)))
    return measured


def _require_stroke(measured: Sequence[Measured], model: LoadModel, tables: Run) -> None:
    """Raise `InsufficientDataError` where much of the way is beyond the learned stroke."""
    paths = [item.signals.path for item in measured]
    place = np.concatenate([model.place(path)[path.regular] for path in paths])
    beyond = float(np.mean(~reached(place)))
    if beyond > MOST_BEYOND:
        low, high = model.scales.low, model.scales.high
        raise InsufficientDataError(
            f"{beyond:.0%} of the way is beyond the stroke that {tables.path} was learned on, "
            f"{low:.4g} to {high:.4g} rad of the motor: the encoder was zeroed elsewhere, or the "
            "tables are of another instrument or mounting; learn tables from runs of this one"
        )


def _of_this_mounting(
    measured: Sequence[Measured], model: LoadModel, tables: Run
) -> tuple[list[Measured], list[str]]:
    """Return the estimates with u widened where strokes to and fro disagree, and notes.

    Raises `InsufficientDataError` where strokes disagree more than in any learned recording.
    """
    loop = model.loop
    misfits = np.array([_misfit(item, model) for item in measured])
    known = misfits[np.isfinite(misfits)]
    if not known.size:
        return list(measured), [
            "no run has strokes in both directions at the same places: whether the tables are of "
            "this mounting cannot be checked"
        ]
    typical, limit = float(np.median(known)), loop.limit(REFUSED)
    if typical > limit:
        raise InsufficientDataError(
            f"strokes to and fro disagree {typical:.1f} times as much as in the runs that "
            f"{tables.path} was learned from, {limit:.1f} times at most is by chance: these runs "
            "are of another instrument or mounting, or of loads unlike the learned ones; learn "
            "tables from runs of this mounting (two loads are enough with --prior)"
        )
    doubted = np.nan_to_num(misfits) > loop.limit(DOUBTED)
    wider = [
        Measured(item.signals, item.estimate.widened(misfit)) if doubt else item
        for item, misfit, doubt in zip(measured, misfits, doubted, strict=True)
    ]
    notes = [
        f"strokes to and fro disagree {typical:.2g} times as much as in the runs that were learned "
        f"from; tables of another mounting are refused beyond {limit:.2g} times"
    ]
    if doubted.any():
        notes.append(
            f"u of {int(doubted.sum())} runs is wider: their strokes disagree up to "
            f"{float(misfits[doubted].max()):.2g} times as much"
        )
    return wider, notes


def _misfit(item: Measured, model: LoadModel) -> float:
    rows, estimate, path = item.signals.counts, item.estimate, item.signals.path
    torque = np.where(estimate.inside, estimate.torque, np.nan)[rows] / model.scales.torque
    return model.loop.misfit(model.place(path)[rows], path.speed[rows] > 0, torque)


def _require_learned_here(runs: Sequence[Run], tables: Run) -> None:
    if tables.rig != runs[0].rig:
        raise UsageError(
            f"{tables.path}: was learned on {tables.rig or 'an unknown rig'}, the runs are of "
            f"{runs[0].rig or 'an unknown rig'}: learn tables from runs of this rig"
        )


def _also_learned(runs: Sequence[Run], tables: Run) -> list[str]:
    inputs = {item["content_sha256"] for item in tables.provenance["inputs"]}
    both = [run.path.name for run in runs if run.content_sha256 in inputs]
    if not both:
        return []
    return [
        f"the tables were learned from {len(both)} of these runs ({both[0]}, ...): errors there "
        "show less than those of runs that were kept from learning"
    ]


def _require_inside(measured: Sequence[Measured], model: LoadModel) -> list[str]:
    """Return notes on samples without an estimate; raise where no sample has one."""
    rows = np.concatenate([item.signals.counts for item in measured])
    states = np.concatenate([item.estimate.states for item in measured])[rows]
    wild = np.concatenate([~item.signals.path.regular for item in measured])[rows]
    inside = np.isin(states, (State.AGAINST, State.WITH))
    hidden = np.isin(states, (State.REVERSED, State.STILL))
    if not inside.any():
        raise InsufficientDataError(
            f"all {len(states)} samples are outside the position, speed and load of the tables "
            f"(learned up to {model.scales.torque * 1e3:.3g} mN m), or at rest: learn from runs "
            "that cover these"
        )
    notes = [
        f"{int(np.sum(states == State.OUTSIDE))} of {len(states)} samples are outside what was "
        "learned and have no value",
        f"{int(np.sum(hidden))} samples are near standstill (below "
        f"{model.scales.standstill:.3g} rad/s) or after a reversal: the torque is the middle of a "
        "dead band there",
    ]
    if wild.any():
        where = [item for item in measured if (~item.signals.path.regular).any()]
        notes.append(
            f"{int(np.sum(wild))} samples of {len(where)} runs belong to a transient, such as "
            "homing, and have no value"
        )
    return notes


def _own_results(measured: Sequence[Measured]) -> dict[str, Quantity]:
    """Return the results that need no sensor."""
    parts = [
        [getattr(item.estimate, name)[item.signals.counts] for item in measured]
        for name in ("inside", "states", "u", "low", "high")
    ]
    inside, states, u, low, high = (np.concatenate(part) for part in parts)
    hidden = np.isin(states, (State.REVERSED, State.STILL))
    count = "a count"
    found = {
        "samples": Quantity(int(np.sum(inside)), "1", reason=count),
        "samples_outside": Quantity(int(np.sum(states == State.OUTSIDE)), "1", reason=count),
        "samples_still": Quantity(int(np.sum(hidden)), "1", reason=count),
        "torque_u_median": Quantity(
            float(np.median(u[inside])), "N m", reason="itself an uncertainty: of one sample"
        ),
    }
    if hidden.any():
        found["dead_band"] = Quantity(
            float(np.median((high - low)[hidden])),
            "N m",
            reason="the median width, near standstill and after reversals",
        )
    return found


def _reading(item: Measured) -> Reading:
    """Return a run as force over time has it."""
    signals, estimate = item.signals, item.estimate
    rows = signals.counts

    def kept(values: Array) -> Array:
        return np.nan_to_num(values[rows])  # no value: the state is that of none

    return Reading(
        name=RECORDING,
        step_time=float(np.diff(signals.path.time[:2])[0]),
        time=signals.path.time[rows],
        torque=kept(estimate.torque),
        u=kept(estimate.u),
        causal=np.empty(0),
        causal_u=np.empty(0),
        causal_states=np.empty(0, dtype=estimate.states.dtype),
        states=estimate.states[rows],
        reference=None if signals.reference is None else signals.reference[rows],
        limited=0,
    )


def _with_motion(table: Table, measured: Sequence[Measured], unit: str, direction: int) -> Table:
    """Return the table with what the torque was read from; low and high are those of the dead band
    where friction may act either way."""

    def joined(values: Sequence[Array]) -> Array:
        rows = [item.signals.counts for item in measured]
        return np.concatenate([own[row] for own, row in zip(values, rows, strict=True)])

    columns = dict(table.columns)
    for name in ("low", "high"):
        values = joined([getattr(item.estimate, name) for item in measured])
        columns[name] = replace(columns[name], values=values)
    columns |= {
        "position": Column(joined([m.signals.path.position for m in measured]), "rad", "motor"),
        "speed": Column(
            joined([direction * m.signals.output_speed for m in measured]),
            "rad/s",
            "of the output, positive against the load",
        ),
        "effort": Column(joined([m.signals.effort for m in measured]), unit, "of the motor"),
    }
    return replace(
        table,
        columns=columns,
        description="torque at the load over time, in the sensor's sign, low-passed as all signals",
    )


# -- judged by the sensor


def _judged(
    runs: Sequence[Run],
    recordings: Sequence[Recording],
    measured: Sequence[Measured],
    tables: Run,
    kt: Run | None,
    unit: str,
) -> tuple[dict[str, Quantity], dict[str, Table], list[str]]:
    """Return results, tables and notes of the comparison with the sensor."""
    model, _ = load_model_from(tables)
    found = _accuracy(measured, model)
    strokes = read_strokes([(m.signals, m.estimate) for m in measured], model.direction)
    rows = [(LEFT_OUT, model.bandwidth_hz, found)]
    if WIDE_MODEL in tables.tables and carries(recordings, WIDE):
        model, _ = load_model_from(tables, WIDE_MODEL)
        rows.append(
            (LEFT_OUT, WIDE, _accuracy(_measured(runs, recordings, model, kt, unit), model))
        )
    numbers = levels_of([item.signals for item in measured])
    more, notes = scatter_results(strokes)
    found_tables = {"accuracy": _accuracy_table(rows, tables)}
    if (table := levels_table(strokes, numbers)) is not None:
        found_tables["levels"] = table
    else:
        notes.append(
            f"no closing stroke passes the middle of the stroke faster than {FAST:g} rad/s: "
            "there is no table of levels"
        )
    return {**_accuracy_results(found), **more}, found_tables, notes


def _accuracy(measured: Sequence[Measured], model: LoadModel) -> Accuracy:
    return accuracy([judge(item.signals, item.estimate, model.direction) for item in measured])


def _accuracy_results(found: Accuracy) -> dict[str, Quantity]:
    reason = "itself a measure of uncertainty"
    slow = f"{reason}; NaN: no such stroke is faster than {FAST:g} rad/s"
    return {
        "rmse_closing": Quantity(found.closing, "N m", reason=slow),
        "rmse_opening": Quantity(found.opening, "N m", reason=slow),
        "rmse_moving": Quantity(found.moving, "N m", reason=reason),
        "coverage_95": Quantity(found.coverage, "1", reason=reason),
    }


def _accuracy_table(rows: Sequence[tuple[int, float, Accuracy]], tables: Run) -> Table:
    """Return errors by split and bandwidth: of these runs, and of those that were learned from."""
    split = [float(kind) for kind, _, _ in rows]
    bandwidth = [bandwidth for _, bandwidth, _ in rows]
    columns = accuracy_columns([item for _, _, item in rows])
    values = {name: list(column.values) for name, column in columns.items()}
    if RANDOM in tables.tables:
        random = tables.table(RANDOM)
        split += [float(RANDOM_HALF)] * len(random["bandwidth"])
        bandwidth += list(random["bandwidth"])
        for name in values:
            values[name] += list(random[name])
    return Table(
        ("row",),
        {
            "row": Column(np.arange(len(split)), "1"),
            "split": Column(np.array(split), "1", "0: runs kept from learning; 1: random halves"),
            "bandwidth": Column(np.array(bandwidth), "Hz", "of all signals"),
            **{
                name: Column(np.array(values[name]), column.unit, column.description)
                for name, column in columns.items()
            },
        },
        "rmse_closing",
        "errors against the sensor",
    )
