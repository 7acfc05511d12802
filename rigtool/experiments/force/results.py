"""Loads of `measure-force` with their uncertainty: Tables 8 and 9, and the unloaded cycles."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

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
from rigtool.experiments.load_disturbance.results_known_loads import ratio_line, reference_lines
from rigtool.experiments.outcome import Outcome
from rigtool.numerics.arrays import Array
from rigtool.quantity import (
    Component,
    Quantity,
    combined,
    difference,
    error_line,
    inherited,
    scattered,
)
from rigtool.recipe import Recipe
from rigtool.runfile import Column, Table

GRID_COUNTS = 10
"""Distance between the points of stored curves, quad counts."""

ZERO_AGAIN = "zero_again"
"""Recording without load after all loads (correction full): zero is known before and after."""

ONE_ANGLE = "torque constant at one rotor angle"
"""Line of the budget: the ripple of the calibration, for want of another."""

SIGNIFICANCE = 0.05
"""Shapiro-Wilk probability below which readings are reported as not normally distributed."""


@dataclass(frozen=True, eq=False)
class LoadReadings:
    """One recording, filtered: signals (n,), its cycles, and the torque read in each (cycles,).

    `position` in quad counts of the motor; `torque` at the output and `feedforward` (of the learned
    table) at the motor, N m. `method_u` N m is the standard uncertainty at the output by the errors
    that the method adds to a reading. `whole` holds the mean of the same cycles, where loads are
    read from whole strokes.
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

    def scaled(self, factor: float) -> LoadReadings:
        """Return readings and curves with a torque constant that is larger by a factor."""
        torque, feedforward = factor * self.torque, factor * self.feedforward
        return replace(self, torque=torque, feedforward=feedforward, values=factor * self.values)

    def strokes(self, signal: Array, grid: Array) -> tuple[Array, Array]:
        """Return a signal over position of the rising and of the falling strokes."""
        return curves(self.position, signal, self.cycles, grid)


@dataclass(frozen=True)
class LoadRow:
    """One load of Table 8 or 9, as `LOAD_COLUMNS` describes its numbers; NaN where there is no
    value."""

    applied_force: float
    applied: Quantity
    mean: Quantity
    std_torque: float
    std_torque_u: float
    cycles: float
    effective_cycles: float

    def blank(self) -> LoadRow:
        """Return the row without what was measured."""
        none = Quantity(math.nan, "N m", reason="outside what was learned")
        return LoadRow(self.applied_force, self.applied, none, *[math.nan] * 4)

    @property
    def error(self) -> Quantity:
        """Mean less applied torque; where both rest on the same length, it cancels."""
        none = math.isnan(self.mean.value)
        return self.mean if none else difference(self.mean, self.applied)

    def column(self, name: str) -> float:
        """Return a number of the row by the name of its column."""
        if hasattr(self, name):
            return float(getattr(self, name))
        if name == "error_percent":
            applied = self.applied.value
            return 100 * self.error.value / applied if applied else math.nan
        quantity, _, what = name.partition("_torque")
        found: Quantity = getattr(self, quantity)
        number = getattr(found, what.removeprefix("_") or "value")
        return math.nan if number is None else float(number)


LOAD_COLUMNS = {
    "applied_force": ("N", ""),
    "applied_torque": ("N m", "at the angle of the reading"),
    "applied_torque_u": ("N m", "standard uncertainty: weights, length, angle ratio"),
    "mean_torque": ("N m", "at the output"),
    "mean_torque_u": (
        "N m",
        "standard uncertainty: scatter, torque constant, zero reading or learned table, method",
    ),
    "mean_torque_dof": ("1", "effective degrees of freedom of mean_torque_u"),
    "std_torque": ("N m", "S of single readings"),
    "std_torque_u": ("N m", ""),
    "error_torque": ("N m", "mean - applied"),
    "error_torque_u": ("N m", "standard uncertainty of both; what they share cancels"),
    "error_torque_dof": ("1", "effective degrees of freedom of error_torque_u"),
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
    loads: Sequence[LoadReadings],
    recipe: Recipe,
    constant: Quantity,
    ripple: Callable[[float], float],
    table_u: float,
    found: Sequence[LoadStatistics] = (),
) -> list[LoadRow]:
    """Return Table 8 or 9, load by load, from readings at one angle of the rising strokes.

    `loads` begin with the one without force; `constant` is the torque constant at one rotor angle,
    `ripple` the part of its ripple that acts at a current, A, and `table_u` the standard
    uncertainty of the learned table where torque is read, N m. `found` summarises the readings of
    each load; without it each load's are taken alone.
    """
    summaries = found or [statistics(load.values) for load in loads]
    angle = math.radians(recipe.measure_force.measure_angle)
    unloaded = summaries[0]
    table = [Component("learned table", 0.0, "N m", table_u, None, recipe.rig.torque_factor)]
    # The zero reading contains the error of the table, too, and removes it; its own uncertainty
    # takes the place of the table's.
    zeroed = [
        error_line("zero reading", unloaded.u, "N m", unloaded.dof),
        error_line("method of the zero reading", loads[0].method_u, "N m"),
    ]
    zero, offset = (unloaded.mean, zeroed) if recipe.measure_force.zero else (0.0, table)
    rows = []
    for load, summary in zip(loads, summaries, strict=True):
        first = load is loads[0]
        own = table if first else offset
        mean = summary.mean - (0.0 if first else zero)
        # What a load adds to ripple of i |i| grows with the current that flows without, too.
        held = abs(mean) / recipe.rig.torque_factor + 2 * np.mean(np.abs(load.feedforward))
        here = _with_ripple(constant, ripple(float(held) / constant.value))
        rows.append(
            LoadRow(
                applied_force=load.force,
                applied=_applied_quantity(recipe, load.force, angle),
                mean=_mean_quantity(replace(summary, mean=mean), recipe, here, own, load.method_u),
                std_torque=summary.std,
                # S / sqrt(2 (n - 1)) for normal readings (GUM E.4.3)
                std_torque_u=summary.std / math.sqrt(2 * (summary.count - 1)),
                cycles=summary.count,
                effective_cycles=summary.effective_count,
            )
        )
    return rows


def _with_ripple(constant: Quantity, part: float) -> Quantity:
    lines = [
        replace(line, u=part * line.u) if line.name == ONE_ANGLE else line
        for line in constant.budget
    ]
    return combined(constant.value, constant.unit, lines) if lines else constant


def row_results(rows: Sequence[LoadRow]) -> dict[str, Quantity]:
    """Return mean torque and error of each load as results, with their budgets."""
    loads = {f"mean_torque_load_{number:03d}": row.mean for number, row in enumerate(rows)}
    errors = {f"error_torque_load_{number:03d}": row.error for number, row in enumerate(rows)}
    errors.pop("error_torque_load_000")
    return {"mean_torque_no_load": loads.pop("mean_torque_load_000"), **loads, **errors}


def loads_outcome(
    loads: Sequence[LoadReadings], rows: Sequence[LoadRow], recipe: Recipe
) -> Outcome:
    """Return Table 8 or 9 and the figures of the unloaded cycles, from readings and their rows."""
    unloaded, judged = rows[0], normality(loads[0].values)
    results = {
        "std_torque_no_load": scattered(
            unloaded.std_torque, "N m", unloaded.std_torque_u, float(unloaded.cycles - 1)
        ),
        **row_results(rows),
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
            rows, LOAD_COLUMNS, "torque read from current while rising, by load; the first has none"
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
                name: Column([row.column(name) for row in rows], unit, about)
                for name, (unit, about) in columns.items()
            },
        },
        signal="mean_torque",
        description=description,
    )


def _mean_quantity(
    row: LoadStatistics,
    recipe: Recipe,
    constant: Quantity,
    offset: Sequence[Component],
    method_u: float,
) -> Quantity:
    """Return the mean torque with its whole uncertainty; `constant` is that at one rotor angle.

    torque = factor * Kt * current + offset + method (GUM 5.1.2). The `offset` is zero; its lines
    are those of the zero reading or of the learned table. `method_u` is that of `LoadReadings`.
    """
    mean = row.mean
    lines = [
        error_line("scatter", row.u, "N m", row.dof),
        *inherited(constant, mean / constant.value, "torque constant"),
        *offset,
        error_line("method of the reading", method_u, "N m"),
        ratio_line(recipe, -mean),
    ]
    return combined(mean, "N m", lines)


def _applied_quantity(recipe: Recipe, force: float, angle: float) -> Quantity:
    """Return the torque that a force takes at an output angle, rad, with its uncertainty.

    The angle is that of the motor over the angle ratio.
    """
    value = float(applied_torque(recipe, force, angle))
    if force == 0:
        return Quantity(value, "N m", 0.0)
    turned = force * recipe.rig.load_arm * math.cos(angle) * angle
    return combined(
        value, "N m", [*reference_lines(recipe, force, value), ratio_line(recipe, -turned)]
    )


def _values_table(loads: Sequence[LoadReadings]) -> Table:
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


def _curve_tables(loads: Sequence[LoadReadings], recipe: Recipe) -> dict[str, Table]:
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
                "torque": Column([w.mean(axis=0) for w in whole], "N m", "at the output"),
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


def _load_notes(loads: Sequence[LoadReadings], rows: Sequence[LoadRow], p: float) -> list[str]:
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
