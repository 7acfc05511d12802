"""`measure-force` on imported runs: torque at the load from the motor's current and encoder.

A load model that `ilc-learn --implementation D` learned on the same rig turns effort and motion
into torque. Where the runs hold a sensor's `reference_torque`, it judges the result and is used for
nothing else: errors by kind of stroke, and a Table 8 at one position of the closing strokes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rigtool.errors import InsufficientDataError, UsageError
from rigtool.experiments.force.imported_strokes import levels_table, read_strokes, scatter_results
from rigtool.experiments.imported import require_one_rig, signals_of
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
from rigtool.experiments.imported_load.model import LoadModel, TorqueEstimate
from rigtool.experiments.imported_load.stored import RANDOM, WIDE_MODEL, load_model_from
from rigtool.experiments.outcome import Outcome
from rigtool.numerics.arrays import Array
from rigtool.quantity import Quantity
from rigtool.runfile import Column, Recording, Run, Table

LEFT_OUT, RANDOM_HALF = 0, 1
"""How the samples that are judged were kept from learning: other runs, or random halves."""


@dataclass(frozen=True, eq=False)
class Measured:
    """One run: its signals and the model's estimate from them."""

    signals: LoadSignals
    estimate: TorqueEstimate


def analyse_imported(runs: Sequence[Run], *, tables: Run, kt: Run | None = None) -> Outcome:
    """Measure torque, and compare it with the sensor where there is one.

    Raises `UsageError` for tables of another rig, `InsufficientDataError` where all is outside what
    was learned.
    """
    recordings = signals_of(runs)
    require_one_rig(recordings, runs)
    model, unit = load_model_from(tables)
    _require_learned_here(runs, tables)
    measured = []
    for run, recording in zip(runs, recordings, strict=True):
        signals = read_signals(run, recording, kt, model.bandwidth_hz)
        if signals.effort_unit != unit:
            raise UsageError(
                f"{run.path}: its effort is in {signals.effort_unit}, the tables were learned "
                f"in {unit}: give --kt to both commands or to neither"
            )
        estimate = model.estimate(signals.effort, signals.path)
        measured.append(Measured(signals, estimate))
    notes = [*_require_inside(measured, model), *_also_learned(runs, tables)]
    found = {"series": _series_table(measured, unit, model.direction)}
    results = _own_results(measured)
    if all(item.signals.reference is not None for item in measured):
        more, judged_tables, remarks = _judged(runs, recordings, measured, tables, kt, model)
        results |= more
        found |= judged_tables
        notes += remarks
    else:
        notes.append(f"not every run holds {REFERENCE}: the torque is not judged")
    return Outcome(results, found, tuple(notes))


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
    still = np.concatenate([item.estimate.still for item in measured])[rows]
    inside = np.concatenate([item.estimate.inside for item in measured])[rows]
    wild = np.concatenate([~item.signals.path.regular for item in measured])[rows]
    moving, outside = int(np.sum(~still)), int(np.sum(~still & ~inside))
    if not inside.any():
        raise InsufficientDataError(
            f"all {moving} samples in motion are outside the position, speed and load of the "
            f"tables (learned up to {model.scales.torque * 1e3:.3g} mN m): learn from runs that "
            "cover these"
        )
    notes = [
        f"{outside} of {moving} samples in motion are outside what was learned and have no value",
        f"{int(np.sum(still))} samples are near standstill (below "
        f"{model.scales.standstill:.3g} rad/s): a dead band instead of a value",
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
    rows = [item.signals.counts for item in measured]
    inside = np.concatenate([m.estimate.inside[r] for m, r in zip(measured, rows, strict=True)])
    still = np.concatenate([m.estimate.still[r] for m, r in zip(measured, rows, strict=True)])
    u = np.concatenate([m.estimate.u[r] for m, r in zip(measured, rows, strict=True)])
    width = np.concatenate(
        [(m.estimate.high - m.estimate.low)[r] for m, r in zip(measured, rows, strict=True)]
    )
    count = "a count"
    found = {
        "samples": Quantity(int(np.sum(inside)), "1", reason=count),
        "samples_outside": Quantity(int(np.sum(~inside & ~still)), "1", reason=count),
        "samples_still": Quantity(int(np.sum(still)), "1", reason=count),
        "torque_u_median": Quantity(
            float(np.nanmedian(u)), "N m", reason="itself an uncertainty: of one sample"
        ),
    }
    if np.isfinite(width).any():
        found["dead_band"] = Quantity(
            float(np.nanmedian(width)), "N m", reason="the median width, near standstill"
        )
    return found


def _series_table(measured: Sequence[Measured], unit: str, direction: int) -> Table:
    """Return the torque of every run over time; runs of different lengths end in NaN."""
    length = max(len(item.signals.path.time) for item in measured)

    def stacked(values: Sequence[Array]) -> Array:
        rows = np.full((len(values), length), np.nan)
        for row, each in zip(rows, values, strict=True):
            row[: len(each)] = each
        return rows

    first = max((item.signals.path.time for item in measured), key=len)
    columns = {
        "run": Column(np.arange(len(measured)), "1", "in the order they were given"),
        "time": Column(first - first[0], "s", "from the start of the run"),
        "torque": Column(
            stacked([item.estimate.torque for item in measured]), "N m", "from effort and motion"
        ),
        "u": Column(stacked([item.estimate.u for item in measured]), "N m", "of one sample"),
        "low": Column(stacked([m.estimate.low for m in measured]), "N m", "dead band"),
        "high": Column(stacked([m.estimate.high for m in measured]), "N m", "dead band"),
        "position": Column(stacked([m.signals.path.position for m in measured]), "rad", "motor"),
        "speed": Column(
            stacked([direction * m.signals.output_speed for m in measured]),
            "rad/s",
            "of the output, positive against the load",
        ),
        "effort": Column(stacked([m.signals.effort for m in measured]), unit, "of the motor"),
    }
    if all(item.signals.reference is not None for item in measured):
        sensors = [m.signals.reference for m in measured if m.signals.reference is not None]
        columns["reference"] = Column(stacked(sensors), "N m", "the sensor's")
    return Table(("run", "time"), columns, "torque", "torque at the load, all signals low-passed")


# -- judged by the sensor


def _judged(
    runs: Sequence[Run],
    recordings: Sequence[Recording],
    measured: Sequence[Measured],
    tables: Run,
    kt: Run | None,
    model: LoadModel,
) -> tuple[dict[str, Quantity], dict[str, Table], list[str]]:
    """Return results, tables and notes of the comparison with the sensor."""
    judged = [judge(item.signals, item.estimate, model.direction) for item in measured]
    found = accuracy(judged)
    strokes = read_strokes([(m.signals, m.estimate) for m in measured], model.direction)
    rows = [(LEFT_OUT, model.bandwidth_hz, found)]
    if WIDE_MODEL in tables.tables and carries(recordings, WIDE):
        wide = []
        model, _ = load_model_from(tables, WIDE_MODEL)
        for run, recording in zip(runs, recordings, strict=True):
            signals = read_signals(run, recording, kt, model.bandwidth_hz)
            wide.append(
                judge(signals, model.estimate(signals.effort, signals.path), model.direction)
            )
        rows.append((LEFT_OUT, WIDE, accuracy(wide)))
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
