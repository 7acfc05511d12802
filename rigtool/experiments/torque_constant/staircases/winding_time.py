"""Time constant tau of the winding, from a thermometer on the housing.

Heat that leaves the winding warms the housing. That takes it from the room's cooling: its
temperature T in a staircase is

    T = a + b t - integral of T dt / tau_h + q r W(t),   W = integral of w dt,   q >= 0

with a and b of each staircase, w the heat in the winding of (1) in
`rigtool.experiments.torque_constant.staircases.model`, and r the heat that the current brings in
each. The size q of the warming depends on the housing; the shape of W shows tau. A sensor follows
the housing with a lag, whose values are averaged over. The winding follows the housing as that
warms: tau comes out short by the ratio of their heat capacities, which nothing else shows. The
probability of tau is in proportion to Q^(-n/2), with what is left of n independent residuals as sum
of squares Q (A. Gelman et al., Bayesian Data Analysis, 3rd ed., 2013, section 3.2).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rigtool.experiments.torque_constant.staircases.model import COPPER_COEFFICIENT, Stairs
from rigtool.numerics.arrays import Array
from rigtool.numerics.residual_covariance import independent_samples

SHORTEST_TIME_CONSTANT, LONGEST_TIME_CONSTANT = 2.0, 300.0
"""Range in which the winding's thermal time constant tau is searched, s."""

TRIED = 61
"""Values of tau in this range."""

SENSOR_LAGS = (0.0, 1.0, 2.0, 4.0, 8.0, 16.0)
"""Lags of a thermometer behind the housing, s."""

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
        within: Array = np.interp(logarithm, self.logarithm, self.likelihood)
        return within


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
        rest: Array = values - (values @ free) @ free.T
        return rest

    shown = left(rows.ravel())
    warming = np.zeros((len(SENSOR_LAGS), len(tau), *rows.shape))
    flown = _flown(power.mean(axis=0), (start, middle, stop), tau)
    warming[:, :, 0] = _behind(flown, middle, np.array(SENSOR_LAGS)[:, None])
    shape = left(warming.reshape(*warming.shape[:2], -1))
    shape /= np.sqrt(np.sum(shape**2, axis=2, keepdims=True))
    size = np.maximum(shape @ shown, 0.0)
    square = shown @ shown - size**2 + len(shown) * ROUNDING**2
    best = np.unravel_index(int(np.argmin(square)), square.shape)
    residual = shown - size[best] * shape[best]
    count = independent_samples(residual, np.full(len(residual), True), 1)
    count = max(count - free.shape[1] - 1, FEWEST_RESIDUALS)
    likelihood: Array = np.mean((square / square[best]) ** (-count / 2), axis=0)
    return likelihood


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
