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
        self._motion(courses, contacts, swings)
        settled = swings[:, :, courses.course.shape[2] // 2 :]
        swings -= settled.mean(axis=2, keepdims=True)
        return swings

    def friction_state(self, courses: Courses, contacts: Contacts) -> tuple[Array, Array]:
        """Return a and b (..., g, p) of friction z (1 + A z) = a + b h after each plateau, where h
        is that before the first."""
        torque = np.empty((0, *courses.course.shape[1:]))
        state, kept = self._motion(courses, contacts, torque)
        first, asymmetry = contacts.state[..., :1], contacts.asymmetry
        friction, kept = one_sided(state, kept, asymmetry)
        before, change = one_sided(first, np.ones(first.shape), asymmetry)
        return friction - kept / change * before, kept / change

    def _motion(self, courses: Courses, contacts: Contacts, torque: Array) -> tuple[Array, Array]:
        """Return states of friction (..., g, p) and dz/dz0 (..., g, p); write the torques (g, p, c)
        N m where there is room for them."""
        drive = courses.torque + contacts.torque()
        laws = np.empty((3, *drive.shape[:-1]))
        laws[0], laws[1], laws[2] = contacts.level, contacts.transition, contacts.exponent
        step, still = np.empty((2, *drive.shape))
        step[:], still[:] = courses.part / self.steps, courses.torque
        moves = np.zeros((5, laws[0].size))
        moves[0], moves[1] = still[..., 0].ravel(), contacts.state[..., 0].ravel()
        moves[3] = 1.0
        state, kept = np.empty((2, *drive.shape))
        flat = -1, drive.shape[-1]
        _move(
            drive.reshape(flat),
            step.reshape(flat),
            self.steps,
            (self.frequency, self.lag, contacts.asymmetry),
            laws.reshape(3, -1),
            moves,
            torque,
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
    arm: tuple[float, float, float],
    contacts: Array,
    moves: Array,
    torque: Array,
    state: Array,
    kept: Array,
) -> None:
    """Move k arms side by side under motor torques (k, p) N m by (1) and write the gauge's `torque`
    (k, p, c) N m, or none (0, p, c), the `state` z (k, p) of friction after each plateau and its
    derivative `kept` (k, p) at z0.

    `step` (k, p) s is that of the integration, `steps` to a value of the course; `arm` is w, l and
    A, `contacts` (3, k) f, s and i of each, `moves` (5, k) its x, z, speed, dz/dz0 and 0. The
    damping acts with the mean of the speeds before and after (leapfrog: Hairer, Lubich and Wanner,
    Geometric Numerical Integration, 2006, section I.1). A step of one arm waits for the one before,
    but not for those of others.
    """
    frequency, lag, asymmetry = arm
    level, transition, exponent = contacts
    x, z, speed, slope, total = moves
    for j in range(drive.shape[1]):
        for part in range(torque.shape[2]):
            for _ in range(steps):
                for k in range(len(x)):
                    push = frequency * frequency * step[k, j]
                    drag = push * lag / 2.0
                    before = speed[k]
                    friction = level[k] * z[k] * (1.0 + asymmetry * z[k])
                    pull = drive[k, j] - x[k] - friction
                    speed[k] = ((1.0 - drag) * before + push * pull) / (1.0 + drag)
                    way = speed[k] * step[k, j]
                    total[k] += x[k] + lag * (before + speed[k]) / 2.0
                    x[k] += way
                    side = math.copysign(1.0, way)
                    left = 1.0 - side * z[k]
                    if left > 0.0:
                        way = abs(way) / transition[k]
                        if exponent[k] == 1.0:
                            ratio = 1.0 / (1.0 + way)
                        else:
                            ratio = max(1.0 - way * left ** (exponent[k] - 1.0), 0.0)
                        slope[k] *= max(1.0 - exponent[k] * (1.0 - ratio), 0.0)
                        z[k] = side * (1.0 - left * ratio)
            for k in range(len(torque)):
                torque[k, j, part], total[k] = total[k] / steps, 0.0
        for k in range(len(x)):
            state[k, j], kept[k, j] = z[k], slope[k]
