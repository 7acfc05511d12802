"""Table 8 with the disturbance of the load taken off: `measure-force --correction load|full`.

`load` takes friction that grows with load off the thesis's reading, at one angle of the rising
strokes. `full` reads the load from whole strokes, lifting and lowering, with all that was learned
at known loads (`experiments.load_disturbance.reading`), the motor constant at the motor's own
temperature. A load outside what was learned has no value; near standstill none has, only a dead
band.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rigtool.errors import InsufficientDataError
from rigtool.experiments.force.results import ZERO_AGAIN, Reading
from rigtool.experiments.load_disturbance.cycles import LoadedCycles
from rigtool.experiments.load_disturbance.model import Comparison, Disturbance
from rigtool.experiments.load_disturbance.reading import DeadBand, LoadReading, dead_band, read_load
from rigtool.experiments.load_disturbance.stored import disturbance_from, load_friction
from rigtool.experiments.load_disturbance.stored_recordings import cycles_of
from rigtool.experiments.outcome import Outcome
from rigtool.quantity import Quantity
from rigtool.recipe import Recipe
from rigtool.runfile import Column, Recording, Run, Table

Array = NDArray[np.float64]

BEYOND = 1.05
"""Loads up to this many times the largest learned one are still read."""

SPEED_SLACK = 1.01
ITERATIONS = 50


# -- load


def without_load_friction(
    loads: Sequence[Reading], recipe: Recipe, tables: Run
) -> tuple[list[Reading], Array]:
    """Return readings without the friction that grows with load, and its u, N m (loads,).

    `loads` begin with the one without load. Solves T + friction(T) = reading - zero for T. The u of
    a load beyond the learned ones is NaN.
    """
    disturbance = corrects(tables, recipe)
    settings, ratio = recipe.measure_force, recipe.rig.angle_ratio
    position = math.radians(settings.measure_angle) * ratio
    speed = 2 * math.pi * settings.speed_rev_per_s * ratio
    zero = float(loads[0].values.mean())
    found, us = [loads[0]], [0.0]
    for load in loads[1:]:
        shown = load.values - zero
        torque = shown.copy()
        for _ in range(ITERATIONS):
            friction, u = load_friction(tables, speed, position, torque)
            torque = shown - friction
        inside = float(torque.mean()) <= BEYOND * disturbance.torque
        us.append(float(u.mean()) if inside else math.nan)
        found.append(replace(load, values=zero + torque))
    return found, np.array(us)


def load_outcome(base: Outcome, friction_u: Array, thesis: Outcome) -> Outcome:
    """Return the outcome of readings `without_load_friction` with the u of what was taken off.

    `thesis` is that of the same readings with it.
    Raises `InsufficientDataError` where all loads are beyond the learned ones.
    """
    table, outside = base.tables["loads"], np.isnan(friction_u)
    if outside[1:].all():
        raise InsufficientDataError(
            "all loads are beyond those that friction was learned with: learn with larger loads in "
            "[ilc_learn.loads]"
        )
    kept = ("load", "applied_force", "applied_torque")
    columns = {
        name: column if name in kept else _blanked(column, outside)
        for name, column in table.columns.items()
    }
    whole_u = np.hypot(columns["mean_torque_u"].values, friction_u)
    columns["mean_torque_u"] = Column(
        whole_u, "N m", "standard uncertainty: as for --correction none, and the friction's"
    )
    about = "torque read while rising, without the friction that grows with load; NaN: not learned"
    count = {"loads_outside": Quantity(float(outside.sum()), "1", reason="a count")}
    return Outcome(
        {**base.results, **count},
        {
            **base.tables,
            "loads": Table(table.axes, columns, table.signal, about),
            **_uncorrected(thesis),
        },
        ("--correction load: friction that grows with load is taken off", *base.notes),
    )


def _blanked(column: Column, where: NDArray[np.bool_]) -> Column:
    return Column(np.where(where, math.nan, column.values), column.unit, column.description)


# -- full


@dataclass(frozen=True)
class _Row:
    """A load: its dead band, and what was read, or why nothing was."""

    band: DeadBand
    reading: LoadReading | None
    reason: str = ""


def full_outcome(
    run: Run, base: Outcome, recipe: Recipe, kt: Run, tables: Run, sampled_u: float
) -> Outcome:
    """Return the outcome with its table of loads read from whole strokes.

    `base` is that of the thesis's way; `sampled_u` N m, at the output, is the standard uncertainty
    by how the rig takes its samples of current. Where the motion is slower than any that was
    learned, loads have a dead band and no value. Raises `InsufficientDataError` where no load can
    be read though the motion was learned.
    """
    disturbance = corrects(tables, recipe)
    slow = slower_than_learned(disturbance, recipe)
    unloaded, loaded = _recordings(run)
    speed = 2 * math.pi * recipe.measure_force.speed_rev_per_s * recipe.rig.angle_ratio
    zero = [cycles_of(recording, recipe, kt, speed) for recording in unloaded]
    rows = [
        _read(disturbance, recording, cycles_of(recording, recipe, kt, speed), zero, recipe, slow)
        for recording in loaded
    ]
    outside = [row for row in rows if row.reading is None]
    if rows and len(outside) == len(rows) and not slow:
        raise InsufficientDataError(f"no load can be read: {outside[0].reason}")
    warmth, remarks = _temperature(unloaded, kt, tables)
    results = {
        **base.results,
        "loads_outside": Quantity(float(len(outside)), "1", reason="a count"),
    }
    notes = (
        f"--correction full: loads read from whole strokes with the disturbance of "
        f"{tables.path.name} taken off; zero from {len(zero)} recording(s)",
        *(f"no value: {reason}" for reason in dict.fromkeys(row.reason for row in outside)),
        *remarks,
        *base.notes,
    )
    loads = _loads_table(base.tables["loads"], rows, recipe, warmth, sampled_u)
    return Outcome(results, {**base.tables, "loads": loads, **_uncorrected(base)}, notes)


def _recordings(run: Run) -> tuple[list[Recording], list[Recording]]:
    """Return the recordings without load, and those with, in the order of the table."""
    found = run.recordings_named("load_")
    again = run.recordings_named(ZERO_AGAIN)
    unloaded = [r for r in found if r.condition("force") == 0]
    return unloaded + again, [r for r in found if r.condition("force") > 0]


def _temperature(unloaded: Sequence[Recording], kt: Run, tables: Run) -> tuple[float, list[str]]:
    """Return the relative u that being warmer than while learning brings, and what to say of it."""
    now = float(np.mean([np.mean(recording.read("temperature")) for recording in unloaded]))
    warmer = now - tables.result("learned_temperature").value
    slope = kt.results.get("torque_constant_temperature_coefficient")
    if slope is None:
        return 0.0, [
            f"the motor is {warmer:+.2g} K from where loads were learned; {kt.path.name} tells no "
            "temperature coefficient, so nothing is corrected for it"
        ]
    return abs(warmer) * (slope.u or 0.0), [
        f"the motor is {warmer:+.2g} K from where loads were learned; its constant is corrected by "
        f"{100 * warmer * slope.value:+.2g} %"
    ]


def _read(
    disturbance: Disturbance,
    recording: Recording,
    cycles: LoadedCycles,
    zero: Sequence[LoadedCycles],
    recipe: Recipe,
    slow: str,
) -> _Row:
    """Read one load; a load that cannot be read costs its own row only.

    `slow` says why none has a value, where the motion is too slow.
    """
    settings = recipe.measure_force
    angle = math.radians(settings.measure_angle)
    comparison = Comparison.of(cycles, zero, math.radians(settings.turn_angle))
    band = dead_band(comparison, angle)
    if slow:
        return _Row(band, None, slow)
    try:
        found = read_load(disturbance, comparison, angle)
    except InsufficientDataError as error:
        return _Row(band, None, f"{recording.name}: {error}")
    if found.moment > BEYOND * disturbance.torque:
        return _Row(
            band,
            None,
            f"{recording.name}: the load is {found.moment * 1e3:.4g} mN m, learned were loads up "
            f"to {disturbance.torque * 1e3:.4g} mN m: learn with larger loads in [ilc_learn.loads]",
        )
    return _Row(band, found)


def corrects(tables: Run, recipe: Recipe) -> Disturbance:
    """Return the disturbance that tables hold for the motion of `measure_force`.

    Raises `RunFileError` where they hold none, `InsufficientDataError` where the motion is faster
    than any that was learned, or too slow for `load`.
    """
    disturbance = disturbance_from(tables)
    speed = recipe.measure_force.speed_rev_per_s
    fastest = disturbance.speeds[-1] / (2 * math.pi * recipe.rig.angle_ratio)
    slow = slower_than_learned(disturbance, recipe)
    if slow and recipe.measure_force.correction == "load":
        raise InsufficientDataError(slow)
    if speed > fastest * SPEED_SLACK:
        raise InsufficientDataError(
            f"measure_force moves at {speed:.3g} rev/s, loads were learned up to {fastest:.3g} "
            "rev/s: move slower, or learn with a higher speed in [ilc_learn.loads]"
        )
    return disturbance


def slower_than_learned(disturbance: Disturbance, recipe: Recipe) -> str:
    """Return why a motion is too slow for a value, nothing where it is not."""
    speed = recipe.measure_force.speed_rev_per_s
    slowest = disturbance.speeds[0] / (2 * math.pi * recipe.rig.angle_ratio)
    if speed * SPEED_SLACK >= slowest:
        return ""
    return (
        f"measure_force moves at {speed:.3g} rev/s, loads were learned from {slowest:.3g} rev/s "
        "on: closer to standstill friction may hold any part of the load within its dead band; "
        "move faster, or learn with a lower speed in [ilc_learn.loads]"
    )


def _loads_table(
    base: Table, rows: Sequence[_Row], recipe: Recipe, warmth: float, sampled_u: float
) -> Table:
    """Return the table of loads with what was read; the first row, without load, stays."""
    angle = math.sin(math.radians(recipe.measure_force.measure_angle))
    columns = {name: base[name].astype(np.float64).copy() for name in base.columns}
    more = {
        name: np.full(len(rows) + 1, math.nan)
        for name in (
            "dead_band_middle",
            "dead_band",
            "angle_mean_torque",
            "angle_std_torque",
            "angle_error_percent",
        )
    }
    for number, row in enumerate(rows, start=1):
        applied = columns["applied_torque"][number]
        values = _row_values(row.reading, angle, applied, warmth, sampled_u)
        values |= {"dead_band_middle": row.band.middle, "dead_band": row.band.half}
        for name, value in values.items():
            (columns if name in columns else more)[name][number] = value
    described = {name: column.description for name, column in base.columns.items()} | {
        "mean_torque": "load at the angle of the reading, from whole strokes up and down",
        "mean_torque_u": "standard uncertainty: scatter, zero, disturbance, misfit, temperature, "
        "samples of current",
        "std_torque": "S of single cycles",
        "cycles": "cycles read",
    }
    table = {
        name: Column(values, base.columns[name].unit, described[name])
        for name, values in columns.items()
    }
    units = {"angle_error_percent": "%"}
    about = {
        "dead_band_middle": "mean of lifting and lowering at the angle, as read, less zero",
        "dead_band": "half of lifting less lowering: what friction may hold at a standstill",
        "angle_mean_torque": "mean of readings at the angle, rising, with the same correction",
        "angle_std_torque": "S of these",
        "angle_error_percent": "their error, of the applied torque",
    }
    table |= {
        name: Column(values, units.get(name, "N m"), about[name]) for name, values in more.items()
    }
    return Table(
        base.axes,
        table,
        base.signal,
        "torque of each load with the disturbance taken off; the first has none. NaN: outside what "
        "was learned",
    )


def _row_values(
    reading: LoadReading | None, sine: float, applied: float, warmth: float, sampled_u: float
) -> dict[str, float]:
    """Return the columns of a load; NaN where it could not be read."""
    names = (
        "mean_torque",
        "mean_torque_u",
        "mean_torque_dof",
        "std_torque",
        "std_torque_u",
        "error_torque",
        "error_percent",
        "cycles",
        "effective_cycles",
    )
    if reading is None:
        return dict.fromkeys(names, math.nan)
    mean, count = sine * reading.moment, len(reading.cycles)
    scatter = sine * float(reading.cycles.std(ddof=1))
    at_angle = sine * reading.at_angle
    own = sine * reading.components["scatter"]
    u = math.hypot(sine * reading.u, warmth * mean, sampled_u)
    values = (
        mean,
        u,
        reading.dof,
        scatter,
        scatter / math.sqrt(2 * (count - 1)),
        mean - applied,
        100 * (mean / applied - 1),
        float(count),
        (scatter / own) ** 2 if own else math.nan,
    )
    return dict(zip(names, values, strict=True)) | {
        "angle_mean_torque": float(at_angle.mean()),
        "angle_std_torque": float(at_angle.std(ddof=1)),
        "angle_error_percent": 100 * (float(at_angle.mean()) / applied - 1),
    }


def _uncorrected(base: Outcome) -> dict[str, Table]:
    """Return the table of loads as the thesis reads them, under a name of its own."""
    table = base.tables["loads"]
    return {
        "loads_uncorrected": Table(
            table.axes, table.columns, table.signal, "the same loads, --correction none"
        )
    }
