"""One rig: drawn, measured by the command itself, compared with the truth."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from designs import DESIGNS, Design, Step, group
from drawn_rigs import Settings

from rigtool.errors import InsufficientDataError
from rigtool.experiments.outcome import Outcome
from rigtool.experiments.running.options import CommonOptions
from rigtool.experiments.running.session import run_command
from rigtool.recipe import load_recipe
from rigtool.runfile import open_run

RECIPE = Path(__file__).parents[1] / "recipes" / "briaire-2006.toml"


@dataclass(frozen=True)
class Trial:
    """One rig: by result, error, standard uncertainty and degrees of freedom; or the refusal."""

    seed: int
    found: dict[tuple[str, int], tuple[float, float, float]]
    refusal: str | None


def trials(numbers: Sequence[int], seed: int) -> list[Trial]:
    """Draw one rig, run each design on it and compare its results with the truth.

    The rig is that of the first in the `group` of the designs; steps that they share run once.
    """
    first, *_ = group(numbers[0])
    drawn = DESIGNS[first].draw(np.random.default_rng([0xC0FE, first, seed]))
    done: dict[int, tuple[Outcome, Path]] = {}
    with tempfile.TemporaryDirectory() as folder:
        return [trial(DESIGNS[number], drawn, seed, Path(folder), done) for number in numbers]


def trial(
    design: Design, drawn: Settings, seed: int, folder: Path, done: dict[int, tuple[Outcome, Path]]
) -> Trial:
    """Run a design on a drawn rig and compare its results with the truth."""
    try:
        outcome = perform(design.step, drawn, seed, folder, done)
    except InsufficientDataError as error:
        return Trial(seed, {}, str(error))
    recipe, _ = load_recipe(RECIPE, settings_of(design.step, drawn, seed))
    found = {
        (name, number): (result.value - true, result.u, result.dof or math.inf)
        for number, (name, result, true) in enumerate(design.compare(outcome, recipe))
        if result.u is not None
    }
    return Trial(seed, found, None)


def settings_of(step: Step, drawn: Settings, seed: int) -> tuple[str, ...]:
    """Return the settings of a step on a drawn rig."""
    every = drawn | step.settings | {"virtual.seed": seed}
    return tuple(f"{name}={value}" for name, value in every.items())


def perform(
    step: Step, drawn: Settings, seed: int, folder: Path, done: dict[int, tuple[Outcome, Path]]
) -> Outcome:
    """Run a step after those that its inputs come from; each of `done` has run already."""
    if id(step) not in done:
        for before in step.inputs.values():
            perform(before, drawn, seed, folder, done)
        output = folder / f"{len(done)}.h5"
        options = CommonOptions(overwrite=True, overrides=settings_of(step, drawn, seed))
        with ExitStack() as stack:
            inputs = {
                name: stack.enter_context(open_run(done[id(before)][1]))
                for name, before in step.inputs.items()
            }
            outcome = run_command(
                step.procedure, [str(RECIPE)], str(output), options=options, inputs=inputs
            )
        done[id(step)] = outcome, output
    return done[id(step)][0]
