"""Frequency response of a plant inside a closed loop, from periods of a known excitation.

    P(k) = sum Y conj(R) / sum U conj(R)  over all periods of an experiment

with the spectra of excitation R, input U and output Y at line k. Disturbances reach U and Y around
the loop, but not R: the ratio of the two correlations has no bias, while Y/U, and ratios of spectra
of U and Y, have one (joint input-output method: Pintelon & Schoukens, System Identification, 2nd
edition, Wiley 2012, section 2.6 and chapter 4). Experiments (realisations of the phases,
directions, speeds) weigh the same; their scatter includes noise and nonlinearity, and gives the
variance of the mean.

Frequencies in Hz; input and output in any unit.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from rigtool.errors import InsufficientDataError
from rigtool.experiments.plant.multisine import LineNumbers
from rigtool.numerics.arrays import Array, ComplexArray, Mask

MIN_EXPERIMENTS = 3
"""Smallest number of experiments whose scatter gives an uncertainty."""

RADIUS_COVERAGE = 0.95
"""Probability with which a true value lies in its `radius`."""


@dataclass(frozen=True, eq=False)
class Experiment:
    """Whole periods of one experiment in steady state: excitation, input, output (periods, n).

    `angle` (periods, n) is that of the shaft, rad.
    """

    reference: Array
    input: Array
    output: Array
    angle: Array


@dataclass(frozen=True, eq=False)
class FrequencyResponse:
    """Response at lines (k,), Hz, and its uncertainty.

    `each` (experiments, k) are the responses of single experiments, `coherence` (k,) is the part of
    the power of input and output (the smaller of both) that belongs to the excitation, in one
    period.
    `quantisation` (k,) is the standard uncertainty of the magnitude from the steps of the output.
    """

    frequency: Array
    each: ComplexArray
    coherence: Array
    quantisation: Array

    @property
    def response(self) -> ComplexArray:
        """Mean over the experiments (k,)."""
        return self.each.mean(axis=0)

    @property
    def u(self) -> Array:
        """Standard uncertainty (k,) of real and imaginary part each, or of the magnitude.

        Half of the complex variance of the mean (circular noise), `dof` degrees of freedom.
        """
        count = len(self.each)
        scatter = np.sum(np.abs(self.each - self.response) ** 2, axis=0)
        return np.sqrt(scatter / (2 * count * (count - 1)))

    @property
    def dof(self) -> int:
        """Degrees of freedom of `u`: two for each experiment but one."""
        return 2 * (len(self.each) - 1)

    @property
    def radius(self) -> Array:
        """Radius (k,) of the circle around the response that holds the truth at
        `RADIUS_COVERAGE`."""
        return coverage_radius(self.u, self.dof)

    def lines(self, keep: Mask) -> FrequencyResponse:
        """Return the response at some of the lines only."""
        return FrequencyResponse(
            self.frequency[keep], self.each[:, keep], self.coherence[keep], self.quantisation[keep]
        )


def coverage_radius(u: Array, dof: float) -> Array:
    """Return the radius of the 95 % circle of a complex number, u of each part with `dof`.

    |error|^2/(2 u^2) follows F(2, dof) (Hotelling).
    """
    return u * math.sqrt(2 * float(special.fdtri(2, dof, RADIUS_COVERAGE)))


def frequency_response(
    experiments: Sequence[Experiment], lines: LineNumbers, sample_time: float, step: float = 0.0
) -> FrequencyResponse:
    """Return the response from input to output at `lines` of the period, in periods^-1.

    `step` is the resolution of the output. Raises `InsufficientDataError` for too few experiments,
    or where an experiment is not excited at a line.
    """
    if len(experiments) < MIN_EXPERIMENTS:
        raise InsufficientDataError(
            f"{len(experiments)} experiments have too little scatter for an uncertainty, "
            f"{MIN_EXPERIMENTS} are needed: raise identify_plant.realisations"
        )
    samples = experiments[0].reference.shape[-1]
    each, powers, quantisation = [], [], []
    for experiment in experiments:
        found = _Correlations.of(experiment, lines)
        each.append(found.output / found.input)
        powers.append(found)
        # White noise of step^2/12 in the time domain has n step^2/12 at a line of one period.
        quantisation.append(
            step * np.sqrt(samples / 24 * found.reference_power) / np.abs(found.input)
        )
    return FrequencyResponse(
        lines / (samples * sample_time),
        np.stack(each),
        _coherence(powers),
        np.sqrt(np.mean(np.square(quantisation), axis=0) / len(experiments)),
    )


@dataclass(frozen=True, eq=False)
class _Correlations:
    """Sums over the periods of one experiment, at the lines (k,)."""

    input: ComplexArray
    output: ComplexArray
    reference_power: Array
    input_power: Array
    output_power: Array

    @classmethod
    def of(cls, experiment: Experiment, lines: LineNumbers) -> _Correlations:
        r, u, y = (
            np.fft.rfft(signal)[:, lines]
            for signal in (experiment.reference, experiment.input, experiment.output)
        )
        powers = [np.sum(np.abs(spectrum) ** 2, axis=0) for spectrum in (r, u, y)]
        # In single precision a line that is not excited lies below 1e-6 of the others.
        quiet = powers[0] < 1e-10 * powers[0].max(initial=0)
        if quiet.any() or not powers[0].max(initial=0) > 0:
            raise InsufficientDataError(
                f"line {lines[int(np.argmax(quiet))]} of the period is not excited: analyse with "
                "the settings of [identify_plant] that were recorded with"
            )
        return cls(np.sum(u * r.conj(), axis=0), np.sum(y * r.conj(), axis=0), *powers)


def _coherence(powers: Sequence[_Correlations]) -> Array:
    """Return |S_xr|^2/(S_xx S_rr), the mean over the experiments, for the smaller of u and y."""
    of_each = [
        [
            np.abs(p.input) ** 2 / (p.input_power * p.reference_power),
            np.abs(p.output) ** 2 / (p.output_power * p.reference_power),
        ]
        for p in powers
    ]
    return np.mean(of_each, axis=0).min(axis=0)
