"""Speed of what users wait for: each row with its aim, and its ratio to a stored baseline.

Run with `make bench`, or for some groups of rows alone with

    python benchmarks/bench.py [--store] [rig] [commands] [small] [learning] [tables] [sensor]
                               [line] [growth]

Times are those of the processor, which other programs on the machine change little, except where
`make -j2` is waited for. A row that the machine has no baseline of becomes it, in build/bench.json;
`--store` replaces all that are measured. Prints; decides nothing.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

ROOT = Path(__file__).parents[1]
RECIPE = ROOT / "recipes" / "briaire-2006.toml"
FIXTURES = ROOT / "tests" / "fixtures"
RIGTOOL = [str(Path(sys.executable).with_name("rigtool"))]
BASELINE = ROOT / "build" / "bench.json"


def processor_time() -> float:
    """Return the processor's time for this program and those that it waited for, s."""
    both = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(used.ru_utime + used.ru_stime for used in both)


def best_of(
    function: Callable[[], object],
    repeats: int = 5,
    clock: Callable[[], float] = processor_time,
) -> float:
    times = []
    for _ in range(repeats):
        start = clock()
        function()
        times.append(clock() - start)
    return min(times)


def virtual_rig(attachment: str) -> float:
    """Return the time of one 8 kHz step, s, set points included."""
    import math

    from rigtool.recipe import load_recipe
    from rigtool.rigs import Feedforward, Task, open_rig
    from rigtool.rigs.motion import Triangle

    recipe, _ = load_recipe(RECIPE, [f"rig.attachment={attachment}"])
    rig = open_rig(recipe, 0.0454, "bench")
    ratio = recipe.rig.angle_ratio
    motion = Triangle(0, math.pi * ratio, 0.4 * math.pi * ratio, 0.35 * ratio, cycles=10)
    task = Task(motion, Feedforward(inertia=recipe.rig.nominal_inertia), record_every=16)
    steps = motion.duration / recipe.rig.sample_time

    def perform() -> None:
        for _ in rig.perform(task):
            pass

    perform()
    return best_of(perform) / steps


AIMS = {"info": 0.2}
"""Of commands on their fixtures, s; of the others 0.8."""

CLOCK_AIMS = {"report": 1.0, "report (all fixtures)": 3.0}
"""The same by the clock."""


LEAST = "import h5py, scipy.special, rigtool.recipe.load"
"""What each analysis imports at least."""

LOOP = """
import sys
from rigtool import api
for path in sys.argv[1:]:
    api.calibrate_kt(path, output=path + ".out", overwrite=True)
"""
"""One process that makes a run of each file."""


def command(*arguments: str) -> float:
    return best_of(lambda: run([*RIGTOOL, *arguments]), 3)


def program(code: str) -> float:
    return best_of(lambda: run([sys.executable, "-c", code]), 3)


def run(line: list[str]) -> None:
    subprocess.run(line, check=True, capture_output=True)


def show(what: str, value: float, unit: str, limit: float | None = None) -> None:
    """Print a row, and store it where it is the first of this machine."""
    text = f"{what:<52}{value:9.2f} {unit}"
    if limit is not None:
        text = f"{text:<70} (aim {limit:g} {unit})"
    stored = json.loads(BASELINE.read_text()) if BASELINE.is_file() else {}
    before = stored.get(what)
    if before:
        text = f"{text:<92} {value / before:.2f} of the baseline"
    print(text, flush=True)
    if before is None or "--store" in sys.argv:
        BASELINE.parent.mkdir(exist_ok=True)
        BASELINE.write_text(json.dumps(stored | {what: value}, indent=1))


def main() -> None:
    named = [word for word in sys.argv[1:] if word != "--store"]
    if unknown := set(named) - set(GROUPS):
        sys.exit(f"{', '.join(sorted(unknown))}: groups of rows are {', '.join(GROUPS)}")
    with tempfile.TemporaryDirectory() as folder:
        for name in named or GROUPS:
            own = Path(folder) / name
            own.mkdir()
            GROUPS[name](own)


def rig(folder: Path) -> None:
    """Show what a step of the virtual rig costs."""
    show("virtual rig, motor and wheel, a step", virtual_rig("pulley") * 1e9, "ns", 65)
    show("virtual rig, with instrument, a step", virtual_rig("instrument") * 1e9, "ns", 110)


def commands(folder: Path) -> None:
    """Show what each command costs on its stored run, its start included."""
    show("start of Python with h5py alone", program("import h5py"), "s")
    show("the same with scipy.special and the recipe's models", program(LEAST), "s")
    show("the same with matplotlib", program(f"{LEAST}, matplotlib.figure"), "s")
    show("rigtool --help", command("--help"), "s", 0.15)
    for name, arguments in fixture_commands(folder).items():
        limit = CLOCK_AIMS.get(name)
        aim = None if limit else AIMS.get(name, 0.8)
        show(f"rigtool {name} on its fixture", command(*arguments), "s", aim)
        if limit:  # two processes draw
            seconds = best_of(partial(run, [*RIGTOOL, *arguments]), 3, time.perf_counter)
            show(f"rigtool {name} on its fixture, clock", seconds, "s", limit)


def small(folder: Path) -> None:
    """Show what many small runs cost: a command each, and one process for all."""
    from growth import KT, cut, used

    from rigtool.runfile import open_run

    with open_run(KT) as run:
        paths = cut(run, "staircase", folder, 60)
    one = ["calibrate-kt", paths[0], "-o", str(folder / "one.h5"), "--overwrite", "-q"]
    show("a small run, a command each", command(*one), "s", 0.25)
    first, every = (min(used(LOOP, *paths[:n])[1] for _ in range(3)) for n in (10, 60))
    show("a small run, one process for all", (every - first) / 50, "s", 0.25)


def tables(folder: Path) -> None:
    """Show how long `make -j2 tables` takes by the clock, and its processor time."""
    start, used = time.perf_counter(), processor_time()
    line = ["make", "-j2", "tables", f"BUILD={folder}/build"]
    subprocess.run(line, check=True, cwd=ROOT, capture_output=True)
    show("make -j2 tables, after set-up", time.perf_counter() - start, "s", 15)
    show("make -j2 tables, processor time", processor_time() - used, "s")


def learning(folder: Path) -> None:
    """Show what learning costs."""
    from learning import INSTRUMENT, instrument, one_table, whole_b

    show("learning one table: 20 turns at 8 kHz", best_of(one_table()), "s", 0.3)
    show("rigtool ilc-learn, implementation B from its run", best_of(whole_b(folder), 3), "s", 1)
    if INSTRUMENT.is_dir():
        seconds = best_of(instrument(folder), 3)
        show("learning a real instrument, 25 runs of 20 s", seconds, "s", 5)


def sensor(folder: Path) -> None:
    """Show what the force sensor in C costs; `python benchmarks/sensor.py` counts operations."""
    from sensor import on_this_machine

    for kind, value in on_this_machine().items():
        show(f"force sensor in C, {kind}, a step of 1 ms", value, "us", 10)


def line(folder: Path) -> None:
    """Show what the serial line costs; ten minutes of it are `python benchmarks/line.py`."""
    from line import SHORT, measure

    for what, value, unit, limit in measure(SHORT):
        show(what, value, unit, limit)


def growth(folder: Path) -> None:
    """Show what a long run and many small ones cost; docs/performance.md explains."""
    from growth import HOUR, hour, many

    for name in HOUR:
        for what, value in hour(folder, name).items():
            unit, limit = ("MB", 300) if what.endswith("MB") else ("", 1.3)
            show(f"an hour: {name}, {what.removesuffix(', MB')}", value, unit, limit)
    for name, value in many(folder).items():
        aim = None if name.startswith("h5py") else 5
        show(f"1000 small files: {name}, each", value, "ms", aim)


def fixture_commands(folder: Path) -> dict[str, list[str]]:
    """Return each command's arguments for its stored run."""
    kt, tables = FIXTURES / "kt.h5", FIXTURES / "tables.h5"
    inputs: dict[str, list[str | Path]] = {
        "calibrate-kt": [kt],
        "stribeck": [FIXTURES / "friction.h5", "--kt", kt],
        "fft-ripple": [FIXTURES / "ripple.h5", "--kt", kt],
        "identify-plant": [FIXTURES / "plant.h5", "--kt", kt],
        "ilc-learn": [tables, "--kt", kt],
        "measure-force": [FIXTURES / "force.h5", "--kt", kt, "--tables", tables],
    }
    commands = {
        name: [name, *map(str, paths), "-o", str(folder / f"{name}.h5"), "--overwrite"]
        for name, paths in inputs.items()
    }
    report = ["-o", str(folder / "report"), "--overwrite"]
    commands["report"] = ["report", str(FIXTURES / "force.h5"), *report]
    commands["report (all fixtures)"] = [
        "report",
        *(str(path) for path in sorted(FIXTURES.glob("*.h5"))),
        *report,
    ]
    commands["info"] = ["info", str(kt)]
    return commands


GROUPS: dict[str, Callable[[Path], None]] = {
    group.__name__: group
    for group in (rig, commands, small, learning, tables, sensor, line, growth)
}
"""Rows that are measured together, by the name that asks for them."""


if __name__ == "__main__":
    main()
