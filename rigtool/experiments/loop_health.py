"""Whether the position loop did what its current is read for: not saturated, and where it should
be.

A controller that holds the rotor answers a distance with a torque: below its crossover with no less
than its smallest gain times the distance. A fast motion of a heavy load needs a large torque, so
the rotor is a large distance off, which is as it should be: all angles are read from the encoder. A
distance without that torque is a fault: of the encoder, of the set point or of what
[rig.controller] says.
"""

from __future__ import annotations

import numpy as np

from rigtool.control.position_loop import controller_sections
from rigtool.errors import InsufficientDataError
from rigtool.recipe import Recipe

UNEXPLAINED_DISTANCE = 0.1
"""Distance of rotor and set point that needs no torque to be believed, rad: what friction, the
encoder's steps and the current's own delay leave at any load."""

LOWEST_HZ = 0.5
"""Lower end of the band in which the controller's gain counts: slower than any motion."""


def require_loop_health(
    recipe: Recipe,
    *,
    largest_current: float,
    largest_controller: float,
    distance: float,
    remedy: str = "use a smaller force",
) -> None:
    """Raise `InsufficientDataError` where the loop saturates or does not hold the rotor.

    `largest_current` is the largest current set point, A, `largest_controller` the controller's own
    part of it, A, and `distance` the largest one of rotor and set point, rad. `remedy` is what to
    do where the loop saturates.
    """
    limit = recipe.rig.current_limit
    if largest_current >= 0.999 * limit:
        raise InsufficientDataError(
            f"the current set point reaches the limit of {limit} A, so the controller saturates "
            f"and the current no longer tells the torque: {remedy}"
        )
    allowed = UNEXPLAINED_DISTANCE + (
        recipe.rig.torque_constant * largest_controller / smallest_gain(recipe)
    )
    if distance > allowed:
        raise InsufficientDataError(
            f"the rotor is up to {distance:.3g} rad off its set point, more than the "
            f"{allowed:.3g} rad that the controller's torque explains, so the loop does not hold "
            "it: check the encoder and [rig.controller]"
        )


def smallest_gain(recipe: Recipe) -> float:
    """Return the smallest gain of the recipe's controller below its crossover, N m/rad."""
    from scipy.signal import sosfreqz

    rig, crossover = recipe.rig, recipe.rig.controller.crossover_hz
    sections = controller_sections(**rig.loop_design)
    frequency = np.geomspace(min(LOWEST_HZ, crossover), crossover, 100)
    return float(np.abs(sosfreqz(sections, frequency, fs=1 / rig.sample_time)[1]).min())
