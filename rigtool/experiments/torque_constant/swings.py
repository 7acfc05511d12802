"""Path of an arm that swings after each step of a staircase, and friction along that path.

Friction follows dz = (+-1 - z) |dx| / s along every swing of the arm, to and fro (P. R. Dahl 1968),
so that z depends on how far the arm overshoots. The gauge shows the swings with the arm's damping,

    torque = x + lag dx/dt                                                              (1)

where x is the elastic torque of the arm.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rigtool.numerics.arrays import Array

TURNS = 12
"""Largest number of turns of the arm that count after one step."""

NOISE = 6.0
"""Turns count beyond this many standard deviations of the noise, whose own range is about 5."""


@dataclass(frozen=True)
class Courses:
    """Mean courses of torque over g kinds of staircases, those with the same set points.

    `torque` (g, p) in N m is that of the settled plateaus, `course` (g, p, c) over the whole of
    each, `part` (g, p) the time between two values of the course, s; `noise` (g,) in N m the
    standard deviation of one; `kind` (m,) the kind of each staircase, and `scale` (m,) its torque
    relative to the mean of its kind.
    """

    setpoint: Array
    torque: Array
    course: Array
    part: Array
    noise: Array
    kind: NDArray[np.int64]
    scale: Array

    def of_each(self, swings: Array) -> Array:
        """Return the path (n, m, p) of each staircase from that of its kind, (n, g, p)."""
        scaled: Array = swings[:, self.kind] * self.scale[:, None]
        return scaled


def mean_courses(setpoint: Array, torque: Array, course: Array, duration: Array) -> Courses:
    """Average set points (m, p), torques, courses (m, p, c) and durations over equal staircases."""
    step = 2e-3 * max(float(np.ptp(setpoint)), 1e-12)
    kind = np.unique(np.round(setpoint / step), axis=0, return_inverse=True)[1].reshape(-1)
    settled = course[:, :, -(course.shape[2] // 3) :]
    ripple = settled - settled.mean(axis=2, keepdims=True)
    kinds = [kind == number for number in range(int(kind.max()) + 1)]

    def mean(values: Array) -> Array:
        return np.stack([values[those].mean(axis=0) for those in kinds])

    noise = [
        math.sqrt(float(np.mean(ripple[those] ** 2)) / np.count_nonzero(those)) for those in kinds
    ]
    part = mean(duration) / course.shape[2]
    rise, of_kind = (values - values.mean(axis=1)[:, None] for values in (torque, mean(torque)))
    scale = np.sum(rise * of_kind[kind], axis=1) / np.sum(of_kind**2, axis=1)[kind]
    return Courses(
        setpoint=mean(setpoint),
        torque=mean(torque),
        course=mean(course),
        part=part,
        noise=np.array(noise),
        kind=kind.astype(np.int64),
        scale=scale,
    )


def swings_seen(courses: Courses) -> bool:
    """Return whether the gauge shows the arm swing after most steps."""
    swings = path(courses, float(np.min(courses.part)) / 20)
    return bool(np.mean(swings[2, :, 1:] != 0) > 0.5)


def path(courses: Courses, lag: float) -> Array:
    """Return the path to each plateau, (TURNS + 2, g, p) N m: its swings, signed, in sequence.

    `lag` is that of (1), s. The path to the first plateau is empty.
    """
    before, after = courses.torque[:, :-1], courses.torque[:, 1:]
    follow = -np.expm1(-courses.part[:, 1:] / lag)
    threshold = NOISE * courses.noise[:, None] * np.sqrt(follow / (2 - follow))
    swings = np.zeros((TURNS + 2, *courses.torque.shape))
    rows, columns = np.arange(len(before))[:, None], np.arange(before.shape[1])[None, :]
    elastic, extreme, turned = before.copy(), before.copy(), before.copy()
    direction = np.sign(after - before)
    count = np.zeros(before.shape, dtype=np.int64)
    for value in np.moveaxis(courses.course[:, 1:], 2, 0):
        elastic = elastic + follow * (value - elastic)
        extreme = np.where((elastic - extreme) * direction > 0, elastic, extreme)
        turns = ((extreme - elastic) * direction > threshold) & (count < TURNS)
        row, column = np.nonzero(turns)
        here = (count[turns], row, column + 1)
        swings[here] = (extreme - turned)[turns]
        turned = np.where(turns, extreme, turned)
        extreme = np.where(turns, elastic, extreme)
        direction = np.where(turns, -direction, direction)
        count += turns
    swings[count, rows, columns + 1] = extreme - turned
    swings[count + 1, rows, columns + 1] = after - extreme
    return swings


def straight_path(courses: Courses) -> Array:
    """Return the path of an arm that friction hardly holds back, (1, g, p) N m: k times a step."""
    slope = np.ptp(courses.torque) / np.ptp(courses.setpoint)
    first = courses.setpoint[:, :1]
    swing: Array = slope * np.diff(courses.setpoint, axis=1, prepend=first)[None]
    return swing


def friction_state(swings: Array, transition: float) -> tuple[Array, Array]:
    """Return a and b (m, p) of the friction's state z = a + b z0 after swings (n, m, p), N m."""
    _, staircases, plateaus = swings.shape
    gained, kept = np.zeros((staircases, plateaus)), np.ones((staircases, plateaus))
    for swing in swings:
        decay = np.exp(-np.abs(swing) / transition)
        gained = np.sign(swing) + (gained - np.sign(swing)) * decay
        kept = kept * decay
    a, b = np.zeros((staircases, plateaus)), np.ones((staircases, plateaus))
    for j in range(1, plateaus):
        a[:, j] = gained[:, j] + kept[:, j] * a[:, j - 1]
        b[:, j] = kept[:, j] * b[:, j - 1]
    return a, b
