"""Friction of each staircase, along the motion of the arm under its own torque.

Its state is z = a + b z0 in (1) of `rigtool.experiments.torque_constant.staircases.model`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rigtool.experiments.torque_constant.staircases.arm_motion import one_sided, state_of
from rigtool.experiments.torque_constant.staircases.mean_staircases import MeanStaircases
from rigtool.experiments.torque_constant.staircases.model import Common
from rigtool.experiments.torque_constant.staircases.swings import (
    friction_state,
    paths,
    straight_path,
)
from rigtool.numerics.arrays import Array


def friction_of_each(
    means: MeanStaircases,
    common: Common,
    begins: Array | None = None,
    sizes: Array | float = 1.0,
) -> tuple[Array, ...]:
    """Return columns of f and f z0 of each staircase (m, p), or nothing without friction.

    It is that of the arm's motion under the torque of each, which begins with the friction `begins`
    (m,) over f, or with that of the mean, and is moved with `sizes` (m,) of f. Ripple acts with a
    lag: what that does to the turns of the arm is added.
    """
    if common.transition is None:
        return ()
    stairs, arm, asymmetry = means.stairs, means.arm, means.asymmetry
    courses, kind = stairs.courses, stairs.courses.kind

    def by_turns(way: Array) -> Array:
        both = friction_state(way, common.transition or 0.0, common.exponent)
        return np.stack(one_sided(*both, asymmetry))

    if common.lag is None:
        own = by_turns(straight_path(courses)[:, kind])
    else:
        torque, *both = courses.of_each()
        own, at_once = (
            by_turns(paths(courses, torque, course, [common.lag])[0]) for course in both
        )
        if arm is not None:
            # As for the mean, or the paths of all would lead elsewhere.
            contacts = means.moves(common)
            first, _ = one_sided(contacts.state[0, kind, :1], at_once[1], asymmetry)
            first = first if begins is None else begins[:, None]
            state = state_of(at_once[0] + at_once[1] * first, asymmetry)
            contacts = replace(contacts, level=contacts.level * sizes, state=state)
            each = replace(courses, torque=torque, course=both[0], part=courses.part[kind])
            own += np.concatenate(arm.friction_state(each, contacts)) - at_once
    a, b = -own * stairs.weight
    return a, b
