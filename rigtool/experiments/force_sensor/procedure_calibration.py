"""Whether a calibration belongs to the rig and to its tables, and what of it is later than they.

Tables hold what the motor's current does in N m, by the calibration that they were learned with.
Another calibration may have another torque constant k, by which one of both is wrong, or the motor
has changed since. It may have another zero of the current, which is that of the amplifier now.
"""

from __future__ import annotations

import math
from dataclasses import replace

from rigtool.errors import RunFileError
from rigtool.experiments.force_model.force_model import ForceModel
from rigtool.experiments.force_model.stored import CONSTANT, MODEL_PREFIX, OFFSET
from rigtool.experiments.torque_per_ampere import torque_per_ampere_at
from rigtool.quantity import REFERENCE_DEGC, Quantity
from rigtool.recipe import Recipe
from rigtool.runfile import Run

OTHER_MOTOR = 1.5
"""Ratio of a calibrated torque constant to the data sheet's from which on it is another motor's."""

ANOTHER = 2.0
"""Standard deviations by which two calibrations differ from which on they are not of one motor."""


def require_calibration(kt: Run, recipe: Recipe) -> None:
    """Raise `RunFileError` unless a calibration may be that of the recipe's rig."""
    kt.require_command("calibrate-kt")
    constant = torque_per_ampere_at(kt, REFERENCE_DEGC).value
    stated = recipe.rig.torque_constant
    if not 1 / OTHER_MOTOR < constant / stated < OTHER_MOTOR:
        raise RunFileError(
            f"{kt.path}: states {constant:.4g} N m/A, the recipe's rig.torque_constant is "
            f"{stated:g} N m/A, and {OTHER_MOTOR:g} times more or less is another motor: give the "
            "calibration of this one, or correct the recipe"
        )
    if kt.rig not in (None, recipe.rig.name):
        raise RunFileError(
            f"{kt.path}: is the calibration of rig {kt.rig}, the recipe is that of "
            f"{recipe.rig.name}: calibrate this one"
        )


def with_zero_of(model: ForceModel, kt: Run) -> ForceModel:
    """Return the model with the zero of the amplifier's current that a calibration states."""
    if "amplifier_offset" not in kt.results:
        return model
    known = replace(model.learned.known, offset=kt.result("amplifier_offset", "A").value)
    return replace(model, learned=replace(model.learned, known=known))


def torque_per_current(model: ForceModel, kt: Run) -> float:
    """Return torque on the output per ampere, N m/A."""
    return model.learned.known.torque_factor * torque_per_ampere_at(kt, REFERENCE_DEGC).value


def changes(tables: Run, kt: Run, model: ForceModel) -> tuple[float, float, list[str]]:
    """Return what a calibration other than that of the tables adds to u, N m and a share of the
    torque, and notes. Differences within `ANOTHER` u of both are none.

    A zero that has moved by c since may have moved by as much again: c is its standard uncertainty.
    """
    share, notes = changed_constant(tables, kt)
    by, moved = changed_zero(tables, kt, model)
    if by:
        notes.append(
            f"{kt.path} states a zero of the current that has moved by {moved * 1e3:.3g} mA "
            f"since {tables.path} was learned: it is taken from there, and u is wider by "
            f"{by * 1e3:.3g} mN m, as it may have moved by as much again"
        )
    return by, share, notes


def changed_constant(tables: Run, kt: Run) -> tuple[float, list[str]]:
    """Return the share of the torque by which another torque constant widens u, and notes."""
    now = torque_per_ampere_at(kt, REFERENCE_DEGC)
    moved = _difference(tables, CONSTANT, now) / now.value
    if not moved:
        return 0.0, []
    return abs(moved), [
        f"{kt.path} states a torque constant that differs by {100 * moved:+.2f} % from that "
        f"which {tables.path} was learned with: u is wider by this share of the torque, as "
        "either may be wrong; learn again with this calibration"
    ]


def changed_zero(tables: Run, kt: Run, model: ForceModel) -> tuple[float, float]:
    """Return by how much, N m on the output and A, the zero of the current has moved since."""
    stated = kt.results.get("amplifier_offset")
    moved = 0.0 if stated is None else _difference(tables, OFFSET, stated)
    return abs(moved) * torque_per_current(model, kt), moved


def _difference(tables: Run, name: str, now: Quantity) -> float:
    """Return by how much a value is off that of the tables, 0 where they do not differ."""
    if MODEL_PREFIX + name not in tables.results:
        return 0.0
    then = tables.result(MODEL_PREFIX + name, now.unit)
    change = now.value - then.value
    return change if abs(change) > ANOTHER * math.hypot(then.u or 0.0, now.u or 0.0) else 0.0
