"""How well torque over time is known with what was learned, beside an estimator that knows all.

    .venv/bin/python benchmarks/learned.py [--seeds 1] [--jobs 2] [--rig thesis] [--duration 60]

Each rig is calibrated and learned (`calibrate-kt`, `ilc-learn --implementation D`) as its owner
would, then it moves while contacts touch it; the same recordings are read by the oracle of
`oracle.py`. Printed are learned parameters over true ones, then errors of both in mN m, and their
ratio, by motion, form, bandwidth and state; `cover` is the share of errors within 1.96 standard
deviations. The warm rig was learned at room temperature.
"""

from __future__ import annotations

import argparse
import math
import tempfile
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack
from pathlib import Path

import numpy as np
from oracle import (
    BANDS,
    MOTIONS,
    RECIPE,
    RIGS,
    STEP,
    Key,
    Recorded,
    Score,
    both_forms,
    lowpassed,
    motion_states,
    plant_of,
    record,
    score,
    scores,
    sum_of,
)

from rigtool.experiments.force_over_time.estimate import Signals
from rigtool.experiments.force_over_time.force_model import ForceModel
from rigtool.experiments.force_over_time.stored import model_from
from rigtool.experiments.learning.procedure import PROCEDURE as ILC_LEARN
from rigtool.experiments.running.options import CommonOptions
from rigtool.experiments.running.session import run_command
from rigtool.experiments.torque_constant.procedure import PROCEDURE as CALIBRATE_KT
from rigtool.experiments.torque_per_ampere import torque_per_ampere_at
from rigtool.recipe import load_recipe
from rigtool.runfile import open_run

WARM = "15 K warmer"
COMPARED = (
    "presliding_angle",
    "housing_presliding_angle",
    "static",
    "stiffness",
    "damping",
    "tip_friction",
    "tip_presliding_angle",
    "grasper_inertia",
    "inertia",
)
"""Parameters of a plant that are learned as such."""


def learned(rig: str, seed: int, folder: Path) -> tuple[ForceModel, float]:
    """Calibrate and learn a rig; return its model, and N m/A at the temperature of its use."""
    sets = () if rig == WARM else RIGS[rig]
    kt, tables = folder / "kt.h5", folder / "tables.h5"
    implementation = "ilc_learn.implementation=D"

    def run(procedure: object, output: Path, *overrides: str, **inputs: Path) -> None:
        options = CommonOptions(overwrite=True, seed=seed, overrides=(*sets, *overrides))
        with ExitStack() as stack:
            runs = {name: stack.enter_context(open_run(path)) for name, path in inputs.items()}
            run_command(procedure, [str(RECIPE)], str(output), options=options, inputs=runs)

    run(CALIBRATE_KT, kt)
    run(ILC_LEARN, tables, implementation, kt=kt)
    recipe, _ = load_recipe(RECIPE, list(RIGS[rig]))
    assert recipe.virtual is not None
    with open_run(tables) as stored, open_run(kt) as calibration:
        model = model_from(stored, recipe)
        degc = recipe.virtual.thermal.ambient_degc  # what a thermometer on the motor shows
        return model, torque_per_ampere_at(calibration, degc).value


def learned_scores(
    recorded: Recorded, motion: str, model: ForceModel, torque_constant: float
) -> dict[Key, Score]:
    """Compare the estimate of a learned model with what truly acted."""
    rig = recorded.recipe.rig
    width, dt = 2 * math.pi / rig.encoder_counts, rig.sample_time
    low = recorded.channels["encoder"] * width
    torque, viscous = model.drive.torque(
        low + width / 2, recorded.channels["current_setpoint"], torque_constant, dt
    )
    signals = Signals(torque, viscous, low, width)
    plant, uncertainty = model.plant(dt), model.uncertainty
    states, found, rate = motion_states(recorded), {}, 1 / (STEP * dt)
    for band in BANDS:
        for form, (estimate, deviation) in both_forms(plant, uncertainty, signals, band).items():
            truth = lowpassed(recorded.truth, band, rate, form == "smoothed")
            for state, chosen in states.items():
                error = np.abs(estimate - truth)[chosen]
                found[motion, form, band, state] = score(error, deviation[chosen])
    return found


Found = tuple[str, dict[str, float], dict[Key, Score], dict[Key, Score]]
"""Rig, learned parameters over true ones, scores of what was learned and of the oracle."""


def measured(rig: str, seed: int, duration: float) -> Found:
    """Learn one rig, move it, and score both estimators."""
    with tempfile.TemporaryDirectory() as folder:
        model, torque_constant = learned(rig, seed, Path(folder))
    own: dict[Key, Score] = {}
    oracle: dict[Key, Score] = {}
    for motion in MOTIONS:
        recorded = record(rig, seed, motion, duration)
        own.update(learned_scores(recorded, motion, model, torque_constant))
        oracle.update(scores(recorded, motion))
    return rig, _over_truth(model, recorded), own, oracle


def _over_truth(model: ForceModel, recorded: Recorded) -> dict[str, float]:
    """Return learned parameters over those of the virtual rig."""
    found, true = model.plant(recorded.recipe.rig.sample_time), plant_of(recorded.recipe)
    over = {name: getattr(found, name) / getattr(true, name) for name in COMPARED}
    carried = 40e-3
    grown = [
        p.load_friction * (math.hypot(carried, p.load_friction_onset) - p.load_friction_onset)
        for p in (found, true)
    ]
    over["load friction at 40 mN m"] = grown[0] / grown[1]
    return over


def print_table(found: list[Found]) -> None:
    """Print parameters and errors of all rigs."""
    for rig in dict.fromkeys(one[0] for one in found):
        mine = [one for one in found if one[0] == rig]
        print(f"\n{rig}: learned over true, by seed")
        for name in mine[0][1]:
            print(f"  {name:28}" + "".join(f"{one[1][name]:8.3f}" for one in mine))
        print(f"  {'rmse, mN m (cover, %)':46}{'learned':>14}{'oracle':>14}{'ratio':>7}")
        for key in sorted(mine[0][2]):
            own, oracle = (sum_of([one[which][key] for one in mine]) for which in (2, 3))
            if own.count:
                motion, form, band, state = key
                ratio = math.sqrt(own.squares / oracle.squares)
                label = f"{motion:8} {form:9}{band:3.0f} Hz  {state}"
                print(f"  {label:46}{_cell(own):>14}{_cell(oracle):>14}{ratio:7.2f}", flush=True)


def _cell(one: Score) -> str:
    rmse = 1e3 * math.sqrt(one.squares / one.count)
    return f"{rmse:.2f} ({100 * one.covered / one.count:.0f})"


def main() -> None:
    """Measure every rig and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--first-seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--rig", choices=RIGS, action="append")
    parser.add_argument("--duration", type=float, default=60.0)
    arguments = parser.parse_args()
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.seeds)
    work = [(rig, seed, arguments.duration) for rig in arguments.rig or RIGS for seed in seeds]
    with ProcessPoolExecutor(arguments.jobs) as pool:
        print_table(list(pool.map(measured, *zip(*work, strict=True))))


if __name__ == "__main__":
    main()
