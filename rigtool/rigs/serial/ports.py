"""The serial ports of this computer, and the devices that answer on them."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from rigtool.errors import HardwareError
from rigtool.rigs.serial.drivers import driver, driver_names
from rigtool.rigs.serial.instruments import BY_CHARACTER, instrument_module
from rigtool.rigs.serial.instruments import INSTRUMENT_MODULES as INSTRUMENTS
from rigtool.rigs.serial.line import Line
from rigtool.rigs.serial.transport.opening import CAN_PREFIX, VISA_PREFIX

PROBE_TIME = 0.15
"""Longest wait for an answer to a question that only one kind of device understands, s."""


@dataclass(frozen=True)
class Device:
    """A port and its device: `driver` and `identity` are empty where nothing answers.

    `problem` is the reason why a port could not be asked.
    """

    port: str
    description: str
    driver: str = ""
    identity: str = ""
    problem: str = ""


def list_ports() -> list[tuple[str, str]]:
    """Return the serial ports of this computer, each with the system's description."""
    from serial.tools import list_ports

    return sorted((item.device, item.description or "") for item in list_ports.comports())


def askable() -> list[str]:
    """Return the names of the drivers and instruments that can be probed."""
    return [*driver_names(), *INSTRUMENTS]


def find_devices(ports: Sequence[str] = (), drivers: Sequence[str] = ()) -> Iterator[Device]:
    """Probe these ports, or all of this computer, for the devices of these drivers.

    Only drives of a CAN bus are asked on one, and only SCPI on a port of VISA. Probing only reads:
    nothing moves and nothing is changed. Instruments that take each character
    for a command are probed only where they are named, and alone.
    """
    described = dict(list_ports())
    drivers = drivers or [name for name in askable() if name not in BY_CHARACTER]
    for port in ports or described:
        yield _ask_on(port, described.get(port, ""), drivers)


def _ask_on(port: str, description: str, drivers: Sequence[str]) -> Device:
    for name in drivers:
        probe, baud_rates, can = _how_to_ask(name)
        if can != port.startswith(CAN_PREFIX) or (port.startswith(VISA_PREFIX) and name != "scpi"):
            continue
        for baud_rate in baud_rates:
            try:
                with Line(port, baud_rate, timeout=PROBE_TIME, retries=0) as line:
                    line.settle()
                    identity = probe(line)
            except HardwareError as error:
                if "cannot be opened" in str(error):
                    return Device(port, description, problem=str(error).removeprefix(f"{port}: "))
                time.sleep(PROBE_TIME / 5)  # for late answers to the last question
                continue
            if identity:
                return Device(port, description, name, identity)
    return Device(port, description)


def _how_to_ask(name: str) -> tuple[Callable[[Line], str | None], tuple[int, ...], bool]:
    """Return the probe of a drive or an instrument, the baud rates to try, and whether on CAN."""
    if name in INSTRUMENTS:
        module = instrument_module(name)
        return module.probe, (module.BAUD_RATE,), False
    found = driver(name)
    return found.probe, found.baud_rates, found.can
