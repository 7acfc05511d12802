"""What a drive does at each step: its error depends on that, and whether it is known at all.

With rotor speed w, deflection h of the long bristle (`plant`) and torque M on the output,

    still        the encoder passes one edge at most within `STILL_TIME`
    reversed     h sign(w) < `SLIDING`: friction is not yet that of sliding
    against      M w >= 0,   with   M w < 0
    outside      angle, speed, torque or temperature beyond what was learned
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
States = NDArray[np.int32]

STILL_TIME = 0.1
"""Within this time, s, a rotor that stands still passes one edge of the encoder at most."""

SPEED_TIME = 0.05
"""That a speed is the mean over, s, where it is compared with what was learned."""

SLIDING = 0.9
"""Part of its deflection at which friction is that of sliding."""

BEYOND = 1.1
"""Of speed and torque that were learned: what is given nonetheless."""

BEYOND_ANGLE = 0.01
"""Of the range of angles, on both sides."""


class State(IntEnum):
    """The numbers are those in run files."""

    OUTSIDE = 0
    AGAINST = 1
    WITH = 2
    REVERSED = 3
    STILL = 4


NAMES = {
    State.OUTSIDE: "outside what was learned: no value",
    State.AGAINST: "moving against the load",
    State.WITH: "moving with the load",
    State.REVERSED: "after a reversal",
    State.STILL: "standing still",
}


@dataclass(frozen=True)
class Reach:
    """How far a model was learned: angle of the rotor rad, its speed rad/s, torque on the output
    N m, and temperature of the motor degC."""

    angle: tuple[float, float]
    speed: float
    torque: float
    temperature_degc: tuple[float, float]

    def left_by(
        self, angle: Array, speed: Array, torque: Array, temperature_degc: Array
    ) -> NDArray[np.bool_]:
        """Return where these (m,) are beyond what was learned."""
        low, high = self.angle
        margin = BEYOND_ANGLE * (high - low)
        cold, warm = self.temperature_degc
        found: NDArray[np.bool_] = (
            (angle < low - margin)
            | (angle > high + margin)
            | (np.abs(speed) > BEYOND * self.speed)
            | (np.abs(torque) > BEYOND * self.torque)
            | (temperature_degc < cold)
            | (temperature_degc > warm)
        )
        return found


def moving_states(
    low: Array, speed: Array, housing: Array, torque: Array, count: float, step_time: float
) -> States:
    """Return the state at each of m steps.

    `low` rad is the lower edge of the angle's count and `count` rad its width, `speed` rad/s and
    the deflection of the long bristle `housing` are the filter's, `torque` N m is that on the
    output, positive where it resists positive motion. All (m,).
    """
    from scipy.ndimage import maximum_filter1d, minimum_filter1d

    width = 2 * max(1, round(STILL_TIME / step_time / 2)) + 1
    way = maximum_filter1d(low, width) - minimum_filter1d(low, width)
    direction = np.sign(speed)
    found = np.where(torque * direction >= 0, State.AGAINST, State.WITH)
    found[housing * direction < SLIDING] = State.REVERSED
    found[way < 1.5 * count] = State.STILL
    states: States = found.astype(np.int32)
    return states


def mean_speed(low: Array, step_time: float) -> Array:
    """Return the mean speed about each step (m,), rad/s, from angles rad."""
    half = max(1, round(SPEED_TIME / step_time / 2))
    size = len(low)
    after = np.minimum(np.arange(size) + half, size - 1)
    before = np.maximum(np.arange(size) - half, 0)
    speed: Array = (low[after] - low[before]) / (np.maximum(after - before, 1) * step_time)
    return speed
