"""Whether the steps of the simulation are small enough for its springs and heat flows.

Speeds are stepped by what positions and speeds were, positions by the new speeds (semi-implicit
Euler, Hairer, Lubich and Wanner, Geometric Numerical Integration, 2006, section I.1.2):

    v' = v - h M^-1 (K x + D v),   x' = x + h v'

with the tendon's terms of `tendon` and the shaft's mobility (`kernel.mobility`), which follow their
dampers exactly: no damper is too strong. A spring k between masses whose reciprocal sum is 1/m is
stable where its oscillation turns by less than two radians a sample, and samples still show it:

    h^2 k / m < 4
"""

from __future__ import annotations

from typing import Any

import numpy as np

from rigtool.errors import RecipeError
from rigtool.numerics.arrays import Array
from rigtool.rigs.virtual.kernel import mobility
from rigtool.rigs.virtual.layout import SLOW_STEP_SAMPLES

EIGENVALUE_ROUNDING = 1e-6
"""By which the largest eigenvalue of a free, stable motion may differ from 1."""


def require_stable(p: Any) -> None:
    """Raise `RecipeError` where the steps are too long for these parameters of the kernel."""
    h = float(p["dt"])
    if p["instrument"]:
        tendon = 1 / float(p["angle_ratio"] * p["torque_factor"] * p["inertia"])
        tendon += 1 / float(p["grasper_inertia"])
        _require_spring("virtual.instrument", p["stiffness"], tendon, h)
    if p["clamped"]:
        _require_spring("virtual.arm", p["arm_stiffness"], 1 / float(p["inertia"]), h)
    _require_steps(_moving(p, h), "the springs of arm and instrument", h)
    _require_steps(_heat(p, h * SLOW_STEP_SAMPLES), "thermal resistances and capacities", h)


def _require_spring(name: str, k: float, mobility: float, h: float) -> None:
    highest = 4 / (mobility * h**2)
    if k < highest:
        return
    raise RecipeError(
        f"{name}.stiffness {k:g} N m/rad is beyond what can be simulated at rig.sample_time {h:g} "
        f"s with these inertias, {highest:.3g} N m/rad: lower it, or sample faster"
    )


def _require_steps(step: Array, what: str, h: float) -> None:
    largest = float(np.abs(np.linalg.eigvals(step)).max())
    if largest > 1 + EIGENVALUE_ROUNDING:
        raise RecipeError(
            f"virtual: {what} cannot be simulated at rig.sample_time {h:g} s: what they move "
            f"grows {largest:.3g} times a step; correct these values, or sample faster"
        )


def _moving(p: Any, h: float) -> Array:
    """Return the step of shaft and grasper, (4, 4), for (angles, speeds)."""
    ratio = np.array([1 / float(p["angle_ratio"]), -1.0])  # angle over the tendon
    factor = float(p["torque_factor"])
    stiffness, damping = np.zeros((2, 2)), np.zeros((2, 2))
    damping[0, 0] = p["viscous"] + (p["housing_viscous"] if p["instrument"] else 0.0)
    if p["clamped"]:
        stiffness[0, 0] = p["arm_stiffness"]
        damping[0, 0] += p["arm_damping"]
    inertia = 1 / mobility(float(p["inertia"]), damping[0, 0], h)
    if p["instrument"]:
        share = float(p["tendon_share"]) * ratio[0] / inertia
        sides = np.array([1 / factor, -1.0])[:, None]  # on the shaft, on the grasper
        own = (stiffness[0].copy(), damping[0].copy())
        stiffness += sides * (float(p["tendon_angle"]) * ratio - share * own[0])
        damping += sides * (float(p["tendon_speed"]) * ratio - share * own[1])
    inverse = np.diag([1 / inertia, 1 / float(p["grasper_inertia"])])
    pull, drag = inverse @ stiffness, inverse @ damping
    one = np.eye(2)
    return np.block([[one - h**2 * pull, h * (one - h * drag)], [-h * pull, one - h * drag]])


def _heat(p: Any, h: float) -> Array:
    """Return the step of the temperatures of winding and housing, (2, 2)."""
    flow, loss = 1 / float(p["winding_to_housing"]), 1 / float(p["housing_to_ambient"])
    winding, housing = h / float(p["winding_capacity"]), h / float(p["housing_capacity"])
    return np.array(
        [[1 - winding * flow, winding * flow], [housing * flow, 1 - housing * (flow + loss)]]
    )
