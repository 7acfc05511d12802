"""`stribeck` on imported runs: holds at constant speeds pooled, or any motion by its dynamics."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from rigtool.errors import InsufficientDataError, UsageError
from rigtool.experiments.friction.holds import find_holds, pool
from rigtool.experiments.friction.imported_motion import add_dynamics
from rigtool.experiments.friction.motion_terms import SmoothedMotion, band_limit
from rigtool.experiments.friction.procedure_analysis import separate
from rigtool.experiments.friction.results import (
    Findings,
    Scale,
    add_friction,
    add_static_friction,
    holds_table,
)
from rigtool.experiments.friction.stribeck_fit import fit_directions
from rigtool.experiments.imported import (
    Effort,
    effort_of,
    is_linear,
    known,
    position_of,
    require_one_rig,
    signals_of,
)
from rigtool.experiments.outcome import Outcome
from rigtool.quantity import Quantity
from rigtool.runfile import Recording, Run

SPEED_PARTS = 10
"""Number of parts of a recording whose mean speeds are compared."""

SPEED_SPREAD_LIMIT = 0.25
"""Mean speeds in the second half of a hold differ by less than this part from their mean."""

MIN_PROGRESS = 0.1
"""Net part of the path that a hold covers at least: an oscillation covers none."""

UNITS_BY_EFFORT = {
    "N": {"N m": "N", "N m s/rad": "N s/m", "rad/s": "m/s", "rad": "m", "kg m2": "kg"},
    "A": {"N m": "A", "N m s/rad": "A s/rad", "kg m2": "A s2/rad"},
    "1": {"N m": "1", "N m s/rad": "s/rad", "kg m2": "s2/rad"},
    "N m": {},
}
"""Units of the results by the unit of the motor's effort, for the units of torque in rad."""


def analyse_imported(runs: Sequence[Run], *, kt: Run | None = None) -> Outcome:
    """Return friction from holds, one or more a run, or from runs of any motion.

    Raises `UsageError` for runs of both kinds or of several rigs, `InsufficientDataError` where
    they do not support the result.
    """
    recordings = signals_of(runs)
    require_one_rig(recordings, runs)
    efforts = [effort_of(recording, kt) for recording in recordings]
    held = [_is_held(recording) for recording in recordings]
    if any(held) and not all(held):
        moving = ", ".join(run.path.name for run, item in zip(runs, held, strict=True) if not item)
        raise UsageError(
            f"{sum(held)} runs hold a constant speed, these do not: {moving}: analyse the two "
            "kinds one after the other"
        )
    first = efforts[0]
    found = Findings(Scale(Quantity(1.0, "1", first.relative_u or 0.0)))
    found.notes.append(f"torque is {first.origin}")
    if first.relative_u is None:
        found.notes.append(
            f"the uncertainty of the scale of {first.name} is unknown and not part of the "
            "uncertainties"
        )
    if all(held):
        _add_holds(runs, recordings, efforts, found)
    else:
        _add_motion(runs, recordings, efforts, found)
    return _in_units(found, UNITS_BY_EFFORT[first.unit], linear=is_linear(recordings[0]))


def _is_held(recording: Recording) -> bool:
    """Return whether a recording holds constant speeds, once it has settled.

    One with a set point may hold several speeds in a row.
    """
    time, position = recording.read("time"), position_of(recording)
    if recording.has("position_setpoint"):
        position = recording.read("position_setpoint")
        speed = np.diff(position) / np.diff(time)
        top = float(np.max(np.abs(speed)))
        steady = np.abs(np.diff(speed)) <= 1e-3 * top * np.diff(time)[1:]
        return bool(np.mean(steady & (np.abs(speed[1:]) > 0.01 * top)) > 0.5)
    edges = np.linspace(time[0], time[-1], SPEED_PARTS + 1)[SPEED_PARTS // 2 :]
    speeds = np.diff(np.interp(edges, time, position)) / np.diff(edges)
    constant = np.max(np.abs(speeds - speeds.mean())) <= SPEED_SPREAD_LIMIT * abs(speeds.mean())
    # An oscillation whose period fits the parts has equal mean speeds too, all near zero.
    late = position[np.searchsorted(time, edges[0]) :]
    onwards = abs(late[-1] - late[0]) >= MIN_PROGRESS * np.sum(np.abs(np.diff(late)))
    return bool(constant and onwards)


# -- holds


def _add_holds(
    runs: Sequence[Run], recordings: Sequence[Recording], efforts: Sequence[Effort], found: Findings
) -> None:
    parts = []
    inertia = known(recordings[0], "inertia")
    for run, recording, effort in zip(runs, recordings, efforts, strict=True):
        setpoint = "position_setpoint"
        try:
            part = find_holds(
                time=recording.read("time"),
                angle=position_of(recording),
                torque=effort.values,
                setpoint=recording.read(setpoint) if recording.has(setpoint) else None,
                # Without the inertia, the speed that fast torque makes is unknown.
                inertia=math.inf if inertia is None else inertia,
            )
        except InsufficientDataError as error:
            raise InsufficientDataError(f"{run.path}: {error}") from None
        parts.append(part)
    holds = pool(parts)
    if inertia is None:
        found.notes.append(
            "the inertia is not known: holds in which the shaft starts and stops are not left out"
        )
    fits = fit_directions(holds.speed, holds.torque, holds.u)
    found.tables["holds"] = holds_table(holds, settled=True)
    settled = int(np.count_nonzero(holds.settled > 0))
    found.notes.append(
        f"settling was left out at the start of {settled} of {len(holds.speed)} holds, at most "
        f"{holds.settled.max():.2g} s"
    )
    offset = separate(fits, holds, [])
    add_friction(fits, offset, found)
    add_static_friction(None, fits, offset, found)


# -- any motion


def _add_motion(
    runs: Sequence[Run], recordings: Sequence[Recording], efforts: Sequence[Effort], found: Findings
) -> None:
    motions: list[SmoothedMotion] = []
    for run, recording, effort in zip(runs, recordings, efforts, strict=True):
        try:
            motion = band_limit(
                time=recording.read("time"),
                position=position_of(recording),
                torque=effort.values,
            )
        except InsufficientDataError as error:
            raise InsufficientDataError(f"{run.path}: {error}") from None
        motions.append(motion)
    add_dynamics(motions, found)


def _in_units(found: Findings, units: Mapping[str, str], *, linear: bool) -> Outcome:
    """Return the findings in the units of the axis."""
    if linear:
        units = {
            **UNITS_BY_EFFORT["N"],
            **{of: unit.replace("rad", "m") for of, unit in units.items()},
        }
    results = {n: replace(q, unit=units.get(q.unit, q.unit)) for n, q in found.results.items()}
    tables = {
        name: replace(
            table,
            columns={
                key: replace(column, unit=units.get(column.unit, column.unit))
                for key, column in table.columns.items()
            },
        )
        for name, table in found.tables.items()
    }
    return Outcome(results, tables, tuple(found.notes))
