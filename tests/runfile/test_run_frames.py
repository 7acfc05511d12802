"""Recordings and tables in pandas and xarray, and a run as a page of a notebook."""

import builtins
import html

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from rigtool.errors import UsageError
from rigtool.runfile import RunWriter, open_run
from rigtool.runfile.summary import html_of
from tests.runfile.whole_run import SPECS, TABLES, samples


@pytest.fixture(scope="module")
def run(run_path):
    with open_run(run_path) as run:
        yield run


@pytest.mark.parametrize("spec", SPECS, ids=lambda spec: spec.name)
def test_a_recording_in_pandas_holds_samples_and_units_as_stored(run, spec):
    frame = run.recordings[spec.name].to_pandas()
    assert list(frame) == [channel.name for channel in spec.channels]
    assert frame.attrs["units"] == {channel.name: channel.unit for channel in spec.channels}
    for channel in spec.channels:
        np.testing.assert_array_equal(frame[channel.name], samples()[spec.name][channel.name])
        assert frame[channel.name].dtype == np.dtype(channel.dtype)


@pytest.mark.parametrize(
    "name",
    [f"recordings/{spec.name}" for spec in SPECS] + ["tables/breakaway", "tables/friction_model"],
)
def test_xarray_holds_what_the_file_itself_opens_as(run, run_path, name):
    kind, _, key = name.partition("/")
    found = getattr(run, kind)[key].to_xarray()
    with xr.open_dataset(run_path, engine="h5netcdf", group=f"/entry/{name}") as stored:
        xr.testing.assert_equal(found, stored)
        for variable in found.variables:
            assert found[variable].attrs["units"] == stored[variable].attrs["units"]
            assert found[variable].attrs["long_name"] == stored[variable].attrs.get("long_name", "")


def test_a_table_in_pandas_has_a_row_for_each_point_of_its_axes(run):
    frame, table = run.tables["friction_model"].to_pandas(), TABLES["friction_model"]
    again = frame.set_index(["speed", "position"])["torque"].unstack()
    np.testing.assert_array_equal(again.to_numpy(), table["torque"])
    by_speed = frame.groupby("speed")["count"]
    assert isinstance(by_speed.first(), pd.Series)
    np.testing.assert_array_equal(by_speed.first(), table["count"])
    assert (by_speed.nunique() == 1).all()
    assert frame.attrs["units"]["torque"] == table.columns["torque"].unit


def test_without_xarray_the_message_names_the_remedy(run, monkeypatch):
    found = builtins.__import__

    def without(name, *arguments, **named):
        if name == "xarray":
            raise ImportError(name)
        return found(name, *arguments, **named)

    monkeypatch.setattr(builtins, "__import__", without)
    for part in (run.tables["breakaway"], run.recordings["sweep"]):
        with pytest.raises(UsageError, match="pip install xarray"):
            part.to_xarray()


def test_the_page_of_a_run_shows_its_summary(run):
    assert run._repr_html_() == html_of(run.summary())
    assert html.unescape(run._repr_html_()) == "<pre>" + "\n".join(run.summary()) + "</pre>"


def test_the_page_of_a_run_is_escaped(tmp_path):
    path = tmp_path / "run.h5"
    note = "<script>alert('torque < 0 & moving')</script>"
    with RunWriter(path, command="stribeck") as writer:
        writer.finish({}, {}, [note])
    with open_run(path) as run:
        assert note in "\n".join(run.summary())
        assert "<script>" not in run._repr_html_()
        assert "&lt;script&gt;" in run._repr_html_()
