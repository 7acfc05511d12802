"""An ODrive and a moteus on a CAN bus, behind an slcan adapter.

The ODrive has a watchdog that counts at rest as well, is fed by any frame, and is off as delivered;
it reads no setting over the bus, and 0.5 does not know the question for its version. Beside its
heartbeat 0.5 sends its position each 10 ms, asked or not.
"""

import struct
import time

from rigtool.rigs.serial.emulators.motor import EmulatedMotor
from rigtool.rigs.serial.moteus import frames
from rigtool.rigs.serial.transport.can_frames import CanFrame
from tests.rigs.serial.emulators.moteus import MoteusEmulator
from tests.rigs.serial.emulators.slcan import SlcanEmulator

TURN = 6.283185307179586
IDLE, CLOSED_LOOP = 1, 8
BEAT = 0.1
ESTIMATES = 0.01


class ODriveCanEmulator(SlcanEmulator):
    """Node 0; `watchdog` [s] as its owner has set it, None where it is off."""

    def __init__(self, *, new=False, watchdog=0.2, direction=1, thermistor=False):
        super().__init__()
        self.new, self.watchdog, self.direction = new, watchdog, direction
        self.temperature = 31.25 if thermistor else float("nan")
        self.motor = EmulatedMotor()
        self.calibrated = True
        self.log = []
        self.reset()

    def reset(self):
        self.state, self.error, self.encoder_flag = IDLE, 0, 0
        self.control, self.input = 3, 3
        self.speed = self.torque = 0.0
        self.limits = (100.0, 60.0)
        self.fed = self.beat = self.estimated = time.monotonic()
        self.log.append("reset")

    @property
    def watchdog_error(self):
        return 0x01000000 if self.new else 0x800

    def answer(self, command, form, *values):
        self.send(CanFrame(command, struct.pack(form, *values)))

    def on_frame(self, frame):
        if frame.identifier >> 5 or frame.extended or frame.fd:
            return
        self.live()
        self.fed = time.monotonic()
        command = frame.identifier & 0x1F
        m = self.motor
        if frame.remote:
            if command == 0x00 and self.new:
                self.answer(0x00, "<8B", 2, 4, 4, 58, 0, 6, 11, 0)
            elif command == 0x09:
                self.answer(0x09, "<ff", m.position / TURN, m.speed / TURN)
            elif command == 0x14:
                iq = (m.current_setpoint * self.direction, m.current * self.direction)
                self.answer(0x14, "<ff", *iq)
            elif command == 0x15 and self.new:
                self.answer(0x15, "<ff", 40.0, self.temperature)
            return
        self.obey(command, frame.data)
        self.turn()

    def obey(self, command, data):
        if command == 0x07:
            (state,) = struct.unpack("<I", data)
            if state == CLOSED_LOOP and (self.error or not self.calibrated):
                self.error |= 0x1
            elif state in (IDLE, CLOSED_LOOP) and state != self.state:
                self.state = state
                self.log.append(f"state {state}")
        elif command == 0x0B:
            self.control, self.input = struct.unpack("<II", data)
        elif command == 0x0D:
            self.speed, self.torque = struct.unpack("<ff", data)
        elif command == 0x0E:
            (self.torque,) = struct.unpack("<f", data)
        elif command == 0x0F:
            self.limits = struct.unpack("<ff", data)
        elif command == 0x18:
            self.error = 0

    def live(self):
        now = time.monotonic()
        if self.watchdog is not None and now - self.fed > self.watchdog:
            if self.state == CLOSED_LOOP:
                self.log.append("watchdog")
            self.error |= self.watchdog_error
            self.state = IDLE
        if now - self.beat >= BEAT:
            self.beat = now
            self.answer(0x01, "<IBBBB", self.error, self.state, 0, self.encoder_flag, 0)
        self.turn()
        if not self.new and now - self.estimated >= ESTIMATES:
            self.estimated = now
            self.answer(0x09, "<ff", self.motor.position / TURN, self.motor.speed / TURN)

    def turn(self):
        mode = {1: "current", 2: "velocity"}.get(self.control) if self.state == 8 else None
        self.motor.current_limit = self.limits[1]
        limit = self.limits[0]
        speed = min(max(self.speed, -limit), limit) * TURN
        self.motor.advance(mode, 0.0, speed, self.torque / abs(self.motor.torque_constant))


class MoteusCanEmulator(SlcanEmulator):
    """The drive of `emulators.moteus`, without an fdcanusb between."""

    def __init__(self, **settings):
        super().__init__()
        self.device = MoteusEmulator(**settings)

    def reset(self):
        self.device.reset()

    def refuse(self, count):
        self.device.refuse(count)

    def on_frame(self, frame):
        if not frame.fd or frame.identifier & 0x7F != self.device.node:
            return
        assert frame.extended == (frame.identifier > 0x7FF)
        try:
            answer = self.device._frame(frame.data)
        except (frames.BadFrame, ValueError):
            return
        if frame.identifier & 0x8000 and answer:
            back = self.device.node << 8 | frame.identifier >> 8 & 0x7F
            self.send(CanFrame(back, frames.padded(answer), back > 0x7FF, fd=True))

    def live(self):
        self.device.idle()
