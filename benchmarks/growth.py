"""A run of an hour at 8 kHz, and a thousand small run files: memory, and time against plain h5py.

Ratios make machines comparable: the time of a whole command over that of a process in which h5py
alone reads the same channels, chunk by chunk.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rigtool.runfile import RecordingSpec, Run, RunWriter, open_run

ROOT = Path(__file__).parents[1]
RECIPE = ROOT / "recipes" / "briaire-2006.toml"
FIXTURES = ROOT / "tests" / "fixtures"
KT, TABLES = FIXTURES / "kt.h5", FIXTURES / "tables.h5"

COMMAND = """
import sys
from rigtool.cli import main
try:
    main(sys.argv[1:])
except SystemExit as done:
    if done.code:
        raise
"""
"""A command of rigtool, in a program that lives on to say how much memory it had."""

READ = """
import sys, h5py
with h5py.File(sys.argv[1]) as file:
    for group in file["entry/recordings"].values():
        for channel in sys.argv[2:]:
            dataset = group[channel]
            for chunk in dataset.iter_chunks():
                dataset[chunk]
"""

READ_FILES = """
import sys, h5py
for path in sys.argv[1:]:
    with h5py.File(path) as file:
        def read(name, item):
            dict(item.attrs)
            if isinstance(item, h5py.Dataset):
                item[()]
        file.visititems(read)
"""
"""All that is in many files."""

MEMORY = """
print(open("/proc/self/status").read().split("VmHWM:")[1].split()[0])
"""
"""Most memory so far, KiB: the kernel's `ru_maxrss` would start at what this process has."""

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


def used(program: str, *arguments: object) -> tuple[float, float, float]:
    """Run a program; return wall-clock and processor time, s, and the most memory, MB."""
    line = [sys.executable, "-c", program + MEMORY, *map(str, arguments)]
    start = time.perf_counter()
    with subprocess.Popen(line, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        printed = process.stdout.read()
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    wall = time.perf_counter() - start
    if process.returncode:
        raise RuntimeError(f"{arguments}: ended with status {process.returncode}")
    return wall, usage.ru_utime + usage.ru_stime, int(printed.split()[-1]) / 1024


def hour(folder: Path, command: str, repeats: int = 3) -> dict[str, float]:
    """Record an hour, analyse it again from the file, and read it with h5py alone."""
    settings, inputs, channels = HOUR[command]
    section = command.replace("-", "_")
    path = folder / f"{command}.h5"
    sets = [f"{section}.{key}={value}" for key, value in settings.items()]
    sets.append(f"{section}.record_every=1")
    common = [*inputs, "--overwrite", "-q"]
    options = [item for value in sets for item in ("--set", value)]
    recording = used(COMMAND, command, RECIPE, "-o", path, *common, *options)
    again = (command, path, "-o", folder / "again.h5", *common)
    # By turns, so that whatever else the machine does slows both.
    pairs = [(used(COMMAND, *again), used(READ, path, *channels)) for _ in range(repeats)]
    wall, processor = (
        min(analysed[i] for analysed, _ in pairs) / min(plain[i] for _, plain in pairs)
        for i in (0, 1)
    )
    path.unlink()
    return {
        "recording, MB": recording[2],
        "analysing, MB": max(analysed[2] for analysed, _ in pairs),
        "analysing / h5py alone, time": wall,
        "analysing / h5py alone, processor": processor,
    }


def many(folder: Path, count: int = 1000, repeats: int = 2) -> dict[str, float]:
    """Return the milliseconds of processor time that each of many small files adds to a command.

    For comparison, that of a program in which h5py alone reads all that is in the same files.
    """
    with open_run(KT) as kt, open_run(FIXTURES / "friction.h5") as friction:
        staircases = cut(kt, "staircase", folder, count)
        holds = cut(friction, "holds", folder, count)
    few, found = count // 5, {}
    quietly = ["--overwrite", "-q"]
    for name, program, paths, before, after in (
        (
            "calibrate-kt",
            COMMAND,
            staircases,
            ["calibrate-kt"],
            ["-o", folder / "out.h5", *quietly],
        ),
        ("stribeck", COMMAND, holds, ["stribeck", "--kt", KT], ["-o", folder / "out.h5", *quietly]),
        ("report", COMMAND, staircases, ["report"], ["-o", folder / "report", *quietly]),
        ("h5py alone, staircases", READ_FILES, staircases, [], []),
        ("h5py alone, holds", READ_FILES, holds, [], []),
    ):
        part, whole = (
            min(used(program, *before, *paths[:size], *after)[1] for _ in range(repeats))
            for size in (few, count)
        )
        found[name] = (whole - part) / (count - few) * 1e3
    return found


def cut(run: Run, name: str, folder: Path, count: int) -> list[str]:
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
