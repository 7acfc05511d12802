"""Delay between effort and position in recordings of motion.

The effort may be recorded later than the position, or earlier where the position is filtered:
torque(t + d) = model(t), so torque = model - d dmodel/dt to first order. The delay d is found by
Gauss-Newton, and is part of the model where the residuals ask for it; where they do not, what it
would change is part of the uncertainties.
The terms are those of `motion_terms`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rigtool.experiments.friction.model_doubt import own_part
from rigtool.experiments.friction.motion_terms import (
    DELAY,
    DYNAMICS_PARAMETERS,
    SmoothedMotion,
    independent,
    weighted,
)
from rigtool.numerics.arrays import TINY, Array
from rigtool.numerics.residual_covariance import long_run_covariance

SIGNIFICANT_RATIO = 3.0
"""Multiple of its uncertainty from which on a delay, or a difference by direction, is
significant."""

DELAY_STEPS = 5
"""Gauss-Newton steps for the delay."""

SECOND_ORDER_RATIO = 2.0
"""Change by a first-order filter over its second-order change at the delay that fits best: the time
constant of the filter is longer than that delay."""

SAME_AS_OTHERS = 1e-6
"""Part of a regressor's power that rounding may leave unexplained by the others."""

DELAY_POWER = 0.1
"""Smallest part of the residuals' power that a delay in the model explains."""


def on_time(
    motions: Sequence[SmoothedMotion], chosen: list[int]
) -> tuple[Sequence[SmoothedMotion], float, Array]:
    """Return the motions with efforts moved by the delay d, d in s, and its uncertainty (5,).

    Their designs have a column for what is left of d. Where the residuals do not ask for a delay,
    d is 0, and the uncertainty of the parameters is stated: what d changes where it shows, else
    what it is likely to change. Before the data, d has a rectangular distribution, as wide as one
    sample, or as the delay that the reversals show: friction that sets in late (presliding) looks
    like a delay there, so it limits d and does not determine it.
    """
    design, torque, _ = weighted(motions)
    before = np.linalg.lstsq(design[:, chosen], torque)[0]
    power = float(np.sum((torque - design[:, chosen] @ before) ** 2))
    here, delay, columns, residual = _late(motions, chosen)
    square = _last(here, columns, weighted(here)[1])[1]
    explained = 1 - float(np.sum(residual**2)) / max(power, TINY)
    unstated = np.zeros(DELAY)
    shown = delay**2 > SIGNIFICANT_RATIO**2 * square
    if shown and explained > DELAY_POWER:
        unstated[chosen] = _lag(here, delay, chosen, columns)
        return here, delay, unstated
    if shown:
        after = np.linalg.lstsq(columns, weighted(here)[1])[0][:-1]
        unstated[chosen] = after - before
        return motions, 0.0, unstated
    reversals = _late([replace(m, used=m.sliding[-1]) for m in motions], chosen)[1]
    half = max(motion.spacing / motion.every for motion in motions) / 2
    change = np.linalg.lstsq(columns[:, :-1], columns[:, -1])[0]
    unstated[chosen] = change * _likely(delay, square, max(half, abs(reversals)) ** 2 / 3)
    return motions, 0.0, unstated


def _late(
    motions: Sequence[SmoothedMotion], chosen: list[int]
) -> tuple[Sequence[SmoothedMotion], float, Array, Array]:
    """Return motions with efforts moved by the delay that fits best, and the delay, s.

    Also return the regressors, the last that of the delay, and the residuals.
    """
    design, torque, _ = weighted(motions)
    here, delay = motions, 0.0
    found = np.linalg.lstsq(design[:, chosen], torque)[0]
    solution: Array = np.asarray(found, np.float64)
    columns, residual = design[:, chosen], torque
    for _ in range(DELAY_STEPS):
        here = [_moved(motion, delay, chosen, solution) for motion in motions]
        design, torque, _ = weighted(here)
        columns = design[:, [*chosen, DELAY]]
        found = np.linalg.lstsq(columns, torque)[0]
        residual = torque - columns @ found
        solution, delay = np.asarray(found[:-1], np.float64), delay + float(found[-1])
    return here, delay, columns, residual


def _lag(
    motions: Sequence[SmoothedMotion], delay: float, chosen: list[int], columns: Array
) -> Array:
    """Return the uncertainty (p,) from a delay d that may be a filter of first order.

    To second order, the filter adds d^2/2 d2model/dt2 to the delay; a filter of the position does
    not do that to sign(v). How much of it there is, the residuals show.
    """
    _, torque, weight = weighted(motions)
    solution = np.linalg.lstsq(columns, torque)[0][:-1]
    linear = np.where(np.array(chosen) == DYNAMICS_PARAMETERS.index("coulomb"), 0.0, solution)
    change = np.zeros(len(chosen))
    for filtered in (solution, linear):
        bent = [
            np.gradient(np.gradient(m.design[:, chosen] @ filtered, m.spacing), m.spacing)
            for m in motions
        ]
        beyond = delay**2 / 2 * weight * np.concatenate(bent)
        part, square = _last(motions, np.column_stack([columns, beyond]), torque)
        alike = np.linalg.lstsq(columns, beyond)[0][:-1]
        change = np.maximum(
            change, np.abs(alike) * _likely(part, square, 1 / 3) * SECOND_ORDER_RATIO
        )
    return change


def _last(motions: Sequence[SmoothedMotion], columns: Array, torque: Array) -> tuple[float, float]:
    """Return the coefficient of the last regressor and its variance, infinite where the others
    explain it."""
    found = np.linalg.lstsq(columns, torque)[0]
    if own_part(columns, columns.shape[1] - 1) < SAME_AS_OTHERS:
        return 0.0, math.inf
    residual = torque - columns @ found
    covariance, _ = long_run_covariance(columns, residual, independent(motions, residual))
    return float(found[-1]), float(covariance[-1, -1])


def _likely(value: float, square: float, before: float) -> float:
    """Return the root mean square of a quantity that is measured with a variance, and had another
    variance around 0 before; a significant value is that of the measurement."""
    known = 1 / (1 + square / before)
    shown = value**2 > SIGNIFICANT_RATIO**2 * square
    return math.hypot(value if shown else known * value, math.sqrt((1 - known) * before))


def _moved(
    motion: SmoothedMotion, delay: float, chosen: list[int], solution: Array
) -> SmoothedMotion:
    """Return a motion with its effort moved by a delay, s, and -dmodel/dt in its design."""
    rows = np.arange(len(motion.torque)) * motion.spacing
    slope = -np.gradient(motion.design[:, chosen] @ solution, motion.spacing)
    return replace(
        motion,
        torque=np.interp(rows + delay, rows, motion.torque),
        design=np.column_stack([motion.design[:, :DELAY], slope]),
    )
