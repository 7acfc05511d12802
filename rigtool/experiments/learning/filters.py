"""The filters of iterative learning: L, which inverts the loop, and Q, which limits the band.

    f(k+1) = Q (f(k) + p L q(k)),  q(k+1)/q(k) = Q (1 - p L T)      [thesis eq. 9-12, 7.2.4.2]

L is a zero-phase inverse (ZPETC: Tomizuka, ASME J. Dyn. Syst. Meas. Control 109, 65-68, 1987). With
T = Bc Bu/A, where Bc holds the zeros that may be cancelled, Bu the others, s in number, and d the
relative degree of T:

    L(z) = A(z) Bu(1/z) / (Bc(z) Bu(1)^2) = z^phd L'(z),  L' proper,  phd = d + s

so that L T = |Bu|^2/Bu(1)^2: no phase at any frequency, gain one at DC. Both filters act on signals
that are stored, and that are periodic because moves repeat: they are applied in the frequency
domain, exactly, with the phase shift omega*phd*Ts of [26]. A cancelled zero outside the unit circle
does no harm there (its inverse runs backwards in time); it must not be filtered forwards in time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from rigtool.control.position_loop import ComplexArray, TransferFunction
from rigtool.errors import InsufficientDataError
from rigtool.experiments.learning.measured_loop import MeasuredLoop
from rigtool.numerics.arrays import Array

UNIT_CIRCLE_MARGIN = 1e-9
"""A cancelled zero this close to the unit circle would make L infinite at its frequency."""

LESS_LEARNING = (
    "lower ilc_learn.robustness_hz or ilc_learn.learning_factor, or raise ilc_learn.cancel_radius "
    "towards 1"
)
"""Remedy where learning does not converge."""


class Inverse(Protocol):
    """A learning filter L, designed in either way."""

    def response(self, frequency: Array, *, shifted: bool = True) -> ComplexArray:
        """Return L (n,) at these frequencies, Hz; before its advance where not `shifted`."""


@dataclass(frozen=True, eq=False)
class LearningFilter:
    """L(z) = z^advance * filter(z), with a proper `filter`."""

    filter: TransferFunction
    advance: int

    def response(self, frequency: Array, *, shifted: bool = True) -> ComplexArray:
        """Return L (n,) at these frequencies, Hz; without `advance` where not `shifted`."""
        response = self.filter.response(frequency)
        if not shifted:
            return response
        omega = 2 * np.pi * np.asarray(frequency)
        return response * np.exp(1j * omega * self.advance * self.filter.sample_time)


def zpetc(system: TransferFunction, cancel_radius: float) -> LearningFilter:
    """Return the zero-phase inverse of a discrete system.

    Zeros with a modulus below `cancel_radius` are cancelled, the others are not. A radius a little
    below one is the safe rule; a radius a little above one also cancels zeros that belong on the
    unit circle and miss it by rounding.

    Raises `InsufficientDataError` where the system is not proper, or where a zero of either kind
    leaves no inverse: one on the unit circle that is to be cancelled, or one at z = 1 (no gain at
    DC) that is not.
    """
    if system.relative_degree < 0:
        raise InsufficientDataError(
            f"the system has {len(system.num_delta) - 1} zeros and {len(system.den_delta) - 1} "
            "poles, so its output would come before its input: it needs as many poles as zeros"
        )
    zeros = system.zeros()
    modulus = np.abs(zeros)
    cancelled, others = zeros[modulus < cancel_radius], zeros[modulus >= cancel_radius]
    on_circle = np.abs(np.abs(cancelled) - 1) < UNIT_CIRCLE_MARGIN
    if on_circle.any():
        raise InsufficientDataError(
            f"the zero {cancelled[on_circle][0]:.6g} lies on the unit circle, its inverse is "
            f"infinite: lower the cancel radius {cancel_radius} below one"
        )
    # Bu in delta = z - 1: its last coefficient is Bu(1).
    kept = _from_roots(others - 1)
    if abs(kept[-1]) < UNIT_CIRCLE_MARGIN:
        raise InsufficientDataError(
            "the system has a zero at z = 1, hence no gain at DC, and cannot be inverted there: "
            "raise the cancel radius, or use a loop with gain at DC"
        )
    # z^s Bu(1/z) has the roots 1/z; it is the product of (1 - root z).
    mirrored = np.real(np.prod(-others)) * _from_roots(1 / others - 1)
    advance = system.relative_degree + others.size
    num = np.convolve(system.den_delta, mirrored)
    den = system.num_delta[0] * kept[-1] ** 2 * _from_roots(cancelled - 1)
    for _ in range(len(num) - len(den)):
        den = np.convolve(den, [1.0, 1.0])  # z: as many poles as zeros
    # The usual scale: denominator with a leading one.
    proper = TransferFunction(num / den[0], den / den[0], system.sample_time)
    return LearningFilter(proper, advance)


def _from_roots(roots: ComplexArray) -> Array:
    """Return the real polynomial of these roots; complex ones come in pairs."""
    return np.atleast_1d(np.real(np.poly(roots))).astype(np.float64)


def robustness_gain(frequency: Array, *, cutoff_hz: float, order: int, sample_time: float) -> Array:
    """Return the gain (n,) of Q at these frequencies, Hz: a Butterworth run forth and back.

    |B|^2 = 1/(1 + (tan(pi f Ts)/tan(pi fc Ts))^(2 order)), the response of `filtfilt` with a
    digital Butterworth filter: no phase, a half at the cut-off. Raises ValueError unless the
    cut-off is below half the sampling rate.
    """
    if not 0 < cutoff_hz < 0.5 / sample_time:
        raise ValueError(
            f"the cut-off {cutoff_hz} Hz must lie between zero and half the sampling rate, "
            f"{0.5 / sample_time} Hz"
        )
    angle = np.minimum(np.abs(np.asarray(frequency, dtype=np.float64)) * sample_time, 0.5) * np.pi
    ratio = np.tan(angle) / np.tan(np.pi * cutoff_hz * sample_time)
    # Above 1e30 the gain is zero for any purpose, and the power would overflow.
    return 1 / (1 + np.minimum(ratio, 1e30 ** (1 / order)) ** (2 * order))


@dataclass(frozen=True, eq=False)
class Learning:
    """Everything that one learning update needs: the loop T, L, and the settings of Q and p.

    `cutoff_hz` and `order` are of the Butterworth in Q, `factor` is p. `system` is the model of T;
    `measured` is the loop around the measured plant, where there is one.
    """

    system: TransferFunction
    inverse: Inverse
    cutoff_hz: float
    order: int
    factor: float
    measured: MeasuredLoop | None = None

    def loop_response(self, frequency: Array) -> ComplexArray:
        """Return T (n,) at these frequencies, Hz: measured if it was, else the model's."""
        if self.measured is None:
            return self.system.response(frequency)
        return self.measured.complementary_sensitivity(frequency)

    def robustness(self, frequency: Array) -> Array:
        """Return the gain of Q (n,) at these frequencies, Hz."""
        return robustness_gain(
            frequency,
            cutoff_hz=self.cutoff_hz,
            order=self.order,
            sample_time=self.system.sample_time,
        )

    def smoothed(self, cycles: Array, period: float) -> Array:
        """Return Q applied to signals (..., n) of one period, s, each."""
        return self._filtered(cycles, period, self.robustness)

    def updated(self, cycles: Array, period: float, before: Array | float = 0.0) -> Array:
        """Return f(k+1) = Q (f(k) + p L q(k)) for controller torques q (..., n) of one period, s.

        `before` is f(k), zero or of the shape of the cycles. Thesis eq. 9, section 7.2.4.2.
        """
        learned = self._filtered(
            cycles, period, lambda f: self.robustness(f) * self.factor * self.inverse.response(f)
        )
        if np.ndim(before) == 0 and before == 0.0:
            return learned
        return learned + self.smoothed(np.asarray(before, dtype=np.float64), period)

    def _filtered(
        self, cycles: Array, period: float, response: Callable[[Array], NDArray[Any]]
    ) -> Array:
        count = cycles.shape[-1]
        if not period > 0:
            raise InsufficientDataError(
                f"a cycle lasts {period:g} s: the recorded time stands still; record it again"
            )
        frequency = np.fft.rfftfreq(count, period / count)
        spectrum = np.fft.rfft(cycles) * response(frequency)
        return np.fft.irfft(spectrum, count)


@dataclass(frozen=True, eq=False)
class Convergence:
    """|Q (1 - p L T)| (n,) over frequency (n,), Hz; its largest value and where that is.

    `bound` (n,) is its largest value for any plant that the measured response allows; NaN where
    the plant was not measured.
    """

    frequency: Array
    magnitude: Array
    bound: Array

    @property
    def peak(self) -> float:
        """Largest value: the part of a disturbance that one more update leaves, at worst."""
        return float(self.magnitude.max())

    @property
    def peak_frequency(self) -> float:
        """Frequency of the largest value, Hz."""
        return float(self.frequency[np.argmax(self.magnitude)])

    @property
    def bound_peak(self) -> float:
        """Largest value of the bound; NaN where there is none."""
        return float(self.bound.max())

    @property
    def bound_frequency(self) -> float:
        """Frequency of the bound's largest value, Hz."""
        return float(self.frequency[np.argmax(self.bound)])

    def require(self, remedy: str = LESS_LEARNING) -> None:
        """Raise `InsufficientDataError` unless the criterion is below one everywhere (eq. 12).

        The message ends with the `remedy`.
        """
        if not self.peak < 1:
            raise InsufficientDataError(
                f"learning does not converge: |Q (1 - p L T)| is {self.peak:.3g} at "
                f"{self.peak_frequency:.4g} Hz and must be below 1 at all frequencies; {remedy}"
            )
        if self.bound_peak >= 1:
            raise InsufficientDataError(
                f"learning may not converge: over the uncertainty of the measured plant "
                f"|Q (1 - p L T)| reaches {self.bound_peak:.3g} at {self.bound_frequency:.4g} Hz "
                f"(with the plant as found {self.peak:.3g} at most) and must be below 1 at all "
                "frequencies; lower ilc_learn.robustness_hz, or measure the plant better there: "
                "raise identify_plant.periods, or identify_plant.frequency_max"
            )


def convergence(learning: Learning, frequency: Array) -> Convergence:
    """Return the criterion of thesis eq. 12, section 7.2.4.2, at these frequencies (n,), Hz."""
    inverse, robustness = learning.inverse.response(frequency), learning.robustness(frequency)
    left = np.abs(1 - learning.factor * inverse * learning.loop_response(frequency))
    bound = np.full(len(left), np.nan)
    if learning.measured is not None:
        doubt = learning.measured.doubt(frequency)
        # zero where nothing is learned, for any doubt of the plant
        gain, nothing = np.abs(inverse), np.zeros(len(left))
        product = np.multiply(gain, doubt, out=nothing, where=gain > 0)
        bound = robustness * (left + learning.factor * product)
    return Convergence(np.asarray(frequency, dtype=np.float64), robustness * left, bound)
