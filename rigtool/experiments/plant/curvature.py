"""Change of the slope of friction over the swing of the shaft's speed.

The viscous friction of the response is the mean slope of friction over the speeds v + s(t) through
which the excitation swings. Where friction bends there, as in the Stribeck effect, its torque has a
part

    e(t) = a s(t)^2,

at sums and differences of the excited lines (even-order distortion: Pintelon & Schoukens, System
Identification, 2nd edition, Wiley 2012, section 3.4), and the slope at v + s is higher by 2 a s.
s is the answer of the shaft to the excitation, almost free of noise; e is in the torque asked less
the torque that the fitted plant needs for the measured angle. Phases are random, so that neither
what the fit leaves at an excited line nor noise correlates with s^2: both are scatter between
experiments.

Friction that grows with the torque T that a second mass asks for does not grow in proportion where
T swings about the friction of the tip: it has a part b T(t)^2 at the same lines, as both squares
rise where the excitation is large. Where a second mass was fitted, a and b are found together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from rigtool.experiments.plant.fit import PlantFit
from rigtool.experiments.plant.frequency_response import Experiment
from rigtool.experiments.plant.multisine import LineNumbers, periodic
from rigtool.numerics.arrays import TINY, Array

SHOWN = 0.05
"""Probability, by scatter alone, of a rise of the slope that counts."""

NEIGHBOURS = 17
"""Lines whose power is averaged for their weight."""


@dataclass(frozen=True)
class SlopeRise:
    """By how much friction's slope rises over one rms of the swing, N m s/rad, and its scatter.

    `u` is the standard uncertainty of the mean of `count` experiments.
    """

    value: float
    u: float
    count: int

    @property
    def shown(self) -> float:
        """The rise where friction bends upwards beyond scatter, else 0."""
        above = float(special.stdtr(self.count - 1, -self.value / max(self.u, TINY)))
        return self.value if above < SHOWN else 0.0


def slope_rise(
    experiments: Sequence[Experiment], speeds: Sequence[Array], lines: LineNumbers, fit: PlantFit
) -> SlopeRise:
    """Return the rise of friction's slope; `lines` of a period are excited.

    `speeds` (periods, n) are the `excited_speed` of each experiment.
    """
    samples = experiments[0].reference.shape[-1]
    line = np.arange(1, int(lines[-1]) + 1)
    plant = fit.response(line / (samples * fit.sample_time))
    torques, squares, sizes = [], [], []
    for experiment, speed in zip(experiments, speeds, strict=True):
        asked, answer = (
            np.fft.rfft(signal)[:, line] for signal in (experiment.input, experiment.output)
        )
        torques.append(asked - answer / plant)
        swings = _excited(speed, lines, fit)
        direction = np.sign(experiment.angle[0, -1] - experiment.angle[0, 0])
        squares.append(direction * np.fft.rfft(swings**2)[..., line])
        sizes.append(float(swings[0].std()))
    torque, bends = np.stack(torques), np.stack(squares)
    window = np.ones(min(NEIGHBOURS, len(line)))
    power = np.convolve(np.mean(np.abs(torque) ** 2, axis=(0, 1)), window, "same")
    weight = np.convolve(np.ones(len(line)), window, "same") / np.maximum(power, TINY)
    right = np.einsum("ecpk,epk,k->ec", bends.conj(), torque, weight).real
    normal = np.einsum("ecpk,edpk,k->ecd", bends.conj(), bends, weight).real
    a = np.linalg.solve(normal, right[..., None])[:, 0, 0]
    rises, count = 2 * a * np.array(sizes), len(experiments)
    u = float(rises.std(ddof=1)) / count**0.5
    return SlopeRise(float(rises.mean()), u, count)


def _excited(speed: Array, lines: LineNumbers, fit: PlantFit) -> Array:
    """Return what the excitation swings, squares of which are friction's: the speed, rad/s, and
    behind a spring the torque on the second mass over its peak (1 or 2, periods, n)."""
    if fit.model.rigid:
        return speed[None]
    samples = speed.shape[-1]
    s = np.asarray(2j * np.pi * lines / (samples * fit.sample_time), dtype=np.complex128)
    carried = np.fft.rfft(speed)[:, lines] / (samples / 2) / s * fit.model.carried(s)
    torque = periodic(lines, carried, samples)
    return np.stack([speed, torque / np.abs(torque).max()])


def excited_speed(experiment: Experiment, lines: LineNumbers, sample_time: float) -> Array:
    """Return the excited speed (periods, n), rad/s."""
    samples = experiment.reference.shape[-1]
    reference, output = (
        np.fft.rfft(signal)[:, lines] for signal in (experiment.reference, experiment.output)
    )
    answer = reference * np.sum(output * reference.conj(), axis=0)
    answer /= np.sum(np.abs(reference) ** 2, axis=0)
    omega = 2 * np.pi * lines / (samples * sample_time)
    return periodic(lines, 1j * omega * answer / (samples / 2), samples)
