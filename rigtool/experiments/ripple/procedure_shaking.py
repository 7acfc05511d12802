"""Ripple of a motor whose loop shakes, by the encoder's steps or by noise.

Ripple that grows with i |i| of the current i follows its mean, and a current that shakes about its
mean I by a standard deviation s has a mean of i |i| = I^2 + s^2 where it keeps its sign.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rigtool.experiments.controller_torque import encoder_shaking
from rigtool.experiments.ripple.orders import HIGHEST_ORDER, coefficients
from rigtool.experiments.ripple.procedure_steady import Collected
from rigtool.numerics.arrays import TINY, Array
from rigtool.recipe import Recipe
from rigtool.runfile import Recording

NOTED = 0.05
"""Part by which the mean of i |i| may be above that of a steady current without a note."""

SHAKING_LIMIT = 0.5
"""Largest relative standard deviation of the speed, by the steps of the encoder, without a note: on
two drawn rigs no order was off at 0.4, and first orders were off by 4 to 10 u at 0.8 to 3."""


def shaken_orders(found: Sequence[Collected], held: Sequence[Array]) -> Array:
    """Return the standard uncertainty of orders by the square of the current, N m (recordings,
    `HIGHEST_ORDER`).

    `held` are torques, N m, by turn and cell of each recording. At most the whole ripple of the
    recording where i |i| is largest grows with it: a rectangular distribution from nothing to that.
    """
    square, shaken = (np.array([getattr(own, n) for own in found]) for n in ("square", "shaken"))
    most = int(np.argmax(square))
    mean = held[most].mean(axis=0)[None]
    (largest,) = np.abs(coefficients(mean, HIGHEST_ORDER, found[most].sampling))
    return np.outer(shaken / max(square[most], TINY), largest) / np.sqrt(3)


def shaken_note(torques: Sequence[Recording], found: Sequence[Collected]) -> list[str]:
    """Return a note on recordings at constant torque whose current shakes by more than `NOTED`."""
    part = [own.shaken / max(own.square - own.shaken, TINY) for own in found[: len(torques)]]
    over = [
        f"{recording.name} by {100 * own:.0f} %"
        for recording, own in zip(torques, part, strict=True)
        if own > NOTED
    ]
    if not over:
        return []
    return [
        "the current shakes about its mean, by the encoder's steps or by noise, which makes ripple "
        "that grows with the square of the current larger than at a steady one, in "
        f"{', '.join(over)} or more; u includes that; take an encoder with more counts, or a "
        "softer controller"
    ]


def uneven_note(recordings: Sequence[Recording], recipe: Recipe) -> list[str]:
    """Return a note where the encoder's steps shake the speed beyond `SHAKING_LIMIT`."""
    speed = np.unique([recording.condition("speed") for recording in recordings])
    shaking = encoder_shaking(recipe, speed)
    if not (shaken := shaking > SHAKING_LIMIT).any():
        return []
    return [
        f"at {', '.join(f'{v:.3g}' for v in speed[shaken])} rad/s the steps of the encoder, "
        f"{recipe.rig.encoder_counts} a turn, make the loop vary the speed by up to "
        f"{100 * shaking.max():.0f} % (limit {100 * SHAKING_LIMIT:.0f} %), so that it does not "
        "turn evenly, which no uncertainty includes; take an encoder with more counts, a softer "
        "controller, or turn faster"
    ]
