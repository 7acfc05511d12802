"""What the bench may have wrong in a known load, as lines of budgets."""

from __future__ import annotations

from rigtool.quantity import Component
from rigtool.recipe import Recipe

ANGLE_RATIO, WEIGHTS, LOAD_ARM = "angle ratio", "weights", "length to the load"
"""Lines of budgets that a torque and its reference share."""


def reference_lines(recipe: Recipe, force: float, torque: float) -> list[Component]:
    """Return the budget lines of a reference torque, which weights on a length make."""
    rig = recipe.rig
    return [
        Component(WEIGHTS, force, "N", force * rig.weights_relative_u, None, torque / force),
        Component(LOAD_ARM, rig.load_arm, "m", rig.load_arm_u, None, torque / rig.load_arm),
    ]


def ratio_line(recipe: Recipe, relative: float) -> Component:
    """Return the line of the angle ratio, by which a torque changes by `relative` N m."""
    rig = recipe.rig
    u = rig.angle_ratio * rig.angle_ratio_relative_u
    return Component(ANGLE_RATIO, rig.angle_ratio, "1", u, None, relative / rig.angle_ratio)
