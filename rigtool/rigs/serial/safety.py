"""Limits: checked before a motion is sent, watched while it runs."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rigtool.errors import RecipeError
from rigtool.numerics.arrays import Array
from rigtool.recipe.serial import Limits
from rigtool.rigs.base import Block, Feedforward, Task
from rigtool.rigs.motion import Move, Observe, OpenLoop

BLOCK_SAMPLES = 65536
"""Samples of a motion evaluated at a time."""

CURRENT_TOLERANCE = 0.05
"""Part of the current limit by which a measured current may be above it: the drive holds its
current at the limit, and noise is on top."""

CURRENT_WINDOW = 0.01
"""Time over which current is averaged, s."""

SPEED_WINDOWS = 0.01 * 2.0 ** np.arange(7)
"""Times over which speed is taken from the encoder, s: a count a sample at 8 kHz would be 12 rad/s.
Longer ones judge more closely, shorter ones sooner."""

MAX_BLIND_TIME = 0.5
"""Longest time for which a position may be missing, s: the motor moves unobserved meanwhile."""

JUMP_RATIO = 5.0
"""Multiple of the limit of speed beyond which the encoder may be at fault as well."""


POSITION_ROUNDING = 1e-6
"""Angle by which a set point may pass a limit of position: it is computed, rad."""


SLOW_RUNAWAY = 2.0
"""Time to the limit of speed, s, from which on a shaft that runs away is noticed near the limit."""


SETTLE_TIME = 0.5
"""Added to each move between recordings, s."""


@dataclass(frozen=True)
class Extremes:
    """Largest demands of a task, at the samples of the loop.

    `position` is (lowest, highest) rad, NaN in open loop, where it is unknown; `current` [A] is
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
    """Evaluate a task at every sample of the loop; `origin` [rad] is where the shaft is.

    Raises `RecipeError` for a set point of position that jumps.
    """
    motion = task.motion
    if isinstance(motion, Observe):  # the path of another's motion is not known
        return Extremes(motion.duration, (math.nan, math.nan), 0.0, 0.0, 0.0, math.nan)
    total = max(1, round(motion.duration / sample_time))
    low, high, top_speed, top_acceleration, top_current = math.inf, -math.inf, 0.0, 0.0, 0.0
    end, path = origin, _Path(type(motion).__name__, sample_time)
    for first in range(0, total, BLOCK_SAMPLES):
        steps = np.arange(first, min(first + BLOCK_SAMPLES, total))
        time = (steps.astype(np.float64) + 0.5) * sample_time
        if isinstance(motion, OpenLoop):
            top_current = max(top_current, float(np.abs(motion.current(time)).max()))
            continue
        position, speed, acceleration = motion.setpoint(time)
        position = position + (origin if motion.start is None else motion.start)
        path.follow(time, position, speed, acceleration)
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


class _Path:
    """Set points of a motion, block by block: positions follow from speeds."""

    def __init__(self, name: str, sample_time: float) -> None:
        self._name, self._dt = name, sample_time
        self._last = np.empty((4, 0))

    def follow(self, time: Array, position: Array, speed: Array, acceleration: Array) -> None:
        """Raise `RecipeError` where the position goes further than speed and acceleration allow."""
        signals = np.concatenate([self._last, [time, position, speed, acceleration]], axis=1)
        self._last = signals[:, -1:]
        moved = np.abs(np.diff(signals[1]))
        fastest, hardest = (np.maximum(np.abs(s[1:]), np.abs(s[:-1])) for s in signals[2:])
        allowed = 2 * (fastest + hardest * self._dt) * self._dt + POSITION_ROUNDING
        if (jumps := np.flatnonzero(moved > allowed)).size:
            at = jumps[0]
            raise RecipeError(
                f"the set point of {self._name} jumps by {moved[at]:.3g} rad at "
                f"{signals[0, at + 1]:.4g} s, where its speed is {fastest[at]:.3g} rad/s: change "
                "the angles or times of this motion in the recipe"
            )


def feedforward_torque(
    feedforward: Feedforward,
    position: Array,
    speed: Array,
    acceleration: Array,
    steps: NDArray[np.int64],
) -> Array:
    """Return the torque that is added at these set points, samples `steps` of the loop; N m."""
    torque = feedforward.model_torque(speed, acceleration)
    if feedforward.table is not None:
        torque = torque + feedforward.table.evaluate(position, speed)
    if feedforward.signal is not None:
        torque = torque + feedforward.signal[steps % len(feedforward.signal)]
    return torque


def require_duration(task: Task, limits: Limits) -> None:
    """Raise `RecipeError` for a motion that lasts too long: its evaluation would as well."""
    if task.motion.duration > limits.duration:
        raise RecipeError(
            f"{type(task.motion).__name__} would last {task.motion.duration:.4g} s, beyond "
            f"serial.limits.duration = {limits.duration:.4g} s: shorten it in the recipe, or raise "
            "the limit"
        )


def require_within_limits(found: Extremes, limits: Limits, what: str = "this motion") -> None:
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
        (found.position[0], found.position[0] < low - POSITION_ROUNDING),
        (found.position[1], found.position[1] > high + POSITION_ROUNDING),
    ):
        if is_beyond:
            beyond.append(
                f"position {value:.4g} rad beyond serial.limits.position = [{low:g}, {high:g}] rad"
            )
    if beyond:
        raise RecipeError(
            f"{what} would exceed the limits of the rig: {'; '.join(beyond)}: ask for less in the "
            "recipe, or raise the limit if the rig withstands that"
        )


class Watch:
    """Watches the signals of a running motion.

    **Speed.** Time stamps may be late and jitter. The only assumption: a reading was made after the
    previous stamp, and at most as long after its own stamp as the previous stamp is before it. This
    holds where the stamp is that of the answer, the middle of question and answer, or the moment
    itself. The limit applies to the slowest motion consistent with this, over `SPEED_WINDOWS`, less
    one count of the encoder.
    - A motor within the limit never trips it, with any jitter.
    - Let T be the longest interval between samples. A speed v that lasts for W + 6 T, W one of the
      windows, always trips where v (W - 2 T) > limit (W + 2 T) + 2 counts, counts in rad. At 8 kHz
      and 4000 counts that is 1.06 times the limit and 0.3 rad/s, over 11 ms; at 250 Hz 1.5 times
      the limit over 64 ms, 1.22 times over 0.11 s; at 50 Hz 1.7 times over 0.28 s, 1.3 times over
      0.44 s.

    **Current.** The mean of its magnitude over `CURRENT_WINDOW`, or over two samples that are
    further apart than that: a single noisy sample does not trip, an oscillating current does. A
    current beyond the limit by `CURRENT_TOLERANCE` for all that time always trips, one within it
    never.

    **Position, temperature.** Each sample. NaN is a missing sample and is left out; positions that
    are missing for longer than `MAX_BLIND_TIME` trip as well. A jump of position, where the encoder
    wraps around or loses counts, appears as speed or as a position.

    **Following.** Where the loop is `closed`, the distance of position and set point, each sample:
    a shaft that is blocked, a set point that the drive clamps, a loop that does not hold.
    """

    def __init__(self, limits: Limits, encoder_counts: int, *, closed: bool = False) -> None:
        self._limits, self._closed = limits, closed
        self._count = 2 * math.pi / encoder_counts
        self._positions = _Tail(float(SPEED_WINDOWS[-1]))
        self._currents = _Tail(CURRENT_WINDOW)
        self._seen = math.nan

    def problem(self, block: Block) -> str | None:
        """Return which limit the next signals exceed, in words, or None."""
        time, encoder = block["time"], block.get("encoder")
        if len(time) == 0:
            return None
        limits = self._limits
        temperature = block.get("temperature", time[:0])
        if (temperature > limits.temperature_degc).any():  # NaN is not
            hot = float(np.nanmax(temperature))
            return _beyond("temperature", hot, limits.temperature_degc, "degC")
        if encoder is not None:
            position = encoder * self._count
            low, high = limits.position
            if (position < low).any():
                return _beyond("position", float(np.nanmin(position)), low, "rad")
            if (position > high).any():
                return _beyond("position", float(np.nanmax(position)), high, "rad")
            found = (
                self._blind(time, position)
                or self._fast(time, position)
                or self._off(block, position)
            )
            if found:
                return found
        current = block.get("current")
        return None if current is None else self._strong(time, current)

    def _blind(self, time: Array, position: Array) -> str | None:
        """Check for how long positions are missing."""
        known = np.isfinite(position)
        if known.all():
            self._seen = float(time[-1])
            return None
        begin = time[0] if math.isnan(self._seen) else self._seen
        seen = np.maximum.accumulate(np.where(known, time, begin))
        self._seen = float(seen[-1])
        longest = float(np.max(time - seen, initial=0.0, where=~known))
        if longest <= MAX_BLIND_TIME:
            return None
        return (
            f"the position was missing for {longest:.3g} s, and the motor moved unobserved: it was "
            "stopped and switched off; check its encoder, or the line"
        )

    def _fast(self, time: Array, position: Array) -> str | None:
        """Check speed, over each of the windows."""
        new, time, position = self._positions.follow(time, position)
        first = np.searchsorted(time, time[new:, None] - SPEED_WINDOWS, side="right") - 1
        row, window = np.nonzero(first >= 1)
        if row.size == 0:
            return None
        first, last = first[row, window], row + new
        # from the stamp before the first reading, to as long after the last stamp as another is
        # before it
        longest = (2 * time[last] - time[last - 1]) - time[first - 1]
        turned = np.abs(position[last] - position[first]) - self._count
        fastest = float((turned / longest).max())
        if fastest <= self._limits.speed:
            return None
        found = _beyond("speed", fastest, self._limits.speed, "rad/s")
        if fastest > JUMP_RATIO * self._limits.speed:
            found += ". Such a speed may also be a jump of the position: check the encoder"
        return found

    def _off(self, block: Block, position: Array) -> str | None:
        """Check the distance of the shaft from its set point."""
        setpoint = block.get("position_setpoint")
        if not self._closed or setpoint is None:
            return None
        off = np.abs(position - setpoint)
        if not (off > self._limits.following_error).any():
            return None
        worst = int(np.nanargmax(off))
        return (
            f"the shaft is at {position[worst]:.4g} rad and its set point at {setpoint[worst]:.4g} "
            f"rad, further apart than serial.limits.following_error = "
            f"{self._limits.following_error:.4g} rad: the motor was stopped and switched off; see "
            "whether the shaft is blocked, whether the drive clamps its set point, or tune its loop"
        )

    def _strong(self, time: Array, current: Array) -> str | None:
        """Check the mean of the current's magnitude."""
        new, time, current = self._currents.follow(time, current)
        before = np.searchsorted(time, time[new:] - CURRENT_WINDOW, side="right") - 1
        row = np.flatnonzero(before >= 0)
        if row.size == 0:
            return None
        total = np.concatenate([[0.0], np.cumsum(np.abs(current))])
        mean = (total[row + new + 1] - total[before[row] + 1]) / (row + new - before[row])
        largest = float(mean.max())
        if largest <= self._limits.current * (1 + CURRENT_TOLERANCE):
            return None
        return _beyond("current", largest, self._limits.current, "A")


def runaway(limits: Limits, encoder_counts: int, period: float, acceleration: float) -> float:
    """Return the speed at which `Watch` notices a shaft that runs away from rest, rad/s.

    It accelerates evenly, rad/s2, and is sampled each `period`, s, without a delay: with friction
    it is slower, with late samples faster.
    """
    if acceleration * SLOW_RUNAWAY < limits.speed:
        return limits.speed
    anywhere = limits.model_copy(update={"position": (-math.inf, math.inf)})
    watch, time = Watch(anywhere, encoder_counts), 0.0
    while True:
        turned = acceleration * time**2 / 2
        encoder = math.floor(turned / (2 * math.pi) * encoder_counts)
        if watch.problem({"time": np.array([time]), "encoder": np.array([float(encoder)])}):
            return acceleration * time
        time += period


class _Tail:
    """The end of a signal, `length` s of it, without missing samples."""

    def __init__(self, length: float) -> None:
        self._length = length
        self._time = np.empty(0)
        self._values = np.empty(0)

    def follow(self, time: Array, values: Array) -> tuple[int, Array, Array]:
        """Return tail and block (n,), the number of old samples in it, and keep its end."""
        there = np.isfinite(values)
        old = len(self._time)
        time = np.concatenate([self._time, time[there]])
        values = np.concatenate([self._values, values[there]])
        if len(time):
            kept = max(0, int(np.searchsorted(time, time[-1] - self._length)) - 2)
            self._time, self._values = time[kept:], values[kept:]
        return old, time, values


def _beyond(name: str, value: float, limit: float, unit: str) -> str:
    return (
        f"{name} reached {value:.4g} {unit}, beyond the limit of {limit:.4g} {unit} "
        f"(serial.limits): the motor was stopped and switched off"
    )


def slow_move(angle: float, limits: Limits) -> Move:
    """Return a move between recordings by an angle, rad: slow, and well within the limits."""
    return Move(angle, SETTLE_TIME + abs(angle) / min(2.0, 0.4 * limits.speed))
