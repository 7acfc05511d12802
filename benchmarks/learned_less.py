"""What intervals and errors are where a rig is learned with less than by default.

    .venv/bin/python benchmarks/learned_less.py [KIND:SEED] [--row NAME ...]
        [--tables build/learned]

The rig is learned with each of `ROWS`, then read in 40 s of strokes and of free motion, each with
pulses and with weak contacts, at the learned power-up and 10 Hz. Printed are the share of samples
with a value, the share of 95 % intervals that hold, with the least of a recording, and the error,
each of the smoothed and of the causal torque.
"""

from __future__ import annotations

import argparse
import math
import re
import tempfile
from pathlib import Path

import numpy as np
from accuracy_tables import FORMS
from learned import Learned, instrument_of, judged, learned
from numpy.typing import NDArray
from oracle import MOTIONS, motion_states, record

from rigtool.experiments.force_filter.motion_states import State

LOADS, CYCLES, MOVES = "ilc_learn.loads.forces=", "ilc_learn.loads.cycles=", "ilc_learn.moves="
LOAD_SPEEDS, SPEEDS = "ilc_learn.loads.speeds_rev_per_s=", "ilc_learn.speeds_rev_per_s="
TIME = 40.0
"""Of a recording, s."""

ROWS = {
    "defaults": (),
    "loads at 1 rev/s alone": (LOAD_SPEEDS + "[1]",),
    "loads at 0.2 rev/s alone": (LOAD_SPEEDS + "[0.2]",),
    "0.5 and 3 N": (LOADS + "[0.5,3]",),
    "2.9 and 3 N": (LOADS + "[2.9,3]",),
    "0.03 and 0.1 N": (LOADS + "[0.03,0.1]",),
    "5 cycles, 3 moves": (CYCLES + "5", MOVES + "3"),
    "loads and moves at 0.2 rev/s": (LOAD_SPEEDS + "[0.2]", SPEEDS + "[0.2]"),
    "loads and moves at 2 rev/s": (LOAD_SPEEDS + "[2]", SPEEDS + "[2]"),
    "0.5 and 3 N at 1 rev/s, 5 cycles, 2 moves at 1 rev/s": (
        LOADS + "[0.5,3]",
        LOAD_SPEEDS + "[1]",
        CYCLES + "5",
        SPEEDS + "[1]",
        MOVES + "2",
    ),
}
"""Settings of the learning, by name."""


def measured(name: str, rig: str, seed: int, store: Path | None) -> str:
    """Learn one rig in one way, read it, and return a row of the table."""
    with tempfile.TemporaryDirectory() as none:
        folder = store / f"{rig}-{seed}-{re.sub(r'[^0-9A-Za-z]+', '-', name)}" if store else none
        Path(folder).mkdir(parents=True, exist_ok=True)
        known = learned(rig, seed, Path(folder), ROWS[name])
    texts: dict[str, list[str]] = {}
    for form, parts in read_all(rig, seed, known).items():
        least = min(np.mean(held[valued]) for _, held, valued in parts)
        error, held, valued = (np.concatenate(own) for own in zip(*parts, strict=True))
        texts[form] = [
            f"{100 * np.mean(valued):.1f}",
            f"{100 * np.mean(held[valued]):.1f} ({100 * least:.0f})",
            f"{1e3 * math.sqrt(np.mean(error[valued] ** 2)):.2f}",
        ]
    pairs = (" / ".join(own) for own in zip(*texts.values(), strict=True))
    return f"| {name} | " + " | ".join(pairs) + " |"


Part = tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_]]
"""Error, whether its interval holds, and whether there is a value, (n,)."""


def read_all(rig: str, seed: int, known: Learned) -> dict[str, list[Part]]:
    """Return the parts of all recordings of a rig by form."""
    model, reach, constant = known
    parts: dict[str, list[Part]] = {form: [] for form in FORMS}
    for contacts in ("pulses", "weak"):
        for motion in MOTIONS:
            recorded = record(rig, seed, motion, TIME, contacts)
            used = motion_states(recorded)["all"]
            sensor = instrument_of(recorded, model, reach, constant)
            for form, rows, _, error, u, states in judged(recorded, sensor):
                own = used[rows][: len(error)]
                held, valued = error <= 1.96 * u, states != State.OUTSIDE
                parts[form].append((error[own], held[own], valued[own]))
    return parts


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("rig", nargs="?", default="thesis:93", help="KIND:SEED")
    parser.add_argument("--row", choices=ROWS, action="append")
    parser.add_argument("--tables", type=Path, help="folder that keeps what was learned")
    arguments = parser.parse_args()
    rig, seed = arguments.rig.split(":")
    for name in arguments.row or ROWS:
        print(measured(name, rig, int(seed), arguments.tables), flush=True)


if __name__ == "__main__":
    main()
