"""The check that runs are of the instrument and mounting on which a load model was learned.

At one place x of the stroke, the torque of strokes in positive and in negative direction differs by
d(x), which the learned loads do by themselves. Friction or tendons of another instrument open or
close this loop, by one amount or differently along the stroke. With mean m(x) of d over the
recordings that were learned, by the sensor,

    offset o = mean over x of d - m,   shape s(x) = d - m - o,
    T = max(|o| / S_o, root of the mean over x of (s / S_s)^2)

S are the root mean squares of o and s over those recordings, each as measured when it was left out
with its load, or with others where that is the lowest or the highest: what few loads leave unknown
of the friction between them is part of S. T is about 1; Student's t with the number of recordings
less one states how far it may be. Of n runs the median of T is known better than one: they are as
1 / (c + (1 - c) / n) that are independent, and T^2 goes as F with so many degrees of freedom, where
c is what runs at one load or speed have in common. So is the mean of o: of r recordings, its
standard deviation is S_o sqrt(c + (1 - c) / n + 1 / r).

A load that changes in time acts on other strokes to than fro, which may be another mounting or
not. With n+ and n- strokes the variance of d is v = s^2 (1 / n+ + 1 / n-) by it, where s^2 is the
mean square about the mean of a direction, with n+ + n- - 2 degrees of freedom. What is refused is
T / r with r^2 = 1 + v / S_o^2; u grows by the whole of T.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rigtool.experiments.imported_load.region import STROKE_CELLS, cell_means, strokes_of
from rigtool.numerics.arrays import Array, Mask

FEWEST_ROWS = 3
"""Fewest rows of a mean in a cell."""

FEWEST_CELLS = 3
"""Cells with both directions, below which a loop is not compared."""

COMMON_SHARE = 0.25
"""Share c of the variance of offsets: some for loads, more for speeds that were left out."""

DOUBTED, REFUSED = 0.95, 0.99
"""Two-sided levels of confidence: beyond the first u grows, beyond the second nothing is given."""


@dataclass(frozen=True, eq=False)
class StrokeLoop:
    """Of so many recordings, without unit: `mean` of the loop in each cell of the stroke and
    root mean square of its `shape` (c,), NaN where unknown, and that of its `offset`."""

    mean: Array
    shape: Array
    offset: float
    recordings: int

    def parts(self, place: Array, rising: Mask, torque: Array) -> tuple[float, float, float]:
        """Return o / S_o, with its sign, the shape's part of T, and r, of rows (n,) of one
        recording; NaN where too few cells have both directions."""
        apart = _loop(place, rising, torque) - self.mean
        known = np.isfinite(apart) & (self.shape > 0)
        if known.sum() < FEWEST_CELLS or not self.offset > 0:
            return math.nan, math.nan, math.nan
        apart = apart[known]
        offset = float(np.mean(apart))
        shape = float(np.sqrt(np.mean(((apart - offset) / self.shape[known]) ** 2)))
        changing = float(np.mean(_changing(place, rising, torque)[known]))
        return offset / self.offset, shape, math.sqrt(1 + changing / self.offset**2)

    def limit(self, confidence: float, runs: int = 1) -> float:
        """Return the T, of several runs the median, beyond which they are not like those learned.

        Of one run it is Student's t.
        """
        from scipy.special import fdtri

        independent = 1 / (COMMON_SHARE + (1 - COMMON_SHARE) / runs)
        return math.sqrt(float(fdtri(independent, max(self.recordings - 1, 1), confidence)))

    def limit_of_mean(self, confidence: float, runs: int) -> float:
        """Return the mean of o / S_o over `runs` beyond which they are not of this mounting."""
        variance = COMMON_SHARE + (1 - COMMON_SHARE) / runs + 1 / self.recordings
        return math.sqrt(variance) * self.limit(confidence)


def learn_loop(
    place: Array, rising: Mask, torque: Array, sensor: Array, recording: NDArray
) -> StrokeLoop:
    """Return the loop of recordings, from torques (n,) as measured when each was left out, and by
    the sensor."""
    numbers = [recording == n for n in np.unique(recording)]
    found, true = (
        np.array([_loop(place[own], rising[own], values[own]) for own in numbers])
        for values in (torque, sensor)
    )
    mean = _over_recordings(true, 0)
    apart = found - mean
    offset = np.array(
        [np.mean(row[np.isfinite(row)]) if np.isfinite(row).any() else np.nan for row in apart]
    )
    shape = np.sqrt(_over_recordings((apart - offset[:, None]) ** 2, 1))
    spread = math.sqrt(float(_over_recordings(offset[:, None] ** 2, 1)[0]))
    return StrokeLoop(mean, shape, spread, len(found))


def _over_recordings(values: Array, taken: int) -> Array:
    """Return the sum of values (r, c) over their number less `taken`, NaN where that is zero."""
    known = np.isfinite(values)
    count = np.maximum(known.sum(axis=0) - taken, 0)
    with np.errstate(invalid="ignore", divide="ignore"):
        found: Array = np.where(known, values, 0.0).sum(axis=0) / count
    return np.where(count > 0, found, np.nan)


def _loop(place: Array, rising: Mask, torque: Array) -> Array:
    """Return the difference of the directions in each cell (c,), NaN where one is missing."""
    known = np.isfinite(torque)
    up, down = (cell_means(place, torque, known & way, FEWEST_ROWS) for way in (rising, ~rising))
    return up - down


def _changing(place: Array, rising: Mask, torque: Array) -> Array:
    """Return the variance (c,) of a loop by how strokes of one direction differ; cells with one
    stroke in each have the usual one, 0 where there is none."""
    stroke = strokes_of(np.where(rising, 1.0, -1.0))
    squares, dof, parts = np.zeros((3, STROKE_CELLS))
    for way in (rising, ~rising):
        rows = way & np.isfinite(torque)
        own = [cell_means(place, torque, rows & (stroke == n)) for n in np.unique(stroke[rows])]
        count = np.isfinite(own).sum(axis=0)
        squares += np.nansum((own - _over_recordings(np.array(own), 0)) ** 2, axis=0)
        dof += np.maximum(count - 1, 0)
        parts += 1 / np.maximum(count, 1)
    usual = squares.sum() / max(dof.sum(), 1)
    return parts * np.where(dof > 0, squares / np.maximum(dof, 1), usual)
