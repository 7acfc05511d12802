"""Torque ripple against the rotor's angle: orders of rotation, and what repeats [7.1.3].

Whole revolutions are laid over each other on a grid of angles (synchronous average): what they
share is repeatable, their scatter is not. The repeatable part is a Fourier series in the angle,

    ripple(angle) = sum over orders k of amplitude_k cos(k angle + phase_k),

each order with a noise floor from the scatter of its coefficient between revolutions. Orders, not
hertz: an order is a number of cycles a turn, at any speed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rigtool.errors import InsufficientDataError
from rigtool.experiments.ripple.revolutions import Revolutions
from rigtool.numerics.checks import require_signals
from rigtool.numerics.jackknife import standard_uncertainty
from rigtool.numerics.welch import PowerSpectrum, Welch

Array = NDArray[np.float64]

CLEAR = 2.0
"""An order is told from noise when its amplitude is this many times the noise floor."""

SAMPLES_A_PERIOD = 2.5
"""Samples in a period of the highest order that is told: two tell no amplitude."""

EQUALLY_GOOD = 0.01
"""Shifts whose correlation is this close to the largest one, relative, fit equally well."""


def lay_over(time: Array, turns: Array, torque: Array, revolutions: int, positions: int) -> Array:
    """Return torque (n,) of a steadily turning rotor by revolution and position, same unit.

    `turns` is the rotor's angle in turns, in either direction. The turn is cut at whole numbers
    into `positions` equal cells; a cell's value is the mean over the time that the rotor spends in
    it. Of (revolutions, positions) the second axis are the cells in the order of their angle. The
    last `revolutions` whole turns are taken; raises `InsufficientDataError` where there are fewer.
    """
    time, turns, torque = require_signals(4, time=time, turns=turns, torque=torque)
    collected = Revolutions(positions, forward=bool(turns[-1] > turns[0]))
    collected.add(time, turns, torque)
    return collected.waveforms(revolutions)


@dataclass(frozen=True)
class Rms:
    """Rms of the repeatable and of the other part, each with its standard uncertainty.

    `non_repeatable_u` is None where two revolutions alone cannot tell.
    """

    repeatable: float
    repeatable_u: float
    non_repeatable: float
    non_repeatable_u: float | None
    dof: int


@dataclass(frozen=True)
class Sampling:
    """Samples `step` of a turn apart, each the mean of `averaged` equally spaced ones.

    Straight lines between samples and means of several make high orders smaller. Order k, the
    cycles x = k step from one sample to the next, is left with

        sinc(x)^2  sin(pi x) / (n sin(pi x / n)),   sinc(x) = sin(pi x) / (pi x)

    of its amplitude, for means of n (R. N. Bracewell, The Fourier Transform and Its Applications,
    3rd ed., 2000, ch. 10).
    """

    step: float
    averaged: int = 1

    @property
    def highest_order(self) -> float:
        """The highest order that the samples tell; above, it takes the place of a lower one."""
        return math.inf if self.step == 0 else 1 / (SAMPLES_A_PERIOD * self.step)

    def gain(self, order: Array) -> Array:
        """Return what is left of the amplitude of orders (m,) up to the highest."""
        cycles = order * self.step
        left: Array = np.sinc(cycles) ** 2 * np.sinc(cycles) / np.sinc(cycles / self.averaged)
        return left


EVERYWHERE = Sampling(0.0)
"""Of waveforms that were not made of samples: nothing is lost."""


@dataclass(frozen=True, eq=False)
class Ripple:
    """Ripple of one running condition: `waveforms` (revolutions, positions), offset removed.

    `sampling` tells what samples the waveforms were made of. Raises `InsufficientDataError` for
    fewer than 2 revolutions.
    """

    waveforms: Array
    sampling: Sampling = EVERYWHERE

    def __post_init__(self) -> None:
        if self.waveforms.ndim != 2 or len(self.waveforms) < 2:
            raise InsufficientDataError(
                f"{len(np.atleast_2d(self.waveforms))} revolution shows no scatter: at least 2 "
                "are needed to tell what repeats"
            )

    @property
    def angle(self) -> Array:
        """Centres of the cells (positions,), rad."""
        count = self.waveforms.shape[1]
        return (np.arange(float(count)) + 0.5) * (2 * np.pi / count)

    @property
    def mean(self) -> Array:
        """Repeatable part (positions,)."""
        mean: Array = self.waveforms.mean(axis=0)
        return mean

    def rms(self) -> Rms:
        """Return the rms of what repeats and of what does not.

        The scatter that the mean of n revolutions still holds, one n-th of its power, is taken
        off; where nothing is left the repeatable part is zero.
        """
        count, mean = len(self.waveforms), self.mean
        others = count - 1
        deviation = self.waveforms - mean
        # All from these means over the positions, so that leaving out each takes one pass.
        power = np.mean(mean**2)
        powers = np.einsum("ij,ij->i", deviation, deviation) / mean.size
        without = power - 2 * (deviation @ mean) / mean.size / others + powers / others**2
        if count > 2:
            left = powers.sum() - powers * count / others
            without = without - left / (others - 1) / others
        repeatable = math.sqrt(max(0.0, float(power - powers.sum() / others / count)))
        repeatable_u = standard_uncertainty(np.sqrt(np.maximum(without, 0.0)))
        scatters = powers * count / others
        scatter = math.sqrt(float(scatters.mean()))
        # Two revolutions lie at equal distances from their mean: no scatter of the scatter.
        spread = float(scatters.std(ddof=1)) / math.sqrt(count)
        scatter_u = spread / (2 * scatter) if count > 2 and scatter > 0 else None
        return Rms(repeatable, repeatable_u, scatter, scatter_u, others)


def remove_offset(waveforms: Array, sampling: Sampling = EVERYWHERE) -> Ripple:
    """Take the mean off waveforms (revolutions, positions): friction and load, not ripple."""
    return Ripple(waveforms - waveforms.mean(), sampling)


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Orders 1..m of a ripple: amplitude and phase (m,), rad, of amplitude*cos(k angle + phase).

    `noise_floor` (m,) is the rms amplitude that scatter alone gives the mean of the revolutions;
    an amplitude's standard uncertainty is that over the square root of two. All are NaN at orders
    that the samples do not tell.
    """

    order: Array
    amplitude: Array
    phase: Array
    noise_floor: Array

    @property
    def clear(self) -> NDArray[np.bool_]:
        """Which orders are told from noise (m,)."""
        clear: NDArray[np.bool_] = self.amplitude > CLEAR * self.noise_floor
        return clear

    def strongest(self) -> int:
        """Return the strongest order; `InsufficientDataError` where it does not clear the noise."""
        index = int(np.nanargmax(self.amplitude))
        amplitude, floor = self.amplitude[index], self.noise_floor[index]
        if amplitude < CLEAR * floor:
            raise InsufficientDataError(
                f"the strongest order has an amplitude of {amplitude:.3g}, its noise floor is "
                f"{floor:.3g}: no order stands out by a factor of {CLEAR:g}; average more "
                "revolutions"
            )
        return int(self.order[index])


def spectrum(ripple: Ripple, orders: int) -> Spectrum:
    """Return the orders 1..`orders` of a ripple; at most half the number of positions.

    Raises `InsufficientDataError` where the samples do not even tell the first order.
    """
    order = np.arange(1.0, orders + 1)
    if ripple.sampling.highest_order < 1:
        raise InsufficientDataError(
            f"{1 / ripple.sampling.step:.3g} samples a turn are too few, {SAMPLES_A_PERIOD:g} are "
            "needed for the first order: turn more slowly, or sample faster"
        )
    found = coefficients(ripple.waveforms, orders, ripple.sampling)
    revolutions = len(found)
    mean = found.mean(axis=0)
    scatter = np.sum(np.abs(found - mean) ** 2, axis=0) / (revolutions - 1)
    floor = np.sqrt(scatter / revolutions)
    told = np.where(order <= ripple.sampling.highest_order, 1.0, np.nan)
    return Spectrum(order, told * np.abs(mean), told * np.angle(mean), told * floor)


def coefficients(
    waveforms: Array, orders: int, sampling: Sampling = EVERYWHERE
) -> NDArray[np.complex128]:
    """Return amplitude*exp(i phase) of each order 1..`orders` and revolution.

    `waveforms` (revolutions, positions) are means over equal cells of the turn; what comes back is
    (revolutions, orders), of amplitude*cos(k angle + phase), zero at orders that the samples do
    not tell. Raises `ValueError` for orders that the positions do not tell.
    """
    positions = waveforms.shape[1]
    if not 1 <= orders < positions / 2:
        raise ValueError(f"{positions} positions carry orders 1 to {(positions - 1) // 2}")
    order = np.arange(1.0, orders + 1)
    # A cell's value is a mean over its width, which makes high orders smaller.
    correction = (
        2 / positions / np.sinc(order / positions) * np.exp(-1j * order * np.pi / positions)
    )
    told = order <= sampling.highest_order
    correction[told] /= sampling.gain(order[told])
    correction[~told] = 0.0
    found: NDArray[np.complex128] = np.fft.rfft(waveforms, axis=1)[:, 1 : orders + 1] * correction
    return found


@dataclass(frozen=True, eq=False)
class Comparison:
    """A ripple against a reference one.

    `correlation` of both as they are and `best_correlation` after turning by `shift` rad, between
    -pi and pi; of shifts that fit equally well, as with a second order alone, the smallest. `scale`
    is the least-squares factor of the turned reference. `correlation_u` and `shift_u` are standard
    uncertainties with `dof` degrees of freedom.
    """

    correlation: float
    correlation_u: float
    shift: float
    shift_u: float
    best_correlation: float
    scale: float
    dof: int


def compare(reference: Ripple, other: Ripple, orders: int) -> Comparison:
    """Compare the orders 1..`orders` of two ripples: other(angle) ~ scale*reference(angle - shift).

    Circular correlation of the repeatable parts, of the orders that clear the noise floor in one
    of them. Uncertainties by the jackknife over revolutions, the i-th of both left out together.
    Raises `InsufficientDataError` where no order of one of them clears the noise.
    """
    clear = np.zeros(orders, dtype=np.bool_)
    for what, ripple in (("reference", reference), ("other", other)):
        above = spectrum(ripple, orders).clear
        if not above.any():
            raise InsufficientDataError(
                f"the {what} ripple is all noise: none of its orders 1 to {orders} stands out by "
                f"a factor of {CLEAR:g}; average more revolutions"
            )
        clear |= above
    count = min(len(reference.waveforms), len(other.waveforms))
    # Orders that do not stand out are left at zero.
    a, b = (
        coefficients(ripple.waveforms, orders, ripple.sampling)[:count] * clear
        for ripple in (reference, other)
    )

    sums = a.sum(axis=0), b.sum(axis=0)
    correlation, shift, best, scale = match_orders(sums[0] / count, sums[1] / count)
    without = np.array(
        [
            match_orders((sums[0] - one) / (count - 1), (sums[1] - another) / (count - 1))
            for one, another in zip(a, b, strict=True)
        ]
    )
    # Near the best shift, so that a jump by a whole turn is none.
    turned = np.array([math.remainder(found - shift, 2 * math.pi) for found in without[:, 1]])
    correlation_u, shift_u = standard_uncertainty(without[:, 0]), standard_uncertainty(turned)
    return Comparison(correlation, correlation_u, shift, shift_u, best, scale, count - 1)


def match_orders(
    a: NDArray[np.complex128], b: NDArray[np.complex128]
) -> tuple[float, float, float, float]:
    """Return correlation, shift, best correlation and scale of b against a, orders 1..m (m,).

    They mean what they do in `Comparison`.
    """
    power_a, power_b = (float(np.sum(np.abs(c) ** 2)) for c in (a, b))
    # Correlation over the shift; eight points in a period of the highest order suffice to find
    # the summit, a parabola through three of them to place it.
    size = 8 * 2 ** math.ceil(math.log2(len(a) + 1))
    cross = np.zeros(size // 2 + 1, dtype=np.complex128)
    cross[1 : len(a) + 1] = np.conj(a) * b
    turned = np.fft.irfft(cross, size) * size / 2
    highest = np.flatnonzero(turned >= turned.max() - EQUALLY_GOOD * abs(turned.max()))
    nearest = highest[np.argmin(np.minimum(highest, size - highest))]
    peak = _summit(turned, int(nearest))
    left, top, right = turned[peak - 1], turned[peak], turned[(peak + 1) % size]
    bend = left - 2 * top + right
    part = 0.5 * (left - right) / bend if bend < 0 else 0.0
    best = float(top - 0.25 * (left - right) * part)
    shift = math.remainder((peak + part) * 2 * math.pi / size, 2 * math.pi)
    norm = math.sqrt(power_a * power_b)
    return float(turned[0]) / norm, shift, best / norm, best / power_a


def _summit(values: Array, start: int) -> int:
    """Return the index of the local maximum uphill from `start` on a circle."""
    size = len(values)
    while True:
        around = [(start + step) % size for step in (0, -1, 1)]
        best = max(around, key=lambda i: values[i])
        if best == start:
            return start
        start = best


def power_spectrum(signal: Array, sample_time: float, segment: int) -> PowerSpectrum:
    """Return the PSD of a signal (n,) by Welch's method, mean removed.

    Segments of `segment` samples with a Hann window, half overlapping.
    """
    (signal,) = require_signals(segment, signal=signal)
    collected = Welch(segment)
    collected.add(signal)
    return collected.spectrum(sample_time)
