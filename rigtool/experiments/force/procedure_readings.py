"""From a recording of `measure-force` to readings of torque: one pass through its signals."""

from __future__ import annotations

import math

import numpy as np

from rigtool.experiments.controller_torque import loop_blocks, naming
from rigtool.experiments.force.cycles import find_cycles, readings
from rigtool.experiments.force.results import LoadReadings
from rigtool.experiments.force.results_method import (
    STRAIGHT,
    require_no_turning_back,
    resolution_u,
    unsteady_torque,
    ways,
)
from rigtool.experiments.force_model.procedure_learning import stroke_record
from rigtool.numerics.arrays import Array
from rigtool.numerics.checks import require_rising, rising_steps
from rigtool.numerics.decimation import Decimator
from rigtool.numerics.lowpass import kept_factor, lowpass
from rigtool.recipe import Recipe
from rigtool.runfile import Recording, Run

RATE_SAMPLES = 8192
"""Samples that the sampling frequency is taken from."""


def read_load(
    recording: Recording,
    recipe: Recipe,
    torque_constant: float,
    lacking: float,
    whole: Run | None = None,
) -> LoadReadings:
    """Filter a recording, cut it into cycles and read the torque of each.

    `torque_constant` is in N m/A, `lacking` N m is what samples lack (`results_method`). With the
    calibration `whole` the reading also holds its whole cycles, for which all samples are in memory
    at once. Raises `InsufficientDataError` where the signals do not carry a reading.
    """
    settings, rig = recipe.measure_force, recipe.rig
    with naming(recording):
        signals, rate, way = _filtered(recording, recipe)
        signals[1:] *= torque_constant  # in place: an hour has 20 MB a signal
        position, torque, feedforward, modelled = signals
        torque *= rig.torque_factor
        modelled *= rig.torque_factor
        cycles = find_cycles(position)
        require_no_turning_back(way, rig.encoder_counts)
        angle = position * rig.count_angle / rig.angle_ratio
        method = (
            lacking,
            unsteady_torque(angle, torque, modelled, rate=rate, cycles=cycles, recipe=recipe),
            resolution_u(recording, recipe, torque_constant),
        )
        values = readings(angle, torque, cycles, math.radians(settings.measure_angle))
    return LoadReadings(
        name=recording.name,
        force=recording.condition("force"),
        asked_cycles=round(recording.condition("cycles")),
        position=position,
        torque=torque,
        feedforward=feedforward,
        cycles=cycles,
        values=values,
        method_u=math.hypot(*method),
        whole=None if whole is None else stroke_record(recording, recipe, whole),
    )


def _filtered(recording: Recording, recipe: Recipe) -> tuple[Array, float, Array]:
    """Return encoder, current of controller, table, model, low-passed and thinned, (4, m), Hz, and
    the `ways` (2,) of the rotor.

    Read block by block, so that memory does not grow with the recording.
    """
    cutoff = recipe.measure_force.lowpass_hz
    rate = 1 / require_rising(recording.read("time", 0, min(recording.size, RATE_SAMPLES)))
    last, samples = np.zeros(0), 0
    collected = Decimator(factor := kept_factor(rate, cutoff), 4, recording.size)
    speed = recipe.rig.motor_speed(recipe.measure_force.speed_rev_per_s)
    way = np.zeros(2)
    for block in loop_blocks(recording, recipe):
        rising_steps(np.concatenate([last, block.time]), samples - last.size)
        last, samples = block.time[-1:], samples + block.time.size
        way += ways(block.encoder, block.setpoint, STRAIGHT * speed / rate)
        collected.add(block.encoder, block.controller, block.learned, block.modelled)
    thinned = collected.finish()
    for signal in thinned:  # one by one: the filter holds several copies of what it works on
        signal[:] = lowpass(rate / factor, signal, cutoff)
    return thinned, rate / factor, way
