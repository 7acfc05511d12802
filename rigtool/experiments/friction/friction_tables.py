"""The tables of `stribeck`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rigtool.experiments.friction.breakaway import Breakaway, Ramp
from rigtool.experiments.friction.holds import Holds
from rigtool.experiments.friction.stribeck_fit import DirectionFit
from rigtool.experiments.friction.sweep import TorqueSpeed
from rigtool.runfile import Column, Table

Array = NDArray[np.float64]

MODEL_POINTS = 120
"""Points of the friction model's curve in each direction."""

RAMP_POINTS = 2000
"""Points of a stored ramp, at most."""


def torque_speed_table(curve: TorqueSpeed, label: str) -> Table:
    """Return the torque-speed curve of a sweep (Fig. 30, 32, 34)."""
    return Table(
        ("speed",),
        {
            "speed": Column(curve.speed, "rad/s"),
            "torque": Column(curve.torque, "N m", "of the controller, without feed-forward"),
            "revolutions": Column(curve.revolutions, "1", "whole turns averaged"),
        },
        signal="torque",
        description=f"Torque against speed, {label}",
    )


def holds_table(holds: Holds) -> Table:
    """Return mean torque by constant speed."""
    order = np.argsort(holds.speed, kind="stable")
    return Table(
        ("speed",),
        {
            "speed": Column(holds.speed[order], "rad/s"),
            "torque": Column(holds.torque[order], "N m", "mean over whole turns"),
            "u": Column(holds.u[order], "N m", "standard uncertainty from scatter"),
            "revolutions": Column(holds.revolutions[order], "1", "whole turns averaged"),
        },
        signal="torque",
        description="Torque at constant speeds",
    )


def model_table(fits: dict[int, DirectionFit]) -> Table:
    """Return the curve of the friction model that was chosen, over the speeds it rests on."""
    lowest = min(fit.lowest for fit in fits.values())
    speeds = np.geomspace(lowest, max(fit.highest for fit in fits.values()), MODEL_POINTS)
    parts = [
        (sign * speeds[::sign], sign * fits[sign].evaluate(speeds)[::sign])
        for sign in (-1, 1)
        if sign in fits
    ]
    return Table(
        ("speed",),
        {
            "speed": Column(np.concatenate([part[0] for part in parts]), "rad/s"),
            "torque": Column(np.concatenate([part[1] for part in parts]), "N m"),
        },
        signal="torque",
        description="Friction model fitted to the holds, constant torque included",
    )


def breakaway_table(position: Array, unloaded: Breakaway | None, loaded: Breakaway | None) -> Table:
    """Return breakaway torque by rotor position, without and with radial load."""
    columns = {"position": Column(position, "rad", "of the rotor, within a turn")}
    for prefix, series in (("", unloaded), ("loaded_", loaded)):
        if series is not None:
            columns[f"{prefix}positive"] = Column(series.positive, "N m")
            columns[f"{prefix}negative"] = Column(series.negative, "N m", "magnitude")
    signal = "positive" if unloaded is not None else "loaded_positive"
    return Table(("position",), columns, signal, "Torque at which the shaft breaks away")


def ramp_table(ramps: list[Ramp], time: Array, angle: Array, torque: Array) -> Table:
    """Return the ramp that took most torque (Fig. 22)."""
    highest = max(ramps, key=lambda ramp: -1.0 if np.isnan(ramp.torque) else ramp.torque)
    part = slice(highest.begin, highest.end, -(-(highest.end - highest.begin) // RAMP_POINTS))
    return Table(
        ("time",),
        {
            "time": Column(time[part] - time[highest.begin], "s"),
            "torque": Column(torque[part], "N m"),
            "position": Column(angle[part], "rad"),
        },
        signal="torque",
        description="The ramp that took most torque to break the shaft away",
    )
