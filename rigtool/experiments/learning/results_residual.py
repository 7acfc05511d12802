"""Results of `ilc-learn` on the remaining disturbance with the table on [Fig. 56]."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rigtool.experiments.learning.rows import Row, residual
from rigtool.numerics.arrays import Array
from rigtool.quantity import Quantity
from rigtool.runfile import Column, Table, dof_column


@dataclass(frozen=True, eq=False)
class Remaining:
    """Controller torque without (`before`) and with the table (`after`), rows of equal speeds.

    `position` (n,) rad is the part of the angle that counts; `applied` (rows, n) N m is the table's
    torque as it was recorded. Rows are in the order of rising speed.
    """

    position: Array
    before: Sequence[Row]
    after: Sequence[Row]
    applied: Array

    def results(self) -> dict[str, Quantity]:
        """Return peak, rms and reduction over all speeds and both directions."""
        return residual(self.before, self.after)

    def tables(self) -> dict[str, Table]:
        """Return numbers by speed, and the waveforms behind them."""
        speed = Column([row.speed for row in self.after], "rad/s", "of the motor shaft")
        return {
            "residual_by_speed": Table(
                ("speed",),
                {
                    "speed": speed,
                    **self._numbers(),
                    "dof": dof_column([row.dof for row in self.after]),
                },
                "residual_peak",
                "controller torque before and after learning, mean of the moves, within the band "
                "of Q, ends of the angle left out",
            ),
            "residual_waveforms": Table(
                ("speed", "position"),
                {
                    "speed": speed,
                    "position": Column(self.position, "rad", "set point of the motor shaft"),
                    "before": Column(
                        [row.mean for row in self.before], "N m", "controller, no table"
                    ),
                    "table": Column(self.applied, "N m", "torque added by the table"),
                    "residual": Column(
                        [row.mean for row in self.after], "N m", "controller, with table"
                    ),
                },
                "residual",
                "torque by position, mean of the moves, within the band of Q",
            ),
        }

    def _numbers(self) -> dict[str, Column]:
        peaks = [int(np.argmax(np.abs(row.mean))) for row in self.after]
        numbers = {
            "before_peak": [np.abs(row.mean).max() for row in self.before],
            "residual_peak": [np.abs(row.mean).max() for row in self.after],
            "residual_peak_u": [row.u[i] for row, i in zip(self.after, peaks, strict=True)],
            "before_rms": [np.sqrt(np.mean(row.mean**2)) for row in self.before],
            "residual_rms": [np.sqrt(np.mean(row.mean**2)) for row in self.after],
            "non_repeatable_rms": [row.non_repeatable_rms for row in self.after],
        }
        described = {
            "residual_peak_u": "standard uncertainty of the mean at the peak",
            "non_repeatable_rms": "scatter of a single move: no table can remove it",
        }
        return {
            name: Column(values, "N m", described.get(name, "")) for name, values in numbers.items()
        }

    def notes(self, expected: Array, tolerance: float = 1e-3) -> tuple[str, ...]:
        """Report moves that were made with another table than the one in the results.

        `expected` (rows, n) N m is what that table adds, as it would be recorded. `tolerance` is
        relative to the largest torque: a recorded current is a 4-byte number.
        """
        difference = float(np.abs(expected - self.applied).max())
        if difference <= tolerance * float(np.abs(self.applied).max()):
            return ()
        return (
            f"the table that was switched on while recording differs from this one by up to "
            f"{difference * 1e3:.2g} mN m: the residual belongs to the recorded one",
        )
