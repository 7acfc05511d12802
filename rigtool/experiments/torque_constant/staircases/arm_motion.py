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
from numpy.typing import NDArray

from rigtool.experiments.torque_constant.staircases.swings import (
    LARGEST_DAMPING,
    Courses,
    longest_lag,
)
from rigtool.numerics.arrays import TINY, Array
from rigtool.numerics.compiled import compiled
from rigtool.numerics.powers import raise_to

FINEST_ANGLE = 0.1
"""Angle of the arm's oscillation in one step of the integration, rad."""

STRIDE = 1.5
"""Ratio of the natural frequencies of arms with one of which the search begins; the slowest of them
swings half a period on a plateau."""

LARGEST_ASYMMETRY = 0.45
"""From half on, friction z (1 + A z) would not grow with its state z everywhere."""

RANGE = math.log(5.0)
"""Natural frequency and lag are searched up to this beyond where the search begins, logarithm."""


@dataclass(frozen=True)
class Contacts:
    """Friction `level` f in N m and its `state` z (g, p) on each plateau; `transition` s in N m and
    `exponent` i of its law; `asymmetry` A, by which it is larger where torque rises. Of h
    hypotheses at once, the state is (h, g, p), level, transition and exponent (h, 1)."""

    level: float | Array
    state: Array
    transition: float | Array
    exponent: float | Array
    asymmetry: float = 0.0

    def torque(self) -> Array:
        """Return friction on each plateau (..., g, p), N m."""
        level = np.asarray(self.level)[..., None]
        return level * self.state * (1 + self.asymmetry * self.state)


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
        swings: Array = np.empty(courses.course.shape)
        drive, step = courses.torque + contacts.torque(), courses.part / self.steps
        first = np.stack([courses.torque[:, 0], contacts.state[:, 0]])
        law = contacts.level, contacts.transition, contacts.exponent, contacts.asymmetry
        _swing(drive, step, self.steps, (self.frequency, self.lag), law, first, swings)
        settled = swings[:, :, courses.course.shape[2] // 2 :]
        swings -= settled.mean(axis=2, keepdims=True)
        return swings

    def friction_state(self, courses: Courses, contacts: Contacts) -> tuple[Array, Array]:
        """Return a and b (..., g, p) of friction z (1 + A z) = a + b h after each plateau, where h
        is that before the first."""
        state, kept = self._slide(courses, contacts)
        first, asymmetry = contacts.state[..., :1], contacts.asymmetry
        friction, kept = one_sided(state, kept, asymmetry)
        before, change = one_sided(first, np.ones(first.shape), asymmetry)
        return friction - kept / change * before, kept / change

    def _slide(self, courses: Courses, contacts: Contacts) -> tuple[Array, Array]:
        """Return states of friction (..., g, p) after each plateau and dz/dz0 (..., g, p)."""
        drive = courses.torque + contacts.torque()
        laws = np.empty((3, *drive.shape[:-1]))
        laws[0], laws[1], laws[2] = contacts.level, contacts.transition, contacts.exponent
        step, still = np.empty((2, *drive.shape))
        step[:], still[:] = courses.part / self.steps, courses.torque
        lanes = np.zeros((LANES, laws[0].size))
        lanes[0], lanes[1] = still[..., 0].ravel(), contacts.state[..., 0].ravel()
        lanes[3] = 1.0
        state, kept = np.empty((2, *drive.shape))
        flat = -1, drive.shape[-1]
        _slide_all(
            drive.reshape(flat),
            step.reshape(flat),
            self.steps * courses.course.shape[2],
            (self.frequency, self.lag, contacts.asymmetry),
            laws.reshape(3, -1),
            lanes,
            lanes.view(np.uint64),
            state.reshape(flat),
            kept.reshape(flat),
        )
        return state, kept


def one_sided(state: Array, kept: Array, asymmetry: float) -> tuple[Array, Array]:
    """Return friction z (1 + A z) of states z (..., p), and its derivative; `kept` is that of z."""
    return state * (1 + asymmetry * state), kept * (1 + 2 * asymmetry * state)


def state_of(friction: Array, asymmetry: float) -> Array:
    """Return states z (..., p) within -1 to 1 whose friction is z (1 + A z)."""
    root = np.sqrt(np.maximum(1 + 4 * asymmetry * friction, 0.0))
    return np.clip(2 * friction / (1 + root), -1.0, 1.0)


def within_limits(asymmetry: float) -> float:
    """Return the nearest relative asymmetry with which friction grows with its state."""
    return min(max(asymmetry, -LARGEST_ASYMMETRY), LARGEST_ASYMMETRY)


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
def _swing(
    drive: Array,
    step: Array,
    steps: int,
    arm: tuple[float, float],
    law: tuple[float, float, float, float],
    first: Array,
    torque: Array,
) -> None:
    """Move g arms under motor torques (g, p) N m by (1) and write the gauge's `torque` (g, p, c)
    N m.

    `step` (g, p) s is that of the integration, `steps` to a value of the course; `arm` is w and l,
    `law` f, s, i and A, `first` (2, g) x and z. The damping acts with the mean of the speeds before
    and after (leapfrog: Hairer, Lubich and Wanner, Geometric Numerical Integration, 2006,
    section I.1).
    """
    frequency, lag = arm
    level, transition, exponent, asymmetry = law
    for g in range(len(drive)):
        x, z, speed = first[0, g], first[1, g], 0.0
        for j in range(drive.shape[1]):
            push = frequency * frequency * step[g, j]
            drag = push * lag / 2.0
            for part in range(torque.shape[2]):
                total = 0.0
                for _ in range(steps):
                    before = speed
                    pull = drive[g, j] - x - level * z * (1.0 + asymmetry * z)
                    speed = ((1.0 - drag) * before + push * pull) / (1.0 + drag)
                    way = speed * step[g, j]
                    total += x + lag * (before + speed) / 2.0
                    x += way
                    side = math.copysign(1.0, way)
                    left = 1.0 - side * z
                    if left > 0.0:
                        way = abs(way) / transition
                        if exponent == 1.0:
                            ratio = 1.0 / (1.0 + way)
                        else:
                            ratio = max(1.0 - way * left ** (exponent - 1.0), 0.0)
                        z = side * (1.0 - left * ratio)
                torque[g, j, part] = total / steps


LANES = 12
"""Numbers that each arm has in `_slide_all`."""


@compiled
def _slide_all(
    drive: Array,
    step: Array,
    steps: int,
    arm: tuple[float, float, float],
    contacts: Array,
    lanes: Array,
    bits: NDArray[np.uint64],
    state: Array,
    kept: Array,
) -> None:
    """Move k arms side by side, each as in `_swing`, and write the `state` z (k, p) of friction
    after each plateau and its derivative `kept` (k, p) at z0.

    `steps` are those of a plateau; `arm` is w, l and A, `contacts` (3, k) f, s and i of each. The
    first `lanes` (12, k) are x, z, speed and dz/dz0, the others room; `bits` is their memory. Loops
    that write to one array run several arms at a time.
    """
    frequency, lag, asymmetry = arm
    level, transition, exponent = contacts[0], contacts[1], contacts[2]
    x, z, speed, slope = lanes[0], lanes[1], lanes[2], lanes[3]
    left, ratio, spare, curved = lanes[4], lanes[5], lanes[6], lanes[7]
    coast, push, pull, time = lanes[8], lanes[9], lanes[10], lanes[11]
    count = len(x)
    for k in range(count):
        curved[k] = exponent[k] - 1.0
    for j in range(drive.shape[1]):
        for k in range(count):
            time[k], pull[k] = step[k, j], drive[k, j]
            whole = frequency * frequency * step[k, j]
            drag = whole * lag / 2.0
            coast[k], push[k] = (1.0 - drag) / (1.0 + drag), whole / (1.0 + drag)
        for _ in range(steps):
            for k in range(count):
                friction = level[k] * z[k] * (1.0 + asymmetry * z[k])
                speed[k] = coast[k] * speed[k] + push[k] * (pull[k] - x[k] - friction)
            for k in range(count):
                x[k] += speed[k] * time[k]
            for k in range(count):
                left[k] = max(1.0 - math.copysign(1.0, speed[k]) * z[k], TINY)
            for k in range(count):
                ratio[k] = left[k]
            raise_to(ratio, bits[5], curved, spare)
            for k in range(count):
                way = abs(speed[k]) * time[k] / transition[k]
                slid = max(1.0 - way * ratio[k], 0.0)
                ratio[k] = 1.0 / (1.0 + way) if exponent[k] == 1.0 else slid
            for k in range(count):
                less = max(1.0 - exponent[k] * (1.0 - ratio[k]), 0.0)
                # Contacts that slide keep what they have: without any, columns would be singular.
                slope[k] *= less if left[k] > TINY else 1.0
            for k in range(count):
                z[k] = math.copysign(1.0, speed[k]) * (1.0 - left[k] * ratio[k])
        for k in range(count):
            state[k, j], kept[k, j] = z[k], slope[k]
