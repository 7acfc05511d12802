"""Drives of CiA 402 on a CAN bus: canopen's own node, with states, PDOs and watchdog of a drive.

`canopen.LocalNode` answers SDO requests and packs PDOs; what it leaves out is here: the state
machine of CiA 402, PDOs on SYNC and only in NMT state operational, mappings that change only while
a PDO is invalid, the consumer of heartbeats, a boot-up after a reset.
"""

import math
import struct
import time

import canopen
from canopen.objectdictionary import (
    INTEGER8,
    INTEGER16,
    INTEGER32,
    UNSIGNED8,
    UNSIGNED16,
    UNSIGNED32,
    ODRecord,
    ODVariable,
)

from rigtool.rigs.serial.emulators.motor import EmulatedMotor
from rigtool.rigs.serial.transport.can_frames import CanFrame
from tests.rigs.serial.emulators.slcan import SlcanEmulator

RPM = 2 * math.pi / 60
COUNTS = 4000
U8, U16, U32, I8, I16, I32 = UNSIGNED8, UNSIGNED16, UNSIGNED32, INTEGER8, INTEGER16, INTEGER32

RATED = 3.21
"""Rated current, A."""

OBJECTS = {
    (0x1000, 0): (U32, 0x00020192),
    (0x1016, 1): (U32, 0),
    (0x1018, 1): (U32, 0x15A),
    (0x1018, 2): (U32, 0x63500000),
    (0x1018, 4): (U32, 0x1234),
    (0x603F, 0): (U16, 0),
    (0x6007, 0): (I16, 3),
    (0x6040, 0): (U16, 0),
    (0x6041, 0): (U16, 0),
    (0x6060, 0): (I8, 1),
    (0x6061, 0): (I8, 1),
    (0x6064, 0): (I32, 0),
    (0x6071, 0): (I16, 0),
    (0x6072, 0): (U16, 3000),
    (0x6073, 0): (U16, 3000),
    (0x6074, 0): (I16, 0),
    (0x6075, 0): (U32, round(RATED * 1e3)),
    (0x6078, 0): (I16, 0),
    (0x607A, 0): (I32, 0),
    (0x607D, 1): (I32, -(2**31)),
    (0x607D, 2): (I32, 2**31 - 1),
    (0x6080, 0): (U32, 10000),
    (0x608F, 1): (U32, COUNTS),
    (0x608F, 2): (U32, 1),
    (0x60A9, 0): (U32, 0xFDB44700),  # mrpm
    (0x60B2, 0): (I16, 0),
    (0x60FF, 0): (I32, 0),
    (0x6502, 0): (U32, 0x3A5),
}
MODES = {8: "position", 9: "velocity", 3: "velocity", 10: "current", 4: "current"}

INVALID = 1 << 31


class BadTransition(Exception):
    """A test looks here: the host asked for what no drive does."""


def dictionary(objects):
    """Return an object dictionary of canopen with these objects, and four PDOs each way."""
    od = canopen.ObjectDictionary()
    for number in range(4):
        for base, kind in ((0x1400, 255), (0x1800, 255)):
            cob = (0x200 if base == 0x1400 else 0x180) + 0x100 * number + 1
            objects = {
                **objects,
                (base + number, 1): (U32, cob | (INVALID if number < 2 else 0)),
                (base + number, 2): (U8, kind),
                (base + number + 0x200, 0): (U8, 1),
                (base + number + 0x200, 1): (
                    U32,
                    0x60400010 if base == 0x1400 else 0x60410010,
                ),
                **{(base + number + 0x200, n): (U32, 0) for n in range(2, 5)},
            }
    for (index, sub), (kind, value) in objects.items():
        variable = ODVariable(f"Object {index:04X} {sub:02X}", index, sub)
        variable.data_type, variable.default, variable.access_type = kind, value, "rw"
        simple = sub == 0 and not any(i == index and s for i, s in objects)
        if simple:
            od.add_object(variable)
            continue
        if index not in od:
            od.add_object(ODRecord(f"Record {index:04X}", index))
        od[index].add_member(variable)
    return od


class Network(canopen.Network):
    def __init__(self, send):
        super().__init__()
        self._send = send

    def send_message(self, can_id, data, remote=False):
        self._send(CanFrame(can_id, bytes(data), remote=remote))

    def send_periodic(self, can_id, data, period, remote=False):
        raise NotImplementedError("nobody asked this drive for a heartbeat of its own")


class CiA402Emulator(SlcanEmulator):
    """A drive at node 1, with the objects of CiA 402 alone; `objects` adds to them or changes them.

    An object whose value is None is not there.
    """

    current = (0x6078, 0)
    limits_in_its_unit = False
    """Whether 6080 is in the unit of speed, as in an EPOS4, or in rpm."""
    mechanical = EmulatedMotor

    def __init__(self, objects=None, hears=True):
        super().__init__()
        self.kept = {**OBJECTS, **(objects or {})}
        self.kept = {place: item for place, item in self.kept.items() if item[1] is not None}
        self.hears = hears
        self.log = []
        self.refusals = 0
        self.motor = self.mechanical()
        self.reset()

    def reset(self):
        """Start as after a loss of power."""
        self.network = Network(self.send)
        self.node = canopen.LocalNode(1, dictionary(self.kept))
        self.network.add_node(self.node)
        self.node.add_read_callback(self.on_read)
        self.node.add_write_callback(self.on_write)
        self.network.subscribe(0x80, self.on_sync)
        self.network.subscribe(0, self.on_nmt)
        self.node.nmt._state = 127
        self.state, self.mode, self.code = "switch on disabled", None, 0
        self.heard = None
        self.motor.position = self.motor.speed = 0.0
        self.send(CanFrame(0x701, b"\0"))

    def refuse(self, count):
        self.refusals = count

    # -- bus

    def on_frame(self, frame):
        if not self.hears:
            return
        self.live()
        if 0x700 < frame.identifier < 0x780:
            watched = self.value(0x1016, 1) if (0x1016, 1) in self.kept else 0
            if frame.identifier == 0x700 + (watched >> 16 & 0x7F):
                self.heard = time.monotonic()
        if self.node.nmt.state == "STOPPED" and frame.identifier != 0:
            return
        if frame.identifier == 0x601 and self.refusals:
            self.refusals -= 1
            self.send(CanFrame(0x581, b"\x80" + frame.data[1:4] + struct.pack("<I", 0x08000022)))
            return
        if frame.identifier in (0x201, 0x301, 0x401, 0x501):
            if self.node.nmt.state == "OPERATIONAL":
                self.on_rpdo(frame)
            return
        self.network.notify(frame.identifier, bytearray(frame.data), 0.0)

    def on_nmt(self, can_id, data, timestamp):
        if data[0] in (0x81, 0x82):
            stored = dict(self.node.data_store)
            self.log.append("reset communication")
            for index in list(stored):
                if index < 0x2000:
                    del self.node.data_store[index]
            self.code = -abs(self.code)  # from now on it may be cleared
            self.node.nmt._state = 127
            self.send(CanFrame(0x701, b"\0"))

    def pdos(self, base):
        """Return (identifier, type, entries) of the valid PDOs."""
        for number in range(4):
            identifier = self.value(base + number, 1)
            if not identifier & INVALID:
                count = self.value(base + number + 0x200, 0)
                places = [self.value(base + number + 0x200, n) for n in range(1, count + 1)]
                yield identifier & 0x7FF, self.value(base + number, 2), places

    def on_sync(self, can_id, data, timestamp):
        if self.node.nmt.state != "OPERATIONAL":
            return
        for identifier, kind, places in self.pdos(0x1800):
            if kind == 1:
                data = b"".join(self.node.get_data(p >> 16, p >> 8 & 0xFF) for p in places)
                self.send(CanFrame(identifier, data))

    def on_rpdo(self, frame):
        for identifier, _, places in self.pdos(0x1400):
            if identifier == frame.identifier:
                size = sum(place & 0xFF for place in places) // 8
                if len(frame.data) != size:
                    self.fault(0x8210)
                    return
                at = 0
                for place in places:
                    part = frame.data[at : (at := at + (place & 0xFF) // 8)]
                    self.node.set_data(place >> 16, place >> 8 & 0xFF, part)

    # -- objects

    def value(self, index, sub=0):
        """Return the number that an object has."""
        kind = self.node.object_dictionary.get_variable(index, sub)
        data = self.node.data_store.get(index, {}).get(sub)
        return kind.default if data is None else kind.decode_raw(data)

    def on_read(self, index, subindex, od):
        return self.measured().get((index, subindex))

    def measured(self):
        self.turn()
        return {
            (0x6041, 0): self.status,
            (0x603F, 0): abs(self.code),
            (0x6061, 0): self.value(0x6060),
            (0x6064, 0): math.floor(self.motor.position / (2 * math.pi) * COUNTS),
            (0x6074, 0): round(self.motor.current_setpoint / RATED * 1e3),
            (0x6078, 0): round(self.motor.current / RATED * 1e3),
        }

    @property
    def status(self):
        return {
            "switch on disabled": 0x0240,
            "ready": 0x0231,
            "switched on": 0x0233,
            "enabled": 0x0237,
            "fault": 0x0208,
        }[self.state]

    def on_write(self, index, subindex, od, data):
        value = od.decode_raw(data)
        self.turn()
        if 0x1400 <= index < 0x1C00:
            self.require_mapping(index, subindex, value)
        if index == 0x6040:
            self.control(value)

    def require_mapping(self, index, sub, value):
        record = index & ~0x200
        valid = not self.value(record, 1) & INVALID
        if (index & 0x200 and valid) or (
            sub == 1
            and not index & 0x200
            and valid
            and not value & INVALID
            and value != self.value(record, 1)
        ):
            raise canopen.SdoAbortedError(0x06010000)
        if index & 0x200 and sub and self.value(index, 0):
            raise canopen.SdoAbortedError(0x06010000)
        if index & 0x200 and sub == 0 and value:
            bits = sum(self.value(index, n) & 0xFF for n in range(1, value + 1))
            for n in range(1, value + 1):
                place = self.value(index, n)
                known = self.node.object_dictionary.get_variable(place >> 16, place >> 8 & 0xFF)
                if known is None or len(known) != place & 0xFF:
                    raise canopen.SdoAbortedError(0x06040041)
            if bits > 64:
                raise canopen.SdoAbortedError(0x06040042)

    # -- states

    def control(self, word):
        """Follow a control word, one state a word."""
        low = word & 0x8F
        if self.state == "fault":
            if low & 0x80 and self.code <= 0:
                self.state, self.code = "switch on disabled", 0
            return
        if not low & 0x02:
            self.switch("switch on disabled")
        elif low & 0x07 == 0x06:
            self.switch("ready")
        elif low & 0x0F == 0x07 and self.state in ("ready", "enabled"):
            self.switch("switched on")
        elif low & 0x0F == 0x0F and self.state == "switched on":
            self.switch("enabled")

    def switch(self, state):
        if state == "ready" and self.state not in ("switch on disabled", "enabled", "switched on"):
            return
        was, self.state = self.state == "enabled", state
        self.mode = MODES.get(self.value(0x6060)) if state == "enabled" else None
        if was != (state == "enabled"):
            self.log.append(f"on: {self.mode}" if state == "enabled" else "off")

    def fault(self, code):
        """Report a fault: the power stage is off."""
        self.switch("switch on disabled")
        self.state, self.code = "fault", code
        self.log.append(f"fault {code:#06x}")
        self.send(CanFrame(0x081, struct.pack("<HB5x", code, 0x10)))

    def live(self):
        """Turn the motor, and watch the host."""
        self.turn()
        watched = self.value(0x1016, 1) if (0x1016, 1) in self.kept else 0
        if not watched & 0xFFFF:
            self.heard = None
        if self.heard is not None and time.monotonic() - self.heard > (watched & 0xFFFF) * 1e-3:
            self.heard = None
            self.node.nmt._state = 127
            if self.value(0x6007) == 2 or self.state != "enabled":
                self.fault(0x8130)

    def turn(self):
        """Turn the motor until now."""
        get = self.value
        unit = RPM * 10.0 ** struct.unpack("<b", bytes([self.speed_unit() >> 24]))[0]
        offset = self.amperes(get(0x60B2)) if (0x60B2, 0) in self.kept else 0.0
        target = self.amperes(get(0x6071)) if self.mode == "current" else 0.0
        self.motor.current_limit = self.limit()
        self.motor.advance(
            self.mode,
            get(0x607A) / COUNTS * 2 * math.pi,
            self.speed(unit) if self.mode == "velocity" else 0.0,
            offset + target,
        )

    def speed(self, unit):
        """Return the set point of speed, rad/s, within 6080 and, in profile mode, 607F."""
        top = self.value(0x6080) * (unit if self.limits_in_its_unit else RPM)
        if self.value(0x6060) == 3 and (0x607F, 0) in self.kept:
            top = min(top, self.value(0x607F) * unit)
        return min(max(self.value(0x60FF) * unit, -top), top)

    def speed_unit(self):
        return self.value(0x60A9) if (0x60A9, 0) in self.kept else 0xB44700

    def amperes(self, per_mille):
        return per_mille * RATED * 1e-3

    def limit(self):
        """Return the limit of current, A."""
        return self.amperes(min(self.value(0x6072), self.value(0x6073)))


class Epos4CanEmulator(CiA402Emulator):
    """An EPOS4: its current and limits are objects of its maker, its rated torque in uN m."""

    limits_in_its_unit = True

    def __init__(self, objects=None, hears=True):
        own = {
            (0x1018, 1): (U32, 0xFB),
            (0x3001, 1): (U32, 3210),
            (0x3001, 2): (U32, 15000),
            (0x3001, 5): (U32, 45000),
            (0x3010, 1): (U32, COUNTS // 4),
            (0x30D0, 0): (I16, 0),
            (0x30D1, 2): (I32, 0),
            (0x6076, 0): (U32, 144450),
            (0x6080, 0): (U32, 10_000_000),
            (0x6072, 0): (U16, None),
            (0x6073, 0): (U16, None),
            (0x6075, 0): (U32, None),
            (0x6074, 0): (I16, None),
            (0x6078, 0): (I16, None),
            (0x608F, 1): (U32, None),
            (0x608F, 2): (U32, None),
        }
        super().__init__({**own, **(objects or {})}, hears)

    def measured(self):
        """Return objects that are measured."""
        return {
            **super().measured(),
            (0x30D1, 2): round(self.motor.current * 1e3),
            (0x30D0, 0): round(self.motor.current_setpoint * 1e3),
        }

    def limit(self):
        return self.value(0x3001, 2) * 1e-3
