"""How well torque over time is known with what was learned, beside an estimator that knows all.

    .venv/bin/python benchmarks/learned.py [KIND:SEED ...] [--jobs 2] [--duration 60]
        [--tables build/learned] [--kept FILE]

Each rig is calibrated and learned (`calibrate-kt`, `ilc-learn --implementation D`) as its owner
would, then it moves while contacts touch it: pulses, or weak ones half of the time, with the ripple
of the learned power-up and with another; the same recordings are read by the oracle of `oracle.py`.
Printed are errors over the oracle's, by motion, bandwidth and state, the share of errors within
1.96 u (for the oracle, of its standard deviations), the mean width of the intervals at rest and the
score of all over the oracle's, and learned parameters over true ones. The warm rig was learned at
room temperature. Runs of `calibrate-kt` and `ilc-learn` that `--tables` holds are taken as they
are, and kept there. Neither those nor the results that `--kept` holds know anything of the code.
"""

from __future__ import annotations

import argparse
import math
import pickle
import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path

import numpy as np
from accuracy_tables import (
    CONDITIONS,
    LARGEST,
    LOADS,
    Condition,
    Found,
    Scores,
    cells,
    print_tables,
)
from numpy.typing import NDArray
from oracle import (
    BANDS,
    CONTACTS,
    MOTIONS,
    RECIPE,
    RIGS,
    STEP,
    Recorded,
    motion_states,
    plant_of,
    record,
    score,
    scores,
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
Known = tuple[float, float]
"""Torque constant at 0 degC, N m/A, and its change per kelvin."""

Learned = tuple[ForceModel, Reach, Known]
"""The model, how far it was learned, and the torque constant."""

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


def learned(rig: str, seed: int, folder: Path, overrides: Sequence[str] = ()) -> Learned:
    """Calibrate and learn a rig, with settings of the learning, but for runs in the folder."""
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
        run(ILC_LEARN, tables, implementation, *overrides, kt=kt)
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
) -> Scores:
    """Compare the estimate of a learned model with what truly acted."""
    states, found = motion_states(recorded), {}
    for band in BANDS:
        instrument = instrument_of(recorded, model, reach, known, band)
        for form, rows, _, error, u, own in judged(recorded, instrument):
            for state, chosen in states.items():
                among = chosen[rows][: len(error)]
                found[motion, form, band, state] = score(error[among], u[among])
            for cell, inside in _cells(recorded.truth[rows][: len(error)], own).items():
                among = inside & states["all"][rows][: len(error)]
                found[motion, form, band, cell] = score(error[among], u[among])
    return found


Judged = tuple[str, slice, Array, Array, Array, NDArray[np.integer]]
"""Form, rows among the filter's steps; torque, error, u and state of each, (n,)."""


def judged(recorded: Recorded, instrument: SensorProperties) -> Iterator[Judged]:
    """Compare both forms of the torque that a sensor reads with what truly acted."""
    one = read(instrument, recorded)
    rows = slice(None, None, one.every)
    size = min(len(recorded.truth[rows]), len(one.time))
    for form, estimate, u, own, reference in (
        ("smoothed", one.torque, one.u, one.states, one.reference),
        ("causal", one.causal, one.causal_u, one.causal_states, one.causal_reference),
    ):
        assert reference is not None
        error = np.abs(estimate - reference)
        yield form, rows, estimate[:size], error[:size], u[:size], own[:size]


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
    return {name: (band == number) & (states == state) for number, state, name in cells()}


def amplitudes(
    recorded: Recorded, instrument: SensorProperties, hz: float
) -> Iterator[tuple[str, float]]:
    """Yield each form, and the amplitude that it reads of a sine of a frequency, Hz, over the
    true one."""
    for form, rows, torque, *_ in judged(recorded, instrument):
        rate = 1 / (STEP * rows.step * recorded.recipe.rig.sample_time)
        yield form, amplitude(torque, recorded.truth[rows], hz, rate)


def amplitude(torque: Array, truth: Array, hz: float, rate: float) -> float:
    """Return the amplitude of a sine of `hz` that is read (n,) over the true one (n,) at a rate."""
    size, span = len(torque), round(rate)
    wave, count = np.exp(-2j * np.pi * hz * np.arange(size) / rate), size // span
    own, true = (
        (values[:size] * wave)[: count * span].reshape(count, span).mean(axis=1)
        for values in (torque, truth)
    )
    acts = np.abs(true) > 0.5 * np.abs(true).max()
    return float(np.abs(own[acts]).sum() / np.abs(true[acts]).sum())


def learned_in(store: Path | None, rig: str, seed: int) -> Learned:
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
    for form, value in amplitudes(swung, instrument_of(swung, model, reach, known), SINE_HZ):
        over[f"sine of {SINE_HZ:g} Hz, {form}"] = value
    for kind, name in [
        *((state, STATE_NAMES[state]) for state in JUDGED_STATES),
        (CREEPING_KIND, "creeping"),
    ]:
        factor, share = model.scales[0][kind].tolist()
        over[f"u over deviation, {name}"], over[f"u over torque, {name}"] = factor, share
    return Found(rig, seed, over, found)


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


def kept(path: Path | None) -> list[Found]:
    """Return the rigs of a file."""
    found = []
    if path is not None and path.exists():
        with path.open("rb") as file:
            while file.peek(1):
                found.append(pickle.load(file))
    return found


def main() -> None:
    """Measure every rig and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("rigs", nargs="*", help="KIND:SEED; five development seeds of each kind")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--duration", type=float, default=60.0)
    parser.add_argument("--tables", type=Path, help="folder that keeps what was learned")
    parser.add_argument("--kept", type=Path, help="file of results; rigs that it has are not read")
    arguments = parser.parse_args()
    wanted = [rig.split(":") for rig in arguments.rigs]
    wanted = wanted or [[rig, str(seed)] for rig in RIGS for seed in range(91, 96)]
    done = {(one.rig, one.seed): one for one in kept(arguments.kept)}
    work = [(rig, int(seed)) for rig, seed in wanted]
    missing = [(*one, arguments.duration, arguments.tables) for one in work if one not in done]
    with ExitStack() as stack:
        out = stack.enter_context(arguments.kept.open("ab")) if arguments.kept else None
        pool = stack.enter_context(ProcessPoolExecutor(arguments.jobs))
        for one in pool.map(measured, *zip(*missing, strict=True)) if missing else ():
            done[one.rig, one.seed] = one
            if out is not None:
                pickle.dump(one, out)
                out.flush()
    print_tables([done[one] for one in work])


if __name__ == "__main__":
    main()
