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
from rigtool.runfile.importers.arrays import load_arrays
from rigtool.runfile.importers.raw import FREE_BYTES, read_bytes

SIZE = 4 * FREE_BYTES


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


@pytest.mark.parametrize("make", [gz, npz, mat_5, mat_5_of_many, mat_73])
def test_bombs(tmp_path, make):
    path = tmp_path / "bomb"
    make(path)
    assert path.stat().st_size < FREE_BYTES / 100
    with pytest.raises(RunFileError, match=f"larger than {FREE_BYTES} bytes unpacked"):
        read_bytes(path) if make is gz else load_arrays(path)
