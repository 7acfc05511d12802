"""A motor with presliding friction that drives a grasper over a tendon: equations and derivatives.

States x: motor angle theta and speed w, bristles z (bearings) and h (housing), grasper angle a and
speed v, bristle t (tip), deviation of the stroke (sine, cosine, load), friction noise n, and the
torque M on the output from outside, positive where it resists positive motion:

    J dw/dt  = T - (F(w) (1 + A z) z + n z + F(w) D dz/dt + b w) - s/g - L h - B w
    Jg dv/dt = s - Ft t - M
    s = k (theta/r - a) + c (w/r - v)                                       tendon
    F(w) = Fc + (Fs - Fc) exp(-(w/vs)^2)                                    Stribeck
    L = Fh m(a) (1 + Ah h) + l (1 + load) (sqrt(s^2 + o^2) - o)/g + sine sin a + cosine cos a
    dz/dx = (1 - z sign dx) / x0,  likewise h over theta, t over a          P. R. Dahl, AIAA J.
                                                                            14(12) 1675-1682, 1976

T is what current and position give (torque constant, ripple, cogging) and b the bearings' viscous
friction; both are inputs, sample by sample, because they hardly depend on the angle within a count.
A bristle's law depends on the path alone, and has a closed form for a step of any size. Everything
else is semi-implicit Euler at the sample time. SI units; g torque at the grasper per motor torque,
r motor angle per grasper angle. Without an instrument (grasper_inertia = 0) M acts on the shaft
itself: s = M, a = theta/r, v = w/r.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Record = Any  # the one element of a structured array, with its fields as attributes

ANGLE, SPEED, BRISTLE, HOUSING, GRASPER, GRASPER_SPEED, TIP = range(7)
SINE, COSINE, LOAD, NOISE, TORQUE = range(7, 12)
STATES = 12
MOVING_STATES = 7
"""The first states change within a sample; the others only from step to step."""


@dataclass(frozen=True)
class Plant:
    """Parameters of the equations above, SI; `friction_map` (n + 1,) is m over one turn of a."""

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


@njit(cache=True)
def dahl(deflection: float, path: float, presliding_angle: float) -> float:
    """Return a bristle's deflection after a path in one direction, exactly."""
    side = 1.0 if path > 0.0 else -1.0
    return side - (side - deflection) * math.exp(-abs(path) / presliding_angle)


@njit(cache=True)
def _direction(speed: float, spread: float) -> float:
    """Return the sign of a speed, the mean of its signs where it is not certain."""
    if spread <= 0.0:
        return 1.0 if speed > 0.0 else -1.0
    return min(max(speed / spread, -1.0), 1.0)


@njit(cache=True)
def advance(
    x: Array,
    p: Record,
    friction_map: Array,
    torque: float,
    viscous: float,
    rows: Array | None,
    spread: float,
    grasper_spread: float,
) -> None:
    """Advance the states x (12,) by one sample under a drive torque [N m].

    `rows` (12, 12), where it is not None, is the derivative of x by the states of an earlier time,
    and is carried along. A bristle yields to motion in either direction, but not alike: where the
    speed is within a `spread` [rad/s] of zero, the derivative is the mean of both.
    """
    dt = p.sample_time
    w, z, v, t, a = x[SPEED], x[BRISTLE], x[GRASPER_SPEED], x[TIP], x[GRASPER]
    h = x[HOUSING]
    # Bristles
    side = 1.0 if w > 0.0 else -1.0
    z_left = math.exp(-abs(w) * dt / p.presliding_angle)
    h_left = math.exp(-abs(w) * dt / p.housing_presliding_angle)
    z_new = side - (side - z) * z_left
    h_new = side - (side - h) * h_left
    tip_side = 1.0 if v > 0.0 else -1.0
    t_left = math.exp(-abs(v) * dt / p.tip_presliding_angle)
    t_new = tip_side - (tip_side - t) * t_left
    # Bearings
    ratio = w / p.stribeck_velocity
    bump = (p.static - p.coulomb) * math.exp(-ratio * ratio) if abs(ratio) < 5.0 else 0.0
    level = p.coulomb + bump
    rate = p.presliding_damping / dt
    shape = (1.0 + p.asymmetry * z_new) * z_new + rate * (z_new - z)
    friction = level * shape + x[NOISE] * z_new + viscous * w
    # Tendon and housing
    free = p.grasper_inertia <= 0.0
    twist = p.stiffness * (x[ANGLE] / p.angle_ratio - a) + p.damping * (w / p.angle_ratio - v)
    if free:
        twist = x[TORQUE]
    root = math.sqrt(twist * twist + p.load_friction_onset**2)
    carried = root - p.load_friction_onset
    size = friction_map.shape[0] - 1
    place = a * (size / (2.0 * math.pi))
    place -= math.floor(place / size) * size
    cell = min(int(place), size - 1)
    slope = friction_map[cell + 1] - friction_map[cell]
    by_angle = friction_map[cell] + (place - cell) * slope
    sine, cosine = math.sin(a), math.cos(a)
    own = p.housing_friction * by_angle
    per_load = p.load_friction / p.torque_factor
    housing = (
        own * (1.0 + p.housing_asymmetry * h_new)
        + per_load * (1.0 + x[LOAD]) * carried
        + x[SINE] * sine
        + x[COSINE] * cosine
    )
    net = torque - friction - twist / p.torque_factor - housing * h_new - p.housing_viscous * w
    outer = twist - p.tip_friction * t_new - x[TORQUE]
    if rows is not None:
        side, tip_side = _direction(w, spread), _direction(v, grasper_spread)
        _differentiate(
            rows,
            p,
            (z_left, h_left, t_left),
            ((1.0 - side * z) * z_left, (1.0 - side * h) * h_left, (1.0 - tip_side * t) * t_left),
            (
                level * (1.0 + 2.0 * p.asymmetry * z_new + rate) + x[NOISE],
                level * rate,
                -2.0 * ratio / p.stribeck_velocity * bump * shape + viscous + p.housing_viscous,
                z_new,
            ),
            (
                housing + own * p.housing_asymmetry * h_new,
                1.0 / p.torque_factor + h_new * per_load * (1.0 + x[LOAD]) * twist / root,
                h_new
                * (
                    p.housing_friction
                    * (1.0 + p.housing_asymmetry * h_new)
                    * slope
                    * (size / (2.0 * math.pi))
                    + x[SINE] * cosine
                    - x[COSINE] * sine
                ),
                h_new * sine,
                h_new * cosine,
                h_new * per_load * carried,
            ),
        )
    x[BRISTLE], x[HOUSING], x[TIP] = z_new, h_new, t_new
    x[SPEED] = w + dt * net / p.inertia
    x[ANGLE] += dt * x[SPEED]
    if free:
        x[GRASPER_SPEED], x[GRASPER] = x[SPEED] / p.angle_ratio, x[ANGLE] / p.angle_ratio
    else:
        x[GRASPER_SPEED] = v + dt * outer / p.grasper_inertia
        x[GRASPER] = a + dt * x[GRASPER_SPEED]


@njit(cache=True)
def _differentiate(
    rows: Array,
    p: Record,
    left: tuple[float, float, float],
    open_: tuple[float, float, float],
    bearing: tuple[float, float, float, float],
    tendon: tuple[float, float, float, float, float, float],
) -> None:
    """Carry the derivatives through one sample; all arguments are as before the step."""
    dt = p.sample_time
    by_z, by_old_z, by_w, by_noise = bearing
    by_h, by_twist, by_a, by_sine, by_cosine, by_load = tendon
    z_w = open_[0] * dt / p.presliding_angle
    h_w = open_[1] * dt / p.housing_presliding_angle
    t_v = open_[2] * dt / p.tip_presliding_angle
    k, c, r = p.stiffness, p.damping, p.angle_ratio
    free = p.grasper_inertia <= 0.0
    for j in range(STATES):
        angle, w, z, h = rows[ANGLE, j], rows[SPEED, j], rows[BRISTLE, j], rows[HOUSING, j]
        a, v, t = rows[GRASPER, j], rows[GRASPER_SPEED, j], rows[TIP, j]
        z_new = left[0] * z + z_w * w
        h_new = left[1] * h + h_w * w
        t_new = left[2] * t + t_v * v
        twist = rows[TORQUE, j] if free else k * (angle / r - a) + c * (w / r - v)
        net = -(
            by_z * z_new
            - by_old_z * z
            + by_w * w
            + by_noise * rows[NOISE, j]
            + by_h * h_new
            + by_twist * twist
            + by_a * a
            + by_sine * rows[SINE, j]
            + by_cosine * rows[COSINE, j]
            + by_load * rows[LOAD, j]
        )
        outer = twist - p.tip_friction * t_new - rows[TORQUE, j]
        w += dt / p.inertia * net
        angle += dt * w
        if free:
            v, a = w / r, angle / r
        else:
            v += dt / p.grasper_inertia * outer
            a += dt * v
        rows[ANGLE, j], rows[SPEED, j] = angle, w
        rows[BRISTLE, j], rows[HOUSING, j], rows[TIP, j] = z_new, h_new, t_new
        rows[GRASPER, j], rows[GRASPER_SPEED, j] = a, v
