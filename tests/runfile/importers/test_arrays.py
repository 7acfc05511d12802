"""Files of MATLAB and NumPy, as these programs and h5py write them."""

import os

import h5py
import numpy as np
import pytest
from scipy.io import savemat

from rigtool.errors import RunFileError
from rigtool.runfile import open_run
from rigtool.runfile.importers import import_files
from rigtool.runfile.importers.arrays import load_arrays
from tests.runfile.importers.mappings import TEXT, columns, mapping, take

NAMED = TEXT
for number, name in enumerate(("t", "q", "i"), start=1):
    NAMED = NAMED.replace(f"column = {number}", f'column = "{name}"')
IN_STRUCTURE = NAMED
for name in ("t", "q", "i"):
    IN_STRUCTURE = IN_STRUCTURE.replace(f'"{name}"', f'"run.{name}"')


def named():
    return dict(zip(("t", "q", "i"), columns(), strict=True))


def write_v73(path, variables):
    """Write as MATLAB does: HDF5 behind 512 bytes of text, matrices transposed."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in variables.items():
            file[name] = np.asarray(values).T
            file[name].attrs["MATLAB_class"] = np.bytes_("double")
    head = b"MATLAB 7.3 MAT-file, Platform: GLNXA64, Created on: x HDF5 schema 1.00 ."
    with path.open("r+b") as stream:
        stream.write(head.ljust(116) + b" " * 8 + b"\x00\x02IM")


def check(path):
    time, encoder, current = columns()
    with open_run(path) as run:
        recording = run.recording("imported")
        np.testing.assert_allclose(recording.read("time"), time / 1000, rtol=1e-15, atol=0)
        np.testing.assert_array_equal(recording.read("encoder"), encoder)
        expected = -(10 * current + 2) / 1000
        np.testing.assert_allclose(recording.read("current"), expected, rtol=1e-14, atol=0)


WRITERS = {
    "matrix.npy": (TEXT, lambda path: np.save(path, np.array(columns()))),
    "tall.npy": (TEXT, lambda path: np.save(path, np.array(columns()).T)),
    "one.npz": (TEXT, lambda path: np.savez_compressed(path, data=np.array(columns()))),
    "many.npz": (NAMED, lambda path: np.savez(path, **named())),
    "matrix.mat": (TEXT, lambda path: savemat(path, {"data": np.array(columns())})),
    "rows.mat": (NAMED, lambda path: savemat(path, named(), oned_as="row")),
    "packed.mat": (NAMED, lambda path: savemat(path, named(), do_compression=True)),
    "v4.mat": (NAMED, lambda path: savemat(path, named(), format="4")),
    "structure.mat": (IN_STRUCTURE, lambda path: savemat(path, {"run": named()})),
    "v73.mat": (TEXT, lambda path: write_v73(path, {"data": np.array(columns())})),
    "v73_many.mat": (NAMED, lambda path: write_v73(path, {k: [v] for k, v in named().items()})),
    "v73_structure.mat": (
        IN_STRUCTURE,
        lambda path: write_v73(path, {f"run/{k}": [v] for k, v in named().items()}),
    ),
}


@pytest.mark.parametrize("name", WRITERS)
def test_what_other_programs_write(tmp_path, name):
    text, write = WRITERS[name]
    write(tmp_path / name)
    take(tmp_path / name, tmp_path / "a.h5", text)
    check(tmp_path / "a.h5")


def test_a_structured_array(tmp_path):
    array = np.rec.fromarrays(columns(), names="t,q,i")
    np.save(tmp_path / "a.npy", np.asarray(array))
    take(tmp_path / "a.npy", tmp_path / "a.h5", NAMED)
    check(tmp_path / "a.h5")


def test_which_of_several_matrices(tmp_path):
    np.savez(tmp_path / "a.npz", other=np.zeros((3, 9)), data=np.array(columns()))
    with pytest.raises(RunFileError, match="holds other, data: name one as `variable`"):
        take(tmp_path / "a.npz", tmp_path / "a.h5")
    take(tmp_path / "a.npz", tmp_path / "a.h5", TEXT.replace("[file]", '[file]\nvariable = "data"'))
    check(tmp_path / "a.h5")


@pytest.mark.parametrize(("bad", "message"), [(np.nan, "is nan"), (np.inf, "is inf")])
def test_samples_without_a_value(tmp_path, bad, message):
    values = np.array(columns())
    values[1, 20] = bad
    np.save(tmp_path / "a.npy", values)
    with pytest.raises(RunFileError, match=f"sample 21: column 2 {message}"):
        take(tmp_path / "a.npy", tmp_path / "a.h5")
    take(tmp_path / "a.npy", tmp_path / "a.h5", skip_bad=True)
    with open_run(tmp_path / "a.h5") as run:
        assert run.result("lines_left_out").value == 1
        assert run.recording("imported").size == len(columns()[0]) - 1


class Pickled:
    pass


@pytest.mark.parametrize(
    ("contents", "message"),
    [
        ({"t": columns()[0], "q": columns()[1]}, "no column 'i', only t, q"),
        ({**named(), "i": columns()[2][:-1]}, "differ in length"),
        ({**named(), "i": np.array(columns())}, "must be one column"),
        ({**named(), "i": columns()[2] + 1j}, "not real numbers"),
        ({**named(), "i": np.array(["x"] * len(columns()[0]))}, "not real numbers"),
        ({**named(), "i": np.array([Pickled()])}, "is damaged, or no file"),
        ({name: values[:0] for name, values in named().items()}, "are empty"),
    ],
)
def test_what_is_no_signal(tmp_path, contents, message):
    np.savez(tmp_path / "a.npz", **contents)
    with pytest.raises(RunFileError, match=message):
        take(tmp_path / "a.npz", tmp_path / "a.h5", NAMED)


def test_the_array_of_a_file_of_numpy_has_columns_by_number(tmp_path):
    np.save(tmp_path / "a.npy", np.array(columns()))
    with pytest.raises(RunFileError, match="has no column 't', only an array without a name"):
        take(tmp_path / "a.npy", tmp_path / "a.h5", NAMED)


@pytest.mark.parametrize("name", ["matrix.npy", "many.npz", "packed.mat", "v73.mat"])
def test_damaged_files_are_refused_or_read_unchanged(tmp_path, name):
    text, write = WRITERS[name]
    write(tmp_path / name)
    whole = (tmp_path / name).read_bytes()
    for length in range(0, len(whole), max(1, len(whole) // 40)):
        (tmp_path / name).write_bytes(whole[:length])
        with pytest.raises(RunFileError):
            take(tmp_path / name, tmp_path / "a.h5", text)


def test_no_link_leads_out_of_a_file(tmp_path):
    write_v73(tmp_path / "secret.mat", {"data": np.array(columns())})
    with h5py.File(tmp_path / "a.mat", "w") as file:
        file["data"] = h5py.ExternalLink("secret.mat", "data")
    with pytest.raises(RunFileError, match="holds nothing"):
        take(tmp_path / "a.mat", tmp_path / "a.h5")


def test_a_claim_of_more_than_there_can_be_is_refused(tmp_path):
    with h5py.File(tmp_path / "a.mat", "w") as file:
        file.create_dataset("data", (3, 10**12), "f8", chunks=(3, 1000))
    with pytest.raises(RunFileError, match="larger than"):
        take(tmp_path / "a.mat", tmp_path / "a.h5")


MAP = """mapping = 1
[rig]
name = "bench"
[map]
signal = "current"
unit = "mA"
missing = 0
"""


def test_a_map_around_the_turn(tmp_path):
    values = np.zeros(64)
    values[::4] = np.arange(1, 17)
    np.save(tmp_path / "a.npy", values)
    import_files([str(tmp_path / "a.npy")], str(tmp_path / "a.h5"), mapping(MAP))
    with open_run(tmp_path / "a.h5") as run:
        table = run.table("map")
    np.testing.assert_allclose(table["position"], np.arange(16) * np.pi / 8, rtol=1e-15, atol=0)
    np.testing.assert_allclose(table["current"], np.arange(1, 17) * 1e-3, rtol=1e-15, atol=0)


def test_arrays_of_structures_and_columns_of_matrices(tmp_path):
    """What scopes of Simulink and recorders of test benches store: `a(2).b` and `a.b(:,2)`."""
    time, encoder, current = columns()
    traces = np.zeros((1, 2), dtype=[("Name", "O"), ("Data", "O")])
    for n, values in enumerate((time, encoder)):
        traces[0, n] = (f"trace {n}", values[None, :])
    more = np.column_stack([encoder, current])
    savemat(tmp_path / "a.mat", {"rec": {"Y": traces, "more": more}})
    names = {"t": "rec.Y(1).Data", "q": "rec.Y(2).Data", "i": "rec.more(:,2)"}
    text = NAMED
    for name, column in names.items():
        text = text.replace(f'"{name}"', f'"{column}"')
    take(tmp_path / "a.mat", tmp_path / "a.h5", text)
    check(tmp_path / "a.h5")
    for wrong in ("rec.more(:,3)", "rec.Y(3).Data"):
        with pytest.raises(RunFileError, match=r"has no column 'rec\."):
            take(tmp_path / "a.mat", tmp_path / "b.h5", text.replace(names["i"], wrong))


def test_objects_of_matlab_name_the_way_out(tmp_path):
    with h5py.File(tmp_path / "a.mat", "w") as file:
        file["TT"] = np.zeros((1, 6), np.uint32)
        file["TT"].attrs["MATLAB_class"] = np.bytes_("timetable")
        file["TT"].attrs["MATLAB_object_decode"] = 3
    with pytest.raises(RunFileError, match=r"TT is a timetable of MATLAB.*t = seconds\(TT\.Time\)"):
        take(tmp_path / "a.mat", tmp_path / "a.h5", NAMED.replace('"t"', '"TT.Time"'))


def test_a_file_that_is_cut_off_later_does_not_end_the_process(tmp_path):
    """Of a file that is mapped into memory, what is missing is a signal, not an error."""
    values = np.arange(100_000.0)
    np.save(tmp_path / "a.npy", values)
    (found,) = load_arrays(tmp_path / "a.npy").values()
    os.truncate(tmp_path / "a.npy", 128)
    assert np.array_equal(found, values)
