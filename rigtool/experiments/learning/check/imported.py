"""`ilc-learn --check` on imported runs: the part a learned map would have removed, and its shift.

The runs were recorded without the map. Their torque is compared with the map order by order: what
would have been left with the map added, by which angle the map would have to be shifted, and by
which factor the torque is larger now.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rigtool.errors import InsufficientDataError, UsageError
from rigtool.experiments.imported import position_of, rotary_recordings
from rigtool.experiments.learning.learned_table import LearnedTable
from rigtool.experiments.learning.stored_table import learned_table_from
from rigtool.experiments.outcome import Outcome
from rigtool.experiments.ripple.imported_groups import (
    GROUP_SPEED_TOLERANCE,
    RepeatedRuns,
    groups_of,
    turns_of,
)
from rigtool.experiments.ripple.imported_maps import SAME_MAP_VARIANCE, SIGNIFICANT_SHIFT
from rigtool.experiments.ripple.imported_turns import fill, reduction
from rigtool.experiments.ripple.map_shift import match_maps
from rigtool.experiments.ripple.orders import (
    HIGHEST_ORDER,
    WAVEFORM_CELLS,
    Match,
    Spectrum,
    cell_centres,
    neighbours_floor,
    remove_offset,
    spectrum,
)
from rigtool.experiments.torque_per_ampere import effort_of
from rigtool.numerics.arrays import Array, ComplexArray
from rigtool.quantity import Quantity
from rigtool.runfile import Column, Recording, Run, Table, dof_column

Orders = ComplexArray

BLOCK_SAMPLES = 16384
"""Most samples of which all orders are held at a time."""

FITS_RESULT = "table_fits"
"""Result that states whether a table fits: 1 or 0."""


def analyse_imported(runs: Sequence[Run], *, tables: Run, kt: Run | None = None) -> Outcome:
    """Compare runs of one condition and speed with a learned map.

    Raises `UsageError` for runs of several conditions or speeds, or where the map has another unit;
    `InsufficientDataError` where it was learned at another speed.
    """
    recordings = rotary_recordings(runs, "that has no turns to compare")
    learned, effort = learned_table_from(tables), effort_of(recordings[0], kt)
    if effort.unit != learned.unit:
        raise UsageError(
            f"{tables.path} holds {learned.unit}, the runs hold {effort.unit}: learn and check "
            "both with --kt, or both without"
        )
    turns = [turns_of(recording, kt) for recording in recordings]
    groups = groups_of(recordings, turns)
    if len(groups) > 1:
        raise UsageError(
            f"the runs are of different conditions or speeds, {groups[0].label()} and "
            f"{groups[1].label()}: check one after the other"
        )
    torque = np.concatenate([here.torque for here in turns])
    found = _compare(groups[0], torque, learned, min(here.orders for here in turns))
    of_record = _of_record(recordings, kt, found.mapped)
    return Outcome(
        {
            **found.results(learned.unit, effort.name),
            "record_variance_removed": Quantity(
                of_record, "1", reason="the part of these records, noise and drift included"
            ),
        },
        {"held_out": found.table(learned.unit), "held_out_waveforms": found.waveforms(learned)},
        (
            *found.notes(groups[0]),
            f"that is of the mean over the turns and its orders up to {len(found.mapped)}; of the "
            "variance of the records, noise included, it would have removed "
            f"{100 * of_record:.1f} %",
        ),
    )


def _of_record(recordings: Sequence[Recording], kt: Run | None, mapped: Orders) -> float:
    """Return the part of the variance of all samples that the map, orders 1..m, removes."""
    order = np.arange(1, mapped.size + 1)
    before = after = 0.0
    for recording in recordings:
        torque, angle = effort_of(recording, kt).values, position_of(recording)
        parts = np.array_split(angle, 1 + angle.size // BLOCK_SAMPLES)
        turning = (np.exp(1j * np.multiply.outer(part, order)) @ mapped for part in parts)
        before += float(torque.var()) * torque.size
        after += float((torque - np.real(np.concatenate(list(turning)))).var()) * torque.size
    return 1 - after / before if before > 0 else 0.0


@dataclass(frozen=True, eq=False)
class _Compared:
    """A run against a map, orders 1..m: those of run, map, and remainder `left`.

    `noise` is the sum of squared amplitudes that scatter alone gives, 0 where nothing was repeated;
    `dof` the degrees of freedom of the noise floors, infinite where they are of the orders around.
    """

    shown: Spectrum
    mapped: Orders
    left: Spectrum
    match: Match
    waveform: Array
    mean_change: float
    mean_u: float | None
    noise: float
    dof: float

    @property
    def fits(self) -> bool:
        return self.left_part <= 1 - SAME_MAP_VARIANCE

    @property
    def shifted(self) -> bool:
        """Whether the run shows the same map, shifted."""
        certain = abs(self.match.shift) > SIGNIFICANT_SHIFT * self.match.shift_u
        return not self.fits and certain and self.match.best_correlation**2 >= SAME_MAP_VARIANCE

    @property
    def left_part(self) -> float:
        """Part of the variance beyond the scatter that the map would have left."""
        left, shown = (
            max(float(np.sum(each.amplitude**2)) - self.noise, 0.0)
            for each in (self.left, self.shown)
        )
        return left / max(shown, np.finfo(float).tiny)

    def results(self, unit: str, name: str) -> dict[str, Quantity]:
        """Return the part that the map would have removed, in all and by order, and its shift."""
        (before, before_u), (after, after_u) = self.shown.rms(), self.left.rms()
        ratio = after / before
        ratio_u = math.hypot(after_u / before, ratio * before_u / before)
        results = {
            FITS_RESULT: Quantity(
                float(self.fits), "1", reason="a verdict: 1 it fits, 0 it does not"
            ),
            "ripple_rms": Quantity(before, unit, before_u),
            "remaining_rms": Quantity(after, unit, after_u),
            "removed": Quantity(1 - ratio, "1", ratio_u),
            "table_shift": Quantity(self.match.shift, "rad", self.match.shift_u),
            "table_scale": Quantity(
                self.match.scale, "1", reason="one map and one run: no repeats to compare"
            ),
            f"mean_{name}_change": Quantity(
                self.mean_change,
                unit,
                self.mean_u,
                reason=None if self.mean_u is not None else "one turn: its scatter is not known",
            ),
        }
        removed, u = reduction(self.shown, self.left)
        for order in self.strongest():
            results[f"order_{order}_removed"] = Quantity(
                float(removed[order - 1]), "1", float(u[order - 1])
            )
        return results

    def strongest(self) -> list[int]:
        """Return the strongest orders of the map that the run shows, too."""
        strength = np.where(self.shown.clear, np.abs(self.mapped), 0.0)
        return self.shown.ranked(strength)

    def table(self, unit: str) -> Table:
        """Return all orders."""
        removed, u = reduction(self.shown, self.left)
        floor = "amplitude due to scatter alone"
        return Table(
            ("order",),
            {
                "order": Column(self.shown.order, "1", "cycles a turn"),
                "amplitude": Column(self.shown.amplitude, unit, "of the runs"),
                "noise_floor": Column(self.shown.noise_floor, unit, floor),
                "learned": Column(np.abs(self.mapped), unit, "of the map"),
                "remaining": Column(self.left.amplitude, unit, "had the map been added"),
                "remaining_noise_floor": Column(self.left.noise_floor, unit, floor),
                "removed": Column(removed, "1", "1 - remaining/amplitude"),
                "removed_u": Column(u, "1", "standard uncertainty"),
                "dof": dof_column(np.full(len(u), self.dof)),
            },
            "remaining",
            "part that a learned map would have removed, by order of rotation",
        )

    def waveforms(self, learned: LearnedTable) -> Table:
        """Return run, map and remainder around the turn."""
        angle = cell_centres(WAVEFORM_CELLS)
        order = np.arange(1, len(self.mapped) + 1)
        mapped = np.real(np.exp(1j * np.multiply.outer(angle, order)) @ self.mapped)
        return Table(
            ("position",),
            {
                "position": Column(angle, "rad", "of the rotor"),
                "ripple": Column(self.waveform, learned.unit, "of the runs, without its mean"),
                "learned": Column(mapped, learned.unit, "the map, without its mean"),
                "remaining": Column(self.waveform - mapped, learned.unit, "had it been added"),
            },
            "remaining",
            "mean of the turns against the map",
        )

    def notes(self, group: RepeatedRuns) -> tuple[str, ...]:
        """State in words whether the map still fits, and its changes."""
        match, removed = self.match, 1 - math.sqrt(self.left_part)
        turns, runs = (
            f"{n:.0f} {w}{'s' * (n > 1)}" for n, w in ((group.turns, "turn"), (group.runs, "run"))
        )
        head = f"{turns} of {runs} at {group.label()}: "
        degrees, u = math.degrees(match.shift), math.degrees(match.shift_u)
        if self.fits:
            verdict = f"the table fits: it would have removed {100 * removed:.1f} % of what repeats"
        elif self.shifted:
            left = math.sqrt(max(0.0, 1 - match.best_correlation**2))
            verdict = (
                f"the table does not fit: it is the same map, shifted by {degrees:.2f} +- {u:.2f} "
                f"deg; shifting it by that is enough, and leaves {100 * left:.1f} %: find what is "
                "not tied to the rotor, such as another index or another motor nearby"
            )
        else:
            verdict = (
                f"the table does not fit, and a shift is not enough: correlation "
                f"{match.correlation:.3f} as it is, {match.best_correlation:.3f} at best, shifted "
                f"by {degrees:.1f} deg: learn again"
            )
        return (head + verdict, "the map was not switched on: the remainder is computed")


def _compare(group: RepeatedRuns, torque: Array, learned: LearnedTable, orders: int) -> _Compared:
    """Compare turns (turns, positions), NaN where none passed, with the map of their speed."""
    mapped = _orders_of(learned, group.speed)[:orders]
    order = np.arange(1.0, mapped.size + 1)
    cells = np.exp(1j * np.multiply.outer(cell_centres(WAVEFORM_CELLS), order))
    # A cell has the mean over its width. Where a turn left cells out, the remainder is bridged, not
    # measured: it is smaller.
    expected = np.real(
        cells @ (mapped * np.sinc(order / WAVEFORM_CELLS) * group.sampling.gain(order))
    )
    remaining, _ = fill(torque - expected)
    means = remaining.mean(axis=1)
    shown = spectrum(remove_offset(remaining + expected, group.sampling), mapped.size)
    there = shown.amplitude * np.exp(1j * shown.phase)
    left = there - mapped
    # The rest is noise of the runs and of the map, or a change: neighbouring orders show the noise.
    floor = neighbours_floor(np.abs(left))
    noise = 0.0
    if len(remaining) > 1:
        noise = float(np.sum(shown.noise_floor**2))
        floor = np.maximum(shown.noise_floor, floor)
    shown = replace(shown, noise_floor=floor)
    return _Compared(
        shown,
        mapped,
        Spectrum(shown.order, np.abs(left), np.angle(left), floor),
        match_maps(mapped, there),
        remaining.mean(axis=0) + expected - means.mean(),
        float(means.mean()) - learned.table.torque[_row(learned, group.speed)].mean(),
        float(means.std(ddof=1)) / math.sqrt(means.size) if means.size > 1 else None,
        noise,
        2 * (len(remaining) - 1) or math.inf,
    )


def _row(learned: LearnedTable, speed: float) -> int:
    """Return the row that was learned at a speed, rad/s; a map is the same row at all speeds."""
    rows, torque = learned.table.speed, learned.table.torque
    nearest = int(np.argmin(np.abs(rows - speed)))
    if len(rows) > 1 and np.array_equal(torque, np.broadcast_to(torque[0], torque.shape)):
        return nearest
    if abs(rows[nearest] - speed) > GROUP_SPEED_TOLERANCE * abs(rows[nearest]):
        raise InsufficientDataError(
            f"the runs turn at {speed:.4g} rad/s, the nearest speed that was learned is "
            f"{rows[nearest]:.4g} rad/s: check at a speed that was learned"
        )
    return nearest


def _orders_of(learned: LearnedTable, speed: float) -> Orders:
    """Return the orders 1..m of the map at a speed, amplitude*exp(i phase)."""
    table = learned.table
    if table.period is None or not math.isclose(table.period, 2 * math.pi):
        raise UsageError("the table is not of a whole turn: imported runs are checked by that only")
    count = table.position.size
    orders = min(HIGHEST_ORDER, (count - 1) // 2)
    order = np.arange(1, orders + 1)
    found = np.fft.rfft(table.torque[_row(learned, speed)])[1 : orders + 1] * (2 / count)
    return found * np.exp(-1j * order * table.position[0])
