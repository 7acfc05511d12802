"""An emulated drive whose time passes only while somebody waits: exact, fast, and never late.

The host's side is a real `Line` and a real driver; between them lies a wire with a delay. Only
clocks and the port are others than over a pseudo-terminal.
"""

import types

from rigtool.rigs.serial import line
from rigtool.rigs.serial.emulators import motor
from rigtool.rigs.serial.emulators.server import TICK
from tests.rigs.serial import toy
from tests.rigs.serial.emulators import maxon, moteus, odrive

CLOCKS = (line, motor, odrive, moteus, maxon, toy)
"""Modules that look at the time."""


class World:
    """The time [s], and the device that lives in it; `delay` [s] is that of the wire, each way.

    `stalls` maps times to how long the host is held up then, s.
    """

    def __init__(self, delay=3e-4, stalls=None):
        self.now = 1000.0
        self.delay = delay
        self.stalls = dict(stalls or {})
        self.device = None
        self._turned = self.now

    def monotonic(self):
        return self.now

    def sleep(self, seconds):
        self.go(self.now + seconds)
        for moment in [moment for moment in self.stalls if moment + 1000.0 <= self.now]:
            self.go(self.now + self.stalls.pop(moment))

    def go(self, moment):
        """Let time pass, and the device look around every `TICK` as its server makes it do."""
        while self.device is not None and self._turned + TICK < moment:
            self._turned = self.now = max(self.now, self._turned + TICK)
            self.device.idle()
        self.now = max(self.now, moment)


class Port:
    """What a `Line` has instead of a serial port."""

    def __init__(self, world):
        self.world = world
        self.pending, self.ready = b"", 0.0

    def write(self, data):
        self.world.go(self.world.now + self.world.delay)
        reply = self.world.device.receive(bytes(data))
        if reply:
            self.pending, self.ready = self.pending + reply, self.world.now + self.world.delay

    @property
    def in_waiting(self):
        return len(self.pending) if self.world.now >= self.ready else 0

    def read(self, size):
        if not self.pending:
            self.world.go(self.world.now + line.POLL)
            return b""
        self.world.go(self.ready)
        data, self.pending = self.pending[:size], self.pending[size:]
        return data

    def close(self):
        self.pending = b""


def pass_time(monkeypatch, make_device, **options):
    """Return a world and the device in it; lines that are opened from now on lead there."""
    world = World(**options)
    clock = types.SimpleNamespace(monotonic=world.monotonic, sleep=world.sleep)
    for module in CLOCKS:
        monkeypatch.setattr(module, "time", clock)
    monkeypatch.setattr(line, "_open", lambda port, baud_rate: Port(world))
    world.device = make_device()
    world.device.motor._then = world.now
    return world, world.device
