"""How much the heat of the winding lowers the torque constant while a motor holds a torque.

A thermometer on the housing shows the winding's heat late and only a part of it. Under a constant
torque the current itself shows the change: k i is constant, so that for turn n of a recording

    log i_n - L_n(tau) = a + g H_n(tau),   dH/dt = (i^2 r - H)/tau,   dL/dt = (h - L)/tau

with a constant a for each recording, and one g and one time constant tau for all. h is the fall of
log k by the housing's temperature, which the winding follows late, r the resistance of copper
at the housing's temperature over that at the first. H and L are first-order lags (Incropera,
DeWitt, Fundamentals of Heat and Mass Transfer, 6th ed., 2007, section 5.1); before the first
recording H is zero, and L is h. Before the first turn of a recording and after the last one, the
current is taken as in that turn, and h stands still. Least squares, friction's scatter
being the same torque at any current; tau is not needed itself: its values are averaged over by
their likelihood.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rigtool.numerics.arrays import TINY, Array

TIME_CONSTANTS = np.geomspace(3.0, 300.0, 97)
"""Of a winding against its housing, s: from motors of some grams to some kilograms. Long recordings
show it to some per cent: 10 % off it, the fall is 5 % off."""

MODEL_U = 0.03
"""Relative standard uncertainty of what a first-order lag shows: copper that is warmer than the
housing resists more, by some per cent as it warms (3 % on two masses of 10 W)."""

FEWEST_TURNS = 4
"""Turns more than recordings at constant torque, for two parameters and a scatter."""


@dataclass(frozen=True, eq=False)
class TurnCurrents:
    """Turns of a recording: their beginnings and the last end `passed` (n + 1,) s, mean `current`
    (n,) A; `recorded`, when the recording began and ended, s; `steady` where something other than
    friction holds the torque constant; `housing` (n + 1,), the fall of log k at these times by
    the housing's temperature; `resistance` (n,) of copper at that temperature, over
    that at a temperature common to all recordings.
    """

    recorded: tuple[float, float]
    passed: Array
    current: Array
    steady: bool
    housing: Array
    resistance: Array


@dataclass(frozen=True, eq=False)
class Lowered:
    """`fall` of log k where turns begin and end (n + 1,), as the winding differs from the
    housing; the standard uncertainty `u` of its mean."""

    fall: Array
    u: float


def winding_heat(recordings: Sequence[TurnCurrents]) -> list[Lowered]:
    """Return by how much heat lowered k in each recording; zero where none shows it."""
    heat = _heat(recordings)
    steady = [n for n, own in enumerate(recordings) if own.steady and own.current.all()]
    turns = sum(recordings[n].current.size for n in steady)
    if turns < len(steady) + FEWEST_TURNS:
        return [Lowered(np.zeros(own.passed.size), 0.0) for own in recordings]
    slope, variance, likelihood = _slopes(
        [heat[n] for n in steady], [recordings[n] for n in steady]
    )
    found = []
    for levels, late in heat:
        each = slope[:, None] * levels + late
        mean, fall = each.mean(axis=1), likelihood @ each
        spread = variance * levels.mean(axis=1) ** 2 + (mean - fall.mean()) ** 2
        model = MODEL_U * float(np.abs((likelihood * slope) @ levels).mean())
        found.append(Lowered(fall, float(np.hypot(np.sqrt(likelihood @ spread), model))))
    return found


def _heat(recordings: Sequence[TurnCurrents]) -> list[tuple[Array, Array]]:
    """Return H, and L - h, where turns begin and end, (time constants, turns + 1) each."""
    state, before = np.zeros((2, TIME_CONSTANTS.size)), np.inf
    found: dict[int, tuple[Array, Array]] = {}
    for number in sorted(range(len(recordings)), key=lambda n: recordings[n].recorded):
        turns = recordings[number]
        begin, end = turns.recorded
        state = state * np.exp(-max(0.0, begin - before) / TIME_CONSTANTS)
        warm = (turns.housing[1:] + turns.housing[:-1]) / 2
        power = turns.current**2 * turns.resistance * np.exp(warm)  # a kelvin lowers log k by more
        power = np.concatenate([power[:1], power, power[-1:]])
        change = np.concatenate([[0.0], np.diff(turns.housing), [0.0]])
        states = []
        durations = np.diff([begin, *turns.passed, end])
        for duration, square, rise in zip(durations, power, change, strict=True):
            # L tends to lag behind h by what that rises in a time constant.
            lag = -rise / max(duration, TINY) * TIME_CONSTANTS
            goal = np.stack([np.full(TIME_CONSTANTS.size, square), lag])
            state = goal + (state - goal) * np.exp(-duration / TIME_CONSTANTS)
            states.append(state)
        levels, late = np.array(states[:-1]).transpose(1, 2, 0)
        found[number], before = (levels, late), end
    return [found[number] for number in range(len(recordings))]


def _slopes(
    heat: Sequence[tuple[Array, Array]], recordings: Sequence[TurnCurrents]
) -> tuple[Array, Array, Array]:
    """Return g, its variance and the likelihood of each time constant, (time constants,)."""
    rows, changes = [], []
    for (levels, late), turns in zip(heat, recordings, strict=True):
        weight, fall = np.abs(turns.current), turns.housing + late
        middle, fallen = ((ends[:, 1:] + ends[:, :-1]) / 2 for ends in (levels, fall))
        change = np.log(weight) - fallen
        share = weight**2 / np.sum(weight**2)  # the constant of the recording is taken off
        rows.append(weight * (middle - (middle @ share)[:, None]))
        changes.append(weight * (change - (change @ share)[:, None]))
    row, change = np.concatenate(rows, axis=1), np.concatenate(changes, axis=1)
    power = np.maximum(np.sum(row**2, axis=1), TINY)
    slope = np.sum(row * change, axis=1) / power
    left = np.sum((change - slope[:, None] * row) ** 2, axis=1)
    least, free = max(float(left.min()), TINY), change.shape[1] - len(recordings) - 2
    likelihood = np.maximum(left / least, 1.0) ** (-free / 2)
    return slope, least / free / power, likelihood / likelihood.sum()
