"""`ilc-learn` on imported runs: a map by position, learned from the torque of another rig's motor.

The torque of a motor that turns slowly and steadily is that of its friction and cogging. The part
that repeats from turn to turn is learned: its mean, and the orders of rotation that exceed the
scatter. Everything is a function of the measured position: there is no set point.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rigtool.control.lookup_table import LookupTable
from rigtool.errors import InsufficientDataError, UsageError
from rigtool.experiments.imported import rotary_recordings
from rigtool.experiments.learning.rows import Amplitudes
from rigtool.experiments.learning.stored_table import period_results, tables_of
from rigtool.experiments.outcome import Outcome
from rigtool.experiments.ripple.imported_groups import RepeatedRuns, groups_of, turns_of
from rigtool.experiments.ripple.imported_maps import SAME_MAP_VARIANCE, read_maps
from rigtool.experiments.ripple.orders import (
    NEIGHBOURING_ORDERS,
    Spectrum,
    coefficients,
    neighbours_floor,
    remove_offset,
    spectrum,
)
from rigtool.experiments.torque_per_ampere import effort_of
from rigtool.numerics.arrays import Array
from rigtool.quantity import Quantity, scattered
from rigtool.runfile import Run, Table
from rigtool.runfile.schema import MAP

MAP_POSITIONS = 2000
"""Positions of a learned map: twenty to a cycle of the highest order."""


def analyse_imported(runs: Sequence[Run], *, kt: Run | None = None) -> Outcome:
    """Learn a map of the turn from runs under one condition; a row for each speed.

    Raises `UsageError` for runs under several conditions, `InsufficientDataError` where no turn is
    repeated or nothing exceeds the scatter.
    """
    if all(MAP in run.tables for run in runs):
        return _learn_maps(runs)
    recordings = rotary_recordings(runs, "that has no turns to learn")
    effort = effort_of(recordings[0], kt)
    turns = [turns_of(recording, kt) for recording in recordings]
    groups = sorted(groups_of(recordings, turns), key=lambda group: group.speed)
    _require_one_condition(groups)
    rows = [_learn(group) for group in groups]
    table = _table_of(rows, np.array([group.speed for group in groups]))
    notes = [
        f"learned from {group.turns:.0f} turns of {group.runs} runs at {group.label()}: orders "
        f"{row.listed()}"
        for group, row in zip(groups, rows, strict=True)
    ]
    notes.append(
        f"learned is the {effort.origin}, by measured position; below the lowest "
        "speed, where nothing was measured, it fades to zero at rest"
    )
    tables = _tables(rows, table, effort.name, effort.unit)
    return Outcome(_results(rows, table, effort.unit), tables, tuple(notes))


def _table_of(rows: Sequence[_Row], speed: Array) -> LookupTable:
    """Return the table of rows at their speeds (rows,), rad/s."""
    position: Array = np.arange(float(MAP_POSITIONS)) * (2 * math.pi / MAP_POSITIONS)
    return LookupTable(
        position=position,
        speed=speed,
        torque=np.stack([row.at(position) for row in rows]),
        low_speed=np.array([0.0, float(np.abs(speed).min())]),
        amplitude=np.array([0.0, 1.0]),
        period=2 * math.pi,
    )


def _require_one_condition(groups: Sequence[RepeatedRuns]) -> None:
    first = groups[0].conditions
    for group in groups[1:]:
        if group.conditions != first:
            raise UsageError(
                f"the runs are of different conditions, {groups[0].label()} and {group.label()}: "
                "give those of one condition"
            )


MAP_SPEED = 0.1
"""Lowest speed at which the table of a map holds, rad/s: below it fades to zero at rest."""

BY_CHANCE = 0.01
"""Probability at which the strongest order of mere noise would count as learned."""


@dataclass(frozen=True, eq=False)
class _Row:
    """Repeatable part at one speed: mean and `orders` (k,), with the scatter behind u.

    `mean_u` and `non_repeatable` are None where nothing was repeated.
    """

    orders: Spectrum
    dof: float
    mean: float
    mean_u: float | None
    non_repeatable: float | None
    examined: int

    @classmethod
    def of(cls, found: Spectrum, means: Array, scatter: float | None) -> _Row:
        """Return the orders of a spectrum above its noise floor; `means` (n,) of the repeats."""
        repeats = means.size
        return cls(
            found.only(found.clear),
            2.0 * (repeats - 1) if repeats > 1 else 4.0 * NEIGHBOURING_ORDERS,
            float(means.mean()),
            float(means.std(ddof=1)) / math.sqrt(repeats) if repeats > 1 else None,
            scatter,
            len(found.order),
        )

    def at(self, position: Array) -> Array:
        """Return mean and orders at positions (n,), rad."""
        angles = np.multiply.outer(position, self.orders.order) + self.orders.phase
        return self.mean + np.cos(angles) @ self.orders.amplitude

    @property
    def u(self) -> float:
        """Standard uncertainty at any position: of the mean, and of the orders together."""
        return math.hypot(
            self.mean_u or 0.0, float(np.linalg.norm(self.orders.noise_floor)) / math.sqrt(2)
        )

    @property
    def u_dof(self) -> float:
        """Degrees of freedom of `u`, by Welch and Satterthwaite (GUM G.4.1)."""
        orders = float(np.sum(self.orders.noise_floor**4)) / 4 / self.dof
        return self.u**4 / ((self.mean_u or 0.0) ** 4 / (self.dof / 2) + orders)

    def listed(self) -> str:
        """Return the strongest orders, and how many were learned, as text."""
        strongest = ", ".join(map(str, self.orders.ranked()))
        return f"{strongest}, {self.orders.order.size} of {self.examined} in all"


def _steadied(floor: Array) -> Array:
    """Return noise floors (m,) of which none is smaller than the rms of those around it.

    Few turns estimate the scatter of an order badly: with two turns, one order of pure noise in
    five shows less than half the scatter that corresponds to its amplitude.
    """
    window = np.ones(2 * NEIGHBOURING_ORDERS + 1)
    here = slice(NEIGHBOURING_ORDERS, NEIGHBOURING_ORDERS + floor.size)
    around = (np.convolve(floor**2, window) / np.convolve(floor**0, window))[here]
    return np.maximum(floor, np.sqrt(around))


def _learn(group: RepeatedRuns) -> _Row:
    if len(group.torque) < 2:
        raise InsufficientDataError(
            f"one turn at {group.label()} does not separate the repeatable part from the rest: "
            "give two runs or more, or record more turns"
        )
    turns = len(group.torque)
    shown = spectrum(remove_offset(group.torque, group.sampling), group.orders)
    found = coefficients(group.torque, group.orders, group.sampling)
    deviation = np.abs(found - found.mean(axis=0)) ** 2
    # A row of several turns has less of it by their number.
    per_row = group.turns / turns
    scatter = math.sqrt(per_row * float(deviation.sum()) / (turns - 1) / 2)
    means = group.torque.mean(axis=1)
    # Of what may be a higher order's, all or nothing, the standard uncertainty is 1/sqrt(3).
    by_alias = math.sqrt(2 / 3) * group.leak * shown.amplitude
    floor = np.hypot(_steadied(shown.noise_floor), by_alias)
    return _known(_Row.of(replace(shown, noise_floor=floor), means, scatter), group.label())


def _known(row: _Row, where: str) -> _Row:
    """Return a row with something to learn; raises `InsufficientDataError` without."""
    # Noise alone passes x floors with probability exp(-x^2) at each order (Rayleigh).
    by_chance = math.sqrt(math.log(row.examined / BY_CHANCE))
    if not (row.orders.amplitude > by_chance * row.orders.noise_floor).any():
        raise InsufficientDataError(
            f"no order of rotation exceeds the scatter at {where}: there is nothing to learn, or "
            "too few turns"
        )
    return row


def _learn_maps(runs: Sequence[Run]) -> Outcome:
    """Learn from maps around the turn, without time or speed: the orders of their mean.

    Raises `InsufficientDataError` for maps that are not the same.
    """
    maps = read_maps(runs)
    for number, match in enumerate(maps.matches):
        if match.correlation**2 < SAME_MAP_VARIANCE:
            raise InsufficientDataError(
                f"{runs[number].path} is another map than {runs[maps.reference].path} "
                f"(correlation {match.correlation:.3f} at equal angles): see fft-ripple, and give "
                "maps of one condition"
            )
    count, mean = len(maps.orders), maps.orders.mean(axis=0)
    amplitude = np.abs(mean)
    if count > 1:
        power = np.sum(np.abs(maps.orders - mean) ** 2, axis=0) / (count - 1)
        floor, scatter = _steadied(np.sqrt(power / count)), math.sqrt(float(power.sum()) / 2)
    else:
        floor, scatter = neighbours_floor(amplitude), None
    order = np.arange(1.0, mean.size + 1)
    found = Spectrum(order, amplitude, np.angle(mean), floor)
    row = _known(_Row.of(found, maps.means, scatter), "a map")
    table = _table_of([row], np.array([MAP_SPEED]))
    # A map that was taken at rest or slowly holds in both directions.
    table = replace(
        table, speed=np.array([-MAP_SPEED, MAP_SPEED]), torque=np.repeat(table.torque, 2, 0)
    )
    notes = [
        f"learned from {count} map{'s' * (count > 1)}: orders {row.listed()}",
        f"a map states no speed: its table holds from {MAP_SPEED:g} rad/s on, in both directions",
    ]
    if count == 1:
        notes.append(
            "one map shows no repeatable part: the noise of an order is taken from those around it"
        )
    tables = _tables([row, row], table, maps.signal, maps.unit)
    return Outcome(_results([row], table, maps.unit), tables, tuple(notes))


def _results(rows: Sequence[_Row], table: LookupTable, unit: str) -> dict[str, Quantity]:
    """Return ripple, non-repeatable part, and the strongest orders, of the lowest speed."""
    row = rows[int(np.argmin(np.abs(table.speed)))]
    rms, u = row.orders.rms()
    results = {"learned_rms": scattered(rms, unit, u, row.dof)}
    if row.non_repeatable is not None:
        scatter_u = row.non_repeatable / math.sqrt(2 * row.dof)
        results["non_repeatable_rms"] = scattered(row.non_repeatable, unit, scatter_u, row.dof)
    reason = None if row.mean_u is not None else "nothing was repeated"
    dof = None if row.mean_u is None else row.dof / 2
    results["learned_mean"] = Quantity(row.mean, unit, row.mean_u, dof, reason)
    for order in row.orders.ranked():
        one = row.orders.only(row.orders.order == order)
        results[f"order_{order}_amplitude"] = scattered(
            float(one.amplitude[0]), unit, float(one.u[0]), row.dof
        )
    return {**results, **period_results(table)}


def _tables(rows: Sequence[_Row], table: LookupTable, name: str, unit: str) -> dict[str, Table]:
    """Return the learned tables; they fade to zero at rest, as no lower speed was recorded."""
    fading = Amplitudes.fading(float(table.low_speed[-1]))
    u = np.repeat([[row.u] for row in rows], MAP_POSITIONS, axis=1)
    dof = np.array([row.u_dof for row in rows])
    return tables_of(table, u, fading, dof, (name, unit), measured=True)
