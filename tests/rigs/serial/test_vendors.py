"""What the makers' own packages send and name, byte for byte; skipped where they are missing.

    pip install moteus odrive cobs

Frames of moteus 1.1.1 are here as well, so that something is compared everywhere.
"""

import importlib.util
import math
import sys
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rigtool.recipe.serial import Limits
from rigtool.rigs.serial.drive import SetPoint
from rigtool.rigs.serial.moteus import drive, frames
from rigtool.rigs.serial.moteus.registers import MODE
from rigtool.rigs.serial.odrive.text import AXIS_ERRORS_05, AXIS_ERRORS_06
from rigtool.rigs.serial.target.frames import cobs_decode, cobs_encode
from tests.rigs.serial.emulators.moteus import MoteusEmulator

SINGLE = st.floats(-1e4, 1e4, width=32)
LIMITS = Limits(current=2.0, speed=20.0, position=(-1, 1), temperature_degc=60, duration=9)


@pytest.fixture(scope="module")
def moteus():
    return pytest.importorskip("moteus")


@pytest.fixture(scope="module")
def maker(moteus):
    """The maker's controller, which writes and reads floats."""
    sends, asks = moteus.PositionResolution(), moteus.QueryResolution()
    for name in ("position", "velocity", "feedforward_torque", "kp_scale", "kd_scale"):
        setattr(sends, name, moteus.F32)
    for name in ("maximum_torque", "watchdog_timeout", "ilimit_scale"):
        setattr(sends, name, moteus.F32)
    for name in ("position", "velocity", "torque", "q_current"):
        setattr(asks, name, moteus.F32)
    return moteus.Controller(
        id=1, transport=object(), position_resolution=sends, query_resolution=asks
    )


def own(mode="position", ratio=1.0):
    """Return a driver that is connected and configured as far as its frames are concerned."""
    found = drive.Moteus(type("Link", (), {"line": None, "node": 1})())
    found._motor = drive.MotorSettings(0.0625, ratio, False, math.inf, 0.0)
    found._limits, found._watchdog, found._mode = LIMITS, 0.25, mode
    return found


@given(position=SINGLE, speed=SINGLE, current=SINGLE)
def test_set_points_are_the_frames_of_the_makers_package(maker, position, speed, current):
    sent = own()._command(SetPoint(position, speed, current))
    wanted = maker.make_position(
        position=position / (2 * math.pi),
        velocity=speed / (2 * math.pi),
        feedforward_torque=current * 0.0625,
        kp_scale=1.0,
        kd_scale=1.0,
        maximum_torque=LIMITS.current * 0.0625,
        watchdog_timeout=0.25,
        ilimit_scale=1.0,
    )
    assert sent == wanted.data


@given(st.binary(max_size=frames.LONGEST_TEXT))
def test_text_and_stop_are_the_frames_of_the_makers_package(maker, text):
    assert frames.text_to_drive(text) == maker.make_diagnostic_write(text).data
    assert frames.ask_text() == maker.make_diagnostic_read(frames.LONGEST_TEXT).data
    assert maker.make_stop().data == drive.STOP


def test_the_emulator_answers_the_makers_package_as_ours(moteus, maker):
    """The maker's question, our emulator, the maker's own reading of the reply."""
    device = MoteusEmulator()
    device.motor.position, device.motor.speed, device.motor.current = 3.0, -2.0, 0.5
    asked = maker.make_query()
    data = device._frame(asked.data)
    found = asked.parse(SimpleNamespace(arbitration_id=0x100, data=data)).values
    register = moteus.Register
    assert found[register.POSITION] == pytest.approx(3.0 / (2 * math.pi), rel=1e-6)
    assert found[register.Q_CURRENT] == pytest.approx(device.motor.current, abs=1e-6)
    ours = frames.registers_of(data)
    assert {int(key) for key in found} == set(ours)
    assert ours[MODE] == found[register.MODE] == 0


# Made with moteus 1.1.1, as above.
PUBLISHED = (
    (
        SetPoint(math.pi / 2, -3 * math.pi, 2.0),
        "01000a0c06200000803e0000c0bf0000003e0000803f0000803f0000003e0d270000803e0d2b0000803f",
    ),
    (
        SetPoint(math.nan, 0.0, 0.0),
        "01000a0c06200000c07f00000000000000000000803f0000803f0000003e0d270000803e0d2b0000803f",
    ),
)


@pytest.mark.parametrize(("setpoint", "sent"), PUBLISHED)
def test_set_points_are_the_frames_that_the_makers_package_made(setpoint, sent):
    assert own()._command(setpoint).hex() == sent


def enums():
    """The enumerations of the package odrive, without its native library."""
    found = importlib.util.find_spec("odrive")
    if found is None or not found.submodule_search_locations:
        pytest.skip("the package odrive is not installed")
    path = f"{found.submodule_search_locations[0]}/enums.py"
    spec = importlib.util.spec_from_file_location("odrive_enums", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules["odrive_enums"] = module
    spec.loader.exec_module(module)
    return module


def test_errors_of_an_odrive_have_the_names_of_the_makers_package():
    found = enums()
    named = {error.value: error.name for error in found.ODriveError if error.value}
    assert named == AXIS_ERRORS_06
    for bit, name in AXIS_ERRORS_05.items():
        assert getattr(found, f"AXIS_ERROR_{name}") == bit


@given(st.one_of(st.binary(max_size=40), st.integers(250, 260).map(lambda size: b"x" * size)))
def test_frames_of_the_target_link_are_those_of_the_package_cobs(data):
    """A run of 254 bytes ends with a block of its own here, as in the paper; both are read."""
    cobs = pytest.importorskip("cobs.cobs")
    assert cobs.decode(cobs_encode(data)) == data
    assert cobs_decode(cobs.encode(data)) == data
