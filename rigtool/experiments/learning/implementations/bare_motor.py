"""The bare motor, turning steadily and sweeping: the common part of implementations A and B."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, TypeVar

import numpy as np

from rigtool.control.lookup_table import LookupTable
from rigtool.errors import RunFileError
from rigtool.experiments.controller_torque import LOOP_CHANNELS, naming
from rigtool.experiments.learning.convergence import Cycles, LearningRun, learning_run
from rigtool.experiments.learning.filters import Learning
from rigtool.experiments.learning.implementations import signals as common
from rigtool.experiments.learning.implementations.runs import iterations_table
from rigtool.experiments.learning.implementations.skeleton import (
    Implementation,
    LearningReport,
    TaughtTable,
)
from rigtool.experiments.learning.implementations.validation import (
    Steady,
    Sweep,
    midpoints,
    steady_outcome,
)
from rigtool.experiments.learning.results_residual import Remaining
from rigtool.experiments.learning.rows import Row
from rigtool.experiments.learning.stored_table import period_results, tables_of
from rigtool.experiments.learning.turns import (
    TURN,
    by_angle,
    cut_turns,
    learned_row,
    torque_row,
    turn_angles,
)
from rigtool.experiments.outcome import Outcome
from rigtool.experiments.procedure import channels
from rigtool.numerics.arrays import Array
from rigtool.numerics.moves import Moves
from rigtool.quantity import Quantity
from rigtool.recipe import Recipe
from rigtool.rigs import Feedforward, Task
from rigtool.rigs.motion import SpeedProfile
from rigtool.runfile import Recording, RecordingSpec, Run, Table

ACCELERATION = 30.0
"""Acceleration of run-up and stop, rad/s2."""

SETTLE_TIME = 0.5
"""Wait after the run-up, s."""

STOP_MARGIN = 0.05
"""Time from the end of the samples in use to the beginning of the stop, s."""

SPARE_SAMPLES = 8
"""Samples taken beyond a turn, so that the turn is whole."""

SAME_TABLE = 5e-3
"""Difference of two tables, relative to the largest torque, that recording may cause."""

SWEEP_NAMES = ("off", "plain", "on")
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
    """Return the number of turns in use at a speed, rev/s."""
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
        channels(*LOOP_CHANNELS),
        {
            "speed": (TURN * speed, "rad/s"),
            "revolutions": (float(turns), "1"),
            "steady_from": (start, "s"),
            # with a margin, since samples do not end where turns do
            "steady_until": (start + (turns + 0.05) / abs(speed), "s"),
        },
        recipe.ilc_learn.turning.record_every,
    )


def sweep_specs(recipe: Recipe) -> dict[str, list[RecordingSpec]]:
    """Return the sweeps by kind, from the highest learned speed backwards to that forwards."""
    turning = recipe.ilc_learn.turning
    top = TURN * max(turning.speeds_rev_per_s)
    start = top / ACCELERATION + SETTLE_TIME
    conditions = {
        "speed": (top, "rad/s"),
        "steady_from": (start, "s"),
        "steady_until": (start + turning.sweep_time, "s"),
    }
    turned = turning.record_every
    return {
        name: [RecordingSpec(name, channels(*LOOP_CHANNELS), conditions, turned)]
        for name in (f"sweep_{variant}" for variant in SWEEP_NAMES)
    }


def task(spec: RecordingSpec, fed: Feedforward) -> Task:
    """Return the motion of a recording: run up, turn steadily or sweep, and stop."""
    speed, begin, end = (spec.conditions[k][0] for k in ("speed", "steady_from", "steady_until"))
    run_up = abs(speed) / ACCELERATION
    if spec.name.startswith("sweep_"):
        last = end + SETTLE_TIME
        profile = SpeedProfile(
            (0.0, run_up, begin, end, last, last + run_up), (0.0, -speed, -speed, speed, speed, 0.0)
        )
    else:
        last = end + STOP_MARGIN
        profile = SpeedProfile((0.0, run_up, last, last + run_up), (0.0, speed, speed, 0.0))
    return Task(profile, fed, record_every=spec.record_every)


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
    with naming(recording):
        cut = cut_turns(time, setpoint, torque_constant * found.controller[used], count)
        # The table is the same in each turn: the last one shows it.
        last = slice(-(len(time) // count) - SPARE_SAMPLES, None)
        learned = torque_constant * found.learned[used][last]
        table = cut_turns(time[last], setpoint[last], learned, 1).torque[0]
    everything = np.ones(table.size, dtype=np.bool_)
    return Turned(speed, cut, Cycles(cut.period, cut.torque, table, everything))


def _steady_part(recording: Recording, time: Array) -> slice:
    begin = time[0] if time.size else 0.0
    first, last = np.searchsorted(
        time - begin, [recording.condition("steady_from"), recording.condition("steady_until")]
    )
    return slice(int(first), int(last))


def learned_by(item: Turned, learning: Learning, positions: int) -> Row:
    """Return the torque that an update learns by angle, on top of a table that was switched on."""
    return learned_row(item.turns, item.speed, learning, positions, item.cycles.before)


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
        off, on = (
            torque_row(one.turns, item.speed, learning, positions)
            for one in (known[item.speed], item)
        )
        found.append((off, on, applied))
    rows_before, rows_after, torques = zip(*found, strict=True)
    return Remaining(turn_angles(positions), rows_before, rows_after, np.stack(torques))


def require_friction_fed(
    recording: Recording, torque_constant: float, fed: dict[str, Quantity]
) -> None:
    """Raise `RunFileError` unless the turns were made with the friction that is given."""
    time = recording.read("time")
    current = recording.read("feedforward_current")[_steady_part(recording, time)]
    recorded = torque_constant * float(current.mean()) if current.size else 0.0
    common.require_friction_fed(recording.name, recorded, recording.condition("speed"), fed)


T = TypeVar("T", bound=TaughtTable)


class BareMotor(Implementation[T]):
    """Learning by angle from whole turns of the bare motor."""

    BARE_MOTOR = True
    LEARNED_FROM: ClassVar[str] = "controller torque"

    # -- given by each implementation

    @abstractmethod
    def before(self, taught: T, first: Sequence[Recording]) -> list[Turned]:
        """Return turns without the table, at the speeds at which it is switched on."""

    @abstractmethod
    def learned_speeds(self, taught: T) -> Collection[float]:
        """Return the speeds at which the table was learned, rad/s."""

    @abstractmethod
    def learned_notes(self, taught: T) -> list[str]:
        """State where the table was learned."""

    @abstractmethod
    def without_tuning(self, taught: T) -> LookupTable:
        """Return the table without low-speed or tuning tables, for the sweep."""

    def learned_tables(self, taught: T) -> dict[str, Table]:
        """Return the results of the learning beside the table itself."""
        return {}

    def extra_results(self) -> dict[str, Quantity]:
        """Return results of this implementation alone."""
        return {}

    def judged(self, taught: T, after: Sequence[Turned]) -> Sequence[Turned]:
        """Return which turns with the table on continue the history of the learning runs."""
        return after

    # -- common to both

    def task(self, spec: RecordingSpec, fed: Feedforward) -> Task:
        """Return the task of a recording with this feed-forward."""
        return task(spec, fed)

    def fed(self, taught: T) -> Feedforward:
        """Return the feed-forward with the table on."""
        return replace(self.plain, table=taught.table)

    def swept(self, taught: T) -> Feedforward:
        """Return the feed-forward of the sweep without low-speed or tuning tables."""
        return replace(self.plain, table=self.without_tuning(taught))

    def require_friction_fed(self, recording: Recording) -> None:
        """Raise `RunFileError` unless the friction that is given was fed forward."""
        require_friction_fed(recording, self.torque_constant, self.friction)

    def turned(self, recordings: Iterable[Recording]) -> list[Turned]:
        """Cut recordings into turns."""
        return [turned(recording, self.recipe, self.torque_constant) for recording in recordings]

    def judge(self, found: Sequence[Turned], updates: int) -> LearningRun:
        """Judge a learning run: all its speeds together."""
        return learning_run([item.cycles for item in found], self.learning, updates)

    def report(
        self, run: Run, taught: T, recorded: Sequence[Sequence[Recording]]
    ) -> LearningReport:
        """Report the table, and the remaining disturbance with it on."""
        filters, history = self.filters.learning, taught.history
        after = self.turned(run.recordings_of("validate"))
        counts = self.recipe.rig.encoder_counts
        remains = remaining(self.before(taught, recorded[0]), after, filters, counts)
        if len(history) == 1 or not history[-1].finished:  # else that table was on already
            history = [*history, self.judge(self.judged(taught, after), len(history))]
        validated = self._validated(run, remains, self.learned_speeds(taught))
        swept = self._sweep(run)
        sweep = Outcome({}) if swept is None else swept.outcome()
        table = taught.table
        return LearningReport(
            {
                **remains.results(),
                **period_results(table),
                **self.extra_results(),
                **validated.results,
                **sweep.results,
            },
            {
                **tables_of(table, taught.u, taught.amplitudes, taught.dof),
                **self.learned_tables(taught),
                "iterations": iterations_table(history, "N m", self.LEARNED_FROM),
                **remains.tables(),
                **validated.tables,
                **sweep.tables,
            },
            tuple(self.learned_notes(taught)),
            remains.notes(self._sampled(table, remains), SAME_TABLE),
            validated,
        )

    def _validated(self, run: Run, remains: Remaining, learned: Collection[float]) -> Outcome:
        """Compare table off and on where it was learned, tuned, and in between, if recorded."""
        filters, counts = self.filters.learning, self.recipe.rig.encoder_counts

        def rows(*kinds: str) -> dict[float, Row]:
            items = self.turned(r for kind in kinds for r in run.recordings_named(f"{kind}_"))
            return {i.speed: torque_row(i.turns, i.speed, filters, counts) for i in items}

        on = rows("on")
        if not on:
            return Outcome({})
        off = rows("low", "off")
        midway = {TURN * speed for speed in between(self.recipe)}
        pairs = [*zip(remains.before, remains.after, strict=True)]
        pairs += [(off[speed], after) for speed, after in on.items() if speed in off]

        def kind(speed: float) -> str:
            if speed in learned:
                return "learned"
            return "between" if speed in midway else "tuned"

        return steady_outcome([Steady(*pair, kind(pair[1].speed)) for pair in pairs])

    def _sweep(self, run: Run) -> Sweep | None:
        """Return the sweeps of a run; None where it holds none."""
        recorded = {r.name: r for r in run.recordings_named("sweep_")}
        if not recorded.keys() >= {f"sweep_{variant}" for variant in SWEEP_NAMES}:
            return None
        torque = {}
        for variant in SWEEP_NAMES:
            recording = recorded[f"sweep_{variant}"]
            found = common.signals(recording, self.recipe)
            used = _steady_part(recording, found.time)
            # Q takes the recording for one period: it begins and ends at rest.
            period = float(found.time[-1] - found.time[0]) * len(found.time) / (len(found.time) - 1)
            controller = self.torque_constant * found.controller
            torque[variant] = self.filters.learning.smoothed(controller, period)[used]
        speed = np.gradient(found.setpoint, found.time)[used]
        return Sweep(found.time[used], speed, torque, self.torque_constant * found.learned[used])

    def _sampled(self, table: LookupTable, remains: Remaining) -> Array:
        """Return the torques of a table by speed and angle (speeds, positions) as recorded.

        A recorded sample is the mean over the angle of several samples of the loop; interpolated
        between samples it is a mean over three such angles.
        """
        speed, count = np.array([row.speed for row in remains.after]), remains.position.size
        torque = table.evaluate(
            np.tile(remains.position, speed.size), np.repeat(speed, count)
        ).reshape(-1, count)
        interval = self.recipe.ilc_learn.turning.record_every * self.recipe.rig.sample_time
        passed = np.outer(interval * speed / TURN, np.arange(count // 2 + 1))
        return np.fft.irfft(np.fft.rfft(torque) * np.sinc(passed) ** 3, count)
