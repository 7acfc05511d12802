"""What a mapping states and the data contradict: speed, position, counts, torque constant."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from rigtool.errors import RunFileError
from rigtool.recipe.mapping import Mapping
from rigtool.runfile.importers.raw import Array
from rigtool.runfile.schema import TIME

PIECES = 100
"""Of a recording over which ways by position and by speed are compared."""

STRAIGHT = 0.9
"""Correlation of these ways from which on their ratio has a meaning."""

OTHER_MOTION = 1.5
"""Ratio of position and speed that no sensor's error explains."""

OTHER_CONSTANT = 1.3
"""Ratio of torque constants that temperature, friction and a data sheet do not explain."""


def require_same_motion(path: Path, signals: dict[str, Array]) -> None:
    """Raise `RunFileError` where a speed is not the derivative of its position.

    Over `PIECES` of the recording, the way by position x and the way by speed w have the slope
    sum(x w) / sum(w^2); where they have no straight line in common nothing is concluded.
    """
    time = signals[TIME]
    for name, of in (("position", "speed"), ("position_setpoint", "speed_setpoint")):
        if name not in signals or of not in signals:
            continue
        way = np.diff(time) * (signals[of][1:] + signals[of][:-1]) / 2
        ends = np.unique(np.linspace(0, len(time) - 1, PIECES + 1).round().astype(int))
        moved = np.diff(signals[name][ends])
        expected = np.diff(np.concatenate([[0.0], np.cumsum(way)])[ends])
        alike = float(moved @ expected)
        squares = float(expected @ expected)
        if squares == 0 or alike**2 < STRAIGHT**2 * squares * float(moved @ moved):
            continue
        ratio = alike / squares
        if not 1 / OTHER_MOTION < ratio < OTHER_MOTION:
            raise RunFileError(
                f"{path}: {name} moves {ratio:.3g} times as far as {of} states: correct the "
                "sampling rate, the time, or a unit, scale, sign or counts_per_turn in the mapping"
            )


def contradictions(signals: dict[str, Array], mapping: Mapping) -> list[str]:
    """Return notes on properties of the rig that the signals contradict."""
    notes = []
    rig = mapping.rig
    if rig.encoder_counts is not None and "encoder" in signals and "position" in signals:
        turn = 2 * math.pi if rig.axis == "rotary" else 1.0
        ratio = slope(signals["encoder"] * (turn / rig.encoder_counts), signals["position"])
        if ratio is not None and not 1 / OTHER_MOTION < ratio < OTHER_MOTION:
            notes.append(
                f"encoder moves {ratio:.3g} times as far as position with encoder_counts = "
                f"{rig.encoder_counts}: correct that, a sign, or counts_per_turn"
            )
    constant = rig.torque_constant
    for torque in ("torque", "reference_torque"):
        if constant is None or torque not in signals or "current" not in signals:
            continue
        found = slope(signals[torque], signals["current"])
        if found is not None and not 1 / OTHER_CONSTANT < found / constant < OTHER_CONSTANT:
            notes.append(
                f"{torque} changes by {found:.3g} N m for each ampere, torque_constant is "
                f"{constant:.3g} N m/A: see to a unit, a sign, a gear between them, or rms current"
            )
    return notes


def slope(values: Array, over: Array) -> float | None:
    """Return the slope of values (n,) over others; None where they are on no straight line."""
    y, x = values - values.mean(), over - over.mean()
    alike, power = float(y @ x), float(x @ x)
    if power == 0 or alike**2 < STRAIGHT**2 * power * float(y @ y):
        return None
    return alike / power
