"""CANopen on a line: python-can's virtual bus and a real pseudo-terminal, canopen's node beyond."""

import canopen
import pytest

from rigtool.rigs.serial.cia402 import objects as od
from rigtool.rigs.serial.cia402.network import ON_SYNC, TRANSMIT, CanObjects, spread
from rigtool.rigs.serial.cia402.objects import Entry, find
from rigtool.rigs.serial.emulators.server import serve
from rigtool.rigs.serial.line import DamagedReply, Line, RequestRefused
from tests.rigs.serial.emulators.canopen import OBJECTS, CiA402Emulator, dictionary

PATIENCE = 60.0
"""Longest wait for an answer of a thread on a machine that stalls, s."""


@pytest.fixture
def bus():
    """A node of canopen on python-can's virtual bus, with a thread of its own."""
    network = canopen.Network()
    network.connect("test_network", interface="virtual")
    network.create_node(1, dictionary(OBJECTS))
    yield network
    network.disconnect()


@pytest.mark.real_time
def test_objects_of_canopens_own_node_over_the_virtual_bus(bus):
    with Line("can:virtual:test_network", timeout=PATIENCE) as line:
        objects = CanObjects(line, 1)
        assert objects.read(od.DEVICE_TYPE) == 0x00020192
        objects.write(od.LOWEST, -12345)
        assert objects.read(od.LOWEST) == -12345
        assert bus[1].sdo[0x607D][1].raw == -12345
        assert find(objects, Entry(0x5FFF, 0, "I", "nothing")) is None
        bus[1].object_dictionary[0x60FF].access_type = "ro"
        with pytest.raises(RequestRefused, match=r"target speed \(60FF:00\) be set to 7: error"):
            objects.write(od.TARGET_SPEED, 7)


@pytest.mark.real_time
def test_pdo_is_mapped_and_sampled_over_a_pseudo_terminal():
    with (
        serve(CiA402Emulator()) as server,
        Line(f"can:slcan:{server.port}", 1_000_000, timeout=PATIENCE) as line,
    ):
        objects = CanObjects(line, 1)
        carried = [od.POSITION, od.TORQUE_CURRENT, od.STATUS]
        identifier = objects.map(TRANSMIT, 0, ON_SYNC, carried)
        assert objects.read_pdo(TRANSMIT).entries == (0x60640020, 0x60780010, 0x60410010)
        objects.change_state("OPERATIONAL")
        values, asked, answered = objects.sample(b"", {identifier: carried})
        assert values == {od.POSITION: 0, od.TORQUE_CURRENT: 0, od.STATUS: 0x0240}
        assert asked <= answered


def test_entries_are_spread_over_pdos_of_64_bit():
    wide = [Entry(0x2000, n, "i", "wide") for n in range(3)]
    with Line("can:virtual:nobody") as line:
        found = spread(CanObjects(line, 1), [*wide, od.STATUS])
    assert found == [wide[:2], [wide[2], od.STATUS]]


def test_emergency_that_is_too_short_is_a_damaged_reply():
    device = CiA402Emulator()
    device.live = lambda: None
    with serve(device) as server, Line(f"can:slcan:{server.port}", 1_000_000) as line:
        objects = CanObjects(line, 1)
        device.open = True
        device.out = b"t0812AABB\r"
        with pytest.raises(DamagedReply, match="is too short"):
            objects._network.take_in(1.0)
