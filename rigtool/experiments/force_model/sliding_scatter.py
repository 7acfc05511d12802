"""Covariance of the parameters learned from sliding, with residuals that are correlated in time.

    cov = H^-1 (P^-1 + sum over records of W' (R + D + T T') W) H^-1,  W = V^-1 X,  H = P^-1 + X' W

with the derivatives X by all parameters, P the priors, V the covariance of the noise that least
squares assumes, D the part of it by which strokes deviate, and R the covariance of the residuals.
Friction's noise lasts longer than a row and is small where a load swings on its tendon: one number
of rows for an independent row is too large there, and too small for what hardly changes along a
stroke. R has the residuals' own power in each record, and in all records their common correlation,
by the window of E. Parzen (Ann. Math. Statist. 32(4) 951-989, 1961; as an estimator: D. W. K.
Andrews, Econometrica 59(3) 817-858, 1991).

T is the additional torque in the tendon if the angle is off by one standard deviation of an even
distribution over a count, at each place where the rotor turns within one: a load then swings
otherwise, alike in all cycles. A count that the rotor passes leaves nothing open: the angle is
known at both of its edges (`experiments.force_filter.encoder_angle`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from rigtool.experiments.force_model.model import RecordState, Shape
from rigtool.experiments.force_model.records import ROWS_HZ, Record
from rigtool.experiments.force_model.sliding_problem import Problem
from rigtool.numerics.arrays import Array

LONGEST_TIME = 1.0
"""Time over which residuals are correlated, s. Half or twice of it changes the uncertainty of a
tendon's stiffness by 2 %."""


def moments(problem: Problem, shape: Shape, coefficient: Array, count: float) -> Array:
    """Return W' (R + D + T T') W of each record (records, p, p) for coefficients (t,) at a shape;
    `count` rad is that of the encoder."""
    records = problem.records
    left = [problem.remaining(n, shape, coefficient) for n in range(len(records))]
    correlation = _correlation(records, left)
    found = []
    for n, record in enumerate(records):
        rows = np.zeros((len(coefficient) + len(problem.shape_spread), record.count))
        rows[:, record.used], noise = problem.influence(n, shape, coefficient)
        size = record.count + len(correlation)
        size += size % 2
        spectrum = np.fft.rfft(rows, size)
        lags = np.zeros(size)
        lags[: len(correlation)] = correlation
        lags[1 - len(correlation) :] = correlation[:0:-1]
        twice = np.full(size // 2 + 1, 2.0)
        twice[[0, -1]] = 1.0
        power = np.maximum(np.fft.rfft(lags).real, 0.0) * twice / size
        white = float(np.mean(left[n] ** 2)) * record.passes
        noise += white * ((spectrum * power) @ spectrum.conj().T).real
        if record.periodic:
            turned = _turned(RecordState.of(shape, problem.known, record), count)
            off = rows @ record.rows(turned).T
            noise += off @ off.T
        found.append(noise)
    return np.stack(found)


def _turned(state: RecordState, count: float) -> Array:
    """Return T (k, n), N m at the motor, of a record that repeats."""
    record, spread = state.record, count / math.sqrt(12)
    more = [np.empty((0, record.angle.size))]
    for place in _turning_counts(record, count):
        angle = record.angle.copy()
        angle[place] += spread
        other = replace(state, record=replace(record, angle=angle))
        other = other.under(record.moment, record.load_inertia)
        more.append((other.carried - state.carried)[None] / state.known.torque_factor)
    return np.concatenate(more)


def _turning_counts(record: Record, count: float) -> Iterator[NDArray[np.intp]]:
    """Yield the places along a cycle within each count that the rotor leaves where it entered."""
    steps = np.diff(np.floor(record.angle / count), append=np.floor(record.angle[0] / count))
    passed = np.flatnonzero(steps)
    for first, last in pairwise([*passed, *(passed[:1] + record.angle.size)]):
        if steps[first] * steps[last % record.angle.size] < 0:
            yield np.arange(first + 1, last + 1) % record.angle.size


def _correlation(records: Sequence[Record], left: Sequence[Array]) -> Array:
    """Return the correlation (l,) at lags of rows that all residuals have, windowed."""
    lags = np.arange(round(LONGEST_TIME * ROWS_HZ) + 1)
    product, pairs = np.zeros((2, len(lags)))
    for record, own in zip(records, left, strict=True):
        signal, used = np.zeros((2, record.count))
        signal[record.used] = own / np.sqrt(np.mean(own**2))
        used[record.used] = 1.0
        for sum_, values in ((product, signal), (pairs, used)):
            reach = min(len(lags), len(values))
            sum_[:reach] += [values[: len(values) - lag] @ values[lag:] for lag in range(reach)]
    part = lags / lags[-1]
    window = np.where(part < 0.5, 1 - 6 * part**2 * (1 - part), 2 * (1 - part) ** 3)
    found: Array = window * product / np.maximum(pairs, 1.0)
    return found / found[0]
