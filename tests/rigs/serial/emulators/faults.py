"""Faults of a line, on demand.

A `Fault` acts on the bytes that the device sends or gets. Numbers of writes count from 0, those of
the device, or with `towards="device"` those of the host.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from rigtool.rigs.serial.emulators import server
from rigtool.rigs.serial.emulators.server import Emulator, Pulled

FaultKind = Literal["flip", "lose", "double", "cut", "silence", "late", "pull", "reset", "refuse"]


@dataclass(frozen=True)
class Fault:
    """A fault of the line or the device.

    flip, lose, double: bits or bytes, each byte with this `probability`, or one of write number
        `at`: number `byte` of it (of a short write counted on from its start), or the middle one.
    cut: of write `at` only the first half arrives.
    silence: from write `at`, for `duration` s, nothing arrives.
    late: write `at` arrives together with, and before, the next one.
    pull, reset, refuse: at write `at` the cable is pulled; the device restarts; it refuses the
        next `count` requests.
    """

    kind: FaultKind
    at: int = 0
    probability: float = 0.0
    duration: float = float("inf")
    count: int = 1
    byte: int | None = None
    towards: Literal["host", "device"] = "host"
    seed: int = 1


class Faults:
    """Applies faults to the writes in one direction."""

    def __init__(
        self, faults: tuple[Fault, ...], towards: str, act: Callable[[Fault], None]
    ) -> None:
        self._faults = [fault for fault in faults if fault.towards == towards]
        self._act = act
        self._random = [np.random.default_rng(fault.seed) for fault in self._faults]
        self._write = 0
        self._since: dict[int, float] = {}
        self._held = b""

    def apply(self, data: bytes) -> bytes:
        """Return the bytes of a write that arrive; raises `Pulled` once the cable is pulled."""
        if not data:
            return data
        number, self._write = self._write, self._write + 1
        data, held, self._held = data, self._held, b""
        for index, fault in enumerate(self._faults):
            if fault.kind in ("flip", "lose", "double"):
                data = self._disturb(data, fault, self._random[index], number)
            elif fault.kind == "silence":
                data = self._silence(data, index, fault, number)
            elif number == fault.at:
                data = self._once(data, fault)
        return held + data

    def _once(self, data: bytes, fault: Fault) -> bytes:
        if fault.kind == "cut":
            return data[: len(data) // 2]
        if fault.kind == "late":
            self._held = data
            return b""
        if fault.kind == "pull":
            raise Pulled
        self._act(fault)
        return b"" if fault.kind == "reset" else data

    def _silence(self, data: bytes, index: int, fault: Fault, number: int) -> bytes:
        if number < fault.at:
            return data
        since = self._since.setdefault(index, time.monotonic())
        return b"" if time.monotonic() - since < fault.duration else data

    def _disturb(
        self, data: bytes, fault: Fault, random: np.random.Generator, number: int
    ) -> bytes:
        if fault.probability > 0:
            hit = np.flatnonzero(random.random(len(data)) < fault.probability)
        elif number == fault.at and data:
            hit = np.array([len(data) // 2 if fault.byte is None else fault.byte % len(data)])
        else:
            return data
        if hit.size == 0:
            return data
        values = np.frombuffer(data, np.uint8).copy()
        if fault.kind == "flip":
            values[hit] ^= (1 << random.integers(0, 8, hit.size)).astype(np.uint8)
            return values.tobytes()
        if fault.kind == "lose":
            return np.delete(values, hit).tobytes()
        return np.insert(values, hit, values[hit]).tobytes()


class Disturbed(Emulator):
    """A device behind a line with faults."""

    def __init__(self, device, faults):
        self._device = device
        self._out = Faults(faults, "host", self._act)
        self._in = Faults(faults, "device", self._act)

    def __getattr__(self, name):
        return getattr(self._device, name)

    @property
    def busy(self):
        return self._device.busy

    def receive(self, data):
        return self._out.apply(self._device.receive(self._in.apply(data)))

    def idle(self):
        return self._out.apply(self._device.idle())

    def _act(self, fault):
        if fault.kind == "reset":
            self._device.reset()
        elif fault.kind == "refuse":
            self._device.refuse(fault.count)


@contextlib.contextmanager
def serve(device, *faults, tcp=False):
    """Serve a device, with faults of its line, while the `with` block runs."""
    with server.serve(Disturbed(device, faults) if faults else device, tcp=tcp) as running:
        yield running


def inject(running, *faults):
    """Let the line of a running server have these faults from now on, and no others."""
    device = vars(running.emulator).get("_device", running.emulator)
    running.emulator = Disturbed(device, faults)
