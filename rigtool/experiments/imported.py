"""Signals of imported runs, and the properties of the rig that their conditions state.

A property that the mapping file did not state is absent.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from rigtool.errors import RunFileError, UsageError
from rigtool.numerics.arrays import Array
from rigtool.recipe.mapping import CONSTANT_SPEED, RIG_CONDITIONS
from rigtool.runfile import Recording, Run
from rigtool.runfile.schema import IMPORTED


def recordings_of(runs: Sequence[Run]) -> list[Recording]:
    """Return all recordings of all runs: a file that a condition splits holds several.

    Raises `RunFileError` for a run that holds only a map, `UsageError` for one that is given twice.
    """
    given: dict[str, Run] = {}
    for run in runs:
        if (other := given.setdefault(run.content_sha256, run)) is not run:
            raise UsageError(
                f"{run.path} holds the same as {other.path}, which is no repeat of it: give each "
                "recording once"
            )
    many = ((run, run.recordings_named(f"{IMPORTED}_")) for run in runs)
    return [recording for run, own in many for recording in own or [run.recording(IMPORTED)]]


def rotary_recordings(runs: Sequence[Run], why: str) -> list[Recording]:
    """Return all recordings of all runs of one rig.

    Raises `UsageError` for several rigs, and for a linear axis, `why` it is refused.
    """
    recordings = recordings_of(runs)
    require_one_rig(recordings)
    if is_linear(recordings[0]):
        raise UsageError(f"{runs[0].path}: is of a linear axis, {why}")
    return recordings


def place(recording: Recording) -> str:
    """Return the run file, and where that holds several recordings which of them, for messages."""
    part = "" if recording.name == IMPORTED else f", {recording.name}"
    return f"{recording.path}{part}"


def rig_property(recording: Recording, name: str) -> float | None:
    """Return a property of the rig, None where it is unknown."""
    return recording.condition(name) if name in recording.conditions else None


def is_linear(recording: Recording) -> bool:
    """Return whether the axis is linear: m and N."""
    return rig_property(recording, "linear_axis") == 1.0


def position_of(recording: Recording) -> Array:
    """Return the position (n,), rad or m.

    The measured position is preferred to encoder counts, counts to the integral of speed, which
    starts at zero, and that to a stated constant speed. Raises `RunFileError` where none of them is
    known.
    """
    if recording.has("position"):
        return recording.read("position")
    counts = rig_property(recording, "encoder_counts")
    if recording.has("encoder") and counts is not None:
        turn = 1.0 if is_linear(recording) else 2 * math.pi
        return recording.read("encoder") * (turn / counts)
    if recording.has("speed"):
        time, speed = recording.read("time"), recording.read("speed")
        steps = np.diff(time) * (speed[1:] + speed[:-1]) / 2
        return np.concatenate([[0.0], np.cumsum(steps)])
    if (stated := rig_property(recording, CONSTANT_SPEED)) is not None:
        time = recording.read("time")
        return stated * (time - time[0])
    raise RunFileError(
        f"{place(recording)}: the position is unknown: there is no channel position or speed, nor "
        "encoder with encoder_counts; import it with one of them mapped, or with a condition "
        f"{CONSTANT_SPEED}"
    )


def moves(recording: Recording) -> bool:
    """Return whether the motion was measured, not stated."""
    counted = recording.has("encoder") and rig_property(recording, "encoder_counts") is not None
    return recording.has("position") or recording.has("speed") or counted


def require_one_rig(recordings: Sequence[Recording]) -> None:
    """Raise `UsageError` where the known properties of the rig differ between recordings."""
    first = {name: rig_property(recordings[0], name) for name in RIG_CONDITIONS}
    for recording in recordings:
        for name, value in first.items():
            if rig_property(recording, name) != value:
                raise UsageError(
                    f"{place(recording)} has {name} {rig_property(recording, name)}, "
                    f"{place(recordings[0])} has {value}: give runs of one rig, imported with one "
                    "mapping"
                )
