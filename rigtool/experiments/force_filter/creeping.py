"""Where a rotor creeps by steps, so that the filter does not know how far its bristles are bent.

A loop that moves a rotor slowly swings it about each edge of the encoder, within a count. Friction
bends and yields with each swing, and no count shows how wide they are: the filter may find M off by
some of friction for as long as the rotor creeps. The way s that a rotor has gone in one direction,
since it turned or rested, leaves of what its bristle h lacks

    q = 1 - h sign(s),   q = q0 exp(-s / x0)

at the length x0 of the bristle. A swing takes the rotor back, so that the filter finds q to be more
than that. What friction F lacks there, q F, is known to be between nothing and that.
"""

from __future__ import annotations

import math

import numpy as np

from rigtool.experiments.force_filter.motion_states import SLIDING_DEFLECTION
from rigtool.numerics.arrays import Array, Mask
from rigtool.numerics.compiled import compiled

MORE = 2.0
"""Multiple of what the way leaves of q from which on the rotor swings."""

RESTED_TIME = 0.15
"""Time, s, that a rotor stands still until its way begins anew: one that creeps does so between two
edges, too."""


LASTING_TIME = 0.5
"""Time, s, that it swings before that counts: turns of strokes take less, and within it M, a random
walk, does not take up what friction lacks."""


def steps_of(time: float, step_time: float) -> int:
    """Return the steps of `step_time` s in a time, s."""
    return max(1, round(time / step_time))


class Creeping:
    """Follows steps as they come; `count` rad is the encoder's, `presliding_angle` rad the length
    x0, and `step_time` s that of a step."""

    def __init__(self, count: float, presliding_angle: float, step_time: float) -> None:
        self._numbers = np.array(
            [count, presliding_angle]
            + [steps_of(time, step_time) for time in (RESTED_TIME, LASTING_TIME)]
        )
        self._state = np.array([1.0, math.nan, 0.0, 0.0, 0.0, 0.0])

    def add(self, low: Array, housing: Array, still: Mask) -> Array:
        """Return q where the rotor has swung while it creeps, else 0, (m,), from the edge of its
        count rad, the bristle h, and where the rotor stands still, (m,)."""
        found = np.zeros(len(low))
        _follow(self._state, self._numbers, low, np.ascontiguousarray(housing), still, found)
        return found


@compiled
def _follow(
    state: Array, numbers: Array, low: Array, housing: Array, still: Mask, found: Array
) -> None:
    """Advance direction, place and q of the turn, the farthest place since, steps at rest, and
    steps since it began to swing, by the steps (m,)."""
    count, length, rested, lasting = numbers
    for k in range(low.shape[0]):
        turns = housing[k] * state[0] < -0.5 or math.isnan(state[1])
        if housing[k] * state[0] < -0.5:
            state[0] = -state[0]
        lacks, place = 1.0 - state[0] * housing[k], state[0] * low[k]
        state[4] = state[4] + 1.0 if still[k] else 0.0
        if turns or state[3] - place > 1.5 * count or state[4] >= rested:
            state[1], state[2], state[3], state[5] = place, lacks, place, 0.0
        if place > state[3]:  # it goes on: where it stays, it may turn
            state[3] = place
            bent = MORE * state[2] * math.exp(-(place - state[1] - count) / length)
            swings = lacks > max(bent, 1.0 - SLIDING_DEFLECTION)
            state[5] = max(state[5], 1.0) if swings else 0.0
        found[k] = lacks if state[5] >= lasting else 0.0
        state[5] += 1.0 if state[5] > 0.0 else 0.0
