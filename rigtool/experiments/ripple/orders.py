"""Torque ripple against the rotor's angle: orders of rotation and the repeatable part [7.1.3].

Whole revolutions are averaged on a grid of angles (synchronous average): their mean is the
repeatable part, their scatter the rest. The repeatable part is a Fourier series in the angle,

    ripple(angle) = sum over orders k of amplitude_k cos(k angle + phase_k),

each order with a noise floor from the scatter of its coefficient between revolutions. Orders, not
hertz: an order is a number of cycles a turn, at any speed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np

from rigtool.errors import NO_RESULT_REMEDY, InsufficientDataError
from rigtool.numerics.arrays import Array, ComplexArray, Mask
from rigtool.numerics.jackknife import standard_uncertainty

WAVEFORM_CELLS = 500
"""Cells of a turn in waveforms, about."""

HIGHEST_ORDER = 100
"""Of rotation, in spectra: cogging of 12 slots and 14 poles has order 84."""

ORDERS_REPORTED = 10
"""Number of orders among the results: the strongest of the significant ones."""

SIGNIFICANT_RATIO = 2.0
"""Multiple of the noise floor above which an order is significant."""

NEIGHBOURING_ORDERS = 10
"""Orders on either side from which the noise of an order of a single turn is taken."""

MIN_SAMPLES_A_PERIOD = 2.5
"""Samples in a period of the highest resolved order: two do not resolve an amplitude."""

SHIFT_TIE = 0.01
"""Relative difference from the largest correlation within which shifts fit equally well."""


def cell_centres(positions: int) -> Array:
    """Return the centres of equal cells of a turn (positions,), rad."""
    return (np.arange(float(positions)) + 0.5) * (2 * np.pi / positions)


def cells_for(encoder_counts: int) -> int:
    """Return the number of cells, nearest to `WAVEFORM_CELLS`, in which no multiple of the
    encoder's counts is an alias of an order of the spectrum: the loop answers to its steps.

    Multiples of c in n cells are aliases of multiples of their greatest common divisor.
    """
    numbers = range(1, 8 * WAVEFORM_CELLS)
    apart = [n for n in numbers if math.gcd(n, encoder_counts) > HIGHEST_ORDER]
    return min(apart, key=lambda n: abs(n - WAVEFORM_CELLS), default=WAVEFORM_CELLS)


@dataclass(frozen=True)
class Rms:
    """Rms of the repeatable and of the other part, each with its standard uncertainty.

    `non_repeatable_u` is None for two revolutions, which do not resolve it.
    """

    repeatable: float
    repeatable_u: float
    non_repeatable: float
    non_repeatable_u: float | None
    dof: int


@dataclass(frozen=True)
class Sampling:
    """Samples `step` of a turn apart, each the mean of `averaged` equally spaced ones.

    Straight lines between samples and means of several attenuate high orders. Order k, which
    passes x = k step cycles from one sample to the next, keeps

        sinc(x)^2  sin(pi x) / (n sin(pi x / n)),   sinc(x) = sin(pi x) / (pi x)

    of its amplitude, for means of n (R. N. Bracewell, The Fourier Transform and Its Applications,
    3rd ed., 2000, ch. 10). Where the speed varies, samples lie up to `fastest` times as far apart.
    """

    step: float
    averaged: int = 1
    fastest: float = 1.0

    @property
    def highest_order(self) -> float:
        """Highest order that the samples resolve; a higher one is an alias of a lower one."""
        return math.inf if self.step == 0 else 1 / (MIN_SAMPLES_A_PERIOD * self.step * self.fastest)

    def gain(self, order: Array) -> Array:
        """Return the remaining part of the amplitude of orders (m,) up to the highest."""
        cycles = order * self.step
        return np.sinc(cycles) ** 2 * np.sinc(cycles) / np.sinc(cycles / self.averaged)


@dataclass(frozen=True, eq=False)
class Ripple:
    """Ripple of one running condition: `waveforms` (revolutions, positions), offset removed.

    `sampling` is that of the samples in the waveforms.
    """

    waveforms: Array
    sampling: Sampling

    @property
    def angle(self) -> Array:
        """Centres of the cells (positions,), rad."""
        return cell_centres(self.waveforms.shape[1])

    @property
    def mean(self) -> Array:
        """Repeatable part (positions,)."""
        return self.waveforms.mean(axis=0)

    def rms(self) -> Rms:
        """Return the rms of the repeatable part and of the rest.

        The mean of n revolutions still holds an n-th of the scatter's power, which is subtracted;
        where nothing remains the repeatable part is zero. Raises `InsufficientDataError` for fewer
        than 2 revolutions.
        """
        if len(self.waveforms) < 2:
            raise InsufficientDataError(
                f"{len(self.waveforms)} revolution shows no scatter: at least 2 are needed to "
                "separate the repeatable part"
            )
        count, mean = len(self.waveforms), self.mean
        others = count - 1
        deviation = self.waveforms - mean
        # The jackknife over revolutions from means over positions, in one pass.
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


@dataclass(frozen=True, eq=False)
class LoopRipple(Ripple):
    """Ripple that the position loop shows: `durations` (revolutions, positions) are how long the
    rotor takes for each cell, s; `steps` (m,) the amplitudes, N m, that the loop answers the
    encoder's steps with at orders 1..m, `distorted` (m,) the standard uncertainty, N m, by an
    amplifier that is not linear; `friction_change` is the standard change of friction, N m, with
    the relative change of the speed.
    """

    durations: Array
    steps: Array
    friction_change: float
    distorted: Array


def remove_offset(waveforms: Array, sampling: Sampling) -> Ripple:
    """Subtract the mean of waveforms (revolutions, positions): friction and load, not ripple."""
    return Ripple(waveforms - waveforms.mean(), sampling)


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Orders 1..m of a ripple: amplitude and phase (m,), rad, of amplitude*cos(k angle + phase).

    `noise_floor` (m,) is the rms amplitude that scatter alone gives the mean of the revolutions;
    the standard uncertainty of an amplitude is the floor over the square root of two. Where nothing
    was repeated it is that of the orders around. All are NaN at orders that the samples do not
    resolve.
    """

    order: Array
    amplitude: Array
    phase: Array
    noise_floor: Array

    @property
    def clear(self) -> Mask:
        """Whether each order is significant (m,)."""
        return self.amplitude > SIGNIFICANT_RATIO * self.noise_floor

    @property
    def u(self) -> Array:
        """Standard uncertainty of each amplitude (m,) by scatter."""
        return self.noise_floor / math.sqrt(2)

    def only(self, chosen: Mask) -> Spectrum:
        """Return the orders that are `chosen` (m,)."""
        return Spectrum(*(getattr(self, field.name)[chosen] for field in fields(self)))

    def rms(self) -> tuple[float, float]:
        """Return the rms of all orders and its standard uncertainty."""
        rms = float(np.linalg.norm(self.amplitude)) / math.sqrt(2)
        # d rms = sum of amplitude * d amplitude / (2 rms), u of an amplitude = floor/sqrt(2)
        weighted = float(np.linalg.norm(self.amplitude * self.u))
        return rms, weighted / (2 * rms) if rms > 0 else 0.0

    def ranked(self, strength: Array | None = None) -> list[int]:
        """Return `ORDERS_REPORTED` orders of most amplitude, or `strength` (m,), that is not 0."""
        power = self.amplitude if strength is None else strength
        order = np.argsort(-power, kind="stable")[:ORDERS_REPORTED]
        return [int(self.order[i]) for i in order if power[i] > 0]

    def strongest(self) -> int:
        """Return the strongest significant order; `InsufficientDataError` where there is none."""
        clear = np.flatnonzero(self.clear)  # never where an amplitude is NaN
        if not clear.size:
            if not (self.amplitude > 0).any():
                raise InsufficientDataError(f"no order has an amplitude: {NO_RESULT_REMEDY}")
            best = int(np.nanargmax(self.amplitude / self.noise_floor))
            ratio = self.amplitude[best] / self.noise_floor[best]
            raise InsufficientDataError(
                f"no order exceeds its noise floor by a factor of {SIGNIFICANT_RATIO:g}, order "
                f"{self.order[best]:g} comes nearest, at {ratio:.3g} times its own: average more "
                "revolutions"
            )
        return int(self.order[clear[np.argmax(self.amplitude[clear])]])


def spectrum(ripple: Ripple, orders: int) -> Spectrum:
    """Return the orders 1..`orders` of a ripple; at most half the number of positions.

    Raises `InsufficientDataError` where the samples do not resolve the first order.
    """
    return scattered(coefficients(ripple.waveforms, orders, ripple.sampling), ripple.sampling)


def scattered(found: ComplexArray, sampling: Sampling) -> Spectrum:
    """Return orders 1..m as the mean of those of single revolutions (revolutions, m), with a noise
    floor by their scatter.

    Raises `InsufficientDataError` where the samples do not resolve the first order.
    """
    if sampling.highest_order < 1:
        raise InsufficientDataError(
            f"{1 / sampling.step:.3g} samples a turn are too few, {MIN_SAMPLES_A_PERIOD:g} "
            "are needed for the first order: turn more slowly, or sample faster"
        )
    revolutions, orders = found.shape
    order = np.arange(1.0, orders + 1)
    mean = found.mean(axis=0)
    if revolutions > 1:
        scatter = np.sum(np.abs(found - mean) ** 2, axis=0) / (revolutions - 1)
        floor = np.sqrt(scatter / revolutions)
    else:
        floor = neighbours_floor(np.abs(mean))
    resolved = np.where(order <= sampling.highest_order, 1.0, np.nan)
    return Spectrum(order, resolved * np.abs(mean), resolved * np.angle(mean), resolved * floor)


def neighbours_floor(amplitude: Array) -> Array:
    """Return the noise floor of orders 1, 2, ... (m,) from the amplitudes around each.

    Their median is sqrt(ln 2) of the rms where they are noise (Rayleigh distribution). Zero where
    there is one order alone.
    """
    orders = len(amplitude)
    floor = np.zeros(orders)
    for index in range(orders if orders > 1 else 0):
        around = np.r_[
            max(0, index - NEIGHBOURING_ORDERS) : index, index + 1 : index + 1 + NEIGHBOURING_ORDERS
        ]
        floor[index] = np.median(amplitude[around[around < orders]]) / math.sqrt(math.log(2))
    return floor


def coefficients(waveforms: Array, orders: int, sampling: Sampling, width: int = 1) -> ComplexArray:
    """Return amplitude*exp(i phase) of each order 1..`orders` and revolution.

    `waveforms` (revolutions, positions) are means over equal cells of the turn, or over as many
    stretches of `width` cells from the beginning of each one on; returned are the
    coefficients of amplitude*cos(k angle + phase), (revolutions, orders), zero at orders that the
    samples do not resolve. Raises `ValueError` for orders that the positions do not resolve.
    """
    positions = waveforms.shape[1]
    if not 1 <= orders < positions / 2:
        raise ValueError(f"{positions} positions carry orders 1 to {(positions - 1) // 2}")
    order = np.arange(1.0, orders + 1)
    # A cell's value is a mean over its width, which attenuates high orders.
    part = order * width / positions
    correction = 2 / positions / np.sinc(part) * np.exp(-1j * np.pi * part)
    resolved = order <= sampling.highest_order
    correction[resolved] /= sampling.gain(order[resolved])
    correction[~resolved] = 0.0
    return np.fft.rfft(waveforms)[:, 1 : orders + 1] * correction


@dataclass(frozen=True, eq=False)
class Match:
    """A ripple or map against a reference one.

    `correlation` at equal angles and `best_correlation` after turning by `shift` rad, between -pi
    and pi; of shifts that fit equally well, as with a second order alone, the smallest. `scale` is
    the least-squares factor of the turned reference, `shift_u` the standard uncertainty of the
    shift.
    """

    correlation: float
    shift: float
    shift_u: float
    best_correlation: float
    scale: float


@dataclass(frozen=True, eq=False)
class RippleComparison(Match):
    """A match with the standard uncertainty of its correlation, and the `dof` of both of its u."""

    correlation_u: float
    dof: int


def compare(reference: Ripple, other: Ripple, orders: int) -> RippleComparison:
    """Compare the orders 1..`orders` of two ripples: other(angle) ~ scale*reference(angle - shift).

    Circular correlation of the repeatable parts, at the orders that are significant in one of
    them. Uncertainties by the jackknife over revolutions, the i-th of both left out together.
    Raises `InsufficientDataError` where one of them has no significant order.
    """
    clear = np.zeros(orders, dtype=np.bool_)
    for what, ripple in (("reference", reference), ("other", other)):
        above = spectrum(ripple, orders).clear
        if not above.any():
            raise InsufficientDataError(
                f"the {what} ripple is all noise: none of its orders 1 to {orders} exceeds it by "
                f"a factor of {SIGNIFICANT_RATIO:g}; average more revolutions"
            )
        clear |= above
    count = min(len(reference.waveforms), len(other.waveforms))
    # Orders that are not significant are set to zero.
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
    # Differences from the best shift, so that a whole turn counts as zero.
    turned = np.array([math.remainder(found - shift, 2 * math.pi) for found in without[:, 1]])
    correlation_u, shift_u = standard_uncertainty(without[:, 0]), standard_uncertainty(turned)
    return RippleComparison(correlation, shift, shift_u, best, scale, correlation_u, count - 1)


def match_orders(a: ComplexArray, b: ComplexArray) -> tuple[float, float, float, float]:
    """Return correlation, shift, best correlation and scale of b against a, orders 1..m (m,).

    As in `Match`.
    """
    power_a, power_b = (float(np.sum(np.abs(c) ** 2)) for c in (a, b))
    # Correlation over the shift; eight points in a period of the highest order suffice to find
    # the summit, a parabola through three of them to place it.
    size = 8 * 2 ** math.ceil(math.log2(len(a) + 1))
    cross = np.zeros(size // 2 + 1, dtype=np.complex128)
    cross[1 : len(a) + 1] = np.conj(a) * b
    turned = np.fft.irfft(cross, size) * size / 2
    highest = np.flatnonzero(turned >= turned.max() - SHIFT_TIE * abs(turned.max()))
    nearest = highest[np.argmin(np.minimum(highest, size - highest))]
    peak = summit(turned, int(nearest))
    left, top, right = turned[peak - 1], turned[peak], turned[(peak + 1) % size]
    bend = left - 2 * top + right
    part = 0.5 * (left - right) / bend if bend < 0 else 0.0
    best = float(top - 0.25 * (left - right) * part)
    shift = math.remainder((peak + part) * 2 * math.pi / size, 2 * math.pi)
    norm = math.sqrt(power_a * power_b)
    return float(turned[0]) / norm, shift, best / norm, best / power_a


def summit(values: Array, start: int, *, periodic: bool = True) -> int:
    """Return the index of the maximum of values (n,) uphill from `start`; `periodic`: a circle."""
    size = len(values)
    while True:
        around = [
            (start + step) % size if periodic else min(max(start + step, 0), size - 1)
            for step in (0, -1, 1)
        ]
        best = max(around, key=lambda i: values[i])
        if best == start:
            return start
        start = best
