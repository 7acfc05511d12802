"""`stribeck` on imported runs: holds at constant speeds pooled, or any motion by its dynamics."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from rigtool.errors import InsufficientDataError, UsageError, naming
from rigtool.experiments.friction.holds import MIN_SAMPLES, find_holds
from rigtool.experiments.friction.imported_motion import add_dynamics, add_inertia
from rigtool.experiments.friction.imported_pairs import add_changes
from rigtool.experiments.friction.inverse_dynamics import identify_dynamics
from rigtool.experiments.friction.motion_terms import SmoothedMotion, band_limit
from rigtool.experiments.friction.offset import half_difference
from rigtool.experiments.friction.procedure_analysis import fit_holds, separate
from rigtool.experiments.friction.results import (
    Findings,
    Scale,
    add_friction,
    add_static_friction,
    holds_table,
)
from rigtool.experiments.friction.results_difference import add_curve_difference, require_different
from rigtool.experiments.imported import (
    is_linear,
    place,
    position_of,
    recordings_of,
    require_one_rig,
    rig_property,
)
from rigtool.experiments.outcome import Outcome
from rigtool.experiments.torque_per_ampere import Effort, effort_of
from rigtool.numerics.arrays import Array
from rigtool.numerics.plateaus import find_plateaus
from rigtool.quantity import Quantity
from rigtool.runfile import Recording, Run

SPEED_PARTS = 10
"""Number of parts of a recording whose mean speeds are compared."""

SPEED_SPREAD_LIMIT = 0.25
"""Mean speeds in the second half of a hold differ by less than this part from their mean."""

MIN_PROGRESS = 0.1
"""Net part of the path that a hold covers at least: an oscillation covers none."""

SPEED_BLOCKS = 400
"""Most parts of a recording whose mean speeds show plateaus."""

ON_STEPS = 0.5
"""Smallest part of the time on plateaus of a staircase of speed."""

ASKED_STEP = 1e-3
"""Part of the highest speed by which set points of one speed differ at most."""

SHOWN_STEP, SHOWN_RANGE = 0.02, 0.05
"""Parts of the highest speed by which measured speeds of a plateau differ from one to the next, and
in all."""

OTHER_SPEED = 0.5
"""Ratio of the speeds of a staircase at most: one speed with its scatter has no such steps."""

SLOWEST_PLATEAU = 0.005
"""Slowest speed of a plateau, relative to the highest: below, the shaft stands still."""

UNITS_BY_EFFORT = {
    "N": {"N m": "N", "N m s/rad": "N s/m", "rad/s": "m/s", "rad": "m", "kg m2": "kg"},
    "A": {"N m": "A", "N m s/rad": "A s/rad", "kg m2": "A s2/rad"},
    "1": {"N m": "1", "N m s/rad": "s/rad", "kg m2": "s2/rad"},
    "N m": {},
}
"""Units of the results by the unit of the motor's effort, for the units of torque in rad."""


def analyse_imported(
    runs: Sequence[Run],
    *,
    kt: Run | None = None,
    against: Run | None = None,
    reference: Run | None = None,
) -> Outcome:
    """Return friction from holds, one or more a run, or from runs of any motion.

    With `against`, also what changed against it: another imported run of the same motion, or for
    holds another run of `stribeck`; with `reference`, the ratio of that to the change in a third
    run. Raises `UsageError` for runs of several rigs, `InsufficientDataError`
    where they do not support the result.
    """
    recordings = recordings_of(runs)
    require_one_rig(recordings)
    efforts = [effort_of(recording, kt) for recording in recordings]
    held = [_stretches(recording) for recording in recordings]
    first = efforts[0]
    found = Findings(Scale(Quantity(1.0, "1", first.relative_u or 0.0)))
    found.notes.append(f"torque is {first.origin}")
    if first.relative_u is None:
        found.notes.append(
            f"the uncertainty of the scale of {first.name} is unknown and not part of the "
            "uncertainties"
        )
    if any(held) and not all(held):
        found.notes.append(
            f"{sum(map(bool, held))} of {len(held)} recordings hold constant speeds: all are taken "
            "by the dynamics of their motion"
        )
    linear, units = is_linear(recordings[0]), UNITS_BY_EFFORT[first.unit]
    if against is None and reference is not None:
        raise UsageError("--reference: is compared with the run of --against: give both")
    require_different(runs, against, reference)
    if all(held):
        try:
            _add_holds(recordings, efforts, held, found)
        except InsufficientDataError as few:
            # Before anything was found; a comparison needs the holds.
            if against is not None or not _moved(recordings, efforts, found):
                raise
            found.notes.append(f"by the dynamics of the motion: {few}")
        if against is not None:
            add_curve_difference(found, against, reference, units.get("N m", "N m"))
    elif against is not None:
        pair = recordings_of([run for run in (against, reference) if run is not None])
        require_one_rig([*recordings, *pair])
        add_changes(recordings, pair[0], pair[1] if reference is not None else None, kt, found)
    else:
        add_dynamics(_motions(recordings, efforts), found)
    return _in_units(found, units, linear=linear)


def _stretches(recording: Recording) -> list[tuple[int, int]]:
    """Return first and last + 1 sample of stretches of constant speed, none for other motions.

    With a set point of position, whose holds `find_holds` finds, or with one speed once it has
    settled, that is the whole recording.
    """
    time, position = recording.read("time"), position_of(recording)
    whole = [(0, len(time))]
    if recording.has("position_setpoint"):
        position = recording.read("position_setpoint")
        speed = np.diff(position) / np.diff(time)
        top = float(np.max(np.abs(speed)))
        steady = np.abs(np.diff(speed)) <= 1e-3 * top * np.diff(time)[1:]
        return whole if np.mean(steady & (np.abs(speed[1:]) > 0.01 * top)) > 0.5 else []
    edges = np.linspace(time[0], time[-1], SPEED_PARTS + 1)[SPEED_PARTS // 2 :]
    speeds = np.diff(np.interp(edges, time, position)) / np.diff(edges)
    constant = np.max(np.abs(speeds - speeds.mean())) <= SPEED_SPREAD_LIMIT * abs(speeds.mean())
    # An oscillation whose period fits the parts has equal mean speeds too, all near zero.
    late = position[np.searchsorted(time, edges[0]) :]
    onwards = abs(late[-1] - late[0]) >= MIN_PROGRESS * np.sum(np.abs(np.diff(late)))
    held = _steps(recording, time, position)
    levels = [abs(position[b - 1] - position[a]) / (time[b - 1] - time[a]) for a, b in held]
    one = not held or min(levels) > OTHER_SPEED * max(levels)
    return whole if constant and onwards and one else held


def _steps(recording: Recording, time: Array, position: Array) -> list[tuple[int, int]]:
    """Return the stretches of a staircase of speed: by its set point, else by the speed itself."""
    if recording.has("speed_setpoint"):
        level = recording.read("speed_setpoint")
        samples = np.arange(len(time))
        step = largest = ASKED_STEP * float(np.max(np.abs(level)))
    else:
        count = min(SPEED_BLOCKS, len(time) // 4)
        samples = np.linspace(0, len(time) - 1, count + 1).round().astype(np.int64)
        level = np.diff(position[samples]) / np.diff(time[samples])
        top = float(np.max(np.abs(level)))
        step, largest = SHOWN_STEP * top, SHOWN_RANGE * top
    slowest = SLOWEST_PLATEAU * float(np.max(np.abs(level)))
    found = [
        (int(samples[a]), int(samples[min(b, len(samples) - 1)]))
        for a, b in find_plateaus(level, step, largest)
        if abs(float(level[a:b].mean())) > slowest
    ]
    held = [(a, b) for a, b in found if b - a >= MIN_SAMPLES]
    return held if sum(b - a for a, b in held) >= ON_STEPS * len(time) else []


# -- holds


def _add_holds(
    recordings: Sequence[Recording],
    efforts: Sequence[Effort],
    stretches: Sequence[Sequence[tuple[int, int]]],
    found: Findings,
) -> None:
    parts = []
    inertia = rig_property(recordings[0], "inertia") if efforts[0].unit == "N m" else None
    for recording, effort, held in zip(recordings, efforts, stretches, strict=True):
        time, angle = recording.read("time"), position_of(recording)
        asked = None
        if recording.has("position_setpoint"):
            asked = recording.read("position_setpoint")
        with naming(place(recording)):
            parts += [
                find_holds(
                    time=time[a:b],
                    angle=angle[a:b],
                    torque=effort.values[a:b],
                    setpoint=None if asked is None else asked[a:b],
                    # Without the inertia, the speed that fast torque makes is unknown.
                    inertia=math.inf if inertia is None else inertia,
                )
                for a, b in held
            ]
    fits, holds, notes = fit_holds(parts)
    found.notes += notes
    if inertia is None:
        found.notes.append(
            "inertia or torque is not known: holds in which the shaft starts and stops are not "
            "left out"
        )
    found.tables["holds"] = holds_table(holds, settled=True)
    settled = int(np.count_nonzero(holds.settled > 0))
    found.notes.append(
        f"settling was left out at the start of {settled} of {len(holds.speed)} holds, at most "
        f"{holds.settled.max():.2g} s"
    )
    offset = separate(fits, holds, [])
    if len(fits) == 2 and (offset is None or not offset.separated):
        offset = half_difference(fits)
    add_friction(fits, offset, found)
    add_static_friction(None, fits, offset, found)
    if inertia is None:
        _add_inertia(recordings, efforts, found)


def _add_inertia(
    recordings: Sequence[Recording], efforts: Sequence[Effort], found: Findings
) -> None:
    """Add the inertia that the motion between holds shows, where it does."""
    try:
        inertia = identify_dynamics(_motions(recordings, efforts))
    except InsufficientDataError:
        return
    if inertia.without_inertia is None:
        add_inertia(inertia, found)
        found.notes.append("inertia is that of the whole motion, between the holds, too")


# -- any motion


def _motions(recordings: Sequence[Recording], efforts: Sequence[Effort]) -> list[SmoothedMotion]:
    motions = []
    for recording, effort in zip(recordings, efforts, strict=True):
        time, position = recording.read("time"), position_of(recording)
        with naming(place(recording)):
            motions.append(band_limit(time=time, position=position, torque=effort.values))
    return motions


def _moved(recordings: Sequence[Recording], efforts: Sequence[Effort], found: Findings) -> bool:
    """Add what the dynamics of the motion show; return whether they do."""
    try:
        add_dynamics(_motions(recordings, efforts), found)
    except InsufficientDataError:
        return False
    return True


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
