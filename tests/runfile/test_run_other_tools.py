"""The same file, unchanged, in programs that other people wrote."""

import shutil
import subprocess
import warnings

import h5py
import numpy as np
import pytest
import xarray

from tests.runfile.whole_run import RESULTS, SIZE, SPECS, TABLES, samples


@pytest.mark.parametrize("name", [spec.name for spec in SPECS])
def test_xarray_gives_named_channels_on_a_shared_time(run_path, name):
    group = f"/entry/recordings/{name}"
    with xarray.open_dataset(run_path, engine="h5netcdf", group=group) as dataset:
        assert dict(dataset.sizes) == {"time": SIZE}
        assert "time" in dataset.coords
        spec = next(spec for spec in SPECS if spec.name == name)
        for channel in spec.channels:
            assert dataset[channel.name].attrs["units"] == channel.unit
            assert dataset[channel.name].attrs["long_name"] == channel.description
            np.testing.assert_array_equal(dataset[channel.name], samples()[name][channel.name])


def test_xarray_gives_tables_with_their_axes(run_path):
    group = "/entry/tables/friction_model"
    with xarray.open_dataset(run_path, engine="h5netcdf", group=group) as dataset:
        assert dict(dataset.sizes) == {"speed": 2, "position": 50}
        assert dataset["torque"].dims == ("speed", "position")
        assert dataset["count"].dims == ("speed",)
        near = dataset["torque"].sel(speed=2.0, position=6.0, method="nearest")
        assert float(near) == TABLES["friction_model"]["torque"][1, -1]


def test_xarray_opens_the_whole_tree(run_path):
    with xarray.open_datatree(run_path, engine="h5netcdf") as data:
        assert float(data["entry/results"]["torque_constant"]) == RESULTS["torque_constant"].value
        assert data["entry/results"]["torque_constant"].attrs["standard_uncertainty"] == 4e-5
        assert data["entry/recordings/sweep"]["current"].sizes == {"time": SIZE}
        assert data["entry"]["command"].values.astype(str) == "stribeck"


def test_silx_finds_the_default_plot(run_path):
    from silx.io.nxdata import get_default

    with h5py.File(run_path, "r") as file:
        plot = get_default(file)
        assert plot is not None
        assert plot.group.name == "/entry/tables/friction_model"
        assert plot.signal_dataset_name == "torque"
        assert plot.axes_dataset_names == ["speed", "position"]
        np.testing.assert_array_equal(plot.signal[()], TABLES["friction_model"]["torque"])


@pytest.mark.parametrize("name", ["recordings/sweep", "recordings/holds", "tables/breakaway"])
def test_silx_accepts_every_group_of_signals(run_path, name):
    from silx.io.nxdata import NXdata

    with h5py.File(run_path, "r") as file:
        plot = NXdata(file["entry"][name], validate=True)
        assert plot.is_valid
        assert plot.issues == []


def test_nexusformat_finds_the_default_plot(run_path):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # its own imports warn
        from nexusformat.nexus import nxload

        plot = nxload(str(run_path)).plottable_data
        assert plot.nxpath == "/entry/tables/friction_model"
        assert plot.nxsignal.nxname == "torque"
        assert [axis.nxname for axis in plot.nxaxes] == ["speed", "position"]
        assert plot.nxsignal.attrs["units"] == "N m"


@pytest.mark.skipif(shutil.which("h5dump") is None, reason="hdf5-tools are not installed")
def test_h5dump_reads_every_dataset(run_path):
    found = subprocess.run(["h5dump", str(run_path)], capture_output=True, text=True, check=True)
    assert found.stderr == ""
    with h5py.File(run_path, "r") as file:
        names: list[str] = []
        file.visititems(lambda name, node: names.append(name.rpartition("/")[2]))
    assert len(names) > 45
    for name in names:
        assert f'"{name}"' in found.stdout


@pytest.mark.skipif(shutil.which("h5dump") is None, reason="hdf5-tools are not installed")
def test_h5dump_prints_the_samples(run_path):
    found = subprocess.run(
        ["h5dump", "-d", "/entry/recordings/sweep/encoder", "-y", "-w", "1", str(run_path)],
        capture_output=True,
        text=True,
        check=True,
    )
    lines = (line.strip().strip(",") for line in found.stdout.splitlines())
    numbers = [int(line) for line in lines if line.lstrip("-").isdigit()]
    assert numbers == samples()["sweep"]["encoder"].tolist()


def test_pandas_makes_a_frame_of_a_recording(run_path):
    with xarray.open_dataset(
        run_path, engine="h5netcdf", group="/entry/recordings/holds"
    ) as dataset:
        frame = dataset.to_dataframe()
    np.testing.assert_array_equal(frame["torque"], samples()["holds"]["torque"])


def test_types_filters_and_bounds_are_the_agreed_ones(run_path):
    with h5py.File(run_path, "r") as file:
        assert file.libver == ("earliest", "v200") or file.libver[0] in ("earliest", "v110")
        found = {}

        def look(name: str, node: h5py.Group | h5py.Dataset) -> None:
            if isinstance(node, h5py.Dataset) and h5py.check_string_dtype(node.dtype) is None:
                found[name] = node

        file.visititems(look)
        assert {node.dtype.str for node in found.values()} <= {"|u1", "<i4", "<f4", "<f8"}
        for name, node in found.items():
            assert "units" in node.attrs, name
            if node.shape == ():
                assert node.id.get_create_plist().get_layout() == h5py.h5d.COMPACT
            else:
                assert (node.compression, node.compression_opts) == ("gzip", 1), name
                assert node.shuffle, name
                assert node.fletcher32, name
        assert found["entry/recordings/sweep/time"].chunks == (8192,)


def test_superblock_is_that_of_hdf5_1_10(run_path):
    # Version 3 came with 1.10; a file for `latest` would say the same but hold newer messages,
    # which h5dump 1.10 above would refuse.
    assert run_path.read_bytes()[8] == 3
