"""Speed of what users wait for. Prints; decides nothing.

Run with `make bench`. Times are those of the processor, which other programs on the machine change
little, except where `make -j2` is waited for. The first run on a machine stores its figures as the
baseline in build/bench.json; later ones print their ratio to it, `--store` replaces it.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]
RECIPE = ROOT / "recipes" / "briaire-2006.toml"
FIXTURES = ROOT / "tests" / "fixtures"
RIGTOOL = [str(Path(sys.executable).with_name("rigtool"))]
BASELINE = ROOT / "build" / "bench.json"

measured: dict[str, float] = {}


def processor_time() -> float:
    """Return the processor's time for this program and those that it waited for, s."""
    both = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(used.ru_utime + used.ru_stime for used in both)


def best_of(function: Callable[[], object], repeats: int = 5) -> float:
    times = []
    for _ in range(repeats):
        start = processor_time()
        function()
        times.append(processor_time() - start)
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

    def run() -> None:
        for _ in rig.perform(task):
            pass

    run()
    return best_of(run) / steps


AIMS = {"info": 0.2, "report": 1.0, "report (all fixtures)": 3.0}
"""Of commands on their fixtures, s; of the others 0.8."""


def command(*arguments: str) -> float:
    return best_of(
        lambda: subprocess.run([*RIGTOOL, *arguments], check=True, capture_output=True), 3
    )


def show(what: str, value: float, unit: str, limit: float | None = None) -> None:
    measured[what] = value
    text = f"{what:<52}{value:9.2f} {unit}"
    if limit is not None:
        text = f"{text:<70} (aim {limit:g} {unit})"
    if (before := baseline().get(what)) is not None:
        text = f"{text:<92} {value / before:.2f} of the baseline"
    print(text, flush=True)


@cache
def baseline() -> dict[str, float]:
    """Return the stored figures of this machine, by what was measured."""
    return json.loads(BASELINE.read_text()) if BASELINE.is_file() else {}


def main() -> None:
    show("virtual rig, motor and wheel, a step", virtual_rig("pulley") * 1e9, "ns", 65)
    show("virtual rig, with instrument, a step", virtual_rig("instrument") * 1e9, "ns", 110)
    show("rigtool --help", command("--help"), "s", 0.15)
    with tempfile.TemporaryDirectory() as folder:
        for name, arguments in fixture_commands(Path(folder)).items():
            limit = AIMS.get(name, 0.8)
            show(f"rigtool {name} on its fixture", command(*arguments), "s", limit)
        learning(Path(folder))
        start = time.perf_counter()
        subprocess.run(
            ["make", "-j2", "tables", f"BUILD={folder}/build"],
            check=True,
            cwd=ROOT,
            capture_output=True,
        )
        show("make -j2 tables, after set-up", time.perf_counter() - start, "s", 15)
    force_sensor()
    line()
    growth()
    if not BASELINE.is_file() or "--store" in sys.argv:
        BASELINE.parent.mkdir(exist_ok=True)
        BASELINE.write_text(json.dumps(measured, indent=1))


def learning(folder: Path) -> None:
    """Show what learning costs."""
    from learning import one_table, whole_b

    show("learning one table: 20 turns at 8 kHz", best_of(one_table()), "s", 0.3)
    show("rigtool ilc-learn, implementation B from its run", best_of(whole_b(folder), 3), "s", 1)


def force_sensor() -> None:
    """Show what the force sensor in C costs; `python benchmarks/sensor.py` counts operations."""
    from sensor import on_this_machine

    for kind, value in on_this_machine().items():
        show(f"force sensor in C, {kind}, a step of 1 ms", value, "us", 10)


def line() -> None:
    """Show what the serial line costs; ten minutes of it are `python benchmarks/line.py`."""
    from line import SHORT, measure

    for what, value, unit, limit in measure(SHORT):
        show(what, value, unit, limit)


def growth() -> None:
    """Show what a long run and many small ones cost; docs/performance.md explains."""
    from growth import HOUR, hour, many

    with tempfile.TemporaryDirectory() as folder:
        for name in HOUR:
            for what, value in hour(Path(folder), name).items():
                unit, limit = ("MB", 300) if what.endswith("MB") else ("", 1.3)
                show(f"an hour: {name}, {what.removesuffix(', MB')}", value, unit, limit)
        for name, value in many(Path(folder)).items():
            show(f"1000 small files: {name}, each", value, "ms", 5)


def fixture_commands(folder: Path) -> dict[str, list[str]]:
    """Return each command's arguments for its stored run."""
    kt, tables = FIXTURES / "kt.h5", FIXTURES / "tables.h5"
    inputs = {
        "calibrate-kt": [kt],
        "stribeck": [FIXTURES / "friction.h5", "--kt", kt],
        "fft-ripple": [FIXTURES / "ripple.h5", "--kt", kt],
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


if __name__ == "__main__":
    main()
