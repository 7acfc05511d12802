"""Signals of imported runs under load."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rigtool.errors import InsufficientDataError, UsageError, naming
from rigtool.experiments.imported import place as named
from rigtool.experiments.imported import position_of, recordings_of, require_one_rig
from rigtool.experiments.imported_load.basis import LoadSignals, ShaftPath, path_of
from rigtool.experiments.imported_load.noise import noise_of
from rigtool.experiments.torque_per_ampere import effort_of
from rigtool.numerics.arrays import Array, Mask
from rigtool.numerics.checks import require_rising
from rigtool.numerics.plateaus import runs_of
from rigtool.numerics.smoothing import resample
from rigtool.runfile import Recording, Run

REFERENCE_CHANNEL = "reference_torque"
"""Channel of the sensor at the load."""

LIMIT_SAMPLES, LIMIT_RATIO = 10, 5
"""An effort at a limit stays at its highest or lowest value for so many samples, and so many times
longer than at any other value."""

USUAL_SHARE, STUCK_RATIO = 0.99, 10
"""An effort is stuck at a value where it stays so many times longer than at this share of others.
"""

LONGEST_INTERVAL, GAP_PERIODS = 2.5, 0.25
"""Longest intervals between samples that are no gaps, in medians (one lost sample is between its
neighbours) and in periods of the bandwidth: the longer of the two."""

LIMITED_SHARE = 0.01
"""Share of a row, behind the low-pass, from which on a limit has changed it."""

JUMP_PART = 0.5
"""Part of a position's range beyond which a step between two samples is none of a motion: what
begins again after a turn or a number of bits steps over nearly all of it."""


def read_all(
    runs: Sequence[Run], kt: Run | None, bandwidth_hz: float, unit: str | None = None
) -> list[LoadSignals]:
    """Return the signals of all recordings of runs of one rig, at a bandwidth.

    Raises `InsufficientDataError` where one is too short or too slow for that, `UsageError` where
    its effort is not in the `unit` that is asked for.
    """
    recordings = recordings_of(runs)
    require_one_rig(recordings)
    found = [_read(recording, kt, bandwidth_hz) for recording in recordings]
    unit = unit or found[0].effort_unit
    for recording, signals in zip(recordings, found, strict=True):
        if signals.effort_unit != unit:
            raise UsageError(
                f"{named(recording)}: its effort is in {signals.effort_unit}, that of the tables "
                f"or of the other runs in {unit}: give --kt to both commands or to neither"
            )
    return found


def _read(recording: Recording, kt: Run | None, bandwidth_hz: float) -> LoadSignals:
    effort = effort_of(recording, kt)
    motor = position_of(recording)
    has_output = recording.has("output_position")
    output = recording.read("output_position") if has_output else motor
    has_place = recording.has("reference_position")
    place = recording.read("reference_position") if has_place else output
    time = recording.read("time")
    sensor = [recording.read(REFERENCE_CHANNEL)] if recording.has(REFERENCE_CHANNEL) else []
    with naming(named(recording)):
        require_steady(time, motor)
        time, (raw, motor, *others), lost = at_even_times(
            time, bandwidth_hz, effort.values, motor, output, place, *sensor
        )
        if np.ptp(raw) == 0:
            raise InsufficientDataError(
                f"the effort is {raw[0]:.4g} throughout: it is not that of a motor that moves; "
                "correct its column in the mapping"
            )
        gone = (at_limit(raw) | lost).astype(np.float64)
        path, (values, gone, output, place, *reference) = path_of(
            time, motor, bandwidth_hz, raw, gone, *others
        )
    regular = path.regular & (np.abs(gone) < LIMITED_SHARE)
    path = replace(path, regular=regular & ~until_reversal(lost, time, path))
    # As the motor's sign, so that one direction has one sign everywhere
    speed = np.gradient(output, path.time)
    sign = math.copysign(1.0, float(np.sum(speed * path.speed)))
    return LoadSignals(
        path=path,
        effort=values,
        effort_unit=effort.unit,
        output_speed=sign * speed,
        place=place,
        reference=reference[0] if reference else None,
        noise=noise_of(raw[~lost], (len(time) - 1) / (time[-1] - time[0]), bandwidth_hz),
    )


def require_steady(time: Array, position: Array) -> None:
    """Raise `InsufficientDataError` where a position (n,), rad, jumps: its turns are not counted.

    A sample that is wrong alone, and steps over a gap, are no jumps.
    """
    known = np.isfinite(position)
    time, position = time[known], position[known]
    if len(time) < 3:
        return
    alone = np.median([position[:-2], position[1:-1], position[2:]], axis=0)
    steps, intervals = np.diff(alone), np.diff(time[1:-1])
    usual = intervals <= LONGEST_INTERVAL * require_rising(time)
    at = np.flatnonzero(usual & (np.abs(steps) > JUMP_PART * np.ptp(alone)))
    if at.size:
        raise InsufficientDataError(
            f"the position jumps {at.size} times, first by {steps[at[0]]:.4g} rad at "
            f"{time[at[0] + 2]:.6g} s, at most {JUMP_PART * np.ptp(alone):.4g} rad, half of its "
            "range, is a motion: state wraps_at in the mapping for an angle or a counter that "
            "begins again (where it is stated, record more often), or take out wrong samples"
        )


def at_even_times(
    time: Array, bandwidth_hz: float, *signals: Array
) -> tuple[Array, list[Array], Mask]:
    """Return an even time (m,), the signals (n,) at it, (m,) each, and where they are `lost`: in a
    gap that the bandwidth shows. Samples with a NaN are left out before.

    Raises `InsufficientDataError` where no two samples are left, or too few a second.
    """
    known = np.isfinite(np.stack(signals)).all(axis=0)
    if np.count_nonzero(known) < 2:
        raise InsufficientDataError(
            "no samples at which all signals are numbers: record these together"
        )
    time, kept = time[known], [values[known] for values in signals]
    gap = max(LONGEST_INTERVAL * require_rising(time), GAP_PERIODS / bandwidth_hz)
    step, sampled, found = resample(time, *kept, gap=gap)
    if step * bandwidth_hz >= 0.5:
        raise InsufficientDataError(
            f"{1 / step:.3g} samples a second carry no bandwidth of {bandwidth_hz:g} Hz: correct "
            "the unit of time in the mapping if it is another, record more often, or lower "
            "measure_force.lowpass_hz"
        )
    return time[0] + step * np.arange(len(sampled)), list(found), ~sampled


def until_reversal(lost: Mask, time: Array, path: ShaftPath) -> Mask:
    """Return which rows (n,) of a path are in a gap longer than a period of the bandwidth, or
    behind it until the motion reverses: where it did so last is not known there.

    `lost` (m,) marks gaps at `time` (m,).
    """
    period, found = 1 / path.bandwidth_hz, np.zeros(len(path.time), dtype=np.bool_)
    for first, last in runs_of(lost):
        if time[last - 1] - time[first] > period:
            start, end = np.searchsorted(path.time, [time[first], time[last - 1] + period])
            way = np.sign(path.speed[end:])
            turned = np.flatnonzero(way != way[:1])
            found[start : end + turned[0] if turned.size else None] = True
    return found


def at_limit(effort: Array) -> Mask:
    """Return where an effort (n,) is cut off at a limit, its highest or lowest value, or stays at
    another for long: the last that arrived."""
    first = np.flatnonzero(np.diff(effort, prepend=np.nan))
    length, value = np.diff(first, append=len(effort)), effort[first]
    ends = effort.max(), effort.min()
    between = length[~np.isin(value, ends)]
    found = np.zeros(len(effort), dtype=np.bool_)
    if not between.size:
        return found
    usual = float(np.quantile(between, USUAL_SHARE))
    stuck = length > max(LIMIT_SAMPLES, STUCK_RATIO * usual)
    found |= np.repeat(stuck & ~np.isin(value, ends), length)
    longest = between[between <= max(LIMIT_SAMPLES, STUCK_RATIO * usual)].max(initial=1)
    for end in ends:
        if length[value == end].max() >= max(LIMIT_SAMPLES, LIMIT_RATIO * longest):
            found |= effort == end
    return found
