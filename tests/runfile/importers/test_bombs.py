"""Small files that unpack to gigabytes: each is refused before they take the memory."""

import gzip
import zipfile
import zlib
from pathlib import Path

import h5py
import numpy as np
import pytest
from scipy.io import savemat

from rigtool.errors import RunFileError
from rigtool.recipe.mapping import parse_mapping
from rigtool.runfile.importers import arrays, raw, text
from rigtool.runfile.importers.arrays import load_arrays
from rigtool.runfile.importers.raw import FREE_BYTES, MAX_LINE, read_bytes

SIZE = 4 * FREE_BYTES
MAPPING = """mapping = 1
[rig]
name = "bench"
encoder_counts = 4096
[signals]
time = { column = 1, unit = "s" }
position = { column = 2, unit = "rad" }
"""


def gz(path: Path) -> None:
    path.write_bytes(gzip.compress(bytes(SIZE)))


def npz(path: Path) -> None:
    with (
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("a.npy", "w") as f,
    ):
        np.lib.format.write_array(f, np.zeros(SIZE, "u1"))


def mat_5(path: Path) -> None:
    savemat(path, {"a": np.zeros(SIZE, "u1")}, do_compression=True)


def mat_5_of_many(path: Path) -> None:
    savemat(path, {"a": 1.0}, do_compression=True)
    element = zlib.compress(bytes(SIZE // 16))
    tag = (15).to_bytes(4, "little") + len(element).to_bytes(4, "little")
    path.write_bytes(path.read_bytes() + 16 * (tag + element))


def mat_73(path: Path) -> None:
    with h5py.File(path, "w") as file:
        for name in "abcd":
            file.create_dataset(name, (SIZE // 32,), "f8", chunks=(1024,))


def mat_73_of_one_chunk(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file.create_dataset("a", (1,), "f8", maxshape=(None,), chunks=(SIZE,), compression=1)


@pytest.mark.parametrize("make", [gz, npz, mat_5, mat_5_of_many, mat_73, mat_73_of_one_chunk])
def test_bombs(tmp_path, make):
    path = tmp_path / "bomb"
    make(path)
    assert path.stat().st_size < FREE_BYTES / 100
    with pytest.raises(RunFileError, match=f"larger than {FREE_BYTES} bytes unpacked"):
        read_bytes(path) if make is gz else load_arrays(path)


@pytest.mark.parametrize(
    ("limit", "content", "message"),
    [
        ("MAX_TEXT", "1,22\n", "has 5 bytes, above 4 of a text: save the numbers"),
        ("MAX_LINES", "1\r\n" * 5, "has 5 lines, above 4"),
        ("MAX_LINES", "1\r" * 5, "has 5 lines, above 4"),
    ],
)
def test_texts(tmp_path, monkeypatch, limit, content, message):
    monkeypatch.setattr(raw, limit, 4)
    path = tmp_path / "long.csv"
    for data in (content.encode(), gzip.compress(content.encode())):
        path.write_bytes(data)
        with pytest.raises(RunFileError, match=message):
            read_bytes(path)


def test_a_line_of_any_length_is_not_divided(tmp_path):
    path = tmp_path / "line.csv"
    path.write_text("1,2\n" + "1," * MAX_LINE + "1\n")
    with pytest.raises(RunFileError, match=f"a line has {2 * MAX_LINE + 1} characters, above"):
        text.read_text(path, parse_mapping(MAPPING), skip_bad=False)


def of_members(path: Path, count: int) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        for number in range(count):
            archive.writestr(str(number), b"")


def of_arrays(path: Path, count: int) -> None:
    savemat(path, {f"a{number}": 1.0 for number in range(count)})


def of_groups(path: Path, count: int) -> None:
    with h5py.File(path, "w") as file:
        for number in range(count):
            file.create_group(str(number))


@pytest.mark.parametrize("make", [of_members, of_arrays, of_groups])
def test_many_objects(tmp_path, monkeypatch, make):
    monkeypatch.setattr(raw, "MAX_OBJECTS", 20)
    path = tmp_path / "many"
    make(path, 30)
    with pytest.raises(RunFileError, match="more than 20 arrays, groups or members"):
        load_arrays(path)


@pytest.mark.parametrize("packed", [True, False])
def test_cells_are_bounded_and_numbers_beside_them_are_not(tmp_path, monkeypatch, packed):
    monkeypatch.setattr(arrays, "MAX_NESTED", 50_000)
    path = tmp_path / "cells.mat"
    cells = np.empty((1, 1000), object)
    cells[:] = 1.0
    savemat(path, {"a": np.zeros(10_000)}, do_compression=packed)
    assert len(load_arrays(path)["a"]) == 10_000
    savemat(path, {"a": cells}, do_compression=packed)
    with pytest.raises(RunFileError, match=r"cells or structures of \d+ bytes, above 50000"):
        load_arrays(path)


def test_numbers_of_a_text(tmp_path, monkeypatch):
    monkeypatch.setattr(text, "MAX_NUMBERS", 9)
    path = tmp_path / "a.csv"
    path.write_text("1,2\n2,3\n3,4\n4,5\n5,6\n")
    with pytest.raises(RunFileError, match="has 10 numbers, above 9 of a text: save"):
        text.read_text(path, parse_mapping(MAPPING), skip_bad=False)
