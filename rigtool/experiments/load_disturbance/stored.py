"""The disturbance of a load in run files, as implementation D writes it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from rigtool.errors import RunFileError
from rigtool.experiments.force_model.learning import LearnedModel
from rigtool.experiments.force_model.stored import TERMS, model_from
from rigtool.experiments.load_disturbance.sliding import DisturbanceGrid
from rigtool.numerics.arrays import Array
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
    """What a rising reading holds besides loads (l,) carried, N m at the output: `friction` that
    grows with them, its `u`, and what `remains` when that is taken off."""

    friction: Array
    u: Array
    remains: Array


def rising_load(tables: Run, recipe: Recipe, model: LearnedModel, load: Array) -> RisingLoad:
    """Return what loads (l,) N m add to a reading of `measure_force`, from the stored tables.

    What remains is the part of the disturbance that does not change its sign with the direction,
    and what the tendon's stretch s / k takes off: at angle b the load M shows s = M sin(b - s / k).
    """
    from scipy.interpolate import interpn

    settings, ratio = recipe.measure_force, recipe.rig.angle_ratio
    position = math.radians(settings.measure_angle)
    speed = 2 * math.pi * settings.speed_rev_per_s * ratio

    def at(name: str, column: str) -> Array:
        table = tables.table(name, *AXES, speed="rad/s", position="rad", load="N m", torque="N m")
        axes = [table[axis] for axis in AXES]
        points = np.stack([np.full_like(load, speed), np.full_like(load, position * ratio), load])
        inside = [np.clip(p, axis[0], axis[-1]) for p, axis in zip(points, axes, strict=True)]
        found: Array = interpn(axes, table[column], np.stack(inside, axis=-1))
        return found

    friction = at(LOAD_FRICTION, "torque")
    sided = at(DISTURBANCE, "torque") - friction
    stretched = np.sin(position - load / model.shape.stiffness) / math.sin(position)
    return RisingLoad(friction, at(LOAD_FRICTION, "u"), sided - load * (1 / stretched - 1))
