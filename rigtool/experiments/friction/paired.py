"""What changed between two runs of one motion, point by point: a payload, a lubricant, a bearing.

    t2 - t1 = dJ a + dfv v + dfc sign(v) + doffset + dgc cos(q) + dgs sin(q) + (F2 - F1) p1

t1 and t2 are the efforts at the same point of the motion, F1 and F2 the regressors of each run and
p1 the parameters of the first one: what both runs share (ripple, other joints, friction that is no
straight line) cancels, and the last term corrects for motions that are not exactly alike. The runs
are aligned by their positions. All terms pass the kernel of `motion_terms`.

Two changes y and x against one first run have the ratio (instrumental variables, with the change x'
that the model explains as the instrument: noise of x does not draw the ratio towards zero)

    ratio = (sum(x' y) - N/2) / (sum(x' x) - N)

N is the noise that the fit of x' takes for a change, trace(cov X'X); the half of it that is the
first run's is in y as well, where all runs have the same noise.

The covariances allow for residuals that are correlated in time (`residual_covariance`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rigtool.errors import InsufficientDataError
from rigtool.experiments.friction.model_doubt import TIME_PARTS, own_part, structure
from rigtool.experiments.friction.motion_terms import MIN_SAMPLES, MIN_SLIDING_WEIGHT, band_limit
from rigtool.numerics.arrays import TINY, Array, Mask
from rigtool.numerics.checks import require_signals
from rigtool.numerics.residual_covariance import (
    independent_samples,
    kept_by_fit,
    long_run_covariance,
)
from rigtool.numerics.smoothing import CUTOFF, KernelSmoother, resample

PAIRED_TERMS = ("inertia", "viscous", "coulomb", "offset", "gravity_cosine", "gravity_sine")

DROPPED_TERMS = (("gravity_cosine", "gravity_sine"), ("inertia",), ("viscous",), ("coulomb",))
"""Terms that a motion may not separate from the others, in the order in which they are dropped."""

MIN_OWN_POWER = 1e-4
"""Smallest part of a term's power that the other terms may leave unexplained: what is hardly
separated has a large uncertainty, and the effect of a term that is left out goes to another
term."""

SAME_MOTION = 0.1
"""Largest rms difference of aligned positions, relative to their standard deviation."""

MAX_RELATIVE_U = 0.2
"""Largest relative u of a known change: noise alone fitted by p terms has 1/sqrt(p)."""

MIN_OVERLAP = 0.5
"""Part of the shorter run that is compared at least, where the peak of a correlation is not the
highest."""

FEW_PEAKS = 5
"""Peaks of the correlation of two motions from which they are aligned: the best fit counts."""

MAX_ALIGNMENT_STEPS = 20
"""Most steps of the alignment."""


@dataclass(frozen=True, eq=False)
class MotionSignals:
    """A recording: `time` (n,) s, `position` (n,) rad or m, `effort` (n,); the angle that gravity
    sees (n,) rad, None where there is none."""

    time: Array
    position: Array
    effort: Array
    angle: Array | None = None


@dataclass(frozen=True, eq=False)
class ParameterChange:
    """Change of `names`' parameters (p,) against the first run, with covariance (p, p) and `dof`.

    `difference` (n,) is that of the efforts at rows `time`, `position`, `speed` (n,), `model` (n,)
    what the parameters explain of it; rows that are not `used` are near standstill. `fitted_noise`
    is the part of the model's power that noise makes; `turns` where gravity sees an angle.
    """

    names: tuple[str, ...]
    parameters: Array
    covariance: Array
    dof: int
    shift: float
    time: Array
    position: Array
    speed: Array
    difference: Array
    model: Array
    used: Mask
    independent: float
    fitted_noise: float
    turns: bool

    @property
    def residual_rms(self) -> float:
        """Of the difference beside the model."""
        return float(np.sqrt(np.mean((self.difference - self.model)[self.used] ** 2)))

    def estimate(self, name: str) -> tuple[float, float] | None:
        """Return the change of a parameter and its u; None where the motion does not show it.

        Where gravity acts and is not separated, its change is part of the inertia's.
        """
        mixed = name == "inertia" and self.turns and "gravity_cosine" not in self.names
        if mixed or name not in self.names:
            return None
        i = self.names.index(name)
        return float(self.parameters[i]), math.sqrt(float(self.covariance[i, i]))

    def gravity(self) -> tuple[float, float] | None:
        """Return the amplitude of gravity's change and its u; None as in `estimate`."""
        if "gravity_cosine" not in self.names:
            return None
        i = self.names.index("gravity_cosine")
        both = self.parameters[i : i + 2]
        amplitude = float(np.linalg.norm(both))
        way = both / max(amplitude, TINY)
        return amplitude, math.sqrt(float(way @ self.covariance[i : i + 2, i : i + 2] @ way))


@dataclass(frozen=True, eq=False)
class _Rows:
    """Smoothed rows of a run: regressors (n, p), effort (n,), and where they are in use."""

    design: Array
    effort: Array
    used: Mask


def changes(first: MotionSignals, others: Sequence[MotionSignals]) -> list[ParameterChange]:
    """Return the change of each other run against the first, all at the same rows.

    Raises `InsufficientDataError` for runs of another motion, or too short ones.
    """
    time, aligned, shifts = _aligned(first, others)
    step = float(np.mean(np.diff(time)))
    motion = band_limit(time=time, position=aligned[0][0], torque=aligned[0][1])
    cutoff, rows = motion.cutoff, []
    smoother = KernelSmoother(step, CUTOFF / cutoff)
    for position, effort, angle, known in aligned:
        motion = band_limit(time=time, position=position, torque=effort, cutoff=cutoff)
        columns = [motion.design[:, :4]]
        if angle is not None:
            columns += [smoother(np.cos(angle))[:, None], smoother(np.sin(angle))[:, None]]
        there = smoother(known.astype(np.float64)) >= MIN_SLIDING_WEIGHT
        rows.append(_Rows(np.column_stack(columns), motion.torque, motion.used & there))
    places = smoother.places(len(time))
    used: Mask = np.logical_and.reduce([row.used for row in rows])
    chosen = _separated(np.concatenate([row.design[used] for row in rows]))
    lag = max(1, round(2 * CUTOFF / cutoff / step / smoother.every))
    return [
        _change(rows[0], row, chosen, used, shift, time[places], aligned[0][0][places], lag)
        for row, shift in zip(rows[1:], shifts, strict=True)
    ]


def ratio(change: ParameterChange, known: ParameterChange) -> tuple[float, float, int]:
    """Return the ratio of two changes against one run, its standard uncertainty, and its dof.

    Raises `InsufficientDataError` where the known change is all noise.
    """
    used = change.used
    x, y, seen = (
        np.where(used, values, 0.0) for values in (known.difference, change.difference, known.model)
    )
    alike = float(seen @ x) - known.fitted_noise
    found = (float(seen @ y) - known.fitted_noise / 2) / alike if alike > 0 else math.nan
    left = y - found * x
    covariance, dof = long_run_covariance(
        seen[:, None], left, min(change.independent, known.independent)
    )
    own = long_run_covariance(seen[:, None], x - seen, known.independent)[0]
    if not alike > 0 or float(own[0, 0]) > MAX_RELATIVE_U**2:
        raise InsufficientDataError(
            "the known change is not larger than the scatter: no ratio can be stated; give a run "
            "with a larger one"
        )
    scale = float(seen @ seen) / alike
    doubt = _doubt(change.position, change.speed, left, seen[:, None], used)
    return found, math.hypot(math.sqrt(float(covariance[0, 0])), float(doubt[0])) * scale, dof


def _change(
    first: _Rows,
    other: _Rows,
    chosen: list[int],
    used: Mask,
    shift: float,
    time: Array,
    position: Array,
    lag: int,
) -> ParameterChange:
    """Fit the difference of two runs."""
    base = np.linalg.lstsq(first.design[used][:, chosen], first.effort[used])[0]
    difference = other.effort - first.effort
    difference = difference - (other.design - first.design)[:, chosen] @ base
    design = np.where(used[:, None], other.design[:, chosen], 0.0)
    parameters = np.linalg.lstsq(design, np.where(used, difference, 0.0))[0]
    residual = np.where(used, difference - design @ parameters, 0.0)
    independent = independent_samples(residual, used, lag)
    covariance, dof = long_run_covariance(design, residual, independent)
    # A motion is slow, and so are its terms: the fit takes a good part of the slow residuals.
    loss = np.sqrt(kept_by_fit(design, dof))
    gram = design.T @ design
    covariance = _scaled(covariance, gram, loss)
    fitted_noise = float(np.sum(covariance * gram))
    doubt = _doubt(position, other.design[:, PAIRED_TERMS.index("viscous")], residual, design, used)
    covariance = covariance + np.diag(doubt**2)
    return ParameterChange(
        tuple(PAIRED_TERMS[i] for i in chosen),
        parameters,
        covariance,
        dof,
        shift,
        time,
        position,
        other.design[:, PAIRED_TERMS.index("viscous")],
        difference,
        other.design[:, chosen] @ parameters,
        used,
        independent,
        fitted_noise,
        other.design.shape[1] == len(PAIRED_TERMS),
    )


def _scaled(covariance: Array, gram: Array, loss: Array) -> Array:
    """Return a covariance (p, p) of which the moments lost a part: `gram` is X'X (p, p)."""
    inverse = np.linalg.inv(gram)
    spread = gram @ covariance @ gram / np.outer(loss, loss)
    return inverse @ spread @ inverse


def _doubt(position: Array, speed: Array, residual: Array, design: Array, used: Mask) -> Array:
    """Return the uncertainty (p,) from what is a function of position, or of speed, in residuals:
    ripple or friction that differ by how far the runs did not move alike."""
    times = np.arange(len(used)) * TIME_PARTS // len(used)
    kept = residual[used], design[used], times[used]
    by_position, by_speed = (structure(over[used], *kept)[1] for over in (position, speed))
    return np.hypot(by_position, by_speed)


def _separated(design: Array) -> list[int]:
    """Return the columns of a design (n, p) that the motion separates from each other.

    Raises `InsufficientDataError` where no row is in motion.
    """
    if len(design) < MIN_SAMPLES:
        raise InsufficientDataError(
            f"{len(design)} smoothed samples of the runs are in motion together, {MIN_SAMPLES} are "
            "needed: record for longer"
        )
    chosen = list(range(design.shape[1]))
    for names in DROPPED_TERMS:
        places = [PAIRED_TERMS.index(name) for name in names if PAIRED_TERMS.index(name) in chosen]
        part = [own_part(design[:, chosen], chosen.index(place)) for place in places]
        if part and min(part) < MIN_OWN_POWER:
            chosen = [place for place in chosen if place not in places]
    return chosen


# -- alignment

_Aligned = tuple[Array, Array, Array | None, Mask]
"""Position, effort, the angle that gravity sees, and the samples that were recorded, (n,)."""


def _aligned(
    first: MotionSignals, others: Sequence[MotionSignals]
) -> tuple[Array, list[_Aligned], list[float]]:
    """Return an even time axis on which all runs are at the same point of the motion, and shifts.

    Raises `InsufficientDataError` for a run of another motion.
    """
    runs = [_even(run) for run in (first, *others)]
    (time, start, *_), shifts = runs[0], [0.0]
    low, high = time[0], time[-1]
    for here, (other, position, *_) in zip(others, runs[1:], strict=True):
        shift = _shift(time, start, other, position)
        low, high = max(low, other[0] - shift), min(high, other[-1] - shift)
        if high - low < len(here.time) * 0.1 * float(time[1] - time[0]):
            raise InsufficientDataError(
                "the runs overlap in less than a tenth of the motion: give runs of one motion"
            )
        shifts.append(shift)
    axis = time[(time >= low) & (time <= high)]
    found: list[_Aligned] = []
    for shift, (at, position, effort, angle, known) in zip(shifts, runs, strict=True):
        there = np.interp(axis + shift, at, known.astype(np.float64)) > 1 - 1e-9
        turned = None if angle is None else np.interp(axis + shift, at, angle)
        torque = np.interp(axis + shift, at, effort)
        found.append((np.interp(axis + shift, at, position), torque, turned, there))
    for position, *_ in found[1:]:
        _require_same(found[0][0], position)
    return axis, found, shifts[1:]


def _even(run: MotionSignals) -> tuple[Array, Array, Array, Array | None, Mask]:
    """Return time from 0 at equal steps, position, effort, angle and the samples known."""
    time, position, effort = require_signals(
        MIN_SAMPLES, time=run.time, position=run.position, effort=run.effort
    )
    turned: Array = np.zeros(len(time)) if run.angle is None else run.angle
    step, known, even = resample(time, position, effort, turned)
    axis: Array = np.arange(float(len(even[0]))) * step
    return axis, even[0], even[1], None if run.angle is None else even[2], known


def _shift(time: Array, position: Array, other: Array, moved: Array) -> float:
    """Return the time by which another run is later at the same point of the motion, s."""
    from scipy.signal import correlate, find_peaks

    step = float(time[1] - time[0])
    again = np.interp(np.arange(other[0], other[-1], step), other, moved)
    theirs, ours = (np.gradient(values) for values in (again, position))
    found = correlate(theirs - theirs.mean(), ours - ours.mean(), method="fft")
    peaks = find_peaks(found, distance=max(1, len(position) // FEW_PEAKS**2))[0]
    highest = peaks[np.argsort(-found[peaks])[:FEW_PEAKS]]
    tried = [
        _refined(time, position, other, moved, (int(peak) - (len(position) - 1)) * step)
        for peak in [int(np.argmax(found)), *highest]
    ]
    return min(tried, key=lambda found: found[0])[1]  # the first one where none overlaps enough


def _refined(
    time: Array, position: Array, other: Array, moved: Array, shift: float
) -> tuple[float, float]:
    """Return the rms distance of positions after least squares from a shift, s, and that shift.

    The peak of a correlation leans towards more overlap.
    """
    step, rms = float(time[1] - time[0]), math.inf
    for _ in range(MAX_ALIGNMENT_STEPS):
        here = time[(time + shift >= other[0]) & (time + shift <= other[-1])]
        if len(here) < max(MIN_SAMPLES, MIN_OVERLAP * min(len(time), len(other))):
            return math.inf, shift
        apart = np.interp(here + shift, other, moved) - np.interp(here, time, position)
        slope = np.gradient(np.interp(here, time, position), step)
        slope = slope - slope.mean()
        rms = float(np.std(apart))
        more = float(slope @ (apart - apart.mean())) / max(float(slope @ slope), TINY)
        shift -= more
        if abs(more) < 1e-4 * step:
            break
    return rms, shift


def _require_same(position: Array, other: Array) -> None:
    apart = other - position
    rms = float(np.std(apart)) / max(float(np.std(position)), TINY)
    if rms > SAME_MOTION:
        raise InsufficientDataError(
            f"the runs are not of one motion: aligned, their positions differ by {100 * rms:.0f} % "
            f"rms of their standard deviation, the limit is {100 * SAME_MOTION:.0f} %; give runs "
            "of one motion"
        )
