"""Force over time while samples arrive: the causal form of `procedure_reading`, block by block.

A row is what the table `force` has as its causal columns, digit for digit, but for what a whole
recording shows: faults of signals, what notes add to u. Where counts leap after a rest, the filter
begins anew.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from rigtool.errors import RecipeError
from rigtool.experiments.force_filter.accuracy import COVERAGE_FACTOR
from rigtool.experiments.force_filter.motion_states import State
from rigtool.experiments.force_model.steps import LONGEST_EXACT, FilterSteps, Holder, unbroken
from rigtool.experiments.force_sensor.power_up.power_up import PowerUp
from rigtool.experiments.force_sensor.procedure_over_time import model_and_reach, over_time
from rigtool.experiments.force_sensor.procedure_reading import NEEDED_CHANNELS, instrument_of
from rigtool.experiments.force_sensor.sensor import Sensor
from rigtool.experiments.procedure import Procedure
from rigtool.numerics.arrays import Array
from rigtool.recipe import Recipe
from rigtool.runfile import Run
from rigtool.signals import CHANNELS


def over_time_live(seconds: float, *, observed: bool, every: int) -> Procedure:
    """Return `over_time`, with force as it comes, of every `every`th estimate."""
    return replace(over_time(seconds, observed=observed), follow=partial(LiveForce, every=every))


BATCH_TIME = 8e-3
"""Samples that are taken together at least, s: each time costs about 1 ms of a core."""


class LiveForce:
    """Turns blocks of signals into rows of force; what is missing between samples begins anew.

    Every `every`th estimate makes a row. Raises `RecipeError` where samples are means, or too far
    apart: their angle is known only from later ones.
    """

    def __init__(self, recipe: Recipe, *, kt: Run, tables: Run, every: int = 1) -> None:
        motion, interval = recipe.measure_force.motion, recipe.rig.sample_time
        if motion.record_every != 1 or not FilterSteps.of(interval, interval).immediate:
            raise RecipeError(
                f"force as it comes needs each sample of a loop above {1 / LONGEST_EXACT:.0f} Hz, "
                f"rig.sample_time = {interval:g} s and measure_force.motion.record_every = "
                f"{motion.record_every} give fewer: record without it, and read the run"
            )
        model, reach = model_and_reach(tables, kt, recipe)
        self._instrument = instrument_of(recipe, kt, model, reach, interval)
        self._every, self._counts = every, self._instrument.counts()
        self._last, self._holder = np.zeros(0), Holder(interval)
        self._waiting = np.empty((len(NEEDED_CHANNELS), 0))
        self._power_up: PowerUp | None = None
        self._begin(0.0)
        # numba is imported now: later the rig moves, and its watchdog waits
        self._rows(np.zeros((len(NEEDED_CHANNELS) - 1, math.ceil(BATCH_TIME / interval))))
        self._power_up = None

    def _begin(self, time: float) -> None:
        self._sensor = Sensor(self._instrument, context=False, before=self._power_up)
        self._power_up = self._sensor.power_up
        self._began, self._steps = time - self._instrument.interval / 2, 0

    def __call__(self, block: Mapping[str, Array]) -> dict[str, Array]:
        """Return rows (r,) of what these signals (n,) complete: `time` s, `torque`, `u`, `low` and
        `high` N m, and `state`; without a value NaN."""
        new = np.array([_as_stored(name, block[name]) for name in NEEDED_CHANNELS])
        if new.shape[1]:
            new[2:] = self._holder.add(new[2:])
        samples = np.hstack([self._waiting, new])
        if samples.shape[1] * self._instrument.interval < BATCH_TIME:
            self._waiting, samples = samples, samples[:, :0]
        else:
            self._waiting = samples[:, :0]
        known = len(self._last)
        time = np.concatenate([self._last, samples[0]])
        good = np.concatenate([np.ones(known, np.bool_), np.isfinite(samples).all(axis=0)])
        rows = []
        for span in unbroken(np.diff(time), good, self._instrument.interval):
            first = max(0, span.start - known)
            part = samples[:, first : span.stop - known]
            if not part.shape[1]:
                continue
            if span.start > 0 or not known:
                self._counts = self._instrument.counts(self._counts.lost)
                self._begin(float(part[0, 0]))
            part = np.vstack([part[0], self._counts.add(part[1]), part[2:]])
            for number, piece in enumerate(np.split(part, self._counts.shown, axis=1)):
                if number:  # a rotor that leaps there would read as a torque
                    self._begin(float(piece[0, 0]))
                if piece.shape[1]:
                    rows.append(self._rows(piece[1:]))
        if samples.shape[1]:
            self._last = time[-1:] if good[-1] else np.zeros(0)
        names = ("time", "torque", "u", "low", "high", "state")
        together = np.hstack(rows) if rows else np.empty((len(names), 0))
        found: dict[str, Any] = dict(zip(names, together, strict=True))
        return {**found, "state": found["state"].astype(np.int32)}

    def _rows(self, samples: Array) -> Array:
        """Return rows (6, r) of samples (3, n) that nothing is missing before."""
        sensed = self._sensor.add(samples)
        count, step_time = len(sensed.states), self._instrument.grid.step_time
        number = self._steps + np.arange(count)
        self._steps += count
        chosen = number % self._every == 0
        states = sensed.states[chosen]
        torque = np.where(states == State.OUTSIDE, np.nan, sensed.torque[chosen])
        u = np.where(states == State.OUTSIDE, np.nan, sensed.u[chosen])
        half = COVERAGE_FACTOR * u
        time = self._began + step_time * (number[chosen] + 1.0)
        return np.array([time, torque, u, torque - half, torque + half, states])


def _as_stored(name: str, values: Array) -> Array:
    """Return values as a run file gives them back: in the precision of their channel."""
    _, kind, _ = CHANNELS[name]
    return np.asarray(values).astype(kind).astype(np.float64)
