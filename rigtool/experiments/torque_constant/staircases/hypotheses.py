"""What all staircases share, as hypotheses: each with its probability and its torque constant.

A hypothesis is a transition s of friction, a lag of the arm's swings and a time constant tau of the
winding. On the mean staircases it leaves, by least squares in all else of (1) of
`rigtool.experiments.torque_constant.staircases.model`, a sum of squares Q. Where the size of the
scatter is unknown, its probability for n independent residuals is

    p = Q^(-n/2) / sum over all hypotheses,

even in the logarithms of s, lag and tau, and normal in friction's asymmetry (A. Gelman et al.,
Bayesian Data Analysis, 3rd ed., 2013, section 3.2). Friction opposes motion: hypotheses that want
the opposite have none. No magnet gains
by heat, so that of a loss by heat only the positive part is possible: if each hypothesis had one,
noise alone would raise the constant. Each is therefore tried without such a loss, too, as probable
beforehand as all sizes of the loss together, of which half a normal distribution has the width that
a single residual leaves (R. E. Kass, L. Wasserman, J. Am. Stat. Assoc. 90, 928, 1995). The spread
of the torque constants of all hypotheses is the uncertainty due to what the data do not show:
friction whose contacts bend further than the arm moves is a spring beside the arm, and no staircase
shows its stiffness.

Loss of the torque constant by a current that lasts:

    loss = mean over hypotheses of g tau (1 - exp(-t/tau)),   t = HEATING_TIME

with g of (1) in `rigtool.experiments.torque_constant.staircases.model`, of either sign: a result
that only may be positive is too large wherever noise hides it (S. L. R. Ellison, A. Williams,
Eurachem/CITAC Guide CG 4, 3rd ed., 2012, appendix F). A staircase shows how much
its own heat takes, and little of a time constant tau beyond its length: the loss by a lasting
current is an extrapolation along tau. Where friction is large, an error of its law passes for
another tau: friction that falls with speed is less in the swings than where the arm rests. What a
hypothesis leaves below `LAW` of friction is no evidence: that squared is added to each Q.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from rigtool.errors import InsufficientDataError
from rigtool.experiments.torque_constant.staircases.arm_motion import within_limits
from rigtool.experiments.torque_constant.staircases.friction_of_each import friction_of_each
from rigtool.experiments.torque_constant.staircases.mean_staircases import (
    ASYMMETRY,
    MeanStaircases,
)
from rigtool.experiments.torque_constant.staircases.model import Common, Stairs
from rigtool.experiments.torque_constant.staircases.swings import longest_lag
from rigtool.experiments.torque_constant.staircases.winding_time import (
    FEWEST_RESIDUALS,
    with_torque,
)
from rigtool.numerics.arrays import TINY, Array
from rigtool.quantity import Quantity, combined, error_line

LONGEST_TRANSITION = 10.0
"""Largest transition of friction, as a multiple of the span of the torque."""

LOWEST_EXPONENT, HIGHEST_EXPONENT = 0.5, 2.0
"""Range of the exponent of the law of friction: below 1 for brittle contacts, which slide after a
finite way, above 1 for ductile ones (Dahl 1968; AIAA J. 14(12) 1675-1682, 1976)."""

COARSE, FINE = (32, 6, 5, 5), (9, 4, 5, 4)
"""Values of s over the exponent, tau, exponent and lag over all of their range, and in each finer
grid. Staircases show f/s and e/s of friction f with the exponent e, and little of e itself."""

TAU, TIME_CONSTANTS = 1, 11
"""Place of tau among these, and its values over all of its range in the last grid: hypotheses whose
friction is less well tried would count against their tau."""

LAW = 2e-3
"""Relative standard uncertainty of friction by its law: swings of 0.04 rad/s lower friction with a
Stribeck velocity of 0.3 rad/s by 0.2 to 0.9 % for a moment."""

FINER_GRIDS = 3
"""Grids that each cover the best of the one before."""

ASYMMETRIES = 2
"""Times that friction's asymmetry is found, each with the likeliest hypothesis so far."""

NODES = ((0.0, 2 / 3), (-math.sqrt(3), 1 / 6), (math.sqrt(3), 1 / 6))
"""Where its asymmetry is tried, in standard uncertainties from the one found, and their weights if
it is normal about that (Gauss and Hermite; J. C. Naylor, A. F. M. Smith, Appl. Statist. 31(3), 214,
1982)."""

NEGLIGIBLE, MARGIN = 1e-9, 3.5
"""Likelihood relative to the largest below which a transition s over the exponent is not tried
again, as friction's asymmetry and the arm become better known, and steps of the grid around it in
which it is."""

ANY = (-math.inf, math.inf)
"""Range of logarithms without bounds."""

SHORTER_LAG = 12.0
"""Ratio of the longest lag of the arm's swings to the shortest."""


@dataclass(frozen=True)
class Weighed:
    """Hypotheses (n,), the `best` of them, and what gives each its probability.

    `logarithm` (n,) is that of tau, `volume` (n,) the part of the grid that each represents,
    `square` (n,) is Q, `independent`
    the number of independent residuals. `slope` (n, 3) has the mean of the torque constants, N m/A,
    their change with temperature, N m/(A K), and that if friction does not change. `loss` (k, 3)
    has a loss by heat of either sign, within `HEATING_TIME` over the square of the current, 1/A2,
    its variance by scatter, if all residuals are independent, and Q, `loss_volume` (k,) the part
    of the grid that each represents.
    """

    best: Common
    logarithm: Array
    volume: Array
    square: Array
    independent: float
    slope: Array
    variance: Array
    loss_volume: Array
    loss: Array

    def probable(self) -> Array:
        """Return the probability of each (n,)."""
        return _probable(self.volume, self.square, self.independent)


def _probable(volume: Array, square: Array, independent: float) -> Array:
    """Return the probability of hypotheses (n,) of a `volume` that leave a `square`."""
    likelihood = volume * (square / square.min()) ** (-independent / 2)
    likelihood /= likelihood.sum()
    return likelihood


@dataclass(frozen=True)
class Hypotheses:
    """All hypotheses on the mean staircases, and what they do to the torque constants.

    The courses of `means` are without noise. `constant` in N m/A is the mean of all hypotheses,
    `spread` their standard deviation, `drift` in N m/(A K) that of the constants' change with
    temperature if friction changes, too, `steady_drift` if it does not.
    """

    means: MeanStaircases
    weighed: Weighed
    constant: float
    spread: float
    drift: float
    steady_drift: float

    def time_constants(self) -> tuple[Array, Array]:
        """Return all tau that are likely (k,), s, and their probabilities."""
        logarithm, which = np.unique(self.weighed.logarithm, return_inverse=True)
        probable = np.bincount(which, weights=self.weighed.probable())
        likely = probable > NEGLIGIBLE
        return np.exp(logarithm[likely]), probable[likely] / probable[likely].sum()


def weigh_hypotheses(stairs: Stairs, coefficient: float, trend: Array) -> Hypotheses:
    """Try all hypotheses; `coefficient` is c of (1), 1/K.

    `trend` (m,) combines the constants of the staircases to their change with temperature, 1/K.
    Raises `InsufficientDataError` where the plateaus leave no degree of freedom.
    """
    means = MeanStaircases(stairs, coefficient, trend)
    if means.dof < 1:
        raise InsufficientDataError(
            f"{int(stairs.weight.sum())} plateaus in {len(stairs.setpoint)} staircases leave no "
            "degree of freedom to the fit: use more steps"
        )
    every, doubt = ways_of(stairs), 0.0
    tried, lengths = _joined([_search(means, way, 0) for way in every]), ANY
    best = tried.best(FEWEST_RESIDUALS)
    ways = _find_arm(means, stairs, best, every)
    for _ in range(ASYMMETRIES if means.arm is not None else 0):
        tried = _joined([_search(means, way, FINER_GRIDS - 1, lengths) for way in ways])
        best, lengths = tried.best(FEWEST_RESIDUALS), _likely(means, tried)
        doubt = means.find_asymmetry(best)
        ways = _find_arm(means, stairs, best, every)
    means.winding, means.coefficient = with_torque(
        means.winding, means.stairs, friction_of_each(means, best), coefficient
    )
    found = weighed(means, ways, doubt, lengths)
    means.move_arm(found.best)
    probable = found.probable()
    mean = probable @ found.slope
    spread = np.sqrt(probable @ ((found.slope - mean) ** 2 + found.variance))
    return Hypotheses(means, found, float(mean[0]), *spread.tolist())


def _find_arm(
    means: MeanStaircases, stairs: Stairs, best: Common, ways: list[tuple[float, float] | None]
) -> list[tuple[float, float] | None]:
    """Take noise off the courses of `stairs` and find the arm in them, with the friction of the
    `best` hypothesis so far; return ranges of the lag, `ways` where they show no arm."""
    # The gauge's noise is also in the path, where it would count as evidence against friction.
    means.stairs = stairs
    means.smooth(best)
    means.find_arm(best)
    return ways if means.arm is None else [(means.arm.lag, means.arm.lag)]


def weighed(
    means: MeanStaircases,
    ways: list[tuple[float, float] | None],
    doubt: float = 0.0,
    lengths: tuple[float, float] = ANY,
) -> Weighed:
    """Return all hypotheses, along paths of these lags, with several asymmetries of friction where
    `doubt`, its standard uncertainty, is not 0; `lengths` as in `_search`."""
    centre, parts = means.asymmetry, []
    for place, share in NODES if doubt else NODES[:1]:
        means.asymmetry = within_limits(centre + place * doubt)
        part = _joined([_search(means, way, FINER_GRIDS, lengths) for way in ways])
        beforehand = -((means.asymmetry / ASYMMETRY) ** 2) / 2
        part.volume[:] *= share * math.exp(beforehand + place**2 / 2)
        parts.append(part)
    means.asymmetry, tried = centre, _joined(parts)
    count = max(means.independent(tried.best(FEWEST_RESIDUALS)), FEWEST_RESIDUALS)
    # Half a normal distribution as wide as one residual leaves the loss by heat, of each kind.
    shows = (2 / math.sqrt(1 + count / means.kinds)) ** means.kinds
    warmed = tried.volume * tried.warms
    volume = warmed[:, None] * np.array([1.0, shows])
    slope, variance = (each.reshape(-1, each.shape[-1]) for each in (tried.slope, tried.variance))
    logarithm = np.repeat(tried.place[:, TAU], 2)
    own = logarithm, volume.ravel(), tried.square.ravel(), count, slope, variance
    return Weighed(tried.best(count), *own, warmed, tried.loss)


@dataclass(frozen=True)
class _Tried:
    """Hypotheses, at places (n, 4) of a grid in the logarithms of s over the exponent, tau, the
    exponent and the lag (NaN where there is none), each without a loss by heat and with one, and
    what they leave.

    `volume` (n,) is the part of the grid that each represents, `warms` (n,) the likelihood of its
    tau by the thermometer, `free` (n, 2) whether it has no friction, `square` (n, 2) is Q, `slope`
    (n, 2, 3) and `loss` (n, 3) what `Weighed` has.
    """

    place: Array
    volume: Array
    warms: Array
    free: Array
    square: Array
    slope: Array
    variance: Array
    loss: Array

    def best(self, independent: float) -> Common:
        """Return the likeliest hypothesis, with so many independent residuals."""
        square, warms = (np.log(np.maximum(each, TINY)) for each in (self.square, self.warms))
        unlikely = independent / 2 * square - warms[:, None]
        least = np.unravel_index(int(np.argmin(unlikely)), unlikely.shape)
        length, tau, exponent, lag = np.exp(self.place[least[0]]).tolist()
        free = bool(self.free[least])
        return Common(
            None if free else length * exponent, exponent, None if math.isnan(lag) else lag, tau
        )


def _joined(parts: list[_Tried]) -> _Tried:
    """Return all hypotheses of several grids."""
    names = vars(parts[0])
    return _Tried(**{name: np.concatenate([vars(part)[name] for part in parts]) for name in names})


def ways_of(stairs: Stairs) -> list[tuple[float, float] | None]:
    """Return ranges of the lag along which friction may follow, s; None for straight steps.

    A gauge that shows no swings may be too slow for them: then friction may follow its torque
    from plateau to plateau, or straight steps of the current.
    """
    longest = longest_lag(stairs.courses)
    if longest is not None:
        return [(longest / SHORTER_LAG, longest)]
    fastest = float(np.min(stairs.courses.part)) / 20
    return [(fastest, fastest), None]


def _likely(means: MeanStaircases, tried: _Tried) -> tuple[float, float]:
    """Return the range of likely logarithms of s over the exponent."""
    count = max(means.independent(tried.best(FEWEST_RESIDUALS)), FEWEST_RESIDUALS)
    square = tried.square.min(axis=1)
    length = tried.place[square < square.min() * NEGLIGIBLE ** (-2 / count), 0]
    return float(length.min()), float(length.max())


def _search(
    means: MeanStaircases,
    lag: tuple[float, float] | None,
    finer: int,
    lengths: tuple[float, float] = ANY,
) -> _Tried:
    """Try hypotheses with lags of this range on a coarse grid, and on so many finer ones.

    The coarse grid has logarithms of s over the exponent in the range `lengths` and about it; or
    all, where the best of these are at an edge.
    """
    low, high = _ranges(means, lag)
    centre, half, wide = (low + high) / 2, (high - low) / 2, high > low
    found: list[_Tried] = []
    for level in range(1 + finer):
        begin, end = np.maximum(centre - half, low), np.minimum(centre + half, high)
        counts = list(FINE if level else COARSE)
        if level and level == finer:
            begin[TAU], end[TAU], counts[TAU] = low[TAU], high[TAU], TIME_CONSTANTS
        numbers = [n if e > b else 1 for n, b, e in zip(counts, begin, end, strict=False)]
        axes = [np.linspace(b, e, n) for b, e, n in zip(begin, end, numbers, strict=True)]
        step = (end - begin) / np.maximum(np.array(numbers) - 1, 1)
        if not level:
            before, beyond = (axes[0] - lengths[0]) / step[0], (axes[0] - lengths[1]) / step[0]
            axes[0] = axes[0][(before > -MARGIN) & (beyond < MARGIN)]
        for part in found:  # the finer grid stands for its part of the coarse one
            before = part.place[:, : len(begin)]
            part.volume[np.all((before >= begin) & (before <= end), axis=1)] = 0.0
        place = np.full((math.prod(map(len, axes)), 4), np.nan)
        place[:, : len(axes)] = list(product(*axes))
        volume = np.full(len(place), np.prod(step[wide] / (high - low)[wide]))
        warms = means.winding.of(place[:, TAU])
        found.append(_Tried(place, volume, warms, *means.try_all(axes)))
        best = int(np.argmin(found[-1].square.min(axis=1)))
        centre, half = place[best, : len(axes)], 1.5 * step
        if not level and lengths != ANY and centre[0] in axes[0][[0, -1]]:
            return _search(means, lag, finer)
    return _joined(found)


def _ranges(means: MeanStaircases, lag: tuple[float, float] | None) -> tuple[Array, Array]:
    """Return bounds of the logarithms of s over the exponent, tau, the exponent and the lag, if
    there is one."""
    courses = means.stairs.courses
    span = float(np.ptp(courses.torque[0]))
    step = span * float(np.median(np.abs(np.diff(courses.setpoint[0]))))
    step /= float(np.ptp(courses.setpoint[0]))
    low, high = [step / 4, LOWEST_EXPONENT], [LONGEST_TRANSITION * span, HIGHEST_EXPONENT]
    if lag is not None:
        low.append(lag[0])
        high.append(lag[1])
    return (
        np.insert(np.log(low), TAU, means.winding.low),
        np.insert(np.log(high), TAU, means.winding.high),
    )


def loss_by_heat(hypotheses: Hypotheses, hidden_u: float, hidden_dof: float) -> Quantity:
    """Return the relative loss of the constant within `HEATING_TIME`, over the square of the
    current, 1/A2, by hypotheses whose loss may have either sign.

    Its uncertainty is that of each by scatter, and what the hypotheses and tau leave open. What
    correlates residuals is friction's path, by which the hypotheses differ: it does not count in
    the scatter again. Of ripple that the angles hide, the loss of each second, 1/(A2 s), has the
    standard uncertainty `hidden_u` with `hidden_dof`; where that is infinite, as large as the loss.
    """
    means, found = hypotheses.means, hypotheses.weighed
    friction = float(means.contacts(found.best).level)
    losses, variance, square = found.loss.T
    evident = square + means.plateaus * (LAW * friction) ** 2
    probable = _probable(found.loss_volume, evident, found.independent)
    loss = float(probable @ losses)
    scatter = math.sqrt(float(probable @ variance))
    spread = math.sqrt(float(probable @ (losses - loss) ** 2))
    stairs = means.stairs
    length = float(np.mean(stairs.end.max(axis=1) - stairs.begin.min(axis=1)))
    step = (means.winding.high - means.winding.low) / (TIME_CONSTANTS - 1)
    open_u = math.hypot(spread, loss * _untried(found.best, length, step))
    hidden_u = abs(loss) if math.isinf(hidden_u) else hidden_u * found.best.warming()
    lines = [
        error_line("scatter", scatter, "1/A2", found.independent),
        error_line("time constant of the winding, path of friction", open_u, "1/A2"),
        error_line("ripple over rotor angles", hidden_u, "1/A2", hidden_dof),
    ]
    return combined(loss, "1/A2", lines)


def _untried(best: Common, length: float, step: float) -> float:
    """Return the relative standard uncertainty of a loss by heat, as tau is tried in steps.

    The loss is known at the end of a staircase of `length` s, whatever tau is; from there to
    `HEATING_TIME` it grows by tau, whose logarithm lies anywhere within a `step` (GUM 4.3.7).
    """
    edges = [
        replace(best, time_constant=best.time_constant * math.exp(side * step / 2))
        for side in (-1, 1)
    ]
    low, high = (math.log(edge.warming() / edge.warming(length)) for edge in edges)
    return abs(high - low) / math.sqrt(12)
