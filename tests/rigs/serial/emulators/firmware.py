"""The target in C on a computer, with the plant of the virtual rig.

The Python emulator gets the same requests, and moves the virtual rig; its samples of encoder,
current and temperature are those that the interrupt in C sees, one after the other. What the loop
in C asks for is compared with what the virtual rig's own loop asked for: as long as both are equal,
the plant would have moved so under the loop in C.
"""

import ctypes
import math
import shutil
import subprocess
import time
from collections import deque
from dataclasses import replace
from pathlib import Path

import numpy as np

from rigtool.rigs.serial.emulators.server import Emulator
from rigtool.rigs.serial.emulators.target import TargetEmulator
from rigtool.rigs.serial.target import link
from rigtool.rigs.serial.target.link import TargetState
from rigtool.rigs.virtual import VirtualRig

SOURCES = Path(link.__file__).with_name("firmware")
HOST = Path(__file__).parents[1] / "target" / "firmware_host.c"
STRICT = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wshadow", "-Werror")
NAMES = ("encoder", "current", "temperature")
AT_ONCE = 1 << 14


def build(folder, name, *flags, source=HOST):
    """Compile the target strictly with its host; return the path of the result."""
    own = sorted(SOURCES.glob("rigtool_*.c"))
    command = [shutil.which("cc"), *STRICT, *flags, f"-I{SOURCES}", f"-I{folder}", source, *own]
    subprocess.run([*map(str, command), "-o", str(folder / name), "-lm"], check=True, timeout=120)
    return folder / name


def library(folder, *flags, name="target.so"):
    """Return the target as a library for ctypes."""
    found = ctypes.CDLL(str(build(folder, name, "-shared", "-fPIC", "-O1", *flags)))
    found.firmware_send.restype = ctypes.c_uint32
    return found


def pointer(array):
    return array.ctypes.data_as(ctypes.c_void_p)


class ShownRig(VirtualRig):
    """A virtual rig that shows each sample of its loop, also those of moves between recordings."""

    shown: deque

    def _run(self, task, grip=None):
        for block in super()._run(replace(task, record_every=1), grip):
            self.shown.append(block)
            yield block


class Twin(TargetEmulator):
    """The Python emulator beside it: it takes the same requests, and moves when it is asked to."""

    def __init__(self, recipe):
        self.shown, self.moving = deque(), iter(())
        super().__init__(recipe)

    def _set_up(self, setup):
        super()._set_up(setup)
        recipe = self.rig._rig
        own = self._recipe.model_copy(update={"rig": recipe})
        self.rig = ShownRig(own, setup.torque_constant, setup.use)
        self.rig.shown = self.shown

    def _start(self, payload):
        if self.state is TargetState.ARMED:
            self.moving = self.rig.perform(self._task)
            self.state = TargetState.DONE
        return b""

    def _move_by(self, payload):
        self.rig.move_by(*link.read_floats(payload).tolist())
        return b""

    def next_samples(self):
        """Return the next block of the virtual rig, None after its end."""
        while not self.shown:
            if next(self.moving, None) is None:
                return None
        return self.shown.popleft()


class Bare(Emulator):
    """The target in C with a shaft that is always at its set point."""

    c = None
    """The library, set by the tests."""

    def __init__(self, *, keeps_log=True, log_bytes=1 << 24):
        self._boot = 0
        self._keeps_log, self._log_bytes = keeps_log, log_bytes
        self.reset()

    def reset(self):
        """Start anew, as after a loss of power."""
        self._boot += 1
        self.c.firmware_begin(self._boot, self._log_bytes, int(self._keeps_log))

    def refuse(self, count):
        """Have a fault of the drive."""
        self.c.firmware_fault(b"the drive reports undervoltage")

    @property
    def state(self):
        return TargetState(self.c.firmware_state())

    def receive(self, data):
        self.c.firmware_receive(data, len(data))
        return self._out()

    def idle(self):
        self.c.firmware_follow(AT_ONCE, clock())
        return self._out()

    def _out(self):
        out = ctypes.create_string_buffer(1 << 14)
        count = self.c.firmware_send(out, len(out))
        return out.raw[:count]


def clock():
    return int(time.monotonic() * 1e3) & 0xFFFFFFFF


class Firmware(Bare):
    """Its samples are those of the virtual rig.

    `difference` is the largest of its currents from the virtual rig's, A.
    """

    def __init__(self, recipe, *, paced=False, **options):
        self._twin, self._paced = Twin(recipe), paced
        self._period, self.difference = recipe.rig.sample_time, 0.0
        super().__init__(**options)

    def reset(self):
        super().reset()
        self._twin.reset()
        self._samples, self._wanted = np.zeros((0, 3)), np.zeros(0)
        self._last = np.array([[0.0, 0.0, 25.0]])
        self._heard = self._then = time.monotonic()

    def receive(self, data):
        running = self.state is TargetState.RUNNING
        self._heard = time.monotonic()
        self.c.firmware_receive(data, len(data))
        self._twin.receive(data)
        if self.state is TargetState.RUNNING and not running:
            self._samples, self._wanted = np.zeros((0, 3)), np.zeros(0)
            self._then = time.monotonic()
            self._advance(1)  # so that STATUS knows the position
        return self._out()

    def idle(self):
        now = time.monotonic()
        if self.state is TargetState.RUNNING:
            due = math.floor((now - self._then) / self._period) if self._paced else AT_ONCE
            self._then += due * self._period if self._paced else 0.0
            self._advance(due)
        elif now - self._heard > 1.0:
            self._run(self._last)  # time goes on: the watchdog
        self.busy = self.state is TargetState.RUNNING and not self._paced
        return self._out()

    def _advance(self, count):
        """Let the loop in C see the next samples of the virtual rig."""
        while count > 0 and self.state is TargetState.RUNNING:
            if not len(self._samples):
                block = self._twin.next_samples()
                if block is None:  # it ends by a limit of the virtual rig's own
                    self._run(self._last)
                    return
                self._samples = np.stack([block[name] for name in NAMES], axis=1)
                self._wanted = block["current_setpoint"]
            samples, self._samples = np.split(self._samples, [count])
            wanted, self._wanted = np.split(self._wanted, [count])
            asked = self._run(samples)
            if self.state is not TargetState.TRIPPED:
                self.difference = max(self.difference, float(np.abs(asked - wanted).max()))
            count -= len(samples)

    def _run(self, samples):
        samples, asked = np.ascontiguousarray(samples), np.zeros(len(samples))
        self.c.firmware_run(len(samples), pointer(samples), clock(), pointer(asked))
        self._last = samples[-1:]
        return asked
