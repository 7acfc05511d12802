"""The commands as functions, for notebooks and scripts: `import rigtool` offers them.

Sources are those of the command, a recipe (.toml) or run files (.h5), or open runs, or arrays:
`{"staircase": signals}`, a recording's name with a DataFrame or mapping of its signals (n,), in the
units of run files, with the recipe of their rig. Inputs such as `kt` are run files or open runs.
Each function returns the `Outcome` of its command, and raises the `RigtoolError` that the command
prints; messages name the options of the command line.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, TypedDict, Unpack

from rigtool.api.arrays import analyse_arrays
from rigtool.errors import RigtoolError, UsageError
from rigtool.experiments.outcome import Outcome
from rigtool.experiments.procedure import Procedure
from rigtool.experiments.running.options import CommonOptions
from rigtool.experiments.running.session import run_command
from rigtool.inputs import is_recipe
from rigtool.quantity import Quantity
from rigtool.runfile import Run
from rigtool.runfile import open_run as open

if TYPE_CHECKING:
    from rigtool.api.arrays import Signals
    from rigtool.recipe import Recipe

    File = str | os.PathLike[str]
    Source = File | Run | Mapping[str, Signals]

__all__ = [
    "Outcome",
    "Quantity",
    "RigtoolError",
    "Run",
    "calibrate_kt",
    "fft_ripple",
    "identify_plant",
    "ilc_learn",
    "measure_force",
    "open",
    "stribeck",
]


class Options(TypedDict, total=False):
    """Arguments of each function beside its sources and inputs.

    `recipe` is that of arrays: a file, or `run.recipe`. `settings` are the `key=value` texts of
    `--set`. `output` is the run file to write; without it the outcome is returned only, which is
    refused where signals are measured. `overwrite`, `seed` and `yes` are as on the command line.
    """

    recipe: File | Recipe
    settings: Sequence[str]
    output: File
    overwrite: bool
    seed: int
    yes: bool


def calibrate_kt(*sources: Source, **options: Unpack[Options]) -> Outcome:
    """Find the torque constant against temperature [7.1.1]."""
    from rigtool.experiments.torque_constant.procedure import PROCEDURE

    return _call(PROCEDURE, sources, {}, **options)


def stribeck(
    *sources: Source,
    kt: File | Run | None = None,
    against: File | Run | None = None,
    reference: File | Run | None = None,
    **options: Unpack[Options],
) -> Outcome:
    """Find friction: Coulomb, viscous, static, and breakaway around the turn [7.1.2, 7.2.2].

    `against` is a stored run of the same motion or speeds: what changed; `reference` one with a
    known change: the ratio of the two changes.
    """
    from rigtool.experiments.friction.procedure import PROCEDURE

    inputs = {"kt": kt, "against": against, "reference": reference}
    return _call(PROCEDURE, sources, inputs, **options)


def fft_ripple(
    *sources: Source, kt: File | Run | None = None, **options: Unpack[Options]
) -> Outcome:
    """Measure torque ripple by order of rotation, speed and torque [7.1.3]."""
    from rigtool.experiments.ripple.procedure import PROCEDURE

    return _call(PROCEDURE, sources, {"kt": kt}, **options)


def identify_plant(
    *sources: Source, kt: File | Run | None = None, **options: Unpack[Options]
) -> Outcome:
    """Measure the frequency response of the plant; fit inertia and friction [7.2.3]."""
    from rigtool.experiments.plant.procedure import PROCEDURE

    return _call(PROCEDURE, sources, {"kt": kt}, **options)


def ilc_learn(
    *sources: Source,
    kt: File | Run | None = None,
    friction: File | Run | None = None,
    plant: File | Run | None = None,
    prior: File | Run | None = None,
    implementation: str | None = None,
    **options: Unpack[Options],
) -> Outcome:
    """Learn the disturbance that repeats with position and speed [7.2.4].

    `implementation` is the way to learn by the thesis's letter; without it, the recipe's. "D" on
    imported runs of known loads needs no recipe; two loads are enough with a `prior` of another
    mounting. Raises `UsageError` for a `prior` of other runs.
    """
    from rigtool.experiments.learning.procedure import PROCEDURE, asked, of_stored

    inputs = {"kt": kt, "friction": friction, "plant": plant, "prior": prior}
    stored = not any(map(_has_recipe, sources))
    if prior is not None and not (stored and implementation == "D"):
        raise UsageError("prior: is for imported runs with implementation D")
    if stored:
        return _call(of_stored(implementation), sources, inputs, **options)
    given = CommonOptions(overrides=tuple(options.get("settings", ())))
    options["settings"] = asked(given, implementation, validate=False).overrides
    return _call(PROCEDURE, sources, inputs, **options)


def measure_force(
    *sources: Source, tables: File | Run, kt: File | Run | None = None, **options: Unpack[Options]
) -> Outcome:
    """Measure known loads, reading force from current [8.1]."""
    from rigtool.experiments.force.procedure import PROCEDURE

    return _call(PROCEDURE, sources, {"kt": kt, "tables": tables}, **options)


def _call(
    procedure: Procedure,
    sources: Sequence[Source],
    inputs: Mapping[str, File | Run | None],
    *,
    recipe: File | Recipe | None = None,
    settings: Sequence[str] = (),
    output: File | None = None,
    overwrite: bool = False,
    seed: int | None = None,
    yes: bool = False,
) -> Outcome:
    """Run the command of a procedure, and return its outcome."""
    options = CommonOptions(overwrite=overwrite, seed=seed, overrides=tuple(settings), yes=yes)
    arrays = [source for source in sources if isinstance(source, Mapping)]
    paths = [_path(source) for source in sources if not isinstance(source, Mapping)]
    if len(arrays) > 1 or (arrays and paths) or not sources:
        raise UsageError(
            f"{procedure.command}: {len(sources)} sources, {len(arrays)} of them arrays: give one "
            "recipe, or run files, or one mapping of recordings to arrays"
        )
    if (recipe is None) == bool(arrays):
        raise UsageError(
            f"{procedure.command}: arrays need the recipe of their rig, as recipe=; a recipe to "
            "measure by is a source itself, and run files hold their own"
        )
    with ExitStack() as stack:
        if output is None:
            if any(map(_has_recipe, paths)):
                raise UsageError(f"{paths[0]}: output is missing: name a run file for the signals")
            output = Path(stack.enter_context(TemporaryDirectory())) / "arrays.h5"
        opened = {
            name: run if isinstance(run, Run) else stack.enter_context(open(run))
            for name, run in inputs.items()
            if run is not None
        }
        if recipe is None:
            return run_command(procedure, paths, os.fspath(output), options=options, inputs=opened)
        (given,) = arrays
        return analyse_arrays(
            procedure, given, recipe, os.fspath(output), options=options, inputs=opened
        )


def _has_recipe(source: Source) -> bool:
    """Return whether a source is a recipe, or arrays that come with one."""
    return isinstance(source, Mapping) or is_recipe(_path(source))


def _path(source: File | Run) -> str:
    if not isinstance(source, str | os.PathLike | Run):
        raise UsageError(
            f"a source is a {type(source).__name__}: give a path, an open run, or arrays by the "
            'name of their recording, e.g. {"staircase": signals}'
        )
    return str(source.path) if isinstance(source, Run) else os.fspath(source)
