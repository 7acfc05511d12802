"""From a recording to the torque on the output at each step, smoothed and causal, block by block.

Memory holds what was read, a few numbers a step, and no samples.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from rigtool.experiments.force_filter.estimate import PIECE, Smoother, without_delay
from rigtool.experiments.force_filter.motion_states import Moments, Reach
from rigtool.experiments.force_model.contacts import Contact, contacts, trial
from rigtool.experiments.force_model.force_model import ForceModel
from rigtool.experiments.force_model.intervals import standard_uncertainty
from rigtool.experiments.force_model.steps import unbroken
from rigtool.experiments.force_sensor.results_over_time import SIGNALS, Reading, Recorded
from rigtool.experiments.force_sensor.sensor import Instrument, Sensor
from rigtool.experiments.torque_per_ampere import torque_per_ampere_at
from rigtool.numerics.arrays import Array
from rigtool.numerics.checks import require_rising, rising_steps
from rigtool.recipe import Recipe
from rigtool.runfile import Recording, Run

NEEDED = ("time", "encoder", "current_setpoint", "temperature")
"""Channels that the torque is read from; `current_setpoint` is all of the motor's current."""

REFERENCE = "reference_torque"

SHORTEST = 2.0
"""Stretch without gaps that is analysed, s: the filter has to settle."""

RATE_SAMPLES = 8192
"""Samples that the sampling frequency is taken from."""

AS_ASKED = 1e-6
"""Of the interval between samples: it is that of the recipe, which a sensor knows beforehand."""


def instrument_of(
    recipe: Recipe, kt: Run, model: ForceModel, reach: Reach, interval: float
) -> Instrument:
    """Return what a sensor knows of this rig, for samples every `interval` s."""
    rig = recipe.rig
    cold = torque_per_ampere_at(kt, 0.0).value
    slope = torque_per_ampere_at(kt, 1.0).value - cold
    count = 2 * math.pi / rig.encoder_counts
    bandwidth = recipe.measure_force.motion.bandwidth_hz
    return Instrument(model, reach, interval, count, (cold, slope), rig.current_limit, bandwidth)


def instrument_for(
    recording: Recording, recipe: Recipe, kt: Run, model: ForceModel, reach: Reach
) -> Instrument:
    """Return what a sensor knows of this rig, for the samples of a recording."""
    return instrument_of(recipe, kt, model, reach, _interval(recording, recipe))


def read_recording(
    recording: Recording,
    recipe: Recipe,
    kt: Run,
    model: ForceModel,
    reach: Reach,
) -> Recorded:
    """Return the torque over a recording, and contacts, by stretches without gaps."""
    if recording.size < 2:
        return Recorded(recording.name, (), 0, 0.0)
    instrument = instrument_for(recording, recipe, kt, model, reach)
    interval = instrument.interval
    parts: list[Reading] = []
    stretch, breaks, first, last = None, -1, math.nan, math.nan
    for block, begins in unbroken_blocks(recording, instrument):
        if begins:
            breaks += 1
            parts += [] if stretch is None else stretch.reading()
            stretch = _Stretch(recording.name, instrument, float(block[0, 0]))
        assert stretch is not None
        stretch.add(block[1:])
    parts += [] if stretch is None else stretch.reading()
    (first,) = recording.read("time", 0, 1)
    (last,) = recording.read("time", recording.size - 1)
    read = sum(len(part.torque) * part.step_time for part in parts)
    lost = last + interval - first - read if breaks or not parts else 0.0
    return Recorded(recording.name, tuple(parts), breaks, lost)


def _interval(recording: Recording, recipe: Recipe) -> float:
    """Return the time between two samples, s: a multiple of the loop's wherever it is one."""
    measured = require_rising(recording.read("time", 0, RATE_SAMPLES))
    own = recipe.rig.sample_time
    asked = own * max(1, round(measured / own))
    return asked if math.isclose(asked, measured, rel_tol=AS_ASKED) else measured


def unbroken_blocks(recording: Recording, instrument: Instrument) -> Iterator[tuple[Array, bool]]:
    """Yield the channels (c, n), time first, and whether a sample is missing before them.

    Samples with NaN are left out.
    """
    names = (*NEEDED, REFERENCE) if recording.has(REFERENCE) else NEEDED
    grid, interval = instrument.grid, instrument.interval
    piece = max(1, round(PIECE * grid.step_time / interval))
    before, number = np.zeros(0), 0
    for block in recording.blocks(*names, finite=False):
        samples = np.array(block)
        time = np.concatenate([before, samples[0]])
        rising_steps(time, number - before.size)
        number += samples.shape[1]
        good = np.concatenate([before == before, np.isfinite(samples).all(axis=0)])
        for span in unbroken(time, good, interval):
            begins = span.start > 0 or not before.size
            rows = slice(max(0, span.start - before.size), span.stop - before.size)
            for part in range(rows.start, rows.stop, piece):
                yield samples[:, part : min(part + piece, rows.stop)], begins
                begins = False
        before = time[-1:] if good[-1] else np.zeros(0)


class _Stretch:
    """Samples without a gap: causal at once, smoothed as soon as enough has followed."""

    def __init__(self, name: str, instrument: Instrument, began: float) -> None:
        step_time = instrument.grid.step_time
        self._name, self._instrument = name, instrument
        self._began = began - instrument.interval / 2
        sought = bool(np.isfinite(instrument.model.limits).any())
        self._sensor = Sensor(instrument, keep=True, contacts=sought)
        self._smoother = Smoother(instrument.model.uncertainty, step_time)
        self._judge = instrument.judge(causal=False)
        self._waiting: Moments | None = None  # of which some, in front, give states alone
        self._in_front = 0
        self._found: dict[str, list[Any]] = {name: [] for name in FOUND}
        self._untouched: list[Array] = []
        self._limited = 0

    def add(self, samples: Array, *, last: bool = False) -> None:
        """Read samples (c, n): encoder, current, temperature, and the reference where it is."""
        sensed = self._sensor.add(samples, last=last)
        self._limited += int(self._instrument.limited(samples[1]).sum())
        estimate = sensed.estimate
        angle = estimate.low + self._instrument.count / 2
        found = [angle, sensed.torque, sensed.u, sensed.states, *sensed.others]
        names = ("angle", "causal", "causal_u", "causal_states", "reference")
        for name, values in zip(names, found, strict=False):
            self._found[name].append(values)
        if sensed.untouched is not None:
            self._untouched.append(sensed.untouched.astype(np.float32))
        before = self._waiting
        self._waiting = sensed.moments if before is None else before.joined(before, sensed.moments)
        assert sensed.again is not None
        self._smooth(*self._smoother.add(sensed.again))

    def _smooth(self, torque: Array, deviation: Array) -> None:
        """Take smoothed values of the steps that wait the longest, and give them their states."""
        if not len(torque):
            return
        assert self._waiting is not None
        judge, first = self._judge, self._in_front
        end = first + len(torque)
        part = self._waiting.part(0, end + judge.span)
        own = part.torque.copy()
        own[first:end] = torque
        states = judge.states(replace(part, torque=own))
        kinds = judge.kinds(states, part)[first:end]
        smoothed: tuple[Any, ...] = (torque, deviation, states[first:end], kinds)
        for name, values in zip(("torque", "u", "states", "kinds"), smoothed, strict=True):
            self._found[name].append(values)
        self._in_front = min(end, judge.span)
        self._waiting = self._waiting.part(end - self._in_front)

    def reading(self) -> list[Reading]:
        """Return what was read, once the stretch is over; nothing where it is too short."""
        rows = np.empty((4 if self._found["reference"] else 3, 0))
        self.add(rows, last=True)
        self._smooth(*self._smoother.finish())
        step_time = self._instrument.grid.step_time
        whole: dict[str, Any] = {
            n: np.concatenate(self._found.pop(n)) for n in FOUND if self._found[n]
        }
        if not whole or len(whole["torque"]) * step_time < SHORTEST:
            return []
        reference = whole.pop("reference", None)
        bandwidth = self._instrument.bandwidth_hz
        deviation = without_delay(whole["u"], bandwidth, step_time)
        ripple, variance, _ = self._sensor.power_up.whole(whole.pop("angle"), whole["torque"])
        whole["torque"] = whole["torque"] - ripple
        scales, deviation = self._instrument.model.scales[0], np.sqrt(deviation**2 + variance)
        whole["u"] = standard_uncertainty(scales, deviation, whole["torque"], whole.pop("kinds"))
        found: list[Contact] = []
        if self._untouched:
            torque, deviation, doubt = np.hstack(self._untouched)
            states = whole["causal_states"]
            tested = trial(torque, deviation, states, step_time, doubt)
            found = contacts(tested, self._instrument.model.limits)
        steps = np.arange(1.0, len(whole["torque"]) + 1)
        time: Any = self._began + step_time * steps
        whole |= {"limited": self._limited, "contacts": tuple(found), "reference": reference}
        return [Reading(self._name, step_time, time, **whole)]


FOUND = (*(name for name in SIGNALS if name != "time"), "reference", "angle", "kinds")
