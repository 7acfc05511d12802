"""Signals of imported runs under load."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from rigtool.errors import InsufficientDataError, UsageError
from rigtool.experiments.imported import position_of, require_one_rig, signals_of
from rigtool.experiments.imported_load.basis import LoadSignals, follow
from rigtool.experiments.torque_per_ampere import effort_of
from rigtool.runfile import Recording, Run

REFERENCE = "reference_torque"
"""Channel of the sensor at the load."""

END = 1.0
"""Left out at each end of a recording, s, as by O'Neill et al., IEEE RA-L 3(4) 3027-3034, 2018."""


def read_all(
    runs: Sequence[Run], kt: Run | None, bandwidth_hz: float, unit: str | None = None
) -> list[LoadSignals]:
    """Return the signals of runs of one rig at a bandwidth.

    Raises `InsufficientDataError` where a run is too short or too slow for that, `UsageError`
    where its effort is not in the `unit` that is asked for.
    """
    recordings = signals_of(runs)
    require_one_rig(recordings, runs)
    found = [_read(run, own, kt, bandwidth_hz) for run, own in zip(runs, recordings, strict=True)]
    unit = unit or found[0].effort_unit
    for run, signals in zip(runs, found, strict=True):
        if signals.effort_unit != unit:
            raise UsageError(
                f"{run.path}: its effort is in {signals.effort_unit}, that of the tables or of the "
                f"other runs in {unit}: give --kt to both commands or to neither"
            )
    return found


def _read(run: Run, recording: Recording, kt: Run | None, bandwidth_hz: float) -> LoadSignals:
    effort = effort_of(recording, kt)
    motor = position_of(recording)
    has_output = recording.has("output_position")
    output = recording.read("output_position") if has_output else motor
    has_place = recording.has("reference_position")
    place = recording.read("reference_position") if has_place else output
    sensor = [recording.read(REFERENCE)] if recording.has(REFERENCE) else []
    try:
        path, (values, output, place, *reference) = follow(
            recording.read("time"), motor, bandwidth_hz, effort.values, output, place, *sensor
        )
    except InsufficientDataError as error:
        raise InsufficientDataError(f"{run.path}: {error}") from None
    start, end = path.time[0] + END, path.time[-1] - END
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
        counts=(path.time >= start) & (path.time <= end),
    )
