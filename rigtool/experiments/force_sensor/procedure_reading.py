"""From a recording to the torque on the output, smoothed and causal, by stretches without gaps."""

from __future__ import annotations

import math
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from rigtool.errors import InsufficientDataError, RigtoolError
from rigtool.experiments.controller_torque import NO_ANSWER, loop_answer
from rigtool.experiments.force_filter.estimate import PIECE_STEPS
from rigtool.experiments.force_filter.motion_states import Reach
from rigtool.experiments.force_model.force_model import ForceModel
from rigtool.experiments.force_model.steps import Holder, unbroken
from rigtool.experiments.force_sensor.power_up.power_up import PowerUp
from rigtool.experiments.force_sensor.power_up.ripple_rows import least_row_time
from rigtool.experiments.force_sensor.results_over_time import TorqueRows
from rigtool.experiments.force_sensor.results_recordings import Recorded
from rigtool.experiments.force_sensor.sensor import SensorProperties
from rigtool.experiments.force_sensor.signal_faults import SignalWatch
from rigtool.experiments.force_sensor.stretch import Stretch
from rigtool.experiments.torque_per_ampere import torque_per_ampere_at
from rigtool.numerics.arrays import Array
from rigtool.numerics.checks import require_rising, rising_steps
from rigtool.numerics.memory import give_back
from rigtool.recipe import Recipe
from rigtool.runfile import Recording, Run

NEEDED_CHANNELS = ("time", "encoder", "current_setpoint", "temperature")
"""Channels that the torque is read from; `current_setpoint` is all of the motor's current."""

REFERENCE_CHANNEL, SETPOINT_CHANNEL = "reference_torque", "position_setpoint"
"""Channels that are read where they are: what acted, which informs nothing, and where the rig's own
loop takes the rotor."""

LONGEST_INTERVAL = 0.01
"""Time between samples, s: what is longer hides how friction changes in a reversal."""

RATE_SAMPLES = 8192
"""Samples that the sampling frequency is taken from."""

BLOCK = 65536
"""Samples that are read at a time, whole chunks: larger blocks leave gaps between what is kept, of
70 MB in an hour."""

AS_ASKED = 1e-6
"""Relative difference within which the interval between samples is that of the recipe."""


def require_interval(
    seconds: float, source: str, error: type[RigtoolError] = InsufficientDataError
) -> None:
    """Raise an `error` where samples of a `source` are too far apart."""
    if seconds > LONGEST_INTERVAL * (1 + AS_ASKED):
        raise error(
            f"{source}: a sample each {seconds * 1e3:.3g} ms does not show how friction changes in "
            f"a reversal, {LONGEST_INTERVAL * 1e3:g} ms at most do: lower "
            "measure_force.motion.record_every"
        )


def instrument_of(
    recipe: Recipe, kt: Run, model: ForceModel, reach: Reach, interval: float
) -> SensorProperties:
    """Return the sensor's properties of this rig, for samples every `interval` s."""
    rig = recipe.rig
    cold = torque_per_ampere_at(kt, 0.0).value
    slope = torque_per_ampere_at(kt, 1.0).value - cold
    return SensorProperties(
        model,
        reach,
        interval,
        rig.sample_time,
        rig.count_angle,
        (cold, slope),
        rig.current_limit,
        recipe.measure_force.motion.corner_hz,
    )


def read_recording(
    recording: Recording,
    recipe: Recipe,
    kt: Run,
    model: ForceModel,
    reach: Reach,
    moved: float = 0.0,
) -> Recorded:
    """Return the torque over a recording, and contacts, by stretches without gaps; the encoder
    shows `moved` rad too much."""
    if recording.size < 2:
        return Recorded(recording.name, (), 0, 0.0)
    interval = _interval(recording, recipe)
    require_interval(interval, recording.name)
    instrument = instrument_of(recipe, kt, model, reach, interval)
    counts = round(moved / instrument.count)
    commanded = recording.has(SETPOINT_CHANNEL)
    loop = loop_answer(recipe) if commanded else NO_ANSWER
    parts: list[TorqueRows] = []
    breaks, read, done, holder = -1, 0.0, 0, Holder(interval)
    with ThreadPoolExecutor(1) as smoothing, ThreadPoolExecutor(1) as testing:
        stretch: Stretch | None = None
        known: tuple[SignalWatch, PowerUp] | tuple[None, None] = None, None
        for block, begins in unbroken_blocks(recording, instrument, holder):
            if begins:
                breaks += 1
                parts += [] if stretch is None else stretch.reading()
                read += 0.0 if stretch is None else stretch.seconds
                stretch = None
            if not block.shape[1]:
                continue
            if stretch is None:
                began, left = float(block[0, 0]), recording.size - done
                stretch = Stretch(
                    recording.name,
                    instrument,
                    began,
                    left,
                    (smoothing, testing),
                    commanded=commanded,
                    loop=loop,
                    before=known,
                )
                known = stretch.known
            done += block.shape[1]
            if counts:
                block[1] -= counts
                if commanded:  # the loop saw the rotor where the encoder showed it
                    block[-1] -= counts * instrument.count
            rows = block[1:]
            stretch.add(*((rows[:-1], rows[-1]) if commanded else (rows,)))
        if stretch is not None:
            parts += stretch.reading()
            read += stretch.seconds
    give_back()
    (first,) = recording.read("time", 0, 1)
    (last,) = recording.read("time", recording.size - 1)
    # without a gap samples count: their clock may be off the interval by a part in a million
    lasts = last + interval - first if breaks else recording.size * interval
    lost, unended = lasts - read, 2 * instrument.grid.step_time
    lost = lost if breaks or not parts or lost > unended else 0.0
    return Recorded(recording.name, tuple(parts), breaks, lost, holder.count)


def _interval(recording: Recording, recipe: Recipe) -> float:
    """Return the time between two samples, s: a multiple of the loop's wherever it is one."""
    measured = require_rising(recording.read("time", 0, RATE_SAMPLES))
    own = recipe.rig.sample_time
    asked = own * max(1, round(measured / own))
    return asked if math.isclose(asked, measured, rel_tol=AS_ASKED) else measured


def unbroken_blocks(
    recording: Recording, instrument: SensorProperties, holder: Holder
) -> Iterator[tuple[Array, bool]]:
    """Yield the channels (c, n), time first, reference and set point last, and whether a sample is
    missing before them.

    Samples with NaN are left out, but where `holder` holds the current; a reference and a set point
    may be NaN. Of what lies between two gaps and is too short for a row of ripple, no sample is
    yielded: thousands of filters would begin for nothing.
    """
    optional = filter(recording.has, (REFERENCE_CHANNEL, SETPOINT_CHANNEL))
    names = (*NEEDED_CHANNELS, *optional)
    grid, interval = instrument.grid, instrument.interval
    piece = max(1, round(PIECE_STEPS * grid.step_time / interval))
    shortest = least_row_time(grid.step_time)
    before, number = np.zeros(0), 0
    for block in recording.blocks(*names, finite=False, size=BLOCK):
        samples = np.array(block)
        samples[2:4] = holder.add(samples[2:4])
        time = np.concatenate([before, samples[0]])
        steps = rising_steps(time, number - before.size)
        number += samples.shape[1]
        good = np.isfinite(samples[: len(NEEDED_CHANNELS)]).all(axis=0)
        good = np.concatenate([before == before, good])
        for span in unbroken(steps, good, interval):
            begins = span.start > 0 or not before.size
            if begins and span.stop < time.size and (span.stop - span.start) * interval < shortest:
                yield samples[:, :0], True
                continue
            rows = slice(max(0, span.start - before.size), span.stop - before.size)
            for part in range(rows.start, rows.stop, piece):
                yield samples[:, part : min(part + piece, rows.stop)], begins
                begins = False
        before = time[-1:] if good[-1] else np.zeros(0)
