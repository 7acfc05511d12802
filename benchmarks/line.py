"""Speed of the serial line: 8 kHz streamed for ten minutes, and blocks from a target's memory.

Run with `python benchmarks/line.py [SECONDS]`. The emulated target is a process of its own; the
share of a core is that of the host's process alone.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rigtool.recipe import Recipe, load_recipe
from rigtool.rigs import Task, open_rig
from rigtool.rigs.bench import Bench, Operator
from rigtool.rigs.motion import SpeedProfile

ROOT = Path(__file__).parents[1]
RECIPE = ROOT / "recipes" / "briaire-2006.toml"
RIGTOOL = str(Path(sys.executable).with_name("rigtool"))
FOUR = "position_setpoint,encoder,current_setpoint,current"


@contextmanager
def emulator(*options: str) -> Iterator[str]:
    """Yield the port of an emulated target in another process."""
    line = [RIGTOOL, "target-emulator", str(RECIPE), *options]
    with subprocess.Popen(line, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            yield process.stdout.readline().strip()
        finally:
            process.terminate()


def recipe(port: str, log: str) -> Recipe:
    return load_recipe(
        RECIPE,
        [
            "rig.source=serial",
            "rig.attachment=pulley",
            "serial.driver=target",
            f'serial.port="{port}"',
            f"serial.log={log}",
            "serial.watchdog=5",
            "serial.limits.current=10",
            "serial.limits.speed=60",
            "serial.limits.position=[-1e6, 1e6]",
            "serial.limits.temperature_degc=90",
            "serial.limits.duration=4000",
        ],
    )[0]


def run(port: str, log: str, seconds: float) -> tuple[int, float, float, dict[str, float]]:
    """Return samples, time on the wall and of the processor, s, and the report of the line."""
    task = Task(SpeedProfile((0.0, 1.0, seconds - 1.0, seconds), (0.0, 3.0, 3.0, 0.0)))
    bench = Bench(yes=True, operator=Operator(say=lambda text: None, present=False))
    with open_rig(recipe(port, log), 0.0454, "bench", bench) as rig:
        blocks = rig.perform(task)
        samples = 0
        wall, processor = time.perf_counter(), time.process_time()
        for block in blocks:
            samples += len(block["time"])
        wall, processor = time.perf_counter() - wall, time.process_time() - processor
        return samples, wall, processor, json.loads(rig.report())


def streaming(seconds: float, *options: str) -> dict[str, float]:
    with emulator("--paced", *options) as port:
        samples, wall, processor, report = run(port, "stream", seconds)
    return {
        "samples": samples,
        "missing": round(seconds * 8000) - samples + report["missing_samples"],
        "read again": report["samples_read_again"],
        "share of a core": processor / wall,
        "kB/s": report["bytes_received"] / wall / 1e3,
    }


def download(seconds: float = 60.0) -> float:
    """Return the rate at which a log comes out of a target's memory, MB/s."""
    with emulator() as port:
        bench = Bench(yes=True, operator=Operator(say=lambda text: None, present=False))
        with open_rig(recipe(port, "memory"), 0.0454, "bench", bench) as rig:
            blocks = rig.perform(
                Task(SpeedProfile((0.0, 1.0, seconds - 1.0, seconds), (0.0, 3.0, 3.0, 0.0)))
            )
            next(blocks)  # the motion is over with the first block
            before = rig.line.counts.bytes_received
            start = time.perf_counter()
            for _ in blocks:
                pass
            return (rig.line.counts.bytes_received - before) / (time.perf_counter() - start) / 1e6


def main() -> None:
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 600.0
    print(f"blocks from memory: {download():.1f} MB/s (aim 1)")
    for what, options in (("4 channels", ("--channels", FOUR)), ("9 channels", ())):
        found = streaming(seconds, *options)
        facts = ", ".join(f"{name} {value:.4g}" for name, value in found.items())
        print(f"8 kHz x {what} for {seconds:g} s: {facts} (aim: missing 0, share 0.15)")


if __name__ == "__main__":
    main()
