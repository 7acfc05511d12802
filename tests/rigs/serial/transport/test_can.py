"""A CAN bus as the port of a line: frames as text, python-can, what it makes of damage."""

import sys
import types

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rigtool.errors import HardwareError, UsageError
from rigtool.rigs.serial.line import DamagedReply, Line, LineLost, LineTimeout
from rigtool.rigs.serial.transport.can_frames import SIZES, CanFrame, decode, encode
from tests.rigs.serial.emulators.faults import Fault, serve
from tests.rigs.serial.emulators.slcan import SlcanEmulator

FRAMES = st.builds(
    lambda number, extended, remote, fd, size: CanFrame(
        number & (0x1FFFFFFF if extended else 0x7FF),
        b"" if remote and not fd else bytes(range(size if fd else min(size, 8))),
        extended,
        remote and not fd,
        fd,
    ),
    st.integers(0, 0x1FFFFFFF),
    st.booleans(),
    st.booleans(),
    st.booleans(),
    st.sampled_from(SIZES),
)


class Echo(SlcanEmulator):
    """Sends back each frame, in whatever text a test wants."""

    garbled = b""

    def on_frame(self, frame):
        self.out += self.garbled
        self.send(frame)


@given(FRAMES)
def test_any_frame_is_read_as_it_was_written(frame):
    assert decode(encode(frame)) == frame


@given(FRAMES)
def test_notation_is_that_of_python_can(frame):
    written = []
    bus = object.__new__(can.interfaces.slcan.slcanBus)
    bus.serialPortOrig = types.SimpleNamespace(
        write_timeout=None, write=written.append, flush=lambda: None
    )
    bus._is_shutdown = True
    bus.send(
        can.Message(
            arbitration_id=frame.identifier,
            data=frame.data,
            is_extended_id=frame.extended,
            is_remote_frame=frame.remote,
            is_fd=frame.fd,
            bitrate_switch=frame.fd,
        )
    )
    assert written == [encode(frame)]


@pytest.mark.parametrize("text", [b"", b"\r", b"x123", b"t12", b"t1239", b"t1232AA", b"tXYZ0"])
def test_other_text_is_no_frame(text):
    with pytest.raises(ValueError):  # noqa: PT011
        decode(text)


@pytest.mark.parametrize(
    "frame", [CanFrame(0x123, b"\1\2"), CanFrame(0x8001, bytes(64), True, fd=True)]
)
def test_frames_pass_an_slcan_adapter(frame):
    with serve(Echo()) as server, Line(f"can:slcan:{server.port}", 500_000) as line:
        line.write(encode(frame) + encode(CanFrame(0x001)))
        assert [line.read_frame(), line.read_frame()] == [frame, CanFrame(0x001)]
        assert server.emulator.bit_rate == "S6"
        with pytest.raises(LineTimeout):
            line.read_frame(0.05)


@pytest.mark.parametrize("garbled", [b"t12X1\r", b"t1238AABB\r", b"t\xff\r", b"t\r", b"dA\r"])
def test_damaged_text_of_an_adapter_is_a_damaged_reply_and_passes(garbled):
    device = Echo()
    device.garbled = garbled
    with serve(device) as server, Line(f"can:slcan:{server.port}", 500_000) as line:
        line.write(encode(CanFrame(0x123, b"\1")))
        with pytest.raises(DamagedReply, match="is no CAN frame"):
            line.read_frame()
        line.settle()
        device.garbled = b""
        line.write(encode(CanFrame(0x123, b"\1")))
        assert line.read_frame() == CanFrame(0x123, b"\1")


def test_bit_rate_of_the_address_counts_and_unknown_ones_are_refused():
    with serve(Echo()) as server:
        with Line(f"can:slcan:{server.port}?bitrate=125000", 500_000):
            pass
        with pytest.raises(HardwareError, match="cannot be opened: Invalid bitrate"):
            Line(f"can:slcan:{server.port}?bitrate=123", 500_000)
        timing = "f_clock=80000000&bitrate=1000000&data_bitrate=5000000"
        with Line(f"can:slcan:{server.port}?{timing}", 500_000) as line:
            line.settle()
        assert server.emulator.bit_rate == "S4S8Y5"


def test_pulled_cable_loses_the_line_once_and_for_all():
    with serve(Echo(), Fault("pull", at=1)) as server:
        line = Line(f"can:slcan:{server.port}", 500_000)
        line.write(encode(CanFrame(0x123)))
        line.settle()
        line.write(encode(CanFrame(0x123)))
        with pytest.raises(LineLost, match="the line is lost"):
            line.read_frame()
        line.close()


def test_virtual_bus_is_a_port():
    with Line("can:virtual:test_can") as line, can.Bus("test_can", "virtual") as other:
        other.send(can.Message(arbitration_id=0x123, data=b"\5", is_extended_id=False))
        assert line.read_frame() == CanFrame(0x123, b"\5")
        line.write(encode(CanFrame(0x10008001, bytes(12), True, fd=True)))
        message = other.recv(1.0)
        assert (message.arbitration_id, message.is_fd, message.dlc) == (0x10008001, True, 12)
        assert message.bitrate_switch


@pytest.mark.parametrize("address", ["can:", "can:slcan", "can:nothing:x", "can:slcan:/dev/nope"])
def test_what_is_no_bus_is_refused(address):
    with pytest.raises(HardwareError, match=f"{address}.*cannot be opened"):
        Line(address, 500_000)


def test_missing_extra_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "can", None)
    with pytest.raises(UsageError, match=r"pip install rigtool\[can\]"):
        Line("can:socketcan:can0")
