"""moteus on a CAN bus: the frames of the fdcanusb, as they are; docs/bench-moteus.md."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from rigtool.errors import RecipeError
from rigtool.recipe import Recipe
from rigtool.rigs.serial.drivers import Driver
from rigtool.rigs.serial.line import Line
from rigtool.rigs.serial.moteus import frames
from rigtool.rigs.serial.moteus.drive import Moteus
from rigtool.rigs.serial.moteus.driver import USUAL_NODE, first_answer
from rigtool.rigs.serial.moteus.link import Link
from rigtool.rigs.serial.moteus.table import MoteusTable
from rigtool.rigs.serial.transport.can_frames import CanFrame, encode

T = TypeVar("T")

LONGEST_SHORT = 0x7FF
"""Largest identifier of 11 bit."""


class CanLink(Link):
    """A drive on a bus for CAN FD: no checksums, no acknowledges."""

    @property
    def wire(self) -> str:
        """What is at the other end of the line, for the operator."""
        return "CAN FD"

    def find_seal(self, question: bytes) -> None:
        """Nothing: frames have a CRC of the bus."""

    def _request(self, frame: bytes, *, reply: bool) -> tuple[bytes, int]:
        identifier, source = self._address(reply=reply)
        extended = identifier > LONGEST_SHORT
        return encode(CanFrame(identifier, frames.padded(frame), extended, fd=True)), source

    def _exchange(
        self,
        frame: bytes,
        understand: Callable[[bytes], T] | None = None,
        *,
        retries: int | None = None,
    ) -> T:
        if understand is not None:
            return super()._exchange(frame, understand, retries=retries)
        self.line.write(self._request(frame, reply=False)[0])
        return None  # type: ignore[return-value]

    def _received(self) -> tuple[int, bytes]:
        frame = self.line.read_frame()
        return frame.identifier, frame.data


def probe(line: Line) -> str | None:
    """Return the identity of the moteus that answers, None for another device."""
    return first_answer(line, CanLink) if _takes_fd(line) else None


def make_drive(line: Line, recipe: Recipe) -> Moteus:
    """Return the drive that a recipe's [serial] names; `RecipeError` for a bus without CAN FD."""
    if not _takes_fd(line):
        raise RecipeError(
            f"{line.port}: moteus speaks CAN FD alone: take an adapter that does, and add "
            "?fd=true to the port"
        )
    return Moteus(CanLink(line, recipe.line.node or USUAL_NODE))


def _takes_fd(line: Line) -> bool:
    return line.replays or "fd=true" in line.port.lower()


DRIVER = Driver(probe, (1_000_000,), make_drive, table_store=MoteusTable, can=True)
