"""The disturbance of a load by position, speed, direction and torque: learned at known loads.

The motor's torque with a load, less that of the same motion without, is

    y = s - s0 + sum over terms of coefficient (function with load - function without load)

s and s0 are the torques that the tendon carries (`tendon`), the functions those of
`terms`. Both sides pass the same low-pass and are compared over the straight part of
the strokes. What changes from one recording to the next (the friction level of each direction:
'instrument friction changes in time') is fitted for each recording and dropped; so is the scatter
of the cycles without load, which all loads of a speed have in common.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from rigtool.experiments.load_disturbance.cycles import LoadedCycles
from rigtool.experiments.load_disturbance.tendon import Tendon, swing
from rigtool.experiments.load_disturbance.terms import State, Term, functions
from rigtool.numerics.arrays import Array
from rigtool.numerics.steady_mean import steady_u

ROWS = 4
"""Points that are compared, for each period of the bandwidth."""


@dataclass(frozen=True, eq=False)
class LoadedPair:
    """A load beside the same motion without it.

    `unloaded` are all recordings of the motion without load, `rows` (r,) the points of the period
    that are compared.
    """

    loaded: LoadedCycles
    unloaded: tuple[LoadedCycles, ...]
    rows: NDArray[np.intp]

    @staticmethod
    def of(loaded: LoadedCycles, unloaded: Sequence[LoadedCycles], margin: float) -> LoadedPair:
        """Compare with recordings of the same motion without load.

        `margin` is the output angle, rad, that is left out at both ends of the stroke.
        """
        left_out = margin * loaded.transmission.angle_ratio
        low, high = loaded.setpoint.min() + left_out, loaded.setpoint.max() - left_out
        inside = np.flatnonzero((loaded.setpoint > low) & (loaded.setpoint < high))
        wanted = ROWS * loaded.transmission.bandwidth_hz * loaded.period
        step = max(1, int(len(loaded.setpoint) / wanted))
        return LoadedPair(loaded, tuple(unloaded), inside[::step])

    @cached_property
    def unloaded_torque(self) -> Array:
        """Torque of the mean cycle without load (n,), N m, not low-passed."""
        mean: Array = np.mean([each.mean for each in self.unloaded], axis=0)
        return mean

    @cached_property
    def torque(self) -> Array:
        """What the load adds to the motor's torque, low-passed (n,), N m."""
        return self.loaded.lowpass(self.loaded.mean - self.unloaded_torque)

    @cached_property
    def nuisance(self) -> Array:
        """Friction levels of a recording by itself, low-passed (3, n)."""
        d, a = self.loaded.direction, self.loaded.output_angle
        return self.loaded.lowpass(np.stack([d, d * np.sin(a), d * np.cos(a)]))

    @cached_property
    def zero_error(self) -> Array:
        """The shape in which a wrong zero looks like a load, low-passed (n,)."""
        return self.loaded.lowpass(np.sin(self.loaded.output_angle))

    @property
    def independent(self) -> float:
        """Number of compared points that are independent after the low-pass."""
        loaded, rows = self.loaded, len(self.rows)
        used = rows * self.rows_apart / len(loaded.setpoint)
        return min(rows, 2 * loaded.transmission.bandwidth_hz * loaded.period * used)

    @property
    def rows_apart(self) -> int:
        """Points of the period from one row to the next."""
        return int(np.min(np.diff(self.rows))) if len(self.rows) > 1 else 1

    def scatter(self) -> float:
        """Return the standard deviation of a single cycle's torque at a point, low-passed, N m."""
        cycles = self.loaded.lowpass(self.loaded.torque - self.loaded.torque.mean(axis=0))
        return float(np.sqrt(np.mean(cycles[:, self.rows] ** 2)))

    def noise(self) -> float:
        """Return the standard uncertainty of the mean cycle with the load at a point, N m."""
        u, _ = steady_u(self.loaded.lowpass(self.loaded.torque)[:, self.rows])
        return float(np.sqrt(np.mean(u**2)))

    def zero_noise(self) -> float:
        """Return the standard uncertainty of the torque without load as it acts on a load, N m."""
        shape = np.vstack([self.zero_error, self.nuisance])[:, self.rows]
        weight = np.linalg.pinv(shape.T)[0]
        us = [
            steady_u(each.lowpass(each.torque)[:, self.rows] @ weight)[0] for each in self.unloaded
        ]
        return math.hypot(*us) / len(us)

    def design(self, listed: Sequence[Term], loaded: State, unloaded: State) -> Array:
        """Return the terms' differences, low-passed (t, n), N m for a coefficient of 1."""
        speed = self.loaded.speed
        difference = functions(listed, loaded, speed) - functions(listed, unloaded, speed)
        return self.loaded.lowpass(difference)

    def states(self, tendon: Tendon, moment: float) -> tuple[State, State]:
        """Return the states with a load of this moment, N m, and without."""
        return state_under(self.loaded, tendon, moment), state_under(self.unloaded[0], tendon, 0.0)


def state_under(cycles: LoadedCycles, tendon: Tendon, moment: float) -> State:
    """Return the state along a cycle with a load of this moment, N m."""
    angle, arm = cycles.output_angle, cycles.transmission.arm
    return State.of(cycles, *swing(angle, cycles.period, tendon, moment, arm))


@dataclass(frozen=True, eq=False)
class Disturbance:
    """A learned disturbance.

    `coefficient` (t,) of the `terms`; `covariance` (3 + t, 3 + t) of the tendon's stiffness,
    damping and tip friction, in SI units, and of the coefficients. `torque` N m is the largest
    learned load, `speeds` rad/s those of the motor.
    """

    terms: tuple[Term, ...]
    tendon: Tendon
    coefficient: Array
    covariance: Array
    torque: float
    speeds: tuple[float, ...]

    def expectation(self, pair: LoadedPair) -> Callable[[float], Array]:
        """Return `expected` as a function of a load's moment, N m, for many evaluations."""
        loaded, speed = pair.loaded, pair.loaded.speed

        def whole(state: State) -> Array:
            added: Array = self.coefficient @ functions(self.terms, state, speed)
            return state.carried + added

        rest = whole(state_under(pair.unloaded[0], self.tendon, 0.0))
        return lambda moment: loaded.lowpass(whole(state_under(loaded, self.tendon, moment)) - rest)

    def expected(self, pair: LoadedPair, moment: float) -> Array:
        """Return what a load of this moment, N m, adds to the motor's torque, low-passed (n,)."""
        return self.expectation(pair)(moment)

    def sensitivity(self, pair: LoadedPair, moment: float) -> Array:
        """Return the derivatives of `expected` by all that is uncertain, (3 + t, n)."""
        loaded, unloaded = pair.states(self.tendon, moment)
        design = pair.design(self.terms, loaded, unloaded)
        middle = self.expected(pair, moment)
        parameters = tendon_parameters(self.tendon)
        by_tendon = []
        for number, u in enumerate(np.sqrt(np.diag(self.covariance)[:3])):
            step = max(float(u), 1e-6 * parameters[number])
            if step == 0:
                by_tendon.append(np.zeros_like(middle))
                continue
            moved = parameters.copy()
            moved[number] += step
            other = replace(self, tendon=Tendon(*moved.tolist()))
            by_tendon.append((other.expected(pair, moment) - middle) / step)
        return np.vstack([by_tendon, design])


def tendon_parameters(tendon: Tendon) -> Array:
    """Return stiffness, damping and tip friction (3,), in SI units."""
    return np.array([tendon.stiffness, tendon.damping, tendon.tip_friction])
