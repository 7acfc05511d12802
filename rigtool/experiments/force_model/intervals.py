"""From the filter's deviation to the standard uncertainty, by the state of motion.

    u^2 = (c s)^2 + (g M)^2 + r^2,   s the filter's deviation, M the torque on the output

r is the deviation of another power-up's ripple, of which no error under known loads has a part,
and at rest of what is not known of friction's asymmetry (`ForceModel.rest_variance`). Errors of
rests count by what the latter does not hold (`beyond`).
c and g of each kind of motion (`Judged.kinds`) are those whose 95 % intervals, half as wide as
h = 1.96 u, score well under known loads with errors e (T. Gneiting, A. E. Raftery, J. Am. Stat.
Assoc. 102(477) 359-378, 2007, section 6.2), in units of s:

    S = sum of (2 h + (2 / 0.05) max(|e| - h, 0)) / s

c is from errors without load, or from all where these are too few, and g from all, given c. While
the rotor slides, c is not from motions that friction was fitted to: they show how strokes differ,
and not how far the friction is off that they gave. The score is least at the c with 95 % of the
errors within h, whatever their tails: friction's are heavy after reversals and at rest. All that
lies within `INDEPENDENT_TIME` counts as one error; normal errors of `EXPECTED_RATIO` s, `EXPECTED`
in number, count besides. While the rotor slides, s follows from hundreds of strokes, so that they
are many there, but where no stroke has shown s.

Known loads hardly change, as others may: without a load, errors after reversals and at rest are
smaller than under one that comes and goes. So a torque that is not zero within 1.96 c s has

    (c s)^2 >= min((C s)^2, (M / 1.96)^2),   C = `SHOWN_FACTOR`

and intervals hold zero where those of C do. Where a load changes, the filter has raised the noise
of its torque: c is 1 at least, as s holds no more than is needed then.

The least score does not tell g: at g = 0 it has no slope, as g^2 counts, and few strokes leave it
flat, or with two minima. g is a mean, with the score for a loss (P. G. Bissiri, C. C. Holmes, S. G.
Walker, J. R. Stat. Soc. B 78(5) 1103-1130, 2016) and all g from 0 to 1 alike before:

    g = integral of g exp(-S) dg / integral of exp(-S) dg
"""

from __future__ import annotations

import math
from collections.abc import Sequence
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

MISSED = 0.05
"""Of the errors, by an interval that is `COVERAGE_FACTOR` u wide to either side."""

MIN_STEPS = 100
"""Compared steps of a kind under load without which its factors are those of all kinds."""

KINDS_TOGETHER = ((State.AGAINST, State.WITH), (State.REVERSED,), (State.STILL,), (CREEPING_KIND,))
"""Kinds that have one c and g."""

FACTORS, SHARES, GRID = (0.4, 20.0), (1e-4, 1.0), 400
"""Between which c and g are, and how many g the mean is over, evenly by their logarithms."""

SHOWN_FACTOR = 0.8
"""Least c of a torque that shows. With every parameter true, under contacts that come and go, the
score of quiet rests is least at c = 0.80 (smoothed) and 0.75 (causal) under a load, at 0.40 without
one, after reversals at 0.75 and 0.60 to 0.65 (five virtual rigs)."""


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
    shown = np.minimum(SHOWN_FACTOR * deviation, np.abs(torque) / COVERAGE_FACTOR)
    own = np.maximum(np.maximum(factor, opened) * deviation, shown)
    return np.sqrt(np.maximum(own**2, least) + (share * torque) ** 2 + variance)


def beyond(error: Array, variance: Array) -> Array:
    """Return the errors (2, m) N m that are left to c and g where u^2 has a `variance` (m,) N2 m2
    besides: 95 % intervals hold them without it where they hold the whole errors with it."""
    left: Array = np.sqrt(np.maximum(error**2 - COVERAGE_FACTOR**2 * variance, 0.0))
    return left


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
        if (chosen & ~free).sum() >= MIN_STEPS:
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
    errors, loads = np.abs(error / deviation), np.abs(torque / deviation)
    factors = [_factor(own[free], expected) for own in errors]
    return np.column_stack([factors, [*map(_share, errors, loads, factors)]])


def _factor(errors: Array, expected: float) -> float:
    """Return c, by errors (n,) over s and the number of those that are expected."""
    from scipy.optimize import brentq

    def beyond(c: float) -> float:
        half = COVERAGE_FACTOR * c
        seen = TIME_APART / INDEPENDENT_TIME * float(np.sum((errors > half) - MISSED))
        return seen + expected * (math.erfc(half / EXPECTED_RATIO / math.sqrt(2)) - MISSED)

    return float(np.clip(brentq(beyond, -1.0, 1.0 + errors.max(initial=0.0)), *FACTORS))


def _share(errors: Array, loads: Array, factor: float) -> float:
    """Return g, by errors and loads (n,) over s and c; 0 where nothing is loaded."""
    errors, loads = errors[loads > 0], loads[loads > 0]
    shares = np.geomspace(*SHARES, GRID)
    alone = np.maximum(factor, np.minimum(SHOWN_FACTOR, loads / COVERAGE_FACTOR))
    own = [_score(errors, np.hypot(alone, g * loads)) for g in shares]
    weights = shares * np.exp(min(own) - np.array(own))  # dg = g d(ln g)
    return float(weights @ shares / weights.sum()) if errors.size else 0.0


def _score(errors: Array, u: Array) -> float:
    """Return the score of errors (n,) by their u (n,), both over s."""
    half = COVERAGE_FACTOR * u
    every = np.sum(2 * half + 2 / MISSED * np.maximum(errors - half, 0))
    return float(every) * TIME_APART / INDEPENDENT_TIME
