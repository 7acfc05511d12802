"""Limits: checked before a motion is sent, watched while it runs; and switching off undisturbed."""

from __future__ import annotations

import contextlib
import math
import signal
import threading
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rigtool.errors import RecipeError
from rigtool.recipe.serial import Limits
from rigtool.rigs.base import Block, Feedforward, Task
from rigtool.rigs.motion import OpenLoop

Array = NDArray[np.float64]

BLOCK = 65536
"""Samples of a motion evaluated at a time."""

CURRENT_TOLERANCE = 0.05
"""Part of the current limit by which a measured current may be above it: the drive holds its
current at the limit, and noise is on top."""

WINDOW = 0.01
"""Time over which current is averaged and speed is taken from the encoder, s: a count a sample at
8 kHz would be 12 rad/s."""


ROUNDING = 1e-6
"""Angle by which a set point may pass a limit of position: it is computed, rad."""


@dataclass(frozen=True)
class Extremes:
    """What a task asks for at most, at the samples of the loop.

    `position` is (lowest, highest) rad, NaN in open loop, where nobody knows it; `current` [A] is
    the feed-forward's, or the whole in open loop; `speed`, `acceleration` are magnitudes.
    """

    duration: float
    position: tuple[float, float]
    speed: float
    acceleration: float
    current: float
    end: float

    def __str__(self) -> str:
        parts = [f"{self.duration:.3g} s"]
        if not math.isnan(self.position[0]):
            parts += [
                f"{self.position[0]:.3f} to {self.position[1]:.3f} rad",
                f"up to {self.speed:.3g} rad/s and {self.acceleration:.3g} rad/s2",
                f"feed-forward up to {self.current:.3g} A",
            ]
        else:
            parts.append(f"current up to {self.current:.3g} A")
        return ", ".join(parts)


def extremes(task: Task, origin: float, sample_time: float, torque_constant: float) -> Extremes:
    """Evaluate a task at every sample of the loop; `origin` [rad] is where the shaft is."""
    motion = task.motion
    total = max(1, round(motion.duration / sample_time))
    low, high, top_speed, top_acceleration, top_current = math.inf, -math.inf, 0.0, 0.0, 0.0
    end = origin
    for first in range(0, total, BLOCK):
        steps = np.arange(first, min(first + BLOCK, total))
        time = (steps.astype(np.float64) + 0.5) * sample_time
        if isinstance(motion, OpenLoop):
            top_current = max(top_current, float(np.abs(motion.current(time)).max()))
            continue
        position, speed, acceleration = motion.setpoint(time)
        position = position + (origin if motion.start is None else motion.start)
        current = (
            feedforward_torque(task.feedforward, position, speed, acceleration, steps)
            / torque_constant
        )
        low, high = min(low, float(position.min())), max(high, float(position.max()))
        top_speed = max(top_speed, float(np.abs(speed).max()))
        top_acceleration = max(top_acceleration, float(np.abs(acceleration).max()))
        top_current = max(top_current, float(np.abs(current).max()))
        end = float(position[-1])
    if isinstance(motion, OpenLoop):
        low = high = math.nan
    return Extremes(motion.duration, (low, high), top_speed, top_acceleration, top_current, end)


def feedforward_torque(
    feedforward: Feedforward,
    position: Array,
    speed: Array,
    acceleration: Array,
    steps: NDArray[np.int64],
) -> Array:
    """Return the torque that is added at these set points, samples `steps` of the loop; N m."""
    torque = model_torque(feedforward, speed, acceleration)
    if feedforward.table is not None:
        torque = torque + feedforward.table.evaluate(position, speed)
    if feedforward.signal is not None:
        torque = torque + feedforward.signal[steps % len(feedforward.signal)]
    return torque


def model_torque(feedforward: Feedforward, speed: Array, acceleration: Array) -> Array:
    """Return the part of the torque from inertia and friction model, N m."""
    torque: Array = (
        feedforward.inertia * acceleration
        + feedforward.viscous * speed
        + feedforward.coulomb * np.tanh(speed)
    )
    return torque


def check_duration(task: Task, limits: Limits) -> None:
    """Raise `RecipeError` for a motion that lasts too long: evaluating it would, too."""
    if task.motion.duration > limits.duration:
        raise RecipeError(
            f"{type(task.motion).__name__} would last {task.motion.duration:.4g} s, beyond "
            f"serial.limits.duration = {limits.duration:.4g} s: shorten it in the recipe, or raise "
            "the limit"
        )


def check(found: Extremes, limits: Limits, what: str = "this motion") -> None:
    """Raise `RecipeError` with everything that a motion asks beyond the limits."""
    low, high = limits.position
    beyond = [
        f"{name} {value:.4g} {unit} beyond serial.limits.{name} = {limit:.4g} {unit}"
        for name, value, limit, unit in (
            ("current", found.current, limits.current, "A"),
            ("speed", found.speed, limits.speed, "rad/s"),
            ("duration", found.duration, limits.duration, "s"),
        )
        if value > limit
    ]
    for value, is_beyond in (
        (found.position[0], found.position[0] < low - ROUNDING),
        (found.position[1], found.position[1] > high + ROUNDING),
    ):
        if is_beyond:
            beyond.append(
                f"position {value:.4g} rad beyond serial.limits.position = [{low:g}, {high:g}] rad"
            )
    if beyond:
        raise RecipeError(
            f"{what} would exceed the limits of the rig: {'; '.join(beyond)}: ask less of the "
            "rig in the recipe, or raise the limit if it stands that"
        )


class Watch:
    """Keeps an eye on what a running motion measures; speed and current over `WINDOW`."""

    def __init__(self, limits: Limits, encoder_counts: int) -> None:
        self._limits = limits
        self._count = 2 * math.pi / encoder_counts
        self._time = np.empty(0)
        self._encoder = np.empty(0)
        self._current = np.empty(0)

    def problem(self, block: Block) -> str | None:
        """Return what is beyond the limits in the signals that follow those so far, or None."""
        time, encoder = block["time"], block.get("encoder")
        if len(time) == 0:
            return None
        limits = self._limits
        hot = _top(block.get("temperature", time[:0]))
        if hot is not None and hot > limits.temperature_degc:
            return _beyond("temperature", hot, limits.temperature_degc, "degC")
        if encoder is not None:
            position = encoder * self._count
            for value in (np.nanmin(position), np.nanmax(position)) if _any(position) else ():
                if not limits.position[0] <= value <= limits.position[1]:
                    nearest = limits.position[0 if value < limits.position[0] else 1]
                    return _beyond("position", float(value), nearest, "rad")
        return self._fast(time, encoder, block.get("current"))

    def _fast(self, time: Array, encoder: Array | None, current: Array | None) -> str | None:
        limits, count = self._limits, len(self._time)
        everything = np.concatenate([self._time, time])
        if encoder is None:
            encoder = np.full(len(time), np.nan)
        if current is None:
            current = np.full(len(time), np.nan)
        encoders = np.concatenate([self._encoder, encoder])
        currents = np.concatenate([self._current, current])
        # from each sample back to the one at least a window before
        before = np.searchsorted(everything, everything - WINDOW, side="right") - 1
        rows = np.flatnonzero(before >= 0)
        kept = max(0, int(np.searchsorted(everything, everything[-1] - 2 * WINDOW)) - 1)
        self._time, self._encoder, self._current = (
            everything[kept:],
            encoders[kept:],
            currents[kept:],
        )
        rows = rows[rows >= count]
        if rows.size == 0:
            return None
        span = everything[rows] - everything[before[rows]]
        speed = np.abs(encoders[rows] - encoders[before[rows]]) * self._count / span
        # a count more or less over the window is the encoder's resolution, not speed
        speed -= self._count / span
        if (fastest := _top(speed)) is not None and fastest > limits.speed:
            return _beyond("speed", fastest, limits.speed, "rad/s")
        total = np.concatenate([[0.0], np.cumsum(np.nan_to_num(currents))])
        mean = np.abs(total[rows + 1] - total[before[rows] + 1]) / (rows - before[rows])
        if (largest := _top(mean)) is not None and largest > limits.current * (
            1 + CURRENT_TOLERANCE
        ):
            return _beyond("current", largest, limits.current, "A")
        return None


def _any(values: Array) -> bool:
    return bool(np.isfinite(values).any())


def _top(values: Array) -> float | None:
    return float(np.nanmax(values)) if _any(values) else None


def _beyond(name: str, value: float, limit: float, unit: str) -> str:
    return (
        f"{name} reached {value:.4g} {unit}, beyond the limit of {limit:.4g} {unit} "
        f"(serial.limits): the motor was stopped and switched off"
    )


@contextlib.contextmanager
def uninterrupted() -> Iterator[None]:
    """Switch off undisturbed: a second Ctrl-C or SIGTERM waits until the block is left."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    names = [name for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
    waiting: list[int] = []
    before = {
        getattr(signal, name): signal.signal(
            getattr(signal, name), lambda number, frame: waiting.append(number)
        )
        for name in names
    }
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    for number in waiting[:1]:
        signal.raise_signal(number)


def speed_of_moves(limits: Limits) -> float:
    """Return the mean speed of moves between recordings, rad/s: slow, and well within limits."""
    return min(2.0, 0.4 * limits.speed)
