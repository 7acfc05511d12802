"""Torque over time as a run file stores it: tables `force` and `force_accuracy`, and results."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from statistics import NormalDist

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
from rigtool.experiments.force_filter.motion_states import STATE_NAMES, State, States
from rigtool.experiments.force_model.contacts import Contact
from rigtool.experiments.force_sensor.commanded_inertia import CommandedTurns
from rigtool.experiments.force_sensor.response import Spectra, amplitude_bandwidth
from rigtool.experiments.force_sensor.signal_faults import SignalFault
from rigtool.experiments.force_sensor.unknown_friction import Passes
from rigtool.experiments.force_sensor.unknown_inertia import Turns
from rigtool.numerics.arrays import Array, Mask, joined
from rigtool.quantity import Quantity
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
    `turns` show whether inertia is that of the tables. `faults` are those of the signals.
    `doubts` (m,) N2 m2 are what of u^2 another power-up's ripple makes."""

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
    commanded: CommandedTurns = field(default_factory=CommandedTurns)
    faults: tuple[SignalFault, ...] = ()
    doubts: Array = field(default_factory=lambda: np.empty(0))

    @property
    def hidden(self) -> Mask:
        """Where there is a dead band instead of an estimate (m,)."""
        return self.dead_bands & np.isin(self.states, (State.REVERSED, State.STILL))

    @property
    def half(self) -> Array:
        """Half of the 95 % interval, or of the dead band (m,), N m."""
        return np.where(self.hidden, math.sqrt(3), COVERAGE_FACTOR) * self.u

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
        references = "reference", "causal_reference"
        names = *FORCE_SIGNALS, *(one for one in references if getattr(first, one) is not None)
        together = dict(zip(names, joined(parts, *names), strict=True))
        return replace(first, **together, limited=sum(part.limited for part in parts))


def steps_of_a_row(step_time: float, corner_hz: float) -> int:
    """Return how many steps of `step_time` s are a row of the table."""
    return max(1, int((1 / step_time) / (ROWS_PER_PERIOD * corner_hz) * (1 + 1e-6)))


IS_CUT = "is a lower bound: beside a torque of half of it and more there is one without a value"

FORCE_SIGNALS = ("time", "torque", "u", "states", "causal", "causal_u", "causal_states")


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
    if "peak_torque" in results and _is_cut(rows, number, results["peak_torque"].value):
        results["peak_torque"] = Quantity(results["peak_torque"].value, "N m", reason=IS_CUT)
    tables = {"force": _table(rows, whole, known, number, corner_hz, load_arm)}
    judged = [row for row in rows if row.reference is not None]
    if any(row.reference is not None and np.isfinite(row.reference).any() for row in judged):
        found, tables["force_accuracy"] = _judged(TorqueRows.joined(judged), largest)
        results |= found | _bandwidth([row.response for row in judged if row.response is not None])
    return results, tables


def _results(whole: TorqueRows, known: Mask, read: float, lost: float) -> dict[str, Quantity]:
    share = float(known.mean()) * read / (read + lost)
    results = {"valid_share": Quantity(share, "1", reason="counted")}
    if known.any():
        torque, u = whole.torque[known], whole.u[known]
        largest, largest_u = peak(torque, u)
        results["peak_torque"] = Quantity(largest, "N m", largest_u)
        results["mean_torque"] = Quantity(float(torque.mean()), "N m", float(u.mean()))
    return results


def _is_cut(rows: Sequence[TorqueRows], number: NDArray[np.intp], highest: float) -> bool:
    """Return whether a torque of more than half of the peak, N m, is beside rows without a value,
    between other ones of its recording (`number`, of each row)."""
    ends = np.cumsum([len(row.time) for row in rows])
    torque, states = (
        np.insert(np.concatenate([getattr(row, name) for row in rows]), ends, fill)
        for name, fill in (("torque", 0.0), ("states", State.OUTSIDE))
    )
    number = np.insert(number, ends, number[ends - 1])
    place = np.flatnonzero(states != State.OUTSIDE)
    high = np.abs(torque[place]) > abs(highest) / 2
    apart = (np.diff(place) > 1) & (np.diff(number[place]) == 0)
    return bool((apart & (high[1:] | high[:-1])).any())


def peak(torque: Array, u: Array) -> tuple[float, float]:
    """Return the peak of a torque (m,) of u (m,), and its standard uncertainty; N m.

    The peak is the torque M whose 95 % interval is farthest from zero: the largest torque alone may
    be that of a row of large u, such as the last ones. Two things are open besides u of that row:

        u_p^2 = u^2 (1 + e_n^2) + (max|torque| - |M|)^2 / 3,    e_n = Phi^-1((n - 3/8) / (n + 1/4))

    Of n maxima whose intervals hold M, which may all be alike, the one with the largest error is
    taken: the largest of n normal errors is e_n u on average (G. Blom, Statistical Estimates and
    Transformed Beta-Variables, 1958), one of them alone is not biased. The torque may have been as
    large as the largest one, in a row of larger u: a rectangle (GUM 4.3.7).
    """
    size = np.abs(torque)
    row = int(np.argmax(size - COVERAGE_FACTOR * u))
    beside = np.pad(size, 1, constant_values=-np.inf)
    maximum = (size >= beside[:-2]) & (size > beside[2:])
    alike = int(np.count_nonzero(maximum & (size + COVERAGE_FACTOR * u >= size[row])))
    largest = NormalDist().inv_cdf((max(alike, 1) - 3 / 8) / (max(alike, 1) + 1 / 4))
    variance = u[row] ** 2 * (1 + largest**2) + (size.max() - size[row]) ** 2 / 3
    return float(torque[row]), math.sqrt(variance)


def _table(
    rows: Sequence[TorqueRows],
    whole: TorqueRows,
    known: Mask,
    number: NDArray[np.intp],
    corner_hz: float,
    load_arm: float | None,
) -> Table:
    def valid(values: Array, where: Mask = known) -> Array:
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
        "state": Column([int(state) for state in JUDGED_STATES], "1", "as in table force"),
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
        found = {
            f"{prefix}rmse": Quantity(overall.rmse, "N m", reason=why),
            f"{prefix}rmse_moving": Quantity(while_moving.rmse, "N m", reason=why),
            f"{prefix}coverage_95": Quantity(overall.coverage, "1", reason="counted"),
        }
        # none where nothing moves, or no reference is known
        results |= {name: one for name, one in found.items() if math.isfinite(one.value)}
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
