"""Torque over time as a run file stores it: tables `force` and `force_accuracy`, and results."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rigtool.experiments.force.accuracy import (
    BANDS,
    JUDGED,
    Accuracy,
    accuracy,
    by_band_and_state,
)
from rigtool.experiments.force_over_time.motion_states import NAMES, Reach, State, States
from rigtool.experiments.outcome import Outcome
from rigtool.numerics.arrays import Array
from rigtool.numerics.lowpass import FILTER_ORDER, lowpass
from rigtool.quantity import Quantity
from rigtool.recipe import Recipe
from rigtool.runfile import Column, Table

ROWS = 20
"""Rows of the table in a period of the low-pass."""

COVERAGE_FACTOR = 1.96
"""Of an interval of 95 %, normal distribution (GUM 6.2.2)."""


@dataclass(frozen=True, eq=False)
class Reading:
    """Torque on the output at each step of a recording (m,), N m: smoothed, and causal behind the
    low-pass; deviations are those behind the low-pass. `reference` N m where it was recorded.
    `limited` counts the samples whose current was at its limit."""

    name: str
    step_time: float
    time: Array
    torque: Array
    deviation: Array
    causal: Array
    causal_deviation: Array
    states: States
    reference: Array | None
    limited: int
    causal_reference: Array | None = None

    @classmethod
    def joined(cls, parts: Sequence[Reading]) -> Reading:
        """Return the parts of one recording as one."""
        first = parts[0]
        if len(parts) == 1:
            return first
        together: dict[str, Any] = {
            name: np.concatenate([getattr(part, name) for part in parts])
            for name in (*SIGNALS, "states")
        }
        for name in ("reference", "causal_reference"):
            if getattr(first, name) is not None:
                together[name] = np.concatenate([getattr(part, name) for part in parts])
        return replace(first, **together, limited=sum(part.limited for part in parts))

    def low_passed(self, cutoff_hz: float) -> Reading:
        """Return the rows of the table, low-passed at a cut-off, Hz, as the causal torque is."""
        from scipy.signal import butter, sosfilt

        rate = 1 / self.step_time
        sections = butter(FILTER_ORDER, cutoff_hz, fs=rate, output="sos")
        every = max(1, int(rate / (ROWS * cutoff_hz)))
        kept = {
            name: getattr(self, name)[::every]
            for name in ("time", "states", "deviation", "causal", "causal_deviation")
        }
        if self.reference is not None:
            kept["reference"] = lowpass(rate, self.reference, cutoff_hz)[::every]
            kept["causal_reference"] = sosfilt(sections, self.reference)[::every]
        return replace(
            self,
            step_time=self.step_time * every,
            torque=lowpass(rate, self.torque, cutoff_hz)[::every],
            **kept,
        )


SIGNALS = ("time", "torque", "deviation", "causal", "causal_deviation")


@dataclass(frozen=True, eq=False)
class Scales:
    """Factors on the filter's deviations by state, (5,) each, in the order of `State`."""

    smoothed: Array
    causal: Array

    def applied(self, rows: Reading) -> Reading:
        """Return rows with standard uncertainties in place of the filter's deviations."""
        return replace(
            rows,
            deviation=rows.deviation * self.smoothed[rows.states],
            causal_deviation=rows.causal_deviation * self.causal[rows.states],
        )


def force_outcome(
    readings: Sequence[Reading], recipe: Recipe, reach: Reach, scales: Scales
) -> Outcome:
    """Return tables, results and notes of the recordings of a run."""
    bandwidth = recipe.measure_force.motion.bandwidth_hz
    rows = [scales.applied(reading.low_passed(bandwidth)) for reading in readings]
    whole = Reading.joined([replace(r, reference=None, causal_reference=None) for r in rows])
    known = whole.states != State.OUTSIDE
    results, tables = _results(whole, known), {"force": _table(rows, whole, known, recipe)}
    judged = [row for row in rows if row.reference is not None]
    if judged:
        found, table = _judged(Reading.joined(judged), reach)
        results |= found
        tables["force_accuracy"] = table
    notes = _notes(readings, known, reach, scales)
    return Outcome(results, tables, tuple(notes))


def _results(whole: Reading, known: NDArray[np.bool_]) -> dict[str, Quantity]:
    results = {"valid_share": _share(known)}
    if known.any():
        torque, u = whole.torque[known], whole.deviation[known]
        peak = int(np.argmax(np.abs(torque)))
        results["peak_torque"] = Quantity(float(torque[peak]), "N m", float(u[peak]))
        results["mean_torque"] = Quantity(float(torque.mean()), "N m", float(u.mean()))
    return results


def _share(values: NDArray[np.bool_]) -> Quantity:
    return Quantity(float(values.mean()), "1", reason="counted")


def _table(
    rows: Sequence[Reading], whole: Reading, known: NDArray[np.bool_], recipe: Recipe
) -> Table:
    def valid(values: Array) -> Array:
        return np.where(known, values, np.nan)

    number = np.repeat(np.arange(len(rows)), [len(row.time) for row in rows])
    half = COVERAGE_FACTOR * whole.deviation
    states = ", ".join(f"{state.value} {name}" for state, name in NAMES.items())
    columns = {
        "row": Column(np.arange(len(number)), "1"),
        "recording": Column(number, "1", "of this run, in order"),
        "time": Column(whole.time, "s", "bench clock"),
        "torque": Column(valid(whole.torque), "N m", "on the output, from the whole recording"),
        "force": Column(valid(whole.torque / recipe.rig.load_arm), "N", "at the tip"),
        "u": Column(valid(whole.deviation), "N m", "standard uncertainty of torque"),
        "low": Column(valid(whole.torque - half), "N m", "lower end of the 95 % interval"),
        "high": Column(valid(whole.torque + half), "N m", "upper end of the 95 % interval"),
        "state": Column(whole.states, "1", states),
        "causal_torque": Column(valid(whole.causal), "N m", "from samples up to its time only"),
        "causal_u": Column(valid(whole.causal_deviation), "N m", "its standard uncertainty"),
    }
    if any(row.reference is not None for row in rows):
        columns["reference"] = Column(_references(rows), "N m", "torque that acted, low-passed")
    return Table(
        ("row",),
        columns,
        "torque",
        "torque on the output over time, positive where it resists positive motion, low-passed at "
        f"{recipe.measure_force.motion.bandwidth_hz:g} Hz",
    )


def _references(rows: Sequence[Reading]) -> Array:
    """Return what acted in all recordings (m,), N m; NaN in those without a reference."""
    return np.concatenate(
        [np.full(len(row.time), np.nan) if row.reference is None else row.reference for row in rows]
    )


def _judged(rows: Reading, reach: Reach) -> tuple[dict[str, Quantity], Table]:
    """Return errors and coverage against the reference, which has no other use."""
    assert rows.reference is not None
    assert rows.causal_reference is not None
    known = rows.states != State.OUTSIDE
    moving = known & (rows.states != State.STILL)
    results: dict[str, Quantity] = {}
    columns = {
        "band": Column(np.array(BANDS[:-1]) * reach.torque, "N m", "lower end of the load's band"),
        "state": Column(np.array([int(state) for state in JUDGED]), "1", "as in table force"),
    }
    for prefix, torque, reference, u in (
        ("", rows.torque, rows.reference, rows.deviation),
        ("causal_", rows.causal, rows.causal_reference, rows.causal_deviation),
    ):
        error = np.where(known, torque - reference, np.nan)
        covered = np.abs(error) <= COVERAGE_FACTOR * u
        overall, while_moving = (accuracy(error, covered, among) for among in (known, moving))
        why = "the deviation from the reference itself"
        results |= {
            f"{prefix}rmse": Quantity(overall.rmse, "N m", reason=why),
            f"{prefix}rmse_moving": Quantity(while_moving.rmse, "N m", reason=why),
            f"{prefix}coverage_95": Quantity(overall.coverage, "1", reason="counted"),
        }
        cells = by_band_and_state(error, covered, rows.reference, rows.states, reach.torque)
        columns |= _cells(prefix, cells)
    return results, Table(
        ("band", "state"), columns, "rmse", "torque against the reference, by load and state"
    )


def _cells(prefix: str, cells: list[list[Accuracy]]) -> dict[str, Column]:
    def values(name: str) -> Array:
        return np.array([[getattr(cell, name) for cell in row] for row in cells])

    return {
        f"{prefix}rmse": Column(values("rmse"), "N m", "root mean square of the error"),
        f"{prefix}bias": Column(values("bias"), "N m", "mean of the error"),
        f"{prefix}coverage_95": Column(values("coverage"), "1", "share within the 95 % interval"),
        f"{prefix}share": Column(values("share"), "1", "of the samples with a value"),
    }


def _notes(
    readings: Sequence[Reading], known: NDArray[np.bool_], reach: Reach, scales: Scales
) -> list[str]:
    low, high = reach.angle
    factors = ", ".join(f"{scales.smoothed[s]:.2f} {NAMES[s]}" for s in JUDGED)
    notes = [
        f"torque was learned up to {reach.torque * 1e3:.4g} mN m, from {low:.4g} to {high:.4g} rad "
        f"of the motor, up to {reach.speed:.4g} rad/s; outside there is no value",
        f"u is the filter's deviation times what errors under the known loads show: {factors}",
    ]
    if (outside := 1 - known.mean()) > 0:
        notes.append(f"no value in {outside:.1%} of the time: outside what was learned")
    if limited := sum(reading.limited for reading in readings):
        notes.append(f"{limited} samples have a current at its limit: no value there")
    return notes
