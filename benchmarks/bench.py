"""Speed of what users wait for. Prints; decides nothing.

Run with `make bench`. Ratios against a loop of plain numpy make machines comparable.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).parents[1]
RECIPE = ROOT / "recipes" / "briaire-2006.toml"
FIXTURES = ROOT / "tests" / "fixtures"
RIGTOOL = [str(Path(sys.executable).with_name("rigtool"))]


def best_of(function: Callable[[], object], repeats: int = 5) -> float:
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        function()
        times.append(time.perf_counter() - start)
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


def command(*arguments: str) -> float:
    return best_of(
        lambda: subprocess.run([*RIGTOOL, *arguments], check=True, capture_output=True), 3
    )


def show(what: str, value: float, unit: str, limit: float | None = None) -> None:
    text = f"{what:<52}{value:9.2f} {unit}"
    print(text if limit is None else f"{text:<70} (aim {limit:g} {unit})", flush=True)


def main() -> None:
    show("virtual rig, motor and wheel, a step", virtual_rig("pulley") * 1e9, "ns", 100)
    show("virtual rig, with instrument, a step", virtual_rig("instrument") * 1e9, "ns", 400)
    show("rigtool --help", command("--help"), "s", 0.15)
    with tempfile.TemporaryDirectory() as folder:
        for name, arguments in fixture_commands(Path(folder)).items():
            limit = None if "all" in name else 2
            show(f"rigtool {name} on its fixture", command(*arguments), "s", limit)
        learning(Path(folder))
        start = time.perf_counter()
        subprocess.run(
            ["make", "-j2", "tables", f"BUILD={folder}/build"],
            check=True,
            cwd=ROOT,
            capture_output=True,
        )
        show("make -j2 tables, after set-up", time.perf_counter() - start, "s", 40)
    force_sensor()
    line()
    growth()


def learning(folder: Path) -> None:
    """Show what learning costs."""
    from learning import one_table, whole_b

    show("learning one table: 20 turns at 8 kHz", best_of(one_table()), "s", 0.3)
    show("rigtool ilc-learn, implementation B from its run", whole_b(folder), "s", 3)


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
                unit, limit = ("MB", 600) if what.endswith("MB") else ("", 2)
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
