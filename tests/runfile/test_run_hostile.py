"""Files that are made to crash a reader: each is refused, by a process that lives on."""

import os
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

from rigtool.errors import RunFileError
from rigtool.runfile import open_run, provenance
from rigtool.runfile.objects import make_text
from rigtool.runfile.verification import verify
from tests.runfile.test_run_reader import change, copy, refused
from tests.runfile.whole_run import SPECS, write

__all__ = ["copy"]

KINDS = {
    "object reference": "h5py.h5t.STD_REF_OBJ",
    "region reference": "h5py.h5t.STD_REF_DSETREG",
    "variable-length float": "h5py.h5t.vlen_create(h5py.h5t.IEEE_F64LE)",
    "compound": "h5py.h5t.py_create(np.dtype([('a', 'f8'), ('b', 'S3')]))",
    "opaque": "h5py.h5t.create(h5py.h5t.OPAQUE, 16)",
    "array": "h5py.h5t.array_create(h5py.h5t.IEEE_F64LE, (2,))",
    "time": "h5py.h5t.UNIX_D32LE",
    "bit field": "h5py.h5t.STD_B64LE",
}
TRY = """
import h5py, numpy as np, shutil, sys
from rigtool.errors import RunFileError
from rigtool.runfile import open_run
for name, kind in {kinds}.items():
    print(name, flush=True)
    path = shutil.copy(sys.argv[1], sys.argv[1] + "." + name)
    with h5py.File(path, "r+", libver=("v110", "v110")) as file:
        entry, space = file["entry"].id, h5py.h5s.create_simple((3,))
        {make}
    try:
        open_run(path)
    except RunFileError as error:
        assert "neither number nor text" in str(error), error
    else:
        raise AssertionError("is read")
"""
PLACES = {
    "attribute": 'h5py.h5a.create(file["entry/recordings/sweep/current"].id, b"x", kind, space)',
    "dataset": 'h5py.h5d.create(entry, b"x", kind, space)',
}


@pytest.mark.parametrize("place", PLACES)
def test_types_that_crash_a_reader(copy, place):
    kinds = ", ".join(f"{name!r}: {kind}" for name, kind in KINDS.items())
    code = TRY.format(kinds=f"{{{kinds}}}", make=PLACES[place])
    done = subprocess.run([sys.executable, "-c", code, str(copy)], capture_output=True, text=True)
    assert done.returncode == 0, (done.stdout.splitlines()[-1:], done.stderr)
    assert done.stdout.splitlines() == list(KINDS)


@pytest.mark.parametrize(
    "damage",
    [
        lambda group: group.__delitem__("program"),
        lambda group: numbered(group, "date"),
        lambda group: numbered(group, "recipe_resolved"),
        lambda group: numbered(group, "content_sha256"),
        lambda group: numbered(group["inputs/0000"], "path"),
        lambda group: group["inputs/0000"].__delitem__("command"),
    ],
)
def test_provenance_of_wrong_types(copy, damage):
    change(copy, lambda file: damage(file["entry/provenance"]), reseal=False)
    refused(copy, "lacks the text")


def numbered(group: h5py.Group, name: str) -> None:
    del group[name]
    group.create_dataset(name, data=np.float64(5.0))


@pytest.mark.parametrize(
    ("place", "name", "value"),
    [
        ("results/arm_length", "units", 5.0),
        ("results/torque_constant", "standard_uncertainty", np.bytes_("5")),
        ("results/torque_constant", "degrees_of_freedom", [1.0, 2.0]),
        ("results/arm_length", "reason", 5.0),
        ("tables/breakaway", "signal", 5.0),
        ("tables/breakaway/positive", "units", 5.0),
        ("recordings/sweep/current", "units", 5.0),
        ("recordings/sweep/conditions/speed", "units", 5.0),
    ],
)
def test_attributes_of_wrong_types(copy, place, name, value):
    change(copy, lambda file: file["entry"][place].attrs.__setitem__(name, value))
    refused(copy, f"attribute '{name}' must be")


@pytest.mark.parametrize("place", ["results/arm_length", "recordings/sweep/conditions/speed"])
def test_a_number_that_is_an_array(copy, place):
    def widen(file: h5py.File) -> None:
        attributes = dict(file["entry"][place].attrs)
        del file["entry"][place]
        file["entry"].create_dataset(place, data=np.zeros(1)).attrs.update(attributes)

    change(copy, widen)
    refused(copy, "must be one number")


@pytest.mark.parametrize("source", ["/dev/zero", "FIFO", "x" * 300, "a\\0b"])
def test_a_source_that_is_no_file_is_not_read(copy, tmp_path, source):
    if source == "FIFO":
        source = str(tmp_path / "fifo")
        os.mkfifo(source)

    def point(file: h5py.File) -> None:
        del file["entry/provenance/source"]
        make_text(file["entry/provenance"], "source", source)
        del file["entry/provenance/inputs"]

    change(copy, point)
    (_, link) = verify(copy)
    assert "no file" in (link.problem or "") or link.remark == "is not there any more"


def test_a_chain_deeper_than_the_stack(tmp_path):
    """A file that names itself under other paths would be followed by recursion for ever."""
    path = write(tmp_path / "0.h5", size=10, recordings=SPECS[:0])
    for number in range(1, 40):
        path = write(tmp_path / f"{number}.h5", inputs=(path,), recordings=SPECS[:0])
    limit = sys.getrecursionlimit()
    sys.setrecursionlimit(150)
    try:
        links = verify(path)
    finally:
        sys.setrecursionlimit(limit)
    assert [link.problem for link in links] == [None] * 40


def test_hashing_reads_files_only(tmp_path):
    for path in (Path("/dev/zero"), tmp_path):
        with pytest.raises(Exception, match="no file"):
            provenance.file_sha256(path)
    with pytest.raises(RunFileError, match="no such file"):
        open_run("a\0b")


def test_a_table_without_a_column_is_refused(copy):
    with open_run(copy) as run:
        table = next(iter(run.tables.values()))
        with pytest.raises(RunFileError, match=r"no column 'nothing', only .*"):
            table["nothing"]
