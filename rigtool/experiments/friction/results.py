"""Results, tables and notes of `stribeck`, with the uncertainty of the torque constant."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np

from rigtool.experiments.friction.breakaway import Breakaway, TorqueRamp
from rigtool.experiments.friction.direction_fit import DIRECTION_NAMES, DirectionFit
from rigtool.experiments.friction.holds import Holds
from rigtool.experiments.friction.offset import Offset
from rigtool.experiments.friction.sweep import TorqueSpeed
from rigtool.numerics.arrays import Array
from rigtool.quantity import (
    Component,
    Quantity,
    combined,
    error_line,
    inherited,
)
from rigtool.runfile import Column, Table, dof_column

Uncertain = tuple[float, float]
"""A value and its standard uncertainty."""

SCATTER_LINE = "scatter"
"""Line of a budget: scatter of the data, or of a fit to them."""

MODEL_POINTS = 120
"""Points of the curve of the friction model in each direction."""

RAMP_POINTS = 2000
"""Largest number of points of a stored ramp."""

TANH_DONE = 3.0
"""Speed above which the compensation's tanh(v / (1 rad/s)) is within 0.5 % of 1, rad/s."""

NOT_SEPARATED = (
    "the data do not separate a constant torque from friction that differs between directions: "
    "their sum is stated as friction_offset; breakaway with a radial load helps"
)
"""Note where both explanations fit."""

SAME_COULOMB = (
    "friction_offset is that of Coulomb friction that is the same in both directions: half of a "
    "difference between them looks the same"
)
"""Note where the offset is stated as if there were no difference."""


@dataclass(frozen=True)
class Scale:
    """Torque for each ampere of set point [7.1.1], with the uncertainty that all torques share."""

    constant: Quantity

    @property
    def value(self) -> float:
        """In N m/A."""
        return self.constant.value

    def quantity(self, value: float, unit: str, lines: Iterable[Component]) -> Quantity:
        """Return a quantity that scales with the constant, with further lines of its budget."""
        scale = inherited(self.constant, value / self.constant.value, "torque constant")
        return combined(value, unit, [*lines, *scale])


@dataclass
class Findings:
    """Results, tables and notes so far.

    `common` are standard uncertainties of Coulomb friction, N m, and of viscous friction,
    N m s/rad, that both directions share, by their lines in the budget.
    """

    scale: Scale
    common: dict[str, tuple[float, float]] = field(default_factory=dict)
    results: dict[str, Quantity] = field(default_factory=dict)
    tables: dict[str, Table] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    def add(self, name: str, estimate: Uncertain, unit: str, dof: float | None = None) -> None:
        """Add a result that scales with the torque constant."""
        value, u = estimate
        self.results[name] = self.scale.quantity(
            value, unit, [error_line(SCATTER_LINE, u, unit, dof)]
        )


def add_friction(fits: dict[int, DirectionFit], offset: Offset | None, found: Findings) -> None:
    """Add Coulomb, viscous and Stribeck parameters; `offset` is subtracted from each direction."""
    dof = {sign: float(fit.dof) for sign, fit in fits.items()}
    coulomb, viscous = ({s: getattr(f, n) for s, f in fits.items()} for n in ("coulomb", "viscous"))
    names = ("coulomb_friction", coulomb, "N m"), ("viscous_friction", viscous, "N m s/rad")
    for number, (name, values, unit) in enumerate(names):
        shared = {line: u[number] for line, u in found.common.items()}
        shift = None if number else offset
        _add_directions(found, name, values, unit, dof, shift, common=shared)
    if offset is not None:
        found.add("friction_offset", offset.offset, "N m")
        asymmetry, asymmetry_u = offset.asymmetry
        line = error_line("friction of both directions", asymmetry_u, "1")
        found.results["friction_asymmetry"] = combined(asymmetry, "1", [line])
        if not offset.separated:
            found.notes.append(SAME_COULOMB if offset.unknown else NOT_SEPARATED)
    elif len(fits) == 1:
        only = DIRECTION_NAMES[next(iter(fits))]
        found.notes.append(
            f"only the {only} direction was held: a constant torque cannot be separated from "
            "Coulomb friction and is part of it"
        )
    velocity = {s: v for s, f in fits.items() if (v := f.stribeck_velocity) is not None}
    static = {s: v for s, f in fits.items() if (v := f.static) is not None}
    if not velocity:
        lowest = max(fit.lowest for fit in fits.values())
        held = " and ".join(DIRECTION_NAMES[sign] for sign in fits)
        found.notes.append(
            f"the data do not resolve a Stribeck effect in {held} direction: Coulomb and "
            f"viscous friction are a line above {lowest:.3g} rad/s"
        )
    _add_directions(found, "stribeck_velocity", velocity, "rad/s", dof, by_constant=False)
    _add_directions(found, "stribeck_static_friction", static, "N m", dof, offset)
    found.tables["friction_model"] = model_table(fits)


def _add_directions(
    found: Findings,
    name: str,
    values: dict[int, Uncertain],
    unit: str,
    dof: Mapping[int, float],
    offset: Offset | None = None,
    by_constant: bool = True,
    common: Mapping[str, float] = MappingProxyType({}),
) -> None:
    """Add the mean over directions, and each direction without the offset.

    `dof` are the degrees of freedom of each direction's scatter; `common` are standard
    uncertainties that all of them share, by their lines in the budget.
    """
    if not values:
        return

    def state(name: str, value: float, scatter: Component, sign: int | None = None) -> None:
        lines = [
            scatter,
            *(error_line(line, shared, unit) for line, shared in common.items()),
        ]
        if offset is not None and sign is not None:
            value -= sign * offset.offset[0]
            apart = math.hypot(offset.offset[1], offset.unknown)
            lines.append(error_line("constant torque", apart, unit))
        quantity = found.scale.quantity if by_constant else combined
        found.results[name] = quantity(value, unit, lines)

    parts = {s: error_line(SCATTER_LINE, u, unit, dof[s]) for s, (_, u) in values.items()}
    mean = combined(
        float(np.mean([value for value, _ in values.values()])),
        unit,
        [replace(part, sensitivity=1 / len(parts)) for part in parts.values()],
    )
    both = error_line(SCATTER_LINE, mean.u or 0.0, unit, mean.dof)
    state(name, mean.value, both)
    for sign, (value, _) in values.items():
        state(f"{name}_{DIRECTION_NAMES[sign]}", value, parts[sign], sign)


def add_breakaway(unloaded: Breakaway, found: Findings) -> None:
    """Add the spread of breakaway torque over positions and directions [7.1.2.1]."""
    ends = {"min": unloaded.lowest} | ({} if unloaded.stuck else {"max": unloaded.highest})
    for name, value in ends.items():
        if unloaded.dof > 0:
            found.add(f"breakaway_torque_{name}", (value, unloaded.scatter), "N m", unloaded.dof)
        else:
            reason = "too few positions to separate scatter from repeatable ripple around the turn"
            found.results[f"breakaway_torque_{name}"] = Quantity(value, "N m", reason=reason)


def add_flatness(curve: TorqueSpeed, found: Findings) -> None:
    """Add the rms of the torque-speed curve with all compensation on [7.2.2, Fig. 34]."""
    rest = curve.torque[np.abs(curve.speed) >= TANH_DONE]
    if len(rest):
        found.results["compensated_torque_rms"] = Quantity(
            float(np.std(rest)), "N m", reason="a measure of scatter itself"
        )


def add_static_friction(
    unloaded: Breakaway | None,
    fits: dict[int, DirectionFit],
    offset: Offset | None,
    found: Findings,
) -> None:
    """Add static friction: the mean breakaway torque around the turn [7.1.2.1], else the fit's."""
    if unloaded is not None and math.isfinite(unloaded.level.u):
        mean = unloaded.level
        found.add("static_friction", (mean.value, mean.u), "N m", mean.dof)
        if offset is not None:
            middle, (constant, u) = unloaded.middle, offset.offset
            for sign, name in DIRECTION_NAMES.items():
                value = mean.value + sign * (middle.value - constant)
                total = math.hypot(mean.u, middle.u, u)
                found.add(f"static_friction_{name}", (value, total), "N m", mean.dof)
        return
    if unloaded is not None and not unloaded.stuck:
        found.notes.append(
            "breakaway gives no static friction: both directions broke away at "
            f"{unloaded.paired} positions, 2 are needed"
        )
    static = {s: known for s, fit in fits.items() if (known := fit.static) is not None}
    if static:
        dof = {sign: float(fits[sign].dof) for sign in static}
        _add_directions(found, "static_friction", static, "N m", dof, offset)
        found.notes.append(
            "static friction is the Stribeck model's, extrapolated to standstill, not that of "
            "breakaway"
        )


# -- tables


def torque_speed_table(curve: TorqueSpeed, label: str) -> Table:
    """Return the torque-speed curve of a sweep (Fig. 30, 32, 34)."""
    return Table(
        ("speed",),
        {
            "speed": Column(curve.speed, "rad/s"),
            "torque": Column(curve.torque, "N m", "of the controller, without feed-forward"),
            "u": Column(curve.u, "N m", "standard uncertainty from scatter within the bin"),
            "dof": dof_column(curve.dof),
            "revolutions": Column(curve.revolutions, "1", "whole turns averaged"),
        },
        signal="torque",
        description=f"Torque against speed, {label}",
    )


def holds_table(holds: Holds, *, settled: bool = False) -> Table:
    """Return mean torque by constant speed, with `settled` also the time left out."""
    order = np.argsort(holds.speed, kind="stable")
    columns = {
        "speed": Column(holds.speed[order], "rad/s"),
        "torque": Column(holds.torque[order], "N m", "mean over whole turns"),
        "u": Column(holds.u[order], "N m", "standard uncertainty from scatter"),
        "dof": dof_column(holds.dof[order]),
        "revolutions": Column(holds.revolutions[order], "1", "whole turns averaged"),
    }
    if settled:
        columns["settled"] = Column(holds.settled[order], "s", "left out at the start")
    return Table(("speed",), columns, "torque", "Torque at constant speeds")


def model_table(fits: dict[int, DirectionFit]) -> Table:
    """Return the curve of the chosen friction model, over the speeds of its fit."""
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


def ramp_table(ramps: list[TorqueRamp], time: Array, angle: Array, torque: Array) -> Table:
    """Return the ramp with the highest breakaway torque (Fig. 22)."""
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
        description="The ramp with the highest breakaway torque",
    )
