"""Thresholds for contacts: from recordings of the tables in which nothing hangs on the output."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from rigtool.experiments.force_filter.motion_states import Reach
from rigtool.experiments.force_model.force_model import ForceModel
from rigtool.experiments.force_sensor.contacts import thresholds, trial
from rigtool.experiments.force_sensor.procedure_reading import (
    instrument_for,
    unbroken_blocks,
)
from rigtool.experiments.force_sensor.sensor import Sensed, Sensor
from rigtool.numerics.arrays import Array
from rigtool.recipe import Recipe
from rigtool.runfile import Recording, Run

KNOWN, EXPLORED = "known_", "explore_"
"""First parts of the names of recordings in runs of implementation D."""


def limits_of(tables: Run, recipe: Recipe, kt: Run, model: ForceModel, reach: Reach) -> Array:
    """Return thresholds for contacts, see `contacts.thresholds`."""
    tested = []
    for recording in _unloaded(tables):
        instrument = instrument_for(recording, recipe, kt, model, reach)
        sensor = Sensor(instrument, contacts=True)
        found: list[Sensed] = []
        for block, begins in unbroken_blocks(recording, instrument):
            if begins and found:
                break  # whatever follows the first gap has to settle again
            found.append(sensor.add(block[1:]))
        torque, deviation = np.hstack([one.untouched for one in found if one.untouched is not None])
        states = np.concatenate([one.states for one in found])
        tested.append(trial(torque, deviation, states, instrument.grid.step_time))
    return thresholds(tested)


def _unloaded(tables: Run) -> Iterator[Recording]:
    """Yield the exploration, and the slowest strokes without load."""
    yield from (r for r in tables.recordings_named(EXPLORED) if r.size)
    loads = [r for r in tables.recordings_named(KNOWN) if r.size]
    slowest = min((r.condition("speed") for r in loads), default=0.0)
    for recording in loads:
        if recording.condition("speed") == slowest and recording.condition("force") == 0:
            yield recording
