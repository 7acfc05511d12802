"""Hundreds of damaged files: each is refused with a message, or read with nothing changed."""

import random
from collections import Counter
from pathlib import Path

import pytest

from rigtool.errors import RunFileError
from rigtool.runfile import open_run
from tests.runfile.whole_run import write
from tests.thorough import first_of

FILES = 550
HEADERS = 30_000  # bytes at the start that hold most of the structure


@pytest.fixture(scope="module")
def small_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run with everything: a whole chunk and a part of one."""
    folder = tmp_path_factory.mktemp("small")
    return write(folder / "run.h5", size=8500, inputs=(write(folder / "input.h5", size=10),))


def everything(path: Path) -> str:
    """Return all that a run says, as a text to compare."""
    with open_run(path) as run:
        tables = {
            name: {key: (column, column.values.tobytes()) for key, column in table.columns.items()}
            for name, table in run.tables.items()
        }
        signals = {
            name: (
                {key: item.read(key).tobytes() for key in item.units},
                item.channels,
                dict(item.conditions),
            )
            for name, item in run.recordings.items()
        }
        parts = (dict(run.results), tables, signals, run.notes, run.provenance, run.recipe)
        return repr((run.command, run.rig, *parts))


def unless_refused(path: Path) -> str | None:
    """Return everything, or None where the file is refused with a message that names it."""
    try:
        return everything(path)
    except RunFileError as error:
        if str(path) not in str(error):
            raise
        return None


def flipped(data: bytearray, luck: random.Random) -> None:
    for _ in range(luck.choice([1, 1, 2, 8])):
        data[luck.randrange(len(data))] ^= luck.randrange(1, 256)


def flipped_in_headers(data: bytearray, luck: random.Random) -> None:
    data[luck.randrange(HEADERS)] ^= 1 << luck.randrange(8)


def overwritten(data: bytearray, luck: random.Random) -> None:
    size = luck.choice([1, 8, 512, 4096])
    start = luck.randrange(len(data) - size)
    data[start : start + size] = luck.choice([bytes(size), b"\xff" * size, luck.randbytes(size)])


def cut(data: bytearray, luck: random.Random) -> None:
    del data[luck.randrange(len(data)) :]


def swapped(data: bytearray, luck: random.Random) -> None:
    size = luck.choice([16, 512, 4096])
    one, other = (luck.randrange(len(data) // size) * size for _ in range(2))
    data[one : one + size], data[other : other + size] = (
        data[other : other + size],
        data[one : one + size],
    )


@pytest.mark.parametrize("seeds", first_of([range(250), range(250, FILES)]))
def test_damaged_files(small_run, tmp_path, seeds):
    good = small_run.read_bytes()
    expected = everything(small_run)
    kinds = [flipped, flipped_in_headers, overwritten, cut, swapped]
    path = tmp_path / small_run.name
    outcomes: Counter[str] = Counter()
    for seed in seeds:
        luck = random.Random(seed)
        data = bytearray(good)
        kinds[seed % len(kinds)](data, luck)
        path.write_bytes(data)
        found = unless_refused(path)
        assert found in (None, expected), seed
        outcomes["refused" if found is None else "the same"] += 1
    assert sum(outcomes.values()) == len(seeds)
    # Both must happen, or the test would not distinguish the two.
    assert outcomes["refused"] > len(seeds) / 2
    assert outcomes["the same"] > 5


@pytest.mark.parametrize("start", ["/entry/results", "/entry/tables", "/entry/recordings"])
def test_every_byte_of_some_structure(small_run, tmp_path, start):
    """Flip each byte around the name of a group: nothing there goes unnoticed or wrong."""
    good = small_run.read_bytes()
    expected = everything(small_run)
    place = good.index(start.rpartition("/")[2].encode())
    path = tmp_path / small_run.name
    for offset in range(max(0, place - 30), place + 30):
        data = bytearray(good)
        data[offset] ^= 0x11
        path.write_bytes(data)
        assert unless_refused(path) in (None, expected), offset
