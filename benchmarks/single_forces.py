"""Pulses of one force and steady sines, read with what was learned and by the oracle.

    .venv/bin/python benchmarks/single_forces.py pulses|sines|bandwidths KIND:SEED ...
        [--jobs 2] [--tables build/learned]

`pulses`: free motion of 40 s, 16 pulses a minute of 1 to 3 s; samples under load, after reversals
and at rest together. `sines`: 30 s of strokes and of free motion, all but the first second under a
sine of one force and frequency. `bandwidths`: sines that come and go, of the frequency up to which
the sensor is asked to be right. `known` is the oracle of `oracle.py`, amplitudes are over true
ones.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from learned import Learned, amplitude, amplitudes, instrument_of, judged, learned_in
from numpy.typing import NDArray
from oracle import CONTACTS, MOTIONS, STEP, Recorded, motion_states, record
from oracle import judged as oracle_judged

from rigtool.experiments.force_sensor.sensor import SensorProperties
from rigtool.recipe.virtual import Pulse, Sine

Array = NDArray[np.float64]

BAND = 10.0
"""Of pulses and steady sines, Hz."""

PULSES, SINES = (0.05, 0.25, 0.9, 1.5, 2.8), (0.1, 0.25, 0.5, 1.0, 2.0)
FREQUENCIES, BANDWIDTHS = (1.0, 2.0, 5.0, 7.0, 10.0), (5.0, 10.0, 12.0, 15.0)

Row = dict[str, Any]
Chosen = NDArray[np.bool_]


def pulses(rig: str, seed: int, store: Path | None) -> Iterator[Row]:
    """Yield, for each force and form, the sums of both estimators."""
    learned = learned_in(store, rig, seed)
    for force in PULSES:
        drawn = Pulse(kind="pulse", rate_per_min=16, duration=(1.0, 3.0), force=(force, force))
        recorded = touched(rig, seed, "free", 40.0, drawn)
        states = motion_states(recorded)
        chosen = (states["reversal"] | states["rest"]) & (recorded.truth != 0)
        for row in both(recorded, sensor_of(recorded, learned), chosen):
            yield {"force": force} | row


def sines(rig: str, seed: int, store: Path | None) -> Iterator[Row]:
    """Yield, for each motion, force, frequency and form, sums and amplitudes of both estimators."""
    learned = learned_in(store, rig, seed)
    for motion in MOTIONS:
        for force in SINES:
            for hz in FREQUENCIES:
                steady = Sine(kind="sine", at=(1.0,), force=(force, force), frequency_hz=(hz, hz))
                recorded = touched(rig, seed, motion, 30.0, steady)
                used = motion_states(recorded)["all"]
                for row in both(recorded, sensor_of(recorded, learned), used, hz):
                    yield {"motion": motion, "force": force, "hz": hz} | row


def bandwidths(rig: str, seed: int, store: Path | None) -> Iterator[Row]:
    """Yield the amplitude of a sine for each bandwidth, which is its frequency, motion and form."""
    learned = learned_in(store, rig, seed)
    for hz in BANDWIDTHS:
        drawn = {"duration": (2, 3), "force": (0.25, 1.5), "frequency_hz": (hz, hz)}
        for motion in MOTIONS:
            own = Sine(kind="sine", rate_per_min=15, **drawn)
            recorded = touched(rig, seed, motion, 30.0, own)
            for form, found in amplitudes(recorded, sensor_of(recorded, learned, hz), hz):
                yield {"hz": hz, "motion": motion, "form": form, "amplitude": found}


def touched(rig: str, seed: int, motion: str, time: float, contact: Pulse | Sine) -> Recorded:
    """Move a virtual rig for a time, s, while one kind of contact touches it."""
    CONTACTS["one"] = (contact,)
    return record(rig, seed, motion, time, "one")


def sensor_of(recorded: Recorded, learned: Learned, band: float = BAND) -> SensorProperties:
    """Return the sensor of a bandwidth, Hz."""
    model, reach, constant = learned
    return instrument_of(recorded, model, reach, constant, band)


def both(
    recorded: Recorded, sensor: SensorProperties, chosen: Chosen, hz: float | None = None
) -> Iterator[Row]:
    """Yield, for each form, sums over chosen steps (m,) of both estimators, and with a frequency
    the amplitude of a sine of it."""
    rate, truth = 1 / (STEP * recorded.recipe.rig.sample_time), recorded.truth
    known = {form: values for form, *values in oracle_judged(recorded, BAND)}
    for form, rows, torque, error, u, _ in judged(recorded, sensor):
        row: Row = {"form": form}
        for of, every, values in (
            ("", rows, (torque, error, u)),
            (" of known", slice(None), known[form]),
        ):
            read, error, u = values
            among = chosen[every][: len(read)]
            row |= _sums(error[among], u[among], of)
            if hz is not None:
                own = rate / (every.step or 1)
                row[f"amplitude{of}"] = amplitude(read, truth[every], hz, own)
        yield row


def _sums(error: Array, u: Array, of: str) -> Row:
    """Return the sums that recordings are put together by."""
    half = 1.96 * u
    return {
        f"count{of}": len(error),
        f"hold{of}": int(np.count_nonzero(error <= half)),
        f"half{of}": float(half.sum()),
        f"squares{of}": float(error @ error),
    }


def _of_pulses(rows: pd.DataFrame) -> pd.DataFrame:
    """Return shares that hold, %, half widths, mN m, and both over the oracle's, by force."""
    keys = ["force", "form"]
    total = rows.drop(columns="rig").groupby(keys, sort=False).sum()
    each = rows.set_index(keys)
    table = pd.DataFrame()
    for of in ("", " of known"):
        table[f"hold{of}"] = 100 * total[f"hold{of}"] / total[f"count{of}"]
        share = 100 * each[f"hold{of}"] / each[f"count{of}"]
        table[f"least{of}"] = share.groupby(keys, sort=False).min()
    mean = {of: total[f"half{of}"] / total[f"count{of}"] for of in ("", " of known")}
    square = {of: total[f"squares{of}"] / total[f"count{of}"] for of in ("", " of known")}
    table["half, mN m"] = 1e3 * mean[""]
    table["half over known's"] = mean[""] / mean[" of known"]
    table["error over known's"] = np.sqrt(square[""] / square[" of known"])
    return table


def _of_sines(rows: pd.DataFrame) -> pd.DataFrame:
    """Return the least and the largest amplitude and share that holds, %, of all frequencies."""
    for of in ("", " of known"):
        rows[f"hold{of}, %"] = 100 * rows[f"hold{of}"] / rows[f"count{of}"]
    names = ["amplitude", "amplitude of known", "hold, %", "hold of known, %"]
    return rows.groupby(["force", "motion", "form"], sort=False)[names].agg(["min", "max"])


def _of_bandwidths(rows: pd.DataFrame) -> pd.DataFrame:
    """Return the least and the largest amplitude of all rigs."""
    return rows.groupby(["hz", "motion", "form"], sort=False)["amplitude"].agg(["min", "max"])


TABLES = {
    "pulses": (pulses, _of_pulses),
    "sines": (sines, _of_sines),
    "bandwidths": (bandwidths, _of_bandwidths),
}


def rows_of(table: str, rig: str, seed: int, store: Path | None) -> list[Row]:
    """Return the rows of one rig."""
    measured, _ = TABLES[table]
    return [{"rig": f"{rig}:{seed}"} | row for row in measured(rig, seed, store)]


def main() -> None:
    """Measure every rig and print one table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("table", choices=TABLES)
    parser.add_argument("rigs", nargs="+", help="KIND:SEED")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--tables", type=Path, help="folder that keeps what was learned")
    arguments = parser.parse_args()
    rigs = [(rig, int(seed)) for rig, seed in (name.split(":") for name in arguments.rigs)]
    work = [(arguments.table, *rig, arguments.tables) for rig in rigs]
    with ProcessPoolExecutor(arguments.jobs) as pool:
        rows = [row for own in pool.map(rows_of, *zip(*work, strict=True)) for row in own]
    _, shown = TABLES[arguments.table]
    print(shown(pd.DataFrame(rows)).to_string(float_format="{:.2f}".format))


if __name__ == "__main__":
    main()
