"""Signals of imported runs under load, and how far a load model's torque is off the sensor."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rigtool.errors import InsufficientDataError
from rigtool.experiments.force_filter.motion_states import State
from rigtool.experiments.imported import position_of
from rigtool.experiments.imported_load.basis import ShaftPath, follow
from rigtool.experiments.imported_load.learning import Observation, level_numbers
from rigtool.experiments.imported_load.model import NORMAL_95, TorqueEstimate
from rigtool.experiments.torque_per_ampere import effort_of
from rigtool.numerics.arrays import Array, Mask
from rigtool.runfile import Column, Recording, Run

REFERENCE = "reference_torque"
"""Channel of the sensor at the load."""

END = 1.0
"""Left out at each end of a recording, s, as by O'Neill et al., IEEE RA-L 3(4) 3027-3034, 2018."""

FAST = 0.25
"""Strokes count as moving fast from this speed of the output on, rad/s; from the same paper."""

WIDE = 50.0
"""The bandwidth of the same paper, Hz, at which accuracy is reported as well."""


@dataclass(frozen=True, eq=False)
class LoadSignals:
    """What an analysis reads of a recording, at the rows (n,) of its path.

    `output_speed` is that of the output where it has an encoder of its own, else of the motor;
    `reference` is None without a sensor; `place` (n,) is where the load is, by the best encoder;
    `counts` are all rows but those at the ends.
    """

    path: ShaftPath
    effort: Array
    effort_unit: str
    output_speed: Array
    place: Array
    reference: Array | None
    counts: Mask

    def observation(self, level: int) -> Observation:
        """Return the recording as one to learn from; `ValueError` without a reference."""
        if self.reference is None:
            raise ValueError(f"nothing to learn from without {REFERENCE}")
        return Observation(self.path, self.effort, self.reference, self.counts, level)


def carries(recordings: Sequence[Recording], bandwidth_hz: float) -> bool:
    """Return whether the sampling carries a bandwidth."""
    steps = [np.median(np.diff(item.read("time", 0, 1000))) for item in recordings]
    return float(max(steps)) * bandwidth_hz < 0.2


def read_signals(
    run: Run, recording: Recording, kt: Run | None, bandwidth_hz: float
) -> LoadSignals:
    """Return the signals of a recording at a bandwidth.

    Raises `InsufficientDataError` where it is too short or too slow for that.
    """
    effort = effort_of(recording, kt)
    motor = position_of(recording)
    has_output = recording.has("output_position")
    output = recording.read("output_position") if has_output else motor
    has_place = recording.has("reference_position")
    place = recording.read("reference_position") if has_place else output
    has_reference = recording.has(REFERENCE)
    extra = [recording.read(REFERENCE)] if has_reference else []
    try:
        path, (values, output, place, *reference) = follow(
            recording.read("time"), motor, bandwidth_hz, effort.values, output, place, *extra
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


def levels_of(signals: Sequence[LoadSignals]) -> list[int]:
    """Return the number of the load level of each recording, by its mean reference torque."""
    means = []
    for item in signals:
        assert item.reference is not None
        moving = item.counts & item.path.regular
        means.append(float(np.mean(item.reference[moving])) if moving.any() else 0.0)
    return level_numbers(means)


@dataclass(frozen=True, eq=False)
class Judged:
    """Errors of one recording, N m, at the rows (n,) that count; NaN where there is no estimate.

    `closing` and `opening` are fast strokes against the load and with it, `moving` is whatever is
    not near standstill; `sure` marks 95 % intervals that hold the sensor's value.
    """

    error: Array
    closing: Mask
    opening: Mask
    moving: Mask
    sure: Mask


@dataclass(frozen=True)
class Accuracy:
    """Root mean squares of the error over many recordings, N m; NaN where nothing moved so.

    `coverage` is the part of 95 % intervals that hold the sensor's value, while moving; `judged`
    of `asked` samples in motion had an estimate.
    """

    closing: float
    opening: float
    moving: float
    coverage: float
    judged: int
    asked: int


def judge(signals: LoadSignals, estimate: TorqueEstimate, direction: int) -> Judged:
    """Compare an estimate with the sensor; `ValueError` without one."""
    if signals.reference is None:
        raise ValueError(f"nothing to compare with without {REFERENCE}")
    rows = signals.counts
    error = np.where(estimate.inside, estimate.torque - signals.reference, np.nan)[rows]
    speed = (direction * signals.output_speed)[rows]
    return Judged(
        error=error,
        closing=speed > FAST,
        opening=speed < -FAST,
        moving=~np.isin(estimate.states, (State.REVERSED, State.STILL))[rows],
        sure=np.abs(error) <= NORMAL_95 * estimate.u[rows],
    )


def accuracy(judged: Sequence[Judged]) -> Accuracy:
    """Pool the errors of recordings."""
    error = np.concatenate([item.error for item in judged])
    known = np.isfinite(error)

    def rms(kind: str) -> float:
        mask = known & np.concatenate([getattr(item, kind) for item in judged])
        return math.sqrt(float(np.mean(error[mask] ** 2))) if mask.any() else math.nan

    moving = np.concatenate([item.moving for item in judged])
    sure = np.concatenate([item.sure for item in judged])[known & moving]
    return Accuracy(
        closing=rms("closing"),
        opening=rms("opening"),
        moving=rms("moving"),
        coverage=float(np.mean(sure)) if sure.size else math.nan,
        judged=int(sure.size),
        asked=int(np.count_nonzero(moving)),
    )


def accuracy_columns(found: Sequence[Accuracy]) -> dict[str, Column]:
    """Return the columns of a table with one row for each accuracy."""

    def column(name: str, unit: str, what: str) -> Column:
        return Column(np.array([float(getattr(item, name)) for item in found]), unit, what)

    fast = f"faster than {FAST:g} rad/s"
    return {
        "rmse_closing": column("closing", "N m", f"strokes against the load, {fast}"),
        "rmse_opening": column("opening", "N m", f"strokes with the load, {fast}"),
        "rmse_moving": column("moving", "N m", "everything that moves"),
        "coverage_95": column("coverage", "1", "of 95 % intervals, everything that moves"),
        "samples": column("judged", "1", "with an estimate, of all that move"),
        "moving": column("asked", "1", "samples in motion"),
    }
