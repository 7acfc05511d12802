"""The disturbance of a load in run files, as implementation D writes it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from rigtool.errors import RunFileError
from rigtool.experiments.force_model.learning import LearnedModel
from rigtool.experiments.force_model.sliding_problem import SLIDING_PARAMETERS
from rigtool.experiments.force_model.stored import TERMS, model_from
from rigtool.experiments.load_disturbance.sliding import DisturbanceGrid
from rigtool.numerics.arrays import Array
from rigtool.quantity import STANDARD_GRAVITY
from rigtool.recipe import Recipe
from rigtool.runfile import Column, Run, Table

DISTURBANCE, LOAD_FRICTION = "disturbance", "load_friction"
AXES = ("speed", "position", "load")


@dataclass(frozen=True, eq=False)
class Disturbance:
    """What was learned of known loads: the `model`, the largest load `torque` N m, and the motor's
    `speeds` rad/s."""

    model: LearnedModel
    torque: float
    speeds: tuple[float, ...]


def disturbance_from(run: Run, recipe: Recipe) -> Disturbance:
    """Return what a run of `ilc-learn --implementation D` learned, for the rig of a recipe.

    Raises `RunFileError` where the run holds no model, or a broken one.
    """
    run.require_command("ilc-learn")
    if TERMS not in run.tables:
        raise RunFileError(
            f"{run.path}: holds no model of what a load does, so no load can be corrected: learn "
            "with --implementation D, or measure with --correction none"
        )
    speeds = sorted(
        {abs(float(speed)) for speed in run.table(DISTURBANCE, *AXES, speed="rad/s")["speed"]}
    )
    torque = run.result("learned_torque", "N m").value
    return Disturbance(model_from(run, recipe).learned, torque, tuple(speeds))


def grid_tables(grid: DisturbanceGrid, recipe: Recipe) -> dict[str, Table]:
    """Return the disturbance by speed, position and load, and the friction that grows with load."""
    position = Column(grid.angle * recipe.rig.angle_ratio, "rad", "of the motor")
    load = Column(grid.load, "N m", "torque that the tendon carries, at the output")

    def table(values: Array, u: Array, what: str, about: str) -> Table:
        return Table(
            AXES,
            {
                "speed": Column(grid.signed[-len(values) :], "rad/s", "of the motor shaft"),
                "position": position,
                "load": load,
                "torque": Column(values, "N m", what),
                "u": Column(u, "N m", "standard uncertainty"),
            },
            "torque",
            about,
        )

    return {
        DISTURBANCE: table(
            grid.torque,
            grid.u,
            "what the load adds besides itself, at the output",
            "disturbance by speed, position and load",
        ),
        LOAD_FRICTION: table(
            grid.friction,
            grid.friction_u,
            "added while lifting, taken off while lowering, at the output",
            "friction that grows with load, by speed, position and load",
        ),
    }


@dataclass(frozen=True, eq=False)
class RisingLoad:
    """What a rising reading holds besides the torque (l,) N m that a load adds to the tendon:
    `friction` that grows with it, and what `remains` when that is taken off. `torque` is that of
    the load at the angle of the reading, of which stretch took a part; `u` is that of both."""

    friction: Array
    u: Array
    remains: Array
    torque: Array


def rising_load(tables: Run, recipe: Recipe, model: LearnedModel, added: Array) -> RisingLoad:
    """Return what belongs to torques (l,) N m that loads add to the tendon while
    `measure_force` lifts them, from the stored tables.

    The tendon carries s = added + t, with friction t of the tip. Its stretch e turns the output
    back, at an even speed v of the rotor over the angle ratio,

        added = M sin a + J a'',   a = b - e,   k e + c e' = s,   J = M r / g + Jg

    with e' = v q/(1 + q) and a'' = v^2 M sin a/(k (1 + q)^3), where q = M cos a/k: the output
    speeds up while the tendon shortens. M sin b is the torque of the load at angle b. What remains
    is the part of the disturbance that does not change its sign with the direction.
    """
    from scipy.interpolate import interpn

    settings, ratio = recipe.measure_force, recipe.rig.angle_ratio
    position = math.radians(settings.measure_angle)
    speed = recipe.rig.motor_speed(settings.speed_rev_per_s)
    carried = added + model.shape.tip_friction
    loads = np.append(carried, model.shape.tip_friction)

    def at(name: str, column: str) -> Array:
        table = tables.table(name, *AXES, speed="rad/s", position="rad", load="N m", torque="N m")
        axes = [table[axis] for axis in AXES]
        place = [np.full_like(loads, speed), np.full_like(loads, position * ratio), loads]
        inside = [np.clip(p, axis[0], axis[-1]) for p, axis in zip(place, axes, strict=True)]
        found: Array = interpn(axes, table[column], np.stack(inside, axis=-1))
        return found[:-1] if column == "u" else found[:-1] - found[-1]

    friction, friction_u = at(LOAD_FRICTION, "torque"), at(LOAD_FRICTION, "u")
    shape, rate = model.shape, speed / ratio
    stretch = carried / shape.stiffness
    moment = added / np.sin(position - stretch)
    slope = moment * np.cos(position - stretch) / shape.stiffness
    stretch -= shape.damping / shape.stiffness * rate * slope / (1 + slope)
    inertia = moment * recipe.rig.load_arm / STANDARD_GRAVITY + shape.grasper_inertia
    swept = inertia * rate**2 / (shape.stiffness * (1 + slope) ** 3)
    torque = added * math.sin(position) / (np.sin(position - stretch) * (1 + swept))
    number = SLIDING_PARAMETERS.index("stiffness")
    relative = math.sqrt(model.covariance[number, number])
    stretch_u = torque * stretch / np.tan(position - stretch) * relative
    sided = at(DISTURBANCE, "torque") - friction
    return RisingLoad(friction, np.hypot(friction_u, stretch_u), sided, torque)
