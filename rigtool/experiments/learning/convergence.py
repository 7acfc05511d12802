"""Learning run by run: the result of each run, and the criterion to end [Fig. 44, 45].

    f(k+1) = Q (f(k) + p L q(k))

One more update would change the table by D_i = Q (f(k) + p L q_i) - f(k), for each cycle i of a
run. The mean of D_i over m cycles contains the repeatable part still to be learned, and noise: the
scatter of single cycles over m, and the earlier scatter in f(k). For noise of variance s^2/m in
each run, that of f(k) is g(k) s^2/m with

    g(0) = 0,   g(k+1) = (1 - p)^2 g(k) + p^2

Learning is finished where the power of the mean of D is not above p^2 (1 + g(k)) s^2/m.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rigtool.experiments.learning.filters import Learning
from rigtool.experiments.learning.repeatable import repeatability
from rigtool.numerics.arrays import Array, Mask
from rigtool.numerics.jackknife import standard_uncertainty


def carried_noise(runs: int, factor: float) -> float:
    """Return g after this number of updates with the learning factor p."""
    carried = 0.0
    for _ in range(runs):
        carried = (1 - factor) ** 2 * carried + factor**2
    return carried


@dataclass(frozen=True, eq=False)
class LearningRun:
    """Result of one learning run, all its speeds together, within the band of Q.

    `rms` and `peak` are of the repeatable part, `scatter` is the rms of a single cycle around the
    mean, in the unit of the signal; `dof` the degrees of freedom of both uncertainties. `ratio` is
    the power that another update would change over the power that noise explains, `limit` the value
    that noise alone exceeds once in a hundred times.
    """

    rms: float
    rms_u: float
    peak: float
    peak_u: float
    dof: int
    scatter: float
    ratio: float
    limit: float

    @property
    def finished(self) -> bool:
        """Whether no repeatable part is left that another update would change."""
        return self.ratio <= self.limit


@dataclass(frozen=True, eq=False)
class Cycles:
    """Repeated cycles of one speed: `signal` (m, n), `before` (n,) fed forward, period in s.

    `used` (n,) marks the part of a cycle that the table covers; only that part counts.
    """

    period: float
    signal: Array
    before: Array
    used: Mask


def learning_run(
    found: Sequence[Cycles], learning: Learning, updates: int, shown: Sequence[Array] | None = None
) -> LearningRun:
    """Judge one run: the cycles of all its speeds, after so many `updates`.

    Rms, peak and scatter are those of the cycles `shown` (m, n), if given, else of the signals.
    Standard uncertainties by the jackknife: cycle i is left out at all speeds at once.
    """
    judged = [c.signal for c in found] if shown is None else shown
    smoothed = [
        learning.smoothed(signal, c.period)[:, c.used]
        for signal, c in zip(judged, found, strict=True)
    ]
    count = min(len(cycles) for cycles in smoothed)
    mean = [cycles.mean(axis=0) for cycles in smoothed]
    without = [(cycles.sum(axis=0) - cycles[:count]) / (len(cycles) - 1) for cycles in smoothed]
    squares = np.mean([np.mean(m**2) for m in mean])
    squares_without = np.mean([np.mean(m**2, axis=1) for m in without], axis=0)
    peaks_without = np.max([np.abs(m).max(axis=1) for m in without], axis=0)
    scatter = np.mean([cycles.var(axis=0, ddof=1).mean() for cycles in smoothed])
    tests = [_still_to_learn(cycles, learning, updates) for cycles in found]
    ratio, limit = max(tests, key=lambda test: test[0] / test[1])
    return LearningRun(
        rms=float(np.sqrt(squares)),
        rms_u=standard_uncertainty(np.sqrt(squares_without)),
        peak=float(max(np.abs(m).max() for m in mean)),
        peak_u=standard_uncertainty(peaks_without),
        dof=count - 1,
        scatter=float(np.sqrt(scatter)),
        ratio=ratio,
        limit=limit,
    )


def _still_to_learn(cycles: Cycles, learning: Learning, updates: int) -> tuple[float, float]:
    """Return ratio and limit for the change by another update."""
    updated = learning.updated(cycles.signal, cycles.period, cycles.before)
    change = (updated - cycles.before)[:, cycles.used]
    test = repeatability(change, 1 + carried_noise(updates, learning.factor))
    return test.ratio(), test.limit()
