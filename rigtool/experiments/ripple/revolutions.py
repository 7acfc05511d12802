"""Mean torque of a turning rotor by revolution and cell of the turn, block by block.

    mean = (integral at the cell's end - integral at its start) / time in the cell

Only time and integral of the torque at the edges of the cells are kept, so that memory grows with
revolutions, not samples. Synchronous (time domain) averaging: S. Braun, Acustica 32, 69-77, 1975.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from rigtool.errors import InsufficientDataError
from rigtool.numerics.arrays import Array
from rigtool.numerics.checks import rising_steps


class Revolutions:
    """Collects blocks of a steadily turning rotor; the turn has `positions` equal cells.

    With `forward`, the angle grows with time.
    """

    def __init__(self, positions: int, *, forward: bool) -> None:
        self._positions = positions
        self._forward = forward
        self._samples = 0
        # The last sample, where blocks are joined.
        self._time, self._advance, self._torque = (np.zeros(0) for _ in range(3))
        self._integral = 0.0
        self._next_edge = 0
        self._start = 0.0
        self._passed: list[Array] = []
        self._integrals: list[Array] = []
        self._firsts: list[NDArray[np.intp]] = []

    def add(self, time: Array, turns: Array, torque: Array) -> None:
        """Take the next samples: time (n,) in s, the rotor's angle in turns, torque.

        Raises `InsufficientDataError` where time does not rise, or the rotor turns more than once
        from sample to sample.
        """
        if not time.size:
            return
        advance = turns if self._forward else -turns
        if not self._samples:
            self._next_edge = math.ceil(advance[0]) * self._positions
            self._start = float(advance[0])
        time = np.concatenate([self._time, time])
        torque = np.concatenate([self._torque, torque])
        advance = np.concatenate([self._advance, advance])
        if np.any(advance[1:] < advance[:-1]):
            # An encoder may step back by a count; the running maximum only advances.
            advance = np.maximum.accumulate(advance)
        areas = rising_steps(time, self._samples - self._time.size)
        areas *= torque[1:] + torque[:-1]
        self._samples += time.size - self._time.size
        self._time, self._advance, self._torque = time[-1:], advance[-1:], torque[-1:]
        if areas.size:
            self._pass_edges(time, advance, torque, areas)

    def _pass_edges(self, time: Array, advance: Array, torque: Array, areas: Array) -> None:
        """Keep the time at which the rotor first reaches each edge between cells, and the integral.

        Torque goes straight from sample to sample; `areas` are twice the integrals between them.
        """
        if (way := float(advance[-1] - advance[0])) > areas.size:  # edges would fill the memory
            raise InsufficientDataError(
                f"the rotor turns {way:.3g} times in {areas.size} samples, more than once from one "
                "to the next: its encoder leaps, or its counts are wrong; record it again"
            )
        stop = math.floor(advance[-1] * self._positions) + 1
        edges = np.arange(self._next_edge, stop) / self._positions
        edges = edges[edges <= advance[-1]]
        reached = np.searchsorted(advance, edges, side="left")
        before = np.maximum(reached - 1, 0)
        low, high = advance[before], advance[before + 1]
        part = np.clip((edges - low) / np.where(high > low, high - low, 1.0), 0.0, 1.0)
        bounds = np.concatenate([[0], before])
        sums = np.add.reduceat(areas, bounds)
        sums[:-1][np.diff(bounds) == 0] = 0.0  # where reduceat gives one element, not none
        integral = self._integral + np.cumsum(sums) / 2
        since = part * (time[before + 1] - time[before])
        mean = torque[before] + part / 2 * (torque[before + 1] - torque[before])
        self._passed.append(time[before] + since)
        self._integrals.append(integral[:-1] + since * mean)
        turns = reached[-self._next_edge % self._positions :: self._positions]
        self._firsts.append(self._samples - time.size + turns)
        self._integral = float(integral[-1])
        self._next_edge += edges.size

    @property
    def step(self) -> float:
        """Mean part of a turn from one sample to the next; 0 with fewer than two samples."""
        if self._samples < 2:
            return 0.0
        return (float(self._advance[-1]) - self._start) / (self._samples - 1)

    def turns(self) -> tuple[Array, Array, NDArray[np.intp]]:
        """Return when each whole turn began, and the last one ended, (turns + 1,) s, the mean
        torque of each, (turns,), and the first sample at or after each beginning and the last end,
        (turns + 1,)."""
        passed, integral = (
            np.concatenate([np.zeros(0), *parts])[:: self._positions]
            for parts in (self._passed, self._integrals)
        )
        firsts = np.concatenate([np.zeros(0, np.intp), *self._firsts])
        return passed, np.diff(integral) / np.diff(passed), firsts

    def cells(self) -> Array:
        """Return the mean torque of each cell, (cells,), in the order in which they are passed."""
        passed, integral = (
            np.concatenate([np.zeros(0), *parts]) for parts in (self._passed, self._integrals)
        )
        with np.errstate(invalid="ignore"):  # edges that are passed at once
            means: Array = np.diff(integral) / np.diff(passed)
        return means

    def passed(self, revolutions: int) -> Array:
        """Return when the rotor passes the edges of the cells in the last `revolutions` whole
        turns, (revolutions*positions + 1,), s."""
        passed = np.concatenate(self._passed)
        last = (passed.size - 1) // self._positions * self._positions
        return passed[last - revolutions * self._positions : last + 1]

    def durations(self, revolutions: int) -> Array:
        """Return how long the rotor takes for each cell in the last `revolutions` whole turns,
        (revolutions, positions), s, the cells in the order of their angle."""
        taken: Array = np.diff(self.passed(revolutions)).reshape(revolutions, self._positions)
        return taken if self._forward else taken[:, ::-1]

    def waveforms(self, revolutions: int) -> Array:
        """Return the mean torque by revolution and cell, of the last `revolutions` whole turns.

        A cell's value is the mean over the time that the rotor spends in it. Of (revolutions,
        positions) the second axis are the cells in the order of their angle. Raises
        `InsufficientDataError` where there are fewer turns.
        """
        cells = self.cells()
        whole = cells.size // self._positions
        if whole < revolutions:
            raise InsufficientDataError(
                f"{whole} whole revolutions in the recording, {revolutions} are needed: record "
                "for longer, or lower the number of revolutions"
            )
        first = (whole - revolutions) * self._positions
        used = cells[first : first + revolutions * self._positions]
        waveforms: Array = used.reshape(revolutions, self._positions)
        # Backwards, the last cell of the turn is passed first.
        return waveforms if self._forward else waveforms[:, ::-1]
