"""`stribeck --against` on constant speeds: the difference of two curves, speed by speed."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from rigtool.errors import InsufficientDataError, UsageError, naming
from rigtool.experiments.friction.holds import SAME_SPEED
from rigtool.experiments.friction.results import Findings
from rigtool.numerics.arrays import Array
from rigtool.quantity import Quantity
from rigtool.runfile import Column, Run, Table, dof_column

HOLD_TABLE = "holds"

RATIO_RESULT = "ratio_of_differences"

MIN_EXTRA_SPEEDS = 3
"""Common speeds beyond the number of parameters that show their scatter."""

_Curve = tuple[Array, Array, Array, Array]
"""Speed (n,), torque (n,), its u (n,) and the degrees of freedom of that (n,)."""


def require_different(runs: Sequence[Run], against: Run | None, reference: Run | None) -> None:
    """Raise `UsageError` where one run is compared with itself."""
    given = [*runs, *(run for run in (against, reference) if run is not None)]
    if against is not None and len({run.content_sha256 for run in given}) < len(given):
        raise UsageError("one run is given twice: nothing changed between a run and itself")


def add_curve_difference(
    found: Findings, against: Run, reference: Run | None, unit: str = "N m"
) -> None:
    """Add the difference of the held curve against that of another run of `stribeck`.

    d torque = dfc sign(v) + dfv v + doffset, by weighted least squares over the speeds in common;
    and the ratio to the difference of a `reference`. The curve is stored in `unit`. Raises
    `UsageError` for a run without curve or in other units, `InsufficientDataError` for too few
    common speeds.
    """
    mine = _curve(found.tables[HOLD_TABLE])
    speed, difference, u, u_dof = _minus(mine, _other(against, unit))
    sign = np.sign(speed)
    columns = {"coulomb_friction_difference": (sign, "N m")}
    columns["viscous_friction_difference"] = (speed, "N m s/rad")
    if sign.min() < sign.max():
        columns["friction_offset_difference"] = (np.ones(len(speed)), "N m")
    if len(speed) < len(columns) + MIN_EXTRA_SPEEDS:
        raise InsufficientDataError(
            f"{len(speed)} speeds are common to {against.path} and this curve, "
            f"{len(columns) + MIN_EXTRA_SPEEDS} are needed: hold the same speeds in both"
        )
    design = np.column_stack([values for values, _ in columns.values()]) / u[:, None]
    parameters = np.linalg.lstsq(design, difference / u)[0]
    left = difference / u - design @ parameters
    dof = len(speed) - len(columns)
    # Scatter beyond the stated u counts.
    excess = max(1.0, float(left @ left) / dof)
    spread = np.sqrt(np.diag(np.linalg.inv(design.T @ design)) * excess)
    for (name, (_, unit)), value, own in zip(columns.items(), parameters, spread, strict=True):
        found.add(name, (float(value), float(own)), unit, float(dof))
    found.notes.append(
        f"differences are this curve minus that of {against.path}, at {len(speed)} common speeds"
    )
    found.tables["hold_differences"] = Table(
        ("speed",),
        {
            "speed": Column(speed, "rad/s"),
            "difference": Column(difference, "N m", "of the mean torques"),
            "u": Column(u, "N m", "standard uncertainty"),
            "dof": dof_column(u_dof),
            "model": Column(design @ parameters * u, "N m", "the same of the fitted change"),
        },
        "difference",
        "Change of the torque at constant speeds",
    )
    if reference is not None:
        others = [_other(run, unit) for run in (against, reference)]
        with naming(reference.path):
            found.results[RATIO_RESULT] = _ratio(mine, *others)


def _ratio(mine: _Curve, base: _Curve, other: _Curve) -> Quantity:
    """Return the ratio of two differences against one curve: weighted least squares over speeds.

    Errors of the known difference would lower the ratio, and those of the curve that both share
    move it towards one: both are subtracted from the sums (W. A. Fuller, Measurement Error Models,
    1987, section 2.2).
    """
    known = _minus(other, base)
    this = _minus(mine, base)
    at = [int(np.argmin(np.abs(known[0] - speed))) for speed in this[0]]
    both = np.abs(known[0][at] - this[0]) <= SAME_SPEED * np.abs(this[0])
    x, x_u = (values[at][both] for values in known[1:3])
    y, y_u = (values[both] for values in this[1:3])
    shared = np.array([base[2][np.argmin(np.abs(base[0] - one))] for one in this[0][both]])
    if len(y) < 1 + MIN_EXTRA_SPEEDS:
        raise InsufficientDataError(
            f"{len(y)} speeds are common to all three runs, {1 + MIN_EXTRA_SPEEDS} are needed: "
            "hold the same "
            "speeds in all"
        )
    weight = 1 / (x_u**2 + y_u**2)
    value = float(np.sum(weight * x * y) / np.sum(weight * x**2))
    for _ in range(10):  # weights follow the ratio
        weight = 1 / (y_u**2 + (value * x_u) ** 2 - 2 * value * shared**2)
        value = float(np.sum(weight * (x * y - shared**2)) / np.sum(weight * (x**2 - x_u**2)))
    power = float(np.sum(weight * (x**2 - x_u**2)))
    if not power > MIN_EXTRA_SPEEDS**2:
        raise InsufficientDataError(
            "the known change is not larger than its uncertainty: no ratio can be stated"
        )
    excess = max(1.0, float(np.sum(weight * (y - value * x) ** 2)) / (len(y) - 1))
    u = math.sqrt(excess / power)
    return Quantity(value, "1", u, float(len(y) - 1))


def _curve(table: Table) -> _Curve:
    """Return speed, torque, u and its degrees of freedom of the holds in a table; repeats of a
    speed stay apart."""
    return table["speed"], table["torque"], np.maximum(table["u"], 1e-12), table["dof"]


def _other(run: Run, unit: str) -> _Curve:
    run.require_command("stribeck")
    if HOLD_TABLE not in run.tables:
        raise UsageError(f"{run.path}: holds no curve of constant speeds: give a run that has one")
    if (stored := run.table(HOLD_TABLE).columns["torque"].unit) != unit:
        raise UsageError(
            f"{run.path} holds {stored}, this curve {unit}: analyse both with --kt, or both without"
        )
    return _curve(run.table(HOLD_TABLE, "speed", torque=unit, u=unit, dof="1"))


def _minus(curve: _Curve, other: _Curve) -> _Curve:
    """Return the difference of two curves at their common speeds.

    Degrees of freedom by Welch and Satterthwaite (GUM G.4.1).
    """
    speed = curve[0]
    at = np.array([int(np.argmin(np.abs(other[0] - one))) for one in speed])
    both = np.abs(other[0][at] - speed) <= SAME_SPEED * np.abs(speed)
    torque, u, dof = (values[both] for values in curve[1:])
    other_torque, other_u, other_dof = (values[at][both] for values in other[1:])
    total = np.hypot(u, other_u)
    with np.errstate(divide="ignore"):  # both are infinite
        dof = total**4 / (u**4 / dof + other_u**4 / other_dof)
    return speed[both], torque - other_torque, total, dof
