"""The position loop around the motor as discrete transfer functions [7.2.4.1, 7.2.4.2].

    C(s) = k (s + wi)/s (s/wz + 1)/(s/wp + 1) / (s2/wl2 + 2 zl s/wl + 1),  by Tustin
    P(s) = 1 / (J s2),  by zero-order hold: P(z) = Ts2/(2 J) (z + 1)/(z - 1)2
    T = C P/(1 + C P),  S = 1/(1 + C P),  Sp = P/(1 + C P)

The error of sample k makes the torque that is held from k to k + 1; there is no other delay.
Angles in rad, torques in N m, frequencies in Hz.

Sampled fast, all poles lie close to z = 1, where polynomials in z lose most of their digits.
Polynomials are therefore in delta = z - 1, highest power first (Middleton & Goodwin, IEEE Trans.
Autom. Control 31(11), 1015-1021, 1986).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypedDict, Unpack

import numpy as np
from numpy.typing import ArrayLike

from rigtool.errors import RecipeError
from rigtool.numerics.arrays import Array, ComplexArray


@dataclass(frozen=True, eq=False)
class TransferFunction:
    """A discrete transfer function, its polynomials in delta = z - 1, and its sample time, s.

    Raises ValueError for polynomials that are zero or not finite.
    """

    num_delta: Array
    den_delta: Array
    sample_time: float

    def __post_init__(self) -> None:
        for name in ("num_delta", "den_delta"):
            trimmed = np.trim_zeros(np.asarray(getattr(self, name), dtype=np.float64), "f")
            if not (trimmed.size and np.isfinite(trimmed).all()):
                raise ValueError("a transfer function needs finite polynomials other than zero")
            object.__setattr__(self, name, trimmed)
        if not self.sample_time > 0:
            raise ValueError(f"sample time must be positive, got {self.sample_time}")

    @classmethod
    def from_z(cls, num: ArrayLike, den: ArrayLike, sample_time: float) -> TransferFunction:
        """Take polynomials in z (m,) and (n,), highest power first."""
        return cls(_shift(num, 1.0), _shift(den, 1.0), sample_time)

    @property
    def num(self) -> Array:
        """Numerator in z, highest power first."""
        return _shift(self.num_delta, -1.0)

    @property
    def den(self) -> Array:
        """Denominator in z, highest power first."""
        return _shift(self.den_delta, -1.0)

    @property
    def relative_degree(self) -> int:
        """Samples from an input to the first response of the output; negative where not proper."""
        return len(self.den_delta) - len(self.num_delta)

    def zeros(self) -> ComplexArray:
        """Roots of the numerator, in z."""
        return np.roots(self.num_delta).astype(np.complex128) + 1

    def poles(self) -> ComplexArray:
        """Roots of the denominator, in z."""
        return np.roots(self.den_delta).astype(np.complex128) + 1

    def response(self, frequency: Array) -> ComplexArray:
        """Return the complex response (n,) at these frequencies, Hz."""
        half = np.pi * np.asarray(frequency, dtype=np.float64) * self.sample_time
        delta = 2j * np.sin(half) * np.exp(1j * half)  # exp(2j half) - 1 without cancellation
        num, den = np.polyval(self.num_delta, delta), np.polyval(self.den_delta, delta)
        return np.asarray(num / den, dtype=np.complex128)


def _shift(coefficients: ArrayLike, by: float) -> Array:
    """Return the coefficients of p(x + by) for those of p(x), highest power first."""
    shifted = np.zeros(1)
    for coefficient in np.asarray(coefficients, dtype=np.float64):
        shifted = np.convolve(shifted, [1.0, by])
        shifted[-1] += coefficient
    return shifted[1:]


@dataclass(frozen=True)
class _Section:
    """A factor of the controller: polynomials in delta."""

    num: Array
    den: Array

    def in_z(self) -> Array:
        """Return a second-order section (6,) as scipy has them."""
        order = len(self.den) - 1
        padding = np.zeros(2 - order)
        row = np.concatenate([_shift(self.num, -1.0), padding, _shift(self.den, -1.0), padding])
        return row / row[3]


class LoopDesign(TypedDict):
    """Settings of the controller, frequencies in Hz; inertia, kg m2; sample time, s."""

    crossover_hz: float
    lead_ratio: float
    integrator_hz: float
    lowpass_hz: float
    lowpass_damping: float
    inertia: float
    sample_time: float


def controller_sections(**design: Unpack[LoopDesign]) -> Array:
    """Return the position controller C(z) as second-order sections (n, 6), N m/rad.

    Rows are [b0 b1 b2 1 a1 a2] as in scipy; the gain is in the first. The open loop has gain one
    at the crossover with the discrete plant of this inertia, kg m2. `integrator_hz` 0 leaves the
    integrator out. Raises `RecipeError` where a frequency is not below half the sampling rate.
    """
    sections = _controller_factors(**design)
    return np.stack([section.in_z() for section in sections])


def _controller_factors(
    *,
    crossover_hz: float,
    lead_ratio: float,
    integrator_hz: float,
    lowpass_hz: float,
    lowpass_damping: float,
    inertia: float,
    sample_time: float,
) -> list[_Section]:
    for name, value in (("crossover_hz", crossover_hz), ("lowpass_hz", lowpass_hz)):
        if not 0 < value < 0.5 / sample_time:
            raise RecipeError(
                f"{name} {value} Hz must lie between zero and half the sampling rate, "
                f"{0.5 / sample_time:.6g} Hz: lower it in [rig.controller], or sample faster"
            )
    crossover = 2 * math.pi * crossover_hz
    integrator = 2 * math.pi * integrator_hz
    lowpass = 2 * math.pi * lowpass_hz
    zero, pole = crossover / lead_ratio, crossover * lead_ratio
    # Coefficients of s2, s, 1 (or s, 1)
    if integrator:
        # (s + wi)/s (s/wz + 1)/(s/wp + 1), multiplied out
        lead = ([1 / zero, 1 + integrator / zero, integrator], [1 / pole, 1.0, 0.0])
    else:
        lead = ([1 / zero, 1.0], [1 / pole, 1.0])
    smooth = ([0.0, 0.0, 1.0], [lowpass**-2, 2 * lowpass_damping / lowpass, 1.0])
    first, second = _tustin(*lead, sample_time), _tustin(*smooth, sample_time)
    at_crossover = np.array([crossover_hz])
    gain = double_integrator(inertia, sample_time).response(at_crossover)[0]
    for section in (first, second):
        gain *= TransferFunction(section.num, section.den, sample_time).response(at_crossover)[0]
    return [_Section(first.num / abs(gain), first.den), second]


def _tustin(num: list[float], den: list[float], sample_time: float) -> _Section:
    """Turn a section in s into one in delta by s = 2/Ts delta/(delta + 2)."""
    s = 2 / sample_time
    # Rows: each power of s over the common denominator (delta + 2)^order
    if len(den) == 3:
        basis = np.array([[s * s, 0.0, 0.0], [s, 2 * s, 0.0], [1.0, 4.0, 4.0]])
    else:
        basis = np.array([[s, 0.0], [1.0, 2.0]])
    return _Section(np.asarray(num) @ basis, np.asarray(den) @ basis)


def double_integrator(inertia: float, sample_time: float) -> TransferFunction:
    """Return P(z) of torque to angle for P(s) = 1/(J s2), exact for a held torque."""
    gain = sample_time**2 / (2 * inertia)
    num, den = np.array([gain, 2 * gain]), np.array([1.0, 0.0, 0.0])
    return TransferFunction(num, den, sample_time)


@dataclass(frozen=True, eq=False)
class Loop:
    """The closed loop of a controller and a plant, of the same sample time.

    Equations (1) and (7) of the thesis, section 7.2.4.
    """

    controller: TransferFunction
    plant: TransferFunction

    @property
    def _characteristic(self) -> tuple[Array, Array, Array]:
        forward = np.convolve(self.controller.num_delta, self.plant.num_delta)
        back = np.convolve(self.controller.den_delta, self.plant.den_delta)
        closed: Array = np.polyadd(forward, back).astype(np.float64)
        return forward, back, closed

    @property
    def complementary_sensitivity(self) -> TransferFunction:
        """T = C P/(1 + C P): from feed-forward torque to minus the controller's torque."""
        forward, _, closed = self._characteristic
        return TransferFunction(forward, closed, self.plant.sample_time)

    @property
    def sensitivity(self) -> TransferFunction:
        """S = 1/(1 + C P): from set point to error."""
        _, back, closed = self._characteristic
        return TransferFunction(back, closed, self.plant.sample_time)

    @property
    def process_sensitivity(self) -> TransferFunction:
        """Sp = P/(1 + C P): from feed-forward torque to minus the error."""
        _, _, closed = self._characteristic
        num = np.convolve(self.plant.num_delta, self.controller.den_delta)
        return TransferFunction(num, closed, self.plant.sample_time)

    @property
    def stable(self) -> bool:
        """Whether all poles of the closed loop lie inside the unit circle."""
        return bool(np.abs(self.sensitivity.poles()).max() < 1)


def position_loop(**design: Unpack[LoopDesign]) -> Loop:
    """Return the loop of `controller_sections` with the double integrator of this inertia."""
    first, second = _controller_factors(**design)
    controller = TransferFunction(
        np.convolve(first.num, second.num),
        np.convolve(first.den, second.den),
        design["sample_time"],
    )
    return Loop(controller, double_integrator(design["inertia"], design["sample_time"]))


def stable_one_sample_late(**design: Unpack[LoopDesign]) -> bool:
    """Return whether this loop is stable with another sample of delay in it.

    Such a loop is one that a host closes over a line: each sample reaches the host one period late.
    """
    loop = position_loop(**design)
    late = np.convolve(loop.plant.den_delta, [1.0, 1.0])
    plant = TransferFunction(loop.plant.num_delta, late, loop.plant.sample_time)
    return Loop(loop.controller, plant).stable


class RunningController:
    """C(z), one sample after the other: transposed direct form II, from rest.

    `sections` (n, 6) are those of `controller_sections`.
    """

    def __init__(self, sections: Array) -> None:
        self._sections = sections.tolist()
        self._state = [[0.0, 0.0] for _ in self._sections]

    def torque(self, error: float) -> float:
        """Return the torque, N m, for the error of position of the next sample, rad."""
        value = error
        for (b0, b1, b2, _, a1, a2), state in zip(self._sections, self._state, strict=True):
            out = b0 * value + state[0]
            state[0] = b1 * value - a1 * out + state[1]
            state[1] = b2 * value - a2 * out
            value = out
        return value


def largest_deviation(**design: Unpack[LoopDesign]) -> float:
    """Return how far a torque that comes at once pushes the shaft at most, rad/(N m).

    The shaft is one without friction, the loop that of `position_loop`.
    """
    controller = RunningController(controller_sections(**design))
    inertia, period = design["inertia"], design["sample_time"]
    position = speed = largest = 0.0
    for _ in range(math.ceil(1.0 / (design["crossover_hz"] * period))):
        acceleration = (1.0 + controller.torque(-position)) / inertia
        position += speed * period + acceleration * period**2 / 2
        speed += acceleration * period
        largest = max(largest, position)
    return largest
