"""`export` of what was learned: the choice of the format, and its file."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rigtool.errors import UsageError
from rigtool.experiments.deploy import drive_formats as texts
from rigtool.experiments.deploy.c_header import header
from rigtool.experiments.deploy.position_map import PositionMap, position_map
from rigtool.experiments.deploy.stored_sensor import sensor
from rigtool.experiments.learning.learned_table import LearnedTable
from rigtool.experiments.learning.stored_table import learned_table_from, of_another_calibration
from rigtool.experiments.torque_per_ampere import learned_constant, torque_per_ampere
from rigtool.runfile import Run
from rigtool.runfile.export import write_new

SENSOR_FORMAT = "c-sensor"
"""Format of the force model that was learned beside the table."""

EXPORT_FORMATS: Mapping[str, tuple[str, ...]] = {
    "c": (".h",),
    "c-int16": (".h",),
    "table": (".csv", ".json", ".mat"),
    "moteus": (".cfg",),
    "odrive": (".csv", ".json"),
    "fourier": (".csv", ".json"),
    SENSOR_FORMAT: (".h",),
}
"""Formats of a learned table, and the endings of their files; the first format of an ending is what
it means by itself."""

DRIVE_UNITS = {"moteus": "A", "odrive": "N m"}
"""Units in which drives take a map; other formats have the table's own."""

SAME_CONSTANT = 1e-6
"""Relative difference within which two torque constants are the same."""

MAP_FORMATS = ("moteus", "odrive", "fourier")
"""Formats that hold the turn at one speed."""


def chosen_format(run: Run, output: Path, part: str | None, wanted: str | None) -> str | None:
    """Return the chosen format of a learned table; None for the run's own formats.

    Raises `UsageError` where format, file and run do not go together.
    """
    ending = output.suffix
    if wanted is None:
        alone = run.command == "ilc-learn" and ending == ".csv" and part is None
        if not alone and ending not in (".h", ".json", ".cfg"):
            return None
        wanted = next(name for name, endings in EXPORT_FORMATS.items() if ending in endings)
    if part is not None:
        raise UsageError(f"--part {part}: --format {wanted} holds the learned table; leave one out")
    if ending not in EXPORT_FORMATS[wanted]:
        raise UsageError(
            f"{output}: --format {wanted} is written as {' or '.join(EXPORT_FORMATS[wanted])}, not "
            f"{ending or 'without ending'!r}"
        )
    return wanted


def export_table(
    run: Run, output: Path, wanted: str, *, speed: float | None, kt: Run | None, overwrite: bool
) -> tuple[str, ...]:
    """Write a learned table, or the sensor; return remarks: the loss by rounding, what is omitted.

    `speed`, rad/s, and `kt`, current to torque, are for the formats that need them. Raises
    `UsageError` where they are missing or do not apply.
    """
    if wanted == SENSOR_FORMAT:
        if speed is not None:
            raise UsageError(f"--speed is for {', '.join(MAP_FORMATS)}: {wanted} holds all speeds")
        text, notes, inputs = sensor(run, kt)
        write_new(output, overwrite, lambda path: _write(path, text), inputs)
        return notes
    learned = learned_table_from(run)
    remarks: list[str] = []
    contents: str | dict[str, Any]
    if wanted in MAP_FORMATS:
        require_own_calibration(run, kt)
        turn = in_unit(position_map(learned.table, learned.u, speed), learned, wanted, kt)
        contents, lost = _map_text(learned, turn, wanted, output)
        remarks += turn.remarks(DRIVE_UNITS.get(wanted, learned.unit))
        remarks += calibration_remarks(learned, kt)
    else:
        for option, value in (("--speed", speed), ("--kt", kt)):
            if value is not None:
                raise UsageError(
                    f"{option} is for {', '.join(MAP_FORMATS)}: {wanted} holds all speeds"
                )
        contents, lost = _table_contents(learned, output, wanted)
    inputs = [run.path] if kt is None else [run.path, kt.path]
    write_new(output, overwrite, lambda path: _write(path, contents), inputs)
    remarks += learned.friction_lines()
    return (f"lost {lost}", *remarks)


def in_unit(turn: PositionMap, learned: LearnedTable, wanted: str, kt: Run | None) -> PositionMap:
    """Return the map in the unit that the drive takes: moteus A, ODrive N m.

    A table that states the constant of its currents gives those, whatever `kt` states. Raises
    `UsageError` where the calibration is missing, or does not apply.
    """
    needed = DRIVE_UNITS.get(wanted, learned.unit)
    if needed == learned.unit:
        if kt is not None:
            raise UsageError(f"--kt: {wanted} takes the table's own unit, {needed}; leave it out")
        return turn
    if {needed, learned.unit} != {"A", "N m"}:
        raise UsageError(f"the table holds {learned.unit}, {wanted} takes {needed}: learn torque")
    if learned.constant is not None:
        return turn.scaled(1 / learned.constant)
    if kt is None:
        raise UsageError(
            f"--kt is missing: {wanted} takes {needed}, the table holds {learned.unit}; give a run "
            "of calibrate-kt of the motor"
        )
    constant = torque_per_ampere(kt).value
    return turn.scaled(1 / constant if needed == "A" else constant)


def require_own_calibration(run: Run, kt: Run | None) -> None:
    """Raise `UsageError` where only `kt` makes current of a table, and it is not the table's own:
    the current would not be the one that was learned."""
    if kt is None or learned_constant(run) is not None or not of_another_calibration(run, kt):
        return
    raise UsageError(
        f"{run.path}: was learned with another calibration than {kt.path.name}, with which its "
        "current would not be the one that was learned: give that calibration, or analyse it again "
        f"with this one: rigtool ilc-learn {run.path.name} --kt {kt.path.name} -o FILE"
    )


def calibration_remarks(learned: LearnedTable, kt: Run | None) -> list[str]:
    """Return a remark where a calibration states another constant than that of the currents."""
    if kt is None or learned.constant is None:
        return []
    stated = torque_per_ampere(kt).value
    if math.isclose(stated, learned.constant, rel_tol=SAME_CONSTANT):
        return []
    return [
        f"currents are those that were learned, by {learned.constant * 1e3:.5g} mN m/A; "
        f"{kt.path.name} states {stated * 1e3:.5g} mN m/A, which does not change them"
    ]


def _map_text(
    learned: LearnedTable, turn: PositionMap, wanted: str, output: Path
) -> tuple[str, str]:
    if wanted == "moteus":
        return texts.moteus(learned, turn)
    write = texts.odrive if wanted == "odrive" else texts.fourier
    return write(learned, turn, as_json=output.suffix == ".json")


def _table_contents(
    learned: LearnedTable, output: Path, wanted: str
) -> tuple[str | dict[str, Any], str]:
    if wanted in ("c", "c-int16"):
        return header(learned, output.stem, short=wanted == "c-int16")
    if output.suffix == ".mat":
        return texts.table_matlab(learned)
    return texts.table_csv(learned) if output.suffix == ".csv" else texts.table_json(learned)


def _write(path: Path, contents: str | dict[str, Any]) -> None:
    if isinstance(contents, str):
        path.write_text(contents, encoding="utf-8")
        return
    from scipy.io import savemat

    savemat(str(path), contents, appendmat=False, do_compression=True, oned_as="column")
