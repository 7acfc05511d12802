"""From the filter's deviation to the standard uncertainty, by the state of motion.

    u^2 = (c s)^2 + (g M)^2,   s the filter's deviation, M the torque on the output

c and g of each kind of motion (`Judge.kinds`) are those under which the errors e under known loads
are most likely, all that lies within `INDEPENDENT` as one, with log c ~ N(0, S^2):

    sum of (log u^2 + e^2 / u^2) / 2 + (log c)^2 / (2 S^2)

While the rotor slides, s follows from hundreds of strokes, so that S is small there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rigtool.experiments.force_filter.motion_states import CREEPING, KINDS, State, States
from rigtool.numerics.arrays import Array

APART = 20e-3
"""Time from one compared step to the next, s."""

INDEPENDENT = 1.0
"""Time that one independent error is worth, s: a stroke's own friction is one error."""

SPREAD, SLIDING_SPREAD = 0.5, 0.1
"""Prior standard deviation S of log c, and S while the rotor slides."""

FEWEST = 100
"""Compared steps of a kind without which its factors are those of all kinds."""

TOGETHER = ((State.AGAINST, State.WITH), (State.REVERSED,), (State.STILL,), (CREEPING,))
"""Kinds that have one c and g."""

STARTS = (0.003, 0.1)
"""Values of g at which the search begins."""

BOUNDS = ((np.log(0.2), np.log(20.0)), (np.log(1e-4), np.log(1.0)))
"""Bounds of log c and log g."""


@dataclass(frozen=True, eq=False)
class Errors:
    """Errors and deviations of smoothed and causal torque (2, m), N m, the `torque` that acted (m,)
    N m, and the kinds of motion (m,)."""

    error: Array
    deviation: Array
    torque: Array
    kinds: States


def standard_uncertainty(scales: Array, deviation: Array, torque: Array, kinds: States) -> Array:
    """Return u (m,) N m by c and g of each kind, (kinds, 2)."""
    factor, share = scales[kinds].T
    u: Array = np.hypot(factor * deviation, share * torque)
    return u


def scales(parts: Sequence[Errors]) -> Array:
    """Return c and g of each kind, of smoothed and of causal torque, (2, kinds, 2)."""
    error, deviation = (
        np.hstack([getattr(part, name) for part in parts]) for name in ("error", "deviation")
    )
    torque = np.concatenate([part.torque for part in parts])
    kinds = np.concatenate([part.kinds for part in parts])
    found = np.ones((2, KINDS, 2)) * (1.0, 0.0)
    of_all: dict[float, Array] = {}
    for together in TOGETHER:
        chosen = np.isin(kinds, together)
        spread = SLIDING_SPREAD if State.AGAINST in together else SPREAD
        if chosen.sum() >= FEWEST:
            own = _of_both(error[:, chosen], deviation[:, chosen], torque[chosen], spread)
        else:
            if spread not in of_all:
                of_all[spread] = _of_both(error, deviation, torque, spread)
            own = of_all[spread]
        found[:, list(together)] = own[:, None]
    return found


def _of_both(error: Array, deviation: Array, torque: Array, spread: float) -> Array:
    """Return c and g of smoothed and of causal torque, (2, 2)."""
    pairs = zip(error, deviation, strict=True)
    return np.stack([_most_likely(*own, torque, spread) for own in pairs])


def _most_likely(error: Array, deviation: Array, torque: Array, spread: float) -> Array:
    """Return c and g, (2,), of errors (n,)."""
    from scipy.optimize import minimize

    squares, of_error = np.stack([deviation**2, torque**2]), error**2

    def cost(logs: Array) -> tuple[float, Array]:
        """Return the cost, and its slopes along log c and log g."""
        scaled = np.exp(2 * logs)
        variance = scaled @ squares
        relative = of_error / variance
        unlikely = np.sum(np.log(variance) + relative) * APART / INDEPENDENT
        slopes = scaled * (squares @ ((1 - relative) / variance)) * APART / INDEPENDENT
        slopes[0] += logs[0] / spread**2
        return float(0.5 * unlikely + 0.5 * (logs[0] / spread) ** 2), slopes

    tried = (
        minimize(cost, np.log([1.0, share]), jac=True, method="L-BFGS-B", bounds=BOUNDS)
        for share in STARTS
    )
    found: Array = np.exp(np.asarray(min(tried, key=lambda one: one.fun).x, dtype=np.float64))
    return found
