"""Torque that depends on the shaft's angle, found in whole turns and subtracted from the input.

While the shaft turns, ripple and friction that differ around the turn,

    e(t) = sum over orders n of (a_n + c_n sign(w) + d_n w) cos(n angle), and the same with sin,

cancel in the response to first order. To second order they do not: e also follows the excited angle
and makes sidebands beside each excited line. The loop answers to these, and e turns them back onto
that line. Friction d that grows with the speed w moves the viscous friction of the response
by up to half the square of its relative amplitude (a linear plant that varies periodically: N. M.
Wereley, S. R. Hall, Proc. 29th IEEE CDC, 1990, 3650).

At all lines that are not excited, e is the torque asked less the torque that the fitted plant needs
for the measured angle. Least squares over these lines finds the amplitudes; the residuals give the
weights of noise over frequency.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rigtool.experiments.plant.fit import PlantFit
from rigtool.experiments.plant.frequency_response import Experiment
from rigtool.experiments.plant.multisine import LineNumbers
from rigtool.numerics.arrays import TINY, Array, ComplexArray

ORDERS = 12
"""Highest order of the turn."""

WEIGHTINGS = 3
"""Fits in a row; the first weights the lines as torque turns the shaft there."""

NEIGHBOURS = 17
"""Lines whose residuals are averaged for their weight."""

SPEED_RATIO = 1.25
"""Ratio of the fastest to the slowest speed from which on friction by the sign of the speed differs
from friction that grows with it."""

WHOLE = 0.1
"""Turns that a whole number of turns may be off by the swing of the shaft."""

RELEVANCE_STEPS = 30
"""Steps in which the variance of each term is found."""

WIDEST = 1e10
"""Variance of each term to begin with, in terms of the noise."""


def without_angle_torque(
    experiments: Sequence[Experiment], lines: LineNumbers, fit: PlantFit
) -> list[Experiment]:
    """Return experiments whose input is less the torque that depends on the angle, N m.

    `lines` of a period are excited. Each experiment has the shape of the others and covers whole
    turns of the shaft, and speeds differ; otherwise all are returned as they are. The input is
    right up to the last of the lines.
    """
    speeds = [abs(e.angle[-1, -1] - e.angle[0, 0]) for e in experiments]
    if (
        len({e.input.shape for e in experiments}) > 1
        or not all(map(_whole_turns, experiments))
        or max(speeds) < SPEED_RATIO * min(speeds)
    ):
        return list(experiments)
    periods, samples = experiments[0].input.shape
    line = np.arange(1, periods * int(lines[-1]) + 1)
    frequency = line / (periods * samples * fit.sample_time)
    plant = fit.response(frequency)
    torque = np.stack(
        [_spectrum(e.input, line) - _spectrum(e.output, line) / plant for e in experiments]
    )
    columns = np.stack([_columns(e.angle, line, 2j * np.pi * frequency) for e in experiments])
    quiet = ~np.isin(line, periods * lines)
    weight, amplitudes = np.abs(plant) * quiet, np.zeros(columns.shape[2])
    window = np.ones(min(NEIGHBOURS, len(line)))
    for _ in range(WEIGHTINGS):
        amplitudes = _least_squares(columns * weight[:, None], torque * weight)
        power = np.sum(np.abs(torque - columns @ amplitudes) ** 2, axis=0) * quiet
        near = np.convolve(quiet, window, "same") / np.convolve(power, window, "same")
        weight = np.sqrt(near) * quiet
    return [
        replace(e, input=e.input - _signal(part @ amplitudes, line, e.input.shape))
        for e, part in zip(experiments, columns, strict=True)
    ]


def _whole_turns(experiment: Experiment) -> bool:
    angle = experiment.angle
    turns = (angle[-1, -1] - angle[0, 0]) * angle.size / (angle.size - 1) / (2 * np.pi)
    return bool(abs(turns - round(turns)) < WHOLE and round(turns) != 0)


def _spectrum(signal: Array, line: LineNumbers) -> ComplexArray:
    return np.fft.rfft(signal.ravel())[line]


def _signal(spectrum: ComplexArray, line: LineNumbers, shape: tuple[int, ...]) -> Array:
    """Return the signal of `_spectrum`, of this shape."""
    count = shape[0] * shape[1]
    every = np.zeros(count // 2 + 1, dtype=np.complex128)
    every[line] = spectrum
    return np.fft.irfft(every, count).reshape(shape)


def _columns(angle: Array, line: LineNumbers, s: ComplexArray) -> ComplexArray:
    """Return the spectra (k, 6 ORDERS) of the terms of e at lines (k,)."""
    direction = np.sign(angle[-1, -1] - angle[0, 0])
    columns = []
    for order in range(1, ORDERS + 1):
        for wave in (np.cos(order * angle), np.sin(order * angle)):
            at = _spectrum(wave, line)
            columns += [at, direction * at, s * at]  # w cos(n angle) is a derivative of a sine
    return np.stack(columns, axis=1)


def _least_squares(columns: ComplexArray, values: ComplexArray) -> Array:
    """Return real factors (c,) of columns (e, k, c) for values (e, k) whose noise has power one.

    Cosine and sine of each term have a normal prior of their own variance, which the data find
    (automatic relevance determination: D. J. C. MacKay, Neural Computation 4, 415-447, 1992), so
    that a term which they do not show stays near zero.
    """
    flat = columns.reshape(-1, columns.shape[2])
    normal, right = (flat.conj().T @ flat).real, (flat.conj().T @ values.ravel()).real
    scale = np.sqrt(np.maximum(np.diag(normal), TINY))
    normal, right = normal / np.outer(scale, scale), right / scale
    variance, factors = np.full(len(scale), WIDEST), np.zeros(len(scale))
    for _ in range(RELEVANCE_STEPS):
        inverse = np.linalg.inv(normal + np.diag(0.5 / variance))
        factors = inverse @ right
        square = factors**2 + np.diag(inverse) / 2
        variance = square.reshape(-1, 2, 3).mean(axis=1, keepdims=True).repeat(2, axis=1).ravel()
    return factors / scale
