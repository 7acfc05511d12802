"""`fft-ripple` on imported runs: orders of rotation, the effect of compensation, maps compared.

A slowly turning motor needs the current that overcomes its cogging, whether the controller or a
table provides it. So both ripples are reported: that of the current, and that of the motion, which
compensation is meant to reduce.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from rigtool.errors import InsufficientDataError, UsageError
from rigtool.experiments.imported import place, rotary_recordings
from rigtool.experiments.outcome import Outcome
from rigtool.experiments.ripple.imported_groups import (
    GROUP_SPEED_TOLERANCE,
    SAME_SETPOINT,
    RepeatedRuns,
    cells_for,
    groups_of,
    ripple_effort,
    turns_of,
)
from rigtool.experiments.ripple.imported_maps import compare_maps
from rigtool.experiments.ripple.imported_turns import Turns, reduction
from rigtool.experiments.ripple.orders import HIGHEST_ORDER, cell_centres, remove_offset, spectrum
from rigtool.experiments.torque_per_ampere import Effort
from rigtool.quantity import Quantity
from rigtool.runfile import Column, Recording, Run, Table, dof_column
from rigtool.runfile.importers.convert import irregular
from rigtool.runfile.schema import IMPORTED, MAP

NEAR_SPEED = 0.3
"""Runs whose speeds differ by less than this part may have been meant as one speed."""

ALIASES_SHOWN = 6
"""Pairs of orders that a note lists."""


def analyse_imported(runs: Sequence[Run], *, kt: Run | None = None) -> Outcome:
    """Find the orders of each condition and compare conditions; or compare maps.

    Raises `UsageError` for maps and recordings together, and for a linear axis.
    """
    maps = [MAP in run.tables for run in runs]
    if all(maps):
        return compare_maps(runs)
    if any(maps):
        raise UsageError("maps and recordings cannot be analysed together: give one kind")
    recordings = rotary_recordings(runs, "that has no turns to lay over")
    effort = ripple_effort(recordings[0], kt)
    positions = cells_for(recordings)
    recordings, turns, left_out = _turning(recordings, kt, positions)
    groups = groups_of(recordings, turns)
    orders = min(group.orders for group in groups)
    for group in groups:
        for name, turned in (("torque", group.torque), ("deviation", group.deviation)):
            group.spectra[name] = spectrum(remove_offset(turned, group.sampling), orders)
    pairs = _pairs(groups)
    tables = {"imported_spectrum": _spectrum_table(groups, effort.unit)}
    tables["imported_waveforms"] = _waveform_table(groups, effort.unit)
    if pairs:
        tables["reduction"] = _reduction_table(pairs, orders)
    notes = [f"torque ripple is that of the {effort.origin}"]
    if any(irregular(np.diff(recording.read("time"))) for recording in recordings):
        notes.append("the irregular time axis: each cell of the turn has the mean over time")
    if left_out:
        notes.append(f"parts of a file without a turn were left out: {', '.join(left_out)}")
    notes += _notes(groups, pairs, turns, orders, effort.name)
    return Outcome(_results(groups, pairs, effort), tables, tuple(notes))


def _turning(
    recordings: Sequence[Recording], kt: Run | None, positions: int
) -> tuple[list[Recording], list[Turns], list[str]]:
    """Return the recordings that hold turns, these turns, and the parts of files without any.

    Raises `InsufficientDataError` where a whole file, or all parts, hold none.
    """
    turning, turns, left_out = [], [], []
    for recording in recordings:
        try:
            turns.append(turns_of(recording, kt, positions))
            turning.append(recording)
        except InsufficientDataError:
            left_out.append(place(recording))
            if recording.name == IMPORTED or len(left_out) == len(recordings):
                raise
    return turning, turns, left_out


def _pairs(groups: Sequence[RepeatedRuns]) -> list[tuple[RepeatedRuns, RepeatedRuns, str]]:
    """Return pairs of groups that differ in one condition: reference (the lower), other, name."""
    pairs = []
    for low in groups:
        for high in groups:
            names = low.conditions.keys() | high.conditions.keys()
            differing = [n for n in names if low.conditions.get(n) != high.conditions.get(n)]
            if len(differing) != 1 or not _same_speed(low, high):
                continue
            (name,) = differing
            if low.conditions.get(name, math.nan) < high.conditions.get(name, math.nan):
                pairs.append((low, high, name))
    return sorted(pairs, key=_rank)


def _same_speed(low: RepeatedRuns, high: RepeatedRuns) -> bool:
    """Return whether groups were to turn at one speed: by set point where both have one."""
    if low.setpoint is not None and high.setpoint is not None:
        return math.isclose(low.setpoint, high.setpoint, rel_tol=SAME_SETPOINT)
    return abs(low.speed - high.speed) <= GROUP_SPEED_TOLERANCE * abs(low.speed)


def _rank(pair: tuple[RepeatedRuns, RepeatedRuns, str]) -> tuple[float, float, float]:
    """Order pairs: most turns, then the first condition of the mapping, the others off."""
    low, high, name = pair
    turns = min(len(low.torque), len(high.torque))
    others = sum(abs(value) for key, value in low.conditions.items() if key != name)
    return -turns, list(high.conditions).index(name), others


def _strongest(group: RepeatedRuns) -> list[int]:
    """Return the significant orders, the strongest first."""
    found = group.spectra["torque"]
    return found.ranked(np.where(group.clear(), found.amplitude, 0.0))


def _results(
    groups: Sequence[RepeatedRuns],
    pairs: Sequence[tuple[RepeatedRuns, RepeatedRuns, str]],
    effort: Effort,
) -> dict[str, Quantity]:
    """Return the strongest orders of the reference, and their reduction."""
    reference = _reference(groups, pairs)
    orders = reference.spectra["torque"]
    strongest = orders.strongest()
    results = {"strongest_order": Quantity(float(strongest), "1", reason="a whole number")}
    dof = 2.0 * (len(reference.torque) - 1) or None
    reported = _strongest(reference)
    for order in reported:
        i = order - 1
        results[f"order_{order}_amplitude"] = Quantity(
            float(orders.amplitude[i]),
            effort.unit,
            float(reference.u[i]),
            dof if reference.leak[i] == 0 else None,
        )
    if not pairs:
        return results
    for quantity, name in (("deviation", "motion"), ("torque", effort.name)):
        values, u = reduction(pairs[0][0].spectra[quantity], pairs[0][1].spectra[quantity])
        for order in reported:
            if math.isfinite(values[order - 1]):
                results[f"order_{order}_{name}_reduction"] = Quantity(
                    float(values[order - 1]), "1", float(u[order - 1])
                )
    return results


def _reference(
    groups: Sequence[RepeatedRuns], pairs: Sequence[tuple[RepeatedRuns, RepeatedRuns, str]]
) -> RepeatedRuns:
    """Return the group that the results are of."""
    return pairs[0][0] if pairs else max(groups, key=lambda group: len(group.torque))


def _notes(
    groups: Sequence[RepeatedRuns],
    pairs: Sequence[tuple[RepeatedRuns, RepeatedRuns, str]],
    turns: Sequence[Turns],
    orders: int,
    name: str,
) -> list[str]:
    notes = []
    settled = max(here.settled for here in turns)
    if settled > 0:
        notes.append(f"settling was left out at the start, up to {settled:.2g} s of a run")
    if orders < HIGHEST_ORDER:
        notes.append(f"the samples around the turn resolve orders up to {orders}")
    for number, group in enumerate(groups):
        strongest = ", ".join(map(str, _strongest(group))) or "none"
        turned = f"{group.runs} run{'s' if group.runs > 1 else ''}, "
        turned += f"{group.turns:.0f} turn{'s' if group.turns > 1 else ''}"
        notes.append(f"group {number} ({group.label()}; {turned}): strongest orders {strongest}")
        if len(group.torque) == 1:
            notes.append(
                f"group {number} is one turn, so the repeatable part is unknown: the noise of an "
                "order is taken from the orders around it"
            )
        notes += _alias_notes(number, group)
    if len(groups) > 1:
        notes.append(f"the results are of group {groups.index(_reference(groups, pairs))}")
    notes += _unpaired(groups)
    for number, (low, high, condition) in enumerate(pairs):
        notes.append(
            f"pair {number}: {condition} {high.conditions[condition]:g} against "
            f"{low.conditions[condition]:g}, group {groups.index(high)} against "
            f"{groups.index(low)}: {_reduction_text(low, high, name)}"
        )
    return notes


def _alias_notes(number: int, group: RepeatedRuns) -> list[str]:
    """Return which orders of a group the samples do not separate; and of a stated speed."""
    notes = []
    if not group.moved:
        notes.append(
            f"group {number}: the speed was stated; refined by the orders of the torque it is "
            f"{group.speed:.6g} rad/s; there is no ripple of the motion"
        )
    if (group.leak > 0).any():
        one = np.flatnonzero(group.leak > 0)
        shown = ", ".join(f"{i + 1} from {group.alias[i]:.0f}" for i in one[:ALIASES_SHOWN])
        more = f" and {len(one) - ALIASES_SHOWN} more" if len(one) > ALIASES_SHOWN else ""
        notes.append(
            f"group {number}: its samples meet the same angles in each turn, so that orders are "
            f"not separated: {shown}{more}; u of a lower order includes that all of its amplitude "
            "is the higher order's; sample at a rate that is no multiple of the speed"
        )
    return notes


def _reduction_text(low: RepeatedRuns, high: RepeatedRuns, name: str) -> str:
    """Return the reductions of the strongest orders as text."""
    texts = []
    for quantity, what in (("deviation", "motion"), ("torque", name)):
        values, _ = reduction(low.spectra[quantity], high.spectra[quantity])
        factors = [
            f"{order}: {1 - values[order - 1]:.3g}"
            for order in _strongest(low)
            if math.isfinite(values[order - 1])
        ]
        texts.append(f"ripple of the {what} times, order by order, {', '.join(factors)}")
    return "; ".join(texts)


def _unpaired(groups: Sequence[RepeatedRuns]) -> list[str]:
    """Return why groups that differ in one condition are not compared."""
    return [
        f"groups {first} and {second} are not compared: they turn at {low.speed:.4g} and "
        f"{high.speed:.4g} rad/s, and nothing shows that one speed was asked for (speed_setpoint)"
        for first, low in enumerate(groups)
        for second, high in enumerate(groups[first + 1 :], start=first + 1)
        if sum(
            low.conditions.get(n) != high.conditions.get(n)
            for n in {*low.conditions, *high.conditions}
        )
        == 1
        and not _same_speed(low, high)
        and abs(low.speed - high.speed) < NEAR_SPEED * abs(low.speed)
    ]


def _spectrum_table(groups: Sequence[RepeatedRuns], unit: str) -> Table:
    first = groups[0].spectra["torque"]

    def column(quantity: str, name: str, of: str, what: str) -> Column:
        values = [
            getattr(group.spectra[quantity], name) * (group.moved or quantity == "torque" or np.nan)
            for group in groups
        ]
        return Column(values, of, what)

    floor = "amplitude that scatter alone would show"
    return Table(
        ("group", "order"),
        {
            **_group_columns(groups),
            "order": Column(first.order, "1", "cycles a turn"),
            "amplitude": column("torque", "amplitude", unit, "of torque or current"),
            "phase": column("torque", "phase", "rad", "amplitude*cos(order*angle + phase)"),
            "noise_floor": column("torque", "noise_floor", unit, floor),
            "u": Column([group.u for group in groups], unit, "standard, of amplitude"),
            "dof": dof_column([group.dof for group in groups]),
            "alias": Column(
                [group.alias[: len(first.order)] for group in groups],
                "1",
                "higher order that the samples do not separate, if any",
            ),
            "deviation": column("deviation", "amplitude", "rad", "of angle from steady motion"),
            "deviation_phase": column("deviation", "phase", "rad", "as phase"),
            "deviation_noise_floor": column("deviation", "noise_floor", "rad", floor),
        },
        "amplitude",
        "ripple by order of rotation, for each condition",
    )


def _waveform_table(groups: Sequence[RepeatedRuns], unit: str) -> Table:
    torque = [group.torque.mean(axis=0) for group in groups]
    deviation = [
        group.deviation.mean(axis=0) if group.moved else np.full(len(torque[0]), np.nan)
        for group in groups
    ]
    return Table(
        ("group", "position"),
        {
            **_group_columns(groups),
            "position": Column(cell_centres(groups[0].torque.shape[1]), "rad", "of the rotor"),
            "ripple": Column(torque, unit, "torque or current, offset included"),
            "deviation": Column(deviation, "rad", "of angle from steady motion"),
        },
        "ripple",
        "mean over the turns of each condition",
    )


def _group_columns(groups: Sequence[RepeatedRuns]) -> dict[str, Column]:
    names = dict.fromkeys(name for group in groups for name in group.conditions)
    taken = ("group", "order", "position", "speed", "turns", "amplitude", "phase", "ripple")
    varied = {
        name: Column([group.conditions.get(name, np.nan) for group in groups], "1")
        for name in names
        if name not in taken
    }
    return {
        "group": Column(np.arange(len(groups)), "1"),
        "speed": Column([group.speed for group in groups], "rad/s", "mean"),
        "turns": Column([group.turns for group in groups], "1", "averaged"),
        **varied,
    }


def _reduction_table(pairs: Sequence[tuple[RepeatedRuns, RepeatedRuns, str]], orders: int) -> Table:
    columns = {
        "pair": Column(np.arange(len(pairs)), "1", "see the notes"),
        "order": Column(np.arange(1.0, orders + 1), "1", "cycles a turn"),
    }
    for quantity, name in (("deviation", "reduction"), ("torque", "torque_reduction")):
        found = [reduction(low.spectra[quantity], high.spectra[quantity]) for low, high, _ in pairs]
        of = "motion" if quantity == "deviation" else "torque or current"
        columns[name] = Column(
            [values for values, _ in found], "1", f"1 - ratio of amplitudes, {of}"
        )
        columns[f"{name}_u"] = Column([u for _, u in found], "1")
    return Table(("pair", "order"), columns, "reduction", "ripple with against without")
