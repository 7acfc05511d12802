"""`fft-ripple` on imported maps around the turn: equal, turned against each other, or different."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rigtool.errors import UsageError, naming
from rigtool.experiments.outcome import Outcome
from rigtool.experiments.ripple.map_shift import highest_order, map_orders, match_maps, typical
from rigtool.experiments.ripple.orders import HIGHEST_ORDER, Match
from rigtool.numerics.arrays import Array, ComplexArray
from rigtool.quantity import Quantity
from rigtool.runfile import Column, Run, Table, dof_column
from rigtool.runfile.schema import MAP

SIGNIFICANT_SHIFT = 3.0
"""Multiple of its uncertainty above which the shift of a map is significant."""

SAME_MAP_VARIANCE = 0.9
"""Smallest common part of the variance, after turning, of two equal maps."""


@dataclass(frozen=True, eq=False)
class Maps:
    """Maps of one signal: their orders (maps, m), amplitude*exp(i phase), and means (maps,).

    `matches` compare each with the `reference`, the one that correlates best with all others.
    """

    orders: ComplexArray
    means: Array
    signal: str
    unit: str
    reference: int
    matches: tuple[Match, ...]


def read_maps(runs: Sequence[Run]) -> Maps:
    """Read maps around the turn; `UsageError` for maps of several signals, `InsufficientDataError`
    for maps without enough angles."""
    tables = [run.table(MAP, "position", position="rad") for run in runs]
    signals = {(table.signal, table.columns[table.signal].unit) for table in tables}
    if len(signals) > 1:
        found = ", ".join(f"{name} [{unit}]" for name, unit in sorted(signals))
        raise UsageError(f"maps of {found} cannot be compared: give maps of one signal")
    orders = min([HIGHEST_ORDER, *(highest_order(table["position"]) for table in tables)])
    maps = []
    for run, table in zip(runs, tables, strict=True):
        with naming(run.path):
            maps.append(map_orders(table["position"], table[table.signal], orders))
    reference = typical(maps)
    return Maps(
        np.array(maps),
        np.array([table[table.signal].mean() for table in tables]),
        *signals.pop(),
        reference,
        tuple(match_maps(maps[reference], other) for other in maps),
    )


def compare_maps(runs: Sequence[Run]) -> Outcome:
    """Compare maps with the one that correlates best with all others.

    Raises `UsageError` for one map alone, and as `read_maps` does.
    """
    if len(runs) < 2:
        raise UsageError(
            "one map cannot be compared: give two or more, or learn from it by ilc-learn"
        )
    maps = read_maps(runs)
    names = [run.path.stem for run in runs]
    notes = [f"compared with {names[maps.reference]}, the map that correlates best with all others"]
    notes += [_verdict(name, match) for name, match in zip(names, maps.matches, strict=True)]
    notes.pop(1 + maps.reference)
    return Outcome(
        _results(names, maps.matches, maps.reference),
        {"map_comparison": _table(maps.matches), "map_spectrum": _spectra(maps.orders, maps.unit)},
        tuple(notes),
    )


def _verdict(name: str, match: Match) -> str:
    """Return whether a map is equal, turned or different, with the numbers."""
    numbers = f"correlation {match.correlation:.3f} at equal angles"
    degrees = math.degrees(match.shift)
    turned = f"{match.best_correlation:.3f} when turned by {degrees:.1f} deg"
    if match.best_correlation**2 < SAME_MAP_VARIANCE:
        return f"{name}: another map ({numbers}, at best {turned})"
    if (
        abs(match.shift) <= SIGNIFICANT_SHIFT * match.shift_u
        or match.correlation**2 >= SAME_MAP_VARIANCE
    ):
        return f"{name}: the same map ({numbers}, {turned})"
    match_u = f"{math.degrees(match.shift_u):.2f}"
    part = abs(match.shift) / (2 * math.pi)
    of_turn = "half a turn" if round(part, 2) == 0.5 else f"{part:.2f} of a turn"
    return (
        f"{name}: the same map, shifted by {of_turn}, {degrees:.1f} +- {match_u} deg "
        f"({numbers}, {turned}): look for a cause that does not turn with the rotor, such as "
        "another index or another motor nearby"
    )


def _results(names: Sequence[str], matches: Sequence[Match], reference: int) -> dict[str, Quantity]:
    results = {}
    for number, (name, match) in enumerate(zip(names, matches, strict=True)):
        if number == reference:
            continue
        key = "".join(c if c.isascii() and c.isalnum() else "_" for c in name)[:80]
        results[f"shift_{key}"] = Quantity(match.shift, "rad", match.shift_u)
        results[f"correlation_{key}"] = Quantity(
            match.correlation, "1", reason="one map each, without repeats"
        )
    return results


def _table(matches: Sequence[Match]) -> Table:
    def column(name: str, unit: str, what: str) -> Column:
        return Column([getattr(match, name) for match in matches], unit, what)

    return Table(
        ("map",),
        {
            "map": Column(np.arange(len(matches)), "1", "in the order of the inputs"),
            "correlation": column("correlation", "1", "at equal angles"),
            "shift": column("shift", "rad", "that makes the correlation largest"),
            "shift_u": column("shift_u", "rad", "standard uncertainty of it"),
            "dof": dof_column(np.full(len(matches), np.inf)),
            "best_correlation": column("best_correlation", "1", "at that shift"),
            "scale": column("scale", "1", "least-squares factor at that shift"),
        },
        "correlation",
        "each map against the one that correlates best with all others",
    )


def _spectra(maps: ComplexArray, unit: str) -> Table:
    return Table(
        ("map", "order"),
        {
            "map": Column(np.arange(len(maps)), "1", "in the order of the inputs"),
            "order": Column(np.arange(1, maps.shape[1] + 1), "1", "cycles a turn"),
            "amplitude": Column(np.abs(maps), unit),
            "phase": Column(np.angle(maps), "rad", "amplitude*cos(order*angle + phase)"),
        },
        "amplitude",
        "maps by order of rotation",
    )
