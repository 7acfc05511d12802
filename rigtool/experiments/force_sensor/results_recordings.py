"""Outcome of a run that reads torque over time: its tables, contacts found, and what to know."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rigtool.experiments.force_filter.accuracy import COVERAGE_FACTOR, JUDGED_STATES
from rigtool.experiments.force_filter.motion_states import (
    CREEPING_KIND,
    LIMIT_TIME,
    STATE_NAMES,
    Reach,
    State,
)
from rigtool.experiments.force_model.contacts import (
    FALSE_ALARMS,
    JUMP_WINDOW,
    MotionKind,
)
from rigtool.experiments.force_model.intervals import SHOWN_FACTOR
from rigtool.experiments.force_model.model import ROTOR_ORDERS
from rigtool.experiments.force_model.steps import HELD_TIME
from rigtool.experiments.force_sensor.events import LET_GO_TIME, UNSEEN, events
from rigtool.experiments.force_sensor.results_over_time import (
    TorqueRows,
    over_time_tables,
    peak,
)
from rigtool.experiments.outcome import Outcome
from rigtool.numerics.arrays import Array, Mask
from rigtool.quantity import Quantity
from rigtool.recipe import Recipe
from rigtool.runfile import Column, Table

CUT = ", infinite where the torque beside has no value: a bound"
LACKS = ", infinite where a torque between has no value"


@dataclass(frozen=True, eq=False)
class Recorded:
    """A recording by its stretches without gaps; `breaks` are between them, and `lost` s have no
    torque: gaps, samples that are NaN, stretches that are too short. In `held` samples current and
    temperature are those of the one before."""

    name: str
    parts: tuple[TorqueRows, ...]
    breaks: int
    lost: float
    held: int = 0


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
    found = _events(parts) if np.isfinite(limits).any() else {}
    peaks_u = found["events"]["peak_u"] if found else np.empty(0)
    if np.isfinite(limits).any():
        tables |= found
        results["contacts"] = Quantity(float(len(peaks_u)), "1", reason="counted")
    known = tables["force"]["state"] != State.OUTSIDE
    notes = [*_notes(recordings, known, reach, scales), *_contact_notes(limits)]
    if cut := np.count_nonzero(np.isinf(peaks_u)):
        notes.append(
            f"contacts that last where the torque has no value, or the recording ends: {cut}; what "
            "they did there is unknown, and u of that infinite"
        )
    return Outcome(results, tables, tuple(notes))


def _events(parts: Sequence[tuple[int, TorqueRows]]) -> dict[str, Table]:
    """Return the table of contacts of numbered stretches; none without contacts."""
    found: list[tuple[float, ...]] = []
    for number, row in parts:
        known = row.states != State.OUTSIDE
        for event in events(row):
            rows = event.rows.start + np.flatnonzero(known[event.rows])
            torque, u = row.torque[rows], row.u[rows]
            cut_begin, cut_end, lacks = _cut(known, rows)
            rms = float(np.sqrt(np.mean(torque**2)))
            clear = torque[np.abs(torque) > COVERAGE_FACTOR * u]
            waves = 1 + int(np.count_nonzero(np.diff(np.sign(clear))))
            seen = math.nan if event.found == UNSEEN else event.found / row.every
            times = row.time[0] + row.step_time * np.array([event.start[0], seen, event.end[0]])
            times_u = row.step_time * np.array([event.start[1] + cut_begin, event.end[1] + cut_end])
            largest, largest_u = peak(torque, u)
            peaks = largest, largest_u + cut_begin + cut_end + lacks
            means = torque.mean(), u.mean() + lacks, rms, np.mean(np.abs(torque) * u) / rms + lacks
            found.append((number, *times, *times_u, *peaks, *means, waves))
    if not found:
        return {}
    numbers = np.array(found).T
    columns = {
        "event": Column(np.arange(len(found)), "1"),
        "recording": Column(numbers[0].astype(np.int32), "1", "of this run, in order"),
        "start": Column(numbers[1], "s", "bench clock, where the torque passes half of it"),
        "start_u": Column(numbers[4], "s", f"standard uncertainty of start{CUT}"),
        "found": Column(numbers[2], "s", "first time at which samples up to it show it, NaN: none"),
        "end": Column(
            numbers[3], "s", "bench clock, where the torque falls below half of its mean"
        ),
        "end_u": Column(numbers[5], "s", f"standard uncertainty of end{CUT}"),
        "peak": Column(numbers[6], "N m", "torque whose interval is farthest from zero"),
        "peak_u": Column(numbers[7], "N m", f"standard uncertainty of peak{CUT}"),
        "mean": Column(numbers[8], "N m", "mean of the known torque from start to end"),
        "mean_u": Column(numbers[9], "N m", f"standard uncertainty of mean{LACKS}"),
        "rms": Column(numbers[10], "N m", "root mean square of the known torque, same span"),
        "rms_u": Column(numbers[11], "N m", f"standard uncertainty of rms{LACKS}"),
        "half_waves": Column(
            numbers[12].astype(np.int32), "1", "two in a period of a force that swings, else 1"
        ),
    }
    return {"events": Table(("event",), columns, "mean", "contacts found in the torque over time")}


def _cut(known: Mask, rows: NDArray[np.intp]) -> tuple[float, float, float]:
    """Return what is added to the u of an event's start, of its end, and of its mean, from its
    known rows: infinity where it may go on before the first or behind the last one, and where the
    rows between have no value, else 0."""
    around = np.pad(known, 1, constant_values=False)
    cuts = not around[rows[0]], not around[rows[-1] + 2], rows[-1] - rows[0] >= len(rows)
    begin, end, lacks = np.where(cuts, np.inf, 0.0)
    return begin, end, lacks


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
        f"{1 / max(map(sum, FALSE_ALARMS)) / 3600:.0f} h{slow}; and where twice the interval of "
        f"the whole recording does not hold zero for {LET_GO_TIME:g} s"
    ]


def _doubt_notes(parts: Sequence[TorqueRows]) -> list[str]:
    """State the ripple of this power-up where its doubt makes most of u^2, in the mean."""
    given = [(part, part.states != State.OUTSIDE) for part in parts if len(part.doubts)]
    if not sum(np.count_nonzero(known) for _, known in given):
        return []
    whole = float(np.concatenate([part.u[known] ** 2 for part, known in given]).mean())
    doubt = float(np.concatenate([part.doubts[known] for part, known in given]).mean())
    if doubt <= whole / 2:
        return []
    return [
        f"the ripple of this power-up stays in doubt: {math.sqrt(doubt) * 1e3:.2g} mN m of the "
        f"{math.sqrt(whole) * 1e3:.2g} mN m of u (root mean squares) stand for it; it shows where "
        "the rotor slides for seconds and nothing touches, and errors that look like contacts hide "
        f"it, as does ripple of orders above {ROTOR_ORDERS[-1]}"
    ]


def _notes(recordings: Sequence[Recorded], known: Mask, reach: Reach, scales: Array) -> list[str]:
    low, high = reach.angle
    named = [*((s, STATE_NAMES[s]) for s in JUDGED_STATES), (CREEPING_KIND, "creeping")]
    factors = ", ".join(
        f"{name} {scales[s, 0]:.2f} and {100 * scales[s, 1]:.1f} %" for s, name in named
    )
    notes = [
        f"torque was learned up to {reach.torque * 1e3:.4g} mN m, from {low:.4g} to {high:.4g} rad "
        f"of the motor, up to {reach.speed:.4g} rad/s; outside there is no value",
        "u is the filter's deviation times a factor, and a share of the torque, as errors under "
        f"the known loads show: {factors}; the factor of a torque that shows is {SHOWN_FACTOR} at "
        "least",
    ]
    if (outside := 1 - known.mean()) > 0:
        limit = any(part.limited for r in recordings for part in r.parts)
        why = ", about a current at its limit" if limit else ""
        notes.append(
            f"no value in {100 * outside:.3g} % of the time: outside what was learned{why}, or "
            f"within {LIMIT_TIME:g} s behind a begin"
        )
    if lost := sum(r.lost for r in recordings):
        notes.append(
            f"samples are missing or NaN: {lost:.3g} s have no value, and the filter begins anew "
            f"behind them (gaps between samples: {sum(r.breaks for r in recordings)})"
        )
    if held := sum(r.held for r in recordings):
        notes.append(
            f"current or temperature is NaN in {held} samples that are taken for the one before: "
            f"{HELD_TIME * 1e3:g} ms at most, what lasts longer is a gap"
        )
    if limited := sum(part.limited for r in recordings for part in r.parts):
        notes.append(f"samples with a current at its limit: {limited}; no value there")
    notes += _doubt_notes([part for r in recordings for part in r.parts])
    return notes + [
        f"recording {r.name}: {fault.text}"
        for r in recordings
        for p in r.parts
        for fault in p.faults
        if fault.text
    ]
