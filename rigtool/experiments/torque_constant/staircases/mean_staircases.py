"""Mean staircases, one of each kind, and what hypotheses about all of them leave.

A hypothesis fixes s, tau, exponent and lag in (1) of
`rigtool.experiments.torque_constant.staircases.model`; all else is linear there:

    torque = X(s, tau, e, lag) b + residual,   Q = mean over kinds of sum of residual^2
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from rigtool.experiments.torque_constant.staircases.arm_motion import (
    Arm,
    Contacts,
    arm_of,
    one_sided,
    state_of,
    within_limits,
)
from rigtool.experiments.torque_constant.staircases.friction_change import FRICTION_CHANGE
from rigtool.experiments.torque_constant.staircases.friction_cone import positive, possible
from rigtool.experiments.torque_constant.staircases.least_squares import left_by, without_known
from rigtool.experiments.torque_constant.staircases.model import (
    Common,
    Stairs,
    mean_of,
    warming,
    winding,
)
from rigtool.experiments.torque_constant.staircases.swings import (
    friction_state,
    paths,
    straight_path,
)
from rigtool.experiments.torque_constant.staircases.winding_time import winding_time
from rigtool.numerics.arrays import TINY, Array
from rigtool.numerics.residual_covariance import independent_samples

LARGEST_FRICTION = 0.25
"""Largest friction, relative to the span of the torque."""

ASYMMETRY = 0.1
"""Standard deviation of friction's relative asymmetry, beforehand (assumed)."""

CHANGE = 1e-2
"""Relative change of what a hypothesis is linear about, and change of its asymmetry."""

PARAMETERS = 7
"""Linear parameters of a mean staircase."""


class MeanStaircases:
    """Mean staircases, one of each kind, and what hypotheses leave of them.

    `coefficient` is c of (1), 1/K; `trend` (m,) combines the constants of the staircases to their
    change with temperature, 1/K. In shapes, g counts kinds, p plateaus, s transitions, c columns.
    """

    def __init__(self, stairs: Stairs, coefficient: float, trend: Array) -> None:
        self.stairs, self.coefficient = stairs, coefficient
        self.winding = winding_time(stairs)
        self.arm: Arm | None = None
        self.asymmetry = 0.0
        self._time_constant = 0.0
        kind = stairs.courses.kind
        self._members = [kind == number for number in range(int(kind.max()) + 1)]
        self._share = np.array([np.mean(those) for those in self._members])
        self._weight, self._step = self._mean(stairs.weight), self._mean(stairs.last_step)
        torque = self._mean(stairs.torque)
        combined = [
            np.sum(trend[those, None] * stairs.torque[those], axis=0) for those in self._members
        ]
        self._torque = np.stack([torque, np.stack(combined)], axis=2)  # (g, p, 2)
        self._span = float(np.ptp(torque))
        self.dof = int(self._weight.sum()) - PARAMETERS * self.kinds

    def _mean(self, values: Array) -> Array:
        return np.stack([values[those].mean(axis=0) for those in self._members])

    def thermal(self, time_constant: float) -> tuple[Array, Array]:
        """Return current, warmed, and its loss by heat, (2, g, p)."""
        heat, warmth = winding(self.stairs, time_constant)
        drift = warmth - mean_of(warmth, self.stairs.weight)[:, None]
        current = self.stairs.current * (1 + self.coefficient * drift)
        return self._mean(current), self._mean(current * heat)

    def _ways(self, lags: Sequence[float | None]) -> list[Array]:
        """Return the path of each lag; None alone, there is no lag, has that of straight steps."""
        courses = self.stairs.courses
        some = [lag for lag in lags if lag is not None]
        if not some:
            return [straight_path(courses)]
        return list(paths(courses, courses.torque, courses.course, some))

    def _friction(
        self, lengths: Array, exponents: Array, lags: Sequence[float | None]
    ) -> tuple[Array, Array]:
        """Return columns of f and f z0 for each exponent, length and lag, (e, s, l, g, p).

        `lengths` (s,) are transitions over their exponent, N m. Once the arm is known, friction
        follows its motion, which depends on friction, too.
        """
        a, b = self._along_turns(lengths, exponents, lags)
        if self.arm is not None:
            contacts = self._moves(lengths, exponents, a, b)
            own = self.arm.friction_state(self.stairs.courses, contacts)
            a, b = (-(each * self._weight).reshape(a.shape) for each in own)
        return a, b

    def _along_turns(
        self, lengths: Array, exponents: Array, lags: Sequence[float | None]
    ) -> tuple[Array, Array]:
        """Return the columns of `_friction` along the turns that the courses show."""
        ways = np.stack(self._ways(lags), axis=1)
        each = exponents[:, None, None, None]
        both = one_sided(*friction_state(ways, lengths[:, None, None] * each, each), self.asymmetry)
        return -both[0] * self._weight, -both[1] * self._weight

    def _moves(self, lengths: Array, exponents: Array, a: Array, b: Array) -> Contacts:
        """Return the friction with which the arm moves under each hypothesis, h at once: that of
        their columns (e, s, l, g, p) along the turns."""
        shape = -1, *self._weight.shape
        level, state = self._levels(self._time_constant, a.reshape(shape), b.reshape(shape))
        laws = np.array([(n, length * n) for n, length in product(exponents, lengths)])
        laws = laws[:, :, None]
        return Contacts(level[:, None], state, laws[:, 1], laws[:, 0], self.asymmetry)

    def _friction_under(self, common: Common) -> tuple[Array, Array]:
        """Return columns of f and f z0 (g, p) under a hypothesis that has friction."""
        a, b = self._friction(*_law(common), [common.lag])
        return a[0, 0, 0], b[0, 0, 0]

    def moves(self, common: Common) -> Contacts:
        """Return the friction with which the arm moves under a hypothesis that has friction, as one
        of h at once."""
        law = _law(common)
        return self._moves(*law, *self._along_turns(*law, [common.lag]))

    def try_all(self, axes: list[Array]) -> tuple[Array, Array, Array, Array, Array]:
        """Return what all hypotheses of a grid leave, each without a loss by heat and with one.

        That is where they have no friction (n, 2), their Q (n, 2), slopes (n, 2, 3) and variances
        of these by what is possible for friction: mean, trend, and the trend with friction that
        does not change; and of a loss by heat of either sign (n, 3) its value and variance by
        scatter, if all residuals are independent, for `HEATING_TIME`, and Q.
        """
        lengths, tau, exponents = (np.exp(axis) for axis in axes[:3])
        lags: list[float | None] = [None]
        if self.arm is not None:
            lags = [self.arm.lag]
        elif len(axes) > 3:
            lags = list(np.exp(axes[3]).tolist())
        columns = self._friction(lengths, exponents, lags)
        shape = (len(tau), *columns[0].shape[:3])
        each = [column.reshape(-1, *self._weight.shape) for column in columns]
        fits = [self._fit(*self.thermal(time_constant), each) for time_constant in tau.tolist()]
        free, square, slope, variance, loss = (
            np.moveaxis(np.reshape(parts, (*shape, *parts[0].shape[1:])), 2, 0).reshape(
                -1, *parts[0].shape[1:]
            )
            for parts in zip(*fits, strict=True)
        )
        warm = np.broadcast_to(warming(tau)[:, None, None], (len(lengths), *shape[:2], shape[3]))
        loss[:, 0] *= warm.ravel()
        loss[:, 1] *= warm.ravel() ** 2
        return free, square, slope, variance, loss

    def _fit(self, current: Array, lost: Array, friction: Sequence[Array]) -> tuple[Array, ...]:
        """Return, without a loss by heat and with one, where least squares find no friction (s, 2),
        Q (s, 2), slopes (s, 2, 3) and their variances (s, 2, 3); and of one of either sign (s, 3)
        its value, 1/(A2 s), variance and Q."""
        *without, _ = self._fit_columns(current, [], friction)
        *cold, loss = self._fit_columns(current, [lost], friction)
        both = zip(without, cold, strict=True)
        return *(np.stack(parts, axis=1) for parts in both), loss

    def _fit_columns(
        self, current: Array, lost: list[Array], friction: Sequence[Array]
    ) -> tuple[Array, Array, Array, Array, Array]:
        """Return what `_fit` does, for columns without a loss by heat or with one."""
        r, projected, rest = self._factors(current, lost, friction)
        square = rest[..., 0] @ self._share
        variance = (np.maximum(square, TINY) / self.dof)[:, None, None, None]
        # The inverse of a leading block of a triangle is the leading block of its inverse.
        inverse: Array = np.asarray(np.linalg.inv(r), dtype=np.float64)
        found = (inverse @ projected)[..., -3:-1, 0]
        cover = inverse[..., -3:-1, :] @ np.swapaxes(inverse[..., -3:-1, :], 2, 3) * variance
        left = possible(found, cover, LARGEST_FRICTION * self._span)
        logarithm = left.logarithm
        level = found[..., 0] @ self._share
        # The ripple's i |i| averages out over angles; as a column it would take most of the slope.
        inverse = inverse[..., :-1, :-1]
        found = inverse @ projected[..., :-1, :]
        # Heat takes as much of the constant at all temperatures; friction may change with them.
        tied = [3, -2] if lost else [-2]
        change = (FRICTION_CHANGE * np.maximum(level, 0.0))[:, None] ** 2
        each = rest[..., 1] / self.dof * self.kinds
        change = change / np.maximum(each, 1e-12 * change + TINY)
        trend, steady = (
            np.sum(without_known(inverse, found[..., 1], tied, wide), axis=1)
            for wide in (change, 0.0)
        )
        found = found[..., :-2, :]
        # All else follows what is possible for friction.
        others = inverse[..., :-2, :-2]
        follows = -others @ r[..., :-3, -3:-1]
        found[..., 0] += np.einsum("sgcf,sgf->sgc", follows, left.shift)
        varied = np.einsum("sgcf,sgfh,sgdh->sgcd", follows, left.covariance, follows)
        loss = np.zeros((len(square), 3))
        if lost:
            cover = others @ np.swapaxes(others, 2, 3) * variance + varied
            loss[:, 0] = -found[..., 3, 0] @ self._share
            loss[:, 1] = cover[..., 3, 3] @ self._share**2
            loss[:, 2] = square * (1 - 2 * logarithm.sum(axis=1) / self.dof)
            # no magnet gains by heat
            chance, shift = positive(-found[..., 3, 0], np.sqrt(cover[..., 3, 3]))
            found[..., 0] -= cover[..., 3] * (shift / cover[..., 3, 3])[..., None]
            logarithm = logarithm + chance
        # Far beyond what is possible, this is the sum of squares at the closest that is.
        square = square * (1 - 2 * logarithm.sum(axis=1) / self.dof)
        square = np.where(level > LARGEST_FRICTION * self._span, np.inf, square)
        mean = found[..., 0, 0] @ self._share
        slope, spread = np.stack([mean, trend, steady], axis=1), np.zeros((len(mean), 3))
        spread[:, 0] = (varied[..., 0, 0] @ self._share**2) * (level <= 0)
        loss[:, :2] /= np.stack([mean, mean**2], axis=1)
        loss[:, 2] = np.where(level > LARGEST_FRICTION * self._span, np.inf, loss[:, 2])
        return level <= 0, square, slope, spread, loss

    def _factors(
        self, current: Array, lost: list[Array], friction: Sequence[Array]
    ) -> tuple[Array, Array, Array]:
        """Return the triangle R (s, g, c, c) of (1) for columns of friction (s, g, p), which are
        the last two before the ripple's i |i|; Q' times the torques (s, g, c, 2); and the squares
        (s, g, 2) that least squares leave of these: all by the R of columns and torques."""
        smooth = np.stack([current, self._weight, self._step, *lost], axis=2)
        plain = np.broadcast_to(smooth, (len(friction[0]), *smooth.shape))
        curved = np.broadcast_to((current * np.abs(current))[..., None], (*plain.shape[:3], 1))
        torque = np.broadcast_to(self._torque, (*plain.shape[:3], 2))
        columns = [plain, np.stack(friction, axis=3), curved, torque]
        r = np.asarray(np.linalg.qr(np.concatenate(columns, axis=3), mode="r"), dtype=np.float64)
        c = r.shape[3] - 2
        return r[..., :c, :c], r[..., :c, c:], np.sum(r[..., c:, c:] ** 2, axis=2)

    def smooth(self, common: Common) -> None:
        """Take off the courses what a hypothesis leaves of the mean torques, as noise; and off
        their rates what its columns, and the ripple's i |i|, leave of these: noise and rounding.
        Where they show the arm, its swings are those of its motion."""
        noise = self.residual(common).reshape(self._weight.shape)
        courses = self.stairs.courses
        columns = self.columns(common)
        columns.append(columns[0] * np.abs(columns[0]))
        rest = [left_by(columns, rate) for rate in np.moveaxis(courses.torque_rate, 1, 0)]
        self.stairs = replace(self.stairs, courses=courses.less(noise, np.stack(rest, axis=1)))

    def find_arm(self, common: Common) -> None:
        """Find the arm in the mean courses, with the friction of a hypothesis."""
        self.arm = arm_of(self.stairs.courses, self.contacts(common))
        self._time_constant = common.time_constant

    def move_arm(self, common: Common) -> None:
        """Give the courses the swings of the arm, with the friction of a hypothesis."""
        if self.arm is not None:
            courses = self.arm.moved(self.stairs.courses, self.contacts(common))
            self.stairs = replace(self.stairs, courses=courses)

    def find_asymmetry(self, common: Common) -> float:
        """Find friction's asymmetry, linear about that so far, and return its standard uncertainty.

        The hypothesis gives way by what is linear in its s, exponent and tau. Beforehand the
        asymmetry is normal about 0 with `ASYMMETRY`; where friction is small, it stays there, and
        0 is returned.
        """
        contacts = self.contacts(common)
        if contacts.level <= 0:
            return 0.0
        columns, squared = self._about(common, contacts)
        column = left_by(columns, squared)
        rest = left_by(columns, self._torque[..., 0])
        power = max(float(np.sum(column**2)), TINY)
        change = float(np.sum(column * rest)) / power
        left = (rest - change * column).ravel()
        free = independent_samples(left, self._weight.ravel() > 0, 1) - PARAMETERS * self.kinds
        each = float(left @ left) / max(free, 1.0)
        known = 1 / (1 + each / power / ASYMMETRY**2)
        found = (self.asymmetry + change) * known
        self.asymmetry = within_limits(found)
        return ASYMMETRY * math.sqrt(1 - known)

    def _about(self, common: Common, contacts: Contacts) -> tuple[list[Array], Array]:
        """Return columns (g, p) of (1) and of changes of s, exponent and tau, and the derivative of
        friction by its asymmetry (g, p), N m."""

        def friction(changed: Common) -> Array:
            a, b = self._friction_under(changed)
            return a * contacts.level + b * contacts.torque()[:, :1]

        columns, now, more = self.columns(common), friction(common), 1 + CHANGE
        columns.append(columns[0] * np.abs(columns[0]))
        columns.append(self.thermal(common.time_constant * more)[1] - columns[3])
        for changed in (
            replace(common, transition=(common.transition or 0.0) * more),
            replace(common, exponent=common.exponent * more),
        ):
            columns.append(friction(changed) - now)
        asymmetry = self.asymmetry
        self.asymmetry = asymmetry + CHANGE
        derivative = (friction(common) - now) / CHANGE
        self.asymmetry = asymmetry
        return columns, derivative

    def columns(self, common: Common) -> list[Array]:
        """Return the columns of (1) on the mean staircases, current first, (g, p) each."""
        current, lost = self.thermal(common.time_constant)
        columns = [current, self._weight, self._step, lost]
        if common.transition is not None:
            columns += self._friction_under(common)
        return columns

    @property
    def kinds(self) -> int:
        """Number of mean staircases."""
        return len(self._members)

    @property
    def plateaus(self) -> float:
        """Plateaus of a mean staircase."""
        return float(self._weight.sum()) / self.kinds

    def contacts(self, common: Common) -> Contacts:
        """Return friction under a hypothesis: its largest torque, 0 where it has none, and its
        state on each plateau."""
        if common.transition is None:
            return Contacts(0.0, np.zeros(self._weight.shape), 1.0, 1.0)
        friction = (each[None] for each in self._friction_under(common))
        (level,), (state,) = self._levels(common.time_constant, *friction)
        return Contacts(float(level), state, common.transition, common.exponent, self.asymmetry)

    def _levels(self, time_constant: float, a: Array, b: Array) -> tuple[Array, Array]:
        """Return friction's largest torque (n,) and state (n, g, p) for its columns (n, g, p)."""
        current, lost = self.thermal(time_constant)
        r, projected, _ = self._factors(current, [lost], [a, b])
        found = np.linalg.solve(r, projected)[..., -3:-1, 0]
        level = found[..., 0] @ self._share
        along = a * found[..., :1] + b * found[..., 1:]
        friction = -along / np.maximum(level, 1e-12 * self._span)[:, None, None]
        state = state_of(friction, self.asymmetry)
        return np.clip(level, 0.0, LARGEST_FRICTION * self._span), state

    def residual(self, common: Common) -> Array:
        """Return the residual of (1) with the ripple's i |i| on the mean staircases, (g p,) N m."""
        columns = self.columns(common)
        curved = columns[0] * np.abs(columns[0])
        return left_by([*columns, curved], self._torque[..., 0]).ravel()

    def independent(self, common: Common) -> float:
        """Return how many independent residuals a hypothesis leaves, less its parameters."""
        residual, used = self.residual(common), self._weight.ravel() > 0
        return independent_samples(residual, used, 1) - PARAMETERS * self.kinds


def _law(common: Common) -> tuple[Array, Array]:
    """Return the transition over its exponent, and the exponent of a hypothesis, (1,) each."""
    return np.array([(common.transition or 0.0) / common.exponent]), np.array([common.exponent])
