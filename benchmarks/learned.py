"""How well torque over time is known with what was learned, beside an estimator that knows all.

    .venv/bin/python benchmarks/learned.py [--seeds 5] [--jobs 2] [--rig thesis] [--duration 60]
        [--tables build/learned]

Each rig is calibrated and learned (`calibrate-kt`, `ilc-learn --implementation D`) as its owner
would, then it moves while contacts touch it: pulses, or weak ones half of the time, with the ripple
of the learned power-up and with another; the same recordings are read by the oracle of `oracle.py`.
Printed are errors over the oracle's, by motion, bandwidth and state, the share of errors within
1.96 u (for the oracle, of its standard deviations), the mean width of the intervals at rest and the
score of all over the oracle's, and learned parameters over true ones. The warm rig was learned at
room temperature. Runs of `calibrate-kt` and `ilc-learn` that `--tables` holds are taken as they
are, and kept there.
"""

from __future__ import annotations

import argparse
import math
import tempfile
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from oracle import (
    BANDS,
    CONTACTS,
    MOTIONS,
    RECIPE,
    RIGS,
    STEP,
    Key,
    Recorded,
    Score,
    motion_states,
    plant_of,
    record,
    score,
    scores,
    sum_of,
)

from rigtool.experiments.force_filter.accuracy import JUDGED_STATES
from rigtool.experiments.force_filter.estimate import PIECE_STEPS
from rigtool.experiments.force_filter.motion_states import CREEPING_KIND, STATE_NAMES, Reach
from rigtool.experiments.force_model.force_model import ForceModel
from rigtool.experiments.force_model.stored import model_from
from rigtool.experiments.force_sensor.procedure_over_time import reach_of
from rigtool.experiments.force_sensor.results_over_time import TorqueRows
from rigtool.experiments.force_sensor.sensor import SensorProperties
from rigtool.experiments.force_sensor.stretch import Stretch
from rigtool.experiments.learning.procedure import PROCEDURE as ILC_LEARN
from rigtool.experiments.procedure import Procedure
from rigtool.experiments.running.options import CommonOptions
from rigtool.experiments.running.session import run_command
from rigtool.experiments.torque_constant.procedure import PROCEDURE as CALIBRATE_KT
from rigtool.experiments.torque_per_ampere import torque_per_ampere_at
from rigtool.recipe import load_recipe
from rigtool.recipe.commands import ForceMotion
from rigtool.recipe.virtual import Sine
from rigtool.runfile import open_run

Array = NDArray[np.float64]

WARM = "15 K warmer"
SINE_HZ, SINE_TIME = 10.0, 30.0
CONTACTS["sine"] = (
    Sine(
        kind="sine", rate_per_min=15, duration=(2.0, 3.0), force=(0.25, 1.5), frequency_hz=SINE_HZ
    ),
)
Condition = tuple[int, str]
CONDITIONS: tuple[Condition, ...] = ((0, "pulses"), (1, "pulses"), (0, "weak"), (1, "weak"))
"""Power-up of the amplifier, which was learned at 0, and contacts."""

ROW_TIME = 5e-3
"""Time of a row of the reading at the largest of `BANDS`, s."""

Known = tuple[float, float]
"""Torque constant at 0 degC, N m/A, and its change per kelvin."""

LARGEST, LOADS = 60e-3, (0.0, 0.01, 0.05, 0.2, 1.0)
"""Largest torque that is learned, N m, and edges of bands of it."""
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


def learned(rig: str, seed: int, folder: Path) -> tuple[ForceModel, Reach, Known]:
    """Calibrate and learn a rig, but for runs in the folder; return its model, how far it was
    learned, and the torque constant."""
    sets = () if rig == WARM else RIGS[rig]
    kt, tables = folder / "kt.h5", folder / "tables.h5"
    implementation = "ilc_learn.implementation=D"

    def run(procedure: Procedure, output: Path, *overrides: str, **inputs: Path) -> None:
        options = CommonOptions(overwrite=True, seed=seed, overrides=(*sets, *overrides))
        with ExitStack() as stack:
            runs = {name: stack.enter_context(open_run(path)) for name, path in inputs.items()}
            run_command(procedure, [str(RECIPE)], str(output), options=options, inputs=runs)

    if not kt.exists():
        run(CALIBRATE_KT, kt)
    if not tables.exists():
        run(ILC_LEARN, tables, implementation, kt=kt)
    recipe, _ = load_recipe(RECIPE, list(RIGS[rig]))
    assert recipe.virtual is not None
    with open_run(tables) as stored, open_run(kt) as calibration:
        model, reach = model_from(stored, recipe), reach_of(stored, calibration)
        cold = torque_per_ampere_at(calibration, 0.0).value
        slope = torque_per_ampere_at(calibration, 1.0).value - cold
        return model, reach, (cold, slope)


def instrument_of(
    recorded: Recorded,
    model: ForceModel,
    reach: Reach,
    torque_constant: tuple[float, float],
    band: float = 10.0,
) -> SensorProperties:
    """Return the sensor as `measure-force` makes it, for a bandwidth, Hz."""
    rig = recorded.recipe.rig
    count = 2 * math.pi / rig.encoder_counts
    motion = ForceMotion(bandwidth_hz=band)
    return SensorProperties(
        model,
        reach,
        rig.sample_time,
        rig.sample_time,
        count,
        torque_constant,
        rig.current_limit,
        motion.corner_hz,
    )


def samples_of(recorded: Recorded) -> Array:
    """Return what the sensor takes (3, n): encoder, current, temperature."""
    names = ("encoder", "current_setpoint", "temperature")
    return np.array([recorded.channels[name] for name in names], dtype=np.float64)


def learned_scores(
    recorded: Recorded, motion: str, model: ForceModel, known: Known, reach: Reach
) -> dict[Key, Score]:
    """Compare the estimate of a learned model with what truly acted."""
    states, found = motion_states(recorded), {}
    for band in BANDS:
        one = read(instrument_of(recorded, model, reach, known, band), recorded)
        rows = slice(None, None, one.every)
        truth = recorded.truth[rows]
        size = min(len(truth), len(one.time))
        for form, estimate, u, own, reference in (
            ("smoothed", one.torque, one.u, one.states, one.reference),
            ("causal", one.causal, one.causal_u, one.causal_states, one.causal_reference),
        ):
            assert reference is not None
            error = np.abs(estimate - reference)[:size]
            for state, chosen in states.items():
                among = chosen[rows][:size]
                found[motion, form, band, state] = score(error[among], u[:size][among])
            for cell, inside in _cells(truth[:size], own[:size]).items():
                among = inside & states["all"][rows][:size]
                found[motion, form, band, cell] = score(error[among], u[:size][among])
    return found


def read(instrument: SensorProperties, recorded: Recorded) -> TorqueRows:
    """Return the torque over a recording, as `measure-force` reads it."""
    samples = np.vstack([samples_of(recorded), recorded.channels["reference_torque"]])
    piece = PIECE_STEPS * STEP
    with ThreadPoolExecutor(1) as smoothing, ThreadPoolExecutor(1) as testing:
        workers = smoothing, testing
        stretch = Stretch("", instrument, 0.0, samples.shape[1], workers)
        for first in range(0, samples.shape[1], piece):
            stretch.add(samples[:, first : first + piece])
        (found,) = stretch.reading()
    return found


def _cells(truth: Array, states: NDArray[np.integer]) -> dict[str, NDArray[np.bool_]]:
    """Return which steps are in each band of load, of 60 mN m, and state of the reading."""
    band = np.searchsorted(np.array(LOADS) * LARGEST, np.abs(truth), side="right") - 1
    return {
        f"from {1e3 * LARGEST * low:g} mN m, {STATE_NAMES[state]}": (band == number)
        & (states == state)
        for number, low in enumerate(LOADS[:-1])
        for state in JUDGED_STATES
    }


def amplitude(
    recorded: Recorded, model: ForceModel, known: Known, reach: Reach
) -> dict[str, float]:
    """Return the amplitude that is read of a sine of `SINE_HZ`, over the true one."""
    one = read(instrument_of(recorded, model, reach, known, SINE_HZ), recorded)
    truth = recorded.truth[:: one.every]
    size, rate = min(len(truth), len(one.time)), 1 / one.step_time
    span = round(rate)
    wave, count = np.exp(-2j * np.pi * SINE_HZ * np.arange(size) / rate), size // span
    found = {}
    for form, estimate in (("smoothed", one.torque), ("causal", one.causal)):
        own, true = (
            (values[:size] * wave)[: count * span].reshape(count, span).mean(axis=1)
            for values in (estimate, truth)
        )
        acts = np.abs(true) > 0.5 * np.abs(true).max()
        found[form] = float(np.abs(own[acts]).sum() / np.abs(true[acts]).sum())
    return found


Scores = dict[Key, Score]
Found = tuple[str, dict[str, float], dict[Condition, tuple[Scores, Scores]]]
"""Rig, learned parameters over true ones, scores of what was learned and of the oracle."""


def learned_in(store: Path | None, rig: str, seed: int) -> tuple[ForceModel, Reach, Known]:
    """Return `learned` from a store by rig and seed, which it keeps, or from nothing."""
    if store is None:
        with tempfile.TemporaryDirectory() as folder:
            return learned(rig, seed, Path(folder))
    own = store / f"{rig}-{seed}"
    own.mkdir(parents=True, exist_ok=True)
    return learned(rig, seed, own)


def measured(rig: str, seed: int, duration: float, store: Path | None) -> Found:
    """Learn one rig, move it under all conditions, and score both estimators."""
    model, reach, known = learned_in(store, rig, seed)
    found: dict[Condition, tuple[Scores, Scores]] = {}
    for power_cycle, contacts in CONDITIONS:
        own, oracle = found[power_cycle, contacts] = {}, {}
        for motion in MOTIONS:
            recorded = record(rig, seed, motion, duration, contacts, power_cycle)
            own.update(learned_scores(recorded, motion, model, known, reach))
            oracle.update(scores(recorded, motion))
    over = _over_truth(model, recorded)
    swung = record(rig, seed, "strokes", SINE_TIME, "sine")
    for form, value in amplitude(swung, model, known, reach).items():
        over[f"sine of {SINE_HZ:g} Hz, {form}"] = value
    for kind, name in [
        *((state, STATE_NAMES[state]) for state in JUDGED_STATES),
        (CREEPING_KIND, "creeping"),
    ]:
        factor, share = model.scales[0][kind].tolist()
        over[f"u over deviation, {name}"], over[f"u over torque, {name}"] = factor, share
    return rig, over, found


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


def print_tables(found: list[Found]) -> None:
    """Print, as tables of Markdown: errors over the oracle's by condition, band and rig, the share
    of errors within the intervals by load and state, and learned parameters over true ones."""
    rigs = {rig: [one for one in found if one[0] == rig] for rig, *_ in found}
    for condition in CONDITIONS:
        for band in BANDS:
            print(f"\npower-up {condition[0]}, {condition[1]}, {band:g} Hz, smoothed / causal\n")
            print("| rig, motion | " + " | ".join(HEADS) + " |\n" + "| --- " * 8 + "|")
            for motion in MOTIONS:
                for rig, mine in [*rigs.items(), ("all", found)]:
                    print(f"| {rig}, {motion} | {_row(mine, condition, motion, band)} |")
        print(f"\npower-up {condition[0]}, {condition[1]}: intervals hold (s)")
        for state in next(iter(found))[2][condition][0]:
            if state[:3] == (MOTIONS[0], "smoothed", BANDS[-1]) and state[3].startswith("from"):
                print(f"  {state[3]:50}{_pairs(_holds(found, condition, state[3]))}")
    print("\nlearned over true: median, least, largest")
    for name in found[0][1]:
        own = [one[1][name] for one in found]
        print(f"  {name:56}{np.median(own):8.3f}{min(own):8.3f}{max(own):8.3f}", flush=True)


HEADS = (
    "moving",
    "after reversals",
    "at rest",
    "all, mN m",
    "95 % holds in (known), %",
    "width at rest",
    "score over known's",
)
FORMS = ("smoothed", "causal")


def _summed(found: list[Found], condition: Condition, key: Key) -> tuple[Score, Score]:
    """Return the scores of what was learned and of the oracle, of all rigs together."""
    both = [one[2][condition] for one in found]
    return sum_of([own[key] for own, _ in both]), sum_of([oracle[key] for _, oracle in both])


def _row(found: list[Found], condition: Condition, motion: str, band: float) -> str:
    """Return one row of the table of errors."""
    scored = {
        state: [_summed(found, condition, (motion, form, band, state)) for form in FORMS]
        for state in ("moving", "reversal", "rest", "all")
    }
    cells = [
        _pairs([f"{_rmse(own) / _rmse(oracle):.2f}" for own, oracle in scored[state]])
        for state in ("moving", "reversal", "rest")
    ]
    cells.append(_pairs([f"{1e3 * _rmse(own):.2f}" for own, _ in scored["all"]]))
    holds = [[f"{100 * s.covered / s.count:.1f}" for s in both] for both in scored["all"]]
    cells.append(_pairs([f"{own} ({oracle})" for own, oracle in holds]))
    halves = [[s.half_widths / s.count for s in both] for both in scored["rest"]]
    cells.append(_pairs([f"{own / oracle:.2f}" for own, oracle in halves]))
    totals = [[s.interval_scores / s.count for s in both] for both in scored["all"]]
    cells.append(_pairs([f"{own / oracle:.2f}" for own, oracle in totals]))
    return " | ".join(cells)


def _holds(found: list[Found], condition: Condition, cell: str) -> list[str]:
    """Return the share within the intervals, %, and the time, s, of a band of load and state."""
    texts = []
    for form in FORMS:
        scored = [one[2][condition][0][m, form, BANDS[-1], cell] for one in found for m in MOTIONS]
        one = sum_of(scored)
        share = f"{100 * one.covered / one.count:.0f}" if one.count else "-"
        texts.append(f"{share} ({one.count * ROW_TIME:.1f})")
    return texts


def _pairs(texts: list[str]) -> str:
    return " / ".join(texts)


def _rmse(one: Score) -> float:
    return math.sqrt(one.squares / one.count)


def main() -> None:
    """Measure every rig and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--first-seed", type=int, default=91)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--rig", choices=RIGS, action="append")
    parser.add_argument("--duration", type=float, default=60.0)
    parser.add_argument("--tables", type=Path, help="folder that keeps what was learned")
    arguments = parser.parse_args()
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.seeds)
    how = arguments.duration, arguments.tables
    work = [(rig, seed, *how) for rig in arguments.rig or RIGS for seed in seeds]
    with ProcessPoolExecutor(arguments.jobs) as pool:
        print_tables(list(pool.map(measured, *zip(*work, strict=True))))


if __name__ == "__main__":
    main()
