"""What all implementations share: channels, a look at a recording's health, names of recordings."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rigtool.errors import InsufficientDataError, RunFileError, UsageError
from rigtool.experiments.learning.stored_table import feedforward
from rigtool.experiments.loop_tracking import require_tracking
from rigtool.quantity import Quantity
from rigtool.recipe import Recipe
from rigtool.runfile import Recording, Run

Array = NDArray[np.float64]

CHANNELS = (
    "time",
    "current_setpoint",
    "feedforward_current",
    "table_current",
    "position_setpoint",
    "encoder",
)
"""What is recorded while the table is by position."""


@dataclass(frozen=True, eq=False)
class Signals:
    """Signals of a recording (n,): s, rad, and N m of the controller and of what was learned."""

    time: Array
    setpoint: Array
    rotor: Array
    controller: Array
    learned: Array


def signals(
    recording: Recording, recipe: Recipe, torque_constant: float, added: str = "table_current"
) -> Signals:
    """Read a recording after a look at its health; `added` is the channel of what was learned.

    Controller torque = torque constant * (set point - feed-forward - added). Raises
    `InsufficientDataError` where the controller saturates, or does not hold the rotor.
    """
    asked, setpoint = recording.read("current_setpoint"), recording.read("position_setpoint")
    rotor = recording.read("encoder") * (2 * math.pi / recipe.rig.encoder_counts)
    learned = recording.read(added)
    controller = asked - recording.read("feedforward_current") - learned
    try:
        require_tracking(
            recipe,
            largest_current=float(np.abs(asked).max(initial=0)),
            largest_controller=float(np.abs(controller).max(initial=0)),
            distance=float(np.abs(setpoint - rotor).max(initial=0)),
            remedy="lower the speed, or raise ilc_learn.turn_angle",
        )
    except InsufficientDataError as error:
        raise InsufficientDataError(f"recording {recording.name}: {error}") from None
    return Signals(
        recording.read("time"),
        setpoint,
        rotor,
        torque_constant * controller,
        torque_constant * learned,
    )


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


def only_run(runs: Sequence[Run]) -> Run:
    """Return the one run of signals that ilc-learn takes; `UsageError` for more."""
    if len(runs) > 1:
        raise UsageError(f"{len(runs)} run files: ilc-learn takes one, with all its speeds")
    return runs[0]


def found(run: Run, kind: str) -> list[Recording]:
    """Return the recordings of a kind that hold samples; `RunFileError` where there are none."""
    recordings = filled(run, kind)
    if not recordings:
        raise RunFileError(
            f"{run.path}: has no recording {kind}_000: give the run file in which ilc-learn "
            "recorded its signals"
        )
    return recordings


def filled(run: Run, kind: str) -> list[Recording]:
    """Return the recordings of a kind that hold samples: what was planned need not be made."""
    return [recording for recording in run.recordings_named(f"{kind}_") if recording.size]
