"""Common to all implementations: recordings of a healthy loop, and their signals."""

from __future__ import annotations

import math

from rigtool import errors
from rigtool.errors import RunFileError
from rigtool.experiments.controller_torque import (
    SMALLER_FORCE,
    LoopSignals,
    SaturationWatch,
    loop_signals,
    naming,
)
from rigtool.experiments.learning.stored_table import feedforward
from rigtool.experiments.procedure import record
from rigtool.quantity import Quantity
from rigtool.recipe import Recipe
from rigtool.rigs import Rig, Task
from rigtool.runfile import Recording, RunWriter

SATURATION_REMEDY = "lower the speed, or raise ilc_learn.turn_angle"
"""Remedy where the controller saturates during learning."""


def record_loop(rig: Rig, recipe: Recipe, task: Task, recorder: RunWriter, name: str) -> None:
    """Record a task of the loop; `InsufficientDataError` names it as soon as the loop saturates,
    which no later one could mend."""
    remedy = SMALLER_FORCE if task.load.force else SATURATION_REMEDY
    with errors.naming(f"recording {name}"):
        record(rig, task, recorder, name, SaturationWatch(recipe, remedy).block)


def signals(recording: Recording, recipe: Recipe) -> LoopSignals:
    """Read a recording; `InsufficientDataError` names it where the loop was not healthy."""
    with naming(recording):
        return loop_signals(recording, recipe, SATURATION_REMEDY)


def require_friction_fed(
    name: str, recorded: float, speed: float, fed: dict[str, Quantity]
) -> None:
    """Raise `RunFileError` unless friction of this torque, N m, was fed forward at a speed, rad/s.

    A table belongs to the friction that was fed forward beside it.
    """
    friction = feedforward(0.0, fed)
    expected = friction.coulomb * math.tanh(speed) + friction.viscous * speed
    if not math.isclose(recorded, expected, rel_tol=0.02, abs_tol=1e-9):
        raise RunFileError(
            f"recording {name}: friction of {recorded * 1e3:.3g} mN m was fed forward at "
            f"{speed:.4g} rad/s, {expected * 1e3:.3g} mN m are expected"
            + (" without --friction" if not fed else "")
            + ": give the --friction that the moves were recorded with"
        )
