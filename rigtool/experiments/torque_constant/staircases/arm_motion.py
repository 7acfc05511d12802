"""Swings of the arm after each step of a staircase, from its equation of motion.

In the elastic torque x of the arm, with natural frequency w and lag l of its damping,

    x''/w2 + l x' + x = M_j - f z (1 + A z),   dz = +-|1 -+ z|^i |dx| / s,   torque = x + l x'  (1)

where M_j is the motor's torque on plateau j. It is what the gauge shows at rest, and friction. Only
w and l are unknown. They are fitted to the courses of all plateaus together, so that the swings
have hardly any noise of the gauge. Noise in the swing of each step alone would count as path of
friction: less friction then fits the staircase, and the slope comes out low (errors in variables;
R. J. Carroll et al., Measurement Error in Nonlinear Models, 2nd ed., 2006, section 1.1).

The motion has the state z of friction itself. Turns that a course shows count only above its noise,
and without the smaller ones friction seems to do less.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from rigtool.experiments.torque_constant.staircases.swings import (
    LARGEST_DAMPING,
    Courses,
    longest_lag,
)
from rigtool.numerics.arrays import Array
from rigtool.numerics.compiled import compiled

FINEST_ANGLE = 0.1
"""Angle of the arm's oscillation in one step of the integration, rad."""

STRIDE = 1.5
"""Ratio of the natural frequencies of arms with one of which the search begins; the slowest of them
swings half a period on a plateau."""

RANGE = math.log(5.0)
"""Natural frequency and lag are searched up to this beyond where the search begins, logarithm."""


@dataclass(frozen=True)
class Contacts:
    """Friction `level` f in N m and its `state` z (g, p) on each plateau; `transition` s in N m and
    `exponent` i of its law; `asymmetry` A, by which it is larger where torque rises."""

    level: float
    state: Array
    transition: float
    exponent: float
    asymmetry: float = 0.0

    def torque(self) -> Array:
        """Return friction on each plateau (g, p), N m."""
        return self.level * self.state * (1 + self.asymmetry * self.state)


@dataclass(frozen=True)
class Arm:
    """Natural `frequency` w in rad/s and `lag` l in s of an arm; it moves in so many `steps` of
    integration for each value of a course."""

    frequency: float
    lag: float
    steps: int

    def moved(self, courses: Courses, contacts: Contacts) -> Courses:
        """Return the courses with the swings of (1), and what all steps leave of these in common.

        That is what the arm has beside (1), as a delay of the current.
        """
        measured = courses.course + courses.dropped - courses.torque[:, :, None]
        swings = self.swings(courses, contacts)
        step = np.diff(courses.torque, prepend=courses.torque[:, :1])
        common = np.einsum("gp,gpc->gc", step, measured - swings)
        swings += step[:, :, None] * (common / np.sum(step**2, axis=1)[:, None])[:, None]
        left = measured - swings
        return replace(
            courses,
            course=courses.torque[:, :, None] + swings,
            noise=np.sqrt(np.mean(left**2, axis=(1, 2)) / left.shape[1]),
            dropped=left,
        )

    def swings(self, courses: Courses, contacts: Contacts) -> Array:
        """Return the swings (g, p, c) of (1) about where the arm comes to rest, N m."""
        swings, _, _ = self._motion(courses, contacts)
        settled = swings[:, :, courses.course.shape[2] // 2 :]
        swings -= settled.mean(axis=2, keepdims=True)
        return swings

    def friction_state(self, courses: Courses, contacts: Contacts) -> tuple[Array, Array]:
        """Return a and b (g, p) of friction z (1 + A z) = a + b h after each plateau, where h is
        that before the first."""
        _, state, kept = self._motion(courses, contacts)
        first, asymmetry = contacts.state[:, :1], contacts.asymmetry
        friction, kept = one_sided(state, kept, asymmetry)
        before, change = one_sided(first, np.ones(first.shape), asymmetry)
        return friction - kept / change * before, kept / change

    def _motion(self, courses: Courses, contacts: Contacts) -> tuple[Array, Array, Array]:
        """Return torques (g, p, c) N m, states of friction (g, p) and dz/dz0 (g, p)."""
        torque: Array = np.empty(courses.course.shape)
        state, kept = np.empty((2, *courses.torque.shape))
        drive = courses.torque + contacts.torque()
        for number in range(len(torque)):
            _move(
                drive[number],
                courses.part[number] / self.steps,
                self.steps,
                (self.frequency, self.lag),
                (contacts.level, contacts.asymmetry, contacts.transition, contacts.exponent),
                (courses.torque[number, 0], contacts.state[number, 0]),
                torque[number],
                state[number],
                kept[number],
            )
        return torque, state, kept


def one_sided(state: Array, kept: Array, asymmetry: float) -> tuple[Array, Array]:
    """Return friction z (1 + A z) of states z (..., p), and its derivative; `kept` is that of z."""
    return state * (1 + asymmetry * state), kept * (1 + 2 * asymmetry * state)


def state_of(friction: Array, asymmetry: float) -> Array:
    """Return states z (..., p) within -1 to 1 whose friction is z (1 + A z)."""
    root = np.sqrt(np.maximum(1 + 4 * asymmetry * friction, 0.0))
    state: Array = np.clip(2 * friction / (1 + root), -1.0, 1.0)
    return state


def arm_of(courses: Courses, contacts: Contacts) -> Arm | None:
    """Return the arm whose swings are those of the mean courses; None where these show none."""
    slowest = longest_lag(courses)
    if slowest is None:
        return None
    measured = courses.course + courses.dropped - courses.torque[:, :, None]
    longest = float(np.max(courses.part))

    def arm(logarithms: Array) -> Arm:
        frequency, lag = np.exp(logarithms).tolist()
        return Arm(frequency, lag, steps)

    def left(logarithms: Array) -> Array:
        rest = arm(logarithms).swings(courses, contacts) - measured
        return rest[:, 1:].ravel()

    from scipy.optimize import least_squares

    # Noise on the swing of a slow arm passes for turns of a fast one.
    fastest = 2 * LARGEST_DAMPING / slowest
    slower = math.log(fastest * courses.course.shape[2] * longest / math.pi) / math.log(STRIDE)
    frequencies = fastest * STRIDE ** -np.arange(max(math.floor(slower), 0) + 1.0)
    steps = max(math.ceil(fastest * longest / FINEST_ANGLE), 1)
    starts = np.log(np.stack([frequencies, LARGEST_DAMPING / 2 / frequencies], axis=1))
    start = min(starts, key=lambda one: float(np.sum(left(one) ** 2)))
    steps = max(math.ceil(math.exp(start[0]) * longest / FINEST_ANGLE), 1)
    bounds = (start - RANGE, start + RANGE)
    found = least_squares(left, start, bounds=bounds, diff_step=np.full(2, 1e-4))
    return arm(found.x)


@compiled
def _move(
    drive: Array,
    step: Array,
    steps: int,
    arm: tuple[float, float],
    contacts: tuple[float, float, float, float],
    start: tuple[float, float],
    torque: Array,
    state: Array,
    kept: Array,
) -> None:
    """Move the arm under motor torques (p,) N m by (1) and write the gauge's `torque` (p, c) N m,
    the `state` z (p,) of friction after each plateau and its derivative `kept` (p,) at z0.

    `step` (p,) s is that of the integration, `steps` to a value of the course; the damping acts
    with the mean of the speeds before and after (leapfrog: Hairer, Lubich and Wanner, Geometric
    Numerical Integration, 2006, section I.1).
    """
    frequency, lag = arm
    level, asymmetry, transition, exponent = contacts
    x, z = start
    speed, slope = 0.0, 1.0
    for j in range(len(drive)):
        push = frequency * frequency * step[j]
        drag = push * lag / 2.0
        for part in range(torque.shape[1]):
            total = 0.0
            for _ in range(steps):
                before = speed
                friction = level * z * (1.0 + asymmetry * z)
                speed = ((1.0 - drag) * speed + push * (drive[j] - x - friction)) / (1.0 + drag)
                way = speed * step[j]
                total += x + lag * (before + speed) / 2.0
                x += way
                side = math.copysign(1.0, way)
                left = 1.0 - side * z
                if left > 0.0:
                    if exponent == 1.0:
                        after = left / (1.0 + abs(way) / transition)
                    else:
                        after = max(left - abs(way) / transition * left**exponent, 0.0)
                    slope *= max(1.0 - exponent * (1.0 - after / left), 0.0)
                    z = side * (1.0 - after)
            torque[j, part] = total / steps
        state[j], kept[j] = z, slope
