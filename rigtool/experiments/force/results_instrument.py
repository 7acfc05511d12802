"""What the instrument adds to `measure-force`: load friction [Fig. 63] and stiffness [Fig. 62]."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from rigtool.errors import InsufficientDataError
from rigtool.experiments.force.cycles import Peaks, peaks
from rigtool.experiments.force.results import LoadReadings, applied_torque, stroke_grid
from rigtool.experiments.outcome import Outcome
from rigtool.numerics.arrays import Array
from rigtool.quantity import Quantity, combined, error_line, inherited, scaled
from rigtool.recipe import Recipe
from rigtool.runfile import Column, Table


def instrument_outcome(
    extra: Mapping[str, LoadReadings], recipe: Recipe, constant: Quantity
) -> Outcome:
    """Return load friction from `hysteresis` and stiffness from `shift`, where they were recorded.

    Where a load shows no peak within the stroke, its results are left out and a note states the
    reason.
    """
    results: dict[str, Quantity] = {}
    tables: dict[str, Table] = {}
    notes: list[str] = []
    for name, reading in extra.items():
        tables[name] = _lifted_table(reading, recipe)
        try:
            found = _peaks(reading, recipe)
        except InsufficientDataError as error:
            notes.append(f"no result: recording {name}: {error}")
            continue
        if name == "hysteresis":
            results |= _friction_results(found, constant)
        else:
            results |= _stiffness_results(found, reading.force, recipe)
    return Outcome(results, tables, tuple(notes))


def _lifted_table(reading: LoadReadings, recipe: Recipe) -> Table:
    grid = stroke_grid(recipe)
    up, down = reading.strokes(reading.torque, grid)
    angle = np.radians(recipe.measure_force.angle) * grid / grid[-1]
    return Table(
        axes=("position",),
        columns={
            "position": Column(grid, "count", "of the motor"),
            "lifting": Column(up.mean(axis=0), "N m", "mean of the rising strokes"),
            "lowering": Column(down.mean(axis=0), "N m", "mean of the falling strokes"),
            "applied": Column(
                applied_torque(recipe, reading.force, angle),
                "N m",
                "of the load, were the instrument stiff",
            ),
        },
        signal="lifting",
        description=f"torque at the output while {reading.force:g} N are lifted and lowered",
    )


def _peaks(reading: LoadReadings, recipe: Recipe) -> Peaks:
    """Find the peak of each stroke, leaving out where it turns."""
    settings, grid = recipe.measure_force, stroke_grid(recipe)
    degrees = settings.angle * grid / grid[-1]
    straight = (degrees >= settings.turn_angle) & (degrees <= settings.angle - settings.turn_angle)
    up, down = reading.strokes(reading.torque, grid[straight])
    return peaks(np.radians(degrees[straight]), up, down)


def _friction_results(found: Peaks, constant: Quantity) -> dict[str, Quantity]:
    """Return both peaks and half their difference, the friction that grows with load.

    The peaks lie at different rotor angles, where the torque constant differs by its ripple: they
    do not share that error.
    """
    lifting, lowering = found.lifting_torque, found.lowering_torque
    both = math.hypot(lifting.mean(), lowering.mean())
    return {
        "lifting_torque": _of_cycles(lifting, "N m", constant, lifting.mean()),
        "lowering_torque": _of_cycles(lowering, "N m", constant, lowering.mean()),
        "load_friction": _of_cycles((lifting - lowering) / 2, "N m", constant, both / 2),
    }


def _stiffness_results(found: Peaks, force: float, recipe: Recipe) -> dict[str, Quantity]:
    """Return where the peak lies and the stiffness that follows.

    The thesis reads the shift while lifting. Friction adds to the tendon's stretch while lifting
    and subtracts from it while lowering, so that the mean of both shifts is due to the load alone:
    stiffness = load / mean.
    """
    rig, middle = recipe.rig, math.pi / 2
    load = float(applied_torque(recipe, force, middle))
    lifting = _of_cycles(found.lifting_angle - middle, "rad")
    mean = _of_cycles((found.lifting_angle + found.lowering_angle) / 2 - middle, "rad")
    counts = rig.angle_ratio * rig.encoder_counts / (2 * math.pi)
    results = {
        "peak_angle_shift": lifting,
        "peak_shift_counts": scaled(lifting, counts, "count"),
        "peak_angle_shift_mean": mean,
    }
    if mean.value > 0:
        reason = (
            "ripple that grows with current moves the peak by an amount that these data do not show"
        )
        results["stiffness"] = Quantity(load / mean.value, "N m/rad", reason=reason)
    return results


def _of_cycles(
    values: Array, unit: str, constant: Quantity | None = None, torque: float = 0.0
) -> Quantity:
    """Return the mean over cycles; the relative uncertainty of `constant` acts on `torque`."""
    mean = float(values.mean())
    if values.size < 2:
        return Quantity(mean, unit, reason="one cycle shows no scatter")
    scatter = float(values.std(ddof=1)) / math.sqrt(values.size)
    lines = [error_line("scatter", scatter, unit, values.size - 1)]
    if constant is not None:
        lines += inherited(constant, torque / constant.value, "torque constant")
    return combined(mean, unit, lines)
