"""The torque of the controller: set point of current less feed-forward and table [7.2.4.2, 8.1].

    controller torque = k (set point - feed-forward - table)

k is the torque per ampere (`torque_per_ampere`), the others are currents: the set point of the
amplifier, the feed-forward of inertia and friction, and the learned one, from a table by position
or as a signal by time.

A recording counts only where the loop was healthy: not saturated, the rotor held. A controller
answers a distance of rotor and set point with a torque: below its crossover with no less than its
smallest gain times the distance. A fast motion of a heavy load needs a large torque and thus a
large distance, which is no fault: all angles are read from the encoder. A distance without that
torque is a fault: of the encoder, of the set point or of [rig.controller].
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from rigtool import errors
from rigtool.control.position_loop import position_loop
from rigtool.errors import InsufficientDataError
from rigtool.numerics.arrays import TINY, Array
from rigtool.recipe import Recipe
from rigtool.runfile import Recording

TABLE, SIGNAL = "table_current", "signal_current"
"""Channels of learned torque: by position, by time."""

LOOP_CHANNELS = (
    "time",
    "current_setpoint",
    "feedforward_current",
    TABLE,
    "position_setpoint",
    "encoder",
)
"""Channels of the position loop with a table by position."""

AT_THE_LIMIT = 0.999
"""Part of the rig's limit of current from which on a set point counts as at the limit."""

SMALL_PART = 0.25
"""Part of the limit of current below which the mean at constant speed does not explain peaks."""

PARTS = 8
"""Of a recording at constant speeds, most of them of one direction: their means are what it takes,
also where the loop swings slowly."""

MOTION_TIME = 0.1
"""Time over which the mean of a current is what a motion takes, s: some periods of a loop's own."""

UNEXPLAINED_DISTANCE = 0.1
"""Distance of rotor and set point that is accepted without a torque, rad: friction, the encoder's
steps and the delay of the current leave this much at any load."""

LOWEST_HZ = 0.5
"""Lower end of the band in which the controller's gain counts: slower than any motion."""

SMALLER_FORCE = (
    "use a smaller force, take a stiffer [rig.controller] or a lower rig.controller.integrator_hz, "
    "which makes a load swing less, or move slower"
)
"""Remedy where the loop saturates under a load."""

SPECTRUM_POINTS, EDGE_HARMONICS = 500, 50
"""Frequencies up to half the rate at which the loop's answer to the encoder is taken, and harmonics
of the rate of its edges."""


@dataclass(frozen=True, eq=False)
class LoopSignals:
    """Signals of the position loop (n,): `time` s, `setpoint` and `rotor` rad, `encoder` counts.

    Currents in A: `total` is the set point of the amplifier, `controller` the controller's own part
    of it, `modelled` the feed-forward of inertia and friction, `learned` that of table or signal.
    """

    time: Array
    setpoint: Array
    encoder: Array
    rotor: Array
    total: Array
    controller: Array
    modelled: Array
    learned: Array


class LoopAnswer(NamedTuple):
    """How a loop answers a distance d of rotor and set point: with a torque of `gain` d or more,
    N m/rad; before d by its `lead`, s; its integrator with a period `turn`, s."""

    gain: float = 0.0
    lead: float = 0.0
    turn: float = 0.0


NO_ANSWER = LoopAnswer()
"""Of a loop that is not known."""


def controller_torque(
    recording: Recording, torque_constant: float, asked: Array | None = None
) -> Array:
    """Return the controller's torque over a recording (n,), N m; `torque_constant` in N m/A.

    Channels that the recording lacks were not fed forward; `asked` is its current set point, where
    that has been read.
    """
    current = recording.read("current_setpoint") if asked is None else asked
    for name in ("feedforward_current", TABLE, SIGNAL):
        if recording.has(name):
            current = current - recording.read(name)
    return torque_constant * current


def loop_blocks(recording: Recording, recipe: Recipe) -> Iterator[LoopSignals]:
    """Yield the signals of a recording block by block.

    Raises `InsufficientDataError` after the last block where the loop saturated or did not hold the
    rotor.
    """
    yield from _checked(recording.blocks(*_names(recording)), recipe, SMALLER_FORCE)


def loop_signals(recording: Recording, recipe: Recipe, remedy: str = SMALLER_FORCE) -> LoopSignals:
    """Return the signals of a whole recording; raises as `loop_blocks` does.

    `remedy` is what to do where the loop saturates.
    """
    whole = tuple(recording.read(name) for name in _names(recording))
    (signals,) = _checked([whole], recipe, remedy)
    return signals


def require_not_saturated(recording: Recording, recipe: Recipe) -> None:
    """Raise `InsufficientDataError` where the loop of a recording saturated."""
    names = "time", "current_setpoint", "feedforward_current"
    SaturationWatch(recipe, SMALLER_FORCE).block({name: recording.read(name) for name in names})


def _names(recording: Recording) -> list[str]:
    return [SIGNAL if name == TABLE and recording.has(SIGNAL) else name for name in LOOP_CHANNELS]


class SaturationWatch:
    """Watches the current of a loop, as it comes, which has to stay below its limit.

    A motion takes the mean over `MOTION_TIME`, and what is fed forward where the limit is reached:
    where both are small, the loop shakes. `remedy` is for a motion that takes too much.
    """

    def __init__(self, recipe: Recipe, remedy: str) -> None:
        self._recipe, self._remedy = recipe, remedy
        self._largest = self._taken = 0.0

    def add(self, time: Array, total: Array, modelled: Array) -> None:
        """Add times, s, the set point of the amplifier and the feed-forward in it, A, (n,) each."""
        if not len(time):
            return
        self._largest = max(self._largest, _largest(total))
        limited = np.abs(total) >= AT_THE_LIMIT * self._recipe.rig.current_limit
        parts = np.array_split(total, math.ceil(float(time[-1] - time[0]) / MOTION_TIME) or 1)
        means = np.array([part.mean() for part in parts if part.size])
        self._taken = max(self._taken, _largest(modelled[limited]), _largest(means))

    def block(self, block: Mapping[str, Array]) -> None:
        """Add a block of signals; raises as `require` does."""
        self.add(*(block[name] for name in ("time", "current_setpoint", "feedforward_current")))
        self.require()

    def require(self) -> None:
        """Raise `InsufficientDataError` where the current reached the limit of the rig."""
        require_unlimited(self._largest, self._recipe, self._remedy, self._taken)


def _checked(
    blocks: Iterable[tuple[Array, ...]], recipe: Recipe, remedy: str
) -> Iterator[LoopSignals]:
    controlled = farthest = 0.0
    watch = SaturationWatch(recipe, remedy)
    for time, total, modelled, learned, setpoint, encoder in blocks:
        rotor = encoder * recipe.rig.count_angle
        controller = total - modelled - learned
        watch.add(time, total, modelled)
        controlled = max(controlled, _largest(controller))
        # where the host runs the loop, the controller knew the sample before
        late = np.abs(np.diff(setpoint, prepend=setpoint[:1])) * _part_of_sample(time, recipe)
        farthest = max(farthest, float((np.abs(setpoint - rotor) - late).max(initial=0.0)))
        yield LoopSignals(time, setpoint, encoder, rotor, total, controller, modelled, learned)
    watch.require()
    require_tracking(recipe, largest_controller=controlled, distance=farthest)


def _part_of_sample(time: Array, recipe: Recipe) -> float:
    """Return a sample of the loop as part of a recorded one, at most 1; `time` (n,) s."""
    span = float(time[-1] - time[0]) if len(time) else 0.0
    return min(1.0, recipe.rig.sample_time * (len(time) - 1) / span) if span > 0 else 1.0


def _largest(values: Array) -> float:
    return float(max(values.max(initial=0.0), -values.min(initial=0.0)))


def naming(recording: Recording) -> AbstractContextManager[None]:
    """Name a recording in each `InsufficientDataError` that is raised within this context."""
    return errors.naming(f"recording {recording.name}")


def require_tracking(recipe: Recipe, *, largest_controller: float, distance: float) -> None:
    """Raise `InsufficientDataError` where the loop does not hold the rotor.

    `largest_controller` is the largest current of the controller's own, A, and `distance` the
    largest one of rotor and set point, rad.
    """
    allowed = UNEXPLAINED_DISTANCE + (
        recipe.rig.torque_constant * largest_controller / smallest_gain(recipe)
    )
    if distance > allowed:
        raise InsufficientDataError(
            f"the rotor is up to {distance:.3g} rad off its set point, more than the "
            f"{allowed:.3g} rad that the controller's torque explains, so the loop does not hold "
            "it: check the encoder and [rig.controller]"
        )


def require_unlimited(
    largest_current: float, recipe: Recipe, remedy: str, usual: float = math.inf
) -> None:
    """Raise `InsufficientDataError` where a current set point, A, is at the limit of the rig.

    `usual` is the size of its mean at constant speed, A: where that is small, the set point shakes.
    """
    limit = recipe.rig.current_limit
    if largest_current < AT_THE_LIMIT * limit:
        return
    if usual >= SMALL_PART * limit:
        remedy += ", or raise rig.current_limit as far as the motor bears it"
    else:
        remedy = (
            "turning takes little of it, so the loop shakes, by coarse steps of the encoder, by "
            "noise or by itself; take an encoder with more counts, or a softer [rig.controller]"
        )
    raise InsufficientDataError(
        f"the current set point reaches the limit of {limit} A, so the controller saturates "
        f"and the current no longer shows the torque: {remedy}"
    )


def require_stable_loop(recipe: Recipe) -> None:
    """Raise `InsufficientDataError` where the recipe's loop is unstable with the nominal inertia.

    Friction may keep such a loop from running away, but it swings. A drive that gets set points
    closes a loop of its own, or the host checks it as it connects. Raises `RecipeError` for a
    controller that this rate of samples cannot have.
    """
    hosted = recipe.rig.source == "serial" and recipe.serial and recipe.serial.driver != "target"
    if hosted or position_loop(**recipe.rig.loop_design).stable:
        return
    controller = recipe.rig.controller
    raise InsufficientDataError(
        f"the position loop is unstable with the nominal inertia "
        f"{recipe.rig.nominal_inertia:.4g} kg m2: crossover_hz is {controller.crossover_hz:g} Hz, "
        f"integrator_hz {controller.integrator_hz:g} Hz, at {1 / recipe.rig.sample_time:g} samples "
        "a second. Friction alone holds it, and it swings: set integrator_hz to a third of "
        "crossover_hz or less, and crossover_hz below a tenth of the rate"
    )


def encoder_shaking(recipe: Recipe, speed: Array) -> Array:
    """Return the standard deviation of speed that the encoder's steps make in the loop, relative.

    At speeds (n,), rad/s. The nominal loop follows the steps. To a shaft that turns evenly they are
    a sawtooth: its harmonics, step/(pi n), are speeds of twice the shaft's own each. Where edges
    come faster than the loop, they are noise of variance step^2/12, evenly up to half the rate
    (B. Widrow, I. Kollar, Quantization Noise, 2008). The larger of the two.
    """
    rig = recipe.rig
    answer = position_loop(**rig.loop_design).complementary_sensitivity.response
    step, way = rig.count_angle, np.maximum(np.abs(speed), TINY)
    noise = step * _speed_of_noise(**rig.loop_design) / way
    edges = np.outer(way / step, np.arange(1, EDGE_HARMONICS + 1))
    seen = edges < 0.5 / rig.sample_time
    followed = np.where(seen, np.abs(answer(edges)), 0.0)
    return np.maximum(noise, np.sqrt(2 * np.sum(followed**2, axis=1)))


@lru_cache(maxsize=4)  # of a thousand files with one recipe, once
def _speed_of_noise(**design: float) -> float:
    """Return the speed, in steps of the encoder a second, that its noise makes in a loop."""
    answer = position_loop(**design).complementary_sensitivity.response
    frequency = np.linspace(0, 0.5 / design["sample_time"], SPECTRUM_POINTS)[1:]
    swing = np.abs(answer(frequency)) * 2 * np.pi * frequency
    return math.sqrt(float(np.mean(swing**2)) / 12)


def usual_current(asked: Array) -> float:
    """Return the size of the mean of current set points (n,) at constant speeds, A."""
    parts = [part.mean() for part in np.array_split(asked, PARTS) if part.size]
    return float(np.mean(np.abs(parts))) if parts else 0.0


def smallest_gain(recipe: Recipe) -> float:
    """Return the smallest gain of the recipe's controller below its crossover, N m/rad."""
    return _smallest_gain(recipe.rig.controller.crossover_hz, **recipe.rig.loop_design)


def loop_answer(recipe: Recipe) -> LoopAnswer:
    """Return how the recipe's loop answers a distance; its lead of (s/wz + 1)/(s/wp + 1) is
    1/wz - 1/wp."""
    own = recipe.rig.controller
    lead = (own.lead_ratio - 1 / own.lead_ratio) / (2 * math.pi * own.crossover_hz)
    turn = 1 / own.integrator_hz if own.integrator_hz else 0.0
    return LoopAnswer(smallest_gain(recipe), lead, turn)


@lru_cache(maxsize=8)
def _smallest_gain(highest_hz: float, **design: float) -> float:
    """Return the smallest gain of a controller, cached for all recordings of a run."""
    frequency = np.geomspace(min(LOWEST_HZ, highest_hz), highest_hz, 100)
    return float(np.abs(position_loop(**design).controller.response(frequency)).min())
