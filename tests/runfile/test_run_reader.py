"""Files that are damaged, foreign, or of another kind: each is refused, with the reason."""

import math
import shutil
import zlib
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from rigtool.errors import RunFileError
from rigtool.experiments.learning.stored_table import stored_table_from
from rigtool.runfile import Channel, RecordingSpec, RunWriter, open_run, provenance
from rigtool.runfile.objects import make_group, make_text, set_attribute
from tests.runfile.whole_run import SPECS, samples, write


@pytest.fixture
def copy(run_path: Path, tmp_path: Path) -> Path:
    return Path(shutil.copy(run_path, tmp_path / "copy.h5"))


def change(path: Path, how: Callable[[h5py.File], None], *, reseal: bool = True) -> None:
    """Change a file; seal it again, so that only the check in question can refuse it."""
    with h5py.File(path, "r+", libver=("v110", "v110")) as file:
        how(file)
        if reseal:
            origin = file["entry/provenance"]
            for name in ("content_sha256", "record_sha256"):
                del origin[name]
            provenance.seal(file)


def refused(path: Path, message: str) -> None:
    with pytest.raises(RunFileError, match=message) as caught:
        open_run(path)
    assert str(path) in str(caught.value)
    assert caught.value.exit_code == 3


def test_no_file(tmp_path):
    refused(tmp_path / "no.h5", "no such file")


def test_a_folder(tmp_path):
    refused(tmp_path, "is a folder")


def test_an_empty_file(tmp_path):
    (tmp_path / "a.h5").touch()
    refused(tmp_path / "a.h5", "is empty")


def test_not_hdf5(tmp_path):
    (tmp_path / "a.h5").write_text("time,current\n0,1\n")
    refused(tmp_path / "a.h5", "not an HDF5 file")


@pytest.mark.parametrize("part", [0.01, 0.3, 0.7, 0.999])
def test_truncated(copy, part):
    data = copy.read_bytes()
    copy.write_bytes(data[: int(len(data) * part)])
    refused(copy, "truncated|cannot be read as HDF5")


def test_hdf5_of_somebody_else(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["x"] = [1, 2]
    refused(tmp_path / "a.h5", "rigtool import")


def test_a_newer_major_version(copy):
    change(copy, lambda file: set_attribute(file, "schema_version", "2.0"), reseal=False)
    refused(copy, "version 2.0.*newer rigtool")


def test_a_newer_minor_version_is_read(copy):
    def extend(file: h5py.File) -> None:
        set_attribute(file, "schema_version", "1.7")
        make_text(file["entry"], "comment", "something that only 1.7 knows")
        make_group(file["entry"], "weather", "NXcollection")

    change(copy, extend)
    with open_run(copy) as run:
        assert run.command == "stribeck"


def test_a_version_that_is_none(copy):
    change(copy, lambda file: set_attribute(file, "schema_version", "soon"), reseal=False)
    refused(copy, "'soon' is no version")


@pytest.mark.parametrize(
    "edit",
    [
        lambda file: file["entry/results/torque_constant"].__setitem__((), 0.045),
        lambda file: file["entry/results/torque_constant"].attrs.__setitem__(
            "units", np.bytes_("N m")
        ),
        lambda file: file["entry/tables/breakaway/positive"].__setitem__(0, 0.0),
        lambda file: set_attribute(file["entry/recordings/sweep/current"], "units", "mA"),
        lambda file: file["entry/recordings/sweep/conditions/speed"].__setitem__((), 4.0),
        lambda file: file["entry/provenance/seed"].__setitem__((), "2"),
        lambda file: file["entry/provenance/inputs/0000/sha256"].__setitem__((), "0" * 64),
        lambda file: file["entry"].__delitem__("notes"),
        lambda file: file["entry/results"].move("torque_constant", "torque_constant_mean"),
    ],
)
def test_an_edited_file(copy, edit):
    change(copy, edit, reseal=False)
    refused(copy, "own hash")


def test_an_unfinished_run(tmp_path):
    path = tmp_path / "run.h5"

    def interrupted() -> None:
        arguments = {"command": "stribeck", "recipe": None, "recipe_text": None}
        with RunWriter(path, recordings=SPECS, **arguments) as out:
            out.append("sweep", samples(10)["sweep"])
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    refused(Path(f"{path}.part"), "never finished.*recover")


def test_a_run_that_is_being_written(tmp_path):
    path = tmp_path / "run.h5"
    with RunWriter(path, command="x", recordings=SPECS[1:]) as out:
        out.append("holds", samples(10)["holds"])
        refused(Path(f"{path}.part"), "never finished|not closed")
        out.finish({}, {})


@pytest.mark.parametrize(
    ("how", "message"),
    [
        (lambda f: f["entry"].__delitem__("command"), "lacks the text 'command'"),
        (lambda f: f["entry/recordings/holds"].__delitem__("time"), "'time'"),
        (lambda f: f["entry/results/arm_length"].attrs.__delitem__("units"), "'units'"),
        (lambda f: f["entry/results/arm_length"].attrs.__delitem__("reason"), "uncertainty"),
        (lambda f: f["entry/tables/breakaway"].attrs.__delitem__("axes"), "'axes'"),
        (lambda f: set_attribute(f["entry/tables/breakaway"], "signal", "x"), "column 'x'"),
        (lambda f: f["entry/recordings/holds/torque"].resize((7,)), "common length"),
    ],
)
def test_a_structure_that_is_incomplete(copy, how, message):
    change(copy, how)
    refused(copy, message)


def zeros(size: int) -> np.ndarray:
    return np.zeros(size, "u1")


def hard_link_graph(parent: h5py.Group) -> None:
    """Link each of few groups from the one above a hundred times: 10^10 paths within the depth."""
    for number in range(5):
        below = parent.create_group(f"g{number}")
        for link in range(100):
            parent[f"l{link}"] = below
        parent = below


def much_of_nothing(entry: h5py.Group) -> None:
    """Add 1.1 GB of zeros, a stored chunk of 16 MiB each 16 kB, to the first recording."""
    recording = next(iter(entry["recordings"].values()))
    chunks, values = 66, 2**21
    added = recording.create_dataset(
        "nothing", (chunks * values,), "f8", chunks=(values,), compression=9
    )
    stored = zlib.compress(bytes(8 * values), 9)
    for chunk in range(chunks):
        added.id.write_direct_chunk((chunk * values,), stored)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda g: g.__setitem__("x", h5py.ExternalLink("other.h5", "/x")), "leads elsewhere"),
        (lambda g: g.__setitem__("x", h5py.SoftLink("/entry")), "leads elsewhere"),
        (lambda g: g.__setitem__("x", g["/entry"]), "linked from more than one place"),
        (lambda g: g.create_dataset("x", (10**12,), "f8", chunks=(8192,)), "claims shape"),
        (lambda g: g.create_dataset("x", (10**9,), "f8", chunks=(8192,)), "file can hold"),
        (lambda g: g.create_dataset("x", (2**25,), "u1", chunks=(2**20,)), "file can hold"),
        (lambda g: g.create_dataset("x", (5,), "f8", chunks=(10**7,), maxshape=(None,)), "chunks"),
        (lambda g: g.create_dataset("x", (5,), "f2"), "float16"),
        (lambda g: g.create_dataset("x", (5,), "?"), "neither number"),
        (lambda g: g.create_dataset("x", (5,), "c16"), "neither number"),
        (lambda g: g.create_dataset("x", (5,), h5py.ref_dtype), "neither number"),
        (lambda g: g.create_dataset("x", (5,), "f8", compression="lzf"), "filter"),
        (
            lambda g: g.create_dataset("x", (5,), "f8", external=[("other.bin", 0, 40)]),
            "in another file",
        ),
        (lambda g: g.__setitem__("x", np.dtype("f8")), "neither group nor dataset"),
        (lambda g: g.attrs.create("x", np.zeros((200, 200), "u1")), "attribute"),
        (lambda g: g.create_dataset("x", data=zeros(2**25), compression=9), "beyond the values"),
        (lambda g: g.create_group("a b"), "member 'a b'"),
        (lambda g: g.create_dataset("x", shape=(), dtype="S2000000000"), "this file"),
        (lambda g: g.create_group("1/2/3/4/5/6"), "nested too deeply"),
        (much_of_nothing, "beyond the bytes of samples"),
        (hard_link_graph, "linked from more than one place"),
        (lambda g: [g.create_group(f"g{i}") for i in range(10_001)], "members"),
        (lambda g: g.create_dataset("x", data=h5py.Empty("f8")), "shape None"),
        (lambda g: g.create_dataset("x", data=np.array([b"a", b"b"])), "array of texts"),
        (lambda g: g.create_dataset("x", data="a"), "text of variable length"),
        (lambda g: g.attrs.__setitem__("x", "a"), "text of variable length"),
    ],
)
def test_what_no_run_file_holds(copy, make, message):
    change(copy, lambda file: make(file["entry"]), reseal=False)
    refused(copy, message)


def test_a_virtual_dataset(copy):
    def add(file: h5py.File) -> None:
        layout = h5py.VirtualLayout((10,), "f8")
        layout[:] = h5py.VirtualSource("other.h5", "x", (10,))
        file["entry"].create_virtual_dataset("x", layout)

    change(copy, add, reseal=False)
    refused(copy, "in another file")


def test_a_run_of_another_command(run_path):
    with open_run(run_path) as run:
        run.require_command("calibrate-kt", "stribeck")
        with pytest.raises(RunFileError, match=r"was written by stribeck; a run of .*calibrate-kt"):
            run.require_command("calibrate-kt")


@pytest.mark.parametrize("value", [np.nan, np.inf, -1e300])
def test_a_condition_that_is_no_number_is_refused(copy, value):
    def other_speed(file):
        file["entry/recordings/sweep/conditions/speed"][()] = value

    change(copy, other_speed)
    with open_run(copy) as run, pytest.raises(RunFileError, match="condition 'speed' of recording"):
        run.recording("sweep").condition("speed")


def test_a_signal_in_another_unit_than_its_name_has_is_refused(copy):
    def other_units(file):
        for place in ("sweep/current", "sweep/conditions/speed"):
            file[f"entry/recordings/{place}"].attrs["units"] = np.bytes_("mA")

    change(copy, other_units)
    with open_run(copy) as run:
        sweep = run.recording("sweep")
        for finite in (True, False):
            with pytest.raises(RunFileError, match=r"'current' of .* in 'mA'; A is needed"):
                next(sweep.blocks("current", finite=finite))
        with pytest.raises(RunFileError, match=r"'speed' of .* in 'mA'; rad/s or m/s is needed"):
            sweep.condition("speed")


def test_what_is_missing_is_named(run_path):
    with open_run(run_path) as run:
        with pytest.raises(RunFileError, match="no recording 'staircase', only sweep, holds"):
            run.recording("staircase")
        with pytest.raises(RunFileError, match="no channel 'force', only time, current"):
            run.recording("sweep").read("force")
        with pytest.raises(RunFileError, match="'radial_force', only speed, moves"):
            run.recording("sweep").condition("radial_force")
        with pytest.raises(RunFileError, match="no table 'x', only friction_model, breakaway"):
            run.table("x")
        with pytest.raises(RunFileError, match="no result 'x', only torque_constant"):
            run.result("x")


def test_recordings_by_prefix_leave_out_empty_ones(tmp_path):
    channels = SPECS[1].channels
    specs = [RecordingSpec(f"load_{number:03d}", channels) for number in range(4)]
    path = tmp_path / "run.h5"
    with RunWriter(path, command="x", recordings=specs) as out:
        for number in (2, 0):
            out.append(f"load_{number:03d}", samples(10)["holds"])
        out.finish({}, {})
    with open_run(path) as run:
        assert [item.name for item in run.recordings_named("load_")] == ["load_000", "load_002"]
        assert run.recordings["load_001"].size == 0
        assert run.recordings["load_001"].duration() == 0.0
        assert math.isclose(run.recording("load_000").duration(), 9e-3, rel_tol=1e-12)
        with pytest.raises(RunFileError, match="no recording 'load_001', only load_000, load_002"):
            run.recording("load_001")
        assert [item.name for item in run.recordings_of("load")] == ["load_000", "load_002"]
        with pytest.raises(RunFileError, match="no recording 'learn_000', only load_000, load_002"):
            run.recordings_of("learn")


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_signal_with_a_hole(tmp_path, bad):
    path = tmp_path / "run.h5"
    block = {"time": np.arange(100.0), "torque": np.zeros(100)}
    block["torque"][40] = bad
    with RunWriter(path, command="x", recordings=SPECS[1:]) as out:
        out.append("holds", block)
        out.finish({}, {})
    with open_run(path) as run:
        recording = run.recording("holds")
        with pytest.raises(RunFileError, match=r"'torque' of recording 'holds'.*at sample 40"):
            recording.read("torque")
        with pytest.raises(RunFileError, match="at sample 40"):
            recording.read("torque", 30, 50)
        assert recording.read("torque", 41).size == 59


def test_large_numbers_are_no_hole(tmp_path):
    path = tmp_path / "run.h5"
    block = {"time": np.arange(2.0), "torque": np.full(2, 9e29)}
    with RunWriter(path, command="x", recordings=SPECS[1:]) as out:
        out.append("holds", block)
        out.finish({}, {})
    with open_run(path) as run:
        assert run.recording("holds").read("torque").tolist() == [9e29] * 2


@pytest.mark.parametrize(("unit", "most"), [("degC", 250.0), ("N m", 1e30)])
@pytest.mark.parametrize("sign", [-1, 1])
def test_no_signal_is_larger_than_its_unit_allows(tmp_path, unit, most, sign):
    path, values = tmp_path / "run.h5", np.full(5000, sign * most)
    values[3] = math.nextafter(sign * most, sign * math.inf)
    channels = (Channel("time", "s", "f8", "time"), Channel("signal", unit, "f8", "signal"))
    spec = RecordingSpec("holds", channels)
    with RunWriter(path, command="x", recordings=[spec]) as out:
        out.append("holds", {"time": np.arange(5000.0), "signal": values})
        out.finish({}, {})
    with open_run(path) as run:
        recording = run.recording("holds")
        assert np.all(recording.read("signal", 4) == sign * most)
        with pytest.raises(RunFileError, match=r"1 value that is NaN.*the first at sample 3;"):
            recording.read("signal", 2)
        (read,) = np.concatenate([*recording.blocks("signal", finite=False)])
    assert np.flatnonzero(np.isnan(read)).tolist() == [3]


def test_a_time_that_is_not_in_seconds(tmp_path):
    path = tmp_path / "run.h5"
    with RunWriter(path, command="x", recordings=SPECS[1:]) as out:
        out.append("holds", {"time": np.arange(9.0) * 0.9e-9, "torque": np.zeros(9)})
        out.finish({}, {})
    with open_run(path) as run, pytest.raises(RunFileError, match="its time is not in s"):
        run.recording("holds").rate()


def test_a_damaged_chunk_is_named(tmp_path):
    path = write(tmp_path / "run.h5")
    with h5py.File(path, "r") as file:
        chunk = file["entry/recordings/sweep/current"].id.get_chunk_info(1)
    data = bytearray(path.read_bytes())
    data[chunk.byte_offset + chunk.size // 2] ^= 0xFF
    path.write_bytes(data)
    with open_run(path) as run:
        recording = run.recording("sweep")
        assert recording.read("current", 0, 8192).size == 8192
        with pytest.raises(RunFileError, match=r"channel 'current' of recording 'sweep'.*damaged"):
            recording.read("current")


def test_a_recipe_of_another_version_names_the_file(copy):
    change(copy, lambda file: file["entry/provenance/recipe_resolved"].__setitem__((), "{}"))
    with open_run(copy) as run, pytest.raises(RunFileError, match=f"{copy}.*recipe"):
        _ = run.recipe


FIXTURES = Path(__file__).parents[1] / "fixtures"
EDITS = {
    "another unit": lambda t: t["position"].attrs.__setitem__("units", np.bytes_("count")),
    "no unit": lambda t: t["position"].attrs.__setitem__("units", np.bytes_("")),
    "no numbers": lambda t: t["torque"].__setitem__(..., np.nan),
    "one that is none": lambda t: t["torque"].__setitem__((1, 2), np.inf),
    "beyond any rig": lambda t: t["torque"].__setitem__((0, 0), 1e300),
    "fewer axes": lambda t: replace_column(t, "torque", t["torque"][:, 0]),
    "no column": lambda t: t.__delitem__("torque"),
    "other axes": lambda t: t.attrs.__setitem__("axes", np.array([b"position", b"speed"])),
    "text": lambda t: replace_column(t, "torque", np.bytes_("text")),
}


def replace_column(table: h5py.Group, name: str, values: object) -> None:
    attributes = dict(table[name].attrs)
    del table[name]
    table[name] = values
    table[name].attrs.update(attributes)


@pytest.mark.parametrize("edit", EDITS)
def test_a_table_that_a_command_computes_with(tmp_path, edit):
    path = Path(shutil.copy(FIXTURES / "turning.h5", tmp_path / "t.h5"))
    change(path, lambda file: EDITS[edit](file["entry/tables/lookup"]))
    with pytest.raises(RunFileError, match=r"anew|again|damaged") as caught, open_run(path) as run:
        run.table("lookup", "speed", "position", speed="rad/s", position="rad", torque="N m")
    assert str(path) in str(caught.value)
    with pytest.raises(RunFileError), open_run(path) as run:
        stored_table_from(run)


@pytest.mark.parametrize("kind", ["f4", "i4", "u1"])
def test_numbers_of_any_stored_type_are_numbers(tmp_path, kind):
    path, ones = Path(shutil.copy(FIXTURES / "turning.h5", tmp_path / "t.h5")), np.ones((4, 2000))
    change(path, lambda f: replace_column(f["entry/tables/lookup"], "u", ones.astype(kind)))
    with open_run(path) as run:
        assert run.table("lookup", "speed", "position", u="N m")["u"].sum() == 8000


@pytest.mark.parametrize(
    "edit",
    [
        lambda r: r.attrs.__setitem__("units", np.bytes_("mN m/A")),
        lambda r: r.__setitem__((), np.nan),
        lambda r: r.__setitem__((), -np.inf),
        lambda r: r.__setitem__((), 1e300),
        lambda r: r.attrs.__setitem__("standard_uncertainty", np.inf),
        lambda r: r.attrs.__setitem__("standard_uncertainty", 1e300),
    ],
)
def test_a_result_that_a_command_computes_with(tmp_path, edit):
    path = Path(shutil.copy(FIXTURES / "kt.h5", tmp_path / "kt.h5"))
    change(path, lambda file: edit(file["entry/results/torque_constant_mean"]))
    with open_run(path) as run:
        run.result("torque_constant_mean")  # shown as it is
        with pytest.raises(RunFileError, match=r"torque_constant_mean is .* anew"):
            run.result("torque_constant_mean", "N m/A")
