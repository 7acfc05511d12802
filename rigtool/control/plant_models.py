"""Models of the plant from torque to angle, exact for a torque held over each sample.

    rigid:     P(s) = 1/(J s2 + fv s)
    two_mass:  J1 th1'' = u - fv th1' - k (th1 - th2) - c (th1' - th2'),  y = th1
               J2 th2'' = k (th1 - th2) + c (th1' - th2'),  J1 + J2 = J

Below its resonance a two-mass plant moves as the whole inertia J, above it as J1 alone [Fig. 76].
J in kg m2, fv in N m s/rad, frequencies in Hz.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from rigtool.control.position_loop import TransferFunction, double_integrator
from rigtool.numerics.arrays import Array, ComplexArray

SPECTRUM_IMAGES = 8
"""Images of the spectrum on either side that are summed; the rest is below 1e-7."""


@dataclass(frozen=True)
class PlantModel:
    """A plant by its parameters; rigid where `motor_side` is None.

    `motor_side` is J1/J, below one; `antiresonance_hz` and `damping` (a ratio) are those of the
    second mass with the motor held.
    """

    inertia: float
    viscous: float = 0.0
    motor_side: float | None = None
    antiresonance_hz: float = 0.0
    damping: float = 0.0

    @property
    def rigid(self) -> bool:
        """Whether the plant is one mass."""
        return self.motor_side is None

    @property
    def mass_line_crossing(self) -> float:
        """Frequency, Hz, where the line 1/(J w2) is one rad/(N m): 0 dB [Fig. 35]."""
        return 1 / (2 * math.pi * math.sqrt(self.inertia))

    @property
    def resonance_hz(self) -> float:
        """Frequency, Hz, of the resonance of the two masses; `ValueError` for a rigid plant."""
        if self.motor_side is None:
            raise ValueError("a rigid plant has no resonance")
        return self.antiresonance_hz / math.sqrt(self.motor_side)

    def held(self, sample_time: float) -> TransferFunction:
        """Return P(z) for a torque held over each sample; `sample_time` in s."""
        a, b, c = self._state_space()
        return zero_order_hold(a, b, c, sample_time)

    def transfer(self, s: ComplexArray) -> ComplexArray:
        """Return P(s) of the continuous plant at complex frequencies (n,), rad/s."""
        if self.motor_side is None:
            return 1 / (s * (self.inertia * s + self.viscous))
        first = self.inertia * self.motor_side
        free = first * s**2 + self.viscous * s
        return np.asarray(1 / (free + self.carried(s)), dtype=np.complex128)

    def carried(self, s: ComplexArray) -> ComplexArray:
        """Return the torque on the second mass for each angle of the first, at `s` (n,), rad/s.

        Raises `ValueError` for a rigid plant.
        """
        if self.motor_side is None:
            raise ValueError("a rigid plant carries no second mass")
        second = self.inertia * (1 - self.motor_side)
        omega = 2 * math.pi * self.antiresonance_hz
        link = second * (2 * self.damping * omega * s + omega**2)
        return np.asarray(second * s**2 * link / (second * s**2 + link), dtype=np.complex128)

    def response(self, frequency: Array, sample_time: float) -> ComplexArray:
        """Return the response (n,) of `held` at frequencies above zero, Hz, without its algebra."""
        return HeldResponses(frequency, sample_time).of(self)

    def _state_space(self) -> tuple[Array, Array, Array]:
        if self.motor_side is None:
            a = np.array([[0.0, 1.0], [0.0, -self.viscous / self.inertia]])
            return a, np.array([0.0, 1 / self.inertia]), np.array([1.0, 0.0])
        first = self.inertia * self.motor_side
        ratio = (1 - self.motor_side) / self.motor_side  # J2/J1
        omega = 2 * math.pi * self.antiresonance_hz
        k, c = omega**2, 2 * self.damping * omega  # each over J2
        a = np.array(
            [
                [0.0, 1.0, 0.0, 0.0],
                [-ratio * k, -ratio * c - self.viscous / first, ratio * k, ratio * c],
                [0.0, 0.0, 0.0, 1.0],
                [k, c, -k, -c],
            ]
        )
        return a, np.array([0.0, 1 / first, 0.0, 0.0]), np.array([1.0, 0.0, 0.0, 0.0])


class HeldResponses:
    """Responses of held plants at the same frequencies (n,), above zero, Hz; `sample_time` in s.

    Sampling sums the images P(s + 2 pi i k/Ts) of the held plant. At high frequencies P is the
    double integrator of J1, whose sum is known; only the difference, which decays fast, is summed.
    What no plant changes is computed once.
    """

    def __init__(self, frequency: Array, sample_time: float) -> None:
        s = 2j * np.pi * np.asarray(frequency, dtype=np.float64)
        numbers = np.arange(-SPECTRUM_IMAGES, SPECTRUM_IMAGES + 1)[:, None]
        self._images = s + 2j * np.pi / sample_time * numbers
        self._held = -np.expm1(-s * sample_time) / (self._images * sample_time)
        whole = double_integrator(1.0, sample_time).response(frequency)
        self._beyond = whole - np.sum(self._held / self._images**2, axis=0)

    def of(self, plant: PlantModel) -> ComplexArray:
        """Return the response (n,) of a plant, as `PlantModel.held` has it."""
        motor = plant.inertia * (1.0 if plant.motor_side is None else plant.motor_side)
        near = np.einsum("kn,kn->n", self._held, plant.transfer(self._images))
        return np.asarray(near + self._beyond / motor, dtype=np.complex128)


def zero_order_hold(a: Array, b: Array, c: Array, sample_time: float) -> TransferFunction:
    """Return P(z) of x' = a x + b u, y = c x for an input that is held over each sample.

    a is (n, n), b and c are (n,).

    In delta = z - 1: x+ - x = (a F) x + (F b) u, where F is the integral of exp(a t) over a sample.
    This form keeps full precision where all poles lie close to z = 1.
    """
    from scipy import linalg

    order = len(b)
    block = np.zeros((2 * order, 2 * order))
    block[:order, :order], block[:order, order:] = a, np.eye(order)
    integral = linalg.expm(block * sample_time)[:order, order:]
    step, gain = a @ integral, integral @ b
    den = np.atleast_1d(np.poly(step)).real
    # Zeros: where [step - delta, gain; c, 0] loses rank; one fewer than poles.
    pencil = np.block([[step, gain[:, None] / np.abs(gain).max()], [c[None, :], np.zeros((1, 1))]])
    identity = np.zeros_like(pencil)
    identity[:order, :order] = np.eye(order)
    found = linalg.eigvals(pencil, identity)
    zeros = found[np.isfinite(found)]
    zeros = zeros[np.argsort(np.abs(zeros))][: order - 1]
    num = float(c @ gain) * np.atleast_1d(np.poly(zeros)).real
    return TransferFunction(num, den, sample_time)
