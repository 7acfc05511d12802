"""The analysis of stored runs, in place of measuring: of rigtool's own recordings, or imported."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from functools import partial

from rigtool.errors import RunFileError, UsageError
from rigtool.experiments.outcome import Outcome
from rigtool.experiments.procedure import Procedure
from rigtool.experiments.running.options import CommonOptions
from rigtool.recipe import Recipe, override_recipe
from rigtool.runfile import Run, RunWriter, open_run
from rigtool.runfile.schema import IMPORT


def analyse_stored(
    procedure: Procedure,
    sources: Sequence[str],
    output: str,
    options: CommonOptions,
    inputs: Mapping[str, Run],
) -> Outcome:
    """Analyse stored runs again, write the output and return its outcome.

    Raises `RunFileError` for a run without a recipe.
    """
    require_nothing_to_measure(options)
    with ExitStack() as stack:
        runs = [stack.enter_context(open_run(source)) for source in sources]
        recipe: Recipe | None = None  # imported runs take its place
        analyse: Callable[..., Outcome]
        if runs[0].command == IMPORT and procedure.analyse_imported is not None:
            for run in runs:
                run.require_command(IMPORT)
            settings = _imported_settings(procedure.imported_settings, options.overrides)
            analyse = partial(procedure.analyse_imported, runs, **settings)
        else:
            recipe = _recipe_of(procedure, runs, options.overrides)
            require_inputs(procedure, inputs)
            analyse = partial(procedure.analyse, runs, recipe)
        with RunWriter(
            output,
            command=procedure.command,
            recipe=recipe,
            inputs=[*runs, *inputs.values()],
            overwrite=options.overwrite,
            rig=runs[0].rig,
        ) as writer:
            outcome = analyse(**inputs)
            writer.finish(outcome.results, outcome.tables, outcome.notes)
    return outcome


def _recipe_of(procedure: Procedure, runs: Sequence[Run], overrides: Sequence[str]) -> Recipe:
    """Return the recipe of runs that this procedure analyses, with other settings of that."""
    for run in runs:
        run.require_command(procedure.command, *procedure.accepts)
        run.forget_tables()
    if (recipe := runs[0].recipe) is None:
        raise RunFileError(
            f"{runs[0].path}: holds no recipe, so the rig's geometry is unknown: "
            "analyse a run that rigtool recorded, or the imported runs themselves"
        )
    return _as_recorded(procedure, recipe, overrides)


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


def require_inputs(procedure: Procedure, inputs: Mapping[str, Run]) -> None:
    """Raise `UsageError` where an input is missing that a procedure needs."""
    for name in procedure.needed:
        if name not in inputs:
            raise UsageError(
                f"--{name} is missing: {procedure.command} needs the run of calibrate-kt, unless "
                "all sources are imported runs"
            )
