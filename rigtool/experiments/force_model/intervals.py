"""From the filter's deviation to the standard uncertainty, by the state of motion.

    u^2 = (c s)^2 + (g M)^2 + r^2,   s the filter's deviation, M the torque on the output

r is the deviation of another power-up's ripple: no error under known loads has a part of it.
c and g of each kind of motion (`Judged.kinds`) are those whose 95 % intervals, half as wide as
h = 1.96 u, have the least score under known loads with errors e (T. Gneiting, A. E. Raftery, J. Am.
Stat. Assoc. 102(477) 359-378, 2007, section 6.2), in units of s:

    sum of (2 h + (2 / 0.05) max(|e| - h, 0)) / s

c is from errors without load, or from all where these are too few, and g from all, given c. While
the rotor slides, c is not from motions that friction was fitted to: they show how strokes differ,
and not how far the friction is off that they gave. The score is least where 95 % of the errors are
within h, whatever their tails: friction's are heavy after reversals and at rest. All that lies
within `INDEPENDENT_TIME` counts as one error; normal errors of `EXPECTED_RATIO` s, `EXPECTED` in
number, count besides. While the rotor slides, s follows from hundreds of strokes, so that they are
many there, but where no stroke has shown s. Known loads hardly change, as others may: where nothing
changes, errors are smaller than that, and show no c below `FACTORS`. Where a load does change, the
filter has raised the noise of its torque: c is 1 at least, as s holds no more than is needed then.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from rigtool.experiments.force_filter.accuracy import COVERAGE_FACTOR
from rigtool.experiments.force_filter.motion_states import CREEPING_KIND, KIND_COUNT, State, States
from rigtool.numerics.arrays import Array, Mask

TIME_APART = 20e-3
"""Time from one compared step to the next, s."""

INDEPENDENT_TIME = 1.0
"""Time that one independent error is worth, s: a stroke's own friction is one error."""

EXPECTED, SLIDING_EXPECTED = 2.0, 50.0
"""Errors that count as if they had been seen; while the rotor slides."""

EXPECTED_RATIO = 0.87
"""Their deviation over s. A filter's noise covers more than the errors that its equations make:
with every parameter true, the score under contacts is least at c = 0.86 (smoothed) and 0.85
(causal) while the rotor slides (17 virtual rigs, `benchmarks/oracle.py`); at 0.80 to 0.97 with 1000
to 4000 counts and 5 to 15 Hz. What is learned makes errors a little larger."""

INTERVAL_COVERAGE = 0.95
"""Of an interval that is `COVERAGE_FACTOR` u wide to either side."""

MIN_STEPS = 100
"""Compared steps of a kind without which its factors are those of all kinds."""

KINDS_TOGETHER = ((State.AGAINST, State.WITH), (State.REVERSED,), (State.STILL,), (CREEPING_KIND,))
"""Kinds that have one c and g."""

FACTORS, SHARES, GRID, PRECISION = (0.8, 20.0), (1e-4, 1.0), 12, 1e-3
"""Between which c and g are, how many of each are tried first, and the precision of the search.
With every parameter true, under contacts that come and go, the score after reversals and at rest is
least at c = 0.69 to 0.75, 1 % larger at 0.8; errors under weak loads are larger than without."""


@dataclass(frozen=True, eq=False)
class Errors:
    """Errors and deviations of smoothed and causal torque (2, m), N m, the `torque` that acted (m,)
    N m, and the kinds of motion (m,); `fitted` where sliding friction was learned from the same
    motion."""

    error: Array
    deviation: Array
    torque: Array
    kinds: States
    fitted: bool = False


def uncertainty_of_kinds(
    scales: Array,
    deviation: Array,
    torque: Array,
    kinds: States,
    variance: Array,
    opened: Mask,
    least: Array | float = 0.0,
) -> Array:
    """Return u (m,) N m by c and g of each kind, (kinds, 2); `variance` (m,) N2 m2 is r^2, `opened`
    (m,) where the noise of the torque is raised, and (c s)^2 is at `least` that, (m,) N2 m2."""
    factor, share = scales[kinds].T
    own = np.maximum((np.maximum(factor, opened) * deviation) ** 2, least)
    return np.sqrt(own + (share * torque) ** 2 + variance)


def scales(parts: Sequence[Errors], *, shown: bool = True) -> Array:
    """Return c and g of each kind, of smoothed and of causal torque, (2, kinds, 2); `shown` states
    whether strokes have shown how they deviate."""
    error, deviation = (
        np.hstack([getattr(part, name) for part in parts]) for name in ("error", "deviation")
    )
    torque = np.concatenate([part.torque for part in parts])
    kinds = np.concatenate([part.kinds for part in parts])
    free = torque == 0
    unseen = np.concatenate([np.full(len(part.kinds), not part.fitted) for part in parts])
    found = np.ones((2, KIND_COUNT, 2)) * (1.0, 0.0)
    of_all: dict[float, Array] = {}
    for together in KINDS_TOGETHER:
        chosen = np.isin(kinds, together)
        expected, own_free = EXPECTED, free
        if State.AGAINST in together:
            expected, own_free = SLIDING_EXPECTED if shown else EXPECTED, free & unseen
            own_free = own_free if (own_free & chosen).sum() >= MIN_STEPS else free
        if chosen.sum() >= MIN_STEPS:
            of_kind = error[:, chosen], deviation[:, chosen], torque[chosen], own_free[chosen]
            own = _of_both(*of_kind, expected)
        else:
            if expected not in of_all:
                of_all[expected] = _of_both(error, deviation, torque, free, expected)
            own = of_all[expected]
        found[:, list(together)] = own[:, None]
    return found


def _of_both(error: Array, deviation: Array, torque: Array, free: Mask, expected: float) -> Array:
    """Return c and g of smoothed and of causal torque, (2, 2), c of the errors that are `free`."""
    if free.sum() < MIN_STEPS:
        free = np.ones_like(free)
    pairs = zip(error, deviation, strict=True)
    return np.stack([_of_least_score(*own, torque, free, expected) for own in pairs])


def _of_least_score(
    error: Array, deviation: Array, torque: Array, free: Mask, expected: float
) -> Array:
    """Return c and g, (2,), of errors (n,)."""
    errors, loads = np.abs(error / deviation), np.abs(torque / deviation)
    own = errors[free]
    factor = least_at(lambda c: _score(own, np.full(len(own), c), expected, c), *FACTORS)
    share = least_at(lambda g: _score(errors, np.hypot(factor, g * loads)), *SHARES)
    return np.array([factor, share])


def _score(errors: Array, u: Array, expected: float = 0.0, factor: float = 1.0) -> float:
    """Return the score of errors (n,), and of those that are expected, with a factor for u."""
    half, penalty = COVERAGE_FACTOR * u, 2 / (1 - INTERVAL_COVERAGE)
    edge = COVERAGE_FACTOR * factor / EXPECTED_RATIO
    seen = (
        float(np.sum(2 * half + penalty * np.maximum(errors - half, 0)))
        * TIME_APART
        / INDEPENDENT_TIME
    )
    density = math.exp(-(edge**2) / 2) / math.sqrt(2 * math.pi)
    beyond = density - edge * math.erfc(edge / math.sqrt(2)) / 2
    return seen + expected * EXPECTED_RATIO * (2 * edge + penalty * 2 * beyond)


def least_at(score: Callable[[float], float], low: float, high: float) -> float:
    """Return where between two values a score is least, searched by its logarithm."""
    from scipy.optimize import minimize_scalar

    def at(x: float) -> float:
        return score(math.exp(x))

    grid = np.linspace(math.log(low), math.log(high), GRID).tolist()
    best = min(range(GRID), key=lambda n: at(grid[n]))
    around = grid[max(best - 1, 0)], grid[min(best + 1, GRID - 1)]
    found = minimize_scalar(at, bounds=around, method="bounded", options={"xatol": PRECISION})
    return math.exp(found.x)
