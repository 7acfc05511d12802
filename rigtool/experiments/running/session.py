"""From sources to an outcome: the steps that all measuring commands share.

A source is a recipe (measure on its rig, then analyse) or run files (analyse their signals).
"""

from __future__ import annotations

import logging
import math
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from rigtool.errors import (
    NO_RESULT_REMEDY,
    InsufficientDataError,
    RecipeError,
    RunFileError,
    UsageError,
)
from rigtool.experiments.outcome import Outcome
from rigtool.experiments.procedure import Procedure
from rigtool.experiments.running.dry_run import dry_run, rehearse, require_gauges, require_offered
from rigtool.experiments.running.lines import open_lines
from rigtool.experiments.running.options import CommonOptions
from rigtool.experiments.running.terminal import open_live
from rigtool.experiments.torque_per_ampere import torque_per_ampere
from rigtool.inputs import is_recipe
from rigtool.recipe import Recipe, load_recipe, override_recipe
from rigtool.rigs import Block, Rig, open_rig
from rigtool.rigs.operator import Operator
from rigtool.runfile import RecordingSpec, Run, RunWriter, chunk_of, open_run
from rigtool.runfile.outputs import require_output
from rigtool.runfile.schema import IMPORT

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
        require_nothing_to_measure(options)
        return _analyse_stored(procedure, sources, output, options, inputs)
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
    overrides = list(options.overrides)
    if options.seed is not None:
        overrides.append(f"virtual.seed={options.seed}")
    recipe, text = load_recipe(source, overrides)
    _log.info("recipe %s, rig %s", source, recipe.rig.name)
    if procedure.bare_motor:
        recipe = override_recipe(recipe, ["rig.attachment=pulley"])
    on_line = recipe.rig.source == "serial"
    if on_line and options.seed is not None:
        raise UsageError(f"--seed {options.seed}: this recipe's rig is on a line, not virtual")
    if options.spy is not None and not on_line:
        raise UsageError(f"--spy {options.spy}: this recipe's rig is virtual, there is no line")
    if options.spy is not None:
        read: list[str | Path] = [source, *(run.path for run in inputs.values())]
        if require_output(options.spy, overwrite=options.overwrite, inputs=read) == Path(
            os.path.realpath(output)
        ):
            raise UsageError(f"--spy {options.spy}: is the output of this run: give another name")
    seed = recipe.virtual.seed if recipe.virtual is not None and not on_line else None
    kt = inputs.get("kt")
    constant = recipe.rig.torque_constant if kt is None else torque_per_ampere(kt).value
    if options.dry_run:
        return dry_run(procedure, recipe, constant, inputs)
    operator = Operator(yes=options.yes, spy=options.spy)
    rig = open_rig(recipe, constant, procedure.command, operator)
    if not rig.physical:
        rehearse(procedure, recipe, constant, inputs, evaluated=False)
    plan = procedure.recordings(recipe)
    rig.use_only({channel.name for spec in plan for channel in spec.channels})
    if rig.physical:
        # Where the program is killed, a second is lost. A virtual rig is a thousand times faster
        # than its clock: it may lose a large chunk.
        rates = [1 / (spec.record_every * recipe.rig.sample_time) for spec in plan]
        plan = tuple(
            replace(spec, chunk=chunk_of(rate)) for spec, rate in zip(plan, rates, strict=True)
        )
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


def require_nothing_to_measure(options: CommonOptions) -> None:
    """Raise `UsageError` for an option that has no meaning where signals are stored already."""
    if options.dry_run:
        raise UsageError("--dry-run: of stored runs nothing would move: leave it out")
    if options.seed is not None:
        raise UsageError(
            f"--seed {options.seed}: a stored run has its signals, nothing is drawn: leave it out"
        )
    if options.spy is not None:
        raise UsageError(f"--spy {options.spy}: stored runs need no line: leave it out")
    if options.live is not None:
        raise UsageError(
            "--live draws what is recorded, of stored runs nothing is: leave it out, and draw them "
            "with plot"
        )


def _analyse_stored(
    procedure: Procedure,
    sources: Sequence[str],
    output: str,
    options: CommonOptions,
    inputs: Mapping[str, Run],
) -> Outcome:
    with ExitStack() as stack:
        runs = [stack.enter_context(open_run(source)) for source in sources]
        if runs[0].command == IMPORT and procedure.analyse_imported is not None:
            return _analyse_imported(
                procedure, procedure.analyse_imported, runs, output, options, inputs
            )
        for run in runs:
            run.require_command(procedure.command, *procedure.accepts)
            run.forget_tables()
        require_inputs(procedure, inputs)
        recipe = runs[0].recipe
        if recipe is None:
            raise RunFileError(
                f"{sources[0]}: holds no recipe, so the rig's geometry is unknown: "
                "analyse a run that rigtool recorded"
            )
        recipe = _as_recorded(procedure, recipe, options.overrides)
        with RunWriter(
            output,
            command=procedure.command,
            recipe=recipe,
            inputs=[*runs, *inputs.values()],
            overwrite=options.overwrite,
        ) as writer:
            outcome = procedure.analyse(runs, recipe, **inputs)
            writer.finish(outcome.results, outcome.tables, outcome.notes)
    return outcome


def _as_recorded(procedure: Procedure, recipe: Recipe, overrides: Sequence[str]) -> Recipe:
    """Return the recipe of a stored run with other settings of its analysis.

    Raises `UsageError` for a setting that contradicts how the signals were recorded.
    """
    for override in overrides:
        key = override.partition("=")[0].strip()
        if key in procedure.analysis_settings or override_recipe(recipe, [override]) == recipe:
            continue
        known = ", ".join(procedure.analysis_settings)
        raise UsageError(
            f"--set {override}: a stored run stays as it was recorded: leave this out, or measure "
            f"again from the recipe; settings of the analysis by {procedure.command}: "
            f"{known or 'none'}"
        )
    return override_recipe(recipe, overrides)


def _analyse_imported(
    procedure: Procedure,
    analyse: Callable[..., Outcome],
    runs: Sequence[Run],
    output: str,
    options: CommonOptions,
    inputs: Mapping[str, Run],
) -> Outcome:
    """Analyse measurements of other rigs: their runs replace the recipe."""
    for run in runs:
        run.require_command(IMPORT)
    settings = _imported_settings(procedure.imported_settings, options.overrides)
    with RunWriter(
        output,
        command=procedure.command,
        inputs=[*runs, *inputs.values()],
        overwrite=options.overwrite,
        rig=runs[0].rig,
    ) as writer:
        outcome = analyse(runs, **inputs, **settings)
        writer.finish(outcome.results, outcome.tables, outcome.notes)
    return outcome


def _imported_settings(accepted: Mapping[str, str], overrides: Sequence[str]) -> dict[str, float]:
    """Return the values of `--set` by the argument names of the analysis of imported runs."""
    settings = {}
    for override in overrides:
        key, _, value = override.partition("=")
        if key.strip() not in accepted:
            raise UsageError(
                f"{override}: imported runs have no recipe: leave this out; the mapping file "
                "states what is known of the rig: change it there and import them again"
            )
        try:
            settings[accepted[key.strip()]] = number = float(value)
        except ValueError:
            number = math.nan
        if not 0 < number < math.inf:
            raise UsageError(f"--set {override}: must be a number above 0")
    return settings


def require_inputs(procedure: Procedure, inputs: Mapping[str, Run]) -> None:
    """Raise `UsageError` where an input is missing that a procedure needs."""
    for name in procedure.needed:
        if name not in inputs:
            raise UsageError(
                f"--{name} is missing: {procedure.command} needs the run of calibrate-kt, unless "
                "all sources are imported runs"
            )


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
