"""From a recording to the torque on the output at each step, smoothed and causal."""

from __future__ import annotations

import math

import numpy as np

from rigtool.experiments.force.power_up import PowerUp
from rigtool.experiments.force.results_over_time import Reading
from rigtool.experiments.force_over_time.estimate import Filter, smoothed
from rigtool.experiments.force_over_time.force_model import ForceModel
from rigtool.experiments.force_over_time.motion_states import (
    Reach,
    State,
    mean_speed,
    moving_states,
)
from rigtool.experiments.force_over_time.plant import HOUSING, SPEED
from rigtool.experiments.force_over_time.steps import Grid, unbroken
from rigtool.experiments.torque_per_ampere import torque_per_ampere_at
from rigtool.numerics.checks import require_rising
from rigtool.recipe import Recipe
from rigtool.runfile import Recording, Run

NEEDED = ("time", "encoder", "current_setpoint", "temperature")
"""Channels that the torque is read from; `current_setpoint` is all of the motor's current."""

REFERENCE = "reference_torque"

SHORTEST = 2.0
"""Stretch without gaps that is analysed, s: the filter has to settle."""

SETTLING = 0.1
"""About a current at its limit, s: the torque has no value."""

AT_THE_LIMIT = 0.999

RATE_SAMPLES = 8192
"""Samples that the sampling frequency is taken from."""


def read_recording(
    recording: Recording,
    recipe: Recipe,
    kt: Run,
    model: ForceModel,
    reach: Reach,
) -> Reading | None:
    """Return the torque over a recording; None where no stretch of it is long enough."""
    if recording.size < 2:
        return None
    interval = require_rising(recording.read("time", 0, RATE_SAMPLES))
    time, encoder, current, temperature = (recording.read(name) for name in NEEDED)
    reference = recording.read(REFERENCE) if recording.has(REFERENCE) else None
    require_rising(time)
    rig = recipe.rig
    grid = Grid.of(interval)
    constant = torque_per_ampere_at(kt, float(temperature.mean())).value
    count = 2 * math.pi / rig.encoder_counts
    limited = np.abs(current) >= AT_THE_LIMIT * rig.current_limit
    good = np.ones(len(time), dtype=np.bool_)
    step_time = grid.step_samples * grid.sample_time
    bandwidth = recipe.measure_force.motion.bandwidth_hz
    filtered = model.plant(grid.sample_time), model.uncertainty, grid.step_samples, bandwidth
    parts = []
    for stretch in unbroken(time, good, interval):
        if (stretch.stop - stretch.start) * interval < SHORTEST:
            continue
        signals = grid.signals(encoder[stretch], current[stretch], count, model.drive, constant)
        causal = Filter(*filtered).add(signals)
        torque, deviation = smoothed(*filtered, signals)
        low = signals.low[grid.step_samples :: grid.step_samples][: len(torque)]
        power_up = PowerUp(model, step_time, bandwidth)
        ripple, variance = power_up.add(low + count / 2, causal.states)
        later, later_variance = power_up.whole(low + count / 2, torque)
        torque = torque - later
        states = moving_states(
            low, causal.states[:, SPEED], causal.states[:, HOUSING], torque, count, step_time
        )
        warm = grid.at_steps(temperature[stretch])
        outside = reach.left_by(low, mean_speed(low, step_time), torque, warm)
        saturated = grid.at_steps(limited[stretch].astype(np.float64)) > 0
        lasting = np.ones(2 * round(SETTLING / step_time) + 1)
        outside |= np.convolve(saturated, lasting, mode="same") > 0.5
        states[outside] = State.OUTSIDE
        began = time[stretch.start] - interval / 2
        parts.append(
            Reading(
                recording.name,
                step_time,
                began + step_time * (1 + np.arange(len(torque))),
                torque,
                np.sqrt(deviation**2 + later_variance),
                causal.passed - ripple,
                np.sqrt(causal.deviation**2 + variance),
                states,
                None if reference is None else grid.at_steps(reference[stretch]),
                int(limited[stretch].sum()),
            )
        )
    return Reading.joined(parts) if parts else None
