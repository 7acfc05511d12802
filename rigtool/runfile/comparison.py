"""Differences between two runs in results, tables and signals, beyond tolerances."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from rigtool.numerics.arrays import Array, Mask
from rigtool.quantity import Quantity, format_quantity
from rigtool.runfile.model import Table
from rigtool.runfile.reader import Run
from rigtool.runfile.recording import BLOCK_SAMPLES, Recording


@dataclass(frozen=True)
class Tolerance:
    """Values a and b agree where |a - b| <= absolute + relative * max(|a|, |b|), in SI."""

    relative: float = 0.0
    absolute: float = 0.0

    def beyond(self, a: Array, b: Array) -> Mask:
        """Return where values (n,) do not agree; NaN agrees with NaN."""
        with np.errstate(invalid="ignore", over="ignore"):
            limit = self.absolute + self.relative * np.maximum(np.abs(a), np.abs(b))
            apart = ~(np.abs(a - b) <= limit) & (a != b)
        both: Mask = np.isnan(a) & np.isnan(b)
        return apart & ~both


def differences(a: Run, b: Run, tolerance: Tolerance) -> Iterator[str]:
    """Yield one line for each result, table column or channel that does not agree.

    An analysis of a stored run keeps no signals: between a run and an analysis of it, only results
    and tables are compared. Between runs of different commands, what only one of them has is
    counted instead of named.
    """
    missing = _missing
    if a.command != b.command:
        yield f"command: {a.command} | {b.command}"
        missing = _counted
    yield from missing("results", a.results, b.results)
    yield from _results(a.results, b.results, tolerance)
    yield from missing("tables", a.tables, b.tables)
    yield from _tables(a.tables, b.tables, tolerance)
    if not (_analyses(a, b) or _analyses(b, a)):
        yield from missing("recordings", a.recordings, b.recordings)
        yield from _recordings(a.recordings, b.recordings, tolerance)


def _analyses(a: Run, b: Run) -> bool:
    """Return whether a holds no signals and was computed from those of b."""
    inputs = {item["content_sha256"] for item in a.provenance["inputs"]}
    return not a.recordings and b.content_sha256 in inputs


def _results(
    a: Mapping[str, Quantity], b: Mapping[str, Quantity], tolerance: Tolerance
) -> Iterator[str]:
    for name in _common(a, b):
        one, other = a[name], b[name]
        where = f"results/{name}"
        if one.unit != other.unit:
            yield f"{where}: unit {one.unit} | {other.unit}"
            continue
        if tolerance.beyond(np.array([one.value]), np.array([other.value])).any():
            line = f"{where}: {format_quantity(one, name)} | {format_quantity(other, name)}"
            yield line + _significance(one, other)
            continue
        u_one, u_other = (np.array([math.nan if q.u is None else q.u]) for q in (one, other))
        if tolerance.beyond(u_one, u_other).any():
            both = ("none" if q.u is None else f"{q.u:.3g} {q.unit}" for q in (one, other))
            yield f"{where}: standard uncertainty {' | '.join(both)}"


def _significance(a: Quantity, b: Quantity) -> str:
    u = math.hypot(a.u or 0.0, b.u or 0.0)
    if u == 0 or not math.isfinite(a.value - b.value):
        return ""
    return f"  ({abs(a.value - b.value) / u:.2g} standard uncertainties of the difference)"


def _tables(a: Mapping[str, Table], b: Mapping[str, Table], tolerance: Tolerance) -> Iterator[str]:
    for name in _common(a, b):
        one, other = a[name].columns, b[name].columns
        yield from _missing(f"tables/{name}", one, other)
        for column in _common(one, other):
            where = f"tables/{name}/{column}"
            if one[column].unit != other[column].unit:
                yield f"{where}: unit {one[column].unit} | {other[column].unit}"
            elif one[column].values.shape != other[column].values.shape:
                yield f"{where}: shape {one[column].values.shape} | {other[column].values.shape}"
            else:
                left, right = (c[column].values.astype(np.float64).ravel() for c in (one, other))
                yield from _Worst(tolerance).add(left, right).line(where, one[column].unit)


def _recordings(
    a: Mapping[str, Recording], b: Mapping[str, Recording], tolerance: Tolerance
) -> Iterator[str]:
    for name in _common(a, b):
        one, other = a[name], b[name]
        where = f"recordings/{name}"
        yield from _missing(where, one.units, other.units)
        if {key: q.value for key, q in one.conditions.items()} != {
            key: q.value for key, q in other.conditions.items()
        }:
            yield f"{where}: recorded under other conditions"
        if one.size != other.size:
            yield f"{where}: {one.size} samples | {other.size}"
            continue
        for channel in _common(one.units, other.units):
            if one.units[channel] != other.units[channel]:
                yield f"{where}/{channel}: unit {one.units[channel]} | {other.units[channel]}"
                continue
            worst = _Worst(tolerance)
            for start in range(0, one.size, BLOCK_SAMPLES):
                stop = min(start + BLOCK_SAMPLES, one.size)
                left = one.read_stored(channel, start, stop).astype(np.float64)
                worst.add(left, other.read_stored(channel, start, stop).astype(np.float64))
            yield from worst.line(f"{where}/{channel}", one.units[channel])


class _Worst:
    """Number of values that differ and their largest difference, block by block."""

    def __init__(self, tolerance: Tolerance) -> None:
        self._tolerance = tolerance
        self._total = self._count = 0
        self._most = 0.0

    def add(self, a: Array, b: Array) -> _Worst:
        apart = self._tolerance.beyond(a, b)
        self._total += a.size
        self._count += int(np.count_nonzero(apart))
        if apart.any():
            self._most = max(self._most, float(np.max(np.abs(a[apart] - b[apart]))))
        return self

    def line(self, where: str, unit: str) -> Iterator[str]:
        if self._count:
            finite = math.isfinite(self._most)
            most = f"{self._most:.3g} {unit}".removesuffix(" 1") if finite else "NaN or infinity"
            yield f"{where}: {self._count} of {self._total} values differ, by up to {most}"


def _common(a: Mapping[str, object], b: Mapping[str, object]) -> list[str]:
    return [name for name in a if name in b]


def _missing(where: str, a: Mapping[str, object], b: Mapping[str, object]) -> Iterator[str]:
    for name in a:
        if name not in b:
            yield f"{where}/{name}: only in the first"
    for name in b:
        if name not in a:
            yield f"{where}/{name}: only in the second"


def _counted(where: str, a: Mapping[str, object], b: Mapping[str, object]) -> Iterator[str]:
    both = len(_common(a, b))
    if both < max(len(a), len(b)):
        only = f"{len(a) - both} only in the first, {len(b) - both} only in the second"
        yield f"{where}: {only}, {both} in both"
