"""Rigs: where signals come from."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rigtool.rigs.base import NEED_DESCRIPTIONS, Block, Feedforward, Load, Rig, Task

if TYPE_CHECKING:
    from rigtool.recipe import Recipe
    from rigtool.rigs.operator import Operator

__all__ = ["NEED_DESCRIPTIONS", "Block", "Feedforward", "Load", "Rig", "Task", "open_rig"]


def open_rig(
    recipe: Recipe, torque_constant: float, stream: str, operator: Operator | None = None
) -> Rig:
    """Return the rig that a recipe names; use it as a context manager.

    `torque_constant` [N m/A] turns the controller's torque into current; `stream` names the
    command, by which the virtual rig draws its noise; `operator` attends a rig on a serial line.
    """
    if recipe.rig.source == "serial":
        from rigtool.rigs.operator import Operator
        from rigtool.rigs.serial import open_serial_rig

        return open_serial_rig(recipe, torque_constant, stream, operator or Operator())
    from rigtool.rigs.virtual import VirtualRig

    return VirtualRig(recipe, torque_constant, stream)
