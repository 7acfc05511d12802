"""How much the heat of the winding lowers the torque constant while a motor holds a torque.

A thermometer on the housing shows the winding's heat late and only a part of it. Under a constant
torque the current itself shows the change: k i is constant, so that for turn n of a recording

    log i_n - (fall of k by the housing's temperature) = a + g H_n(tau),   dH/dt = (i^2 - H)/tau

with a constant a for each recording, and one g and one time constant tau for all. H is the square
of the current through a first-order lag (Incropera, DeWitt, Fundamentals of Heat and Mass Transfer,
6th ed., 2007, section 5.1), zero before the first recording. Before the first turn of a recording
and after the last one, the current is taken as in that turn. Least squares, friction's scatter
being the same torque at any current; tau is not needed itself: its values are averaged over by
their likelihood.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rigtool.numerics.arrays import TINY, Array

TIME_CONSTANTS = np.geomspace(3.0, 300.0, 25)
"""Of a winding against its housing, s: from motors of some grams to some kilograms."""

FEWEST_TURNS = 4
"""Turns more than recordings at constant torque, for two parameters and a scatter."""


@dataclass(frozen=True, eq=False)
class TurnCurrents:
    """Turns of a recording: their beginnings and the last end `passed` (n + 1,) s, mean `current`
    (n,) A; `recorded`, when the recording began and ended, s; `steady` where something other than
    friction holds the torque constant; `housing`, the relative fall of k from the first to the last
    of them by the housing's temperature.
    """

    recorded: tuple[float, float]
    passed: Array
    current: Array
    steady: bool
    housing: float


@dataclass(frozen=True, eq=False)
class Lowered:
    """Relative `fall` of k by the winding's heat where turns begin and end (n + 1,); the standard
    uncertainty `u` of its mean."""

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
    for own in heat:
        mean = slope * own.mean(axis=1)
        spread = likelihood @ (variance * own.mean(axis=1) ** 2 + (mean - likelihood @ mean) ** 2)
        found.append(Lowered((likelihood * slope) @ own, float(np.sqrt(spread))))
    return found


def _heat(recordings: Sequence[TurnCurrents]) -> list[Array]:
    """Return H where turns begin and end, (time constants, turns + 1), of each recording."""
    level, before = np.zeros(TIME_CONSTANTS.size), np.inf
    found: dict[int, Array] = {}
    for number in sorted(range(len(recordings)), key=lambda n: recordings[n].recorded):
        turns = recordings[number]
        begin, end = turns.recorded
        level = level * np.exp(-max(0.0, begin - before) / TIME_CONSTANTS)
        current = np.concatenate([turns.current[:1], turns.current, turns.current[-1:]])
        levels = []
        for duration, square in zip(np.diff([begin, *turns.passed, end]), current**2, strict=True):
            level = square + (level - square) * np.exp(-duration / TIME_CONSTANTS)
            levels.append(level)
        found[number], before = np.array(levels[:-1]).T, end
    return [found[number] for number in range(len(recordings))]


def _slopes(
    heat: Sequence[Array], recordings: Sequence[TurnCurrents]
) -> tuple[Array, Array, Array]:
    """Return g, its variance and the likelihood of each time constant, (time constants,)."""
    rows, changes = [], []
    for levels, turns in zip(heat, recordings, strict=True):
        count, weight = turns.current.size, np.abs(turns.current)
        fall = turns.housing * ((np.arange(count) + 0.5) / count - 0.5)
        middle, change = (levels[:, 1:] + levels[:, :-1]) / 2, np.log(weight) - fall
        share = weight**2 / np.sum(weight**2)  # the constant of the recording is taken off
        rows.append(weight * (middle - (middle @ share)[:, None]))
        changes.append(weight * (change - change @ share))
    row, change = np.concatenate(rows, axis=1), np.concatenate(changes)
    power = np.maximum(np.sum(row**2, axis=1), TINY)
    slope = row @ change / power
    left = np.sum((change - slope[:, None] * row) ** 2, axis=1)
    least, free = max(float(left.min()), TINY), change.size - len(recordings) - 2
    likelihood = np.maximum(left / least, 1.0) ** (-free / 2)
    return slope, least / free / power, likelihood / likelihood.sum()
