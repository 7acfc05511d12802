"""Rigs: where signals come from."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rigtool.rigs.base import CHANNELS, NEEDS, Block, Feedforward, Load, Rig, Task

if TYPE_CHECKING:
    from rigtool.recipe import Recipe
    from rigtool.rigs.bench import Bench

__all__ = ["CHANNELS", "NEEDS", "Block", "Feedforward", "Load", "Rig", "Task", "open_rig"]


def open_rig(
    recipe: Recipe, torque_constant: float, stream: str, bench: Bench | None = None
) -> Rig:
    """Return the rig that a recipe names; use it as a context manager.

    `torque_constant` [N m/A] turns the controller's torque into current; `stream` names the use;
    `bench` says how to go about a rig on a serial line.
    """
    if recipe.rig.source == "serial":
        from rigtool.rigs.bench import Bench
        from rigtool.rigs.serial import open_serial_rig

        return open_serial_rig(recipe, torque_constant, stream, bench or Bench())
    from rigtool.rigs.virtual import VirtualRig

    return VirtualRig(recipe, torque_constant, stream)
