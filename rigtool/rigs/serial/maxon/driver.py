"""maxon drives on a serial line: EPOS4, EPOS2 and DES 70/10; docs/bench-maxon.md.

The kind is found by asking: the single byte that is an op code for drives in lock-step means
nothing to an EPOS4. All of them are driven by current and by speed; none has a watchdog on this
line, so a process beside this one watches over it (`guard_process`).
"""

from __future__ import annotations

from rigtool.errors import HardwareError
from rigtool.recipe import Recipe
from rigtool.rigs.serial.cia402.objects import DEVICE_TYPE
from rigtool.rigs.serial.cia402.states import identity
from rigtool.rigs.serial.drive import Drive
from rigtool.rigs.serial.drivers import Driver
from rigtool.rigs.serial.line import DamagedReply, Line, LineLost, LineTimeout
from rigtool.rigs.serial.maxon.des import DesDrive, read_status
from rigtool.rigs.serial.maxon.epos import Epos2Drive, Epos4Drive, EposDrive
from rigtool.rigs.serial.maxon.frames import (
    FAILED,
    FRAME_TIMEOUT,
    OKAY,
    TIMEOUT_RATIO,
    DleFrames,
    LockStepFrames,
)
from rigtool.rigs.serial.maxon.guard import make_guard
from rigtool.rigs.serial.maxon.objects import EPOS2_ACCESS, EPOS4_ACCESS, EposObjects

BAUD_RATES = (115200, 38400)
"""Of an EPOS and of a DES, as they are delivered, bit/s."""

FACTORY_NODE = 1
"""Address that an EPOS is delivered with; `serial.node` = 0 means this one."""


def probe(line: Line) -> str | None:
    """Return the identity of the maxon drive that answers, None for another device."""
    found = _find(line, FACTORY_NODE)
    if found is None:
        return None
    if isinstance(found, EposObjects):
        family = "EPOS4" if isinstance(found.frames, DleFrames) else "EPOS2"
        return identity(found, f"maxon {family}")
    return "maxon DES"


def make_drive(line: Line, recipe: Recipe) -> Drive:
    """Return the driver of the device on a line; raises `HardwareError` where nothing does.

    Raises `RecipeError` for a recipe without an emergency stop.
    """
    settings, node = recipe.line, recipe.line.node or FACTORY_NODE
    guard = make_guard(line, settings, node, "maxon drives have", "maxon", BAUD_RATES[0])
    drive = drive_on(line, node, recipe.rig.encoder_counts)
    drive.guard = guard
    return drive


def drive_on(line: Line, node: int, encoder_counts: int) -> DesDrive | EposDrive:
    """Return the driver of the device on a line; raises `HardwareError` where nothing does."""
    found, counts = _find(line, node), encoder_counts
    if found is None:
        raise HardwareError(
            f"{line.port}: no maxon drive answers: check power and cable; an EPOS talks at 115200 "
            "bit/s, a DES at 38400: set serial.baud_rate"
        )
    if not isinstance(found, EposObjects):
        return DesDrive(found, counts)
    if isinstance(found.frames, DleFrames):
        return Epos4Drive(found, counts)
    return Epos2Drive(found, counts)


def _find(line: Line, node: int) -> EposObjects | LockStepFrames | None:
    """Ask twice for the device: an earlier question may have left an incomplete frame."""
    for attempt in range(2):
        if attempt:
            line.pause(TIMEOUT_RATIO * FRAME_TIMEOUT)
        line.settle()
        line.write(bytes([EPOS2_ACCESS.read]))
        try:
            ready = line.read_exactly(1)
        except LineTimeout:
            ready = b""
        try:
            found = _introduced(line, ready, node)
        except (LineLost, LineTimeout, DamagedReply):
            continue
        if found is not None:
            return found
    return None


def _introduced(line: Line, ready: bytes, node: int) -> EposObjects | LockStepFrames | None:
    """Return the drive that answered the op code of an EPOS2, once it has answered a whole
    question."""
    frames = LockStepFrames(line, FRAME_TIMEOUT)
    if ready == FAILED:  # it knows acknowledges, and no objects
        read_status(frames)
        return frames
    if ready == OKAY:
        objects = EposObjects(frames, EPOS2_ACCESS, node)
        frames.complete(EPOS2_ACCESS.read, EPOS2_ACCESS.address(node, DEVICE_TYPE), 8)
        return objects
    objects = EposObjects(DleFrames(line), EPOS4_ACCESS, node)
    objects.read(DEVICE_TYPE, retries=0)
    return objects


def switch_off(line: Line, node: int) -> None:
    """Switch the device on a line off."""
    drive_on(line, node, encoder_counts=4).halt()


DRIVER = Driver(probe, BAUD_RATES, make_drive, has_watchdog=False, switch_off=switch_off)
