"""Orders that the steps of an encoder show, and no motor makes.

A loop samples an angle that its encoder rounds down to whole steps. The error of a sample is

    q = step (floor(angle/step) + 1/2) - angle.

Where the rotor makes more than half a step from one sample to the next, edges of the steps are an
alias of a lower frequency (B. Widrow, I. Kollar, Quantization Noise, 2008, ch. 20). Ripple moves
the angle by some steps to and fro, which spreads the alias over whole orders of the turn.
"""

from __future__ import annotations

import numpy as np

from rigtool.numerics.arrays import Array

MOTION_ORDERS = 30
"""Orders of the turn up to which the motion is taken: the inertia holds higher ones."""

PHASES = (0.0, 0.25, 0.5, 0.75)
"""Where the zero of the angle lies within a step: not known, so that all of these count."""


def step_orders(
    passed: Array, revolutions: int, counts: int, sample_time: float, orders: int
) -> Array:
    """Return the rms amplitudes, rad, of orders 1..`orders` of the turn in q, (orders,).

    `passed` (n + 1,) is when the rotor passes the edges of n equal cells, those of `revolutions`
    whole turns, s; the loop takes a sample each `sample_time`, s.
    """
    cells = (passed.size - 1) // revolutions
    time = _smooth(passed, MOTION_ORDERS * revolutions)
    turns = np.arange(time.size) / cells
    sums, samples = np.zeros((len(PHASES), cells)), 0
    # In parts, as many turns may have millions of samples.
    for begin in range(revolutions):
        since = np.interp([begin, begin + 1], turns, time) - time[0]
        first, stop = np.ceil(since / sample_time)
        angle = np.interp(time[0] + np.arange(first, stop) * sample_time, time, turns)
        cell = ((angle % 1.0) * cells).astype(np.intp)
        samples += angle.size
        for phase, total in zip(PHASES, sums, strict=True):
            place = angle * counts + phase
            error = np.floor(place) + 0.5 - place
            total += np.bincount(cell, error, cells)
    found = np.fft.rfft(sums, axis=1)[:, 1 : orders + 1] * (2 / max(samples, 1))
    rms: Array = np.sqrt(np.mean(np.abs(found) ** 2, axis=0)) * (2 * np.pi / counts)
    return rms


def _smooth(passed: Array, cycles: int) -> Array:
    """Return times (n,) without what has more than so many cycles in all of them."""
    even = np.linspace(passed[0], passed[-1], passed.size)
    late = np.fft.rfft((passed - even)[:-1])
    late[cycles + 1 :] = 0.0
    even[:-1] += np.fft.irfft(late, passed.size - 1)
    times: Array = np.maximum.accumulate(even)
    return times
