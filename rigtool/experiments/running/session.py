"""From sources to an outcome: the steps that all measuring commands share.

A source is a recipe (measure on its rig, then analyse) or run files (analyse their signals).
"""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from rigtool.errors import NO_RESULT_REMEDY, InsufficientDataError, RecipeError, UsageError
from rigtool.experiments.outcome import Outcome
from rigtool.experiments.procedure import Procedure
from rigtool.experiments.running.dry_run import dry_run, rehearse, require_gauges, require_offered
from rigtool.experiments.running.lines import open_lines
from rigtool.experiments.running.options import CommonOptions
from rigtool.experiments.running.stored import analyse_stored, require_inputs
from rigtool.experiments.running.terminal import open_live
from rigtool.experiments.torque_per_ampere import learned_constant, torque_per_ampere
from rigtool.inputs import is_recipe
from rigtool.recipe import Recipe, load_recipe, override_recipe
from rigtool.rigs import Block, Rig, open_rig
from rigtool.rigs.operator import Operator
from rigtool.runfile import RecordingSpec, Run, RunWriter, chunk_of
from rigtool.runfile.outputs import require_output

_log = logging.getLogger("rigtool")

STATUS_ONLY = "status while it moves, not recorded"
AS_IT_COMES = "as it comes"
"""Names in drawings of what a rig reports before the signals of a motion are complete."""


@contextmanager
def solvable() -> Iterator[None]:
    """Turn equations that have no solution into `InsufficientDataError`: signals that are zero,
    constant, or far from any rig's.
    """
    try:
        yield
    except np.linalg.LinAlgError as error:
        raised = InsufficientDataError(
            f"the signals determine no result ({error}): {NO_RESULT_REMEDY}"
        )
        for note in getattr(error, "__notes__", ()):
            raised.add_note(note)
        raise raised from error


@solvable()
def run_command(
    procedure: Procedure,
    sources: Sequence[str],
    output: str,
    *,
    options: CommonOptions,
    inputs: Mapping[str, Run],
) -> Outcome:
    """Measure or re-analyse, write the output and return its outcome.

    `inputs` are open runs by the name of their option. Raises `UsageError` for sources that do not
    go together.
    """
    recipes = [source for source in sources if is_recipe(source)]
    if not recipes:
        return analyse_stored(procedure, sources, output, options, inputs)
    if len(sources) > 1:
        raise UsageError(
            f"{len(sources)} sources with a recipe among them: give one recipe, or run files only"
        )
    return _measure(procedure, recipes[0], output, options, inputs)


def _measure(
    procedure: Procedure,
    source: str,
    output: str,
    options: CommonOptions,
    inputs: Mapping[str, Run],
) -> Outcome:
    require_inputs(procedure, inputs)
    recipe, text = _recipe_of(procedure, source, options)
    on_line = recipe.rig.source == "serial"
    _require_spy(options, output, [source, *(run.path for run in inputs.values())])
    seed = recipe.virtual.seed if recipe.virtual is not None and not on_line else None
    constant = _constant(recipe, inputs)
    if options.dry_run:
        return dry_run(procedure, recipe, constant, inputs)
    operator = Operator(yes=options.yes, spy=options.spy)
    rig = open_rig(recipe, constant, procedure.command, operator)
    if not rig.physical:
        rehearse(procedure, recipe, constant, inputs, evaluated=False)
    plan = procedure.recordings(recipe)
    rig.use_only({channel.name for spec in plan for channel in spec.channels})
    if rig.physical:
        plan = _in_small_chunks(plan, recipe)
    writer = _WatchedWriter(
        output,
        command=procedure.command,
        recipe=recipe,
        recipe_text=text,
        recordings=plan,
        inputs=list(inputs.values()),
        seed=seed,
        overwrite=options.overwrite,
        sources=[source, *([options.spy] if options.spy is not None else [])],
    )
    follow = _follower(procedure, options, recipe, rig, inputs)
    with _shown(options, follow, rig) as show, writer, _progress(options, plan, writer):
        writer.show = None if rig.streams else show
        if show is not None and (rig.streams or follow is None):
            rig.watcher = partial(show, AS_IT_COMES if rig.streams else STATUS_ONLY)
        with rig:
            if rig.physical:
                _permit(rig, procedure, recipe, constant, inputs)
            procedure.measure(rig, recipe, writer, **inputs)
        run = writer.recorded()
        _log.info("analysing %d recordings", len(run.recordings))
        if (report := rig.report()) is not None:
            run.provenance["line"] = report
            writer.note_line(report)
        outcome = procedure.analyse([run], recipe, **inputs)
        writer.finish(outcome.results, outcome.tables, outcome.notes)
    return outcome


def _constant(recipe: Recipe, inputs: Mapping[str, Run]) -> float:
    """Return the torque per ampere, N m/A, that makes current of the loop's torque: that of the
    learned tables, whose currents then are those that were learned, whatever `kt` states."""
    kt, tables = inputs.get("kt"), inputs.get("tables")
    learned = None if tables is None else learned_constant(tables)
    if learned is not None:
        return learned
    return recipe.rig.torque_constant if kt is None else torque_per_ampere(kt).value


def _recipe_of(procedure: Procedure, source: str, options: CommonOptions) -> tuple[Recipe, str]:
    """Return the recipe to measure with, and its text; `UsageError` for an option that does not go
    with its rig."""
    recipe, text = load_recipe(source, options.overrides)
    _log.info("recipe %s, rig %s", source, recipe.rig.name)
    on_line = recipe.rig.source == "serial"
    if options.seed is not None:
        if on_line:
            raise UsageError(f"--seed {options.seed}: this recipe's rig is on a line, not virtual")
        recipe = override_recipe(recipe, [f"virtual.seed={options.seed}"])
    if procedure.bare_motor:
        recipe = override_recipe(recipe, ["rig.attachment=pulley"])
    if options.spy is not None and not on_line:
        raise UsageError(f"--spy {options.spy}: this recipe's rig is virtual, there is no line")
    return recipe, text


def _require_spy(options: CommonOptions, output: str, read: Sequence[str | Path]) -> None:
    """Raise `UsageError` where the file for the bytes on the line cannot be written, or is read or
    written otherwise."""
    if options.spy is not None:
        spy = require_output(options.spy, overwrite=options.overwrite, inputs=read)
        if spy == Path(os.path.realpath(output)):
            raise UsageError(f"--spy {options.spy}: is the output of this run: give another name")


def _in_small_chunks(plan: Sequence[RecordingSpec], recipe: Recipe) -> tuple[RecordingSpec, ...]:
    """Return recordings of which a second is lost where the program is killed.

    A virtual rig is a thousand times faster than its clock: it may lose a large chunk.
    """
    rates = [1 / (spec.record_every * recipe.rig.sample_time) for spec in plan]
    return tuple(
        replace(spec, chunk=chunk_of(rate)) for spec, rate in zip(plan, rates, strict=True)
    )


def _follower(
    procedure: Procedure,
    options: CommonOptions,
    recipe: Recipe,
    rig: Rig,
    inputs: Mapping[str, Run],
) -> Callable[[Block], Block] | None:
    """Return the function that turns signals into the values that are shown; None to show the
    signals.

    Raises `RecipeError` where a stream is asked for and this rig or recipe cannot have one.
    """
    if procedure.follow is None or (options.live is None and not options.stream):
        return None
    comes = not rig.physical or rig.streams
    if options.stream and not comes:
        raise RecipeError(
            "--stream needs samples while the rig moves, and its drive hands them out later: use a "
            'target with serial.log = "stream"'
        )
    if not comes:
        return None
    try:
        return procedure.follow(recipe, **inputs)
    except RecipeError:
        if options.stream:
            raise
        return None  # signals are drawn as those of other commands


@contextmanager
def _shown(
    options: CommonOptions, follow: Callable[[Block], Block] | None, rig: Rig
) -> Iterator[Callable[[str, Block], None] | None]:
    """Return the function that shows a block of a recording, None where nothing is shown."""
    with ExitStack() as stack:
        shows: list[Callable[[str, Block], None]] = []
        if options.live is not None:
            shows.append(stack.enter_context(open_live(options.live)).show)
        if options.stream:
            shows.append(stack.enter_context(open_lines(waits=not rig.physical)).show)

        def show(recording: str, block: Block) -> None:
            values = block if follow is None else follow(block)
            for one in shows:
                one(recording, values)

        yield show if shows else None


def _permit(
    rig: Rig,
    procedure: Procedure,
    recipe: Recipe,
    torque_constant: float,
    inputs: Mapping[str, Run],
) -> None:
    """Refuse motions beyond the rig's abilities or limits, show the plan, and ask for consent."""
    plan = rehearse(procedure, recipe, torque_constant, inputs, rig.position)
    require_gauges(plan, recipe.line, procedure.command)
    require_offered(rig, plan, procedure.command)
    plan.check(recipe.line.limits)
    rig.permit(str(plan))


class _WatchedWriter(RunWriter):
    """A writer that also hands each block to live views and a progress bar."""

    show: Callable[[str, Block], None] | None = None
    _bar: Any = None
    _current: str | None = None

    def watch(self, bar: Any, order: Mapping[str, int]) -> None:
        """Advance a progress bar by one for each new recording."""
        self._bar, self._order = bar, order

    def append(self, recording: str, block: Mapping[str, Any]) -> None:
        """Append as the writer does, then move the bar."""
        if recording != self._current:
            self._current = recording
            _log.info("measuring: %s", recording)
        super().append(recording, block)
        if self.show is not None:
            self.show(recording, dict(block))
        if self._bar is not None:
            self._bar.label = recording
            self._bar.update(max(0, self._order[recording] - self._bar.pos))


@contextmanager
def _progress(
    options: CommonOptions, plan: Sequence[RecordingSpec], writer: _WatchedWriter
) -> Iterator[None]:
    if options.live == "terminal" or not options.progress:
        yield
        return
    import click

    with click.progressbar(length=len(plan), file=sys.stderr, show_eta=False) as bar:
        writer.watch(bar, {spec.name: number for number, spec in enumerate(plan)})
        yield
        bar.update(max(0, len(plan) - bar.pos))
