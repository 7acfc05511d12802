"""Inputs that change while they are read, samples that no bench has, files of another kind."""

from __future__ import annotations

import functools
import hashlib
import os
import random
import shutil
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np

from rigtool.errors import RigtoolError
from rigtool.runfile.provenance import seal
from tests.attack.bench import ANALYSES, RECIPE, ROOT, Bench, inputs, measuring
from tests.attack.trial import Trial, content, run

MAPPINGS = ROOT / "recipes" / "import"


def _cut(path: Path, other: Path, luck: random.Random) -> None:
    os.truncate(path, luck.randrange(path.stat().st_size))


def _delete(path: Path, other: Path, luck: random.Random) -> None:
    path.unlink()


def _replace(path: Path, other: Path, luck: random.Random) -> None:
    new = path.with_suffix(".new")
    shutil.copyfile(other, new)
    os.replace(new, path)


def _write_into(path: Path, other: Path, luck: random.Random) -> None:
    with path.open("r+b") as stream:
        stream.seek(luck.randrange(path.stat().st_size))
        stream.write(luck.randbytes(luck.choice([8, 4096])))


CHANGES = (_cut, _delete, _replace, _write_into)


def _lines(path: Path, name: str, output: Path) -> list[list[object]]:
    command = ANALYSES[name]
    return [
        [command, path, *inputs(command), "-o", output / "o.h5"],
        ["export", path, "-o", output / "o.nc"],
        ["info", path, "--json"],
    ]


@functools.cache
def _undisturbed(line: tuple[object, ...]) -> tuple[int, str | None, float]:
    """Return exit code, content of the output if any, and duration [s] on a file that stays."""
    begin = time.perf_counter()
    code = run(line).code
    duration = time.perf_counter() - begin
    output = Path(str(line[-1]))
    found = content(output) if line[-2] == "-o" else None
    if line[-2] == "-o":
        output.unlink()
    return code, found, duration


def changing(bench: Bench) -> Trial:
    """A file that changes while it is read is refused, or what was read is whole."""
    luck = bench.luck
    name, other = luck.sample(["kt", "friction", "ripple", "plant", "force"], 2)
    path = bench.file(f"{name}.h5")
    shutil.copyfile(bench.stored[name], path)
    line = luck.choice(_lines(path, name, path.parent))
    output = path.parent / str(line[-1])
    code, expected, duration = _undisturbed(tuple(line))
    change, moment = luck.choice(CHANGES), luck.uniform(0, duration)

    def strike(process: int) -> None:
        time.sleep(moment)
        change(path, bench.stored[other], luck)

    found = run(line, strike)
    faults = list(found.faults)
    if found.code == code == 0 and expected is not None:
        try:
            # a file that takes the name before it is opened is what is exported, whole
            if content(output) not in (expected, content(bench.stored[other])):
                faults.append("different")
        except RigtoolError:
            faults.append("damaged")
    if any(left.startswith(".") for left in os.listdir(path.parent)):
        faults.append("left over")
    return replace(found, faults=tuple(faults))


SAMPLES: tuple[Callable[[np.ndarray], np.ndarray], ...] = (
    lambda values: values * 0,
    lambda values: -values,
    lambda values: values[::-1],
    lambda values: values * 1e-300,
    lambda values: values * 1e12,
    lambda values: values * 0 + 1e29,
    lambda values: values * 0 + 5e-324,
    lambda values: np.where(np.arange(values.size) == values.size // 2, 1e29, values),
    lambda values: np.where(np.arange(values.size) < values.size // 2, values, values + 1e6),
    lambda values: np.where(np.arange(values.size) % 2, 240.0, -240.0),
    lambda values: np.random.default_rng(1).normal(size=values.size),
    lambda values: np.round(values),
)


def samples(bench: Bench) -> Trial:
    """Samples of a stored run that no bench has, with correct hashes, are refused or analysed."""
    luck = bench.luck
    name = luck.choice(list(ANALYSES))
    path = bench.file(f"{name}.h5")
    shutil.copyfile(bench.stored[name], path)
    change = luck.choice(SAMPLES)
    with h5py.File(path, "r+") as file:
        recordings = [file["entry/recordings"][key] for key in file["entry/recordings"]]
        channel = luck.choice([key for key in recordings[0] if key != "conditions"])
        for recording in recordings if luck.random() < 0.6 else [luck.choice(recordings)]:
            if channel in recording:
                _edit(recording, channel, change)
        for digest in ("content_sha256", "record_sha256"):
            del file["entry/provenance"][digest]
        seal(file)
    command = ANALYSES[name]
    line = [command, path, *inputs(command), "-o", path.parent / "o.h5", "--json"]
    return run(line)


def _edit(recording: h5py.Group, channel: str, change: Callable[[np.ndarray], np.ndarray]) -> None:
    data = recording[channel]
    with np.errstate(all="ignore"), suppress(OverflowError):
        data[:] = np.nan_to_num(change(data[:].astype(float))).astype(data.dtype)
    data.attrs["sha256"] = np.bytes_(hashlib.sha256(data[:].tobytes()).hexdigest())


def another_kind(bench: Bench) -> Trial:
    """Each option of each command gets a file of any kind: refused, or it is what it needs."""
    luck = bench.luck
    out = bench.file("o.h5")
    files: list[object] = [*bench.stored.values(), RECIPE, *sorted(MAPPINGS.glob("*.toml"))]
    files += [ROOT / "README.md", ROOT / "docs" / "figures", ROOT / "nothing.h5", __file__]
    command = luck.choice(list(ANALYSES.values()))
    lines: list[list[object]] = [
        [command, luck.choice(files), *inputs(command), "-o", out],
        [command, bench.stored["tables"], *inputs(command), "-o", out],
        ["stribeck", bench.stored["friction"], "--against", luck.choice(files), "-o", out],
        ["deploy", bench.stored["turning"], "--rig", RECIPE, "--speed", 12.566, "--dry-run"],
        ["import", luck.choice(files), "--map", luck.choice(files), "-o", out],
        ["import", luck.choice(files), "--preview"],
        ["export", luck.choice(files), "-o", out.with_suffix(luck.choice([".csv", ".h", ".json"]))],
        ["report", *luck.choices(files, k=2), "-o", out.with_suffix("")],
        ["diff", *luck.choices(files, k=2)],
        ["recover", luck.choice(files), "-o", out],
        ["plot", luck.choice(files), "-o", out.with_suffix(".png")],
        [*measuring("measure-force", out), "--dry-run"],
        [*measuring("ilc-learn", out), "--dry-run"],
    ]
    line = luck.choice(lines)
    named = [place for place, word in enumerate(line) if word in files]
    if luck.random() < 0.7:
        line[luck.choice(named)] = luck.choice(files)
    found = run(line)
    if found.code != 0 and any(out.parent.iterdir()):
        return replace(found, faults=(*found.faults, "left over"))
    return found
