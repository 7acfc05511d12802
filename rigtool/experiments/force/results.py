"""Loads of `measure-force` with their uncertainty: Tables 8 and 9, and the unloaded cycles."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from rigtool.experiments.force.cycles import (
    Cycle,
    LoadStatistics,
    curves,
    normality,
    statistics,
    up_and_down,
)
from rigtool.experiments.force_model.records import Record
from rigtool.experiments.outcome import Outcome
from rigtool.numerics.arrays import Array
from rigtool.quantity import Quantity
from rigtool.recipe import Recipe
from rigtool.runfile import Column, Table

GRID_COUNTS = 10
"""Distance between the points of stored curves, quad counts."""

ZERO_AGAIN = "zero_again"
"""Recording without load after all loads (correction full): zero is known before and after."""

SIGNIFICANCE = 0.05
"""Shapiro-Wilk probability below which readings are reported as not normally distributed."""


@dataclass(frozen=True, eq=False)
class Reading:
    """One recording, filtered: signals (n,), its cycles, and the torque read in each (cycles,).

    `position` in quad counts of the motor; `torque` at the output and `feedforward` (of the learned
    table) at the motor, N m. `method_u` N m is the standard uncertainty at the output by the errors
    that the method adds to a reading. `whole` holds the same cycles laid over each other,
    where loads are read from whole strokes.
    """

    name: str
    force: float
    asked_cycles: int
    position: Array
    torque: Array
    feedforward: Array
    cycles: list[Cycle]
    values: Array
    method_u: float = 0.0
    whole: Record | None = None

    def strokes(self, signal: Array, grid: Array) -> tuple[Array, Array]:
        """Return a signal over position of the rising and of the falling strokes."""
        return curves(self.position, signal, self.cycles, grid)


@dataclass(frozen=True)
class LoadRow:
    """One load of Table 8 or 9, as `COLUMNS` describes its numbers; NaN where there is no value."""

    applied_force: float
    applied_torque: float
    mean_torque: float
    mean_torque_u: float
    mean_torque_dof: float
    std_torque: float
    std_torque_u: float
    error_torque: float
    error_percent: float
    cycles: float
    effective_cycles: float

    def blank(self) -> LoadRow:
        """Return the row without what was measured."""
        measured = (f.name for f in fields(self) if not f.name.startswith("applied_"))
        return replace(self, **dict.fromkeys(measured, math.nan))


COLUMNS = {
    "applied_force": ("N", ""),
    "applied_torque": ("N m", "at the angle of the reading"),
    "mean_torque": ("N m", "at the output"),
    "mean_torque_u": (
        "N m",
        "standard uncertainty: scatter, torque constant, zero reading or learned table, method",
    ),
    "mean_torque_dof": ("1", "effective degrees of freedom of mean_torque_u"),
    "std_torque": ("N m", "S of single readings"),
    "std_torque_u": ("N m", ""),
    "error_torque": ("N m", "mean - applied"),
    "error_percent": ("%", "of the applied torque"),
    "cycles": ("1", "readings"),
    "effective_cycles": ("1", "independent readings among them"),
}
"""Unit and description of each number of a load."""


def applied_torque(recipe: Recipe, force: float, angle: float | Array) -> Array:
    """Return the torque that a force takes at an output angle, N m, in the order of `angle`.

    At the grasper force * length * sin(angle) [8.1], on the pulley force * radius.
    """
    sine = np.sin(angle) if recipe.rig.attachment == "instrument" else np.ones_like(angle)
    return force * recipe.rig.load_arm * sine


def stroke_grid(recipe: Recipe) -> Array:
    """Return positions over one stroke, quad counts of the motor."""
    rig = recipe.rig
    span = recipe.measure_force.angle / 360 * rig.encoder_counts * rig.angle_ratio
    return np.linspace(0, span, max(2, round(span / GRID_COUNTS) + 1))


def load_rows(
    loads: Sequence[Reading], recipe: Recipe, constant: Quantity, table_u: float
) -> list[LoadRow]:
    """Return Table 8 or 9, load by load, from readings at one angle of the rising strokes.

    `loads` begin with the one without force; `constant` is the torque constant at one rotor angle
    and `table_u` the standard uncertainty of the learned table where torque is read, N m.
    """
    angle = math.radians(recipe.measure_force.measure_angle)
    unloaded = statistics(loads[0].values, 0.0)
    zero = unloaded.mean if recipe.measure_force.zero else 0.0
    # The zero reading contains the error of the table, too, and removes it; its own uncertainty
    # takes the place of the table's.
    zero_u = math.hypot(unloaded.u, loads[0].method_u) / recipe.rig.torque_factor
    offset_u = zero_u if recipe.measure_force.zero else table_u
    rows = []
    for load in loads:
        if load is loads[0]:
            found, own_u = unloaded, table_u
        else:
            applied = float(applied_torque(recipe, load.force, angle))
            found, own_u = statistics(load.values - zero, applied), offset_u
        mean = _mean_quantity(found, recipe, constant, own_u, load.method_u)
        rows.append(
            LoadRow(
                applied_force=load.force,
                applied_torque=found.mean - found.error,
                mean_torque=mean.value,
                mean_torque_u=mean.u or 0.0,
                mean_torque_dof=math.nan if mean.dof is None else mean.dof,
                std_torque=found.std,
                # S / sqrt(2 (n - 1)) for normal readings (GUM E.4.3)
                std_torque_u=found.std / math.sqrt(2 * (found.count - 1)),
                error_torque=found.error,
                error_percent=found.error_percent,
                cycles=found.count,
                effective_cycles=found.effective_count,
            )
        )
    return rows


def loads_outcome(loads: Sequence[Reading], rows: Sequence[LoadRow], recipe: Recipe) -> Outcome:
    """Return Table 8 or 9 and the figures of the unloaded cycles, from readings and their rows."""
    unloaded, judged = rows[0], normality(loads[0].values)
    mean_dof = None if math.isnan(unloaded.mean_torque_dof) else unloaded.mean_torque_dof
    results = {
        "std_torque_no_load": Quantity(
            unloaded.std_torque, "N m", unloaded.std_torque_u, float(unloaded.cycles - 1)
        ),
        "mean_torque_no_load": Quantity(
            unloaded.mean_torque, "N m", unloaded.mean_torque_u, mean_dof
        ),
        "normality_p": Quantity(judged.p, "1", reason="a probability is not measured"),
    }
    probability = Table(
        axes=("quantile",),
        columns={
            "quantile": Column(judged.quantile, "1", "of the standard normal distribution"),
            "value": Column(judged.ordered, "N m", "readings without load, sorted"),
            "probability": Column(judged.probability, "1", "order statistic median (Filliben)"),
        },
        signal="value",
        description="normal probability plot of the readings without load",
    )
    tables = {
        "loads": loads_table(
            rows, COLUMNS, "torque read from current while rising, by load; the first has none"
        ),
        "values": _values_table(loads),
        "probability_plot": probability,
        **_curve_tables(loads, recipe),
    }
    return Outcome(results, tables, tuple(_load_notes(loads, rows, judged.p)))


def loads_table(
    rows: Sequence[LoadRow], columns: Mapping[str, tuple[str, str]], description: str
) -> Table:
    """Return the table of loads; `columns` are the numbers of a row by unit and description."""
    return Table(
        axes=("load",),
        columns={
            "load": Column(np.arange(len(rows)), "1", "in the order of measurement"),
            **{
                name: Column(np.array([getattr(row, name) for row in rows]), unit, about)
                for name, (unit, about) in columns.items()
            },
        },
        signal="mean_torque",
        description=description,
    )


def _mean_quantity(
    row: LoadStatistics, recipe: Recipe, constant: Quantity, offset_u: float, method_u: float
) -> Quantity:
    """Return the mean torque with its whole uncertainty; `constant` is that at one rotor angle.

    torque = factor * (Kt * current + offset) + method (GUM 5.1.2, by GTC). The offset is zero;
    `offset_u`, N m at the motor, is how well that is known: from the zero reading, or from the
    learned table. `method_u` is that of `Reading`.
    """
    from GTC import dof, uncertainty, ureal

    factor = recipe.rig.torque_factor
    scale = factor * constant.value
    current = ureal(row.mean / scale, row.u / scale, row.dof)
    kt = ureal(constant.value, constant.u or 0.0, constant.dof or math.inf)
    torque = factor * (kt * current + ureal(0.0, offset_u)) + ureal(0.0, method_u)
    degrees = float(dof(torque))
    return Quantity(
        row.mean, "N m", float(uncertainty(torque)), degrees if math.isfinite(degrees) else None
    )


def _values_table(loads: Sequence[Reading]) -> Table:
    values = np.full((len(loads), max(load.values.size for load in loads)), math.nan)
    for row, load in zip(values, loads, strict=True):
        row[: load.values.size] = load.values
    return Table(
        axes=("load", "cycle"),
        columns={
            "load": Column(np.arange(len(loads)), "1"),
            "cycle": Column(np.arange(values.shape[1]), "1"),
            "torque": Column(values, "N m", "zero not taken off; NaN where there is none"),
        },
        signal="torque",
        description="readings at the output, one each rising stroke, by load and cycle",
    )


def _curve_tables(loads: Sequence[Reading], recipe: Recipe) -> dict[str, Table]:
    grid = stroke_grid(recipe)
    position = Column(
        up_and_down(grid, 2 * grid[-1] - grid), "count", "of the motor, up and then down again"
    )
    whole = [up_and_down(*load.strokes(load.torque, grid)) for load in loads]
    unloaded = loads[0]
    fed = up_and_down(*unloaded.strokes(unloaded.feedforward, grid))
    return {
        "cycles_no_load": Table(
            axes=("cycle", "position"),
            columns={
                "cycle": Column(np.arange(len(whole[0])), "1"),
                "position": position,
                "torque": Column(whole[0], "N m", "at the output"),
            },
            signal="torque",
            description="what remains without load, cycle by cycle",
        ),
        "mean_cycles": Table(
            axes=("load", "position"),
            columns={
                "load": Column(np.arange(len(loads)), "1"),
                "position": position,
                "torque": Column(np.stack([w.mean(axis=0) for w in whole]), "N m", "at the output"),
            },
            signal="torque",
            description="mean cycle of each load",
        ),
        "feedforward": Table(
            axes=("position",),
            columns={
                "position": position,
                "torque": Column(fed.mean(axis=0), "N m", "of the learned table, at the motor"),
                "residual": Column(
                    whole[0][-1] / recipe.rig.torque_factor,
                    "N m",
                    "what the controller added in the last cycle, at the motor",
                ),
            },
            signal="torque",
            description="feed-forward and remaining disturbance without load",
        ),
    }


def _load_notes(loads: Sequence[Reading], rows: Sequence[LoadRow], p: float) -> list[str]:
    notes = []
    if p < SIGNIFICANCE:
        notes.append(
            f"the readings without load are not normally distributed (Shapiro-Wilk p = {p:.2g}): "
            "their S shows little of how often they are far off"
        )
    for load, row in zip(loads, rows, strict=True):
        if row.cycles < load.asked_cycles:
            notes.append(
                f"{load.name}: {row.cycles} whole cycles of {load.asked_cycles} in the recipe"
            )
        if row.effective_cycles < row.cycles / 2:
            notes.append(
                f"{load.name}: readings follow each other, {row.cycles} of them count as "
                f"{row.effective_cycles:.3g} independent ones"
            )
    return notes
