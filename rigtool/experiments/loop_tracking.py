"""Check that the position loop tracks its set point without saturating, so its current is torque.

    |rotor - set point| <= unexplained distance + controller torque / smallest gain

Below its crossover a controller answers a following error with at least its smallest gain times
that error. A fast motion of a heavy load needs a large torque and so has a large following error,
which is no fault: all angles are read from the encoder. A following error without that torque is a
fault of the encoder, of the set point or of [rig.controller].
"""

from __future__ import annotations

import numpy as np

from rigtool.control.position_loop import controller_sections
from rigtool.errors import InsufficientDataError
from rigtool.recipe import Recipe

UNEXPLAINED_DISTANCE = 0.1
"""Following error that needs no torque to be plausible, rad: what friction, the steps of the
encoder and the delay of the current leave at any load."""

LOWEST_HZ = 0.5
"""Lower end of the band in which the smallest gain is searched: slower than any motion, Hz."""


def require_tracking(
    recipe: Recipe,
    *,
    largest_current: float,
    largest_controller: float,
    distance: float,
    remedy: str = "use a smaller force",
) -> None:
    """Raise `InsufficientDataError` where the loop saturates or does not hold the rotor.

    `largest_current` is the largest current set point, A, `largest_controller` the controller's
    part of it, A, and `distance` the largest following error, rad. `remedy` ends the message
    where the loop saturates.
    """
    limit = recipe.rig.current_limit
    if largest_current >= 0.999 * limit:
        raise InsufficientDataError(
            f"the current set point reaches the limit of {limit} A, so the controller saturates "
            f"and the current no longer shows the torque: {remedy}"
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

    rig, crossover_hz = recipe.rig, recipe.rig.controller.crossover_hz
    sections = controller_sections(
        **rig.controller.model_dump(), inertia=rig.nominal_inertia, sample_time=rig.sample_time
    )
    frequency = np.geomspace(min(LOWEST_HZ, crossover_hz), crossover_hz, 100)
    return float(np.abs(sosfreqz(sections, frequency, fs=1 / rig.sample_time)[1]).min())
