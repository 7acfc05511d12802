"""The bare motor turning steadily, and sweeping: what implementations A and B have in common."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rigtool.control.lookup_table import LookupTable
from rigtool.errors import InsufficientDataError, RunFileError
from rigtool.experiments.controller_torque import CHANNELS
from rigtool.experiments.learning.convergence import Cycles, LearningRun, learning_run
from rigtool.experiments.learning.filters import Learning
from rigtool.experiments.learning.implementations import signals as common
from rigtool.experiments.learning.implementations.validation import (
    Steady,
    Sweep,
    midpoints,
    steady_outcome,
)
from rigtool.experiments.learning.results_residual import Remaining
from rigtool.experiments.learning.rows import Row
from rigtool.experiments.learning.turns import (
    TURN,
    by_angle,
    cut_turns,
    learned_row,
    torque_row,
    turn_angles,
)
from rigtool.experiments.outcome import Outcome
from rigtool.experiments.procedure import channels, record
from rigtool.numerics.moves import Moves
from rigtool.quantity import Quantity
from rigtool.recipe import Recipe
from rigtool.rigs import Feedforward, Rig, Task
from rigtool.rigs.motion import SpeedProfile
from rigtool.runfile import Recording, RecordingSpec, Run, RunWriter

Array = NDArray[np.float64]

ACCELERATION = 30.0
"""Of run-up and stop, rad/s2."""

SETTLE_TIME = 0.5
"""After the run-up, s."""

MARGIN = 0.05
"""From the end of what is used to the beginning of the stop, s."""

SPARE = 8
"""Samples taken beyond a turn, so that it is whole."""

SAME = 5e-3
"""Difference of two tables, relative to the largest torque, that recording them may make."""

SWEEPS = ("off", "plain", "on")
"""Sweeps with the table off, without its amplitude and phase tables, and with them."""


def both(speeds: Iterable[float]) -> list[float]:
    """Return speeds with either sign, slowest first."""
    return [sign * speed for speed in sorted(speeds) for sign in (1.0, -1.0)]


def low_and_learned(recipe: Recipe) -> tuple[float, ...]:
    """Return the low and the learned speeds of the recipe, rev/s."""
    turning = recipe.ilc_learn.turning
    return (*turning.low_speeds_rev_per_s, *turning.speeds_rev_per_s)


def between(recipe: Recipe) -> list[float]:
    """Return the speeds to validate at that were not learned, rev/s, both directions."""
    return both(midpoints(low_and_learned(recipe)))


def revolutions(recipe: Recipe, speed_rev_per_s: float) -> int:
    """Return how many turns count at a speed, rev/s."""
    turning = recipe.ilc_learn.turning
    low = abs(speed_rev_per_s) < min(turning.speeds_rev_per_s)
    return turning.low_speed_revolutions if low else turning.revolutions


def steady_specs(recipe: Recipe, kind: str, speeds: Iterable[float]) -> list[RecordingSpec]:
    """Return recordings at constant speeds, rev/s with their sign."""
    return [_steady(recipe, f"{kind}_{n:03d}", speed) for n, speed in enumerate(speeds)]


def _steady(recipe: Recipe, name: str, speed: float) -> RecordingSpec:
    start = abs(TURN * speed) / ACCELERATION + SETTLE_TIME
    turns = revolutions(recipe, speed)
    return RecordingSpec(
        name,
        channels(*CHANNELS),
        {
            "speed": (TURN * speed, "rad/s"),
            "revolutions": (float(turns), "1"),
            "steady_from": (start, "s"),
            # a little more, as samples do not end where turns do
            "steady_until": (start + (turns + 0.05) / abs(speed), "s"),
        },
        recipe.ilc_learn.turning.record_every,
    )


def sweep_specs(recipe: Recipe) -> list[RecordingSpec]:
    """Return the sweeps from the highest learned speed backwards to the highest forwards."""
    turning = recipe.ilc_learn.turning
    top = TURN * max(turning.speeds_rev_per_s)
    start = top / ACCELERATION + SETTLE_TIME
    conditions = {
        "speed": (top, "rad/s"),
        "steady_from": (start, "s"),
        "steady_until": (start + turning.sweep_time, "s"),
    }
    return [
        RecordingSpec(f"sweep_{variant}", channels(*CHANNELS), conditions, turning.record_every)
        for variant in SWEEPS
    ]


def task(spec: RecordingSpec, fed: Feedforward) -> Task:
    """Return what to do for a recording: run up, turn steadily or sweep, and stop."""
    speed, begin, end = (spec.conditions[k][0] for k in ("speed", "steady_from", "steady_until"))
    run_up = abs(speed) / ACCELERATION
    if spec.name.startswith("sweep_"):
        last = end + SETTLE_TIME
        profile = SpeedProfile(
            (0.0, run_up, begin, end, last, last + run_up),
            (0.0, -speed, -speed, speed, speed, 0.0),
        )
    else:
        last = end + MARGIN
        profile = SpeedProfile((0.0, run_up, last, last + run_up), (0.0, speed, speed, 0.0))
    return Task(profile, fed, record_every=spec.record_every)


@dataclass(frozen=True, eq=False)
class Bench:
    """A rig that turns, and where it is recorded."""

    rig: Rig
    recipe: Recipe
    recorder: RunWriter

    def turn(self, specs: Iterable[RecordingSpec], fed: Feedforward) -> list[Recording]:
        """Make recordings with this fed forward, and return them."""
        made = list(specs)
        for spec in made:
            record(self.rig, task(spec, fed), self.recorder, spec.name)
        return [self.recorder.recording(spec.name) for spec in made]

    def check(
        self,
        kinds: Mapping[str, Sequence[RecordingSpec]],
        fed: Feedforward,
        plain: LookupTable,
        table: LookupTable,
    ) -> None:
        """Turn with the table on at the learned speeds; with a validation, anywhere else as well.

        `plain` is the table without its amplitude and phase tables, for the sweep.
        """
        compensated = replace(fed, table=table)
        self.turn(kinds["validate"], compensated)
        self.turn(kinds.get("off", []), fed)
        self.turn(kinds.get("on", []), compensated)
        variants = (fed, replace(fed, table=plain), compensated)
        for spec, variant in zip(kinds.get("sweep", []), variants, strict=False):
            self.turn([spec], variant)


# -- analysing


@dataclass(frozen=True, eq=False)
class Turned:
    """A recording at constant speed: turns of the controller's torque, and the same as cycles.

    `speed` in rad/s with its sign.
    """

    speed: float
    turns: Moves
    cycles: Cycles


def turned(recording: Recording, recipe: Recipe, torque_constant: float) -> Turned:
    """Cut a recording into its turns; `InsufficientDataError` names it where that fails."""
    found = common.signals(recording, recipe)
    used = _steady_part(recording, found.time)
    speed = recording.condition("speed")
    count = revolutions(recipe, speed / TURN)
    time, setpoint = found.time[used], found.setpoint[used]
    try:
        cut = cut_turns(time, setpoint, torque_constant * found.controller[used], count)
        # The table is the same in each turn: the last one tells it.
        last = slice(-(len(time) // count) - SPARE, None)
        learned = torque_constant * found.learned[used][last]
        table = cut_turns(time[last], setpoint[last], learned, 1).torque[0]
    except InsufficientDataError as error:
        raise InsufficientDataError(f"recording {recording.name}: {error}") from None
    everything = np.ones(table.size, dtype=np.bool_)
    return Turned(speed, cut, Cycles(cut.period, cut.torque, table, everything))


def _steady_part(recording: Recording, time: Array) -> slice:
    begin = time[0] if time.size else 0.0
    first, last = np.searchsorted(
        time - begin, [recording.condition("steady_from"), recording.condition("steady_until")]
    )
    return slice(int(first), int(last))


def judge(found: Sequence[Turned], learning: Learning, updates: int) -> LearningRun:
    """Judge a learning run: all its speeds together."""
    return learning_run([item.cycles for item in found], learning, updates)


def learned_by(item: Turned, learning: Learning, positions: int, *, first: bool = False) -> Row:
    """Return what an update learns by angle; in the `first` run nothing was fed forward."""
    before = 0.0 if first else item.cycles.before
    return learned_row(item.turns, item.speed, learning, positions, before)


def torque_by(item: Turned, learning: Learning, positions: int) -> Row:
    """Return the controller's torque within the band of Q by angle."""
    return torque_row(item.turns, item.speed, learning, positions)


def remaining(
    before: Sequence[Turned], after: Sequence[Turned], learning: Learning, positions: int
) -> Remaining:
    """Compare turns without and with the table, speed by speed.

    Raises `RunFileError` where a speed was not recorded without the table.
    """
    known = {item.speed: item for item in before}
    found: list[tuple[Row, Row, Array]] = []
    for item in sorted(after, key=lambda item: item.speed):
        if item.speed not in known:
            raise RunFileError(
                f"turned with the table at {item.speed:.4g} rad/s, which was not recorded without "
                f"it, only {', '.join(f'{speed:.4g}' for speed in known)}: record both at one speed"
            )
        applied = by_angle(item.turns, item.cycles.before, positions)
        off = torque_by(known[item.speed], learning, positions)
        found.append((off, torque_by(item, learning, positions), applied))
    rows_before, rows_after, torques = zip(*found, strict=True)
    return Remaining(turn_angles(positions), rows_before, rows_after, np.stack(torques))


def notes_on_table(remains: Remaining, table: LookupTable, recipe: Recipe) -> tuple[str, ...]:
    """Say so where the turns were made with another table than the one reported.

    A recorded sample is a mean over the angle of several; read between samples it is one over three
    such angles in a row.
    """
    speeds = np.array([row.speed for row in remains.after])
    positions = remains.position
    here = table.evaluate(
        np.tile(positions, len(speeds)), np.repeat(speeds, len(positions))
    ).reshape(remains.applied.shape)
    angle = recipe.ilc_learn.turning.record_every * recipe.rig.sample_time * np.abs(speeds) / TURN
    order = np.arange(len(positions) // 2 + 1)
    seen = np.fft.rfft(here, axis=1) * np.sinc(np.outer(angle, order)) ** 3
    off = np.abs(np.fft.irfft(seen, len(positions), axis=1) - remains.applied).max()
    if off <= SAME * np.abs(remains.applied).max():
        return ()
    return (
        f"the table that was switched on while recording differs from this one by up to "
        f"{off * 1e3:.2g} mN m: the residual belongs to the recorded one",
    )


def validated(
    run: Run,
    remains: Remaining,
    learned: Collection[float],
    recipe: Recipe,
    torque_constant: float,
    learning: Learning,
) -> Outcome:
    """Compare table off and on where it was learned, tuned, and in between, if that was recorded.

    `learned` are the speeds of which the table holds what was learned there, rad/s.
    """

    def rows(*kinds: str) -> dict[float, Row]:
        recorded = [r for kind in kinds for r in common.filled(run, kind)]
        items = (turned(recording, recipe, torque_constant) for recording in recorded)
        return {item.speed: torque_by(item, learning, recipe.rig.encoder_counts) for item in items}

    on = rows("on")
    if not on:
        return Outcome({})
    off = rows("low", "off")
    midway = {TURN * speed for speed in between(recipe)}
    pairs = [*zip(remains.before, remains.after, strict=True)]
    pairs += [(off[speed], after) for speed, after in on.items() if speed in off]

    def kind(speed: float) -> str:
        if speed in learned:
            return "learned"
        return "between" if speed in midway else "tuned"

    return steady_outcome([Steady(*pair, kind(pair[1].speed)) for pair in pairs])


def with_check(
    history: Sequence[LearningRun], after: Sequence[Turned], learning: Learning
) -> list[LearningRun]:
    """Return the judged runs and the one that was made with the final table."""
    if len(history) > 1 and history[-1].finished:
        return list(history)  # that table was on already
    return [*history, judge(after, learning, len(history))]


def require_friction_fed(
    recording: Recording, recipe: Recipe, torque_constant: float, fed: dict[str, Quantity]
) -> None:
    """Raise `RunFileError` unless the turns were made with the friction that is given."""
    time = recording.read("time")
    current = recording.read("feedforward_current")[_steady_part(recording, time)]
    recorded = torque_constant * float(current.mean()) if current.size else 0.0
    common.require_friction_fed(recording.name, recorded, recording.condition("speed"), fed)


def sweep(run: Run, recipe: Recipe, torque_constant: float, learning: Learning) -> Sweep | None:
    """Return the sweeps of a run; None where it holds none."""
    recorded = {recording.name: recording for recording in run.recordings_named("sweep_")}
    if any(f"sweep_{v}" not in recorded or not recorded[f"sweep_{v}"].size for v in SWEEPS):
        return None
    torque = {}
    for variant in SWEEPS:
        recording = recorded[f"sweep_{variant}"]
        found = common.signals(recording, recipe)
        used = _steady_part(recording, found.time)
        # Q takes the recording for one period: it begins and ends at rest.
        period = float(found.time[-1] - found.time[0]) * len(found.time) / (len(found.time) - 1)
        torque[variant] = learning.smoothed(torque_constant * found.controller, period)[used]
    speed = np.gradient(found.setpoint, found.time)[used]
    return Sweep(found.time[used], speed, torque, torque_constant * found.learned[used])
