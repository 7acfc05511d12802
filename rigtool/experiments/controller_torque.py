"""The torque of the controller: all that it asks for, less what is fed forward [7.2.4.2, 8.1].

    controller torque = k (set point - feed-forward - table)

k is the torque per ampere (`torque_per_ampere`), the others are currents: the set point of the
amplifier, the feed-forward of inertia and friction, and what was learned, from a table by position
or as a signal by time.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rigtool.errors import InsufficientDataError
from rigtool.experiments.loop_health import require_loop_health
from rigtool.recipe import Recipe
from rigtool.runfile import Recording

Array = NDArray[np.float64]

TABLE, SIGNAL = "table_current", "signal_current"
"""Channels of what was learned: by position, by time."""

CHANNELS = (
    "time",
    "current_setpoint",
    "feedforward_current",
    TABLE,
    "position_setpoint",
    "encoder",
)
"""What is recorded of the position loop while the table is by position."""


@dataclass(frozen=True, eq=False)
class LoopSignals:
    """Signals of the position loop (n,): `time` s, `setpoint` and `rotor` rad, `encoder` counts.

    Currents in A: `asked` is the set point of the amplifier, `controller` the controller's own part
    of it, `modelled` the feed-forward of inertia and friction, `learned` that of table or signal.
    """

    time: Array
    setpoint: Array
    encoder: Array
    rotor: Array
    asked: Array
    controller: Array
    modelled: Array
    learned: Array


def controller_torque(recording: Recording, torque_constant: float) -> Array:
    """Return the controller's torque over a recording (n,), N m; `torque_constant` in N m/A.

    What the recording does not hold was not fed forward.
    """
    current = recording.read("current_setpoint")
    for name in ("feedforward_current", TABLE, SIGNAL):
        if recording.has(name):
            current = current - recording.read(name)
    return torque_constant * current


def loop_blocks(
    recording: Recording, recipe: Recipe, remedy: str = "use a smaller force"
) -> Iterator[LoopSignals]:
    """Yield the signals of a recording block by block.

    Raises `InsufficientDataError` after the last block where the loop saturated or did not hold the
    rotor; `remedy` for the former is part of the message.
    """
    yield from _checked(recording.blocks(*_names(recording)), recipe, remedy)


def loop_signals(
    recording: Recording, recipe: Recipe, remedy: str = "use a smaller force"
) -> LoopSignals:
    """Return the signals of a whole recording; raises as `loop_blocks` does."""
    whole = tuple(recording.read(name) for name in _names(recording))
    (signals,) = _checked([whole], recipe, remedy)
    return signals


def _names(recording: Recording) -> list[str]:
    return [SIGNAL if name == TABLE and recording.has(SIGNAL) else name for name in CHANNELS]


def _checked(
    blocks: Iterable[tuple[Array, ...]], recipe: Recipe, remedy: str
) -> Iterator[LoopSignals]:
    largest = controlled = farthest = 0.0
    for time, asked, modelled, learned, setpoint, encoder in blocks:
        rotor = encoder * (2 * math.pi / recipe.rig.encoder_counts)
        controller = asked - modelled - learned
        largest = max(largest, _largest(asked))
        controlled = max(controlled, _largest(controller))
        farthest = max(farthest, _largest(setpoint - rotor))
        yield LoopSignals(time, setpoint, encoder, rotor, asked, controller, modelled, learned)
    require_loop_health(
        recipe,
        largest_current=largest,
        largest_controller=controlled,
        distance=farthest,
        remedy=remedy,
    )


def _largest(values: Array) -> float:
    return float(max(values.max(initial=0.0), -values.min(initial=0.0)))


@contextmanager
def naming(recording: Recording) -> Iterator[None]:
    """Name a recording in each `InsufficientDataError` that is raised within this context."""
    try:
        yield
    except InsufficientDataError as error:
        raise InsufficientDataError(f"recording {recording.name}: {error}") from None
