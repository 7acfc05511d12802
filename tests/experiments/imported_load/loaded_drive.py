"""A drive whose friction grows with load, moved to and fro under loads: the truth is known."""

import numpy as np

from rigtool.experiments.imported_load.basis import LoadSignals, path_of
from rigtool.experiments.imported_load.noise import noise_of

RATE = 200.0
BANDWIDTH_HZ = 5.0
MU = 0.3
PER_TORQUE = 1.5
"""A/(N m), without friction."""


def record(
    load, frequency, *, seed=0, seconds=12.0, drift=0.0, noise=0.002, amplitude=20.0, zero=0.0
):
    """Return time, position, effort and torque of one recording; the load resists rising.

    `drift` is friction that this recording has more than others, A; `zero` rad is where the encoder
    was zeroed.
    """
    random = np.random.default_rng(seed)
    time = np.arange(round(seconds * RATE)) / RATE
    phase = 2 * np.pi * frequency * time
    position = amplitude * np.sin(phase)
    speed = amplitude * 2 * np.pi * frequency * np.cos(phase)
    way = np.tanh(speed / 0.5)
    torque = -load * (1 + 0.1 * np.sin(position / 15))
    friction = (0.02 + drift) * way + 2e-4 * speed
    ripple = 0.01 * np.sin(position / 5)
    effort = -PER_TORQUE * torque * (1 + MU * way) + friction + ripple
    effort += random.normal(0, noise, len(time))
    return time, position - zero, effort, torque


def observe(load, frequency, **more):
    """Return a recording as one to learn from."""
    return signals(*record(load, frequency, **more))


def signals(time, position, effort, torque):
    """Return a recording's signals as an analysis reads them."""
    noise = noise_of(effort, RATE, BANDWIDTH_HZ)
    path, (effort, torque) = path_of(time, position, BANDWIDTH_HZ, effort, torque)
    return LoadSignals(path, effort, "A", path.speed, path.position, torque, noise)


def observations(loads=(0.02, 0.04, 0.06, 0.08), frequencies=(0.1, 0.2, 0.3), **more):
    """Return recordings of all loads at all frequencies, each with its own drift and noise."""
    random = np.random.default_rng(more.pop("seed", 1))
    drift = more.pop("drift", 0.001)
    return [
        observe(load, f, seed=random.integers(1 << 31), drift=random.normal(0, drift), **more)
        for load in loads
        for f in frequencies
    ]
