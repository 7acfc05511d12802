"""Steady revolutions of a recording of `fft-ripple` [7.1.3]."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rigtool.control.position_loop import position_loop
from rigtool.errors import InsufficientDataError
from rigtool.experiments.controller_torque import naming, require_unlimited
from rigtool.experiments.ripple.encoder_steps import step_orders
from rigtool.experiments.ripple.orders import HIGHEST_ORDER, Sampling, cells_for
from rigtool.experiments.ripple.revolutions import Revolutions
from rigtool.experiments.ripple.varying_speed import fastest
from rigtool.numerics.arrays import Array
from rigtool.numerics.welch import Welch
from rigtool.recipe import Recipe
from rigtool.runfile import Recording
from rigtool.runfile.schema import CHUNK

DRIFT_DEGREE = 3, 12
"""Lowest and highest degree of the polynomial by which the housing's temperature changes over a
recording, if so many turns show it."""

TURNS_A_DEGREE = 12
"""Turns for each degree of it: a housing follows its winding, at first late, then by exponentials.
Over 150 turns (12 min) a cubic is 0.2 K off at the beginning."""

MIN_STEADY_SAMPLES = 4
"""Smallest number of samples at constant speed, however few turns they make."""


def steady_samples(recording: Recording) -> range:
    """Return the samples at constant speed.

    Raises `InsufficientDataError` where there are fewer than `MIN_STEADY_SAMPLES`.
    """
    begin = float(recording.read("time", 0, 1)[0])
    starts = range(0, recording.size, CHUNK)

    def since_start(sample: int) -> float:
        return float(recording.read("time", sample, sample + 1)[0]) - begin

    def first_from(seconds: float) -> int:
        """Return the first sample so long after the start, or the number of samples."""
        # Each look at a sample unpacks its chunk: one for each chunk, not for each sample.
        chunk = bisect_left(starts, seconds, key=since_start)
        start = starts[max(chunk - 1, 0)]
        after = recording.read("time", start, start + CHUNK) - begin
        return start + int(np.searchsorted(after, seconds))

    first = first_from(recording.condition("steady_from"))
    last = first_from(recording.condition("steady_until"))
    if last - first < MIN_STEADY_SAMPLES:
        raise InsufficientDataError(
            f"recording {recording.name}: {last - first} samples at constant speed are too few, "
            f"{MIN_STEADY_SAMPLES} are needed: record for longer"
        )
    return range(first, last)


def first_and_last(recording: Recording, channel: str, samples: range) -> tuple[float, float]:
    """Return the first and the last of these samples."""
    first, last = (recording.read(channel, i, i + 1)[0] for i in (samples[0], samples[-1]))
    return float(first), float(last)


def temperature_at_turns(recording: Recording, firsts: NDArray[np.intp]) -> Array:
    """Return the motor's temperature where turns begin and end, (turns + 1,) degC; NaN where none
    is known.

    `firsts` (turns + 1,) are the first samples of each turn, and the first one after the last turn.
    A polynomial through the means of the turns, of a higher degree for more of them
    (`TURNS_A_DEGREE`).
    """
    turns = firsts.size - 1
    sums, counts = np.zeros(turns), np.zeros(turns)
    if recording.has("temperature"):
        start, stop = int(firsts[0]), int(firsts[-1])
        for (degc,) in recording.blocks("temperature", start=start, stop=stop, finite=False):
            begins = np.clip(firsts - start, 0, degc.size)
            own = np.flatnonzero(np.diff(begins))  # turns with samples in this block
            known = np.isfinite(degc)
            sums[own] += np.add.reduceat(np.where(known, degc, 0.0), begins[own])
            counts[own] += np.add.reduceat(known, begins[own], dtype=np.intp)
            start += degc.size
    known = np.flatnonzero(counts)
    if not known.size:
        return np.full(turns + 1, np.nan)
    lowest, highest = DRIFT_DEGREE
    degree = min(max(lowest, known.size // TURNS_A_DEGREE), highest, known.size - 1)
    means = sums[known] / counts[known]
    smooth = np.polynomial.Chebyshev.fit(known + 0.5, means, degree, domain=[0, turns])
    return np.asarray(smooth(np.arange(turns + 1.0)), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Collected:
    """Steady revolutions of a recording, as `Revolutions` has them: `waveforms` (revolutions,
    positions) A, with their `sampling`; `durations` (revolutions, positions) s; `steps` (m,), those
    of `step_orders`; when the rotor `passed` turns, s, the mean `current` of each, A, and the
    `firsts` of the recording's samples in them. `square` is the mean of i |i|, `shaken` the part of
    it that a current which is steady would not have, A2: of recorded samples, which are means of
    several."""

    waveforms: Array
    durations: Array
    steps: Array
    forward: bool
    sampling: Sampling
    passed: Array
    current: Array
    firsts: NDArray[np.intp]
    square: float
    shaken: float


def collected(
    recording: Recording, steady: range, recipe: Recipe, welch: Welch | None
) -> Collected:
    """Return a recording's steady revolutions; add their current to `welch`.

    Raises `InsufficientDataError` where the current is at its limit, or whole turns are missing.
    """
    largest = total = square = 0.0
    with naming(recording):
        first, last = first_and_last(recording, "encoder", steady)
        revolutions = Revolutions(cells_for(recipe.rig.encoder_counts), forward=last > first)
        for time, encoder, current in recording.blocks(
            "time", "encoder", "current_setpoint", start=steady.start, stop=steady.stop
        ):
            largest = max(largest, float(np.abs(current).max()))
            total += float(current.sum())
            square += float(current @ np.abs(current))
            encoder /= recipe.rig.encoder_counts
            revolutions.add(time, encoder, current)
            if welch is not None:
                welch.add(current)
        held = "torque" in recording.conditions
        remedy = "lower fft_ripple.torques" if held else "turn more slowly"
        mean, square = abs(total) / len(steady), abs(square) / len(steady)
        require_unlimited(largest, recipe, remedy, mean)
        settings = recipe.fft_ripple
        waveforms = revolutions.waveforms(settings.revolutions)
        durations = revolutions.durations(settings.revolutions)
        sampling = Sampling(revolutions.step, settings.record_every, fastest(durations))
        steps = step_orders(
            revolutions.passed(settings.revolutions),
            settings.revolutions,
            recipe.rig.encoder_counts,
            position_loop(**recipe.rig.loop_design),
            settings.record_every,
            HIGHEST_ORDER,
        )
    shaken = max(square - mean**2, 0.0)
    forward = last > first
    passed, turn_means, firsts = revolutions.turns()
    firsts += steady.start
    return Collected(
        waveforms, durations, steps, forward, sampling, passed, turn_means, firsts, square, shaken
    )
