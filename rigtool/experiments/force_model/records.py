"""Recorded motions under known loads, on a grid: the data that the force model is learned from.

All rows, measured and modelled, pass the same low-pass, evaluated by its spectrum: no phase shift,
no delay. A motion that repeats is the mean of its cycles (`numerics.steady_mean`), on one period;
any other wraps around, and its ends are left out. The gain is that of a Butterworth low-pass of
second order forward and backward,

    G(f) = 1 / (1 + (f / fc)^4).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from rigtool.errors import InsufficientDataError
from rigtool.experiments.force_filter.encoder_angle import interpolated
from rigtool.experiments.force_model.paths import bristle
from rigtool.numerics.arrays import Array, Mask
from rigtool.numerics.decimation import block_means
from rigtool.numerics.moves import rising_crossings
from rigtool.numerics.steady_mean import steady_mean

LOWPASS_HZ = 30.0
"""Cut-off of all compared signals; reversals of friction and the swing of an instrument lie
below."""

MOTION_HZ = 80.0
"""Cut-off of the angle before it is differentiated, against the encoder's steps."""

ROWS_HZ = 100.0
"""Rows a second."""

GRID_HZ = 500.0
"""Samples a second of the grid."""

WAVE_PART = 1 / 4
"""Frequency, in parts of the grid's, up to which waves are on it: those above would alias, and the
low-pass of the rows leaves less than 1 % of them."""

SLOW_PERIOD = 3.0
"""Period from which on half of the grid is enough, s."""

FINE = 1.5
"""Distance of places in samples up to which nothing between them is lost."""

SLIDING_COUNT_RATE = 160.0
"""Counts a second below which a rotor does not slide evenly."""

COUNTS_AFTER_TURN, AFTER_TURN_PART = 25.0, 1 / 70
"""Counts, and part of the way, after a turn that are left out at least: there the bristles, of
whatever length, are bent again."""

LOW_PASS_SPREAD = 0.04
"""Time over which the low-pass spreads a sample to either side, s."""

FEWEST_CYCLES = 3
"""Cycles of a recording up to which the first one is kept, although it runs in."""

END_TIME = 0.3
"""Time left out at both ends of a motion that does not repeat, s: wrapping fades there."""


def slowest_taught(speeds: Sequence[float], count: float) -> float:
    """Return the slowest of the `speeds` of strokes, rad/s, at which rows slide with counts of
    `count` rad; where they slide at none, the slowest of all."""
    return min([speed for speed in speeds if speed > SLIDING_COUNT_RATE * count] or speeds)


@dataclass(frozen=True, eq=False)
class Record:
    """One motion under one load.

    `interval` s of the grid; over the grid (n,): `angle` rad of the rotor, `current` A, `trusted`
    where the rotor slides. `torque_constant` N m/A; the load's `moment` N m at 90 degrees of the
    output and its `load_inertia` kg m2 about it. `cycles` is how many were averaged, 0 for a motion
    that does not repeat. `torques` (cycles, rows) N m are the motor's in each of them, low-passed;
    empty where nothing repeats. `passes` is how often the rows go through much the same motion: the
    errors of a model come back as often.
    """

    interval: float
    angle: Array
    current: Array
    trusted: Mask
    torque_constant: float
    moment: float
    load_inertia: float
    cycles: int
    torques: Array
    passes: int = field(default=1, kw_only=True)

    @property
    def periodic(self) -> bool:
        """Whether the motion repeats."""
        return self.cycles > 0

    @property
    def scatter(self) -> float:
        """Standard deviation of the cycles' torque, rms over all rows that count, N m; 0 of one
        cycle, and where no row counts."""
        if self.cycles < 2 or not self.used.any():
            return 0.0
        return float(np.sqrt(self.torques[:, self.used].var(axis=0, ddof=1).mean()))

    @cached_property
    def speed(self) -> Array:
        """Speed of the rotor (n,), rad/s."""
        return self._slope(self.angle, 1)

    @cached_property
    def acceleration(self) -> Array:
        """Acceleration of the rotor (n,), rad/s2."""
        return self._slope(self.angle, 2)

    @cached_property
    def current_rate(self) -> Array:
        """Rate of the current (n,), A/s."""
        return self._slope(self.current, 1)

    def wave(self, order: int, quarter: int) -> Array:
        """Return cosine (quarter 0) or sine (1) of an order of the rotor's angle (n,), 0 where
        it is too fast for the grid."""
        if (order, quarter) not in self._waves:
            shown = order * np.abs(self.speed) * self.interval < WAVE_PART * 2 * math.pi
            turned = order * self.angle
            self._waves[order, quarter] = np.where(
                shown, np.sin(turned) if quarter else np.cos(turned), 0.0
            )
        return self._waves[order, quarter]

    @cached_property
    def _waves(self) -> dict[tuple[int, int], Array]:
        return {}

    def _slope(self, signal: Array, order: int) -> Array:
        trend = np.linspace(signal[0], signal[-1], len(signal))
        if self.periodic:
            trend = np.zeros(len(signal))
        spectrum = np.fft.rfft(signal - trend)
        frequency = np.fft.rfftfreq(len(signal), self.interval)
        gain = (2j * np.pi * frequency) ** order / (1 + (frequency / MOTION_HZ) ** 4)
        slope = np.fft.irfft(spectrum * gain, len(signal))
        if order == 1 and not self.periodic:
            slope += (signal[-1] - signal[0]) / (self.interval * (len(signal) - 1))
        return slope

    @property
    def count(self) -> int:
        """Rows."""
        return _rows(self.angle.size, self.interval)

    def rows(self, signals: Array) -> Array:
        """Low-pass signals (..., n) and return them at the rows (..., rows)."""
        return lowpassed_rows(signals, self.interval)

    @cached_property
    def used(self) -> Mask:
        """Rows (rows,) that count."""
        place = np.arange(self.count) * (self.angle.size / self.count)
        used: Mask = self.trusted[np.minimum(place.astype(np.intp), self.angle.size - 1)]
        if not self.periodic:
            time = place * self.interval
            used = used & (time >= END_TIME) & (time <= self.angle.size * self.interval - END_TIME)
        return used


def _rows(size: int, interval: float) -> int:
    return int(min(size, round(size * interval * ROWS_HZ)))


def lowpassed_rows(signals: Array, interval: float, cutoff_hz: float = LOWPASS_HZ) -> Array:
    """Low-pass signals (..., n), sampled every `interval` s, and return their rows (..., rows)."""
    size = signals.shape[-1]
    count = _rows(size, interval)
    spectrum = np.fft.rfft(signals)[..., : count // 2 + 1]
    frequency = np.fft.rfftfreq(size, interval)[: count // 2 + 1]
    spectrum /= 1 + (frequency / cutoff_hz) ** 4
    return np.fft.irfft(spectrum, count) * (count / size)


@dataclass(frozen=True)
class LoadCase:
    """Conditions of a motion: the motor's `torque_constant` N m/A, the load's `moment` N m at 90
    degrees and its `load_inertia` kg m2, the `count` rad of the encoder, and the time `lead` s from
    the record of a current until it acts, in the middle of a sample and later."""

    torque_constant: float
    moment: float
    load_inertia: float
    count: float
    lead: float = 0.0


def repeated(
    encoder: Array, current: Array, setpoint: Array, interval: float, under: LoadCase
) -> Record:
    """Average the cycles of a motion; signals (n,) every `interval` s, counts, A, rad.

    The cycle that runs in is left out. Raises `InsufficientDataError` where not one is left.
    """
    from scipy.fft import next_fast_len

    encoder, current, setpoint, interval = _thinned(encoder, current, setpoint, interval)
    time = interval * np.arange(0.5, len(encoder))
    starts = rising_crossings(time, setpoint, (setpoint.max() + setpoint.min()) / 2)
    starts = starts[1:] if len(starts) > FEWEST_CYCLES else starts
    if len(starts) < 2:
        raise InsufficientDataError(
            "the recording holds no whole cycle of its motion: record for longer"
        )
    cycles = len(starts) - 1
    period = (starts[-1] - starts[0]) / cycles
    grid_hz = GRID_HZ if period < SLOW_PERIOD else GRID_HZ / 2
    size = next_fast_len(round(period * grid_hz), real=True)
    size += size % 2
    grid = starts[:-1, None] + np.arange(size) * (period / size)
    place = (grid.ravel() + under.lead) / interval
    angles = interpolated(encoder, place).reshape(cycles, size)
    currents = _within(current, grid.ravel() / interval, period / size / interval)
    currents = currents.reshape(cycles, size)
    angle = steady_mean(angles) * under.count
    speed = np.gradient(np.interp(grid[0], time, setpoint), period / size)
    return Record(
        period / size,
        angle,
        steady_mean(currents),
        _sliding(angle, speed, period / size, under.count, True),
        under.torque_constant,
        under.moment,
        under.load_inertia,
        cycles,
        lowpassed_rows(under.torque_constant * currents, period / size),
    )


def single(
    encoder: Array, current: Array, setpoint: Array, interval: float, under: LoadCase
) -> Record:
    """Return a motion that does not repeat; signals (n,) every `interval` s in counts, A, rad."""
    from scipy.fft import prev_fast_len

    encoder, current, setpoint, interval = _thinned(encoder, current, setpoint, interval)
    size = prev_fast_len(len(encoder), real=True) // 2 * 2
    encoder, current, setpoint = encoder[:size], current[:size], setpoint[:size]
    place = np.arange(0.5, size) + under.lead / interval
    angle = interpolated(encoder, place) * under.count
    return Record(
        interval,
        angle,
        _within(current, np.arange(0.5, size), 1.0),
        _sliding(angle, np.gradient(setpoint, interval), interval, under.count, False),
        under.torque_constant,
        under.moment,
        under.load_inertia,
        0,
        np.empty((0, 0)),
    )


def _thinned(
    encoder: Array, current: Array, setpoint: Array, interval: float
) -> tuple[Array, Array, Array, float]:
    """Return means of samples, `GRID_HZ` a second or as many as there are."""
    by = max(1, round(1 / (GRID_HZ * interval)))
    encoder, current, setpoint = (block_means(one, by) for one in (encoder, current, setpoint))
    return encoder, current, setpoint, interval * by


def _within(means: Array, place: Array, apart: float) -> Array:
    """Return the signal whose means over samples are given (n,), at places of them, `apart`.

    It is the slope of the cubic spline through the sums of these means. The means themselves, or
    a linear interpolation between them, would be smaller: at a tenth of the samples' rate by 2 and
    5 %. At fewer places than samples, the steps of an encoder would alias to a slow torque where as
    many pass in a second. There the signal is the mean from place to place, less 1/24 of its
    curvature (second difference), which restores slow changes.
    """
    from scipy.interpolate import make_interp_spline

    sums = make_interp_spline(np.arange(len(means) + 1.0), np.append(0.0, np.cumsum(means)))
    found: Array
    if apart <= FINE:
        found = sums.derivative()(place)
    else:
        found = (sums(place + apart / 2) - sums(place - apart / 2)) / apart
        found[1:-1] -= np.diff(found, 2) / 24
    return found


def bristle_scale(way: float, count: float) -> float:
    """Return about the length of a short bristle, rad, from motion over a way, rad.

    It is a count. With a fine encoder it is more counts, doubled as long as `COUNTS_AFTER_TURN` of
    this length are within the part of the way in which bristles are bent again.
    """
    return count * 2.0 ** _doublings(AFTER_TURN_PART * way / COUNTS_AFTER_TURN / count)


def halved(value: float, times: float) -> list[float]:
    """Return a value / 2, 4, .. up to `times`."""
    return [value / 2.0**n for n in range(1, 1 + _doublings(times))]


def _doublings(times: float) -> int:
    return math.floor(math.log2(max(1.0, times)))


def _sliding(
    angle: Array, setpoint_speed: Array, interval: float, count: float, periodic: bool
) -> Mask:
    """Return where the rotor slides (n,): fast enough, and far enough from its last turn.

    More slowly, the loop nudges the rotor from count to count, and its motion within them is
    unseen.
    """
    after_turn = max(COUNTS_AFTER_TURN * count, AFTER_TURN_PART * float(np.ptp(angle)))
    bent = bristle(angle, after_turn / 4, periodic)
    slides = (np.abs(bent) > 1 - np.exp(-4.0)) & (
        setpoint_speed * np.sign(bent) > SLIDING_COUNT_RATE * count
    )
    reach = round(LOW_PASS_SPREAD / interval)
    around = np.pad(~slides, reach, mode="wrap")
    near = np.convolve(around, np.ones(2 * reach + 1), mode="valid")
    return near == 0
