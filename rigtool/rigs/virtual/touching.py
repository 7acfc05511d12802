"""A step of the output under contacts, compiled: weights, forces, tissue, a hand.

Contacts at the output (grasper, or pulley without an instrument) enter its equation of motion:

    M = L + F + W sin(thg) + k max(0, thg - th0) + c wg + kh (thg - thh) + ch (wg - wh) + I dwg/dt

with the recipe's hanging load L, a force F, hung masses of weight W r and inertia I (the load's
included), tissue (k, c from th0 on, never pulling) and the grip of a hand (kh, ch) that is at thh.
M is the torque on the output, `reference_torque`. These springs and dampers are implicit, thus
stable however stiff they are: a spring damps as k dt more than it does.
"""

from __future__ import annotations

from typing import Any

from rigtool.numerics.arrays import Array
from rigtool.numerics.compiled import compiled
from rigtool.rigs.virtual.layout import (
    FORCE_TORQUE,
    HAND_ANGLE,
    HAND_SPEED,
    TISSUE_ANGLE,
    TISSUE_BEGIN,
    TISSUE_DAMPING,
    TISSUE_END,
    TISSUE_STIFFNESS,
    WEIGHT_MOMENT,
)

Record = Any  # the one element of a STATE array or of `parameters`, with its fields as attributes


@compiled
def touched(
    p: Record,
    touch: Array,
    tissues: Array,
    time: float,
    angle: float,
    speed: float,
    lever: float,
    driving: float,
    load: float,
    inertia: float,
) -> tuple[float, float, float]:
    """Return the output's speed one step later, the torque that acted on it from outside, and that
    of the contacts alone, without load and inertia.

    `lever` is the sine of the angle at which weights hang, `driving` the rig's own torque on the
    output, `load` that of the recipe's load, `inertia` the rig's with that load.
    """
    weight = touch[WEIGHT_MOMENT]
    hung = weight * p.inertia_per_weight
    total = inertia + hung
    outside = load + touch[FORCE_TORQUE] + weight * lever
    grip = p.grip_stiffness * (angle - touch[HAND_ANGLE]) - p.grip_damping * touch[HAND_SPEED]
    per_speed = p.grip_damping + p.dt * p.grip_stiffness
    push = yielding = 0.0
    for j in range(tissues.shape[0]):
        tissue = tissues[j]
        depth = angle - tissue[TISSUE_ANGLE]
        if tissue[TISSUE_BEGIN] <= time < tissue[TISSUE_END] and depth > 0.0:
            push += tissue[TISSUE_STIFFNESS] * depth
            yielding += tissue[TISSUE_DAMPING] + p.dt * tissue[TISSUE_STIFFNESS]
    free = speed + p.dt * (driving - outside - grip) / total
    after = (free - p.dt * push / total) / (1.0 + p.dt * (per_speed + yielding) / total)
    if push + yielding * after < 0.0:  # tissue lets go
        push = yielding = 0.0
        after = free / (1.0 + p.dt * per_speed / total)
    outside += grip + push + (per_speed + yielding) * after
    contact = outside - load
    outside += (p.load_inertia + hung) * (after - speed) / p.dt
    return after, outside, contact
