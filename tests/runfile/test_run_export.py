"""Runs in other formats, read back by other programs."""

import os
import sys
from pathlib import Path

import netCDF4
import numpy as np
import pandas as pd
import pyarrow.parquet
import pytest
import xarray
from scipy.io import loadmat

from rigtool.errors import RunFileError, UsageError
from rigtool.runfile import Recording, RunWriter, open_run
from rigtool.runfile.export import export
from tests.runfile.whole_run import SIZE, SPECS, TABLES, samples, write

KT = Path(__file__).parents[1] / "fixtures" / "kt.h5"


def exported(run_path, path, part=None, overwrite=False):
    with open_run(run_path) as run:
        export(run, path, part, overwrite)
    return path


@pytest.mark.parametrize("part", ["sweep", "recordings/sweep"])
def test_a_recording_as_csv(run_path, tmp_path, part):
    frame = pd.read_csv(exported(run_path, tmp_path / "a.csv", part))
    assert list(frame) == ["time [s]", "current [A]", "encoder [count]", "limit_switch [1]"]
    assert len(frame) == SIZE
    for (name, values), column in zip(samples()["sweep"].items(), frame, strict=True):
        np.testing.assert_array_equal(frame[column].astype(values.dtype), values, name)


def test_a_table_as_csv_has_a_line_for_each_point(run_path, tmp_path):
    path = exported(run_path, tmp_path / "a.csv", "friction_model")
    frame = pd.read_csv(path, dtype=str).map(float)  # exact in all versions of pandas
    table = TABLES["friction_model"]
    assert len(frame) == 100
    wide = frame.pivot(index="speed [rad/s]", columns="position [rad]", values="torque [N m]")
    np.testing.assert_array_equal(wide.index, table["speed"])
    np.testing.assert_array_equal(wide.columns, table["position"])
    np.testing.assert_array_equal(wide, table["torque"])
    counts = frame.groupby("speed [rad/s]")["count [1]"].unique()
    assert [item.tolist() for item in counts] == [[3], [4]]


def test_results_as_csv(run_path, tmp_path):
    frame = pd.read_csv(exported(run_path, tmp_path / "a.csv", "results"), index_col="name")
    assert frame.loc["torque_constant", "value"] == 0.0458
    assert frame.loc["torque_constant", "u"] == 4e-5
    assert frame.loc["arm_length", "reason"] == "from the drawing"
    assert np.isnan(frame.loc["not_found", "value"])


def test_a_recording_as_parquet(run_path, tmp_path, monkeypatch):
    monkeypatch.setattr("rigtool.runfile.export.EXPORT_ROWS", 8192)
    path = exported(run_path, tmp_path / "a.parquet", "sweep")
    frame = pd.read_parquet(path)
    assert len(frame) == SIZE
    for (name, values), column in zip(samples()["sweep"].items(), frame, strict=True):
        assert column == name
        assert frame[name].dtype == values.dtype
        np.testing.assert_array_equal(frame[name], values)
    assert frame.attrs["units"] == {
        "time": "s",
        "current": "A",
        "encoder": "count",
        "limit_switch": "1",
    }
    with pyarrow.parquet.ParquetFile(path) as file:
        assert file.schema_arrow.field("current").metadata == {b"units": b"A"}
        assert file.metadata.num_row_groups == -(-SIZE // 8192) > 1


def test_a_table_and_results_as_parquet(run_path, tmp_path):
    frame = pd.read_parquet(exported(run_path, tmp_path / "a.parquet", "friction_model"))
    wide = frame.pivot(index="speed", columns="position", values="torque")
    np.testing.assert_array_equal(wide, TABLES["friction_model"]["torque"])
    assert frame.attrs["units"]["torque"] == "N m"
    frame = pd.read_parquet(exported(run_path, tmp_path / "b.parquet", "results"))
    frame = frame.set_index("name")
    assert frame.loc["torque_constant", ["value", "unit", "u"]].tolist() == [0.0458, "N m/A", 4e-5]
    assert frame.loc["arm_length", "reason"] == "from the drawing"
    assert np.isnan(frame.loc["not_found", "value"])


def test_parquet_without_its_package_says_what_to_install(run_path, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(UsageError, match=r"pip install rigtool\[parquet\]"):
        exported(run_path, tmp_path / "a.parquet", "sweep")
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("ending", ["csv", "parquet"])
def test_a_long_recording_is_exported_in_blocks(tmp_path, monkeypatch, ending):
    """No read is longer than a block, and blocks of any length join without a seam."""
    monkeypatch.setattr("rigtool.runfile.export.EXPORT_ROWS", 1000)
    path, longest = write(tmp_path / "run.h5", size=10_500), 0
    stored = Recording.read_stored

    def watched(self, name, start=0, stop=None):
        nonlocal longest
        longest = max(longest, self.size if stop is None else stop - start)
        return stored(self, name, start, stop)

    monkeypatch.setattr(Recording, "read_stored", watched)
    exported(path, tmp_path / f"a.{ending}", "sweep")
    assert longest == 1000
    read = {"csv": pd.read_csv, "parquet": pd.read_parquet}[ending]
    current = read(tmp_path / f"a.{ending}").iloc[:, 1].astype("f4")
    np.testing.assert_array_equal(current, samples(10_500)["sweep"]["current"])


def test_an_empty_recording_keeps_its_columns(tmp_path):
    path = tmp_path / "run.h5"
    with RunWriter(path, command="x", recordings=SPECS) as out:
        out.append("holds", samples(5)["holds"])
        out.finish({}, {})
    frame = pd.read_parquet(exported(path, tmp_path / "a.parquet", "sweep"))
    assert list(frame) == list(samples(5)["sweep"])
    assert len(frame) == 0
    assert len(pd.read_csv(exported(path, tmp_path / "a.csv", "sweep"))) == 0


def test_matlab(run_path, tmp_path):
    data = loadmat(exported(run_path, tmp_path / "a.mat"), simplify_cells=True)
    assert data["command"] == "stribeck"
    assert data["results"]["torque_constant"]["value"] == 0.0458
    assert data["results"]["torque_constant"]["unit"] == "N m/A"
    table = data["tables"]["friction_model"]
    np.testing.assert_array_equal(table["columns"]["torque"], TABLES["friction_model"]["torque"])
    assert list(table["axes"]) == ["speed", "position"]
    sweep = data["recordings"]["sweep"]
    assert sweep["conditions"] == {"speed": 3.0, "moves": 20.0}
    assert sweep["units"]["encoder"] == "count"
    for name, values in samples()["sweep"].items():
        np.testing.assert_array_equal(sweep["signals"][name], values)


def test_netcdf(run_path, tmp_path):
    path = exported(run_path, tmp_path / "a.nc")
    with xarray.open_dataset(path, engine="h5netcdf", group="entry/recordings/holds") as data:
        np.testing.assert_array_equal(data["torque"], samples()["holds"]["torque"])


@pytest.mark.parametrize("other", [b"something else", KT.read_bytes()])
def test_a_run_that_is_replaced_before_it_is_copied(run_path, tmp_path, other):
    with open_run(run_path) as run:
        (tmp_path / "new").write_bytes(other)
        moved = tmp_path / "moved.h5"
        os.rename(run_path, moved)
        os.replace(tmp_path / "new", run_path)
        try:
            with pytest.raises(RunFileError, match="was replaced or changed"):
                export(run, tmp_path / "a.nc", None, False)
        finally:
            os.replace(moved, run_path)  # it is of other tests too
    assert not (tmp_path / "a.nc").exists()


def test_netcdf_of_another_reader(run_path, tmp_path):
    """The netCDF library itself, by its own Python package."""
    with netCDF4.Dataset(exported(run_path, tmp_path / "a.nc")) as data:
        entry = data["entry"]
        for name, block in samples().items():
            group = entry["recordings"][name]
            assert list(group.dimensions) == ["time"]
            for channel, values in block.items():
                variable = group[channel]
                assert variable.dimensions == ("time",)
                np.testing.assert_array_equal(variable[:], values)
        assert entry["recordings/sweep/encoder"].units == "count"
        table = entry["tables/friction_model"]
        assert table["torque"].dimensions == ("speed", "position")
        assert table["torque"].units == "N m"
        np.testing.assert_array_equal(table["torque"][:], TABLES["friction_model"]["torque"])
        constant = entry["results/torque_constant"]
        assert (float(constant[...]), constant.units) == (0.0458, "N m/A")
        assert constant.standard_uncertainty == 4e-5


@pytest.mark.parametrize(
    ("name", "part", "message"),
    [
        ("a.parquet", None, "more than one thing"),
        ("a.xlsx", None, "'.xlsx'"),
        ("a", None, "use one of .csv, .parquet, .mat, .nc"),
        ("a.mat", "sweep", "--part is for .csv and .parquet"),
        ("a.csv", None, "more than one thing: choose by --part from results, recordings/sweep"),
        ("a.csv", "nothing", "has no single part 'nothing'"),
    ],
)
def test_what_is_not_clear_is_asked(run_path, tmp_path, name, part, message):
    with pytest.raises(UsageError, match=message):
        exported(run_path, tmp_path / name, part)
    assert os.listdir(tmp_path) == []


def test_a_table_and_a_recording_of_one_name_are_told_apart(tmp_path):
    path = tmp_path / "run.h5"
    with RunWriter(path, command="x") as out:
        out.finish({}, {"results": TABLES["breakaway"], "holds": TABLES["breakaway"]})
    exported(path, tmp_path / "a.csv", "tables/holds")
    assert (tmp_path / "a.csv").read_text().splitlines()[0] == "position [rad],positive [N m]"


def test_an_existing_file_is_refused_and_kept(run_path, tmp_path):
    (tmp_path / "a.csv").write_text("mine")
    with pytest.raises(UsageError, match="--overwrite"):
        exported(run_path, tmp_path / "a.csv", "sweep")
    assert (tmp_path / "a.csv").read_text() == "mine"
    exported(run_path, tmp_path / "a.csv", "results", overwrite=True)
    assert (tmp_path / "a.csv").read_text().startswith("name,")


def test_a_folder_that_is_not_there(run_path, tmp_path):
    with pytest.raises(UsageError, match="does not exist: create it first"):
        exported(run_path, tmp_path / "no" / "a.csv", "sweep")
