"""How far the torque swings, of which a rotor that is held shows nothing.

A force that goes on to swing while the rotor rests within a count of the encoder shows nowhere:
friction takes it up. The filter, which expects a random walk, finds the torque of before. Where
the rotor slides, the swing shows. With the torque M and its mean M0 of memory `LEVEL_TIME`,

    v = median of (M - M0)^2,   the variance of a sine,   v - v0 beyond that of noise

A pulse is away from M0 for some `LEVEL_TIME` after either edge only; a force that swings is so most
of the time, which the median shows. While the rotor slides, each step raises
or lowers v by the same factor (H. Robbins, S. Monro, Ann. Math. Stat. 22(3), 1951), so that it is
exceeded half of the time.
"""

from __future__ import annotations

import math

import numpy as np

from rigtool.experiments.force_filter.motion_states import State, States
from rigtool.numerics.arrays import Array
from rigtool.numerics.compiled import compiled

LEVEL_TIME = 0.1
"""Memory of the mean, s: 0.53 of a sine of 1 Hz is away from it, and most of faster ones."""

SWING_TIME = 0.25
"""Time, s, in which the median changes by a factor e."""

LEAST_SWING = 0.5
"""Root of v0, in deviations of a stroke's friction: that of a torque that does not swing."""

TAKEN_VARIANCE = 0.05**2 / 3
"""Part of v by which u^2 grows: the filter takes up to 5 % of the amplitude, as a bandwidth states,
a rectangle from 0 on."""

OUTSIDE, AGAINST, WITH = int(State.OUTSIDE), int(State.AGAINST), int(State.WITH)


class Swinging:
    """Follows steps of `step_time` s as they come; `least` N2 m2 is v0."""

    def __init__(self, least: float, step_time: float) -> None:
        numbers = math.exp(-step_time / LEVEL_TIME), *factors(step_time), least
        self._numbers, self._state = np.array(numbers), np.array([0.0, least])

    def add(self, torque: Array, states: States) -> Array:
        """Return v - v0, (m,) N2 m2, of the torque (m,) N m; steps outside what was learned change
        nothing."""
        found = np.empty(len(torque))
        _follow(self._state, self._numbers, np.ascontiguousarray(torque), states, found)
        return found


def factors(step_time: float) -> tuple[float, float]:
    """Return by what the median grows and falls in a step."""
    falls = math.exp(-step_time / SWING_TIME)
    return 1 / falls, falls


@compiled
def _follow(state: Array, numbers: Array, torque: Array, states: States, found: Array) -> None:
    """Advance mean and median by the steps (m,)."""
    kept, grows, falls, least = numbers
    for k in range(torque.shape[0]):
        away = torque[k] - state[0]
        if states[k] != OUTSIDE:
            state[0] = torque[k] - kept * away
        if states[k] == AGAINST or states[k] == WITH:
            state[1] = max(state[1] * (grows if away * away > state[1] else falls), least)
        found[k] = state[1] - least
