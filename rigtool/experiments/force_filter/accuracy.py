"""Torque over time against a reference: error and coverage, by band of load and by state.

error = torque - reference,   coverage = share of |error| <= 1.96 u
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rigtool.experiments.force_filter.motion_states import State, States
from rigtool.numerics.arrays import Array, Mask

COVERAGE_FACTOR = 1.96
"""Coverage factor of a 95 % interval, normal distribution (GUM 6.2.2)."""

LOAD_BAND_EDGES = (0.0, 0.01, 0.05, 0.2, 1.0)
"""Edges of the bands of load, in parts of the largest learned torque."""

JUDGED_STATES = (State.AGAINST, State.WITH, State.REVERSED, State.STILL)


@dataclass(frozen=True)
class Accuracy:
    """`share` of all samples with a value that are among these; root mean square and mean of the
    error, N m; share of these samples whose interval holds the reference. NaN without samples."""

    share: float
    rmse: float
    bias: float
    coverage: float


def accuracy(error: Array, covered: Mask, among: Mask) -> Accuracy:
    """Return the accuracy of the samples `among` all; `error` N m is NaN without a value; (n,)."""
    valid = np.isfinite(error)
    chosen = among & valid
    if not chosen.any():
        return Accuracy(0.0, np.nan, np.nan, np.nan)
    own = error[chosen]
    return Accuracy(
        float(chosen.sum() / valid.sum()),
        float(np.sqrt(np.mean(own**2))),
        float(own.mean()),
        float(covered[chosen].mean()),
    )


def by_band_and_state(
    error: Array,
    covered: Mask,
    reference: Array,
    states: States,
    largest: float,
) -> list[list[Accuracy]]:
    """Return the accuracy in each of `LOAD_BAND_EDGES` (rows) and states `JUDGED_STATES` (columns).

    `largest` N m is the largest torque that was learned; all others (n,), see `accuracy`.
    """
    band = np.clip(
        np.searchsorted(LOAD_BAND_EDGES, np.abs(reference) / largest, side="right") - 1,
        0,
        len(LOAD_BAND_EDGES) - 2,
    )
    return [
        [accuracy(error, covered, (band == number) & (states == state)) for state in JUDGED_STATES]
        for number in range(len(LOAD_BAND_EDGES) - 1)
    ]


def off_zero(low: Array, high: Array) -> Array:
    """Return how far the intervals from `low` to `high` are from zero (n,).

    Negative where they hold it, minus infinity where there is no value.
    """
    return np.nan_to_num(np.maximum(low, -high), nan=-np.inf)
