"""Signals given as arrays: analysed like recordings of a recipe's rig."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from rigtool.errors import UsageError
from rigtool.experiments.outcome import Outcome
from rigtool.experiments.procedure import Procedure
from rigtool.experiments.running.options import CommonOptions
from rigtool.experiments.running.session import solvable
from rigtool.experiments.running.stored import require_inputs, require_nothing_to_measure
from rigtool.inputs import PathName
from rigtool.numerics.arrays import Array
from rigtool.recipe import Recipe, load_recipe, override_recipe
from rigtool.runfile import RecordingSpec, Run, RunWriter

if TYPE_CHECKING:
    import pandas as pd

    Signals = Mapping[str, ArrayLike] | pd.DataFrame

SAME_INTERVAL = 0.05
"""Relative difference of sampling intervals that clocks explain; a factor of 2 is another rate."""

NOTE = "the signals were given as arrays, not recorded by rigtool"


@solvable()
def analyse_arrays(
    procedure: Procedure,
    arrays: Mapping[str, Signals],
    recipe: PathName | Recipe,
    output: str,
    *,
    options: CommonOptions,
    inputs: Mapping[str, Run],
) -> Outcome:
    """Store arrays as recordings of a recipe, analyse them, and return the outcome.

    `arrays` maps names of recordings to their signals (n,), in the units of run files; conditions
    of a recording, its speed for instance, are those that the recipe plans. Raises `UsageError` for
    arrays that are no recording of this procedure and recipe.
    """
    require_nothing_to_measure(options)
    require_inputs(procedure, inputs)
    overrides = [*options.overrides, *(["rig.attachment=pulley"] if procedure.bare_motor else [])]
    if isinstance(recipe, Recipe):
        known, text = override_recipe(recipe, overrides), None
    else:
        known, text = load_recipe(os.fspath(recipe), overrides)
    plan = {spec.name: spec for spec in procedure.recordings(known)}
    if not arrays or not arrays.keys() <= plan.keys():
        unknown = ", ".join(map(str, arrays.keys() - plan.keys())) or "nothing"
        raise UsageError(
            f"{procedure.command}: {unknown} is given, recordings of this recipe are "
            f"{', '.join(plan)}"
        )
    given = {name: _signals(plan[name], signals) for name, signals in arrays.items()}
    specs = []
    for name, signals in given.items():
        _require_rate(plan[name], signals["time"], known.rig.sample_time)
        own = (item for item in plan[name].channels if item.name in signals)
        exact = tuple(replace(item, dtype="f8") for item in own)  # without loss of digits
        specs.append(replace(plan[name], channels=exact))
    with RunWriter(
        output,
        command=procedure.command,
        recipe=known,
        recipe_text=text,
        recordings=specs,
        inputs=list(inputs.values()),
        overwrite=options.overwrite,
        copied=True,
    ) as writer:
        for name, signals in given.items():
            writer.append(name, signals)
        outcome = procedure.analyse([writer.recorded()], known, **inputs)
        outcome = replace(outcome, notes=(NOTE, *outcome.notes))
        writer.finish(outcome.results, outcome.tables, outcome.notes)
    return outcome


def _signals(spec: RecordingSpec, signals: Signals) -> dict[str, Array]:
    """Return the signals of a recording as f8; `UsageError` where they are none of it."""
    units = {channel.name: channel.unit for channel in spec.channels}
    known = ", ".join(f"{name} [{unit}]" for name, unit in units.items())
    if not hasattr(signals, "keys"):
        what = type(signals).__name__
        raise UsageError(f"{spec.name}: is a {what}: give a DataFrame or mapping of {known}")
    stated = getattr(signals, "attrs", {}).get("units", {})
    if not isinstance(stated, Mapping):
        raise UsageError(f"{spec.name}: attrs['units'] is {stated!r}: map signals to their units")
    found = {}
    for name in signals:
        if name not in units:
            raise UsageError(f"{spec.name}: has no signal {name!r}; its signals are {known}")
        if stated.get(name, units[name]) != units[name]:
            raise UsageError(
                f"{spec.name}: {name} is in {stated[name]}, but must be in {units[name]}"
            )
        found[name] = _numbers(f"{spec.name}: {name}", signals[name])
    if "time" not in found or len(found) < 2:
        raise UsageError(f"{spec.name}: needs time and a measured signal; its signals are {known}")
    sizes = {name: values.size for name, values in found.items()}
    if len(set(sizes.values())) > 1:
        raise UsageError(f"{spec.name}: signals differ in their number of samples: {sizes}")
    if not (np.diff(found["time"]) > 0).all() or found["time"].size < 2:
        raise UsageError(f"{spec.name}: time must rise from each of 2 or more samples to the next")
    return found


def _numbers(what: str, values: Any) -> Array:
    if isinstance(values, np.ma.MaskedArray) and np.ma.is_masked(values):
        raise UsageError(f"{what}: {np.ma.count_masked(values)} samples are masked: leave them out")
    try:
        found = np.asarray(values)
        if found.dtype.kind in "cmMV":
            raise TypeError(f"its type is {found.dtype}")
        found = np.asarray(found, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise UsageError(f"{what}: is no array of numbers: {error}") from None
    if found.ndim != 1:
        raise UsageError(f"{what}: has shape {found.shape}, but must have one dimension")
    return found


def _require_rate(spec: RecordingSpec, time: Array, sample_time: float) -> None:
    """Raise `UsageError` unless samples are as far apart as the recipe plans."""
    found, planned = float(np.median(np.diff(time))), spec.record_every * sample_time
    if abs(found / planned - 1) > SAME_INTERVAL:
        raise UsageError(
            f"{spec.name}: samples are {found:.4g} s apart, by the recipe {planned:.4g} s: set "
            "record_every of this command, or rig.sample_time, as the signals were recorded"
        )
