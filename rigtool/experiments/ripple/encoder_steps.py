"""Orders that the steps of an encoder show, and no motor makes.

A loop samples an angle that its encoder rounds down to whole steps. The error of a sample is

    q = step (floor(angle/step) + 1/2) - angle,

which the controller answers with the torque (T/P) q. Where the rotor makes more than half a step
from one sample to the next, edges of the steps are an alias of a lower frequency (B. Widrow, I.
Kollar, Quantization Noise, 2008, ch. 20); ripple moves the angle by some steps to and fro, which
spreads the alias over whole orders of the turn. What is recorded of this torque and of the encoder
passes the analysis as the motor's ripple does.
"""

from __future__ import annotations

import numpy as np

from rigtool.control.position_loop import Loop
from rigtool.experiments.ripple.orders import Sampling, coefficients
from rigtool.experiments.ripple.revolutions import Revolutions
from rigtool.numerics.arrays import Array

MOTION_ORDERS = 30
"""Orders of the turn up to which the motion is taken: the inertia holds higher ones."""

PHASES = (0.0, 0.25)
"""Where the zero of the angle lies within a step: not known, so that both count."""


def step_orders(
    passed: Array, revolutions: int, counts: int, loop: Loop, averaged: int, orders: int
) -> Array:
    """Return the rms amplitudes, N m, of orders 1..`orders` with which the loop answers the steps,
    (orders,).

    `passed` (n + 1,) is when the rotor passes the edges of n equal cells, those of `revolutions`
    whole turns, s. A recorded sample is the mean of `averaged` ones of the loop. Zero where edges
    come more slowly than half the rate of recorded samples, which resolve them.
    """
    cells, sample_time = (passed.size - 1) // revolutions, loop.plant.sample_time
    per_sample = counts * revolutions / (passed[-1] - passed[0]) * sample_time
    if per_sample * averaged < 0.5:
        return np.zeros(orders)
    time = _smooth(passed, MOTION_ORDERS * revolutions)
    # A turn more on both sides, so that all turns are whole.
    first, last = time[cells] - time[0], time[-1] - time[-1 - cells]
    time = np.concatenate([time[:cells] - first, time, time[-cells:] + last])
    sampled = np.arange(time[0], time[-1], sample_time)
    sampled = sampled[: sampled.size // averaged * averaged]
    angle = np.interp(sampled, time, np.arange(time.size) / cells)
    frequency: Array = np.fft.rfftfreq(angle.size, sample_time)[1:].astype(np.float64)
    answer = loop.complementary_sensitivity.response(frequency) / loop.plant.response(frequency)
    power = np.zeros(orders)
    for phase in PHASES:
        place = angle * counts + phase
        count = np.floor(place)
        error = np.fft.rfft(count + 0.5 - place) * (2 * np.pi / counts)
        torque = np.fft.irfft(np.concatenate([[0.0], error[1:] * answer]), angle.size)
        recorded = Revolutions(cells, forward=True)
        recorded.add(
            *(each.reshape(-1, averaged).mean(axis=1) for each in (sampled, count / counts, torque))
        )
        sampling = Sampling(recorded.step, averaged)
        found = coefficients(recorded.waveforms(revolutions), orders, sampling).mean(axis=0)
        power += np.abs(found) ** 2 / len(PHASES)
    return np.sqrt(power)


def _smooth(passed: Array, cycles: int) -> Array:
    """Return times (n,) without what has more than so many cycles in all of them."""
    even = np.linspace(passed[0], passed[-1], passed.size)
    late = np.fft.rfft((passed - even)[:-1])
    late[cycles + 1 :] = 0.0
    even[:-1] += np.fft.irfft(late, passed.size - 1)
    return np.maximum.accumulate(even)
