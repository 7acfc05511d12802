"""How much larger errors are than the filter states, by state: from the known loads of the tables.

The filter reads the recordings that its model was learned from, where what acts is known:

    M = F r sin a,   a = rotor angle / angle ratio - M / stiffness

The factor of a state is the 95 % quantile of |error| / deviation over that of a normal
distribution, 1 at least. Loads are those of the slowest strokes: their inertia does not count.

Thresholds for contacts come from the strokes without load among these, and from the exploration.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from rigtool.experiments.force.contacts import thresholds, trial
from rigtool.experiments.force.procedure_reading import (
    instrument_for,
    read_recording,
    unbroken_blocks,
)
from rigtool.experiments.force.results_over_time import COVERAGE_FACTOR, Reading, Scales
from rigtool.experiments.force.sensor import Sensed, Sensor
from rigtool.experiments.force_over_time.force_model import ForceModel
from rigtool.experiments.force_over_time.motion_states import Reach, State, States
from rigtool.numerics.arrays import Array
from rigtool.recipe import Recipe
from rigtool.runfile import Recording, Run

KNOWN, EXPLORED = "known_", "explore_"
"""First parts of the names of recordings in runs of implementation D."""

LENGTH = 40.0
"""Of each recording that is read, s."""

FEWEST = 100
"""Rows of a state without which its factor is that of all states."""

ITERATIONS = 60


def scales_of(tables: Run, recipe: Recipe, kt: Run, model: ForceModel, reach: Reach) -> Scales:
    """Return the factors of each state; 1 for all where the tables hold no recordings."""
    found: dict[str, list[tuple[Array, States]]] = {"smoothed": [], "causal": []}
    bandwidth = recipe.measure_force.motion.bandwidth_hz
    for recording in _informative(tables):
        for part in read_recording(recording, recipe, kt, model, reach, LENGTH).parts:
            rows = part.low_passed(bandwidth)
            truth = _known(recording, rows, recipe, model)
            for name, torque, deviation, states in (
                ("smoothed", rows.torque, rows.deviation, rows.states),
                ("causal", rows.causal, rows.causal_deviation, rows.causal_states),
            ):
                found[name].append((np.abs(torque - truth) / deviation, states))
    return Scales(*(_factors(found[name]) for name in ("smoothed", "causal")))


def _informative(tables: Run) -> Iterator[Recording]:
    """Yield the exploration, and the lightest and heaviest load at the slowest speed."""
    yield from (r for r in tables.recordings_named(EXPLORED) if r.size)
    loads = [r for r in tables.recordings_named(KNOWN) if r.size]
    if loads:
        slowest = min(r.condition("speed") for r in loads)
        slow = [r for r in loads if r.condition("speed") == slowest]
        slow.sort(key=lambda r: r.condition("force"))
        yield from (slow[0], slow[len(slow) // 2], slow[-1])


def limits_of(tables: Run, recipe: Recipe, kt: Run, model: ForceModel, reach: Reach) -> Array:
    """Return thresholds for contacts, see `contacts.thresholds`."""
    tested = []
    for recording in _unloaded(tables):
        instrument = instrument_for(recording, recipe, kt, model, reach)
        sensor = Sensor(instrument, contacts=True)
        found: list[Sensed] = []
        for block, begins in unbroken_blocks(recording, instrument, None):
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


def _known(recording: Recording, rows: Reading, recipe: Recipe, model: ForceModel) -> Array:
    """Return the torque of a hanging load at the rows (m,), N m."""
    moment = recording.condition("force") * recipe.rig.load_arm
    counts = np.interp(rows.time, recording.read("time"), recording.read("encoder"))
    free = counts * (2 * math.pi / recipe.rig.encoder_counts) / recipe.rig.angle_ratio
    angle, stiffness = free.copy(), model.learned.shape.stiffness
    for _ in range(ITERATIONS):
        angle = (angle + free - moment * np.sin(angle) / stiffness) / 2
    truth: Array = moment * np.sin(angle)
    return truth


def _factors(pieces: list[tuple[Array, States]]) -> Array:
    """Return the factor of each state, in the order of `State`."""
    factors = np.ones(len(State))
    if not pieces:
        return factors
    ratio, states = (np.concatenate(arrays) for arrays in zip(*pieces, strict=True))
    known = states != State.OUTSIDE
    for state in State:
        chosen = states == state
        chosen = known if chosen.sum() < FEWEST else chosen
        if chosen.any():
            factors[state] = max(1.0, float(np.quantile(ratio[chosen], 0.95)) / COVERAGE_FACTOR)
    return factors
