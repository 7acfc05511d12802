"""Time constant tau of the winding, from a thermometer on the housing and from the torque.

Heat that leaves the winding warms the housing. That takes it from the room's cooling: its
temperature T in a staircase is

    T = a + b t - integral of T dt / tau_h + q r W(t) - h L(t),   W = integral of w dt,   q >= 0

with a and b of each staircase, w the heat in the winding of (1) in
`rigtool.experiments.torque_constant.staircases.model`, and r the heat that the current brings in
each. The size q of the warming depends on the housing; the shape of W shows tau. L is by how much
the winding lags behind T, which takes heat, too: h is the winding's part of the motor's heat
capacity. Without it, heat from a winding that cools would pass for the current's. Values of h are
averaged over, and of the lag with which a sensor follows the housing.

The torque shows tau as well: a motor that cools at 50 degC and not at 20 degC has a winding that
does so later, by which its constant changes within the staircases. The probability of tau is in
proportion to Q^(-n/2), with what is left of n independent residuals as sum of squares Q
(A. Gelman et al., Bayesian Data Analysis, 3rd ed., 2013, section 3.2).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from rigtool.experiments.torque_constant.staircases.least_squares import LeastSquares
from rigtool.experiments.torque_constant.staircases.model import (
    COPPER_COEFFICIENT,
    SAME_TEMPERATURE,
    Stairs,
    columns_of,
    mean_of,
    winding,
)
from rigtool.numerics.arrays import TINY, Array
from rigtool.numerics.residual_covariance import independent_samples

SHORTEST_TIME_CONSTANT, LONGEST_TIME_CONSTANT = 2.0, 300.0
"""Range in which the winding's thermal time constant tau is searched, s."""

TRIED = 61
"""Values of tau in this range."""

SENSOR_LAGS = (0.0, 1.0, 2.0, 4.0, 8.0, 16.0)
"""Lags of a thermometer behind the housing, s."""

CAPACITIES = np.geomspace(0.03, 0.3, 6)
"""The winding's part of the motor's heat capacity h, from motors in a heavy body to those of little
but copper (assumed, even in its logarithm)."""

FEWEST_RESIDUALS = 4.0
"""Fewest independent residuals that are assumed."""

UNLIKELY = 1e-3
"""Likelihood relative to the largest below which a tau is not tried."""

ROUNDING = 1e-6
"""Changes of the temperature that are rounding, K."""


@dataclass(frozen=True)
class WindingTime:
    """Logarithms of tau (n,), tau in s, and their `likelihood` (n,) by the thermometer, 1 at most.

    `low` and `high` bound the logarithms that are likely.
    """

    logarithm: Array
    likelihood: Array

    @property
    def low(self) -> float:
        """The lowest logarithm that is likely, or the one below."""
        first = int(np.argmax(self.likelihood > UNLIKELY))
        return float(self.logarithm[max(first - 1, 0)])

    @property
    def high(self) -> float:
        """The highest logarithm that is likely, or the one above."""
        last = len(self.logarithm) - int(np.argmax(self.likelihood[::-1] > UNLIKELY))
        return float(self.logarithm[min(last, len(self.logarithm) - 1)])

    def of(self, logarithm: Array) -> Array:
        """Return the likelihood of logarithms of tau (k,)."""
        return np.interp(logarithm, self.logarithm, self.likelihood)


def winding_time(stairs: Stairs) -> WindingTime:
    """Return what the recorded temperatures say about tau; all is alike where they say nothing."""
    tau = np.geomspace(SHORTEST_TIME_CONSTANT, LONGEST_TIME_CONSTANT, TRIED)
    likelihood = np.ones(len(tau))
    for number in range(int(stairs.courses.kind.max()) + 1):
        likelihood *= _likelihood(stairs, stairs.courses.kind == number, tau)
    return WindingTime(np.log(tau), likelihood / likelihood.max())


def _likelihood(stairs: Stairs, those: Array, tau: Array) -> Array:
    """Return the likelihood of each tau (n,) by the staircases of a kind, `those` (m,)."""
    used = slice(int(np.sum(stairs.weight[those], axis=1).min()))
    degc = stairs.temperature[those, used]
    start, middle, stop = (
        (each[those, used] - stairs.begin[those, :1]).mean(axis=0)
        for each in (stairs.begin, stairs.middle, stairs.end)
    )
    power = stairs.current[those, used] ** 2 * (1 + COPPER_COEFFICIENT * (degc - 20))
    heat = power @ (stop - start)
    # All staircases as two: one with their heat, one that differs from it by temperature alone.
    sums = np.linalg.qr(np.stack([heat, np.ones(len(heat))], axis=1))[0].T
    sums[0] *= np.sign(sums[0] @ heat)
    rows = sums @ degc
    passed = np.cumsum(rows * (stop - start), axis=1) - rows * (stop - middle)
    own = np.kron(np.eye(len(rows)), np.stack([np.ones(len(middle)), middle], axis=1))
    free = np.linalg.qr(np.column_stack([own, passed.ravel()]))[0]

    def left(values: Array) -> Array:
        return values - (values @ free) @ free.T

    shown = left(rows.ravel())
    warming = np.zeros((len(SENSOR_LAGS), len(tau), *rows.shape))
    flown = _flown(power.mean(axis=0), (start, middle, stop), tau)
    warming[:, :, 0] = _behind(flown, middle, np.array(SENSOR_LAGS)[:, None])
    shape = left(warming.reshape(*warming.shape[:2], -1))
    shape /= np.sqrt(np.sum(shape**2, axis=2, keepdims=True))
    cold = _best_of(shown[None], shape)[1].reshape(rows.shape)
    lags = left(_late(rows - cold, middle, tau).reshape(len(tau), -1))
    rest = shown + CAPACITIES[:, None, None, None] * lags
    square, residual = _best_of(rest, shape)
    count = independent_samples(residual, np.full(len(residual), True), 1)
    count = max(count - free.shape[1] - 2, FEWEST_RESIDUALS)
    return np.mean((square / square.min()) ** (-count / 2), axis=(0, 1))


def _best_of(shown: Array, shape: Array) -> tuple[Array, Array]:
    """Return what each unit `shape` (..., p), by an amount of 0 or more, leaves of `shown`
    (..., p) as sum of squares (...,), and the residual of the best (p,)."""
    size = np.maximum(np.sum(shape * shown, axis=-1), 0.0)
    square = np.sum(shown**2, axis=-1) - size**2 + shown.shape[-1] * ROUNDING**2
    best = np.unravel_index(int(np.argmin(square)), square.shape)
    residual = (shown - size[..., None] * shape)[best]
    return square, residual


def _late(degc: Array, time: Array, tau: Array) -> Array:
    """Return by how much a winding lags behind temperatures (r, p) without noise, (n, r, p) K."""
    begin = degc[:, :1] - (degc[:, 1:2] - degc[:, :1]) / (time[1] - time[0]) * time[0]
    return _behind(degc - begin, time, tau[:, None]) - (degc - begin)


def with_torque(
    thermometer: WindingTime, stairs: Stairs, friction: tuple[Array, ...], coefficient: float
) -> tuple[WindingTime, float]:
    """Return tau by the thermometer and by the torque, whose change with temperature is tried, and
    c of (1), 1/K.

    `friction` has columns of each staircase (m, p), `coefficient` is c by lines through the
    staircases: friction makes these too flat, and a housing that cools is colder than its winding.
    A single temperature shows nothing.
    """
    degc = mean_of(stairs.temperature, stairs.weight)
    rise = degc - degc.mean()
    if np.ptp(degc) <= SAME_TEMPERATURE:
        return thermometer, coefficient
    trend, used = rise / (rise @ rise), np.mean(stairs.weight, axis=0) > 0

    def fit(tau: float, c: float, steady: bool = False) -> tuple[LeastSquares, Array]:
        warm = winding(stairs, tau)
        current, lost, own, shared = columns_of(stairs, warm, friction, c, rise, steady=steady)
        found = LeastSquares(stairs.torque, [current, *own], [*shared, stairs.current * lost])
        return found, mean_of(warm[1], stairs.weight)

    def changed(tau: float, c: float) -> float:
        found, degc = fit(tau, c, steady=True)
        return float((trend @ found.own[:, 0]) / (trend @ degc) / found.own[:, 0].mean())

    tau = np.exp(thermometer.logarithm).tolist()
    c = changed(tau[int(np.argmax(thermometer.likelihood))], coefficient)
    fits = [fit(each, c)[0] for each in tau]
    residuals = [(trend @ each.residual)[used] for each in fits]
    square = np.sum(np.stack(residuals) ** 2, axis=1) + TINY
    best = int(np.argmin(square))
    count = independent_samples(residuals[best], np.full(int(used.sum()), True), 1)
    count = max(count - fits[0].own.shape[1] - fits[0].shared.size, FEWEST_RESIDUALS)
    likelihood = thermometer.likelihood * (square / square[best]) ** (-count / 2)
    both = replace(thermometer, likelihood=likelihood / likelihood.max())
    return both, changed(tau[int(np.argmax(likelihood))], c)


def mean_winding(
    stairs: Stairs, tau: Array, probable: Array, trend: Array
) -> tuple[tuple[Array, Array], float]:
    """Return heat in the winding, A2 s, and its temperature, degC, (m, p), as means over tau; and
    the relative standard uncertainty of the range of temperatures.

    `tau` (k,) in s has the probabilities `probable` (k,), `trend` (m,) combines the staircases.
    """
    each = [winding(stairs, one) for one in tau.tolist()]
    heat, warmth = np.tensordot(probable, np.array(each), 1)
    spans = np.array([trend @ mean_of(one, stairs.weight) for _, one in each])
    span = float(probable @ spans)
    spread = math.sqrt(float(probable @ (spans - span) ** 2))
    return (heat, warmth), spread / max(abs(span), TINY)


def _flown(power: Array, times: tuple[Array, Array, Array], tau: Array) -> Array:
    """Return W in the middle of plateaus (n, p), for the power (p,) on each and tau (n,); `times`
    (p,) are begin, middle and end of each, s."""
    begin, middle, end = times
    heat, flown = np.zeros((2, len(tau)))
    middles = []
    for j in range(len(power)):
        if j:
            fades = -np.expm1(-(begin[j] - end[j - 1]) / tau)
            flown, heat = flown + tau * heat * fades, heat * (1 - fades)
        for part, lasts in enumerate((middle[j] - begin[j], end[j] - middle[j])):
            after = heat + (power[j] * tau - heat) * -np.expm1(-lasts / tau)
            flown = flown + tau * (power[j] * lasts - after + heat)
            heat = after
            if part == 0:
                middles.append(flown)
    return np.stack(middles, axis=1)


def _behind(values: Array, time: Array, lag: Array) -> Array:
    """Return values (..., p) at times (p,) behind low-passes of first order, all 0 before; `lag` in
    s broadcasts against (...,)."""
    lag = np.maximum(lag, 1e-9)
    shape = np.broadcast_shapes(values.shape[:-1], lag.shape)
    behind, last, output = np.empty((*shape, len(time))), np.zeros(shape), np.zeros(shape)
    for j, step in enumerate(np.diff(time, prepend=0.0).tolist()):
        kept = np.exp(-step / lag)
        slope = (values[..., j] - last) / step
        output = output * kept + last * (1 - kept) + slope * (step - lag * (1 - kept))
        behind[..., j], last = output, values[..., j]
    return behind
