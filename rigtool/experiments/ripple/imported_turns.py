"""Turns of a steadily turning shaft in a recording of another rig, and the ripple in them.

Settling, speed and number of turns come from the signals alone. The angle is compared with a steady
motion, angle(t) = a + speed t; the residual,

    deviation(t) = angle(t) - a - speed t,

is the ripple of the motion, as torque against angle is that of the torque. Cells of the turn have
the means over the time that the shaft spends in them: where it turns steadily, those of the bench
(`Revolutions`); a shaft that sticks and jumps, or turns back, has those of the samples in each. A
recording may be one turn alone, of which a tenth may lack; its time axis may be irregular. Where
most turns miss cells, the orders are fitted to several turns together, by least squares on the
angle.

Samples at angles p_j see order k' as part of order k by

    A(m) = |mean over j of exp(i m p_j)|,   m = k' - k or k' + k

1 where the samples meet the same angles in each turn, s a turn, and m is a multiple of s: orders k
and s - k are then one (`aliases`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from rigtool.errors import InsufficientDataError
from rigtool.experiments.ripple.orders import HIGHEST_ORDER, Spectrum, cell_centres
from rigtool.experiments.ripple.revolutions import Revolutions
from rigtool.numerics.arrays import Array
from rigtool.numerics.checks import require_rising, require_signals
from rigtool.numerics.settling import settled_from

CELLS_AN_ORDER = 5
"""Cells of the turn for an order that they carry."""

MAX_ALIASED_PART = 0.3
"""Part of a higher order's amplitude seen in a lower one from which on the samples do not separate
the two: angles that are spread evenly show 1/sqrt(n)."""

STATED, FEW_ORDERS, STANDS_OUT = 0.03, 20, 4.0
"""Relative error of a stated speed, orders that show it first, and the least ratio of their power
to that at other speeds."""

MIN_COVERED_PART = 0.9
"""Smallest covered part of a turn that counts."""

MIN_SAMPLES = 64
"""Smallest number of samples in a recording."""

LEAST_FITS, MOST_FITS = 5, 20
"""Parts of a recording that are fitted one by one: fewer show no scatter, more hold too few turns
each."""

SAMPLES_PER_NUMBER = 3
"""Smallest number of samples for each amplitude that is fitted."""

MIN_SINGULAR_VALUE = 0.3
"""Smallest singular value of the fitted functions, 1 where angles are evenly spread: samples that
meet the same angles in each turn do not resolve orders above half their number."""

BLOCK_NUMBERS = 2**20
"""Numbers of a design that are in memory at a time."""


@dataclass(frozen=True, eq=False)
class Turns:
    """Turns of one recording: (turns, positions), NaN in cells that were not passed.

    `torque` in its own unit, `deviation` from steady motion in rad, `speed` in rad/s with its sign,
    `settled` the time from the start to the steady motion, s. A row is the mean of `turns_a_row`,
    its samples lie `step` of a turn apart, 0 where no lines were drawn between them; orders up to
    `orders` are resolved, of which the part `leak` (orders,) of the amplitude of the
    order `alias` (orders,) is seen as one.
    """

    torque: Array
    deviation: Array
    speed: float
    settled: float
    orders: int
    turns_a_row: float
    step: float
    alias: Array
    leak: Array


def find_turns(time: Array, turns: Array, torque: Array, positions: int) -> Turns:
    """Return a recording by turn: `time` (n,) in s, angle in `turns` (n,), `torque` (n,).

    Cells of the turn carry orders up to a `CELLS_AN_ORDER`-th of their number. Samples before the
    steady motion are left out. Raises `InsufficientDataError` where less than `MIN_COVERED_PART` of
    a turn is left.
    """
    time, turns, torque = require_signals(MIN_SAMPLES, time=time, turns=turns, torque=torque)
    require_rising(time)
    whole = time
    first, speed, deviation = _steady_part(time, turns, 0.5 / positions)
    time, turns, torque = time[first:], turns[first:], torque[first:]
    both = torque, 2 * np.pi * deviation[first:]
    settled = float(time[0] - whole[0])
    cells = _Cells(turns, math.copysign(1.0, speed), positions)
    if cells.rows < 1:
        raise InsufficientDataError(
            f"the shaft passes {max(cells.way, 0.0):.2f} of a turn steadily, {MIN_COVERED_PART} "
            "are needed: record for longer"
        )
    rows = [cells.waveforms(time, values) for values in both]
    covered = np.mean(np.isfinite(rows[0]), axis=1) >= MIN_COVERED_PART
    if np.mean(covered) < 0.5:
        used = cells.used
        *rows, orders = _fit_orders(turns[used], torque[used], both[1][used], cells.rows, positions)
        seen = aliases(turns[used], orders, max(orders, positions // CELLS_AN_ORDER))
        a_row, step = cells.rows / len(rows[0]), 0.0
    else:
        rows, orders = [row[covered] for row in rows], positions // CELLS_AN_ORDER
        seen = np.full(orders, np.nan), np.zeros(orders)
        a_row, step = 1.0, cells.way / (len(turns) - 1) if cells.steady else 0.0
    return Turns(rows[0], rows[1], 2 * math.pi * speed, settled, orders, a_row, step, *seen)


class _Cells:
    """Cells of the turn that samples at angles (n,), in turns, pass.

    `steady` where no sample skips a cell or goes back by one. The first cell is then the first
    whole one, else that of the first sample.
    """

    def __init__(self, turns: Array, sign: float, positions: int) -> None:
        self.steady = bool(np.abs(np.diff(turns)).max() < 1 / positions)
        start = sign * turns[0] * positions
        first = math.ceil(start) if self.steady else math.floor(start)
        self._advance = sign * turns - first / positions
        self._positions = positions
        self.way = float(self._advance[-1])
        self.rows = math.floor(self.way + 1 - MIN_COVERED_PART)
        self.used = self._advance < self.rows
        order = np.arange(positions)
        self._place = (first + order if sign > 0 else -first - order - 1) % positions

    def waveforms(self, time: Array, values: Array) -> Array:
        """Return the mean of values (n,) over the time in each cell by turn; NaN where no sample
        lies.

        As the bench takes them where the motion is steady, else of the samples in each.
        """
        size = self.rows * self._positions
        at = np.floor(self._advance * self._positions).astype(np.int64)
        inside = (at >= 0) & (at < size)
        weight = np.gradient(time)[inside]
        spent = np.bincount(at[inside], weight, size)
        if self.steady:
            revolutions = Revolutions(self._positions, forward=True)
            revolutions.add(time, self._advance, values)
            found = revolutions.cells()[:size]
            means = np.full(size, np.nan)
            means[: len(found)] = found
        else:
            sums = np.bincount(at[inside], weight * values[inside], size)
            with np.errstate(invalid="ignore"):
                means = sums / spent
        means[spent == 0] = np.nan
        waveforms = np.empty((self.rows, self._positions))
        waveforms[:, self._place] = means.reshape(self.rows, self._positions)
        return waveforms


def aliases(turns: Array, orders: int, highest: int) -> tuple[Array, Array]:
    """Return for orders 1 to `orders` the higher one, up to `highest`, that samples at angles (n,)
    in `turns` show as part of it most, and which part; NaN and 0 where that is below
    `MAX_ALIASED_PART`."""
    alias, leak = np.full(orders, np.nan), np.zeros(orders)
    phase = np.exp(2j * np.pi * turns)
    kernel = np.zeros(2 * highest + 1)
    power = np.ones_like(phase)
    for m in range(1, 2 * highest + 1):
        power = power * phase
        kernel[m] = abs(power.mean())
    above = np.arange(orders + 1, highest + 1)
    for order in range(1, orders + 1) if above.size else ():
        seen = np.maximum(kernel[above - order], kernel[above + order])
        most = int(np.argmax(seen))
        if seen[most] > MAX_ALIASED_PART:
            alias[order - 1], leak[order - 1] = above[most], seen[most]
    return alias, leak


def refined_speed(time: Array, torque: Array, speed: float) -> float:
    """Return the speed near a stated one, turns/s, at which the orders of a torque are strongest.

    `time` (n,) s, `torque` (n,). The sum of the power of orders over speeds within `STATED` of the
    stated one, first of few orders, then finer of more. The stated speed where no orders stand out.
    """
    step = float(np.median(np.diff(time)))
    even = np.arange(time[0], time[-1], step)
    values = np.interp(even, time, torque)
    values = (values - np.polyval(np.polyfit(even, values, 1), even)) * np.hanning(len(even))
    size = 32 * 2 ** math.ceil(math.log2(len(even)))
    power = np.abs(np.fft.rfft(values, size)) ** 2
    lasted, best, within = float(even[-1] - even[0]), speed, STATED * abs(speed)
    for most in (FEW_ORDERS, HIGHEST_ORDER):
        orders = np.arange(1, min(most, max(1, int(0.4 / step / abs(speed)))) + 1)
        fine = 1 / (4 * lasted * orders[-1])
        tried = best + np.arange(-math.ceil(within / fine), math.ceil(within / fine) + 1) * fine
        places = np.rint(np.abs(np.multiply.outer(tried, orders)) * step * size).astype(np.int64)
        sums = power[np.minimum(places, len(power) - 1)].sum(axis=1)
        if most == FEW_ORDERS and sums.max() < STANDS_OUT * np.median(sums):
            return speed
        best, within = float(tried[int(np.argmax(sums))]), 2 * fine
    return best


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
        both = np.column_stack([torque, deviation])
        squares, sums = zip(
            *(_moments(turns[part], both[part], orders) for part in parts), strict=True
        )
        if min(np.linalg.eigvalsh(square)[0] for square in squares) >= MIN_SINGULAR_VALUE**2:
            width = np.repeat(np.sinc(np.arange(orders + 1) / positions), 2)[1:]
            found = np.linalg.solve(np.array(squares), np.array(sums))
            torques, deviations = np.moveaxis((_series(cells, orders) * width) @ found, -1, 0)
            return torques, deviations, orders
        orders = int(0.8 * orders)
    raise InsufficientDataError(
        f"{count} samples in {rows} turns, at equal angles in each, resolve no order: sample faster"
    )


def _moments(turns: Array, values: Array, orders: int) -> tuple[Array, Array]:
    """Return means of the series' products with itself (p, p) and with values (n, 2), (p, 2)."""
    size = 2 * orders + 1
    square, with_values = np.zeros((size, size)), np.zeros((size, 2))
    block = max(BLOCK_NUMBERS // size, 1)
    for first in range(0, len(turns), block):
        design = _series(2 * np.pi * turns[first : first + block], orders)
        square += design.T @ design
        with_values += design.T @ values[first : first + block]
    return square / len(turns), with_values / len(turns)


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


def reduction(reference: Spectrum, other: Spectrum) -> tuple[Array, Array]:
    """Return the reduction of each order in `other`, 1 - ratio, and its standard uncertainty.

    NaN where the order is not significant in the reference.
    """
    clear = reference.clear
    low = np.where(clear, reference.amplitude, np.nan)
    ratio = other.amplitude / low
    u = np.hypot(other.noise_floor, ratio * reference.noise_floor) / (math.sqrt(2) * low)
    return 1 - ratio, u
