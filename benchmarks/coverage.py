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
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from rigtool.errors import InsufficientDataError
from rigtool.experiments.procedure import Procedure
from rigtool.experiments.running.options import CommonOptions
from rigtool.experiments.running.session import run_command
from rigtool.experiments.torque_constant.procedure import PROCEDURE as CALIBRATE_KT
from rigtool.recipe import Recipe, load_recipe
from rigtool.rigs.virtual.maps import rotor_map

RECIPE = Path(__file__).parents[1] / "recipes" / "briaire-2006.toml"
FAR = 5.0
"""Pull that no result may exceed."""

Draw = Callable[[np.random.Generator], dict[str, object]]
"""Settings of one rig, as for `--set`."""
Truth = Callable[[Recipe], dict[str, float]]
"""What the results would be without any error."""


@dataclass(frozen=True)
class Design:
    """One way to use a command, and how its rigs are drawn."""

    name: str
    procedure: Procedure
    draw: Draw
    truth: Truth


@dataclass(frozen=True)
class Trial:
    """One rig: by result, error, standard uncertainty and degrees of freedom; or the refusal."""

    seed: int
    found: dict[str, tuple[float, float, float]]
    refusal: str | None


# -- calibrate-kt


def spread(rng: np.random.Generator, low: float, high: float) -> float:
    """Return a number drawn evenly on a logarithmic scale."""
    return float(np.exp(rng.uniform(math.log(low), math.log(high))))


def near(rng: np.random.Generator) -> dict[str, object]:
    """Draw a rig like the thesis's: its parameters vary by a half or so."""
    motor, amplifier = "virtual.motor.", "virtual.amplifier."
    coulomb = spread(rng, 1.2e-3, 4.5e-3)
    # Errors of arm and gauge, as large as the recipe states, both scale the force that is read.
    gauge = 1 + 3e-4 * rng.standard_normal() + 0.2e-3 / 0.540 * rng.standard_normal()
    return {
        motor + "torque_constant": spread(rng, 0.03, 0.07),
        motor + "torque_constant_temperature_coefficient": rng.uniform(-2e-3, -0.8e-3),
        motor + "coulomb_friction": coulomb,
        motor + "static_friction": coulomb * rng.uniform(1.0, 2.0),
        motor + "presliding_angle": spread(rng, 0.7e-3, 3e-3),
        motor + "friction_noise": spread(rng, 0.03e-3, 0.3e-3),
        amplifier + "gain": rng.uniform(0.97, 1.03),
        amplifier + "offset": 1e-3 * rng.standard_normal(),
        amplifier + "gain_ripple": ripple(rng, 0.0035),
        amplifier + "saturation_ripple": ripple(rng, 0.0015),
        "virtual.arm.stiffness": spread(rng, 8.0, 30.0),
        "virtual.sensors.force_noise": spread(rng, 2e-4, 2e-3),
        "virtual.sensors.force_gain": gauge,
        "virtual.thermal.winding_to_housing": rng.uniform(0.5, 1.2),
    }


def ripple(rng: np.random.Generator, amplitude: float) -> str:
    """Draw which orders the amplifier's ripple has, as a list of TOML."""
    orders = rng.choice(np.arange(1, 7), size=rng.integers(1, 5), replace=False)
    rows = (f"{{order={order}, amplitude={spread(rng, 0.3, 2) * amplitude}}}" for order in orders)
    return f"[{', '.join(rows)}]"


def far(rng: np.random.Generator) -> dict[str, object]:
    """Draw a rig far from the thesis's, and a grid of angles and temperatures."""
    constant = spread(rng, 0.01, 0.3)
    friction = spread(rng, 0.2, 8.0) * 2.3e-3 * math.sqrt(constant / 0.045)
    noise = spread(rng, 0.3, 10.0)
    temperatures = np.linspace(20.0, rng.uniform(35.0, 50.0), rng.integers(2, 8))
    return near(rng) | {
        "calibrate_kt.rotor_positions": int(rng.integers(2, 9)),
        "calibrate_kt.temperatures_degc": temperatures.round(1).tolist(),
        "rig.torque_constant": constant,
        "virtual.motor.torque_constant": constant,
        "virtual.motor.coulomb_friction": friction,
        "virtual.motor.static_friction": friction * rng.uniform(1.0, 2.0),
        "virtual.motor.presliding_angle": spread(rng, 0.5e-3, 20e-3),
        "virtual.motor.friction_noise": noise * 0.03e-3,
        "virtual.sensors.force_noise": noise * 2e-4,
        "virtual.sensors.force_resolution": spread(rng, 1e-3, 0.1),
        "rig.encoder_counts": int(spread(rng, 1000, 20000)) // 4 * 4,
        "rig.sample_time": float(rng.choice([125e-6, 250e-6, 500e-6, 1e-3])),
    }


def also(draw: Draw, **settings: object) -> Draw:
    """Return a way to draw with some settings fixed; `__` stands for the dot between names."""
    fixed = {name.replace("__", "."): value for name, value in settings.items()}
    return lambda rng: draw(rng) | fixed


def grid(positions: int, *temperatures: float) -> dict[str, object]:
    """Return the settings of a grid of angles and temperatures."""
    return {
        "calibrate_kt__rotor_positions": positions,
        "calibrate_kt__temperatures_degc": list(temperatures),
    }


def coulomb(factor: float) -> dict[str, object]:
    """Return the settings of a rig with that many times the thesis's friction."""
    return {
        "virtual__motor__coulomb_friction": factor * 2.3e-3,
        "virtual__motor__static_friction": factor * 4.0e-3,
    }


def true_constants(recipe: Recipe) -> dict[str, float]:
    """Return the results of calibrate-kt for this rig without any error."""
    assert recipe.virtual is not None
    virtual, settings = recipe.virtual, recipe.calibrate_kt
    at_20 = virtual.motor.torque_constant
    slope = virtual.motor.torque_constant_temperature_coefficient
    low, high = settings.reference_range_degc
    mean = 1 + slope * ((low + high) / 2 - 20)
    errors = [mean / (1 + slope * (end - 20)) - 1 for end in (low, high)]
    table = rotor_map(virtual, virtual.amplifier, virtual.power_cycle)[:-1]
    # The slope of i + i (g + s i) over the span of the staircase is 1 + g + s span.
    return {
        "torque_constant": at_20,
        "torque_constant_temperature_coefficient": slope,
        "torque_constant_mean": at_20 * mean,
        "torque_constant_constant_error": max(map(abs, errors)),
        "torque_constant_ripple": float(np.std(table[:, 1] + settings.current_max * table[:, 2])),
        "amplifier_gain": virtual.amplifier.gain,
        "amplifier_offset": virtual.amplifier.offset,
    }


def calibrate_kt() -> tuple[Design, ...]:
    """Return the designs of calibrate-kt: grids of angles and temperatures, then hard rigs."""
    some = grid(8, 20, 35, 50)
    gimbal = {
        "rig__torque_constant": 0.3,
        "virtual__motor__torque_constant": 0.3,
        "virtual__motor__coulomb_friction": 12e-3,
        "virtual__motor__static_friction": 20e-3,
        "calibrate_kt__current_max": 1.0,
    }
    draws: dict[str, Draw] = {
        "8 x 7": near,
        "4 x 3": also(near, **grid(4, 20, 30, 40)),
        "3 x 2": also(near, **grid(3, 20, 50)),
        "2 x 7": also(near, **grid(2, 20, 25, 30, 35, 40, 45, 50)),
        "6 x 4": also(near, **grid(6, 20, 30, 40, 50)),
        "1 A": also(near, **some, calibrate_kt__current_max=1.0),
        "friction x 4": also(near, **some, **coulomb(4)),
        "friction x 8": also(near, **some, **coulomb(8)),
        "gimbal motor": also(near, **some, **gimbal),
        "soft contacts": also(near, **some, virtual__motor__presliding_angle=50e-3),
        "gauge 0.01 N": also(near, **some, virtual__sensors__force_resolution=0.01),
        "gauge 0.1 N": also(near, **some, virtual__sensors__force_resolution=0.1),
        "far": far,
    }
    return tuple(
        Design(f"calibrate-kt, {name}", CALIBRATE_KT, draw, true_constants)
        for name, draw in draws.items()
    )


DESIGNS = (*calibrate_kt(),)
"""A function a command, joined here."""


# -- trials


def trial(design_number: int, seed: int) -> Trial:
    """Draw one rig, run the command on it and compare its results with the truth."""
    design = DESIGNS[design_number]
    drawn = design.draw(np.random.default_rng([0xC0FE, design_number, seed]))
    overrides = tuple(f"{name}={value}" for name, value in drawn.items())
    options = CommonOptions(overwrite=True, quiet=True, seed=seed, overrides=overrides)
    with tempfile.TemporaryDirectory() as folder:
        output = str(Path(folder) / "run.h5")
        try:
            outcome = run_command(
                design.procedure, [str(RECIPE)], output, options=options, inputs={}
            )
        except InsufficientDataError as error:
            return Trial(seed, {}, str(error))
    recipe, _ = load_recipe(RECIPE, (*overrides, f"virtual.seed={seed}"))
    found = {}
    for name, true in design.truth(recipe).items():
        result = outcome.results.get(name)
        if result is not None and result.u is not None:
            found[name] = (result.value - true, result.u, result.dof or math.inf)
    return Trial(seed, found, None)


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
    names = dict.fromkeys(name for trial in trials for name in trial.found)
    for name in names:
        yield Row.of(name, np.array([t.found[name] for t in trials if name in t.found]))


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
