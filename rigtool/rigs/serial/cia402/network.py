"""CANopen on a `Line`, by the library canopen: objects by SDO, NMT, PDOs and heartbeat.

No thread reads the bus: frames are taken in while an answer is awaited. So a record of the line
plays back, and the heartbeat that keeps a drive on ends where the loop hangs.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

from rigtool.errors import RecipeError, UsageError
from rigtool.rigs.serial.cia402.objects import Entry, refusal
from rigtool.rigs.serial.line import DamagedReply, Line
from rigtool.rigs.serial.transport.can_frames import CanFrame, encode

try:
    import canopen
except ImportError:
    raise UsageError(
        "drives of CiA 402 need the package canopen, that is not installed: pip install "
        "rigtool[can]"
    ) from None

T = TypeVar("T")

HOST_NODE = 0x7F
"""Node address from which the host sends its heartbeat."""

HEARTBEAT = encode(CanFrame(0x700 + HOST_NODE, b"\x05"))
SYNC = encode(CanFrame(0x080))

RECEIVE, TRANSMIT = 0x1400, 0x1800
"""First records of the PDOs that a drive receives, and that it transmits."""
AT_ONCE, ON_SYNC = 255, 1
"""Types of transmission."""
INVALID, NO_RTR = 1 << 31, 1 << 30
PDO_BITS = 64

BOOT_TIME = 5.0
"""Longest time in which a node is back after a reset of its communication, s."""


class _Network(canopen.Network):
    """canopen's network, on a line; `alive` sends a heartbeat before each message."""

    def __init__(self, line: Line) -> None:
        super().__init__()
        self.line, self.alive = line, False

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        frame = encode(CanFrame(can_id, bytes(data), remote=remote))
        self.line.write(HEARTBEAT + frame if self.alive else frame)

    def take_in(self, timeout: float | None = None) -> CanFrame:
        """Hand the next frame to canopen, and return it; see `Line.read_frame` for errors."""
        frame = self.line.read_frame(timeout)
        try:
            self.notify(frame.identifier, bytearray(frame.data), 0.0)
        except struct.error:
            raise DamagedReply(f"{self.line.port}: {frame}: is too short") from None
        return frame


class _Sdo(canopen.sdo.SdoClient):
    network: _Network

    def read_response(self) -> bytes:
        while self.responses.empty():
            self.network.take_in()
        return super().read_response()


class _Node(canopen.RemoteNode):
    def add_sdo(self, rx_cobid: int, tx_cobid: int) -> _Sdo:
        client = _Sdo(rx_cobid, tx_cobid, self.object_dictionary)
        self.sdo_channels.append(client)
        return client


@dataclass(frozen=True)
class Pdo:
    """A PDO of a drive: record `index` of its settings, its identifier and type, what it carries.

    `identifier` has the bits of 1400:01; `entries` are as in 1600: index, sub-index and bits.
    """

    index: int
    identifier: int
    kind: int
    entries: tuple[int, ...]


class CanObjects:
    """The objects of a node on a CAN bus, see `objects.Objects`, and what else CANopen has.

    `eds` is the maker's file that describes the objects; without one, objects are read by the types
    that rigtool knows. Raises `RecipeError` for a file that is not an EDS.
    """

    def __init__(self, line: Line, node: int, eds: str | None = None) -> None:
        try:
            dictionary = canopen.import_od(eds, node) if eds else canopen.ObjectDictionary()
        except Exception as error:  # canopen raises whatever its parsers do
            raise RecipeError(f"serial.eds {eds}: cannot be read as an EDS: {error}") from None
        self.line, self.node = line, node
        self._network = _Network(line)
        self._node = _Node(node, dictionary)
        self._network.add_node(self._node)

    # -- objects

    def read(self, entry: Entry, retries: int | None = None) -> int:
        """Return a value; `RequestRefused` where the drive answers with an error."""
        sdo = self._node.sdo
        data = self._ask(entry, "read", lambda: sdo.upload(entry.index, entry.sub), retries)
        return int.from_bytes(data[: self.size(entry)], "little", signed=entry.kind.islower())

    def write(self, entry: Entry, value: int) -> None:
        """Set a value; repeating it does no harm."""
        sdo, data = self._node.sdo, entry.pack(value)
        fill = b"\xff" if value < 0 else b"\0"
        data = data[: entry.size].ljust(8, fill)[: self.size(entry)]
        self._ask(entry, f"set to {value}", lambda: sdo.download(entry.index, entry.sub, data))

    def size(self, entry: Entry) -> int:
        """Return the bytes of a value: by the EDS, where that has the object."""
        known = self._node.object_dictionary.get_variable(entry.index, entry.sub)
        return len(known) // 8 if known is not None and known.fixed_size else entry.size

    def _ask(self, entry: Entry, what: str, act: Callable[[], T], retries: int | None = None) -> T:
        def asked() -> T:
            try:
                return act()
            except canopen.SdoAbortedError as error:
                raise refusal(self.line.port, error.code, entry, what) from None
            except (canopen.SdoCommunicationError, struct.error) as error:
                raise DamagedReply(f"{self.line.port}: {error}") from None

        return self.line.exchange(b"", asked, retries=retries)

    # -- network

    @property
    def alive(self) -> bool:
        """Whether each message is preceded by the host's heartbeat."""
        return self._network.alive

    @alive.setter
    def alive(self, alive: bool) -> None:
        self._network.alive = alive

    def change_state(self, state: str) -> None:
        """Send the node into a state of NMT, by its name in canopen."""
        self._node.nmt.state = state

    def reset_communication(self) -> None:
        """Restart the communication of the node; raises `LineTimeout` where it is not back."""
        self.change_state("RESET COMMUNICATION")
        with self.line.within(BOOT_TIME):
            while self._network.take_in(BOOT_TIME).identifier != 0x700 + self.node:
                pass

    # -- PDOs

    def pack(self, entries: Sequence[Entry]) -> tuple[int, ...]:
        """Return entries as a PDO carries them."""
        return tuple(entry.index << 16 | entry.sub << 8 | 8 * self.size(entry) for entry in entries)

    def read_pdo(self, index: int) -> Pdo:
        """Return the settings of a PDO."""
        count = self.read(_count(index))
        return Pdo(
            index,
            self.read(Entry(index, 1, "I", "identifier of a PDO")),
            self.read(Entry(index, 2, "B", "type of a PDO")),
            tuple(self.read(_mapped(index, n)) for n in range(1, count + 1)),
        )

    def write_pdo(self, pdo: Pdo) -> None:
        """Set a PDO up; it is invalid meanwhile."""
        identifier = Entry(pdo.index, 1, "I", "identifier of a PDO")
        before = self.read(identifier)
        self.write(identifier, before | INVALID)
        self.write(Entry(pdo.index, 2, "B", "type of a PDO"), pdo.kind)
        self.write(_count(pdo.index), 0)
        for n, entry in enumerate(pdo.entries, start=1):
            self.write(_mapped(pdo.index, n), entry)
        self.write(_count(pdo.index), len(pdo.entries))
        self.write(identifier, pdo.identifier)

    def map(self, first: int, number: int, kind: int, entries: Sequence[Entry]) -> int:
        """Let PDO `number`, from 0, carry these entries; return its identifier."""
        base = 0x180 if first == TRANSMIT else 0x200
        pdo = self.read_pdo(first + number)
        identifier = base + 0x100 * number + self.node
        valid = identifier | pdo.identifier & NO_RTR
        self.write_pdo(replace(pdo, identifier=valid, kind=kind, entries=self.pack(entries)))
        return identifier

    def sample(
        self, request: bytes, wanted: Mapping[int, Sequence[Entry]]
    ) -> tuple[dict[Entry, int], float, float]:
        """Send frames and a SYNC; return the values of the PDOs that answer, and its times, s.

        `wanted` has their identifiers. Raises `LineLost` where they do not come.
        """
        alive = HEARTBEAT if self.alive else b""

        def receive() -> tuple[dict[Entry, int], float, float]:
            asked, missing = self.line.now(), dict(wanted)
            values: dict[Entry, int] = {}
            while missing:
                frame = self._network.take_in()
                if (entries := missing.pop(frame.identifier, None)) is not None:
                    values |= self._unpack(entries, frame.data)
            return values, asked, self.line.now()

        return self.line.exchange(alive + request + SYNC, receive)

    def _unpack(self, entries: Sequence[Entry], data: bytes) -> dict[Entry, int]:
        values, at = {}, 0
        for entry in entries:
            part = data[at : (at := at + self.size(entry))]
            values[entry] = int.from_bytes(part, "little", signed=entry.kind.islower())
        if at != len(data):
            raise DamagedReply(f"{self.line.port}: a PDO has {len(data)} bytes, not {at}")
        return values

    def frame(self, identifier: int, values: Mapping[Entry, int]) -> bytes:
        """Return the frame of a PDO that the drive receives; `HardwareError` for too large ones."""
        data = b"".join(
            entry.pack(value)[: entry.size].ljust(self.size(entry), b"\0")
            for entry, value in values.items()
        )
        return encode(CanFrame(identifier, data))


def spread(objects: CanObjects, entries: Sequence[Entry]) -> list[list[Entry]]:
    """Return entries by the PDO that carries them, in their order."""
    pdos: list[list[Entry]] = [[]]
    for entry in entries:
        bits = sum(8 * objects.size(other) for other in [*pdos[-1], entry])
        if bits > PDO_BITS:
            pdos.append([])
        pdos[-1].append(entry)
    return pdos


def _count(index: int) -> Entry:
    return Entry(index + 0x200, 0, "B", "number of objects in a PDO")


def _mapped(index: int, number: int) -> Entry:
    return Entry(index + 0x200, number, "I", "object in a PDO")
