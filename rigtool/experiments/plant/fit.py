"""Inertia and viscous friction from a measured frequency response, by weighted least squares.

    P(f) = model(J, fv, ...) exp(-j w tau - c w2 + j d w3)

`model` is exact for a torque held over a sample; tau, c and d model the dynamics above the band
that are not the plant (the amplifier's current loop, the timing of the hold): below their corner,
the logarithm of any such dynamics begins with these three terms. Without the third, what is left
of the phase at high lines would be fitted by friction, which turns the phase at low lines.
Residuals are logarithms of measured over modelled response, magnitude and phase together, weighted
by their scatter (logarithmic least squares: Pintelon & Schoukens, System Identification, 2nd
edition, Wiley 2012, section 9.8).

A second mass is fitted only where the rigid plant deviates by more than is usual, and accepted
only where it is better by an F test and has its resonance within the band. Where the test
does not decide, the plant is rigid, and what a second mass would change is an uncertainty of its
own. Behind a tendon there is a second mass: one that does not show is possible, however well one
inertia explains the response. Scatter is the larger of two: that of the experiments by the
jackknife (a linear step instead of a new fit), which includes errors common to all lines but rests
on few experiments; and that of the lines, propagated by least squares and raised by their deviation
from the model, which rests on many.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import optimize, special

from rigtool.control.plant_models import HeldResponses, PlantModel
from rigtool.errors import InsufficientDataError
from rigtool.experiments.plant.frequency_response import FrequencyResponse
from rigtool.numerics.arrays import TINY, Array, ComplexArray, Mask
from rigtool.numerics.jackknife import standard_uncertainty

MIN_COHERENCE = 0.8
"""Smallest part of a line's power in one period that belongs to the excitation."""

MIN_LINES = 8
"""Smallest number of lines in a fit of up to seven parameters; each line has two values."""

POOLED_LINES = 5
"""Number of neighbouring lines whose relative scatter is pooled for the weights; a line with more
keeps its own."""

SECOND_MASS_SIGNIFICANCE = 1e-4
"""Probability that the test rejects the rigid plant wrongly."""

DOUBT = 0.05
"""The same probability, below which a second mass that was not accepted counts as possible."""

LITTLE_LEFT = 0.5
"""Probability of the residuals of the rigid plant above which a second mass has nothing to
explain."""

SERIES = 0.08
"""Largest c w2, with which a lag of first order differs from its series by c2 w4 = 0.6 %."""

BY_STEPS = 0.5
"""Part of the scatter of a line that the encoder's steps make, above which they hide it."""

LAST_STEPS, DIFFERENCE = 2, 1e-4
"""Steps of Gauss and Newton after the search for the rigid plant, and half of the differences, in
scaled parameters, of their derivatives: the search ends by rounding, each version of it elsewhere,
by up to 4e-5 u."""

LONGEST_STEP = 0.01
"""Length of such a step, in scaled parameters, beyond which the lines do not determine them, and
the search has the last word."""

UNKNOWN = 1.0
"""Change of ln J by scatter from which the response does not show an inertia."""

MAX_EVALUATIONS = 500
"""Largest number of evaluations in one fit; without a second mass it does not converge."""


@dataclass(frozen=True, eq=False)
class PlantFit:
    """A model with `delay` tau, s, `roll_off` c, s2, and `phase_bend` d, s3.

    `used` (k,) marks the lines of the fit, `misfit` is the root of chi2 over its degrees of
    freedom: one where model and scatter explain all. `without` are the fits without each
    experiment in turn, `moved` those one standard deviation off along each principal axis of the
    least-squares covariance, `possible` is the one with a second mass where a rigid plant is
    uncertain.
    """

    model: PlantModel
    delay: float
    roll_off: float
    phase_bend: float
    sample_time: float
    used: Mask
    misfit: float
    rigid_rejected: float
    without: tuple[PlantFit, ...] = ()
    moved: tuple[PlantFit, ...] = ()
    possible: PlantFit | None = None

    def response(self, frequency: Array) -> ComplexArray:
        """Return P (n,) at these frequencies, Hz, with delay and roll-off."""
        return self.model.response(frequency, self.sample_time) * np.exp(self.lag(frequency))

    def lag(self, frequency: Array) -> ComplexArray:
        """Return the logarithm (n,) of delay, roll-off and bend at these frequencies, Hz."""
        omega = 2 * np.pi * np.asarray(frequency, dtype=np.float64)
        turned = omega * (self.phase_bend * omega**2 - self.delay)
        return np.asarray(1j * turned - self.roll_off * omega**2, dtype=np.complex128)

    def scatter(self, statistic: Callable[[PlantFit], float]) -> float:
        """Return the standard uncertainty of a statistic of the fit by scatter."""
        scatter = standard_uncertainty(np.array([statistic(fit) for fit in self.without]))
        here = statistic(self)
        return max(scatter, math.hypot(*(statistic(fit) - here for fit in self.moved)))

    def doubt(self, statistic: Callable[[PlantFit], float]) -> float:
        """Return the standard uncertainty of a statistic by a second mass that is possible."""
        return abs(statistic(self.possible) - statistic(self)) if self.possible else 0.0


def fit_plant(
    found: FrequencyResponse, sample_time: float, nominal_inertia: float, *, tendon: bool = False
) -> PlantFit:
    """Fit the simplest model that the response supports, from `nominal_inertia`, kg m2.

    With a `tendon` a second mass is known to be there, and is possible wherever it is not seen.
    Lines at which dynamics above the band, such as a slow current loop, have rolled off by more
    than their series holds (`SERIES`) are left out. Raises `InsufficientDataError` where too few
    lines are coherent with the excitation, or left.
    """
    used = found.coherence >= MIN_COHERENCE
    if used.sum() < max(MIN_LINES, len(used) / 2):
        raise InsufficientDataError(_incoherent(found, used))
    while True:
        fit = _of_lines(found, used, sample_time, nominal_inertia, tendon)
        highest = math.sqrt(SERIES / max(fit.roll_off, TINY)) / (2 * math.pi)
        within = used & (found.frequency <= highest)
        if not fit.model.rigid or (within == used).all():
            return fit
        if within.sum() < MIN_LINES:
            raise InsufficientDataError(
                f"what moves the shaft has rolled off by {-math.expm1(-SERIES):.0%} at "
                f"{highest:.3g} Hz already, with {within.sum()} lines below, {MIN_LINES} are "
                "needed: the amplifier's current loop is slow; make it faster, or lower "
                "identify_plant.frequency_max"
            )
        used = within


def _incoherent(found: FrequencyResponse, used: Mask) -> str:
    """Return why lines do not show the excitation, and what helps.

    Coherence is that in one period, whatever their number.
    """
    text = (
        f"only {used.sum()} of {len(used)} lines have a coherence of at least {MIN_COHERENCE} "
        f"(lowest {found.coherence.min():.2g} at "
        f"{found.frequency[np.argmin(found.coherence)]:.4g} Hz), half of them and at least "
        f"{MIN_LINES} are needed: the excitation is lost in "
    )
    share = float(np.median(np.square(found.quantisation / np.maximum(found.u, TINY))[~used]))
    more = "raise identify_plant.speeds (stroke_speeds with the instrument) or swing, take"
    if share < BY_STEPS:
        return (
            f"{text}disturbances; {more} a stiffer [rig.controller], which keeps the shaft moving, "
            "or correct [rig.inertia], by which the excitation is scaled"
        )
    text += f"the steps of the encoder; {more} an encoder with more counts"
    if used.sum() < MIN_LINES:
        return text
    return f"{text}, or lower identify_plant.frequency_max to {found.frequency[used].max():.4g} Hz"


def _of_lines(
    found: FrequencyResponse,
    used: Mask,
    sample_time: float,
    nominal_inertia: float,
    tendon: bool,
) -> PlantFit:
    """Return the simplest model that these lines support."""
    data = _Data(found.lines(used), sample_time)
    nominal = PlantModel(nominal_inertia, 0.0)
    start = PlantFit(nominal, 0.0, 0.0, 0.0, sample_time, used, 1.0, 1.0)
    rigid = data.fitted(start)
    two = _second_mass(data, rigid, tendon)
    rigid = data.settled(rigid)
    if two is None:
        return data.with_scatter(rigid)
    doubt = two.rigid_rejected
    if doubt < SECOND_MASS_SIGNIFICANCE:
        return data.with_scatter(two)
    return replace(data.with_scatter(rigid), rigid_rejected=doubt, possible=two)


def _second_mass(data: _Data, rigid: PlantFit, known: bool) -> PlantFit | None:
    """Return the fit with a second mass where the data ask for it or leave a doubt, else None.

    Where it is `known` to be there, the data always leave one, if it fits best within the band.
    """
    if data.explained(rigid) > LITTLE_LEFT and not known:
        return None
    low, high = data.found.frequency[[0, -1]]
    candidates = []
    for antiresonance in np.geomspace(2 * low, high / 2, 6):
        model = PlantModel(rigid.model.inertia, rigid.model.viscous, 0.9, antiresonance, 0.3)
        candidates.append(data.fitted(replace(rigid, model=model, misfit=1.0)))
    best = min(candidates, key=lambda fit: fit.misfit)
    free, more = data.freedom(rigid), data.freedom(best)
    left, rest = rigid.misfit**2 * free, best.misfit**2 * more
    ratio = ((left - rest) / (free - more)) / (rest / more)
    better = float(special.fdtrc(free - more, more, ratio))
    inside = low < best.model.antiresonance_hz and best.model.resonance_hz < high
    return (
        replace(best, rigid_rejected=better)
        if better < (1.0 if known else DOUBT) and inside
        else None
    )


class _Data:
    """A measured response with the weights of its lines."""

    def __init__(self, found: FrequencyResponse, sample_time: float) -> None:
        self.found = found
        self._held = HeldResponses(found.frequency, sample_time)
        relative = np.square(found.u / np.abs(found.response))
        window = np.ones(min(POOLED_LINES, len(relative)))
        count = np.convolve(np.ones(len(relative)), window, "same")
        pooled = np.convolve(relative, window, "same") / count
        # Ripple that falls on a line is its own: pooled, the line would look like a second mass
        self._weight = 1 / np.sqrt(np.maximum(pooled, relative))

    def freedom(self, fit: PlantFit) -> int:
        """Return the degrees of freedom of the residuals."""
        return 2 * len(self.found.frequency) - len(_parameters(fit))

    def explained(self, fit: PlantFit) -> float:
        """Return the probability of deviations this large if the model is right."""
        noise = self.found.dof * len(self.found.frequency)
        return float(special.fdtrc(self.freedom(fit), noise, fit.misfit**2))

    def residuals(self, fit: PlantFit, response: ComplexArray) -> Array:
        """Return weighted residuals (2 k,): logarithm of magnitude, then phase."""
        ratio = np.log(response / self._held.of(fit.model) / np.exp(fit.lag(self.found.frequency)))
        return np.concatenate([ratio.real * self._weight, ratio.imag * self._weight])

    def fitted(self, start: PlantFit) -> PlantFit:
        """Return the least-squares fit of the model, rigid or with two masses, of `start`."""
        measured = self.found.response
        scale = _scale(start)
        origin = _parameters(start)

        def residuals(steps: Array) -> Array:
            return self.residuals(_with(start, origin + scale * steps), measured)

        solution = optimize.least_squares(
            residuals, np.zeros(len(origin)), method="lm", max_nfev=MAX_EVALUATIONS
        )
        found = _with(start, origin + scale * solution.x)
        misfit = math.sqrt(2 * solution.cost / self.freedom(found))
        return _with(found, _parameters(found), misfit=misfit)

    def settled(self, fit: PlantFit) -> PlantFit:
        """Return a fit at the least sum of squares near the one that a search found."""
        for _ in range(LAST_STEPS):
            scale, origin = _scale(fit), _parameters(fit)
            sides = (
                [
                    self.residuals(_with(fit, origin + move), self.found.response)
                    for move in np.diag(side * DIFFERENCE * scale)
                ]
                for side in (1, -1)
            )
            ahead, behind = map(np.array, sides)
            jacobian = (ahead - behind).T / (2 * DIFFERENCE)
            here = self.residuals(fit, self.found.response)
            step = np.linalg.pinv(jacobian) @ here
            if np.abs(step).max() > LONGEST_STEP:
                break
            fit = _with(fit, origin - scale * step)
        here = self.residuals(fit, self.found.response)
        return replace(fit, misfit=math.sqrt(here @ here / self.freedom(fit)))

    def with_scatter(self, fit: PlantFit) -> PlantFit:
        """Return the fit with `without` and `moved`, from which its uncertainty follows.

        Raises `InsufficientDataError` where either changes ln J by more than `UNKNOWN`.
        """
        scale, origin = _scale(fit), _parameters(fit)
        here = self.residuals(fit, self.found.response)
        step = 1e-4
        jacobian = np.stack(
            [
                (self.residuals(_with(fit, origin + move), self.found.response) - here) / step
                for move in np.diag(scale * step)
            ],
            axis=1,
        )
        inverse = np.linalg.pinv(jacobian)
        each = self.found.each
        rests = (np.delete(each, number, axis=0).mean(axis=0) for number in range(len(each)))
        without = [inverse @ (here - self.residuals(fit, rest)) for rest in rests]
        # Residuals scatter by one: the shift of the parameters has these principal axes.
        axes, sizes, _ = np.linalg.svd(inverse, full_matrices=False)
        moved = list((axes * sizes * max(1.0, fit.misfit)).T)
        if (unknown := float(np.abs([step[0] for step in without + moved]).max())) > UNKNOWN:
            raise InsufficientDataError(_inertia_unknown(fit, self.found.frequency[-1], unknown))
        one, other = (
            tuple(_with(fit, origin + scale * step) for step in steps) for steps in (without, moved)
        )
        return replace(fit, without=one, moved=other)


def _inertia_unknown(fit: PlantFit, highest: float, unknown: float) -> str:
    """Return why the response does not show an inertia, and what helps."""
    corner = fit.model.viscous / fit.model.inertia / (2 * math.pi)
    return (
        f"the inertia is unknown: scatter changes its logarithm by {unknown:.2g} ({UNKNOWN:g} at "
        f"most); viscous friction outweighs it up to some {corner:.3g} Hz, and lines end at "
        f"{highest:.3g} Hz; raise identify_plant.frequency_max, or swing or periods against scatter"
    )


# Parameters as a vector: ln J, fv, tau, c, d; for two masses also ln(J1/J2), ln of the
# antiresonance and the damping ratio.


def _parameters(fit: PlantFit) -> Array:
    model = fit.model
    vector = [math.log(model.inertia), model.viscous, fit.delay, fit.roll_off, fit.phase_bend]
    if model.motor_side is not None:
        part = model.motor_side
        vector += [math.log(part / (1 - part)), math.log(model.antiresonance_hz), model.damping]
    return np.array(vector)


def _scale(fit: PlantFit) -> Array:
    """Return steps of the parameters that change the response about equally."""
    inertia, sample = fit.model.inertia, fit.sample_time
    scale = [1.0, inertia * 100.0, sample, sample**2, sample**3, 1.0, 1.0, 1.0]
    return np.array(scale[: len(_parameters(fit))])


def _with(fit: PlantFit, vector: Array, **changes: Any) -> PlantFit:
    """Return a fit with the parameters of a vector."""
    inertia, viscous = math.exp(vector[0]), float(vector[1])
    if len(vector) > 5:
        # A second mass that the data do not show runs away: bound it.
        part = 1 / (1 + math.exp(-min(max(float(vector[5]), -5.0), 5.0)))
        highest = math.log(0.2 / fit.sample_time)
        antiresonance = math.exp(min(max(float(vector[6]), -2.0), highest))
        model = PlantModel(inertia, viscous, part, antiresonance, float(vector[7]))
    else:
        model = PlantModel(inertia, viscous)
    delay, roll_off, phase_bend = map(float, vector[2:5])
    return replace(
        fit, model=model, delay=delay, roll_off=roll_off, phase_bend=phase_bend, **changes
    )
