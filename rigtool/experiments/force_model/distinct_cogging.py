"""Orders of cogging that stand out of what the other terms leave of records of known loads.

Slots and poles make few, strong orders: pole pairs and their multiples, and the least common
multiple of slots and poles (Z. Q. Zhu, D. Howe, IEEE Trans. Energy Convers. 15(4) 407-412, 2000). A
prior that falls with the order has no room for them, and orders above those of the ripple are no
terms at all. Records without load, on which a load's friction has no part, are searched for them
one by one. With N independent rows and a sum of squares Q, one that lowers Q to Q' is taken if

    N / 2 ln(Q / Q') > ln N + ln C

(G. Schwarz, Ann. Statist. 6(2) 461-464, 1978; the noise is unknown, cosine and sine are two
parameters) among C orders that may be. Q has the square of the least residual that is assumed.

Ripple with hardly a lag is like cogging, so that a search may end at such a lag. Orders are looked
for at the lag found and at the one where the search began: the better of both is taken.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from rigtool.experiments.force_model.model import Kind, Shape, Term
from rigtool.experiments.force_model.sliding_problem import (
    LEAST_RMS,
    ROWS_PER_INDEPENDENT_ROW,
    Problem,
    logarithms,
)
from rigtool.numerics.arrays import Array

ORDERS = range(1, 101)
"""Orders that are tried: 84 is that of 12 slots and 14 poles; beyond, encoders have few counts and
strokes pass the low-pass of the rows."""


@dataclass(frozen=True, eq=False)
class _Found:
    """Terms that stand out, the shape at which they do, and half the criterion, less if better."""

    terms: tuple[Term, ...]
    shape: Shape
    criterion: float


def distinct_cogging(
    problem: Problem, shape: Shape, size: float
) -> tuple[tuple[Term, ...], Shape] | None:
    """Return the orders of cogging that stand out near a shape and the shape at which a search
    with them begins, or None.

    `size` N m is the prior spread of an order. Those returned have their own size for a spread.
    """
    lags = {shape.ripple_time, problem.start.ripple_time}
    tried = [_found(problem, replace(shape, ripple_time=lag), size) for lag in lags]
    best = min(tried, key=lambda one: one.criterion)
    return (best.terms, best.shape) if best.terms else None


def _found(problem: Problem, shape: Shape, size: float) -> _Found:
    """Return what stands out at a shape; the best of the other parameters there is near it."""
    known = {term.order for term in problem.terms if term.kind is Kind.DISTINCT_COGGING}
    orders = [order for order in ORDERS if order not in known]
    tried = tuple(
        Term(Kind.DISTINCT_COGGING, size, order, quarter) for order in orders for quarter in (0, 1)
    )
    normal, rows = _normal(problem, shape, tried)
    count = len(normal) - 1 - len(tried)
    left = _without(normal, slice(0, count))[count:, count:]
    pairs, price = [slice(k, k + 2) for k in range(0, len(tried), 2)], math.log(rows * len(orders))
    chosen: list[int] = []
    while len(chosen) < len(orders):
        after = [left[-1, -1] - _part(left, pair) for pair in pairs]
        best = int(np.argmin(after))
        if rows / 2 * math.log(left[-1, -1] / after[best]) <= price:
            break
        chosen.append(best)
        left = _without(left, pairs[best])
    inside = [*range(count), *(count + k for n in chosen for k in (2 * n, 2 * n + 1))]
    solution = np.linalg.solve(normal[np.ix_(inside, inside)], normal[inside, -1])[count:] * size
    sizes = np.sqrt(np.mean(solution.reshape(-1, 2) ** 2, axis=1)).tolist()
    terms = tuple(
        replace(tried[2 * n + k], spread=own)
        for n, own in sorted(zip(chosen, sizes, strict=True))
        for k in (0, 1)
    )
    return _Found(terms, shape, rows / 2 * math.log(left[-1, -1]) + price * len(chosen))


def _normal(problem: Problem, shape: Shape, tried: tuple[Term, ...]) -> tuple[Array, float]:
    """Return the normal matrix of the records without load, all alike, linear about a shape, and
    their number of independent rows.

    Parameters are the step of the shape, the terms, and those `tried`, in units of their spreads;
    right-hand side and sum of squares are last (p + 1, p + 1).
    """
    coefficient = np.append(problem.cost(shape)[0], np.zeros(len(tried)))
    free = [n for n, record in enumerate(problem.records) if not record.moment]
    wide = [problem.only(n).beside(tried) for n in free]
    used = sum(float(one.records[0].used.sum()) / one.records[0].passes for one in wide)
    scale = np.concatenate([problem.shape_spread, wide[0].spread, [1.0]])
    normal = np.sum([one.sums(0, shape, coefficient) for one in wide], axis=0)
    least = (LEAST_RMS * problem.friction) ** 2
    normal[-1, -1] += (
        sum(float(one.records[0].used.sum() / one.variance[0]) for one in wide) * least
    )
    normal *= np.outer(scale, scale)
    away = (logarithms(shape) - logarithms(problem.start)) / problem.shape_spread
    normal += np.diag(np.append(np.ones(len(scale) - 1), away @ away))
    normal[: len(away), -1] -= away
    normal[-1, : len(away)] -= away
    return normal, max(used / ROWS_PER_INDEPENDENT_ROW, 1.0)


def _part(matrix: Array, own: slice) -> float:
    """Return by how much some parameters lower the sum of squares of a normal matrix."""
    return float(matrix[-1, own] @ np.linalg.solve(matrix[own, own], matrix[own, -1]))


def _without(matrix: Array, own: slice) -> Array:
    """Return a normal matrix after the best values of some parameters, which do nothing more."""
    left: Array = matrix - matrix[:, own] @ np.linalg.solve(matrix[own, own], matrix[own])
    left[own] = left[:, own] = 0.0
    left[own, own] = np.eye(own.stop - own.start)
    return left
