"""Runs whose tables and results were edited, with hashes that fit."""

from __future__ import annotations

import random
import shutil
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import h5py
import numpy as np

from rigtool.runfile.provenance import seal
from tests.attack.bench import ANALYSES, KT, RECIPE, ROOT, TABLES, Bench, inputs
from tests.attack.trial import Trial, run

FIXTURES = ROOT / "tests" / "fixtures"
FORCE, FRICTION, TURNING = (FIXTURES / f"{n}.h5" for n in ("force", "friction", "turning"))
SHORT = ("--set", "ilc_learn.moves=2", "--set", "ilc_learn.speeds_rev_per_s=[3]")
SHORT += ("--set", "ilc_learn.low_speeds_rev_per_s=[]")
NUMBERS = (0.0, -1.0, float("nan"), float("inf"), 1e300, 1e-300)
EDITS = ("column", "column", "column", "table", "result")


def readers(name: str, path: Path) -> list[list[object]]:
    """Return the lines that read a run of the fixtures; what they write is beside it."""
    folder = path.parent
    out = ["-o", folder / "again.h5", "-q"]
    learn = ["ilc-learn", RECIPE, "--kt", KT, *SHORT, *out]
    of_all: list[list[object]] = [
        ["info", path],
        ["info", path, "--json"],
        ["report", path, "-o", folder / "report", "-q"],
        ["plot", path, "-o", folder / "o.png", "-q"],
        ["export", path, "-o", folder / "o.mat"],
        ["export", path, "--part", "results", "-o", folder / "o.csv"],
        [ANALYSES[name], path, *inputs(ANALYSES[name]), *out],
    ]
    of_one: dict[str, list[list[object]]] = {
        "kt": [
            ["measure-force", FORCE, "--kt", path, "--tables", TABLES, *out],
            ["stribeck", FRICTION, "--kt", path, *out],
            [
                "export",
                TURNING,
                "--format",
                "moteus",
                "--speed",
                "12.57",
                "--kt",
                path,
                "-o",
                folder / "o.cfg",
            ],
        ],
        "friction": [[*learn, "--friction", path]],
        "plant": [[*learn, "--plant", path], [*learn, "--plant", path, "--learning-filter", "frf"]],
        "tables": [
            ["measure-force", FORCE, "--kt", KT, "--tables", path, *out],
            ["ilc-learn", RECIPE, "--kt", KT, "--check", path, *out],
            [*learn, "--prior", path],
            *(["export", path, "--format", how, "-o", folder / "o.h"] for how in ("c", "c-int16")),
            ["export", path, "--format", "table", "-o", folder / "o.json"],
        ],
        "turning": [
            ["ilc-learn", RECIPE, "--kt", KT, "--check", path, *out],
            [
                "export",
                path,
                "--format",
                "moteus",
                "--speed",
                "12.57",
                "--kt",
                KT,
                "-o",
                folder / "o.cfg",
            ],
            ["export", path, "--format", "fourier", "--speed", "12.57", "-o", folder / "o.json"],
            [
                "export",
                path,
                "--format",
                "odrive",
                "--speed",
                "12.57",
                "--kt",
                KT,
                "-o",
                folder / "o.json",
            ],
        ],
    }
    return of_all + of_one.get(name, []) * 2


def _values(found: np.ndarray, luck: random.Random) -> object:
    """Return other values for a column."""
    size = found.size
    ways: tuple[Callable[[], object], ...] = (
        lambda: "text",
        lambda: np.array([b"a"] * max(1, size)),
        lambda: np.full(found.shape, np.nan),
        lambda: np.full(found.shape, luck.choice([np.inf, 0.0, -1.0, 1e308, 1e-308])),
        lambda: np.where(np.arange(size) == size // 2, np.nan, found.ravel()).reshape(found.shape),
        lambda: np.round(found).astype("i4") if np.isfinite(found).all() else found,
        lambda: found.astype("f4"),
        lambda: found > 0,
        lambda: found.astype("c16"),
        lambda: found[..., None],
        lambda: found.ravel(),
        lambda: found.T,
        lambda: found[:0],
        lambda: found[:1],
        lambda: found[::-1],
        lambda: -found,
        lambda: np.float64(3.0),
        lambda: h5py.Empty("f8"),
    )
    return luck.choice(ways)()


def _edit_column(table: h5py.Group, luck: random.Random) -> str:
    """Change a column of a table; return what was done."""
    name = luck.choice(list(table))
    item = table[name]
    attributes, found = dict(item.attrs), item[()]
    what = luck.randrange(6)
    if what == 0:
        del table[name]
        return f"without {name}"
    if what == 1:
        table.move(name, "other")
        return f"{name} renamed"
    if what == 2:
        item.attrs["units"] = np.bytes_(luck.choice(["kg", "1", "A", "rad", "", "mN m"]))
        return f"unit of {name}"
    value = _values(found, luck)
    del table[name]
    table[name] = value
    for key, one in attributes.items():
        if key == "units" or luck.random() < 0.9:
            table[name].attrs[key] = one
    return f"{name} as {value!r:.60}"


def _edit_table(tables: h5py.Group, other: h5py.Group, luck: random.Random) -> str:
    """Change a table as a whole; return what was done."""
    name = luck.choice(list(tables))
    what = luck.randrange(5)
    if what == 0:
        del tables[name]
        return f"no {name}"
    if what == 1:
        from_name = luck.choice(list(other))
        del tables[name]
        other.copy(from_name, tables, name)
        return f"{name} is {from_name}"
    if what == 2:
        keep = luck.choice([0, 1, 2])
        for column in list(tables[name]):
            item = tables[name][column]
            attributes, found = dict(item.attrs), item[()]
            shape = tuple(slice(0, keep) for _ in range(found.ndim))
            del tables[name][column]
            tables[name][column] = found[shape]
            tables[name][column].attrs.update(attributes)
        return f"{name} cut to {keep}"
    attribute = luck.choice(["axes", "signal"])
    columns = [np.bytes_(c) for c in tables[name]]
    if attribute == "signal":
        tables[name].attrs["signal"] = luck.choice(columns)
    else:
        count = min(len(columns), luck.choice([1, 1, 2]))
        tables[name].attrs["axes"] = np.array(luck.sample(columns, count))
    return f"{attribute} of {name}"


def _edit_result(results: h5py.Group, luck: random.Random) -> str:
    """Change a result; return what was done."""
    name = luck.choice(list(results))
    item = results[name]
    what = luck.randrange(6)
    if what == 0:
        del results[name]
        return f"no result {name}"
    if what == 1:
        item.attrs["units"] = np.bytes_(luck.choice(["kg", "1", "", "mN m"]))
        return f"unit of result {name}"
    if what == 2:
        key = luck.choice(["standard_uncertainty", "degrees_of_freedom"])
        item.attrs[key] = luck.choice([0.0, -1.0, float("nan"), float("inf"), 1e300])
        return f"{key} of {name}"
    if what == 3:
        item.attrs.pop("standard_uncertainty", None)
        return f"no u of {name}"
    attributes = dict(item.attrs)
    value = luck.choice([*NUMBERS, -float(item[()])])
    del results[name]
    results[name] = value
    results[name].attrs.update(attributes)
    return f"{name} = {value}"


def edit(path: Path, other: Path, luck: random.Random) -> str:
    """Edit one thing of a run file and make its hashes fit; return what was done."""
    what = luck.choice(EDITS)
    with h5py.File(path, "r+") as file, h5py.File(other) as second:
        entry = file["entry"]
        if what == "result":
            done = _edit_result(entry["results"], luck)
        elif what == "table":
            done = _edit_table(entry["tables"], second["entry/tables"], luck)
        else:
            table = luck.choice(list(entry["tables"]))
            done = f"{table}: " + _edit_column(entry["tables"][table], luck)
        for digest in ("content_sha256", "record_sha256"):
            del file["entry/provenance"][digest]
        seal(file)
    return done


def edited(bench: Bench) -> Trial:
    """A run with other tables or results than its command writes is refused, or read."""
    names = ("kt", "friction", "ripple", "plant", "force", "tables", "turning")
    name, other = (bench.luck.choice(names) for _ in range(2))
    path = bench.file(f"{name}.h5")
    shutil.copyfile(bench.stored[name], path)
    with suppress(LookupError, TypeError, ValueError, RuntimeError, OSError):
        edit(path, bench.stored[other], bench.luck)  # not all of it can be stored
    return run(bench.luck.choice(readers(name, path)))
