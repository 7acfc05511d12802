"""How processor time and memory grow: with samples, loads, orders, runs and figures.

Each row takes a command on stored data of growing size, start of the program included, and fits

    value = a + b n^p

to its processor time and to its most memory. Prints p of both, and the n at which the memory would
be 4 GB, by this law. Prints; decides nothing.

    python benchmarks/exponents.py [samples] [loads] [orders] [runs] [figures]
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from growth import COMMAND, FIXTURES, HOUR, KT, RECIPE, cut, used
from numpy.typing import NDArray

from rigtool.runfile import open_run

MACHINE_MB = 4096
REPEATS = 3
QUIETLY = ("--overwrite", "-q")

Case = tuple[float, tuple[object, ...]]
"""A size, and the arguments of the command at that size."""

MAPPING = """mapping = 1
[rig]
name = "bench"
[signals]
time = { column = "t", unit = "s" }
position = { column = "p", unit = "rad" }
torque = { column = "m", unit = "N m" }
"""


def fitted(sizes: NDArray[np.float64], values: NDArray[np.float64]) -> tuple[float, float, float]:
    """Return a, b and p of the values (n,), a and b not negative, by least relative squares."""
    best = (np.inf, 0.0, 0.0, 0.0)
    for p in np.arange(0.2, 3.01, 0.02):
        design = np.column_stack([np.ones(len(sizes)), sizes**p]) / values[:, None]
        (a, b), *_ = np.linalg.lstsq(design, np.ones(len(sizes)), rcond=None)
        left = float(np.sum((design @ (a, b) - 1) ** 2))
        if a >= 0 and b >= 0 and left < best[0]:
            best = (left, a, b, float(p))
    return best[1:]


def samples(folder: Path) -> Iterator[tuple[str, str, list[Case]]]:
    """Yield recordings of growing length at 8 kHz."""
    for command, setting, sizes in (
        ("fft-ripple", "revolutions", (50, 100, 200, 400)),
        ("measure-force", "cycles", (9, 27, 81, 243)),
    ):
        settings, inputs, _ = HOUR[command]
        section = command.replace("-", "_")
        cases: list[Case] = []
        for size in sizes:
            path = folder / f"{command}{size}.h5"
            every = {**settings, setting: size, "record_every": 1}
            sets = [word for key, value in every.items() for word in _set(section, key, value)]
            used(COMMAND, command, RECIPE, "-o", path, *inputs, *QUIETLY, *sets)
            with open_run(path) as run:
                count = sum(run.recording(name).size for name in run.recordings)
            again = (command, path, "-o", folder / "again.h5", *inputs, *QUIETLY)
            cases.append((count / 1e6, again))
        yield f"{command}: million samples", "million samples", cases


def loads(folder: Path) -> Iterator[tuple[str, str, list[Case]]]:
    """Yield recordings of a growing number of loads."""
    inputs = HOUR["measure-force"][1]
    cases: list[Case] = []
    for size in (5, 10, 20, 40):
        path = folder / f"loads{size}.h5"
        forces = np.linspace(0.1, 2.5, size).round(4).tolist()
        every = {"forces": forces, "cycles": 6, "extra_cycles": 1}
        sets = [word for key, value in every.items() for word in _set("measure_force", key, value)]
        used(COMMAND, "measure-force", RECIPE, "-o", path, *inputs, *QUIETLY, *sets)
        again = ("measure-force", path, "-o", folder / "again.h5", *inputs, *QUIETLY)
        cases.append((size, again))
    yield "measure-force: loads of 6 cycles", "loads", cases


def orders(folder: Path, count: int = 160_000) -> Iterator[tuple[str, str, list[Case]]]:
    """Yield imported recordings of equal length, with more and more samples, and orders, a turn."""
    (folder / "mapping.toml").write_text(MAPPING)
    random = np.random.default_rng(1)
    cases: list[Case] = []
    for size in (12, 25, 50, 100, 400):
        turns = np.arange(count) / (2.5 * size)
        angle, time = 2 * np.pi * turns, turns / 0.5
        torque = 1e-3 * np.sin(7 * angle) + random.normal(0, 1e-4, count)
        raw = folder / f"orders{size}"
        raw.mkdir()
        np.savez(raw / "one.npz", t=time, p=angle, m=torque)
        imported = folder / f"imported{size}"
        used(COMMAND, "import", raw, "--map", folder / "mapping.toml", "-o", imported, "-q")
        cases.append(
            (size, ("fft-ripple", imported / "one.h5", "-o", folder / "again.h5", *QUIETLY))
        )
    yield f"fft-ripple: samples a turn, import of {count} samples", "samples a turn", cases


def runs(folder: Path) -> Iterator[tuple[str, str, list[Case]]]:
    """Yield a growing number of small runs in one call."""
    sizes, output = (125, 250, 500, 1000), ("-o", folder / "out.h5", *QUIETLY)
    with open_run(KT) as kt, open_run(FIXTURES / "friction.h5") as friction:
        staircases = cut(kt, "staircase", folder, sizes[-1])
        holds = cut(friction, "holds", folder, sizes[-1])
    for name, paths, more in (
        ("calibrate-kt", staircases, ()),
        ("stribeck", holds, ("--kt", KT)),
    ):
        cases: list[Case] = [(n, (name, *paths[:n], *more, *output)) for n in sizes]
        yield f"{name}: small runs in one call", "runs", cases


def figures(folder: Path) -> Iterator[tuple[str, str, list[Case]]]:
    """Yield reports of a growing number of runs with seven figures each."""
    cases: list[Case] = []
    for size in (1, 2, 4, 8):
        paths = [folder / f"force{number}.h5" for number in range(size)]
        for path in paths:
            shutil.copy(FIXTURES / "force.h5", path)
        arguments = ("report", *paths, "-o", folder / "report", *QUIETLY)
        cases.append((7 * size, arguments))
    yield "report: figures", "figures", cases


def _set(section: str, key: str, value: object) -> tuple[str, str]:
    return "--set", f"{section}.{key}={value}"


AXES: dict[str, Callable[[Path], Iterator[tuple[str, str, list[Case]]]]] = {
    axis.__name__: axis for axis in (samples, loads, orders, runs, figures)
}


def main() -> None:
    for axis in sys.argv[1:] or AXES:
        with tempfile.TemporaryDirectory() as folder:
            for title, unit, cases in AXES[axis](Path(folder)):
                sizes, times, memories = [], [], []
                for size, arguments in cases:
                    each = [used(COMMAND, *arguments) for _ in range(REPEATS)]
                    sizes.append(float(size))
                    times.append(min(processor for _, processor, _ in each))
                    memories.append(max(memory for *_, memory in each))
                print(title)
                for row in zip(sizes, times, memories, strict=True):
                    print("  {:10.4g}{:9.2f} s{:8.0f} MB".format(*row))
                _, _, exponent = fitted(np.array(sizes), np.array(times))
                a, b, p = fitted(np.array(sizes), np.array(memories))
                full = ((MACHINE_MB - a) / b) ** (1 / p) if b > 0 else np.inf
                print(f"  time ~ n^{exponent:.2f}, memory ~ n^{p:.2f}; 4 GB at {full:.2g} {unit}")
                print("", flush=True)


if __name__ == "__main__":
    main()
