"""Run files put together from parts of others, with hashes that fit: units, attributes, samples,
conditions, recipes and provenance that belong to another channel, recording, run or time."""

from __future__ import annotations

import hashlib
import random
import shutil
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import h5py
import numpy as np

from rigtool.errors import RunFileError
from rigtool.runfile.provenance import seal
from tests.attack.bench import Bench
from tests.attack.edited import readers
from tests.attack.trial import Trial, run

Mix = Callable[[h5py.Group, h5py.Group, random.Random], None]
DATES = ("1970-01-01T00:00:00+00:00", "2100-02-29T25:61:00Z", "0000-00-00", "+292277026596", "")
DATES += ("2026-10-25T02:30:00+02:00", "9999-12-31T23:59:59-23:59", "NaT")


def _stamp(data: h5py.Dataset) -> None:
    data.attrs["sha256"] = np.bytes_(hashlib.sha256(data[()].tobytes()).hexdigest())


def _recording(entry: h5py.Group, luck: random.Random) -> h5py.Group:
    return entry["recordings"][luck.choice(list(entry["recordings"]))]


def _channels(recording: h5py.Group) -> list[str]:
    return [name for name in recording if name != "conditions"]


def _time(entry: h5py.Group, other: h5py.Group, luck: random.Random) -> None:
    """Time that runs backwards, stands, leaps or begins elsewhere within a recording."""
    data = _recording(entry, luck)["time"]
    found = data[:]
    begin, end = sorted(luck.randrange(found.size) for _ in range(2))
    step = float(found[1] - found[0])
    ways: tuple[Callable[[], object], ...] = (
        lambda: found[begin:end][::-1],
        lambda: found[begin],
        lambda: found[begin:end] + luck.choice([-3600, -step, step / 2, 3600, 1e9]),
        lambda: found[begin:end] - luck.choice([1e9, 3600, found[begin]]),
        lambda: np.repeat(found[begin:end:2], 2)[: end - begin],
    )
    found[begin:end] = luck.choice(ways)()
    data[:] = found
    _stamp(data)


def _samples_of_another(entry: h5py.Group, other: h5py.Group, luck: random.Random) -> None:
    """A channel has the samples of another recording or run: of another length, too."""
    recording = _recording(entry, luck)
    source = _recording(luck.choice([entry, other]), luck)
    name, from_name = luck.choice(_channels(recording)), luck.choice(_channels(source))
    if luck.random() < 0.5:
        from_name = name if name in source else from_name
    values, attributes = source[from_name][()], dict(recording[name].attrs)
    if luck.random() < 0.5:  # in the length of the recording
        values = np.resize(values, recording[name].shape)
    del recording[name]
    recording[name] = values
    for key in ("units", "long_name"):
        recording[name].attrs[key] = attributes[key]
    _stamp(recording[name])


def _recording_of_another(entry: h5py.Group, other: h5py.Group, luck: random.Random) -> None:
    """A recording of another run takes the place of one, or stands beside it."""
    source = _recording(other, luck)
    names = list(entry["recordings"])
    name = luck.choice([*names, names[0][:-1] + "9", "another"])
    if name in names:
        del entry["recordings"][name]
    other.copy(source, entry["recordings"], name)


def _columns(group: h5py.Group) -> list[h5py.Dataset]:
    return [item for item in group.values() if isinstance(item, h5py.Dataset)]


def _units(entry: h5py.Group, other: h5py.Group, luck: random.Random) -> None:
    """Two channels or columns change their units, or all their attributes."""
    where = luck.choice(["recordings", "tables"])
    group = entry[where][luck.choice(list(entry[where]))]
    one, another = luck.sample(_columns(group), 2)
    keys = ["units"] if luck.random() < 0.6 else sorted(set(one.attrs) & set(another.attrs))
    for key in keys:
        one.attrs[key], another.attrs[key] = another.attrs[key], one.attrs[key]


def _attributes(entry: h5py.Group, other: h5py.Group, luck: random.Random) -> None:
    """Any object has the attribute of the same name of any object of the other run."""
    mine: list[str] = []
    theirs: dict[str, list[object]] = {}
    entry.visit(mine.append)
    for key in ("units", "signal", "axes", "long_name", "degrees_of_freedom", "auxiliary_signals"):
        theirs[key] = []
    other.visititems(
        lambda _, item: (
            [theirs[k].append(item.attrs[k]) for k in item.attrs if k in theirs][:0] or None
        )
    )
    for _ in range(luck.choice([1, 1, 4])):
        item = entry[luck.choice(mine)]
        known = [key for key in item.attrs if theirs.get(key)]
        if known:
            key = luck.choice(known)
            item.attrs[key] = luck.choice(theirs[key])


def _axes(entry: h5py.Group, other: h5py.Group, luck: random.Random) -> None:
    """A table has its axes in the other order, its values turned, or both."""
    tables = [t for t in entry["tables"].values() if len(t.attrs.get("axes", ())) == 2]
    table = luck.choice(tables or list(entry["tables"].values()))
    axes = table.attrs["axes"]
    if luck.random() < 0.7:
        table.attrs["axes"] = axes[::-1]
    if luck.random() < 0.7:
        for name in list(table):
            if table[name].ndim == 2:
                values, attributes = table[name][()].T, dict(table[name].attrs)
                del table[name]
                table[name] = values
                table[name].attrs["units"] = attributes["units"]


def _order(entry: h5py.Group, other: h5py.Group, luck: random.Random) -> None:
    """The axis of a table is unordered, holds a value twice, or falls."""
    table = luck.choice(list(entry["tables"].values()))
    data = table[luck.choice(list(table.attrs["axes"])).decode()]
    values = data[()]
    ways: tuple[Callable[[], object], ...] = (
        lambda: values[::-1],
        lambda: np.roll(values, luck.randrange(1, 9)),
        lambda: np.full_like(values, values[0]),
        lambda: np.where(np.arange(values.size) == values.size // 2, values[0], values),
        lambda: -values,
    )
    data[...] = luck.choice(ways)()


def _conditions(entry: h5py.Group, other: h5py.Group, luck: random.Random) -> None:
    """Conditions of a recording are other numbers, missing, or those of another."""
    held = [r["conditions"] for r in entry["recordings"].values() if "conditions" in r]
    if not held:
        return
    conditions = luck.choice(held)
    name = luck.choice(list(conditions))
    attributes = dict(conditions[name].attrs)
    value = conditions[name][()]
    del conditions[name]
    if luck.random() < 0.8:
        numbers = [
            0.0,
            -1.0,
            np.nan,
            np.inf,
            1e300,
            1e-300,
            3.0,
            np.bytes_(b"x"),
            [1.0, 2.0],
            -value,
        ]
        conditions[name] = luck.choice([*numbers, luck.choice(held).get(name, [4.0])[()]])
        conditions[name].attrs.update(attributes)


def _uncertainty(entry: h5py.Group, other: h5py.Group, luck: random.Random) -> None:
    """Uncertainties and degrees of freedom of results and tables that no analysis has."""
    wrong = luck.choice([0.0, -1.0, np.nan, np.inf, 1e-320, 1e25])
    if luck.random() < 0.5:
        for result in entry["results"].values():
            for key in ("standard_uncertainty", "degrees_of_freedom"):
                if key in result.attrs and luck.random() < 0.6:
                    result.attrs[key] = wrong
        return
    for table in entry["tables"].values():
        for name in list(table):
            if name in ("u", "dof") or name.endswith("_u"):
                table[name][...] = wrong


def _text(group: h5py.Group, name: str, value: str) -> None:
    del group[name]
    group[name] = np.bytes_(value.encode()) if value else h5py.Empty("S1")


def _origin(entry: h5py.Group, other: h5py.Group, luck: random.Random) -> None:
    """Dates that cannot be, recipes, commands and seeds of another run, inputs in a circle."""
    mine, theirs = entry["provenance"], other["provenance"]
    what = luck.randrange(4)
    if what == 0:
        _text(mine, "date", luck.choice(DATES))
    elif what == 1:
        name = luck.choice(["recipe", "recipe_resolved", "seed", "argv", "version", "packages"])
        del mine[name]
        theirs.copy(name, mine)
    elif what == 2:
        for name in ("command", "rig"):
            if luck.random() < 0.6:
                del entry[name]
                other.copy(name, entry)
    elif "inputs" in mine:
        source = mine["inputs/0000"]
        _text(source, "path", entry.file.filename)
        for digest in ("content_sha256", "sha256"):
            if luck.random() < 0.5:
                _text(source, digest, mine["content_sha256"][()].decode())


MIXES: tuple[Mix, ...] = (
    _time,
    _samples_of_another,
    _recording_of_another,
    _units,
    _attributes,
    _axes,
    _order,
    _conditions,
    _uncertainty,
    _origin,
)


def mix(path: Path, other: Path, luck: random.Random) -> None:
    """Change a run file by parts of another, once or more, and make its hashes fit."""
    with h5py.File(path, "r+") as file, h5py.File(other) as second:
        for _ in range(luck.choice([1, 1, 1, 3])):
            with suppress(LookupError, TypeError, ValueError, RuntimeError, OSError):
                luck.choice(MIXES)(file["entry"], second["entry"], luck)
        for digest in ("content_sha256", "record_sha256"):
            del file["entry/provenance"][digest]
        with suppress(RunFileError):  # what no run file may hold has no hash either
            seal(file)


def mixed(bench: Bench) -> Trial:
    """A run that was put together from parts of others is refused, or read."""
    names = ("kt", "friction", "ripple", "plant", "force", "tables", "turning")
    name, other = (bench.luck.choice(names) for _ in range(2))
    path = bench.file(f"{name}.h5")
    shutil.copyfile(bench.stored[name], path)
    mix(path, bench.stored[other], bench.luck)
    again: list[list[object]] = [readers(name, path)[6]] * 5
    lines = [*again, *readers(name, path), ["verify", path], ["diff", path, bench.stored[name]]]
    return run(bench.luck.choice(lines))
