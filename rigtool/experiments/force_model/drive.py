"""Torque at the shaft from current and rotor angle: the input of a filter over motor and tendon.

    T = late(kT (i + i0)) - offset - cogging - lag(kT-ripple),   b = drag by rotor angle

late() is a first-order lag by the learned delay of the current. The rest are the terms of `model`
that depend on the rotor's angle alone; they hardly change within a count, so that the encoder's
angle is good enough for them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from rigtool.experiments.force_filter.plant import Plant
from rigtool.experiments.force_model.learning import LearnedModel
from rigtool.experiments.force_model.model import Kind, Term, wave
from rigtool.numerics.arrays import Array
from rigtool.numerics.compiled import compiled_allocating

MAP_SIZE = 2048
"""Points of a turn: an order is interpolated between them within 2.5e-4 up to 14, 1.2e-2 up
to 100."""

COGGING, RIPPLE, GAIN, SQUARE, VISCOUS = range(5)
LARGEST_LEAD = 1 / 3
"""Part of a sample by which torque may lead its current: more would ring."""

_COLUMNS = {
    Kind.OFFSET: COGGING,
    Kind.COGGING: COGGING,
    Kind.DISTINCT_COGGING: COGGING,
    Kind.RIPPLE: RIPPLE,
    Kind.GAIN_RIPPLE: GAIN,
    Kind.SQUARE_RIPPLE: SQUARE,
    Kind.VISCOUS: VISCOUS,
}


@dataclass(frozen=True, eq=False)
class MotorMap:
    """By rotor angle, tabulated over one turn (n + 1, 5): cogging and ripple in N m, ripple per
    torque and per torque and ampere, drag in N m s/rad. `ripple_time` s is the ripple's lag,
    `delay` s the current's."""

    rotor_map: Array
    ripple_time: float
    offset: float
    delay: float = 0.0

    def delay_kept(self, sample_time: float) -> float:
        """Return the part of the earlier torque that a sample of `sample_time` s keeps, so that
        torque is late by the delay. A delay below zero, which noise may cause, gives a lead."""
        late = max(self.delay, -LARGEST_LEAD * sample_time)
        return late / (late + sample_time)

    def torque(
        self,
        angle: Array,
        current: Array,
        torque_constant: Array | float,
        sample_time: float,
        lagging: Array | None = None,
    ) -> tuple[Array, Array]:
        """Return torque N m and drag N m s/rad (n,) at angles rad under currents A.

        `lagging` (2,) N m are the lagging ripple and torque before these samples, 0 by default, and
        receive their values after them.
        """
        torque, viscous = np.empty(angle.size), np.empty(angle.size)
        _drive(
            angle,
            torque_constant * (current + self.offset),
            current,
            self.rotor_map,
            1.0 - math.exp(-sample_time / self.ripple_time),
            self.delay_kept(sample_time),
            np.zeros(2) if lagging is None else lagging,
            torque,
            viscous,
        )
        return torque, viscous


def tabulated(terms: tuple[Term, ...], coefficient: Array) -> Array:
    """Return the maps (n + 1, 5) of a learned model with coefficients (t,), see `MotorMap`."""
    angle = np.linspace(0.0, 2 * np.pi, MAP_SIZE + 1)
    found = np.zeros((MAP_SIZE + 1, 5))
    for term, value in zip(terms, coefficient, strict=True):
        if term.kind in _COLUMNS:
            found[:, _COLUMNS[term.kind]] += value * wave(term, angle)
    return found


@compiled_allocating
def _drive(
    angle: Array,
    plain: Array,
    current: Array,
    rotor_map: Array,
    step: float,
    kept: float,
    lagging: Array,
    torque: Array,
    viscous: Array,
) -> None:
    size = rotor_map.shape[0] - 1
    scale = size / (2.0 * math.pi)
    ripple, late = lagging
    here = np.empty(5)
    for k in range(angle.size):
        place = angle[k] * scale
        place -= math.floor(place / size) * size
        cell = min(int(place), size - 1)
        part = place - cell
        for j in range(5):
            here[j] = rotor_map[cell, j] + part * (rotor_map[cell + 1, j] - rotor_map[cell, j])
        raw = here[1] + plain[k] * (here[2] + abs(current[k]) * here[3])
        ripple += step * (raw - ripple)
        late += (1.0 - kept) * (plain[k] - late)
        torque[k] = late - here[0] - ripple
        viscous[k] = here[4]
    lagging[0], lagging[1] = ripple, late


def drive_of(model: LearnedModel) -> MotorMap:
    """Return the drive of a learned model."""
    rotor_map, delay = tabulated(model.terms, model.coefficient), model.total(Kind.DELAY)
    return MotorMap(rotor_map, model.shape.ripple_time, model.known.offset, delay)


def plant_of(model: LearnedModel, sample_time: float) -> Plant:
    """Return the equations of a learned model that a filter runs on, at a sample time, s."""
    shape, known, sums = model.shape, model.known, {kind: model.total(kind) for kind in Kind}
    angle = np.linspace(0.0, 2 * np.pi, MAP_SIZE + 1)
    mean = sums[Kind.HOUSING]
    factor = known.torque_factor / (1.0 + sums[Kind.CARRIED])
    columns = {Kind.HOUSING: (0, 1.0 / mean), Kind.LOAD_FRICTION: (1, factor / known.torque_factor)}
    by_angle = np.tile((1.0, 0.0), (MAP_SIZE + 1, 1))
    for term, value in zip(model.terms, model.coefficient, strict=True):
        if term.order and term.kind in columns:
            column, unit = columns[term.kind]
            by_angle[:, column] += unit * value * wave(term, angle)
    static = sums[Kind.BEARING] + sums[Kind.STRIBECK]
    return Plant(
        sample_time=sample_time,
        inertia=known.inertia + sums[Kind.INERTIA],
        coulomb=sums[Kind.BEARING],
        static=static,
        stribeck_velocity=shape.stribeck_speed,
        asymmetry=shape.asymmetry,
        presliding_angle=shape.bearing_length,
        presliding_damping=max(sums[Kind.BEARING_DAMPING], 0.0) / static,
        angle_ratio=known.angle_ratio,
        torque_factor=factor,
        stiffness=shape.stiffness,
        damping=shape.damping,
        grasper_inertia=shape.grasper_inertia,
        housing_friction=mean,
        housing_asymmetry=shape.asymmetry,
        housing_viscous=0.0,
        housing_presliding_angle=shape.housing_length,
        tip_friction=shape.tip_friction,
        tip_presliding_angle=shape.tip_length,
        load_friction=sums[Kind.LOAD_FRICTION] * factor / known.torque_factor,
        load_friction_onset=shape.load_onset,
        friction_map=by_angle,
    )
