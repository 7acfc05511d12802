"""The `TableStore` protocol: a drive that keeps a table of the turn and adds it by itself."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class DriveTable:
    """Codes (size,) of a table in a drive, at equal steps of its encoder; current = code*scale."""

    codes: NDArray[np.int64]
    scale: float


@dataclass(frozen=True)
class EncoderZero:
    """Angle by which a drive reads its table: sign*position + offset, rad, offset with its u."""

    sign: int
    offset: float
    u: float


class TableStore(Protocol):
    """A drive behind a `Line` that stores a table; each method may raise `HardwareError`.

    `scale_step` [A] is the resolution with which the drive reports its scale: a stored table can be
    compared exactly.
    """

    size: int
    largest_code: int
    scale_step: float

    def connect(self) -> str:
        """Identify the drive as it does for motions; nothing changes."""

    def zero(self) -> EncoderZero:
        """Measure the relation between the table's angle and the position, at standstill."""

    def read(self) -> DriveTable:
        """Return the table that the drive uses."""

    def store(self, table: DriveTable, before: DriveTable) -> None:
        """Store a table permanently and compare; on any failure restore `before`."""
