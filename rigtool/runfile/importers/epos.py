"""Recorder exports of maxon's EPOS Studio, whose header describes everything except the rig.

Sampling period:;6.400                     ms
Index:;0x30D3;0x30D2;0x0000;0x0000         the object that each channel recorded
Subindex:;0x01;0x01;0x00;0x00
;Velocity actual value averaged;Torque actual value averaged
ms;rpm;%
0.000;161;30.7
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from rigtool.errors import RunFileError
from rigtool.recipe.mapping import FileLayout, Mapping, Signal
from rigtool.recipe.units import RATED, UNITS, unit_name
from rigtool.runfile.importers.header import Lines, decode, split_lines
from rigtool.runfile.importers.marks import NUMBER, marks_of, plain, split_fields
from rigtool.runfile.importers.raw import Importer, Raw, read_bytes, require_good
from rigtool.runfile.importers.text import read_numbers, words_of

OBJECTS = {
    0x6064: "position",
    0x6062: "position_setpoint",
    0x60E4: "output_position",
    0x606C: "speed",
    0x30D3: "speed",
    0x606B: "speed_setpoint",
    0x6077: "torque",
    0x30D2: "torque",
    0x6078: "current",
    0x30D1: "current",
    0x30D0: "current_setpoint",
}
"""Objects of the EPOS4 that have a fixed meaning here (EPOS4 Firmware Specification, maxon)."""

NAMED = {
    "position actual": "position",
    "position demand": "position_setpoint",
    "velocity actual": "speed",
    "velocity demand": "speed_setpoint",
    "torque actual": "torque",
    "current actual": "current",
    "current demand": "current_setpoint",
}
"""The same by the first two words of a channel's name, where somebody took the objects out."""

FEWEST_TIMES = 3
"""Times that show their period."""

OTHER_UNIT = 30.0
"""Ratio of the times' period and that of the header that rows taken out do not explain."""

_NAMES = (";", "time;", "Time;")
"""Beginnings of the line that names the channels."""

_HEADER_LINES = 60
_HEADED = re.compile(r"^\"?Index:[;,\t]\"?0x", re.MULTILINE)
_KEY = re.compile(r"^\"?[A-Z][A-Za-z. ]+:\"?([;,\t])", re.MULTILINE)
_NAME = re.compile(r"[^a-z0-9]+")
_ADDED = re.compile(r",(?!\d)")


def is_epos(path: Path) -> bool:
    """Return whether a file is such an export, from its first lines."""
    try:
        with path.open("rb") as stream:
            start = stream.read(4096)
    except OSError:
        return False
    text = start.decode("latin-1").replace("\x00", "")
    return "EPOS Studio Version:" in text or bool(_HEADED.search(text))


def read_epos(path: Path, mapping: Mapping, skip_bad: bool) -> tuple[Raw, Mapping, list[str]]:
    """Return the columns of an export, the mapping filled with the signals that it names, notes.

    Torque in percent becomes N m where `mapping` states the rated torque. A mapping with signals
    of its own keeps them: columns by the names in the file, `time` the first. [file] of a mapping
    holds for the lines of numbers. What a spreadsheet or a person added behind a comma is taken
    off, and what it made of semicolons is undone. Raises `RunFileError` for a header or lines that
    are damaged, or times that contradict the sampling period.
    """
    lines, notes = _as_exported(split_lines(decode(read_bytes(path)), mapping.file.comment))
    header = _header(path, lines)
    names_at = len(header)
    _require_one(path, lines, names_at)
    names = ["time", *(name.strip() for name in lines.text[names_at].split(";")[1:])]
    units = [unit.strip() for unit in lines.text[names_at + 1].split(";")]
    if len(names) != len(units):
        raise RunFileError(
            f"{path}, line {lines.number[names_at + 1]}: {len(units)} units for {len(names)} "
            "columns: export the recording again"
        )
    if not mapping.signals:
        signals, more = _signals(path, header, names, units, mapping)
        notes += more
        filled = {**mapping.model_dump(), "signals": signals}
        mapping = Mapping.model_validate(filled)
    data = lines.after(names_at + 2)
    marks = marks_of(
        data.text, FileLayout(delimiter=mapping.file.delimiter or ";", decimal=mapping.file.decimal)
    )
    raw = read_numbers(path, data, marks, mapping.columns, names, skip_bad, words_of(mapping))
    _require_period(path, header, raw, mapping)
    return raw, mapping, [*notes, *_missing(path, header, data, skip_bad)]


def _require_period(
    path: Path, header: dict[tuple[int, str], list[str]], raw: Raw, mapping: Mapping
) -> None:
    """Raise `RunFileError` where the times do not rise by the sampling period of the header, ms."""
    _, stated = _field(header, "Sampling period")
    times = raw.columns.get(mapping.signals["time"].column) if "time" in mapping.signals else None
    if not stated or times is None or len(times) < FEWEST_TIMES:
        return
    found = re.match(r"[\d.,]+", stated[0].strip())
    period = float(found[0].replace(",", ".")) * 1e-3 if found else 0.0
    steps = np.diff(times) * mapping.signals["time"].scale * mapping.factor("time")
    ratio = float(np.median(steps)) / period if period > 0 else 1.0
    if not 1 / OTHER_UNIT < ratio < OTHER_UNIT:
        raise RunFileError(
            f"{path}: its times rise by {period * ratio:.4g} s, its header states a period of "
            f"{period:.4g} s: correct the unit of the times, or the header"
        )


def _as_exported(lines: Lines) -> tuple[Lines, list[str]]:
    """Return the lines without what was added behind a comma, and notes on what that said.

    A comma before a digit is a decimal mark, any other begins a cell of a spreadsheet or a remark.
    A spreadsheet may also have saved with commas or tabs, in quotes, and with empty cells behind;
    words in cells behind the columns are remarks, too.
    """
    marks = _KEY.findall("\n".join(lines.text[:_HEADER_LINES]))
    mark = max(set(marks), key=marks.count) if marks else ";"
    parts = [_ADDED.split(_with_semicolons(line, mark), maxsplit=1) for line in lines.text]
    names_at = next((n for n, part in enumerate(parts) if part[0].startswith(_NAMES)), len(parts))
    for part in parts[names_at + 1 :]:
        cells = part[0].split(";")
        width = parts[names_at][0].count(";") + 1
        more = [cell.strip() for cell in cells[width:] if cell.strip()]
        if more and not all(NUMBER.fullmatch(plain(cell, ",")) for cell in more):
            part[:] = [";".join(cells[:width]), ", ".join([*more, *part[1:]])]
    notes = [
        f"line {number}: remark {remark!r} left out"
        for (_, *added), number in zip(parts, lines.number, strict=True)
        if added and (remark := added[0].strip(' ,"\t'))
    ]
    kept = [
        (part[0], number)
        for part, number in zip(parts, lines.number, strict=True)
        if part[0].strip()
    ]
    texts, numbers = [text for text, _ in kept], [number for _, number in kept]
    return Lines(texts, numbers, lines.whole), notes


def _with_semicolons(line: str, mark: str) -> str:
    """Return a line as EPOS Studio writes it, without empty cells at its end."""
    if mark != ";":
        line = ";".join(split_fields(line, mark))
    elif line.startswith('"') and ";" in line:
        line = line.rstrip('", \t')[1:].replace('""', '"')
    return line.rstrip("; \t")


def _header(path: Path, lines: Lines) -> dict[tuple[int, str], list[str]]:
    """Return the header by number of its line and key; the line of names follows it."""
    header: dict[tuple[int, str], list[str]] = {}
    for at, (number, line) in enumerate(zip(lines.number, lines.text, strict=True)):
        if at + 1 >= len(lines.text) or at >= _HEADER_LINES:
            break
        if line.startswith(_NAMES):
            return header
        key, *values = line.split(";")
        header[number, key.rstrip(":")] = values
    raise RunFileError(
        f"{path}: is an export of EPOS Studio without names and units of its channels: it was cut "
        "short; export it again"
    )


def _require_one(path: Path, lines: Lines, names_at: int) -> None:
    """Raise `RunFileError` where another recording follows the first."""
    begin = None  # of lines of a header
    for at in range(names_at + 1, len(lines.text)):
        line = lines.text[at]
        if _KEY.match(line):
            begin = at if begin is None else begin
        elif begin is None or not line.startswith(_NAMES):
            begin = None
        else:
            raise RunFileError(
                f"{path}, line {lines.number[begin]}: another recording begins here, and a file "
                "holds one: save each in a file of its own, from its header to its last sample, "
                "and import the folder"
            )


def _field(header: dict[tuple[int, str], list[str]], key: str) -> tuple[int, list[str]]:
    """Return the number of the line of a key, and its values."""
    found = ((number, values) for (number, name), values in header.items() if name == key)
    return next(found, (0, []))


def _signals(
    path: Path,
    header: dict[tuple[int, str], list[str]],
    names: list[str],
    units: list[str],
    mapping: Mapping,
) -> tuple[dict[str, Signal], list[str]]:
    """Return the signals of an export, and notes on channels that are left out."""
    line, values = _field(header, "Index")
    try:
        indices = [int(value, 16) for value in values]
    except ValueError:
        raise RunFileError(
            f"{path}, line {line}: {'; '.join(values)[:80]!r} are no objects such as 0x30D3: "
            "correct the line, or give a mapping with [signals]"
        ) from None
    signals: dict[str, Signal] = {}
    notes = []
    for number, (name, unit) in enumerate(zip(names, units, strict=True)):
        index = indices[number - 1] if 0 < number <= len(indices) else 0
        signal, unit = _meaning(name if number else "time", index, unit, mapping)
        if unit not in (*UNITS, RATED):
            if number == 0:
                raise RunFileError(
                    f"{path}: its times are in {unit!r}, an unknown unit: correct the line of "
                    "units, or give a mapping with [signals]"
                )
            notes.append(
                f"channel {name!r} is in {unit!r}, an unknown unit, and was left out: a mapping "
                "with [signals] reads it"
            )
            continue
        if signal in signals:
            signal = f"{signal}_{number}"
        signals[signal] = Signal(column=number + 1, unit=unit, description=name if number else "")
    if len(signals) < 2:
        raise RunFileError(
            f"{path}: has no channel in a known unit, only {', '.join(units[1:])}: give a mapping "
            "with [signals] for this file"
        )
    return signals, notes


def _meaning(name: str, index: int, unit: str, mapping: Mapping) -> tuple[str, str]:
    """Return signal and unit of a channel."""
    words = " ".join(name.lower().split()[:2])
    plain = _NAME.sub("_", name.lower()).strip("_") or "channel"
    signal = OBJECTS.get(index, NAMED.get(words, plain))
    unit = unit_name(unit)
    if unit == "count":
        signal = {"position": "encoder"}.get(signal, f"{signal}_count")
    elif mapping.fixed_unit(signal) not in (None, UNITS.get(unit, ("", None))[1], "N m"):
        signal = plain  # a speed of a belt in mm/s is none of the motor
    if signal == "torque" and unit == "%":
        return (
            ("torque", RATED) if mapping.rig.rated_torque is not None else ("relative_torque", "%")
        )
    return signal, unit


def _missing(
    path: Path, header: dict[tuple[int, str], list[str]], data: Lines, skip_bad: bool
) -> list[str]:
    """Return a note if samples are missing according to the header; raise unless `skip_bad`."""
    _, recorded = _field(header, "Recorded samples")
    if not recorded or not recorded[0].isdigit() or int(recorded[0]) <= len(data.text):
        return []
    lost = int(recorded[0]) - len(data.text)
    why = f"the file ends here, {lost} of {recorded[0]} recorded samples are missing"
    if not skip_bad:
        require_good(path, "line", {data.number[-1]: why})
    return [f"line {data.number[-1]}: {why}"]


IMPORTER = Importer(is_epos, read_epos)
