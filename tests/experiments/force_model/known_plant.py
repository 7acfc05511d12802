"""Strokes of a drive whose friction, ripple and tendon are formulas of this file."""

import math

import numpy as np
from scipy.signal import lfilter

from rigtool.experiments.force_model.records import LoadCase, repeated

COUNT = 2 * math.pi / 4000
CONSTANT = 0.05
RATIO, FACTOR, INERTIA = 0.9, 1.1, 2e-5
COULOMB, VISCOUS = 12e-3, 1.5e-4
RIPPLE = 0.8e-3
LOAD_FRICTION, ONSET = 0.15, 1e-3
STIFFNESS = 0.25
SPAN = 2.6
STEP = 2e-3


def strokes(moment, speed, cycles=6, deviation=0.0, noise=(0.0, 0.1), seed=1, payback=0.0):
    """Return strokes under a load's moment, N m, at a motor speed, rad/s, laid over each other.

    `deviation` N m is that of each stroke's friction at sine and cosine of the angle, `noise` N m
    and s that of a first-order process. The next stroke of the same direction takes `payback` of
    a deviation back.
    """
    stroke = SPAN / speed
    time = np.arange(0, 2 * stroke * (cycles + 1.6), STEP)
    phase = time / stroke
    inside = np.mod(phase, 2.0)
    angle = SPAN * np.minimum(inside, 2 - inside)
    angle = np.convolve(np.pad(angle, 25, mode="edge"), np.ones(51) / 51, mode="valid")
    velocity = np.gradient(angle, STEP)
    way = np.tanh(velocity / 0.02)
    output = angle / RATIO
    carried = moment * np.sin(output)
    for _ in range(60 if moment else 0):
        carried = (carried + moment * np.sin(output - carried / STIFFNESS)) / 2
    friction = way * (COULOMB + LOAD_FRICTION / FACTOR * (np.hypot(carried, ONSET) - ONSET))
    rng = np.random.default_rng(seed)
    number = np.floor(phase).astype(int)
    fresh = rng.standard_normal((2, number.max() + 3))
    drawn = deviation * (fresh[:, 2:] - payback * fresh[:, :-2])[:, number]
    friction += way * (drawn[0] * np.sin(output) + drawn[1] * np.cos(output))
    size, memory = noise
    kept = math.exp(-STEP / memory)
    process = lfilter(
        [1.0], [1.0, -kept], size * math.sqrt(1 - kept**2) * rng.standard_normal(time.size)
    )
    torque = (
        carried / FACTOR
        + friction
        + way * process
        + VISCOUS * velocity
        + RIPPLE * np.cos(2 * angle)
        + INERTIA * np.gradient(velocity, STEP)
    )
    encoder = np.floor(angle / COUNT)
    under = LoadCase(CONSTANT, moment, 1e-9, COUNT)
    return repeated(encoder, torque / CONSTANT, angle, STEP, under)
