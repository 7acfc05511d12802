"""Loads of `measure-force` with their uncertainty: Tables 8 and 9, and what no load shows."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rigtool.experiments.force.cycles import (
    Cycle,
    LoadStatistics,
    curves,
    normality,
    statistics,
    up_and_down,
)
from rigtool.experiments.outcome import Outcome
from rigtool.quantity import Quantity
from rigtool.recipe import Recipe
from rigtool.runfile import Column, Table

Array = NDArray[np.float64]

GRID_COUNTS = 10
"""Distance of the points at which curves are stored, quad counts."""

ZERO_AGAIN = "zero_again"
"""Recording without load after all loads (correction full): zero is known before and after."""

SIGNIFICANCE = 0.05
"""Shapiro-Wilk probability below which readings are said not to be normally distributed."""


@dataclass(frozen=True, eq=False)
class Reading:
    """One recording, filtered: signals (n,), its cycles, and the torque read in each (cycles,).

    `position` in quad counts of the motor; `torque` at the output and `feedforward` (of the learned
    table) at the motor, N m. `method_u` is the standard uncertainty at the output of what a reading
    holds beside the load by the way it is made, N m.
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

    def strokes(self, signal: Array, grid: Array) -> tuple[Array, Array]:
        """Return a signal over position of the rising and of the falling strokes."""
        return curves(self.position, signal, self.cycles, grid)


def applied_torque(recipe: Recipe, force: float, angle: float | Array) -> Array:
    """Return the torque that a force asks for at an output angle, N m, in the order of `angle`.

    At the grasper force * length * sin(angle) [8.1], on the pulley force * radius.
    """
    sine = np.sin(angle) if recipe.rig.attachment == "instrument" else np.ones_like(angle)
    return force * recipe.rig.load_arm * sine


def stroke_grid(recipe: Recipe) -> Array:
    """Return positions over one stroke, quad counts of the motor."""
    rig = recipe.rig
    span = recipe.measure_force.angle / 360 * rig.encoder_counts * rig.angle_ratio
    return np.linspace(0, span, max(2, round(span / GRID_COUNTS) + 1))


def loads_outcome(
    loads: Sequence[Reading], recipe: Recipe, constant: Quantity, table_u: float
) -> Outcome:
    """Return Table 8 or 9 and the figures of the unloaded cycles.

    `loads` begin with the one without force; `constant` is the torque constant at one rotor angle
    and `table_u` the standard uncertainty of the learned table where torque is read, N m.
    """
    angle = math.radians(recipe.measure_force.measure_angle)
    unloaded = statistics(loads[0].values, 0.0)
    zero = unloaded.mean if recipe.measure_force.zero else 0.0
    rows = [unloaded] + [
        statistics(load.values - zero, float(applied_torque(recipe, load.force, angle)))
        for load in loads[1:]
    ]
    # The error of the table is in the zero reading as well and goes with it; what makes the zero
    # reading uncertain comes instead.
    zero_u = math.hypot(unloaded.u, loads[0].method_u) / recipe.rig.torque_factor
    offset_u = zero_u if recipe.measure_force.zero else table_u
    judged = normality(loads[0].values)
    results = {
        "std_torque_no_load": Quantity(
            unloaded.std, "N m", _std_u(unloaded), float(unloaded.count - 1)
        ),
        "mean_torque_no_load": _mean_quantity(
            unloaded, recipe, constant, table_u, loads[0].method_u
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
        "loads": _loads_table(loads, rows, recipe, constant, table_u, offset_u),
        "values": _values_table(loads),
        "probability_plot": probability,
        **_curve_tables(loads, recipe),
    }
    return Outcome(results, tables, tuple(_load_notes(loads, rows, judged.p)))


def _loads_table(
    loads: Sequence[Reading],
    rows: Sequence[LoadStatistics],
    recipe: Recipe,
    constant: Quantity,
    table_u: float,
    offset_u: float,
) -> Table:
    means = [
        _mean_quantity(row, recipe, constant, offset_u if number else table_u, load.method_u)
        for number, (row, load) in enumerate(zip(rows, loads, strict=True))
    ]
    columns = {
        "load": Column(np.arange(len(loads)), "1", "in the order of measurement"),
        "applied_force": Column(np.array([load.force for load in loads]), "N"),
        "applied_torque": Column(
            np.array([row.mean - row.error for row in rows]), "N m", "at the angle of the reading"
        ),
        "mean_torque": Column(np.array([mean.value for mean in means]), "N m", "at the output"),
        "mean_torque_u": Column(
            np.array([mean.u for mean in means]),
            "N m",
            "standard uncertainty: scatter, torque constant, zero reading or learned table, method",
        ),
        "mean_torque_dof": Column(
            np.array([math.nan if mean.dof is None else mean.dof for mean in means]),
            "1",
            "effective degrees of freedom of mean_torque_u",
        ),
        "std_torque": Column(np.array([row.std for row in rows]), "N m", "S of single readings"),
        "std_torque_u": Column(np.array([_std_u(row) for row in rows]), "N m"),
        "error_torque": Column(np.array([row.error for row in rows]), "N m", "mean - applied"),
        "error_percent": Column(
            np.array([row.error_percent for row in rows]), "%", "of the applied torque"
        ),
        "cycles": Column(np.array([row.count for row in rows]), "1", "readings"),
        "effective_cycles": Column(
            np.array([row.effective_count for row in rows]), "1", "independent readings among them"
        ),
    }
    return Table(
        axes=("load",),
        columns=columns,
        signal="mean_torque",
        description="torque read from current while rising, by load; the first has none",
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


def _std_u(row: LoadStatistics) -> float:
    """Return the standard uncertainty of S for normal readings, S / sqrt(2 (n - 1)) (GUM E.4.3)."""
    return row.std / math.sqrt(2 * (row.count - 1))


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


def _load_notes(loads: Sequence[Reading], rows: Sequence[LoadStatistics], p: float) -> list[str]:
    notes = []
    if p < SIGNIFICANCE:
        notes.append(
            f"the readings without load are not normally distributed (Shapiro-Wilk p = {p:.2g}): "
            "their S says little about how often they are far off"
        )
    for load, row in zip(loads, rows, strict=True):
        if row.count < load.asked_cycles:
            notes.append(
                f"{load.name}: {row.count} whole cycles of {load.asked_cycles} that were asked for"
            )
        if row.effective_count < row.count / 2:
            notes.append(
                f"{load.name}: readings follow each other, {row.count} of them count as "
                f"{row.effective_count:.3g} independent ones"
            )
    return notes
