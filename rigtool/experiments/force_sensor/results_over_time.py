"""Torque over time as a run file stores it: tables `force` and `force_accuracy`, and results."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rigtool.experiments.force_filter.accuracy import (
    COVERAGE_FACTOR,
    JUDGED_STATES,
    LOAD_BAND_EDGES,
    Accuracy,
    accuracy,
    by_band_and_state,
)
from rigtool.experiments.force_filter.motion_states import (
    CREEPING_KIND,
    STATE_NAMES,
    Reach,
    State,
    States,
)
from rigtool.experiments.force_model.contacts import FALSE_ALARMS, JUMP_WINDOW, Contact, MotionKind
from rigtool.experiments.force_sensor.response import Spectra, amplitude_bandwidth
from rigtool.experiments.force_sensor.signal_faults import SignalFault
from rigtool.experiments.force_sensor.unknown_friction import Passes
from rigtool.experiments.force_sensor.unknown_inertia import Turns
from rigtool.experiments.outcome import Outcome
from rigtool.numerics.arrays import Array, Mask
from rigtool.quantity import Quantity
from rigtool.recipe import Recipe
from rigtool.runfile import Column, Table

ROWS_PER_PERIOD = 20 / 3
"""Rows of the table in a period of the low-pass's corner: 20 in one of the bandwidth."""


@dataclass(frozen=True, eq=False)
class TorqueRows:
    """Rows of the torque on the output in a stretch without gaps (m,), N m, low-passed: smoothed,
    and causal (empty where there is none), each with standard uncertainty and states. `reference`
    N m where it was recorded, low-passed as each. `limited` counts the samples whose current was at
    its limit; `contacts` are in steps, `every` of which are a row. With `dead_bands`, the torque of
    the states REVERSED and STILL is the middle of a dead band, its u that of a rectangular
    distribution (GUM 4.3.7). `passes` show whether the tables are of this
    instrument: of the torque, and of what it was before another power-up's ripple was taken off.
    `turns` show whether inertia is that of the tables. `faults` are those of the signals."""

    name: str
    step_time: float
    time: Array
    torque: Array
    u: Array
    states: States
    causal: Array = field(default_factory=lambda: np.empty(0))
    causal_u: Array = field(default_factory=lambda: np.empty(0))
    causal_states: States = field(default_factory=lambda: np.empty(0, dtype=np.int32))
    reference: Array | None = None
    limited: int = 0
    causal_reference: Array | None = None
    contacts: tuple[Contact, ...] = ()
    every: int = 1
    dead_bands: bool = False
    response: Spectra | None = None
    passes: tuple[Passes, ...] = ()
    turns: Turns = field(default_factory=Turns)
    faults: tuple[SignalFault, ...] = ()

    @property
    def hidden(self) -> Mask:
        """Where there is a dead band instead of an estimate (m,)."""
        found: Mask = self.dead_bands & np.isin(self.states, (State.REVERSED, State.STILL))
        return found

    @property
    def half(self) -> Array:
        """Half of the 95 % interval, or of the dead band (m,), N m."""
        half: Array = np.where(self.hidden, math.sqrt(3), COVERAGE_FACTOR) * self.u
        return half

    def widened(self, by: float, share: float) -> TorqueRows:
        """Return the reading with another uncertainty, N m, and a share of the torque, besides."""
        u, causal_u = (
            np.sqrt(u**2 + by**2 + (share * torque) ** 2)
            for u, torque in ((self.u, self.torque), (self.causal_u, self.causal))
        )
        return replace(self, u=u, causal_u=causal_u)

    @classmethod
    def joined(cls, parts: Sequence[TorqueRows]) -> TorqueRows:
        """Return stretches as one."""
        first = parts[0]
        if len(parts) == 1:
            return first
        together: dict[str, Any] = {
            name: np.concatenate([getattr(part, name) for part in parts]) for name in FORCE_SIGNALS
        }
        for name in ("reference", "causal_reference"):
            if getattr(first, name) is not None:
                together[name] = np.concatenate([getattr(part, name) for part in parts])
        return replace(first, **together, limited=sum(part.limited for part in parts))


def steps_of_a_row(step_time: float, corner_hz: float) -> int:
    """Return how many steps of `step_time` s are a row of the table."""
    return max(1, int((1 / step_time) / (ROWS_PER_PERIOD * corner_hz) * (1 + 1e-6)))


FORCE_SIGNALS = (
    "time",
    "torque",
    "u",
    "states",
    "causal",
    "causal_u",
    "causal_states",
)


@dataclass(frozen=True, eq=False)
class Recorded:
    """A recording by its stretches without gaps; `breaks` are between them, and `lost` s have no
    torque: gaps, samples that are NaN, stretches that are too short."""

    name: str
    parts: tuple[TorqueRows, ...]
    breaks: int
    lost: float


def force_outcome(
    recordings: Sequence[Recorded], recipe: Recipe, reach: Reach, scales: Array, limits: Array
) -> Outcome:
    """Return tables, results and notes of the recordings of a run.

    `scales` (kinds, 2) are those of the smoothed torque (`intervals`), `limits` (3, 2) the
    thresholds by which contacts were looked for.
    """
    corner_hz = recipe.measure_force.motion.corner_hz
    parts = [(number, part) for number, r in enumerate(recordings) for part in r.parts]
    rows = [part for _, part in parts]
    results, tables = over_time_tables(
        rows,
        reach.torque,
        corner_hz,
        recipe.rig.load_arm,
        numbers=[number for number, _ in parts],
        lost=sum(r.lost for r in recordings),
    )
    if np.isfinite(limits).any():
        tables |= (events := _events(parts))
        count = events["events"].shape[0] if events else 0
        results["contacts"] = Quantity(float(count), "1", reason="counted")
    known = tables["force"]["state"] != State.OUTSIDE
    notes = [*_notes(recordings, known, reach, scales), *_contact_notes(limits)]
    return Outcome(results, tables, tuple(notes))


def over_time_tables(
    rows: Sequence[TorqueRows],
    largest: float,
    corner_hz: float,
    load_arm: float | None = None,
    *,
    numbers: Sequence[int] | None = None,
    lost: float = 0.0,
) -> tuple[dict[str, Quantity], dict[str, Table]]:
    """Return results and tables of stretches, low-passed at `corner_hz`, with uncertainties.

    `largest` N m is the largest torque that was learned; the force at the tip needs a `load_arm` m.
    `numbers` are those of the recordings that the stretches belong to, one each by default; `lost`
    s is the time without a stretch.
    """
    whole = TorqueRows.joined([replace(r, reference=None, causal_reference=None) for r in rows])
    number = np.repeat(
        np.arange(len(rows)) if numbers is None else numbers, [len(row.time) for row in rows]
    )
    known = whole.states != State.OUTSIDE
    results = _results(whole, known, sum(len(r.time) * r.step_time for r in rows), lost)
    tables = {"force": _table(rows, whole, known, number, corner_hz, load_arm)}
    judged = [row for row in rows if row.reference is not None]
    if judged:
        found, tables["force_accuracy"] = _judged(TorqueRows.joined(judged), largest)
        results |= found | _bandwidth([row.response for row in judged if row.response is not None])
    return results, tables


def _results(
    whole: TorqueRows, known: NDArray[np.bool_], read: float, lost: float
) -> dict[str, Quantity]:
    share = float(known.mean()) * read / (read + lost)
    results = {"valid_share": Quantity(share, "1", reason="counted")}
    if known.any():
        torque, u = whole.torque[known], whole.u[known]
        peak = _peak(torque, u)
        results["peak_torque"] = Quantity(float(torque[peak]), "N m", float(u[peak]))
        results["mean_torque"] = Quantity(float(torque.mean()), "N m", float(u.mean()))
    return results


def _peak(torque: Array, u: Array) -> int:
    """Return the row with the largest magnitude that the torque surely has, by its 95 % interval:
    the largest torque alone may be that of a row of large u, such as the last ones."""
    return int(np.argmax(np.abs(torque) - COVERAGE_FACTOR * u))


def _table(
    rows: Sequence[TorqueRows],
    whole: TorqueRows,
    known: NDArray[np.bool_],
    number: NDArray[np.intp],
    corner_hz: float,
    load_arm: float | None,
) -> Table:
    def valid(values: Array, where: NDArray[np.bool_] = known) -> Array:
        return np.where(where, values, np.nan)

    so_far = whole.causal_states != State.OUTSIDE

    states = ", ".join(f"{state.value} {name}" for state, name in STATE_NAMES.items())
    columns = {
        "row": Column(np.arange(len(number)), "1"),
        "recording": Column(number, "1", "of this run, in order"),
        "time": Column(whole.time, "s", "bench clock"),
        "torque": Column(valid(whole.torque), "N m", "on the output, from the whole recording"),
        "force": Column(valid(whole.torque / (load_arm or np.nan)), "N", "at the tip"),
        "u": Column(valid(whole.u), "N m", "standard uncertainty of torque"),
        "low": Column(valid(whole.torque - whole.half), "N m", "lower end of the 95 % interval"),
        "high": Column(valid(whole.torque + whole.half), "N m", "upper end of the 95 % interval"),
        "state": Column(whole.states, "1", states),
    }
    if load_arm is None:
        del columns["force"]
    if whole.causal.size:
        columns |= {
            "causal_torque": Column(
                valid(whole.causal, so_far), "N m", "from samples up to its time only"
            ),
            "causal_u": Column(valid(whole.causal_u, so_far), "N m", "its standard uncertainty"),
            "causal_state": Column(whole.causal_states, "1", "from samples up to its time only"),
        }
    if any(row.reference is not None for row in rows):
        columns["reference"] = Column(_references(rows), "N m", "torque that acted, low-passed")
    return Table(
        ("row",),
        columns,
        "torque",
        "torque on the output over time, positive where it resists positive motion, low-passed at "
        f"{corner_hz:g} Hz",
    )


def _references(rows: Sequence[TorqueRows]) -> Array:
    """Return what acted in all recordings (m,), N m; NaN in those without a reference."""
    return np.concatenate(
        [np.full(len(row.time), np.nan) if row.reference is None else row.reference for row in rows]
    )


def _judged(rows: TorqueRows, largest: float) -> tuple[dict[str, Quantity], Table]:
    """Return errors and coverage against the reference, which has no other use."""
    assert rows.reference is not None
    results: dict[str, Quantity] = {}
    columns = {
        "band": Column(
            np.array(LOAD_BAND_EDGES[:-1]) * largest, "N m", "lower end of the load's band"
        ),
        "state": Column(
            np.array([int(state) for state in JUDGED_STATES]), "1", "as in table force"
        ),
    }
    for prefix, torque, reference, half, states in (
        ("", rows.torque, rows.reference, rows.half, rows.states),
        (
            "causal_",
            rows.causal,
            rows.causal_reference,
            COVERAGE_FACTOR * rows.causal_u,
            rows.causal_states,
        ),
    ):
        if reference is None:
            continue  # there is no causal form
        known = states != State.OUTSIDE
        moving = known & (states != State.STILL) & ~rows.hidden
        error = np.where(known, torque - reference, np.nan)
        covered = np.abs(error) <= half
        overall, while_moving = (accuracy(error, covered, among) for among in (known, moving))
        why = "the deviation from the reference itself"
        results |= {
            f"{prefix}rmse": Quantity(overall.rmse, "N m", reason=why),
            f"{prefix}rmse_moving": Quantity(while_moving.rmse, "N m", reason=why),
            f"{prefix}coverage_95": Quantity(overall.coverage, "1", reason="counted"),
        }
        cells = by_band_and_state(error, covered, rows.reference, states, largest)
        columns |= _cells(prefix, cells)
    return results, Table(
        ("band", "state"), columns, "rmse", "torque against the reference, by load and state"
    )


def _bandwidth(responses: Sequence[Spectra]) -> dict[str, Quantity]:
    """Return up to which frequency the torque has the reference's amplitude; none unless known."""
    if not responses:
        return {}
    value, u = amplitude_bandwidth(responses)
    return {} if math.isnan(value) else {"bandwidth": Quantity(value, "Hz", u)}


def _cells(prefix: str, cells: list[list[Accuracy]]) -> dict[str, Column]:
    def values(name: str) -> Array:
        return np.array([[getattr(cell, name) for cell in row] for row in cells])

    return {
        f"{prefix}rmse": Column(values("rmse"), "N m", "root mean square of the error"),
        f"{prefix}bias": Column(values("bias"), "N m", "mean of the error"),
        f"{prefix}coverage_95": Column(values("coverage"), "1", "share within the 95 % interval"),
        f"{prefix}share": Column(values("share"), "1", "of the samples with a value"),
    }


def _events(parts: Sequence[tuple[int, TorqueRows]]) -> dict[str, Table]:
    """Return the table of contacts of numbered stretches; none without contacts.

    Contacts are found by samples so far. A torque that the whole recording does not distinguish
    from zero there is none.
    """
    found: list[tuple[float, ...]] = []
    for number, row in parts:
        known, step_time = row.states != State.OUTSIDE, row.step_time / row.every
        for contact in row.contacts:
            span = slice(contact.begin // row.every, contact.end // row.every + 1)
            torque, u = row.torque[span][known[span]], row.u[span][known[span]]
            if not len(torque):
                continue
            peak = _peak(torque, u)
            if abs(torque[peak]) <= COVERAGE_FACTOR * u[peak]:
                continue
            times = row.time[0] + step_time * np.array([contact.begin, contact.found, contact.end])
            found.append((number, *times, torque[peak], u[peak], torque.mean(), u.mean()))
    if not found:
        return {}
    numbers = np.array(found).T
    u_time = np.full(len(found), JUMP_WINDOW / math.sqrt(12))
    columns = {
        "event": Column(np.arange(len(found)), "1"),
        "recording": Column(numbers[0].astype(np.int32), "1", "of this run, in order"),
        "start": Column(numbers[1], "s", "bench clock, where the torque passes half of it"),
        "start_u": Column(u_time, "s", "standard uncertainty of start"),
        "found": Column(numbers[2], "s", "first time at which samples up to it show the contact"),
        "end": Column(
            numbers[3], "s", "bench clock, where the torque falls below half of its mean"
        ),
        "end_u": Column(u_time, "s", "standard uncertainty of end"),
        "peak": Column(numbers[4], "N m", "torque whose interval is farthest from zero"),
        "peak_u": Column(numbers[5], "N m", "standard uncertainty of peak"),
        "mean": Column(numbers[6], "N m", "mean torque from start to end"),
        "mean_u": Column(numbers[7], "N m", "standard uncertainty of mean"),
    }
    return {"events": Table(("event",), columns, "mean", "contacts found in the torque over time")}


def _contact_notes(limits: Array) -> list[str]:
    """State by which jumps contacts are found."""
    names = {
        MotionKind.STEADY: "in steady motion",
        MotionKind.REVERSED: "after reversals",
        MotionKind.STILL: "at rest",
    }
    jumps = limits[:, 0] * 1e3
    known = [f"{jumps[m]:.2g} mN m {names[m]}" for m in MotionKind if np.isfinite(jumps[m])]
    if not known:
        return ["contacts are not looked for: the tables hold no recordings without load"]
    without = [names[m] for m in MotionKind if np.isinf(limits[m, 1])]
    slow = (
        f"; contacts that come more slowly are not looked for {', '.join(without)}: too little was "
        "recorded without load, learn with more ilc_learn.loads.cycles"
        if without
        else ""
    )
    return [
        f"contacts are found by torques that rise within {JUMP_WINDOW * 1e3:.0f} ms by more than "
        f"{', '.join(known)}: the tables show such errors less than once in "
        f"{1 / max(map(sum, FALSE_ALARMS)) / 3600:.0f} h{slow}"
    ]


def _notes(
    recordings: Sequence[Recorded], known: NDArray[np.bool_], reach: Reach, scales: Array
) -> list[str]:
    low, high = reach.angle
    named = [*((s, STATE_NAMES[s]) for s in JUDGED_STATES), (CREEPING_KIND, "creeping")]
    factors = ", ".join(
        f"{name} {scales[s, 0]:.2f} and {100 * scales[s, 1]:.1f} %" for s, name in named
    )
    notes = [
        f"torque was learned up to {reach.torque * 1e3:.4g} mN m, from {low:.4g} to {high:.4g} rad "
        f"of the motor, up to {reach.speed:.4g} rad/s; outside there is no value",
        "u is the filter's deviation times a factor, and a share of the torque, as errors under "
        f"the known loads show: {factors}",
    ]
    if (outside := 1 - known.mean()) > 0:
        limit = any(part.limited for r in recordings for part in r.parts)
        why = ", or about a current at its limit" if limit else ""
        notes.append(
            f"no value in {100 * outside:.1f} % of the time: outside what was learned{why}"
        )
    if lost := sum(r.lost for r in recordings):
        notes.append(
            f"samples are missing or NaN: {lost:.3g} s have no value, and the filter begins anew "
            f"behind them (gaps between samples: {sum(r.breaks for r in recordings)})"
        )
    if limited := sum(part.limited for r in recordings for part in r.parts):
        notes.append(f"samples with a current at its limit: {limited}; no value there")
    return notes + [
        f"recording {r.name}: {fault.text}"
        for r in recordings
        for p in r.parts
        for fault in p.faults
        if fault.text
    ]
