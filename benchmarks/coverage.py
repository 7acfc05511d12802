"""How often stated intervals hold what they were computed for, on virtual rigs drawn anew.

    make coverage
    .venv/bin/python benchmarks/coverage.py [--rigs N] [--first 1] [--only NAME] [--short] [--list]
    .venv/bin/python benchmarks/coverage.py --kept FILE      in parts: what FILE has is not run
    .venv/bin/python benchmarks/coverage.py --kept FILE --rigs 0 --markdown     what FILE holds

Each design of `DESIGNS` is one way to use a command: what the recipe says, and what is drawn for
each rig (constants, frictions, noises, ripple; errors of arm and gauge from their stated standard
uncertainty). A pull is (result - truth)/u. `holds` counts intervals of 95 %, u times the quantile
of Student's t with the result's degrees of freedom, that contain the truth; the range behind it is
its 95 % interval (Clopper & Pearson, Biometrika 26, 404, 1934). `refused` counts the rigs for which
the command states that the data do not carry a result. The short form ends with exit code 1 where
a result is beyond 5 u, or where so few intervals hold that chance does not explain it.

With `--kept`, each rig is a line of JSON in FILE as soon as it is done. The file knows nothing of
the code: remove it where the code has changed.
"""

from __future__ import annotations

if __name__ == "coverage":
    # numba looks for the package of this name, which measures which lines run, and finds this file.
    raise ImportError("benchmarks/coverage.py is a script")

import argparse
import json
import os
import re
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path

# As the command line: a rig on each core, and threads of a small matrix only wait for each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from designs import DESIGNS, group
from numpy.typing import NDArray
from scipy import stats
from trials import Trial, trials

FAR = 5.0
"""Pull that no result may exceed."""

UNLIKELY = 1e-3
"""Probability of so few intervals that hold, if they hold in 95 %, below which a row fails."""

SHORT = {
    "calibrate-kt, 4 x 3": 24,
    "calibrate-kt, 3 x 2": 24,
    "calibrate-kt, friction x 4": 24,
    "calibrate-kt, far": 24,
    "calibrate-kt, wrong bench": 24,
    "stribeck, near": 10,
    "fft-ripple, near": 10,
    "identify-plant, pulley, near": 10,
    "identify-plant, pulley, far": 16,
    "identify-plant, instrument": 6,
    "measure-force, pulley": 6,
}
"""Rigs of each design in the short form."""


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

    @property
    def fails(self) -> bool:
        """Whether chance does not explain the row."""
        few = float(stats.binom.cdf(self.held, self.count, 0.95))
        return bool(self.far) or few < UNLIKELY

    def __str__(self) -> str:
        interval = stats.binomtest(self.held, self.count).proportion_ci()
        return (
            f"  {self.name:42}{self.count:4}{100 * self.held / self.count:7.0f} "
            f"({100 * interval.low:3.0f}-{100 * interval.high:3.0f}){self.mean:+8.2f}"
            f"{self.std:6.2f}{self.far:5}"
        )

    def markdown(self, design: str, tried: int, refused: int) -> str:
        """Return the row as a line of a table of Markdown."""
        interval = stats.binomtest(self.held, self.count).proportion_ci()
        return (
            f"| {design} | {self.name} | {self.count} | {100 * self.held / self.count:.0f} "
            f"({100 * interval.low:.0f} to {100 * interval.high:.0f}) | {self.mean:+.2f} | "
            f"{self.std:.2f} | {self.far} | {refused} of {tried} |"
        )


def print_markdown(name: str, trials: Sequence[Trial]) -> None:
    """Print the rows of one design as lines of a table of Markdown."""
    refused = sum(trial.refusal is not None for trial in trials)
    for row in rows(trials):
        print(row.markdown(name, len(trials), refused))


def rigs_of(number: int, arguments: argparse.Namespace) -> int:
    """Return how many rigs of a design are tried."""
    if arguments.short:
        return SHORT[DESIGNS[number].name]
    return DESIGNS[number].rigs if arguments.rigs is None else int(arguments.rigs)


def kept(path: Path | None) -> dict[str, dict[int, Trial]]:
    """Return the trials of a file by design and seed."""
    found: dict[str, dict[int, Trial]] = {design.name: {} for design in DESIGNS}
    if path is not None and path.exists():
        for line in path.read_text(encoding="utf-8").splitlines():
            one = json.loads(line)
            results = {(name, number): tuple(errors) for name, number, errors in one["found"]}
            trial_ = Trial(one["seed"], results, one["refusal"])
            found[one["design"]][trial_.seed] = trial_
    return found


def line_of(design: str, tried: Trial) -> str:
    """Return a trial as a line of JSON."""
    found = [[*key, errors] for key, errors in tried.found.items()]
    return json.dumps(asdict(tried) | {"design": design, "found": found}) + "\n"


def print_design(name: str, trials: Sequence[Trial]) -> bool:
    """Print the rows of one design, and why rigs were refused; return whether a row fails."""
    # Refusals for the same reason differ in their numbers.
    reasons = [trial.refusal for trial in trials if trial.refusal is not None]
    refusals = Counter(re.sub(r"-?\d[\d.e-]*", "#", reason) for reason in reasons)
    print(f"{name}: {len(trials)} rigs, {refusals.total()} refused")
    found = list(rows(trials))
    for row in found:
        print(row)
    for refusal, count in refusals.most_common():
        print(f"  refused {count}: {refusal}")
    return any(row.fails for row in found)


def rows(trials: Sequence[Trial]) -> Iterator[Row]:
    """Yield the coverage of each result."""
    found: dict[str, list[tuple[float, float, float]]] = {}
    for tried in trials:
        for (name, _), errors in tried.found.items():
            found.setdefault(name, []).append(errors)
    for name, own in found.items():
        yield Row.of(name, np.array(own))


def main() -> None:
    """Try every design and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rigs", type=int, help="drawn for each design (24; 12 that learn loads)")
    parser.add_argument("--first", type=int, default=1, help="seed of the first rig")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--only", help="designs whose name contains this")
    parser.add_argument(
        "--short", action="store_true", help="a few rigs; exit code 1 where it fails"
    )
    parser.add_argument("--list", action="store_true", help="name the designs")
    parser.add_argument("--kept", type=Path, help="file of JSON lines; what it has is not run")
    parser.add_argument("--markdown", action="store_true", help="print tables of Markdown")
    arguments = parser.parse_args()
    chosen = [n for n, d in enumerate(DESIGNS) if (arguments.only or "") in d.name]
    if arguments.short:
        chosen = [n for n in chosen if DESIGNS[n].name in SHORT]
    if arguments.list:
        print("\n".join(DESIGNS[number].name for number in chosen))
        return
    if not arguments.markdown:
        print(f"{'result':44}{'n':>4}{'holds, % (interval)':>20}{'pull':>5}{'std':>7}{'far':>5}")
    failed, known = False, kept(arguments.kept)
    with ExitStack() as stack:
        pool = stack.enter_context(ProcessPoolExecutor(arguments.jobs))
        out = stack.enter_context(arguments.kept.open("a")) if arguments.kept else None
        for number in chosen:
            together = [n for n in group(number) if n in chosen]
            names = [DESIGNS[n].name for n in together]
            seeds = range(arguments.first, arguments.first + rigs_of(number, arguments))
            missing = [seed for seed in seeds if any(seed not in known[name] for name in names)]
            for tried in pool.map(trials, [together] * len(missing), missing):
                for name, one in zip(names, tried, strict=True):
                    known[name][one.seed] = one
                    if out is not None:
                        out.write(line_of(name, one))
                        out.flush()
            name = DESIGNS[number].name
            done = known[name]
            if arguments.markdown:
                print_markdown(name, list(done.values()))
            elif done:
                failed |= print_design(name, list(done.values()))
    sys.exit(arguments.short and failed)


if __name__ == "__main__":
    main()
