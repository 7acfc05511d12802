"""Rigs: where signals come from."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rigtool.rigs.base import CHANNELS, Block, Feedforward, Load, Rig, Task

if TYPE_CHECKING:
    from rigtool.recipe import Recipe

__all__ = ["CHANNELS", "Block", "Feedforward", "Load", "Rig", "Task", "open_rig"]


def open_rig(recipe: Recipe, torque_constant: float, stream: str) -> Rig:
    """Open the rig that a recipe names.

    `torque_constant` [N m/A] turns the controller's torque into current; `stream` names the use.
    """
    from rigtool.rigs.virtual import VirtualRig

    return VirtualRig(recipe, torque_constant, stream)
