"""Turns of a steadily turning shaft in a recording of another rig, and the ripple in them.

Settling, speed and number of turns come from the signals alone. The angle is compared with a steady
motion, angle(t) = a + speed t; the residual,

    deviation(t) = angle(t) - a - speed t,

is the ripple of the motion, as torque against angle is that of the torque. A time axis may be
irregular: a cell of the turn has the mean over the time that the shaft spends in it. Where most
turns miss cells, the orders are fitted to several turns together, by least squares on the angle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from rigtool.errors import InsufficientDataError
from rigtool.experiments.ripple.orders import (
    HIGHEST_ORDER,
    Spectrum,
    cell_centres,
    coefficients,
    remove_offset,
    spectrum,
)
from rigtool.numerics.arrays import Array
from rigtool.numerics.checks import require_rising, require_signals
from rigtool.numerics.settling import settled_from

COVERED = 0.9
"""Smallest covered part of a turn that counts."""

NEIGHBOURS = 10
"""Orders on either side from which the noise of an order of a single turn is taken."""

MIN_SAMPLES = 64
"""Smallest number of samples in a recording."""

LEAST_FITS, MOST_FITS = 5, 20
"""Parts of a recording that are fitted one by one: fewer show no scatter, more hold too few turns
each."""

SAMPLES_PER_NUMBER = 3
"""Smallest number of samples for each amplitude that is fitted."""

WEAKEST = 0.3
"""Smallest singular value of the fitted functions, 1 where angles are evenly spread: samples that
meet the same angles in each turn do not resolve orders above half their number."""


@dataclass(frozen=True, eq=False)
class Turns:
    """Turns of one recording: (turns, positions), NaN in cells that were not passed.

    `torque` in its own unit, `deviation` from steady motion in rad, `speed` in rad/s with its sign,
    `settled` the time from the start to the steady motion, s. A row is the mean of `turns_a_row`;
    orders up to `orders` are resolved.
    """

    torque: Array
    deviation: Array
    speed: float
    settled: float
    orders: int
    turns_a_row: float = 1.0


def find_turns(time: Array, turns: Array, torque: Array, positions: int) -> Turns:
    """Return a recording by turn: `time` (n,) in s, angle in `turns` (n,), `torque` (n,).

    Samples before the steady motion are left out. Raises `InsufficientDataError` where less than
    `COVERED` of a turn is left.
    """
    time, turns, torque = require_signals(MIN_SAMPLES, time=time, turns=turns, torque=torque)
    require_rising(time)
    first, speed, deviation = _steady_part(time, turns, 0.5 / positions)
    progress = (turns[first:] - turns[first]) * math.copysign(1.0, speed)
    rows = math.floor(progress[-1] + 1 - COVERED)
    if rows < 1:
        raise InsufficientDataError(
            f"the shaft passes {max(progress[-1], 0.0):.2f} of a turn steadily, {COVERED} are "
            "needed: record for longer"
        )
    settled = float(time[first] - time[0])
    row = np.clip(np.floor(progress), 0, None).astype(np.int64)
    cell = np.floor(np.mod(turns[first:], 1.0) * positions).astype(np.int64) % positions
    used = row < rows
    place = (row * positions + cell)[used]
    weight = np.gradient(time[first:])[used]
    spent = np.bincount(place, weight, rows * positions).reshape(rows, positions)

    def mean(values: Array) -> Array:
        sums = np.bincount(place, weight * values[first:][used], rows * positions)
        with np.errstate(invalid="ignore"):
            cells: Array = sums.reshape(rows, positions) / spent
        return cells

    whole = np.mean(spent > 0, axis=1) >= COVERED
    if np.mean(whole) < 0.5:
        angle, steady = turns[first:][used], 2 * np.pi * deviation[first:][used]
        fitted = _fit_orders(angle, torque[first:][used], steady, rows, positions)
        return Turns(*fitted[:2], 2 * math.pi * speed, settled, fitted[2], rows / len(fitted[0]))
    return Turns(
        mean(torque)[whole],
        mean(2 * np.pi * deviation)[whole],
        2 * math.pi * speed,
        settled,
        HIGHEST_ORDER,
    )


def _fit_orders(
    turns: Array, torque: Array, deviation: Array, rows: int, positions: int
) -> tuple[Array, Array, int]:
    """Return waveforms (fits, positions) of torque and deviation, and the highest order in them.

    A row is the Fourier series that fits the samples of some successive turns best, angle in
    `turns` (n,); its cells hold means over their width. Raises `InsufficientDataError` where the
    samples do not resolve one order.
    """
    least, count = min(rows, LEAST_FITS), len(turns)
    orders = min(HIGHEST_ORDER, (count // (SAMPLES_PER_NUMBER * least) - 1) // 2)
    cells = cell_centres(positions)
    while orders >= 1:
        fits = min(rows, MOST_FITS, count // (SAMPLES_PER_NUMBER * (2 * orders + 1)))
        edges = np.searchsorted(np.abs(turns - turns[0]), np.arange(1, fits) * (rows / fits))
        parts = np.split(np.arange(count), edges)
        design = _series(2 * np.pi * turns, orders)
        squares = [design[part].T @ design[part] / len(part) for part in parts]
        if min(np.linalg.eigvalsh(square)[0] for square in squares) >= WEAKEST**2:
            both = np.column_stack([torque, deviation])
            sums = [design[part].T @ both[part] / len(part) for part in parts]
            width = np.repeat(np.sinc(np.arange(orders + 1) / positions), 2)[1:]
            found = np.linalg.solve(np.array(squares), np.array(sums))
            torques, deviations = np.moveaxis((_series(cells, orders) * width) @ found, -1, 0)
            return torques, deviations, orders
        orders = int(0.8 * orders)
    raise InsufficientDataError(
        f"{count} samples in {rows} turns, at equal angles in each, resolve no order: sample faster"
    )


def _series(angle: Array, orders: int) -> Array:
    """Return 1, cosine and sine of order 1, 2, ..., of unit variance, (n, 2 orders + 1)."""
    phase = np.multiply.outer(angle, np.arange(1, orders + 1))
    pairs = np.stack([np.cos(phase), np.sin(phase)], axis=-1).reshape(len(angle), -1)
    return np.column_stack([np.ones(len(angle)), math.sqrt(2) * pairs])


def _steady_part(time: Array, turns: Array, resolution: float) -> tuple[int, float, Array]:
    """Return the first sample of the steady motion, its speed in turns/s, and the deviation.

    Deviations below `resolution`, in turns, do not count.
    """
    half = int(np.searchsorted(time, (time[0] + time[-1]) / 2))
    first = half
    # The speed of the second half alone depends on its place in the turn: fit twice.
    for _ in range(2):
        speed, start = np.polyfit(time[first:], turns[first:], 1)
        deviation = turns - start - speed * time
        first = settled_from(deviation, half, resolution)
    return first, float(speed), deviation


def fill(waveforms: Array) -> tuple[Array, float]:
    """Return turns (turns, positions) without NaN, and the widest gap that was bridged, in turns.

    A cell that one turn missed takes the mean of the others; one that all turns missed lies on the
    line between its neighbours, which keeps orders of up to half a cycle in the gap.
    """
    known = np.isfinite(waveforms)
    counts = known.sum(axis=0)
    mean = np.where(known, waveforms, 0.0).sum(axis=0) / np.maximum(counts, 1)
    passed = np.flatnonzero(counts)
    positions = waveforms.shape[1]
    mean = np.interp(np.arange(positions), passed, mean[passed], period=positions)
    gap = int(np.max(np.diff(passed, append=passed[0] + positions))) - 1
    return np.where(known, waveforms, mean), gap / positions


def turn_spectrum(waveforms: Array, orders: int) -> Spectrum:
    """Return the orders 1..`orders` of the repeatable part of turns (turns, positions).

    A single turn has no repeatable part: the noise floor of an order is that of the orders around
    it.
    """
    if len(waveforms) > 1:
        return spectrum(remove_offset(waveforms), orders)
    found = coefficients(waveforms, orders)[0]
    amplitude = np.abs(found)
    floor = neighbours_floor(amplitude)
    return Spectrum(np.arange(1.0, orders + 1), amplitude, np.angle(found), floor)


def neighbours_floor(amplitude: Array) -> Array:
    """Return the noise floor of orders 1, 2, ... (m,) from the amplitudes around each.

    Their median is sqrt(ln 2) of the rms where they are noise (Rayleigh distribution). Zero where
    there is one order alone.
    """
    orders = len(amplitude)
    floor = np.zeros(orders)
    for index in range(orders if orders > 1 else 0):
        around = np.r_[max(0, index - NEIGHBOURS) : index, index + 1 : index + 1 + NEIGHBOURS]
        floor[index] = np.median(amplitude[around[around < orders]]) / math.sqrt(math.log(2))
    return floor


def reduction(reference: Spectrum, other: Spectrum) -> tuple[Array, Array]:
    """Return the reduction of each order in `other`, 1 - ratio, and its standard uncertainty.

    NaN where the order is not significant in the reference.
    """
    clear = reference.clear
    low = np.where(clear, reference.amplitude, np.nan)
    ratio = other.amplitude / low
    u = np.hypot(other.noise_floor, ratio * reference.noise_floor) / (math.sqrt(2) * low)
    return 1 - ratio, u
