"""`stribeck --against` on imported runs: what changed between two runs of one motion."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rigtool.errors import UsageError, naming
from rigtool.experiments.friction.paired import MotionSignals, ParameterChange, changes, ratio
from rigtool.experiments.friction.results import Findings
from rigtool.experiments.friction.results_difference import RATIO_RESULT
from rigtool.experiments.imported import is_linear, place, position_of, rig_property
from rigtool.experiments.torque_per_ampere import effort_of
from rigtool.quantity import Quantity
from rigtool.runfile import Column, Recording, Run, Table

TERM_RESULTS = {
    "inertia": ("inertia_difference", "kg m2"),
    "viscous": ("viscous_friction_difference", "N m s/rad"),
    "coulomb": ("coulomb_friction_difference", "N m"),
    "offset": ("friction_offset_difference", "N m"),
    "gravity_cosine": ("gravity_cosine_difference", "N m"),
    "gravity_sine": ("gravity_sine_difference", "N m"),
}
"""Results and units by the terms of the fit."""

ONE_RANGE = 4 * np.pi
"""Largest range of the motor over which its own angle, without gear_ratio, is that of an arm."""

MAX_TABLE_POINTS = 2000
"""Largest number of points of the table."""


def add_changes(
    recordings: Sequence[Recording],
    against: Recording,
    reference: Recording | None,
    kt: Run | None,
    found: Findings,
) -> None:
    """Add what changed against another recording of the same motion, and the ratio to that change
    of a `reference`.

    Raises `UsageError` for several recordings, `InsufficientDataError` for other motions.
    """
    if len(recordings) > 1:
        raise UsageError(
            f"{len(recordings)} recordings: --against compares one recording with one, point by "
            "point: give one"
        )
    others = [recordings[0], *([] if reference is None else [reference])]
    with naming(place(recordings[0])):
        all_changes = changes(
            _signals(against, kt, found), [_signals(other, kt, found) for other in others]
        )
    change = all_changes[0]
    for term, (name, unit) in TERM_RESULTS.items():
        if (estimate := change.estimate(term)) is not None:
            found.add(name, estimate, unit, float(change.dof))
    if (gravity := change.gravity()) is not None:
        found.add("gravity_difference", gravity, "N m", float(change.dof))
    found.results["difference_rms"] = Quantity(
        change.residual_rms, "N m", reason="a measure of scatter itself"
    )
    if reference is not None:
        value, u, dof = ratio(change, all_changes[1])
        found.results[RATIO_RESULT] = Quantity(value, "1", u, float(dof))
        found.notes.append(
            f"{RATIO_RESULT} is that of this change to the change in {place(reference)}, both "
            "against "
            f"{place(against)}, point by point: the scale of the effort cancels"
        )
    found.notes.extend(_notes(change, recordings[0], against))
    found.tables["paired_difference"] = _table(change)


def _signals(recording: Recording, kt: Run | None, found: Findings) -> MotionSignals:
    """Return a recording as the comparison takes it, with the angle that gravity sees."""
    position = position_of(recording)
    effort = effort_of(recording, kt)
    gear = rig_property(recording, "gear_ratio")
    angle = None
    if is_linear(recording):
        pass
    elif recording.has("output_position"):
        angle = recording.read("output_position")
    elif gear is not None:
        angle = position / gear
    elif np.ptp(position) <= ONE_RANGE:
        angle = position
    else:
        note = "gravity is not separated: the angle of the arm is unknown, state rig.gear_ratio"
        if note not in found.notes:
            found.notes.append(note)
    return MotionSignals(recording.read("time"), position, effort.values, angle)


def _notes(change: ParameterChange, recording: Recording, against: Recording) -> list[str]:
    notes = [
        f"{place(recording)} minus {place(against)}, at the same points of one motion; the second "
        f"of them is {round(-change.shift, 9) + 0.0:.4g} s later",
        "what both runs share cancels: ripple, friction that is no straight line over speed, "
        "joints that move alike; coupling to other joints of an arm that the change brings is not "
        "in u",
    ]
    if lacking := [
        name for term, (name, _) in TERM_RESULTS.items() if change.estimate(term) is None
    ]:
        if is_linear(recording):
            lacking = [name for name in lacking if "gravity" not in name]
        if lacking:
            notes.append(f"the motion does not separate {', '.join(lacking)} from the others")
    if is_linear(recording):
        notes.append("gravity along the axis is part of friction_offset_difference")
    return notes


def _table(change: ParameterChange) -> Table:
    part = slice(None, None, -(-len(change.time) // MAX_TABLE_POINTS))
    used = np.where(change.used, 1.0, np.nan)
    return Table(
        ("time",),
        {
            "time": Column(change.time[part], "s", "of the run that is compared with"),
            "position": Column(change.position[part], "rad"),
            "difference": Column((change.difference * used)[part], "N m", "of the efforts"),
            "model": Column((change.model * used)[part], "N m", "the same of the fitted change"),
        },
        "difference",
        "Change of the effort at the same points of one motion; no value near standstill",
    )
