"""How often stated intervals hold what they were computed for, on virtual rigs drawn anew.

    make coverage
    .venv/bin/python benchmarks/coverage.py [--rigs 40] [--first 1] [--only NAME] [--list]

Each design of `DESIGNS` is one way to use a command: what the recipe says, and what is drawn for
each rig (constants, frictions, noises, ripple; errors of arm and gauge from their stated standard
uncertainty). A pull is (result - truth)/u. `holds` counts intervals of 95 %, u times the quantile
of Student's t with the result's degrees of freedom, that contain the truth; the range behind it is
its 95 % interval (Clopper & Pearson, Biometrika 26, 404, 1934). `refused` counts the rigs for which
the command states that the data do not carry a result.
"""

from __future__ import annotations

if __name__ == "coverage":
    # numba looks for the package of this name, which measures which lines run, and finds this file.
    raise ImportError("benchmarks/coverage.py is a script")

import argparse
import math
import re
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from designs import DESIGNS, Step
from drawn_rigs import Settings
from numpy.typing import NDArray
from scipy import stats

from rigtool.errors import InsufficientDataError
from rigtool.experiments.outcome import Outcome
from rigtool.experiments.running.options import CommonOptions
from rigtool.experiments.running.session import run_command
from rigtool.recipe import load_recipe
from rigtool.runfile import open_run

RECIPE = Path(__file__).parents[1] / "recipes" / "briaire-2006.toml"
FAR = 5.0
"""Pull that no result may exceed."""


@dataclass(frozen=True)
class Trial:
    """One rig: by result, error, standard uncertainty and degrees of freedom; or the refusal."""

    seed: int
    found: dict[tuple[str, int], tuple[float, float, float]]
    refusal: str | None


# -- trials


def trial(design_number: int, seed: int) -> Trial:
    """Draw one rig, run the command on it and compare its results with the truth."""
    design = DESIGNS[design_number]
    drawn = design.draw(np.random.default_rng([0xC0FE, design_number, seed]))
    with tempfile.TemporaryDirectory() as folder:
        done: dict[int, tuple[Outcome, Path]] = {}
        try:
            outcome = perform(design.step, drawn, seed, Path(folder), done)
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
        options = CommonOptions(
            overwrite=True, quiet=True, overrides=settings_of(step, drawn, seed)
        )
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


@dataclass(frozen=True)
class Row:
    """Coverage of one result over the rigs of a design."""

    name: str
    count: int
    held: int
    mean: float
    std: float
    far: int

    @classmethod
    def of(cls, name: str, errors: NDArray[np.float64]) -> Row:
        """Return the row of errors (n, 3): error, standard uncertainty, degrees of freedom."""
        error, u, dof = errors.T
        pull = error / np.maximum(u, 1e-300)
        held = np.abs(pull) <= stats.t.ppf(0.975, dof)
        beyond = np.abs(pull) > FAR * stats.t.ppf(0.975, dof) / stats.norm.ppf(0.975)
        return cls(name, len(u), int(held.sum()), pull.mean(), pull.std(), int(beyond.sum()))

    def __str__(self) -> str:
        interval = stats.binomtest(self.held, self.count).proportion_ci()
        return (
            f"  {self.name:42}{self.count:4}{100 * self.held / self.count:7.0f} "
            f"({100 * interval.low:3.0f}-{100 * interval.high:3.0f}){self.mean:+8.2f}"
            f"{self.std:6.2f}{self.far:5}"
        )


def print_design(name: str, trials: Sequence[Trial]) -> None:
    """Print the rows of one design, and why rigs were refused."""
    # Refusals for the same reason differ in their numbers.
    reasons = [trial.refusal for trial in trials if trial.refusal is not None]
    refusals = Counter(re.sub(r"-?\d[\d.e-]*", "#", reason) for reason in reasons)
    print(f"{name}: {len(trials)} rigs, {refusals.total()} refused")
    for row in rows(trials):
        print(row)
    for refusal, count in refusals.most_common():
        print(f"  refused {count}: {refusal}")


def rows(trials: Sequence[Trial]) -> Iterator[Row]:
    """Yield the coverage of each result."""
    found: dict[str, list[tuple[float, float, float]]] = {}
    for trial in trials:
        for (name, _), errors in trial.found.items():
            found.setdefault(name, []).append(errors)
    for name, errors in found.items():
        yield Row.of(name, np.array(errors))


def main() -> None:
    """Try every design and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rigs", type=int, default=40, help="drawn for each design")
    parser.add_argument("--first", type=int, default=1, help="seed of the first rig")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--only", help="designs whose name contains this")
    parser.add_argument("--list", action="store_true", help="name the designs")
    arguments = parser.parse_args()
    chosen = [n for n, d in enumerate(DESIGNS) if (arguments.only or "") in d.name]
    if arguments.list:
        print("\n".join(DESIGNS[number].name for number in chosen))
        return
    print(f"{'result':44}{'n':>4}{'holds, % (interval)':>20}{'pull':>5}{'std':>7}{'far':>5}")
    seeds = range(arguments.first, arguments.first + arguments.rigs)
    with ProcessPoolExecutor(arguments.jobs) as pool:
        for number in chosen:
            tried = pool.map(trial, [number] * len(seeds), seeds)
            print_design(DESIGNS[number].name, list(tried))


if __name__ == "__main__":
    main()
