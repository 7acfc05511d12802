"""The causal estimate of a recording, block by block; `smoothed` has the form by what follows.

A step of the filter is `step_samples` samples long; its angle is that of the first sample after
it, so that step k is the estimate at the end of its samples. The equations are those of `plant`
and `kalman`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rigtool.experiments.force_filter import kalman, passed, smoother
from rigtool.experiments.force_filter.kalman import Uncertainty
from rigtool.experiments.force_filter.plant import STATES, TORQUE, Plant, as_record
from rigtool.numerics.arrays import Array, Mask, joined

PIECE_STEPS = 8192
"""Steps that are filtered at a time where the smoother keeps what the filter did."""

IDLE_TIME = 0.25
"""Time without a current, s, from which on a motor is not driven. The current of a controller
passes zero in less where the motion turns around."""


def idle_steps(step_time: float) -> int:
    """Return the steps of `step_time` s in `IDLE_TIME`."""
    return max(1, round(IDLE_TIME / step_time))


@dataclass(frozen=True)
class Signals:
    """The input of the filter at each of n samples.

    `drive_torque` (n,) is what current and position give [N m], `viscous` (n,) the bearings'
    viscous friction [N m s/rad], `low` (n,) the lower edge of the count that the angle is in [rad],
    and `width` that of a count [rad]. `idle` (n,) is where the motor has no current, nowhere by
    default.
    """

    drive_torque: Array
    viscous: Array
    low: Array
    width: float
    idle: Mask | None = None

    def part(self, first: int, last: int | None) -> Signals:
        """Return the samples from `first` to before `last`; to the end for None."""
        return Signals(
            self.drive_torque[first:last],
            self.viscous[first:last],
            self.low[first:last],
            self.width,
            None if self.idle is None else self.idle[first:last],
        )

    def joined(self, after: Signals) -> Signals:
        """Return these samples and those that follow."""
        return Signals(
            np.concatenate([self.drive_torque, after.drive_torque]),
            np.concatenate([self.viscous, after.viscous]),
            np.concatenate([self.low, after.low]),
            after.width,
            None
            if self.idle is None or after.idle is None
            else np.concatenate([self.idle, after.idle]),
        )


@dataclass(frozen=True)
class Estimate:
    """Estimate after each of m steps: all states (m, 12); the torque behind the low-pass, its
    deviation, both N m, the level of the torque's noise, and gains, (m, 9).

    `low` (m,) rad is the count's edge after each, `idle` (m,) where the motor has had no current
    for `IDLE_TIME`, `kept` what the smoother needs of the steps, None unless requested.
    """

    states: Array
    outputs: Array
    low: Array
    idle: Mask
    kept: tuple[Array, ...] | None = None

    @classmethod
    def joined(cls, parts: Sequence[Estimate]) -> Estimate:
        """Return estimates that follow one another as one, without what the smoother needs."""
        if len(parts) == 1:
            return parts[0]
        return cls(*joined(parts, "states", "outputs", "low", "idle"))

    @property
    def torque(self) -> Array:
        """Torque on the output, (m,) N m."""
        return self.states[:, TORQUE]

    @property
    def passed(self) -> Array:
        """Torque on the output behind the low-pass, (m,) N m."""
        return self.outputs[:, 0]

    @property
    def deviation(self) -> Array:
        """Its standard deviation, (m,) N m."""
        return self.outputs[:, 1]

    @property
    def opened(self) -> Mask:
        """Where the noise of the torque is raised, (m,)."""
        return self.outputs[:, 2] > 0

    @property
    def gains(self) -> Array:
        """Change of the states `kalman.FOLLOWED` for each radian of the angle, (m, 6)."""
        return self.outputs[:, kalman.FIRST_GAIN :]


class Filter:
    """The causal estimate; samples are added as they come, in blocks of any length.

    Torque behind the low-pass and its deviation are for a corner of `corner_hz` Hz.
    """

    def __init__(
        self, plant: Plant, uncertainty: Uncertainty, step_samples: int, corner_hz: float
    ) -> None:
        self._plant, self._uncertainty, self._size = plant, uncertainty, step_samples
        self._low_pass = passed.section(corner_hz, step_samples * plant.sample_time)
        self._waiting: Signals | None = None
        self._state: NDArray[np.void] | None = None
        self._idle_steps = idle_steps(step_samples * plant.sample_time)
        self._idle = self._idle_steps  # as if there had been no current before

    @property
    def last_deviation(self) -> float:
        """Standard deviation of the torque after the last step, before the low-pass, N m."""
        if self._state is None:
            return 0.0
        return float(np.sqrt(self._state["covariance"][0, TORQUE, TORQUE]))

    def pieces(self, signals: Signals, steps: int) -> tuple[Signals, Signals]:
        """Return the first samples, which complete no more than some steps, and the others."""
        waiting = 0 if self._waiting is None else self._waiting.low.size
        end = max(0, steps * self._size + 1 - waiting)
        return signals.part(0, end), signals.part(end, None)

    def ends(self, signals: Signals) -> Array:
        """Return the angle after every step that these samples complete, (m,) rad: the middle of
        its count."""
        waiting = 0 if self._waiting is None else self._waiting.low.size
        return signals.low[self._size - waiting :: self._size] + signals.width / 2

    def add(
        self,
        signals: Signals,
        *,
        keep: bool = False,
        less: Array | None = None,
        least: Array | None = None,
    ) -> Estimate:
        """Return the estimate after every step that these samples complete, m of them.

        `less` (m,) N m is subtracted from the drive torque in each; `least` (m,) are the lowest
        levels of the torque's noise.
        """
        if self._waiting is not None:
            signals = self._waiting.joined(signals)
        if self._state is None and signals.low.size:
            start = float(signals.low[0])
            self._state = kalman.begin(
                self._plant, self._uncertainty, start, signals.width, self._low_pass
            )
        size, count = self._size, max(0, (signals.low.size - 1) // self._size)
        self._waiting = signals.part(count * size, None)
        kept = smoother.room(count, size) if keep else None
        low = np.ascontiguousarray(signals.low[size : count * size + 1 : size])
        found = Estimate(
            np.empty((count, STATES)),
            np.empty((count, kalman.OUTPUTS)),
            low,
            self._still_idle(signals.idle, count),
            kept,
        )
        if self._state is None or not count:
            return found
        torque = signals.drive_torque[: count * size].reshape(count, size)
        kalman.run(
            self._state,
            as_record(self._plant),
            as_record(self._uncertainty),
            self._plant.friction_map,
            torque if less is None else torque - less[:, None],
            signals.viscous[: count * size].reshape(count, size),
            low,
            signals.width,
            found.idle,
            self._low_pass,
            np.zeros(count) if least is None else np.ascontiguousarray(least[:count]),
            found.states,
            found.outputs,
            smoother.room(0, size) if kept is None else kept,
        )
        return found

    def _still_idle(self, idle: Mask | None, count: int) -> Mask:
        """Return the steps (count,) in which the motor has had no current for `IDLE_TIME`, from the
        samples without one (n,): a current that passes zero is absent for moments only."""
        if idle is None or not count:
            return np.zeros(count, dtype=np.bool_)
        size, step = self._size, np.arange(1, count + 1)
        none = idle[size - 1 : count * size : size] & idle[size : count * size + 1 : size]
        lasting = step - np.maximum.accumulate(np.where(none, -self._idle, step))
        self._idle = min(int(lasting[-1]), self._idle_steps)
        return lasting >= self._idle_steps
