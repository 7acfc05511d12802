"""Values of run files by name, for the page that compares them with the thesis.

An expression is one address or several with " / ", " * " and " - " between them, from left to
right:

    torque_constant                       a result
    lookup.torque[speed=6.28]             a column of a table at the nearest point of its axes
    peak sweep.on                         rms, peak, span or mean of a column or a signal
    rms feedforward.residual[position=425..1275]
    force-pulley:std_torque_no_load       a result of another run
    recipe.rig.current_limit              a setting of the run's recipe
    0.02                                  a plain number
    special.low_current_exit              see `SPECIAL_VALUES`
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from rigtool.errors import InsufficientDataError, RunFileError, UsageError
from rigtool.quantity import Quantity
from rigtool.report.published import published

if TYPE_CHECKING:
    from rigtool.recipe import Recipe
    from rigtool.runfile import Run, Table

Runs = Mapping[str, "Run"]

AS_SET = "as set in the recipe"
NOT_KNOWN = "the curve's own uncertainty is not known"

_ADDRESS = re.compile(
    r"(?:(?P<reduce>rms|peak|span|mean) )?(?:(?P<run>[\w-]+):)?"
    r"(?P<name>\w+)(?:\.(?P<column>\w+)(?:\[(?P<where>[^]]+)\])?)?"
)
_REDUCE: dict[str, Callable[[np.ndarray], float]] = {
    "rms": lambda values: float(np.sqrt(np.mean(values**2))),
    "peak": lambda values: float(np.max(np.abs(values))),
    "span": lambda values: float(np.ptp(values)),
    "mean": lambda values: float(np.mean(values)),
}


def published_entry(path: str) -> Any:
    """Return the entry at a dotted path of `published.toml`: a value with section, or a list.

    Raises `KeyError` where there is none.
    """
    entry: Any = published()
    for name in path.split("."):
        entry = entry[name]
    return entry


def evaluate(expression: str, runs: Runs, run: str) -> Quantity:
    """Return the value of an expression; addresses without a run refer to `run`.

    Uncertainties are combined as those of independent values (GUM 5.1.2). Raises `UsageError` for
    a text that is no address, `RunFileError` for a value that the run does not hold.
    """
    first, *rest = re.split(r" ([-/*]) ", expression)
    found = _operand(first, runs, run)
    for sign, operand in zip(rest[::2], rest[1::2], strict=True):
        found = _combine(found, sign, _operand(operand, runs, run))
    return found


def _operand(text: str, runs: Runs, run: str) -> Quantity:
    if re.fullmatch(r"[\d.]+(e-?\d+)?", text):
        return Quantity(float(text), "1", 0.0)
    if text.startswith("recipe."):
        return _of_recipe(text.removeprefix("recipe."), runs[run])
    if text.startswith("special."):
        return SPECIAL_VALUES[text.removeprefix("special.")](runs, run)
    match = _ADDRESS.fullmatch(text)
    if match is None:
        raise UsageError(f"{text!r}: is no address of a value (see {__name__})")
    source = runs[match["run"] or run]
    if match["column"] is None:
        return source.result(match["name"])
    if match["name"] in source.recordings:
        recording = source.recording(match["name"])
        values = recording.read(match["column"])
        return Quantity(
            _REDUCE[match["reduce"]](values), recording.units[match["column"]], reason=NOT_KNOWN
        )
    table = source.table(match["name"])
    return _of_table(table, match["column"], match["where"] or "", match["reduce"])


def _combine(left: Quantity, sign: str, right: Quantity) -> Quantity:
    if sign == "-":
        value, unit = left.value - right.value, left.unit
        parts = [left.u, right.u]
    else:
        value = left.value * right.value if sign == "*" else left.value / right.value
        unit = _unit(left.unit, sign, right.unit)
        parts = [None if part.u is None else part.u / part.value * value for part in (left, right)]
    known = [part for part in parts if part is not None]
    if len(known) < len(parts):
        return Quantity(value, unit, reason=left.reason or right.reason or NOT_KNOWN)
    return Quantity(value, unit, math.hypot(*known))


def _unit(left: str, sign: str, right: str) -> str:
    """Return the unit of a product or quotient, for the units that the page needs."""
    if right == "1":
        return left
    if left == right and sign == "/":
        return "1"
    if left == "1" and sign == "*":
        return right
    if (left, sign, right) in _UNITS:
        return _UNITS[left, sign, right]
    return f"{left} {right}" if sign == "*" else f"{left}/({right})"


ON_THE_GRID = 1e-9
"""Of the range of an axis: a point that is nearer to an end belongs to it."""

_UNITS = {
    ("N m", "/", "m"): "N",
    ("A", "*", "N m/A"): "N m",
    ("1", "/", "rad/(N m)"): "N m/rad",
    ("1", "/", "rad/s"): "s",
    ("rad", "/", "rad/s"): "s",
}


def _of_recipe(path: str, run: Run) -> Quantity:
    value: Any = _recipe(run)
    for name in path.split("."):
        value = getattr(value, name)
    return Quantity(float(value), _RECIPE_UNITS.get(name, "1"), reason=AS_SET)


_RECIPE_UNITS = {"current_limit": "A", "lowpass_hz": "Hz", "grasper_length": "m"}


def _recipe(run: Run) -> Recipe:
    if run.recipe is None:
        raise RunFileError(f"{run.path}: holds no recipe: make it again from one")
    return run.recipe


def _of_table(table: Table, column: str, where: str, reduce: str | None) -> Quantity:
    index: list[slice | int] = [slice(None)] * len(table.axes)
    for condition in filter(None, where.split(",")):
        axis, _, wanted = condition.partition("=")
        places = np.asarray(table[axis], dtype=np.float64)
        if ".." in wanted:
            low, high = (float(end) for end in wanted.split(".."))
            near = ON_THE_GRID * (places[-1] - places[0])
            first = int(np.searchsorted(places, low - near))
            index[table.axes.index(axis)] = slice(
                first, int(np.searchsorted(places, high + near, side="right"))
            )
        else:
            index[table.axes.index(axis)] = int(np.argmin(np.abs(places - float(wanted))))
    values = np.asarray(table[column], dtype=np.float64)[tuple(index)]
    unit = table.columns[column].unit
    if reduce is not None:
        return Quantity(_REDUCE[reduce](values), unit, reason=NOT_KNOWN)
    if values.size != 1:
        raise UsageError(f"{column}[{where}]: holds {values.size} values: select one")
    u = f"{column}_u" if f"{column}_u" in table.columns else "u"
    if u in table.columns and (u != "u" or column == table.signal):
        return Quantity(float(values), unit, float(np.asarray(table[u])[tuple(index)]))
    return Quantity(float(values), unit, reason=NOT_KNOWN)


def low_current_refusal(runs: Runs, run: str) -> str:
    """Return why `stribeck` refuses the holds of a run, "" where it does not [App. C]."""
    from rigtool.experiments.friction.procedure_analysis import HOLD_RECORDING, coulomb_and_viscous

    try:
        coulomb_and_viscous(runs[run].recording(HOLD_RECORDING), _recipe(runs[run]), runs["kt"])
    except InsufficientDataError as error:
        return str(error)
    return ""


def _low_current_exit(runs: Runs, run: str) -> Quantity:
    code = InsufficientDataError.exit_code if low_current_refusal(runs, run) else 0
    return Quantity(code, "1", reason="an exit code")


def _phase_advance_of_published_transfer(runs: Runs, run: str) -> Quantity:
    from rigtool.control.position_loop import TransferFunction
    from rigtool.experiments.learning.filters import zpetc

    stated = published_entry("transfer")
    system = TransferFunction.from_z(
        stated["numerator"], stated["denominator"], stated["sample_time"]
    )
    # Its zero near 1.0008 is a rounded 1: a radius slightly above 1 includes it.
    advance = zpetc(system, cancel_radius=1.01).advance
    return Quantity(advance, "1", reason="a whole number of samples")


def _learned_speed(runs: Runs, run: str) -> Quantity:
    """Return the highest learned speed of the output."""
    ratio = _recipe(runs[run]).rig.angle_ratio
    speeds = np.abs(np.asarray(runs[run].table("lookup")["speed"])) / ratio
    return Quantity(float(speeds.max()), "rad/s", reason=AS_SET)


SPECIAL_VALUES: dict[str, Callable[[Runs, str], Quantity]] = {
    "low_current_exit": _low_current_exit,
    "phase_advance_of_published_transfer": _phase_advance_of_published_transfer,
    "learned_speed": _learned_speed,
    "half_turn": lambda runs, run: Quantity(math.pi, "rad", 0.0),
}
"""Values that need more than one address."""
