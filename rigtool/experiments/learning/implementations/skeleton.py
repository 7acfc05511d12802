"""The common part of all implementations of `ilc-learn`; each adds the rest in its methods.

A first run is recorded without a table. Each further run is recorded with the table learned so far,
until nothing is left to learn or all runs are made [Fig. 44]. Then the moves are repeated with the
final table, or signal, switched on. The analysis of a stored run learns from its recordings in the
same order.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Generic, Protocol, TypeVar

from rigtool.control.lookup_table import LookupTable
from rigtool.experiments.learning.convergence import LearningRun
from rigtool.experiments.learning.filters import Learning
from rigtool.experiments.learning.implementations.runs import (
    iterations_notes,
    kind_of,
    recorded_runs,
    runs_at_most,
)
from rigtool.experiments.learning.implementations.signals import record_loop
from rigtool.experiments.learning.procedure_design import FilterDesign, design_filters
from rigtool.experiments.learning.rows import Amplitudes
from rigtool.experiments.learning.stored_table import feedforward, friction_results
from rigtool.experiments.outcome import Outcome
from rigtool.experiments.procedure import only_run
from rigtool.experiments.torque_per_ampere import torque_per_ampere
from rigtool.numerics.arrays import Array
from rigtool.quantity import Quantity
from rigtool.recipe import Recipe
from rigtool.rigs import Feedforward, Rig, Task
from rigtool.runfile import Recording, RecordingSpec, Run, RunWriter, Table


class Taught(Protocol):
    """Table or torque that results from learning runs."""

    @property
    def history(self) -> Sequence[LearningRun]:
        """All learning runs so far, judged."""


T = TypeVar("T", bound=Taught)


@dataclass(frozen=True, eq=False)
class TaughtTable:
    """A learned table, its standard uncertainty and amplitude table, and all runs judged.

    `dof` (speeds,) are the degrees of freedom of `u`.
    """

    table: LookupTable
    u: Array
    dof: Array
    amplitudes: Amplitudes
    history: list[LearningRun]


@dataclass(frozen=True)
class LearningReport:
    """Results and notes of an implementation on a run.

    Notes are about the `learned` table, about motion with it switched on, and at other speeds.
    """

    results: Mapping[str, Quantity]
    tables: Mapping[str, Table]
    learned: tuple[str, ...]
    switched_on: tuple[str, ...] = ()
    validated: Outcome = field(default_factory=lambda: Outcome({}))


class Implementation(ABC, Generic[T]):
    """One way to learn, for a recipe and the runs that it takes its numbers from.

    `plain` is the feed-forward without anything learned: inertia and, if given, friction.
    """

    BARE_MOTOR: ClassVar[bool] = False
    """Whether the shaft turns continuously, which no instrument can follow."""

    RIG_NEED: ClassVar[str] = "table"
    """Abilities that a rig needs to apply the learned torque."""

    UNIT: ClassVar[str] = "mN m"
    """A thousandth of the unit of the signal that is learned from."""

    recipe: Recipe
    torque_constant: float
    filters: FilterDesign
    friction: dict[str, Quantity]
    plain: Feedforward

    def __init__(
        self, recipe: Recipe, *, kt: Run, friction: Run | None = None, plant: Run | None = None
    ) -> None:
        self.require(recipe, friction)
        self.recipe = recipe
        self.filters = design_filters(recipe, plant)
        self.torque_constant = torque_per_ampere(kt).value
        self.friction = friction_results(friction)
        # An error of the inertia leaves a torque of every turn-around in the first positions.
        inertia = (
            recipe.rig.nominal_inertia if plant is None else plant.result("inertia", "kg m2").value
        )
        self.plain = feedforward(inertia, self.friction)

    # -- given by each implementation

    @staticmethod
    @abstractmethod
    def kinds(recipe: Recipe) -> dict[str, list[RecordingSpec]]:
        """Return all recordings by kind, in the order of the run file."""

    @abstractmethod
    def task(self, spec: RecordingSpec, fed: Feedforward) -> Task:
        """Return the task of a recording with this feed-forward."""

    @abstractmethod
    def learn(self, runs: Sequence[Sequence[Recording]], slower: Sequence[Recording]) -> T:
        """Return the table from all runs so far, and from recordings at `low` speeds, if any."""

    @abstractmethod
    def fed(self, taught: T) -> Feedforward:
        """Return the feed-forward with the learned table switched on."""

    @abstractmethod
    def report(
        self, run: Run, taught: T, recorded: Sequence[Sequence[Recording]]
    ) -> LearningReport:
        """Report the learned table and the remainder with it switched on."""

    def require(self, recipe: Recipe, friction: Run | None) -> None:
        """Raise an error where this implementation cannot learn from recipe and inputs."""

    def require_friction_fed(self, recording: Recording) -> None:
        """Raise `RunFileError` unless the friction that is given was fed forward."""

    def finish(self, taught: T, others: Sequence[Recording]) -> T:
        """Return the table, tuned by recordings at other speeds, if any."""
        return taught

    def swept(self, taught: T) -> Feedforward:
        """Return the feed-forward of the sweep without low-speed or tuning tables."""
        return self.fed(taught)

    @property
    def learning(self) -> Learning:
        """The filters that are learned with."""
        return self.filters.learning

    # -- common to all

    @classmethod
    def recordings(cls, recipe: Recipe) -> tuple[RecordingSpec, ...]:
        """List all recordings that may be made."""
        return tuple(spec for specs in cls.kinds(recipe).values() for spec in specs)

    @classmethod
    def measure(cls, rig: Rig, recipe: Recipe, recorder: RunWriter, **inputs: Any) -> None:
        """Learn run by run, and record the remainder with the learned table switched on."""
        cls(recipe, **inputs)._measure(rig, recorder)

    @classmethod
    def analyse(cls, runs: Sequence[Run], recipe: Recipe, **inputs: Any) -> Outcome:
        """Learn from stored recordings, and report the remainder.

        Raises `UsageError` for several runs, `InsufficientDataError` where the recordings do not
        carry a result.
        """
        return cls(recipe, **inputs)._analyse(only_run(runs, "ilc-learn", "speeds"))

    def _measure(self, rig: Rig, recorder: RunWriter) -> None:
        kinds = self.kinds(self.recipe)

        def perform(kind: str, fed: Feedforward) -> list[Recording]:
            specs = kinds.get(kind, [])
            for spec in specs:
                record_loop(rig, self.recipe, self.task(spec, fed), recorder, spec.name)
            return [recorder.recording(spec.name) for spec in specs]

        runs = [perform("learn", self.plain)]
        slower = perform("low", self.plain)
        taught = self.learn(runs, slower)
        while len(runs) < runs_at_most(self.recipe) and not taught.history[-1].finished:
            runs.append(perform(kind_of(len(runs)), self.fed(taught)))
            taught = self.learn(runs, slower)
        taught = self.finish(taught, perform("tune", self.plain))
        final, swept = self.fed(taught), self.swept(taught)
        for kind, fed in {
            "validate": final,
            "off": self.plain,
            "on": final,
            "sweep_off": self.plain,
            "sweep_plain": swept,
            "sweep_on": final,
        }.items():
            perform(kind, fed)

    def _analyse(self, run: Run) -> Outcome:
        recorded = recorded_runs(run, self.recipe)
        self.require_friction_fed(recorded[0][0])
        tuned = run.recordings_of("tune") if "tune" in self.kinds(self.recipe) else []
        taught = self.finish(self.learn(recorded, run.recordings_named("low_")), tuned)
        report = self.report(run, taught, recorded)
        most = runs_at_most(self.recipe)
        return Outcome(
            {**report.results, **self.filters.results(), **self.friction},
            {**report.tables, **self.filters.tables()},
            (
                *report.learned,
                *self.filters.origin,
                *report.switched_on,
                *iterations_notes(taught.history, self.UNIT, most),
                *report.validated.notes,
            ),
        )
