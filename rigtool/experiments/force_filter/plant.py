"""A motor with presliding friction that drives a grasper over a tendon: equations and derivatives.

States x: motor angle theta and speed w, bristles z (bearings) and h (housing), grasper angle a and
speed v, bristle t (tip), deviation of the stroke (sine, cosine, load), friction noise n, and the
torque M on the output from outside, positive where it resists positive motion:

    J dw/dt  = T - (F(w) (1 + A z) z + n z + F(w) D dz/dt + b w) - s/g - L h - B w
    Jg dv/dt = s - Ft t - M
    s = k (theta/r - a) + c (w/r - v)                                       tendon
    F(w) = Fc + (Fs - Fc) exp(-(w/vs)^2)                                    Stribeck
    L = Fh (m(a) + Ah h) + (l (1 + load) + lw(a)) (sqrt(s^2 + o^2) - o)/g
        + sine sin a + cosine cos a
    dz/dx = (1 - z sign dx) / x0,  likewise h over theta, t over a          P. R. Dahl, AIAA J.
                                                                            14(12) 1675-1682, 1976

T is the torque from current and position (torque constant, ripple, cogging) and b the bearings'
viscous friction. Both are inputs, sample by sample, because they hardly depend on the angle within
a count. A bristle's law depends on the path alone and has a closed form for a step of any size.
Everything else is semi-implicit Euler at the sample time. SI units; g torque at the grasper per
motor torque, r motor angle per grasper angle. Without an instrument (grasper_inertia = 0) M acts on
the shaft itself: s = M, a = theta/r, v = w/r.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rigtool.numerics.arrays import Array
from rigtool.numerics.compiled import compiled

Record = Any  # the one element of a structured array, with its fields as attributes

ANGLE, SPEED, BRISTLE, HOUSING, GRASPER, GRASPER_SPEED, TIP = range(7)
SINE, COSINE, LOAD, NOISE, TORQUE = range(7, 12)
STATES = 12
MOVING_STATES = 7
"""The first states change within a sample; the others only from step to step."""

FACTOR_COUNT = 25
"""Numbers by which a sample multiplies small changes of the states: `linear`."""


@dataclass(frozen=True)
class Plant:
    """Parameters of the equations above, in SI, in their order.

    `inertia` J is that of rotor, pulley and wheel; `coulomb`, `static`, `stribeck_velocity` and
    `asymmetry` are Fc, Fs, vs and A of the bearings, with the bristle's length `presliding_angle`
    x0 [rad] and damping D [s]; `housing_...` are Fh, Ah, B and x0 of the housing at the motor,
    `tip_...` Ft and x0 at the grasper; `load_friction` l and `load_friction_onset` o [N m].
    `friction_map` (n + 1, 2) is m, and lw, by which load friction differs from l, over one turn of
    a. A bare pulley has no grasper_inertia, housing, tip and load friction, and the factors 1.
    """

    sample_time: float
    inertia: float
    coulomb: float
    static: float
    stribeck_velocity: float
    asymmetry: float
    presliding_angle: float
    presliding_damping: float
    angle_ratio: float
    torque_factor: float
    stiffness: float
    damping: float
    grasper_inertia: float
    housing_friction: float
    housing_asymmetry: float
    housing_viscous: float
    housing_presliding_angle: float
    tip_friction: float
    tip_presliding_angle: float
    load_friction: float
    load_friction_onset: float
    friction_map: Array


def as_record(parameters: Any) -> NDArray[np.void]:
    """Return the numbers of a frozen dataclass as compiled functions take them, (1,)."""
    names = [field.name for field in fields(parameters) if field.type == "float"]
    record = np.zeros(1, dtype=[(name, "f8") for name in names])
    for name in names:
        record[name] = getattr(parameters, name)
    return record


@compiled
def _bend(z: float, speed: float, dt: float, x0: float, spread: float) -> tuple[float, ...]:
    """Return a bristle one sample later, and its derivatives by itself and by the speed.

    A bristle yields to motion in either direction, but not alike: where the speed is within a
    `spread` of zero, the derivative by it lies between both.
    """
    left = math.exp(-abs(speed) * dt / x0)
    side = 1.0 if speed > 0.0 else -1.0
    after = side - (side - z) * left
    if abs(speed) < spread:
        side = speed / spread
    return after, left, (1.0 - side * z) * left * dt / x0


@compiled
def _bearings(
    p: Record, w: float, old: float, z: float, noise: float, viscous: float
) -> tuple[float, ...]:
    """Return the bearings' friction, and its derivatives by the bristle, the old one and w."""
    ratio = w / p.stribeck_velocity
    bump = (p.static - p.coulomb) * math.exp(-ratio * ratio) if abs(ratio) < 5.0 else 0.0
    level = p.coulomb + bump
    rate = p.presliding_damping / p.sample_time
    shape = (1.0 + p.asymmetry * z) * z + rate * (z - old)
    return (
        level * shape + noise * z + viscous * w,
        level * (1.0 + 2.0 * p.asymmetry * z + rate) + noise,
        -level * rate,
        -2.0 * ratio / p.stribeck_velocity * bump * shape + viscous,
    )


@compiled
def _housing(p: Record, friction_map: Array, x: Array, h: float, twist: float) -> tuple[float, ...]:
    """Return the housing's friction, and its derivatives by h, tendon torque, a and load."""
    size = friction_map.shape[0] - 1
    per_angle = size / (2.0 * math.pi)
    place = x[GRASPER] * per_angle
    place -= math.floor(place / size) * size
    cell = min(int(place), size - 1)
    low, high, part = friction_map[cell], friction_map[cell + 1], place - cell
    slope, load_slope = high[0] - low[0], high[1] - low[1]
    by_angle = low[0] + part * slope
    sine, cosine = math.sin(x[GRASPER]), math.cos(x[GRASPER])
    root = math.sqrt(twist * twist + p.load_friction_onset**2)
    carried = (root - p.load_friction_onset) / p.torque_factor
    sided = p.housing_friction * p.housing_asymmetry * h
    per_load = p.load_friction * (1.0 + x[LOAD]) + low[1] + part * load_slope
    level = p.housing_friction * by_angle + sided + per_load * carried
    level += x[SINE] * sine + x[COSINE] * cosine
    slope = (p.housing_friction * slope + load_slope * carried) * per_angle
    return (
        level * h,
        level + sided,
        per_load * twist / (root * p.torque_factor) * h,
        (slope + x[SINE] * cosine - x[COSINE] * sine) * h,
        p.load_friction * carried * h,
    )


@compiled
def advance(
    x: Array,
    p: Record,
    friction_map: Array,
    torque: float,
    viscous: float,
    factors: Array | None,
    k: int,
    spread: float,
    grasper_spread: float,
) -> None:
    """Advance the states x (12,) by one sample under a drive torque [N m].

    `factors`, where it is not None, receives as row k the `FACTOR_COUNT` by which the sample
    multiplies small changes of x (`linear`); speeds within their spread [rad/s] of zero have no
    certain direction.
    """
    dt, r, per_factor = p.sample_time, p.angle_ratio, 1.0 / p.torque_factor
    bare = p.grasper_inertia <= 0.0
    e, f = dt / p.inertia, 0.0 if bare else dt / p.grasper_inertia
    pull, drag = (0.0, 0.0) if bare else (p.stiffness, p.damping)
    rotor_pull, rotor_drag = pull / r, drag / r
    w, v, a, old = x[SPEED], x[GRASPER_SPEED], x[GRASPER], x[BRISTLE]
    z, z_by_z, z_by_w = _bend(old, w, dt, p.presliding_angle, spread)
    h, h_by_h, h_by_w = _bend(x[HOUSING], w, dt, p.housing_presliding_angle, spread)
    t, t_by_t, t_by_v = _bend(x[TIP], v, dt, p.tip_presliding_angle, grasper_spread)
    twist = x[TORQUE] if bare else pull * (x[ANGLE] / r - a) + drag * (w / r - v)
    bearings, by_z, by_old, by_w = _bearings(p, w, old, z, x[NOISE], viscous)
    housing, by_h, by_twist, by_a, by_load = _housing(p, friction_map, x, h, twist)
    sine, cosine = h * math.sin(a), h * math.cos(a)
    net = torque - bearings - twist * per_factor - housing - p.housing_viscous * w
    outer = twist - p.tip_friction * t - x[TORQUE]
    x[BRISTLE], x[HOUSING], x[TIP] = z, h, t
    x[SPEED] += e * net
    x[ANGLE] += dt * x[SPEED]
    if bare:
        x[GRASPER_SPEED], x[GRASPER] = x[SPEED] / r, x[ANGLE] / r
    else:
        x[GRASPER_SPEED] += f * outer
        x[GRASPER] += dt * x[GRASPER_SPEED]
    if factors is None:
        return
    by_twist += per_factor
    by_w += p.housing_viscous + by_z * z_by_w + by_h * h_by_w
    factors[k, 0] = -e * by_twist * rotor_pull
    factors[k, 1] = 1.0 - e * (by_w + by_twist * rotor_drag)
    factors[k, 2] = -e * (by_z * z_by_z + by_old)
    factors[k, 3] = -e * by_h * h_by_h
    factors[k, 4] = e * (by_twist * pull - by_a)
    factors[k, 5] = e * by_twist * drag
    factors[k, 6], factors[k, 7] = -e * sine, -e * cosine
    factors[k, 8], factors[k, 9] = -e * by_load, -e * z
    factors[k, 10] = -e * by_twist if bare else 0.0
    factors[k, 11], factors[k, 12] = f * rotor_pull, f * rotor_drag
    factors[k, 13] = -f * pull
    factors[k, 14] = 1.0 - f * (drag + p.tip_friction * t_by_v)
    factors[k, 15], factors[k, 16] = -f * p.tip_friction * t_by_t, -f
    factors[k, 17], factors[k, 18] = z_by_z, z_by_w
    factors[k, 19], factors[k, 20] = h_by_h, h_by_w
    factors[k, 21], factors[k, 22] = t_by_t, t_by_v
    factors[k, 23], factors[k, 24] = dt, 1.0 / r if bare else 0.0
