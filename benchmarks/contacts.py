"""Whether contacts are found in time, and none where nothing touches, on rigs that were learned.

    .venv/bin/python benchmarks/contacts.py [--seed 1] [--seeds 1] [--rig thesis] [--jobs 2]
        [--power-cycle 0] [--tables build/learned]

Pulses of 0.1 N in strokes and 0.5 N in free motion, 20 a minute for 120 s, then 600 s of either
without any, all causal: the sensor, the second filter and the tests of `force_model.contacts`, as
`measure-force` runs them. Times count from where a pulse begins to rise. `known` are the same tests
and thresholds on the torque of the oracle (`oracle.py`), which knows every parameter of the rig.
"""

from __future__ import annotations

import argparse
import math
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from learned import instrument_of, learned_in, samples_of
from numpy.typing import NDArray
from oracle import (
    AVERAGED,
    CONTACTS,
    RIGS,
    STEP,
    Recorded,
    plant_of,
    record,
    signals_of,
    uncertainty_of,
)

from rigtool.experiments.force_filter.estimate import Filter
from rigtool.experiments.force_model.contacts import CONTACT_SETTLING_TIME, Contact, contacts, trial
from rigtool.experiments.force_sensor.sensor import Sensor, SensorProperties
from rigtool.recipe.virtual import Pulse

Array = NDArray[np.float64]

WANTED = {"strokes": (0.1, 0.1), "free": (0.5, 0.05)}
"""Force, N, and within which time it is to be found, s."""

TIME, QUIET = 120.0, 600.0
"""Of a recording with pulses, and of one without, s."""

PIECE = 8192 * STEP

for _force, _ in WANTED.values():
    CONTACTS[f"{_force:g} N"] = (
        Pulse(kind="pulse", rate_per_min=20, duration=(0.5, 1.5), force=(_force, _force)),
    )
CONTACTS["none"] = ()


@dataclass(frozen=True)
class Count:
    """Pulses, those that were found and found in time; delays s; contacts where nothing touches."""

    pulses: int
    found: int
    in_time: int
    delays: tuple[float, ...]
    false: int


def found_by_sensor(recorded: Recorded, instrument: SensorProperties) -> list[Contact]:
    """Return the contacts that the sensor finds, in steps."""
    sensor, untouched = Sensor(instrument), instrument.filter(instrument.model.untouched)
    samples, parts = samples_of(recorded), []
    for first in range(0, samples.shape[1], PIECE):
        sensed = sensor.add(samples[:, first : first + PIECE])
        other = untouched.add(sensed.signals, less=sensed.less)
        parts.append((other.torque, other.deviation, sensed.kinds, sensed.doubt))
    torque, deviation, kinds, doubt = (np.concatenate(p) for p in zip(*parts, strict=True))
    tested = trial(torque, deviation, kinds, instrument.grid.step_time, doubt)
    return contacts(tested, instrument.model.limits)


def found_by_oracle(recorded: Recorded, instrument: SensorProperties) -> list[Contact]:
    """Return the contacts that the same tests find in the oracle's torque, in steps."""
    kinds = Sensor(instrument).add(samples_of(recorded), last=True).kinds
    u, plant = uncertainty_of(recorded.recipe), plant_of(recorded.recipe)
    quiet = replace(u, slow_torque_rate=u.torque_rate, step_torque_rate=u.torque_rate)
    found = Filter(plant, quiet, STEP // AVERAGED, instrument.corner_hz).add(signals_of(recorded))
    size, step_time = min(len(found.low), len(kinds)), instrument.grid.step_time
    tested = trial(found.torque[:size], found.deviation[:size], kinds[:size], step_time)
    return contacts(tested, instrument.model.limits)


def counted(found: list[Contact], recorded: Recorded, within: float) -> Count:
    """Compare contacts with the pulses that acted."""
    step_time = STEP * recorded.recipe.rig.sample_time
    acts = np.abs(recorded.truth) > 0
    begins = np.flatnonzero(np.diff(acts.astype(np.int8)) > 0)
    ends = np.append(begins[1:], len(acts))
    begins, ends = (own[begins * step_time > CONTACT_SETTLING_TIME] for own in (begins, ends))
    delays = []
    for begin, end in zip(begins, ends, strict=True):
        first = [
            c.found for c in found if begin < c.found < end and acts[begin + 1 : c.found].all()
        ]
        delays += [float(first[0] - begin) * step_time] if first else []
    false = sum(not acts[max(0, c.begin - 1) : c.found + 1].any() for c in found)
    return Count(len(begins), len(delays), sum(d <= within for d in delays), tuple(delays), false)


Found = dict[tuple[str, str, str], Count]
"""By motion, whether with pulses, and whether by the sensor or by the oracle."""


def measured(rig: str, seed: int, power_cycle: int, store: Path | None) -> tuple[str, int, Found]:
    """Return the counts of one rig."""
    model, reach, constant = learned_in(store, rig, seed)
    counts: Found = {}
    for motion, (force, within) in WANTED.items():
        for touched, time in ((f"{force:g} N", TIME), ("none", QUIET)):
            recorded = record(rig, seed, motion, time, touched, power_cycle)
            instrument = instrument_of(recorded, model, reach, constant)
            for name, finds in (("sensor", found_by_sensor), ("known", found_by_oracle)):
                if touched != "none" or name == "sensor":
                    count = counted(finds(recorded, instrument), recorded, within)
                    counts[motion, touched, name] = count
    return rig, seed, counts


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--seed", type=int, default=1, help="the first")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--rig", choices=RIGS, action="append")
    parser.add_argument("--power-cycle", type=int, default=0, help="of the amplifier; learned at 0")
    parser.add_argument("--tables", type=Path, help="folder that keeps what was learned")
    arguments = parser.parse_args()
    seeds = range(arguments.seed, arguments.seed + arguments.seeds)
    how = arguments.power_cycle, arguments.tables
    work = [(rig, seed, *how) for rig in arguments.rig or ("thesis",) for seed in seeds]
    with ProcessPoolExecutor(arguments.jobs) as pool:
        for rig, seed, counts in pool.map(measured, *zip(*work, strict=True)):
            print(f"\n{rig} ({seed}), power-up {arguments.power_cycle}")
            for (motion, touched, name), one in counts.items():
                print(
                    f"  {motion:8} {touched:6} {name:7} {_line(motion, touched, one)}", flush=True
                )


def _line(motion: str, touched: str, one: Count) -> str:
    if touched == "none":
        return f"{one.false} reported in {QUIET:.0f} s"
    within, many = WANTED[motion][1], max(one.pulses, 1)
    median = 1e3 * float(np.median(one.delays)) if one.delays else math.nan
    return (
        f"{100 * one.in_time / many:.0f} % of {one.pulses} within {1e3 * within:.0f} ms, "
        f"{100 * one.found / many:.0f} % at all, median {median:.0f} ms; {one.false} beside them"
    )


if __name__ == "__main__":
    main()
