"""`make attack`: attacks for a time, by a seed; what must not be seen is counted and fails."""

from __future__ import annotations

import argparse
import math
import random
import shutil
import sys
import time
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.attack.bench import Bench, warm
from tests.attack.kinds import KINDS, Kind


def attack(
    folder: Path,
    seed: int,
    *,
    kinds: Mapping[str, Kind] = KINDS,
    seconds: float = math.inf,
    rounds: float = math.inf,
    kept: Path | None = None,
) -> list[str]:
    """Make attacks of all kinds in turn; print counts and return a line for each fault.

    The attack `number` of a kind depends on seed, kind and number only. What failed is kept.
    """
    warm()
    made: Counter[str] = Counter()
    codes: Counter[str] = Counter()
    faults: list[str] = []
    end = time.monotonic() + seconds
    number = 0
    while number < rounds and time.monotonic() < end:
        for name, kind in kinds.items():
            bench = Bench(folder, random.Random(f"{seed} {name} {number}"))
            found = kind(bench)
            made[name] += 1
            codes[f"{name}: {found.code}"] += 1
            for fault in found.faults:
                last = found.err.strip().splitlines()[-1:] or [""]
                faults.append(f"{name} {number}: {fault}: exit {found.code}: {last[0][:300]}")
                print(faults[-1], file=sys.stderr, flush=True)
                _keep(folder / "now", kept, f"{name} {number}")
        number += 1
    print(f"seed {seed}: " + ", ".join(f"{count} {name}" for name, count in made.items()))
    print("exit codes: " + ", ".join(f"{name} x {n}" for name, n in sorted(codes.items())))
    print(f"tracebacks, crashes, hangs, memory, different results: {len(faults)}")
    return faults


def _keep(now: Path, kept: Path | None, name: str) -> None:
    if kept is not None and now.exists():
        shutil.copytree(now, kept / name.replace(" ", "-"), dirs_exist_ok=True)


def main() -> int:
    """Attack as the command line asks; return the exit code."""
    parser = argparse.ArgumentParser(prog="attack", description=__doc__)
    parser.add_argument("--seconds", type=float, default=600)
    parser.add_argument("--rounds", type=float, default=math.inf, help="attacks of each kind")
    parser.add_argument("--kinds", nargs="*", default=list(KINDS), choices=list(KINDS))
    parser.add_argument("--seed", type=int, default=20061)
    parser.add_argument("--keep", type=Path, help="folder for the files of what failed")
    asked = parser.parse_args()
    with TemporaryDirectory() as folder:
        faults = attack(
            Path(folder),
            asked.seed,
            kinds={name: KINDS[name] for name in asked.kinds},
            seconds=asked.seconds,
            rounds=asked.rounds,
            kept=asked.keep,
        )
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
