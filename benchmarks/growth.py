"""A run of an hour at 8 kHz, and a thousand small run files: memory, and time against plain h5py.

Ratios make machines comparable: the time of a whole command over that of a process in which h5py
alone reads the same channels, chunk by chunk.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rigtool.runfile import RecordingSpec, Run, RunWriter, open_run

ROOT = Path(__file__).parents[1]
RECIPE = ROOT / "recipes" / "briaire-2006.toml"
FIXTURES = ROOT / "tests" / "fixtures"
KT, TABLES = FIXTURES / "kt.h5", FIXTURES / "tables.h5"
RIGTOOL = [str(Path(sys.executable).with_name("rigtool"))]

READ = """
import sys, h5py
with h5py.File(sys.argv[1]) as file:
    for group in file["entry/recordings"].values():
        for channel in sys.argv[2:]:
            dataset = group[channel]
            for chunk in dataset.iter_chunks():
                dataset[chunk]
"""

RIPPLE = ("time", "encoder", "current_setpoint")
FORCE = (*RIPPLE, "position_setpoint", "feedforward_current", "table_current")

HOUR = {
    "fft-ripple": (
        {"speeds": "[3]", "revolutions": "1717", "torques": "[]", "power_cycles": "0"},
        ["--kt", str(KT)],
        RIPPLE,
    ),
    "measure-force": (
        {"forces": "[0.25]", "cycles": "294", "extra_cycles": "1"},
        ["--kt", str(KT), "--tables", str(TABLES)],
        FORCE,
    ),
}
"""Settings of the command, inputs, and the channels that its analysis reads."""


def used(arguments: Sequence[str]) -> tuple[float, float, float]:
    """Run a command; return wall-clock and processor time, s, and the most memory, MB."""
    start = time.perf_counter()
    process = subprocess.Popen(arguments, stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    wall = time.perf_counter() - start
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise RuntimeError(f"{arguments}: ended with status {process.returncode}")
    return wall, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024


def hour(folder: Path, command: str, repeats: int = 3) -> dict[str, float]:
    """Record an hour, analyse it again from the file, and read it with h5py alone."""
    settings, inputs, channels = HOUR[command]
    section = command.replace("-", "_")
    path = str(folder / f"{command}.h5")
    options = [f"{section}.{key}={value}" for key, value in settings.items()]
    options.append(f"{section}.record_every=1")
    common = ["--overwrite", "-q", *inputs]
    record = [RECIPE, "-o", path, *common, *(x for option in options for x in ("--set", option))]
    recording = used([*RIGTOOL, command, *map(str, record)])
    analyse = [*RIGTOOL, command, path, "-o", str(folder / "again.h5"), *common]
    read = [sys.executable, "-c", READ, path, *channels]
    pairs = [(used(analyse), used(read)) for _ in range(repeats)]
    wall, processor = (
        min(analysed[i] for analysed, _ in pairs) / min(plain[i] for _, plain in pairs)
        for i in (0, 1)
    )
    return {
        "recording, MB": recording[2],
        "analysing, MB": max(analysed[2] for analysed, _ in pairs),
        "analysing / h5py alone, time": wall,
        "analysing / h5py alone, processor": processor,
    }


def many(folder: Path, count: int = 1000) -> dict[str, float]:
    """Return the milliseconds that each of many small files adds to a command."""
    folder.mkdir()
    with open_run(KT) as kt, open_run(FIXTURES / "friction.h5") as friction:
        staircases = _cut(kt, "staircase", folder, count)
        holds = _cut(friction, "holds", folder, count)
    found = {}
    for command, paths, more in (
        ("calibrate-kt", staircases, ["-o", str(folder / "out.h5")]),
        ("stribeck", holds, ["--kt", str(KT), "-o", str(folder / "out.h5")]),
        ("report", staircases, ["-o", str(folder / "report")]),
    ):
        few, everything = (
            used([*RIGTOOL, command, *paths[:size], *more, "--overwrite", "-q"])[0]
            for size in (count // 5, count)
        )
        found[command] = (everything - few) / (count - count // 5) * 1e3
    return found


def _cut(run: Run, name: str, folder: Path, count: int) -> list[str]:
    """Write small files, each with one part of a recording and with noise of its own."""
    recording = run.recording(name)
    whole = {channel.name: recording.read(channel.name) for channel in recording.channels}
    bounds = _parts(name, whole)
    rng = np.random.default_rng(1)
    paths = []
    for number in range(count):
        part = slice(*bounds[number % len(bounds)])
        block = {channel: values[part] for channel, values in whole.items()}
        block["current"] = block["current"] + 1e-4 * rng.standard_normal(block["current"].size)
        path = folder / f"{name}{number:04d}.h5"
        with RunWriter(
            path,
            command=run.command,
            recipe=run.recipe,
            recipe_text=None,
            recordings=[RecordingSpec(name, recording.channels)],
        ) as writer:
            writer.append(name, block)
            writer.finish({}, {})
        paths.append(str(path))
    return paths


def _parts(name: str, whole: dict[str, NDArray[np.float64]]) -> list[tuple[int, int]]:
    """Return where the staircases, or the holds, of a recording begin and end."""
    if name == "staircase":
        new = np.diff(whole["rotor_angle"]) != 0
    else:
        speed = np.diff(whole["position_setpoint"]) / np.diff(whole["time"])
        steady = np.abs(np.diff(speed, prepend=speed[0])) < 1e-6 * np.abs(speed).max()
        new = np.diff(steady.astype(int), append=0) != 0
    edges = [0, *(np.flatnonzero(new) + 1).tolist(), len(whole["time"])]
    return [(begin, end) for begin, end in pairwise(edges) if end - begin > 500]
