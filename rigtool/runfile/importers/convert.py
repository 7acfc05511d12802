"""Conversion of raw columns to SI signals on a rising time axis."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from rigtool.errors import RunFileError
from rigtool.recipe.mapping import Mapping
from rigtool.runfile.importers.contradictions import require_same_motion
from rigtool.runfile.importers.counters import unwrapped
from rigtool.runfile.importers.raw import Array, Raw, require_good
from rigtool.runfile.schema import TIME

IRREGULAR_PART = 0.01
"""Intervals that differ from the median by more than this part make a time axis irregular."""

START_RATIO, START_STEP = 30.0, 10.0
"""A first sample that differs from the second by this factor, over a step this many times as large
as any later one, is no measurement."""

MIN_STEPS = 10
"""Smallest number of samples that show how a signal moves."""


def to_si(path: Path, raw: Raw, mapping: Mapping, skip_bad: bool) -> tuple[dict[str, Array], Raw]:
    """Return signals by name, `time` first, and the raw columns without bad lines.

    A first sample that is no measurement is left out. Raises `RunFileError` where time does not
    rise, unless `skip_bad`: then as few lines as possible are left out so that it does; and where
    fewer than two samples are there.
    """
    time = _time(raw, mapping)
    raw = replace(raw, starts=tuple(raw.line[_starts(time)].tolist()))
    bad = {
        int(raw.line[index]): _not_risen(time[index], time[index - 1])
        for index in np.flatnonzero(np.diff(time) <= 0) + 1
        if index not in raw.edges
    }
    if bad:
        if not skip_bad:
            require_good(path, raw.what, bad)
        kept = [a + i for a, b in pairwise(raw.edges) for i in _longest_rise(time[a:b])]
        off = np.setdiff1d(np.arange(len(time)), kept)
        raw = raw.without({int(raw.line[index]): "out of the order of time" for index in off})
        time = _time(raw, mapping)
    if (why := _wrong_start(time, raw, mapping)) is not None:
        raw = raw.without({int(raw.line[0]): why})
        time = _time(raw, mapping)
    if len(time) < 2:
        raise RunFileError(f"{path}: {len(time)} sample, at least 2 are needed: record for longer")
    signals = {TIME: time}
    for name in mapping.signals:
        if name != TIME:
            signals[name] = _signal(raw, mapping, name)
    for name, values in signals.items():
        if not np.isfinite(values).all():
            raise RunFileError(
                f"{path}: {name} is beyond the numbers of a computer with this scale and offset: "
                "correct them in the mapping"
            )
    require_same_motion(path, longest(signals, raw), mapping.rig)
    return signals, raw


def whole_times(raw: Raw, mapping: Mapping) -> Raw:
    """Return the columns with nanoseconds added to the seconds of times, from the first second."""
    columns = dict(raw.columns)
    for signal in mapping.signals.values():
        if signal.nanoseconds is not None:
            seconds = columns[signal.column] - np.nanmin(columns[signal.column])
            columns[signal.column] = seconds + 1e-9 * columns[signal.nanoseconds]
    return replace(raw, columns=columns)


def longest(signals: dict[str, Array], raw: Raw) -> dict[str, Array]:
    """Return the signals of the longest recording of a file."""
    a, b = max(pairwise(raw.edges), key=lambda part: part[1] - part[0])
    return {name: values[a:b] for name, values in signals.items()}


def _not_risen(now: float, before: float) -> str:
    same = (
        "; state sampling_rate_hz for `time` if its clock is too coarse, or `nanoseconds` of "
        "`time` where these have a column of their own"
    )
    same = same if now == before else ""
    return f"time does not rise: {now:.9g} s after {before:.9g} s{same}"


def _starts(time: Array) -> list[int]:
    """Return the samples at which the time of a file (n,) starts anew.

    There, it falls to the start of the recording or before it, and goes on at the usual rate.
    """
    steps = np.diff(time)
    falls = np.flatnonzero(steps < 0) + 1
    if falls.size == 0:
        return []
    usual, found = float(np.median(steps)), [0]
    for at in falls.tolist():
        again = time[at] <= time[found[-1]] + usual
        more = steps[at : at + MIN_STEPS]
        if again and len(more) == MIN_STEPS and np.all((more >= 0) & (more < START_STEP * usual)):
            found.append(at)
    return found[1:]


def _wrong_start(time: Array, raw: Raw, mapping: Mapping) -> str | None:
    """Return why the first sample is none of the motion, None where it may be one.

    Recorders that begin before their first conversion store what was in memory.
    """
    if len(time) < MIN_STEPS:
        return None
    for name in mapping.signals:
        if name == TIME or name.endswith("_setpoint"):
            continue
        values = _signal(raw, mapping, name)
        with np.errstate(over="ignore", invalid="ignore"):  # found by `to_si`
            steps = np.abs(np.diff(values))
            first, second = np.abs(values[:2])
            far = 0 < min(first, second) * START_RATIO < max(first, second)
            alone = steps[0] > START_STEP * steps[1:].max() > 0
        if far and alone:
            return f"{name} is {values[0]:.4g}, {values[1]:.4g} next: no sample of this motion"
    return None


def _time(raw: Raw, mapping: Mapping) -> Array:
    rate = mapping.file.sampling_rate_hz
    return raw.place / rate if rate is not None else _signal(raw, mapping, TIME)


def _signal(raw: Raw, mapping: Mapping, name: str) -> Array:
    signal = mapping.signals[name]
    values = raw.columns[signal.column]
    if signal.wraps_at is not None:
        values = unwrapped(values, signal.wraps_at)
    with np.errstate(over="ignore"):  # found by `to_si`
        shown = (signal.scale * values + signal.offset) * (signal.sign * mapping.factor(name))
        si: Array = shown + mapping.zero(name)
    return si


def _longest_rise(values: Array) -> list[int]:
    """Return the indices of the longest strictly rising subsequence (Fredman 1975)."""
    tails: list[float] = []
    ends: list[int] = []
    before = [-1] * len(values)
    for index, value in enumerate(values.tolist()):
        place = bisect_left(tails, value)
        if place < len(tails) and tails[place] == value:
            continue  # of equal times the first is kept
        before[index] = ends[place - 1] if place else -1
        tails[place : place + 1] = [value]
        ends[place : place + 1] = [index]
    chain = []
    index = ends[-1]
    while index >= 0:
        chain.append(index)
        index = before[index]
    return chain[::-1]


def irregular(steps: Array) -> str | None:
    """Return a note where the intervals of a time axis (n,) differ, else None."""
    usual = float(np.median(steps))
    if np.max(np.abs(steps - usual)) <= IRREGULAR_PART * usual:
        return None
    return (
        f"the time axis is irregular, intervals from {steps.min():.4g} to {steps.max():.4g} s, "
        f"median {usual:.4g} s: kept as recorded"
    )


def intervals(time: Array, raw: Raw) -> Array:
    """Return the intervals within the recordings of a file."""
    return np.delete(np.diff(time), np.array(raw.edges[1:-1], dtype=np.intp) - 1)


def stem(path: Path) -> str:
    """Return a file's name without its endings: '07' for 07.TXT.gz."""
    name = path.name.removesuffix(".gz").removesuffix(".GZ")
    return Path(name).stem
