"""Signals of imported runs under load."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rigtool.errors import UsageError, naming
from rigtool.experiments.imported import place as named
from rigtool.experiments.imported import position_of, recordings_of, require_one_rig
from rigtool.experiments.imported_load.basis import LoadSignals, path_of
from rigtool.experiments.imported_load.noise import noise_of
from rigtool.experiments.torque_per_ampere import effort_of
from rigtool.numerics.arrays import Array, Mask
from rigtool.runfile import Recording, Run

REFERENCE_CHANNEL = "reference_torque"
"""Channel of the sensor at the load."""

LIMIT_SAMPLES, LIMIT_RATIO = 10, 5
"""An effort at a limit stays at its highest or lowest value for so many samples, and so many times
longer than at any other value."""

LIMITED_SHARE = 0.01
"""Share of a row, behind the low-pass, from which on a limit has changed it."""


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
        limited = at_limit(effort.values).astype(np.float64)
        path, (values, limited, output, place, *reference) = path_of(
            time,
            motor,
            bandwidth_hz,
            effort.values,
            limited,
            output,
            place,
            *sensor,
        )
    path = replace(path, regular=path.regular & (np.abs(limited) < LIMITED_SHARE))
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
        noise=noise_of(effort.values, (len(time) - 1) / (time[-1] - time[0]), bandwidth_hz),
    )


def at_limit(effort: Array) -> Mask:
    """Return where an effort (n,) is cut off at a limit: its highest or lowest value."""
    first = np.flatnonzero(np.diff(effort, prepend=np.nan))
    length, value = np.diff(first, append=len(effort)), effort[first]
    ends = effort.max(), effort.min()
    between = length[~np.isin(value, ends)]
    found = np.zeros(len(effort), dtype=np.bool_)
    for end in ends:
        longest = length[value == end].max()
        if between.size and longest >= max(LIMIT_SAMPLES, LIMIT_RATIO * between.max()):
            found |= effort == end
    return found
