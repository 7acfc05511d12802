"""Mean staircases, one of each kind, and what hypotheses about all of them leave.

A hypothesis fixes s, tau, exponent and lag in (1) of
`rigtool.experiments.torque_constant.staircase_model`; all else is linear there:

    torque = X(s, tau, e, lag) b + residual,   Q = mean over kinds of sum of residual^2
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from rigtool.experiments.torque_constant.arm_motion import Arm, Contacts, arm_of
from rigtool.experiments.torque_constant.friction_cone import possible
from rigtool.experiments.torque_constant.staircase_model import Common, Stairs, mean_of, winding
from rigtool.experiments.torque_constant.swings import friction_state, paths, straight_path
from rigtool.numerics.arrays import Array
from rigtool.numerics.residual_covariance import independent_samples

LARGEST_FRICTION = 0.25
"""Largest friction, relative to the span of the torque."""

PARAMETERS = 7
"""Linear parameters of a mean staircase."""


class MeanStaircases:
    """Mean staircases, one of each kind, and what hypotheses leave of them.

    `coefficient` is c of (1), 1/K; `trend` (m,) combines the constants of the staircases to their
    change with temperature, 1/K. In shapes, g counts kinds, p plateaus, s transitions, c columns.
    """

    def __init__(self, stairs: Stairs, coefficient: float, trend: Array) -> None:
        self.stairs, self._coefficient = stairs, coefficient
        self.arm: Arm | None = None
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
        self.dof = int(self._weight.sum()) - PARAMETERS * len(self._members)

    def _mean(self, values: Array) -> Array:
        return np.stack([values[those].mean(axis=0) for those in self._members])

    def thermal(self, time_constant: float) -> tuple[Array, Array]:
        """Return current, warmed, and its loss by heat, (2, g, p)."""
        heat, warmth = winding(self.stairs, time_constant)
        drift = warmth - mean_of(warmth, self.stairs.weight)[:, None]
        current = self.stairs.current * (1 + self._coefficient * drift)
        return self._mean(current), self._mean(current * heat)

    def _ways(self, lags: Sequence[float | None]) -> list[Array]:
        """Return the path of each lag; None alone, there is no lag, has that of straight steps."""
        courses = self.stairs.courses
        some = [lag for lag in lags if lag is not None]
        if not some:
            return [straight_path(courses)]
        return list(paths(courses, courses.torque, courses.course, some))

    def _friction(
        self, way: Array, transition: ArrayLike, exponent: ArrayLike
    ) -> tuple[Array, Array]:
        a, b = friction_state(way, transition, exponent)
        return -a * self._weight, -b * self._weight  # (..., g, p)

    def try_all(self, axes: list[Array]) -> tuple[list[Common], Array, Array, Array]:
        """Return all hypotheses of a grid, their Q (n,), slopes (n, 3) and variances of these by
        what is possible for friction: mean, trend, loss by heat."""
        transition, tau, exponents = (np.exp(axis) for axis in axes[:3])
        lags: list[float | None] = [None]
        if len(axes) > 3:
            lags = list(np.exp(axes[3]).tolist())
        if self.arm is not None:
            lags = [self.arm.lag]
            ways = self._own_ways(self.arm, transition, exponents)
        else:
            ways = np.stack(self._ways(lags), axis=1)
        columns = self._friction(ways, transition[:, None, None], exponents[:, None, None, None])
        shape = (len(tau), *columns[0].shape[:3])
        fits = [
            self._fit(*thermal, [each.reshape(-1, *self._weight.shape) for each in pair])
            for thermal in map(self.thermal, tau.tolist())
            for pair in zip(*columns, strict=True)
        ]
        square, slope, spread, free = (
            np.moveaxis(np.reshape(parts, (*shape, *parts[0].shape[1:])), 2, 0)
            for parts in zip(*fits, strict=True)
        )
        commons = [
            Common(None if without else float(s), float(exponent), lag, float(t))
            for (s, t, exponent, lag), without in zip(
                product(transition, tau, exponents, lags), free.ravel(), strict=True
            )
        ]
        slope, spread = slope.reshape(-1, 3), spread.reshape(-1, 3)
        warming = np.array([common.warming() for common in commons])
        slope[:, 2] *= warming
        spread[:, 2] *= warming**2
        return commons, square.ravel(), slope, spread

    def _fit(self, current: Array, lost: Array, friction: Sequence[Array]) -> tuple[Array, ...]:
        """Return Q (s,), slopes (s, 3) and their variances (s, 3), and where least squares find no
        friction (s,)."""
        *fits, added = self._fit_columns(current, [lost], friction)
        gains = added > 0  # as no magnet does by heat
        if not gains.any():
            return tuple(fits)
        *cold, _ = self._fit_columns(current, [], friction)
        return tuple(
            np.where(np.reshape(gains, (-1, *[1] * (one.ndim - 1))), other, one)
            for one, other in zip(fits, cold, strict=True)
        )

    def _fit_columns(
        self, current: Array, lost: list[Array], friction: Sequence[Array]
    ) -> tuple[Array, Array, Array, Array, Array]:
        """Return what `_fit` does, and what heat adds (s,)."""
        q, r = self._factors(current, lost, friction)
        projected = np.swapaxes(q, 2, 3) @ self._torque
        rest = self._torque[..., 0] - (q @ projected[..., :1])[..., 0]
        square = np.sum(rest**2, axis=2) @ self._share
        found: Array = np.asarray(np.linalg.solve(r, projected), dtype=np.float64)
        inverse: Array = np.asarray(np.linalg.inv(r), dtype=np.float64)
        level = found[..., -3, 0] @ self._share
        cover = inverse[..., -3:-1, :] @ np.swapaxes(inverse[..., -3:-1, :], 2, 3)
        variance = np.maximum(square, 1e-300) / self.dof
        cover *= variance[:, None, None, None]
        left = possible(found[..., -3:-1, 0], cover, LARGEST_FRICTION * self._span)
        # Far beyond what is possible, this is the sum of squares at the closest that is.
        square = square * (1 - 2 * left.logarithm.sum(axis=1) / self.dof)
        square = np.where(level > LARGEST_FRICTION * self._span, np.inf, square)
        # The ripple's i |i| averages out over angles; as a column it would take most of the slope.
        found = np.linalg.solve(r[..., :-1, :-1], projected[..., :-1, :])[..., :-2, :]
        # All else follows what is possible for friction.
        follows = -np.linalg.solve(r[..., :-3, :-3], r[..., :-3, -3:-1])
        found[..., 0] += np.einsum("sgcf,sgf->sgc", follows, left.shift)
        mean = found[..., 0, 0] @ self._share
        slope, spread = np.zeros((2, len(mean), 3))
        slope[:, 0], slope[:, 1] = mean, np.sum(found[..., 0, 1], axis=1)
        varied = np.einsum("sgcf,sgfh,sgch->sgc", follows, left.covariance, follows)
        spread[:, 0] = varied[..., 0] @ self._share**2
        added = np.zeros(mean.shape)
        if lost:
            added = found[..., 3, 0] @ self._share
            slope[:, 2], spread[:, 2] = -added / mean, varied[..., 3] @ self._share**2 / mean**2
        return square, slope, spread * (level <= 0)[:, None], level <= 0, added

    def _factors(
        self, current: Array, lost: list[Array], friction: Sequence[Array]
    ) -> tuple[Array, Array]:
        """Return QR factors (s, g, p, c), (s, g, c, c) of (1) for columns of friction (s, g, p);
        theirs are the last two before the ripple's i |i|."""
        smooth = np.stack([current, self._weight, self._step, *lost], axis=2)
        plain = np.broadcast_to(smooth, (len(friction[0]), *smooth.shape))
        curved = np.broadcast_to((current * np.abs(current))[..., None], (*plain.shape[:3], 1))
        q, r = np.linalg.qr(np.concatenate([plain, np.stack(friction, axis=3), curved], axis=3))
        return q, r

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

    def columns(self, common: Common) -> list[Array]:
        """Return the columns of (1) on the mean staircases, current first, (g, p) each."""
        current, lost = self.thermal(common.time_constant)
        columns = [current, self._weight, self._step, lost]
        if common.transition is not None:
            (way,) = self._ways([common.lag])
            columns += self._friction(way, common.transition, common.exponent)
        return columns

    @property
    def plateaus(self) -> float:
        """Plateaus of a mean staircase."""
        return float(self._weight.sum()) / len(self._members)

    def contacts(self, common: Common) -> Contacts:
        """Return friction under a hypothesis: its largest torque, 0 where it has none, and its
        state on each plateau."""
        if common.transition is None:
            return Contacts(0.0, np.zeros(self._weight.shape), 1.0, 1.0)
        (way,) = self._ways([common.lag])
        friction = self._friction(way, common.transition, common.exponent)
        (level,), (state,) = self._levels(common.time_constant, *(each[None] for each in friction))
        return Contacts(float(level), state, common.transition, common.exponent)

    def _levels(self, time_constant: float, a: Array, b: Array) -> tuple[Array, Array]:
        """Return friction's largest torque (n,) and state (n, g, p) for its columns (n, g, p)."""
        current, lost = self.thermal(time_constant)
        q, r = self._factors(current, [lost], [a, b])
        found = np.linalg.solve(r, np.swapaxes(q, 2, 3) @ self._torque[..., :1])[..., -3:-1, 0]
        level = found[..., 0] @ self._share
        along = a * found[..., :1] + b * found[..., 1:]
        state = np.clip(-along / np.maximum(level, 1e-300)[:, None, None], -1.0, 1.0)
        return np.clip(level, 0.0, LARGEST_FRICTION * self._span), state

    def _own_ways(self, arm: Arm, transition: Array, exponents: Array) -> Array:
        """Return the path of each transition (s,) and exponent (e,) of friction, (TURNS + 2, e, s,
        1, g, p) N m: how far the arm swings depends on friction, too."""
        courses = self.stairs.courses
        (way,) = self._ways([arm.lag])
        columns = self._friction(way, transition[:, None], exponents[:, None, None])
        shape = columns[0].shape
        each = (column.reshape(-1, *shape[2:]) for column in columns)
        found = []
        for level, state, (exponent, s) in zip(
            *self._levels(self._time_constant, *each), product(exponents, transition), strict=True
        ):
            contacts = Contacts(float(level), state, float(s), float(exponent))
            moved = arm.moved(courses, contacts)
            found.append(paths(moved, moved.torque, moved.course, [arm.lag])[0])
        ways = np.stack(found, axis=1)
        return ways.reshape(len(ways), *shape[:2], 1, *shape[2:])

    def residual(self, common: Common) -> Array:
        """Return the residual of (1) with the ripple's i |i| on the mean staircases, (g p,) N m."""
        columns = self.columns(common)
        curved = columns[0] * np.abs(columns[0])
        return left_by([*columns, curved], self._torque[..., 0]).ravel()

    def independent(self, common: Common) -> float:
        """Return how many independent residuals a hypothesis leaves, less its parameters."""
        residual, used = self.residual(common), self._weight.ravel() > 0
        return independent_samples(residual, used, 1) - PARAMETERS * len(self._members)


def left_by(columns: list[Array], torque: Array) -> Array:
    """Return what least squares leave of torques (g, p) by columns (g, p) of each kind."""
    q, _ = np.linalg.qr(np.stack(columns, axis=2))
    rest: Array = torque - np.einsum("gpc,gc->gp", q, np.einsum("gpc,gp->gc", q, torque))
    return rest
