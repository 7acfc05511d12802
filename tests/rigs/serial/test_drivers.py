"""Drivers by name: those of rigtool, and one that another package adds by an entry point."""

import importlib
import sys

import pytest

from rigtool import plugins
from rigtool.errors import RecipeError, RigtoolError
from rigtool.rigs import open_rig
from rigtool.rigs.serial import drivers
from rigtool.rigs.serial.drivers import Driver
from rigtool.rigs.serial.emulators.server import serve
from rigtool.rigs.serial.hosted.rig import HostedRig
from rigtool.rigs.serial.ports import askable, find_devices
from tests.rigs.serial import toy
from tests.rigs.serial.recipes import serial_recipe

POINTS = """[rigtool.drivers]
toy = tests.rigs.serial.toy:DRIVER
text = tests.rigs.serial.toy:__doc__
maxon = tests.rigs.serial.toy:DRIVER
"""


@pytest.fixture
def package(tmp_path, monkeypatch):
    """Install a package with drivers, as far as its metadata go."""
    info = tmp_path / "rigtool_toy-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: rigtool-toy\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(POINTS)
    monkeypatch.setattr(sys, "path", [*sys.path, str(tmp_path)])
    importlib.invalidate_caches()
    plugins.plugins.cache_clear()
    yield
    plugins.plugins.cache_clear()


@pytest.mark.parametrize("name", drivers.DRIVER_MODULES)
def test_each_driver_of_rigtool_makes_a_drive_or_a_rig(name, monkeypatch):
    monkeypatch.setattr(drivers, "plugins", None)  # other packages are not asked for these
    found = drivers.driver(name)
    assert isinstance(found, Driver)
    assert (found.make_drive is None) != (found.make_rig is None)


def test_unknown_driver_is_refused_with_the_known_ones():
    known = (
        f"'toaster' is unknown: use one of {', '.join(drivers.DRIVER_MODULES)}, replay, or install"
    )
    with pytest.raises(RecipeError, match=known):
        open_rig(serial_recipe("/dev/none", driver="toaster"), 0.045, "test")


@pytest.mark.usefixtures("package")
def test_driver_of_another_package_is_found_opened_and_asked():
    assert "toy" in askable()
    with pytest.raises(RecipeError, match="cia402, text, toy, replay"):
        drivers.driver("toaster")
    with serve(toy.ToyEmulator()) as server:
        rig = open_rig(serial_recipe(server.port, driver="toy", sample_time=0.01), 0.045, "test")
        assert isinstance(rig, HostedRig)
        with rig:
            assert "toy 1" in rig.report()
        (device,) = find_devices([server.port], ["toy"])
    assert device.driver == "toy"
    assert device.identity.startswith("toy 1")


@pytest.mark.usefixtures("package")
def test_drivers_of_other_packages_replace_none_of_rigtool_and_are_drivers(caplog):
    assert drivers.driver("maxon") is not toy.DRIVER
    with pytest.raises(RigtoolError, match="driver text of rigtool-toy is of type str"):
        drivers.driver("text")
    assert caplog.messages == [
        "Warning: driver maxon of rigtool-toy is left out: rigtool has one of that name"
    ]
