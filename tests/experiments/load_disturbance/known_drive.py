"""Strokes of a load on a drive whose friction, ripple and tendon are formulas of this file."""

import math

import numpy as np
from scipy import constants

from rigtool.experiments.force_model.model import Known
from rigtool.experiments.force_model.paths import tendon
from rigtool.experiments.force_model.records import LoadCase, repeated

COUNT = 2 * math.pi / 4000
CONSTANT, ARM = 0.045, 0.02
KNOWN = Known(angle_ratio=0.85, torque_factor=1.18, inertia=2e-5)
STIFFNESS, DAMPING, TIP_FRICTION = 0.25, 1e-3, 0.8e-3
STEP = 2e-3


def strokes(
    moment,
    speed,
    *,
    known=True,
    count=8,
    friction=0.1,
    stiffness=STIFFNESS,
    damping=DAMPING,
    tip_friction=TIP_FRICTION,
    scatter=0.0,
    ripple=0.004,
    phase=0.0,
    seed=1,
    drift=0.0,
):
    """Return strokes under a load, N m, at an output speed in rev/s, laid over each other.

    Friction is 10 mN m without load, `friction` times the load more; the torque constant varies
    with the rotor's angle by `ripple`, turned by `phase`; `scatter` N m is that of each cycle's
    load. The record states its load only where it is `known`.
    """
    rotor_speed = 2 * math.pi * speed * KNOWN.angle_ratio
    span = math.pi * KNOWN.angle_ratio
    stroke = span / rotor_speed
    time = np.arange(0, 2 * stroke * (count + 1.8), STEP)
    angle = _rounded(np.mod(time / stroke, 2.0)) * span
    fine = 4096
    whole = np.arange(fine) / fine * 2
    inertia = moment * ARM / constants.g + 1e-7
    torque, _ = tendon(
        _rounded(whole) * span / KNOWN.angle_ratio,
        2 * stroke / fine,
        stiffness,
        damping,
        inertia,
        tip_friction,
        0.01,
        moment,
        True,
    )
    way = np.gradient(_rounded(whole))
    direction = np.tanh(way / np.abs(way).max() * 20)
    added = friction * (np.hypot(torque, 2e-3) - 2e-3)
    at_output = torque + direction * (10e-3 + drift + added)
    phases = np.append(whole, 2.0)
    output = np.interp(np.mod(time / stroke, 2.0), phases, np.append(at_output, at_output[0]))
    number = np.floor(time / stroke / 2).astype(int)
    output += (scatter * np.random.default_rng(seed).standard_normal(number.max() + 1))[number]
    gain = 1 + ripple * np.sin(angle + 0.5 + phase) + ripple * np.cos(2 * angle + phase)
    acceleration = np.gradient(np.gradient(angle, STEP), STEP)
    current = (output / KNOWN.torque_factor / gain + KNOWN.inertia * acceleration) / CONSTANT
    stated = moment if known else 0.0
    under = LoadCase(CONSTANT, stated, stated * ARM / constants.g, COUNT)
    return repeated(np.floor(angle / COUNT), current, angle, STEP, under)


def _rounded(phase):
    """Return a triangle 0..1..0 over phases 0..2 with its corners rounded by a short average."""
    fine = np.arange(-2, 4, 1e-3)
    triangle = 1 - np.abs(np.mod(fine, 2.0) - 1)
    window = np.hanning(161)
    smooth = np.convolve(triangle, window / window.sum(), "same")
    return np.interp(phase, fine, smooth)
