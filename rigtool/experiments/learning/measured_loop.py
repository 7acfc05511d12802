"""The loop around a measured plant, and how well it is known at any frequency.

    P(f) = model(f) r(f),  r known at the measured lines and interpolated between them
    T = T0 r/(1 + T0 (r - 1)),  S = S0/(1 + T0 (r - 1)),  T0 and S0 those of the model

r is interpolated in logarithm of magnitude and in phase, over the logarithm of frequency; beyond
the first and the last line it keeps its value of that line. The plant is known to lie within a
circle, |P'/P - 1| <= d. Below the first line d stays as it is there, between lines it is
interpolated; above the last line unmodelled dynamics grow, d as the square of frequency from the
last line's circle and distance to the model together. Over the circle

    |T' - T| <= |T S| d/(1 - |T| d),

and a loop with |T| d >= 1 may be unstable.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rigtool.control.position_loop import Loop
from rigtool.experiments.plant.multisine import ComplexArray
from rigtool.numerics.arrays import Array


@dataclass(frozen=True, eq=False)
class MeasuredLoop:
    """A loop with its model, and the plant's response (k,) at rising frequencies (k,), Hz.

    `radius` (k,) is that of the circle that holds the plant's true response, relative to it.
    """

    loop: Loop
    frequency: Array
    response: ComplexArray
    radius: Array

    @property
    def _ratio(self) -> ComplexArray:
        return self.response / self.loop.plant.response(self.frequency)

    def ratio(self, frequency: Array) -> ComplexArray:
        """Return plant over model (n,) at these frequencies, Hz."""
        at, known = self._places(frequency)
        found = self._ratio
        magnitude = np.interp(at, known, np.log(np.abs(found)))
        phase = np.interp(at, known, np.unwrap(np.angle(found)))
        return np.exp(magnitude + 1j * phase)

    def relative_radius(self, frequency: Array) -> Array:
        """Return d (n,): how far the plant may be from `ratio` times the model, relative."""
        at, known = self._places(frequency)
        beyond = self.radius[-1] + np.abs(self._ratio[-1] - 1)
        square = np.square(np.asarray(frequency) / self.frequency[-1])
        inside = np.interp(at, known, self.radius)
        return np.where(at > known[-1], beyond * square, inside)

    def complementary_sensitivity(self, frequency: Array) -> ComplexArray:
        """Return T (n,) at these frequencies, Hz."""
        model = self.loop.complementary_sensitivity.response(frequency)
        ratio = self.ratio(frequency)
        return np.asarray(model * ratio / (1 + model * (ratio - 1)), dtype=np.complex128)

    def doubt(self, frequency: Array) -> Array:
        """Return the largest |T' - T| (n,) over the circles; infinite where it has no bound."""
        model = self.loop.complementary_sensitivity.response(frequency)
        ratio, radius = self.ratio(frequency), self.relative_radius(frequency)
        turned = 1 + model * (ratio - 1)
        t = model * ratio / turned
        s = self.loop.sensitivity.response(frequency) / turned
        room = 1 - np.abs(t) * radius
        bounded = room > 0
        doubt = np.full(len(ratio), np.inf)
        doubt[bounded] = (np.abs(t * s) * radius)[bounded] / room[bounded]
        return doubt

    def _places(self, frequency: Array) -> tuple[Array, Array]:
        at = np.log(np.maximum(frequency, self.frequency[0]))  # below it, all is as there
        return at, np.log(self.frequency)


@dataclass(frozen=True, eq=False)
class InverseResponse:
    """L = W/T from the measured response: the second choice beside ZPETC.

    W is one up to the last measured line, zero an octave above, and falls smoothly between (half a
    cosine over the logarithm of frequency): unmeasured frequencies are not learned. There is no
    phase to advance: the filter acts off-line.
    """

    measured: MeasuredLoop

    @property
    def last_line(self) -> float:
        """Frequency up to which all is learned, Hz."""
        return float(self.measured.frequency[-1])

    def response(self, frequency: Array, *, shifted: bool = True) -> ComplexArray:
        """Return L (n,) at these frequencies, Hz."""
        octaves = np.log2(np.clip(np.asarray(frequency) / self.last_line, 1, 2))
        window = 0.5 + 0.5 * np.cos(np.pi * octaves)
        inverse = np.zeros(len(window), dtype=np.complex128)
        kept = window > 0
        t = self.measured.complementary_sensitivity(np.asarray(frequency)[kept])
        inverse[kept] = window[kept] / t
        return inverse
