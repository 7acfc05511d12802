"""A learned table as exported: with its unit, uncertainty and origin [7.2.4.2, Fig. 49]."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from rigtool.control.lookup_table import LookupTable
from rigtool.numerics.arrays import Array
from rigtool.quantity import Quantity

COULOMB, VISCOUS = "feedforward_coulomb", "feedforward_viscous"
"""Results that state the friction feed-forward with which a table was learned, if there was one."""


@dataclass(frozen=True, eq=False)
class LearnedTable:
    """A learned table with the facts that its user needs.

    `u` has the shape of its torque. `quantity` and `unit` are those of its values; `friction` was
    fed forward while it was learned and is not part of it; `band_hz` is the cut-off of Q, None
    where it is not known, at `band_speed` rad/s, None where at each speed; `origin` are lines about
    rig, program, date and hash. `constant` N m/A is the torque per ampere that the current was made
    with, None where it is not known.
    """

    table: LookupTable
    u: Array
    quantity: str
    unit: str
    friction: Mapping[str, Quantity]
    band_hz: float | None
    band_speed: float | None
    origin: tuple[str, ...]
    constant: float | None = None

    def band_order(self, speed: float) -> int | None:
        """Return the highest order that Q passed in the map at a speed, rad/s; None: not known."""
        if self.band_hz is None:
            return None
        at = speed if self.band_speed is None else self.band_speed
        return int(self.band_hz * 2 * math.pi / abs(at))

    def rule(self) -> list[str]:
        """Return how values between the entries are found, in lines."""
        if self.table.period is None:
            low, high = self.table.position[[0, -1]]
            where = f"Positions outside {low:.6g} to {high:.6g} rad are clamped, speeds too:"
        else:
            where = f"Periodic over {self.table.period:.9g} rad; speeds outside are clamped:"
        return [
            "Interpolation: bilinear over position and speed, zero at rest.",
            f"{where} the table does not extrapolate.",
        ]

    def friction_lines(self) -> list[str]:
        """Return the models to feed forward beside the table, in lines; empty where there are
        none."""
        if not self.friction:
            return []
        coulomb, viscous = (self.friction[name].value for name in (COULOMB, VISCOUS))
        return [
            "Learned beside a feed-forward of friction that is not in it; add, with v in rad/s:",
            f"{coulomb:.6g} N m * tanh(v) + {viscous:.6g} N m s/rad * v",
        ]
