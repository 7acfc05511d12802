"""The estimate of a recording: block by block as it arrives, or smoothed once it is complete.

A step of the filter is `step_samples` samples long; its angle is that of the first sample after
it, so that step k is the estimate at the end of its samples. Both forms have the same equations
(`plant`, `kalman`); the smoothed one runs them backwards (`smoother`, Bryson and Frazier 1963).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rigtool.experiments.force_over_time import kalman, passed, smoother
from rigtool.experiments.force_over_time.kalman import Uncertainty
from rigtool.experiments.force_over_time.plant import STATES, TORQUE, Plant, as_record

Array = NDArray[np.float64]

SEGMENT = 4096
"""Steps that the smoother keeps at a time; the filter runs twice, and memory does not grow."""


@dataclass(frozen=True)
class Signals:
    """What is known of each of n samples.

    `drive_torque` (n,) is what current and position give [N m], `viscous` (n,) the bearings'
    viscous friction [N m s/rad], `low` (n,) the lower edge of the count that the angle is in [rad],
    and `width` that of a count [rad].
    """

    drive_torque: Array
    viscous: Array
    low: Array
    width: float


@dataclass(frozen=True)
class Estimate:
    """Estimate after each of m steps: all states (m, 12); the torque behind the low-pass, and its
    deviation, (m, 2) N m."""

    states: Array
    outputs: Array

    @property
    def torque(self) -> Array:
        """Torque on the output, (m,) N m."""
        torque: Array = self.states[:, TORQUE]
        return torque

    @property
    def passed(self) -> Array:
        """Torque on the output behind the low-pass, (m,) N m."""
        return self.outputs[:, 0]

    @property
    def deviation(self) -> Array:
        """Its standard deviation, (m,) N m."""
        return self.outputs[:, 1]


class Filter:
    """The causal estimate; samples are added as they come, in blocks of any length.

    Torque behind the low-pass and its deviation are for a `bandwidth_hz` Hz.
    """

    def __init__(
        self, plant: Plant, uncertainty: Uncertainty, step_samples: int, bandwidth_hz: float
    ) -> None:
        self._plant, self._uncertainty, self._size = plant, uncertainty, step_samples
        self._low_pass = passed.section(bandwidth_hz, step_samples * plant.sample_time)
        self._waiting: Signals | None = None
        self._state: NDArray[np.void] | None = None

    def add(self, signals: Signals) -> Estimate:
        """Return the estimate after every step that these samples complete, m of them."""
        if self._waiting is not None:
            signals = _joined(self._waiting, signals)
        if self._state is None and signals.low.size:
            low = float(signals.low[0])
            self._state = kalman.begin(self._plant, self._uncertainty, low, signals.width)
        count = max(0, (signals.low.size - 1) // self._size)
        self._waiting = _part(signals, count * self._size, None)
        if self._state is None:
            return Estimate(np.empty((0, STATES)), np.empty((0, 2)))
        models = self._plant, self._uncertainty, self._size, self._low_pass
        return _steps(self._state, *models, signals, None)


def smoothed(
    plant: Plant,
    uncertainty: Uncertainty,
    step_samples: int,
    bandwidth_hz: float,
    signals: Signals,
) -> tuple[Array, Array]:
    """Return torque after each step, and the deviation that a low-pass without phase shift leaves
    of it, (m,) N m each, from the whole recording.

    The deviation is that of the causal low-pass of the same bandwidth, by its delay later.

    Raises `ValueError` for less than a step of samples.
    """
    count = (signals.low.size - 1) // step_samples
    if count < 1:
        raise ValueError(f"{signals.low.size} samples are less than a step of {step_samples}")
    step_time = step_samples * plant.sample_time
    models = plant, uncertainty, step_samples, passed.section(bandwidth_hz, step_time)
    pieces = []
    state = kalman.begin(plant, uncertainty, float(signals.low[0]), signals.width)
    for first in range(0, count, SEGMENT):
        last = min(first + SEGMENT, count)
        piece = _part(signals, first * step_samples, last * step_samples + 1)
        pieces.append((slice(first, last), piece, state.copy()))
        _steps(state, *models, piece, None)
    torque, deviation = np.empty(count), np.empty(count)
    adjoint, information = np.zeros(STATES), np.zeros((STATES, STATES))
    kept = math.exp(-step_time / uncertainty.friction_noise_time)
    for span, piece, before in reversed(pieces):
        kept_steps = smoother.room(span.stop - span.start)
        found = _steps(before, *models, piece, kept_steps)
        torque[span], deviation[span] = found.torque, found.deviation
        smoother.backwards(adjoint, information, kept, kept_steps, torque[span], deviation[span])
    late = min(round(passed.delay(bandwidth_hz) / step_time), count - 1)
    return torque, np.append(deviation[late:], np.full(late, deviation[-1]))


def _steps(
    state: NDArray[np.void],
    plant: Plant,
    uncertainty: Uncertainty,
    size: int,
    low_pass: Array,
    signals: Signals,
    kept: tuple[Array, ...] | None,
) -> Estimate:
    """Run all whole steps of these samples; changes the filter's state."""
    count = max(0, (signals.low.size - 1) // size)
    found = Estimate(np.empty((count, STATES)), np.empty((count, 2)))
    kalman.run(
        state,
        as_record(plant),
        as_record(uncertainty),
        plant.friction_map,
        signals.drive_torque[: count * size].reshape(count, size),
        signals.viscous[: count * size].reshape(count, size),
        np.ascontiguousarray(signals.low[size : count * size + 1 : size]),
        signals.width,
        low_pass,
        found.states,
        found.outputs,
        kept,
    )
    return found


def _part(signals: Signals, first: int, last: int | None) -> Signals:
    return Signals(
        signals.drive_torque[first:last],
        signals.viscous[first:last],
        signals.low[first:last],
        signals.width,
    )


def _joined(before: Signals, after: Signals) -> Signals:
    return Signals(
        np.concatenate([before.drive_torque, after.drive_torque]),
        np.concatenate([before.viscous, after.viscous]),
        np.concatenate([before.low, after.low]),
        after.width,
    )
