"""Kinds of attack. Each does one thing by its luck and returns the trial with the faults found."""

from __future__ import annotations

import json
import os
import random
import re
import shutil
import signal
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np

from rigtool.runfile.provenance import seal
from tests.attack.bench import (
    ANALYSES,
    MEASURING,
    RECIPE,
    RECIPES,
    Bench,
    inputs,
    measuring,
    said,
)
from tests.attack.edited import edited
from tests.attack.mixed import mixed
from tests.attack.surroundings import refusing
from tests.attack.trial import Trial, at, content, run
from tests.attack.wrong_inputs import another_kind, changing, samples

Kind = Callable[[Bench], Trial]


def with_fault(found: Trial, *faults: str) -> Trial:
    """Return a trial with more faults."""
    return replace(found, faults=(*found.faults, *faults))


# -- interrupts


def kill(bench: Bench) -> Trial:
    """A command that is killed loses nothing that was there, and its signals can be recovered."""
    command = bench.luck.choice(list(MEASURING))
    expected, duration = bench.expected(command)
    output = bench.file("run.h5")
    earlier = bench.stored["kt"].read_bytes()
    output.write_bytes(earlier)
    strike = at(bench.luck.uniform(0, duration), signal.SIGKILL)
    found = run(measuring(command, output), strike, frozenset({0, -signal.SIGKILL}))
    if output.read_bytes() != earlier and content(output) != expected:
        return with_fault(found, "different")
    part = output.with_name("run.h5.part")
    if part.exists():
        found = _recovered(found, part, bench.folder / f"{command}.whole.h5")
    again = run(measuring(command, output))
    left = sorted(os.listdir(output.parent))
    faults = [*again.faults, *(["left over"] if left != ["run.h5"] else [])]
    return with_fault(found, *faults) if faults else found


def _recovered(found: Trial, part: Path, whole: Path) -> Trial:
    from rigtool.runfile import open_run

    back = part.with_name("back.h5")
    recovery = run(["recover", part, "-o", back])
    faults = list(recovery.faults)
    if recovery.code == 0:
        with open_run(back) as some, open_run(whole) as every:
            for name, recording in some.recordings.items():
                for channel in recording.channels:
                    beginning = every.recordings[name].read_stored(channel.name, 0, recording.size)
                    if not np.array_equal(recording.read_stored(channel.name), beginning):
                        faults.append("different")
        back.unlink()
    elif "nothing to recover" not in recovery.err:
        faults.append("not recovered")
    return with_fault(found, *faults) if faults else found


def interrupt(bench: Bench) -> Trial:
    """Ctrl-C and SIGTERM end a command in order, whenever they come."""
    command = bench.luck.choice(list(MEASURING))
    expected, duration = bench.expected(command)
    output = bench.file("run.h5")
    number = bench.luck.choice([signal.SIGINT, signal.SIGTERM, signal.SIGQUIT])
    strike = at(bench.luck.uniform(0, duration), number)
    codes = frozenset({0, 128 + number, 130 if number == signal.SIGINT else 143})
    found = run(measuring(command, output), strike, codes)
    faults = []
    if found.code == 0 and content(output) != expected:
        faults.append("different")
    if found.code != 0 and output.exists() and content(output) != expected:
        faults.append("half written")
    part = output.with_name("run.h5.part")
    if part.exists():
        if "rigtool recover" not in found.err:
            faults.append("silent part")
        found = _recovered(found, part, bench.folder / f"{command}.whole.h5")
    hidden = [name for name in os.listdir(output.parent) if name.startswith(".")]
    return with_fault(found, *faults, *(["left over"] if hidden else []))


# -- files


def _flip(data: bytearray, luck: random.Random) -> None:
    for _ in range(luck.choice([1, 1, 2, 8])):
        data[luck.randrange(len(data))] ^= luck.randrange(1, 256)


def _flip_head(data: bytearray, luck: random.Random) -> None:
    data[luck.randrange(min(30_000, len(data)))] ^= 1 << luck.randrange(8)


def _overwrite(data: bytearray, luck: random.Random) -> None:
    size = luck.choice([1, 8, 512, 4096])
    start = luck.randrange(max(1, len(data) - size))
    data[start : start + size] = luck.choice([bytes(size), b"\xff" * size, luck.randbytes(size)])


def _cut(data: bytearray, luck: random.Random) -> None:
    del data[luck.randrange(len(data)) :]


def _swap(data: bytearray, luck: random.Random) -> None:
    size = luck.choice([16, 512, 4096])
    one, other = (luck.randrange(max(1, len(data) // size)) * size for _ in range(2))
    first, second = data[one : one + size], data[other : other + size]
    data[one : one + len(second)], data[other : other + len(first)] = second, first


DAMAGE = (_flip, _flip_head, _overwrite, _cut, _swap)


def _reading(bench: Bench, name: str, path: Path) -> list[object]:
    """Return a command line that reads a run file and writes, if at all, beside it."""
    luck, output = bench.luck, path.parent
    command = ANALYSES[name]
    return luck.choice(
        [
            ["info", path, "--json"],
            ["verify", path],
            ["diff", path, bench.stored[name]],
            ["report", path, "-o", output / "report", "-q"],
            ["export", path, "-o", output / "o.mat"],
            ["export", path, "--part", "results", "-o", output / "o.csv"],
            [command, path, *inputs(command), "-o", output / "again.h5", "--json"],
        ]
    )


def damaged(bench: Bench) -> Trial:
    """A damaged file is refused, or read as if it were whole."""
    name = bench.luck.choice(["kt", "friction", "ripple", "plant", "force"])
    good = bench.file(f"{name}.h5")
    shutil.copyfile(bench.stored[name], good)
    line = _reading(bench, name, good)
    code, expected = said(tuple(line))
    shutil.rmtree(good.parent)
    good.parent.mkdir()
    data = bytearray(bench.stored[name].read_bytes())
    bench.luck.choice(DAMAGE)(data, bench.luck)
    good.write_bytes(data)
    found = run(line, expected=frozenset({code, 1, 3, 4}))
    if found.code == code == 0 and _without_origin(found.out) != _without_origin(expected):
        return with_fault(found, "different")
    return found


def _without_origin(text: str) -> object:
    """Return what was printed, a document without its provenance: the hash of a damaged file is
    another, also where the damage is in bytes that nothing uses."""
    try:
        document = json.loads(text)
    except ValueError:
        return text
    if isinstance(document, dict):
        document.pop("provenance", None)
    return document


VALUES: tuple[Callable[[random.Random], object], ...] = (
    lambda luck: luck.choice([0, -1, 2**31, 2**63 - 1, 1.5, float("nan"), float("inf")]),
    lambda luck: "x" * luck.choice([0, 1, 300, 100_000]),
    lambda luck: luck.choice(["\x1b[2J", "*/ x /*", "=1+1", "</script>", "\u202e", "/dev/zero"]),
    lambda luck: np.array(luck.choice([[], [1.0], [[1, 2], [3, 4]]])),
    lambda luck: np.zeros(luck.choice([0, 1, 5, 1000]), luck.choice(["f4", "i1", "u8", "S3"])),
    lambda luck: np.void(b"\0\1\2"),
    lambda luck: h5py.Empty("f8"),
    lambda luck: np.array(["a", "b"], dtype=h5py.string_dtype()),
    lambda luck: np.zeros(3, dtype=[("a", "f8"), ("b", "i4")]),
    lambda luck: "[" * luck.choice([10, 5000]),
    lambda luck: luck.choice(["{}", "[]", "null", '{"inputs": 3}', "1e999", "-" * 50]),
)


def _tamper(file: h5py.File, luck: random.Random) -> None:
    """Change one object or attribute of a run file into something that HDF5 allows."""
    found: list[str] = []
    file.visit(found.append)
    name = luck.choice(found)
    item = file[name]
    parent, key = item.parent, name.rpartition("/")[2]
    value = luck.choice(VALUES)(luck)
    what = luck.randrange(10)
    if what < 4 and len(item.attrs):
        item.attrs[luck.choice(list(item.attrs))] = value
    elif what == 4:
        item.attrs["units"] = file.ref if luck.random() < 0.5 else value
    elif what == 5:
        del parent[key]
    elif what == 6:
        del parent[key]
        links = [h5py.SoftLink("/nowhere"), h5py.ExternalLink("other.h5", "/"), file["/"]]
        parent[key] = luck.choice(links)
    elif what == 7:
        del parent[key]
        parent.create_group(key)
    elif what == 8:
        del parent[key]
        size = luck.choice([0, 1, 10**6, 2**40])
        parent.create_dataset(key, shape=(size,), chunks=(1024,), dtype=luck.choice(["f8", "S9"]))
    else:
        del parent[key]
        parent[key] = value


def malicious(bench: Bench) -> Trial:
    """A file that is valid HDF5 and nonsense is refused or read, and harms nobody."""
    name = bench.luck.choice(["kt", "friction", "ripple", "plant", "force"])
    path = bench.file(f"{name}.h5")
    shutil.copyfile(bench.stored[name], path)
    with h5py.File(path, "r+") as file:
        for _ in range(bench.luck.choice([1, 1, 3])):
            try:
                _tamper(file, bench.luck)
            except (LookupError, TypeError, ValueError, RuntimeError, OSError):
                continue  # HDF5 does not allow this one, or nothing is left to change
        if bench.luck.random() < 0.7:
            with suppress(Exception):  # as whoever makes such a file on purpose would
                for digest in ("content_sha256", "record_sha256"):
                    del file["entry/provenance"][digest]
                seal(file)
    return run(_reading(bench, name, path))


# -- words


NUMBERS = ("0", "-1", "1e-300", "1e308", "-1e9", "nan", "inf", "7", "1000000000000", "0.5", "1e5")
WORDS = (*NUMBERS, '""', '"x"', "true", "[]", "[1, 2]", "{}", "[[1]]", "1979-05-27", "'\\u0007'")


def _mutated(text: str, luck: random.Random) -> str:
    """Change lines of a TOML or CSV text."""
    lines = text.splitlines()
    for _ in range(luck.choice([1, 1, 2, 4])):
        place = luck.randrange(len(lines))
        line, what = lines[place], luck.randrange(7)
        if what < 4:
            numbers = list(re.finditer(r"-?\d+(\.\d+)?(e-?\d+)?", line))
            if numbers:
                one = luck.choice(numbers)
                lines[place] = line[: one.start()] + luck.choice(WORDS) + line[one.end() :]
        elif what == 4:
            del lines[place]
            lines = lines or [""]
        elif what == 5:
            lines.insert(luck.randrange(len(lines) + 1), line)
        else:
            cut = luck.randrange(len(line) + 1)
            lines[place] = line[:cut] + chr(luck.choice([0, 7, 34, 44, 61, 91, 8238])) + line[cut:]
    return "\n".join(lines) + "\n"


def _prepared(bench: Bench, recipe: Path, *more: object) -> list[object]:
    """Return the line of a command that moves nothing, or the springs, which is soon over."""
    command = bench.luck.choice(list(MEASURING))
    line = measuring(command, bench.folder / "now" / "run.h5", recipe)
    dry = () if command == "suspension" and bench.luck.random() < 0.5 else ("--dry-run",)
    return [*line, *dry, *more]


def recipe(bench: Bench) -> Trial:
    """A recipe that was changed is refused with its line, or taken."""
    source = bench.luck.choice(RECIPES)
    path = bench.file("rig.toml")
    text = _mutated(source.read_text(encoding="utf-8"), bench.luck)
    path.write_text(text, encoding="utf-8", errors="replace")
    return run(_prepared(bench, path))


def setting(bench: Bench) -> Trial:
    """A value of --set is refused or taken, of a recipe and of a stored run."""
    luck = bench.luck
    bench.file("run.h5")
    key, known = luck.choice(_settings())
    value: object = luck.choice((*WORDS, *(str(10.0 ** luck.randint(-12, 12)) for _ in range(9))))
    if isinstance(known, float) and luck.random() < 0.6:
        value = known * 10 ** luck.uniform(-1.5, 1.5)
    elif isinstance(known, int) and luck.random() < 0.6:
        value = luck.choice([known, 1 + known, 3, not known])
    word = f"{key}={value}"
    if luck.random() < 0.8:
        return run(_prepared(bench, RECIPE, "--set", word))
    name = luck.choice(["kt", "force", "plant"])
    output, command = bench.folder / "now" / "again.h5", ANALYSES[name]
    return run([command, bench.stored[name], *inputs(command), "-o", output, "--set", word])


def _settings() -> list[tuple[str, object]]:
    from rigtool.recipe import load_recipe

    def leaves(tree: object, path: str) -> list[tuple[str, object]]:
        if not isinstance(tree, dict):
            return [(path[1:], tree)]
        return [leaf for key, value in tree.items() for leaf in leaves(value, f"{path}.{key}")]

    return leaves(load_recipe(RECIPE)[0].model_dump(), "")


MAPPING = """mapping = 1
[rig]
name = "bench"
encoder_counts = 4096
torque_constant = 0.045
[file]
comment = "%"
[signals]
time = { column = 1, unit = "ms" }
position = { column = 2, unit = "count", counts_per_turn = 4096, wraps_at = 65536 }
current = { column = 3, unit = "mA", offset = 2, scale = 10, sign = -1 }
"""


def imported(bench: Bench) -> Trial:
    """Measurements of other programs are imported, or refused with their line."""
    luck = bench.luck
    folder = bench.file("a").parent
    values = np.column_stack([np.arange(60) * 2.0, np.arange(60) * 7.0, np.sin(np.arange(60.0))])
    text = "\n".join(",".join(f"{x:.6g}" for x in row) for row in values) + "\n"
    mapping = MAPPING
    kind = luck.choice(["csv", "csv", "npy", "npz", "mat", "gz"])
    if luck.random() < 0.5:
        mapping = _mutated(mapping, luck)
    source = folder / f"a.{kind}"
    if kind == "csv":
        source.write_text(_mutated(text, luck), encoding="utf-8", errors="replace")
    else:
        data = bytearray(_binary(kind, values, folder))
        if luck.random() < 0.7:
            luck.choice(DAMAGE)(data, luck)
        source.write_bytes(data)
    (folder / "map.toml").write_text(mapping, encoding="utf-8", errors="replace")
    return run(["import", source, "--map", folder / "map.toml", "-o", folder / "a.h5"])


def _binary(kind: str, values: np.ndarray, folder: Path) -> bytes:
    import gzip

    import scipy.io

    path = folder / f"made.{kind}"
    if kind == "gz":
        return gzip.compress(b"\n".join(b",".join(b"%g" % x for x in row) for row in values))
    if kind == "mat":
        scipy.io.savemat(path, {"a": values})
    elif kind == "npy":
        np.save(path, values)
    else:
        np.savez(path, a=values)
    data = path.read_bytes()
    path.unlink()
    return data


KINDS: dict[str, Kind] = {
    "kills": kill,
    "signals": interrupt,
    "damaged files": damaged,
    "malicious files": malicious,
    "edited tables": edited,
    "mixed files": mixed,
    "recipes": recipe,
    "settings": setting,
    "imports": imported,
    "refusals": refusing,
    "changed inputs": changing,
    "samples": samples,
    "other files": another_kind,
}
