"""A learned table as it leaves the house: with its unit, its uncertainty, and where it is from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rigtool.control.lookup_table import LookupTable
from rigtool.errors import RunFileError
from rigtool.experiments.deploy.quantised_table import Loss
from rigtool.experiments.learning.stored_table import COULOMB, VISCOUS, stored_table_from
from rigtool.quantity import Quantity
from rigtool.runfile import Run

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LearnedTable:
    """A learned table and what its user must be told.

    `u` has the shape of its torque. `quantity` and `unit` are what it holds; `friction` was fed
    forward while it was learned, and is not in it; `band_hz` is the cut-off of Q, None where it is
    not known; `origin` are lines about rig, program, date and hash.
    """

    table: LookupTable
    u: Array
    quantity: str
    unit: str
    friction: Mapping[str, Quantity]
    band_hz: float | None
    origin: tuple[str, ...]

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

    def friction_told(self) -> list[str]:
        """Return what has to be fed forward beside the table, in lines; none where nothing is."""
        if not self.friction:
            return []
        coulomb, viscous = (self.friction[name].value for name in (COULOMB, VISCOUS))
        return [
            "Learned beside a feed-forward of friction that is not in it; add, with v in rad/s:",
            f"{coulomb:.6g} N m * tanh(v) + {viscous:.6g} N m s/rad * v",
        ]


def learned_table_from(run: Run) -> LearnedTable:
    """Return the learned table of a run of ilc-learn; raises `RunFileError` where it has none."""
    table = stored_table_from(run)
    stored = run.table("lookup")
    signal = stored.columns[stored.signal]
    made = run.provenance
    return LearnedTable(
        table=table,
        u=np.asarray(stored["u"], dtype=np.float64),
        quantity=stored.signal,
        unit=signal.unit,
        friction={n: run.results[n] for n in (COULOMB, VISCOUS) if n in run.results},
        band_hz=_band(run),
        origin=(
            f"Rig {run.rig or 'unknown'}; learned on {made['date']}, rigtool {made['version']}.",
            f"File {run.path.name}, content sha256 {run.content_sha256}.",
        ),
    )


def _band(run: Run) -> float | None:
    """Return the cut-off of Q, Hz; a table outlives the recipes that this version reads."""
    try:
        return None if run.recipe is None else run.recipe.ilc_learn.robustness_hz
    except RunFileError:
        return None


def told_loss(lost: Loss, unit: str, by: str) -> str:
    """Say what was lost by what, in the unit of the table."""
    return f"by {by}, largest {lost.largest:.2g} {unit}, rms {lost.rms:.2g} {unit}"
