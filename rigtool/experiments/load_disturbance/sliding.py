"""Torque that a load adds while the rotor slides evenly: by angle, direction and load.

At a constant speed every part of the model (`experiments.force_model.model`) is a function of
the angle: bristles are bent to one side, and what lags has followed. With a torque s on the tendon

    added = n (sum of coefficient (function(s) - function(s0))),   s0 = t z_t,   a = b / r - s / k

changes the friction that grows with s, that of the output angle a, and the current, with which
ripple grows; the current that follows from all of it is found by iteration.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rigtool.experiments.force_model.learning import LearnedModel
from rigtool.experiments.force_model.model import RecordState, Shape, functions
from rigtool.experiments.force_model.records import Record
from rigtool.experiments.force_model.sliding_problem import (
    DERIVATIVE_STEP,
    SLIDING_PARAMETERS,
    stepped_shape,
)
from rigtool.numerics.arrays import Array

STEADY_PARAMETERS = ("stribeck_speed", "ripple_time", "stiffness", "load_onset", "direction_ratio")
"""Parameters of a shape on which even sliding under a given load depends."""

CURRENT_ITERATIONS = 3
"""Times that the current of a point, which its own disturbance changes, is computed anew."""

WAY_POINTS = 150
"""Points of the way over all angles and of the way before them, on which lags settle."""

LAG_LENGTHS = 6.0
"""Length of the way before, in times of the ripple's lag."""


@dataclass(frozen=True, eq=False)
class SlidingRecord(Record):
    """A motion at constant `rate`, rad/s of the rotor."""

    rate: float

    @property
    def speed(self) -> Array:
        """Speed of the rotor (n,), rad/s."""
        return np.full(self.angle.size, self.rate)

    @property
    def acceleration(self) -> Array:
        """None (n,), rad/s2."""
        return np.zeros(self.angle.size)

    @property
    def current_rate(self) -> Array:
        """As good as none (n,), A/s."""
        return np.zeros(self.angle.size)


@dataclass(frozen=True, eq=False)
class DisturbanceGrid:
    """The disturbance by motor speed rad/s, `angle` (a,) rad of the output, and `load` (l,) N m
    that the tendon carries.

    `torque` and `u` (2 s, a, l) at speeds `signed` (2 s,), which rise; `friction` and `friction_u`
    (s, a, l), half of what differs between the directions, at the positive ones.
    """

    signed: Array
    angle: Array
    load: Array
    torque: Array
    u: Array
    friction: Array
    friction_u: Array


def grid_of(
    model: LearnedModel, speeds: Sequence[float], angle: Array, load: Array, torque_constant: float
) -> DisturbanceGrid:
    """Return the disturbance at motor speeds, rad/s, output angles (a,) rad and loads (l,) N m."""
    signed = sorted(side * speed for speed in speeds for side in (1.0, -1.0))
    found = [disturbance(model, angle, load, speed, torque_constant) for speed in signed]
    ways = list(zip(found, reversed(found), strict=True))[len(speeds) :]  # speeds v and -v
    halves = [((up - down) / 2, (up_by - down_by) / 2) for (up, up_by), (down, down_by) in ways]

    def valued(parts: Sequence[tuple[Array, Array]]) -> tuple[Array, Array]:
        values, by = (np.stack(part) for part in zip(*parts, strict=True))
        variance = np.einsum("spal,pq,sqal->sal", by, model.covariance, by, optimize=True)
        return values, np.sqrt(np.maximum(variance, 0.0))

    return DisturbanceGrid(np.array(signed), angle, load, *valued(found), *valued(halves))


def disturbance(
    model: LearnedModel, angle: Array, load: Array, speed: float, torque_constant: float
) -> tuple[Array, Array]:
    """Return the disturbance of loads (l,) N m at output angles (a,) rad: (a, l), N m.

    At the output, at a motor speed, rad/s, with its sign; and the derivatives (p, a, l) by the
    logarithms of the model's shape and by its coefficients.
    """
    found = [_sliding(model, angle, value, speed, torque_constant) for value in load.tolist()]
    tip = float(np.sign(speed)) * model.shape.tip_friction
    rest, rest_by = _sliding(model, angle, tip, speed, torque_constant)
    added = np.stack([torque - rest for torque, _ in found], axis=-1)
    by = np.stack([own - rest_by for _, own in found], axis=-1)
    return added, by


def _sliding(
    model: LearnedModel, angle: Array, carried: float, speed: float, torque_constant: float
) -> tuple[Array, Array]:
    """Return all torque besides the one carried at angles (a,), N m at the output, and derivatives
    (p, a)."""
    shape, known = model.shape, model.known
    side, factor = float(np.sign(speed)), known.torque_factor
    before = LAG_LENGTHS * shape.ripple_time * abs(speed)
    ends = np.array([angle.min(), angle.max()])[:: int(side)] * known.angle_ratio
    path = np.linspace(ends[0] - side * before, ends[1], WAY_POINTS)
    interval = abs(path[1] - path[0]) / abs(speed)
    none, empty = np.zeros(WAY_POINTS, dtype=bool), np.empty((0, 0))
    at_one_side, everywhere = np.full(WAY_POINTS, side), np.full(WAY_POINTS, carried)

    def state(shape: Shape, record: Record) -> RecordState:
        output = path / known.angle_ratio - carried / shape.stiffness
        return RecordState(record, shape, known, at_one_side, at_one_side, everywhere, output)

    values = np.zeros((len(model.terms), WAY_POINTS))
    for _ in range(CURRENT_ITERATIONS):
        torque = carried / factor + model.coefficient @ values
        current = torque / torque_constant - known.offset
        record = SlidingRecord(
            interval, path, current, none, torque_constant, 0.0, 0.0, 0, empty, speed
        )
        values = functions(model.terms, state(shape, record))
    by_shape = np.zeros((len(SLIDING_PARAMETERS), WAY_POINTS))
    for number, name in enumerate(SLIDING_PARAMETERS):
        if name in STEADY_PARAMETERS:
            there = state(
                stepped_shape(shape, DERIVATIVE_STEP * np.eye(len(SLIDING_PARAMETERS))[number]),
                record,
            )
            by_shape[number] = (
                model.coefficient @ (functions(model.terms, there) - values) / DERIVATIVE_STEP
            )
    rows = factor * np.vstack([model.coefficient @ values, by_shape, values])
    order = np.argsort(path)
    points = angle * known.angle_ratio
    found = np.stack([np.interp(points, path[order], row[order]) for row in rows])
    return found[0], found[1:]
