"""Speed of the serial line: 8 kHz streamed for a while, and blocks from a target's memory.

`make bench` streams for `SHORT` s; `python benchmarks/line.py` for ten minutes, or the seconds that
it is given. The emulated target is a process of its own; the share of a core is that of the host's
process alone. Ratios are against pyserial alone, which reads as many bytes in a plain loop.
"""

from __future__ import annotations

import json
import os
import pty
import subprocess
import sys
import time
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import serial

from rigtool.recipe import Recipe, load_recipe
from rigtool.rigs import Task, open_rig
from rigtool.rigs.motion import SpeedProfile
from rigtool.rigs.operator import Operator
from rigtool.rigs.serial.rig import SerialRig

ROOT = Path(__file__).parents[1]
RECIPE = ROOT / "recipes" / "briaire-2006.toml"
RIGTOOL = str(Path(sys.executable).with_name("rigtool"))
FOUR = "position_setpoint,encoder,current_setpoint,current"
SHORT, WHOLE = 15.0, 600.0
"""Times of streaming, s: by `make bench`, and by default."""

FRAME = 64
"""Samples of a frame, as the emulator sends them, for the plain stream."""

SENDER = """
import sys, time
size, rate, total = int(sys.argv[1]), float(sys.argv[2]), int(sys.argv[3])
sys.stdin.readline()
start, sent = time.perf_counter(), 0
while sent < total:
    sys.stdout.buffer.write(b"x" * size)
    sys.stdout.buffer.flush()
    sent += size
    time.sleep(max(0.0, start + sent / rate - time.perf_counter()))
"""


@contextmanager
def emulator(*options: str) -> Iterator[str]:
    """Yield the port of an emulated target in another process."""
    line = [RIGTOOL, "target-emulator", str(RECIPE), *options]
    with subprocess.Popen(
        line, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as process:
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
    operator = Operator(say=lambda text: None, present=False, yes=True)
    with open_rig(recipe(port, log), 0.0454, "bench", operator) as rig:
        blocks = rig.perform(task)
        samples = 0
        wall, processor = time.perf_counter(), time.process_time()
        for block in blocks:
            samples += len(block["time"])
        wall, processor = time.perf_counter() - wall, time.process_time() - processor
        return samples, wall, processor, json.loads(rig.report() or "{}")


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
        operator = Operator(say=lambda text: None, present=False, yes=True)
        with open_rig(recipe(port, "memory"), 0.0454, "bench", operator) as rig:
            assert isinstance(rig, SerialRig)
            blocks = rig.perform(
                Task(SpeedProfile((0.0, 1.0, seconds - 1.0, seconds), (0.0, 3.0, 3.0, 0.0)))
            )
            next(blocks)  # the motion is over with the first block
            before = rig.line.counts.bytes_received
            start = time.perf_counter()
            for _ in blocks:
                pass
            return (rig.line.counts.bytes_received - before) / (time.perf_counter() - start) / 1e6


def plain(total: int, bytes_per_s: float, size: int) -> tuple[float, float]:
    """Read bytes from a pty with pyserial alone; return its share of a core, and its rate, MB/s.

    They come in pieces of `size` at `bytes_per_s`, infinite for as fast as they are taken.
    """
    ours, theirs = pty.openpty()
    tty.setraw(theirs)
    line = [sys.executable, "-c", SENDER, str(size), str(bytes_per_s), str(total)]
    with (
        subprocess.Popen(line, stdin=subprocess.PIPE, stdout=ours) as sender,
        serial.Serial(os.ttyname(theirs), timeout=0.01) as port,
    ):
        assert sender.stdin is not None
        sender.stdin.write(b"\n")
        sender.stdin.close()
        wall, processor, got = time.perf_counter(), time.process_time(), 0
        while got < total:
            got += len(port.read(max(1, port.in_waiting)))
        wall, processor = time.perf_counter() - wall, time.process_time() - processor
    os.close(ours)
    os.close(theirs)
    return processor / wall, total / wall / 1e6


def measure(seconds: float) -> Iterator[tuple[str, float, str, float | None]]:
    """Yield what is measured: words, value, unit and aim."""
    rate = download()
    yield "blocks from a target's memory", rate, "MB/s", 1
    alone = plain(40_000_000, float("inf"), 4096)[1]
    yield "blocks from a target's memory / pyserial alone", rate / alone, "", None
    for what, options in (("4 channels", ("--channels", FOUR)), ("9 channels", ())):
        found = streaming(seconds, *options)
        name = f"8 kHz x {what}, {seconds:g} s"
        yield f"{name}: missing samples", found["missing"], "", 0
        yield f"{name}: share of a core", found["share of a core"], "", 0.15
        bytes_per_s = 1e3 * found["kB/s"]
        size = round(bytes_per_s * FRAME / 8000)
        alone, _ = plain(int(bytes_per_s * min(seconds, SHORT)), bytes_per_s, size)
        yield f"{name}: the same / pyserial alone", found["share of a core"] / alone, "", None


def main() -> None:
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else WHOLE
    for what, value, unit, aim in measure(seconds):
        print(f"{what}: {value:.4g} {unit}", "" if aim is None else f"(aim {aim:g})", flush=True)


if __name__ == "__main__":
    main()
