"""Cycles of a load on a drive whose friction, ripple and tendon are formulas of this file."""

import math

import numpy as np

from rigtool.experiments.load_disturbance.cycles import Transmission, loaded_cycles
from rigtool.experiments.load_disturbance.tendon import Tendon, swing

DRIVE = Transmission(angle_ratio=0.85, torque_factor=1.18, inertia=2e-5, arm=0.02, bandwidth_hz=5.0)
CONSTANT = 0.045
TENDON = Tendon(0.25, 1e-3, 0.8e-3)
TURN = math.radians(20)


def cycles(
    moment,
    speed,
    *,
    count=8,
    friction=0.1,
    tendon=TENDON,
    scatter=0.0,
    ripple=0.004,
    seed=1,
    constant=CONSTANT,
    drift=0.0,
):
    """Return cycles of a load, N m, at an output speed in rev/s, 500 samples a second.

    Friction is 10 mN m without load, `friction` times the load more; the torque constant varies
    with the rotor's angle by `ripple`; `scatter` N m is that of each cycle's load.
    """
    rotor_speed = 2 * math.pi * speed * DRIVE.angle_ratio
    span = math.pi * DRIVE.angle_ratio
    stroke = span / rotor_speed
    step = 2e-3
    time = np.arange(0, 2 * stroke * (count + 1.2), step)
    phase = np.mod(time / stroke, 2.0)
    setpoint = _rounded(phase) * span
    period = 2 * stroke
    whole = np.arange(4096) / 4096 * 2
    one = _rounded(whole) * span / DRIVE.angle_ratio
    torque, _ = swing(one, period, tendon, moment, DRIVE.arm)
    way = np.gradient(one)
    direction = np.tanh(way / np.abs(way).max() * 20)
    added = friction * np.hypot(torque, 2e-3) - friction * 2e-3
    at_output = torque + direction * (10e-3 + drift + added)
    phases = np.append(whole, 2.0)
    output = np.interp(phase, phases, np.append(at_output, at_output[0]))
    number = np.floor(time / period).astype(int)
    deviation = scatter * np.random.default_rng(seed).standard_normal(number.max() + 1)
    output = output + deviation[number]
    gain = 1 + ripple * np.sin(setpoint + 0.5) + ripple * np.cos(2 * setpoint)
    acceleration = np.gradient(np.gradient(setpoint, step), step)
    current = (output / DRIVE.torque_factor / gain + DRIVE.inertia * acceleration) / constant
    return loaded_cycles(
        time,
        setpoint,
        setpoint,
        current,
        transmission=DRIVE,
        speed=rotor_speed,
        torque_constant=constant,
        moves=count,
    )


def _rounded(phase):
    """Return a triangle 0..1..0 over phases 0..2 with its corners rounded by a short average."""
    fine = np.arange(-2, 4, 1e-3)
    triangle = 1 - np.abs(np.mod(fine, 2.0) - 1)
    window = np.hanning(161)
    smooth = np.convolve(triangle, window / window.sum(), "same")
    return np.interp(phase, fine, smooth)
