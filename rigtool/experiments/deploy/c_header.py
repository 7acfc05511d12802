"""A learned table as a C header: constant arrays, and the interpolation that rigtool itself uses.

    torque(p, v) = (1 - b) ((1 - a) q_jk + a q_j,k+1) + b ((1 - a) q_j+1,k + a q_j+1,k+1)

with q_jk = factor_j row_j(p_k), a the place of p between positions k and k + 1, and b that of v
between the nodes of speed j and j + 1: `control.lookup_table` in 4-byte numbers.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rigtool.escapes import c_comment
from rigtool.experiments.deploy.quantised_table import loss, quantise
from rigtool.experiments.learning.learned_table import COULOMB, VISCOUS, LearnedTable
from rigtool.numerics.arrays import Array

INT16 = 32767
"""Largest code of a table of 2-byte numbers."""

LINE_WIDTH = 100
"""Characters of a line."""

PERIODIC = """    float across = (position - {P}_START) / {P}_STEP;
    int column, next;
    across -= {P}_POSITIONS * floorf(across / {P}_POSITIONS);
    if (!(across >= 0.0f && across < {P}_POSITIONS))
        across = 0.0f;  /* rounding */
    column = (int)across;
    next = column + 1 < {P}_POSITIONS ? column + 1 : 0;
    across -= (float)column;
"""

CLAMPED = """    float across = (position - {P}_START) / {P}_STEP;
    int column, next;
    if (!(across > 0.0f))
        across = 0.0f;
    if (across > {P}_POSITIONS - 1)
        across = {P}_POSITIONS - 1;
    column = (int)across;
    if (column > {P}_POSITIONS - 2)
        column = {P}_POSITIONS - 2;
    next = column + 1;
    across -= (float)column;
"""

FUNCTIONS = """/* One row of the table, between two positions. */
static inline float {p}_row(int node, int column, int next, float across)
{{
    const {type} *row = {p}_table[{p}_row_of[node]];
    float low = (float)row[column], high = (float)row[next];
    return {p}_factor[node] * {scaled}(low + across * (high - low));
}}

/* {Q} [{unit}] at a position [rad] and speed [rad/s] of the motor shaft. */
static inline float {p}_{q}(float position, float speed)
{{
    int node = 0;
    float along, lower;
{place}    if (position != position || speed != speed)
        return 0.0f;  /* no number */
    if (!(speed > {p}_speed[0]))
        speed = {p}_speed[0];
    if (speed > {p}_speed[{P}_NODES - 1])
        speed = {p}_speed[{P}_NODES - 1];
    while (node < {P}_NODES - 2 && speed >= {p}_speed[node + 1])
        node++;
    along = (speed - {p}_speed[node]) / ({p}_speed[node + 1] - {p}_speed[node]);
    lower = {p}_row(node, column, next, across);
    return lower + along * ({p}_row(node + 1, column, next, across) - lower);
}}

/* 1 where the table was learned, 0 where {p}_{q} holds the value of its edge. */
static inline int {p}_covers(float position, float speed)
{{
    return {covers}speed >= {p}_speed[0] * 1.000001f
        && speed <= {p}_speed[{P}_NODES - 1] * 1.000001f;
}}
"""


def header(learned: LearnedTable, stem: str, *, short: bool) -> tuple[str, str]:
    """Return the text of a C header, and its loss by rounding; `short` makes its numbers int16.

    `stem` is the file's name without its ending; the names in the header begin with it.
    """
    table, name = learned.table, identifier(stem)
    macro, at, unit = name.upper(), learned.table.nodes, c_comment(learned.unit)
    if short:
        quantised = quantise(table.torque, INT16)
        entries: Array | NDArray[np.int64] = quantised.codes
        lost = loss(quantised.values - table.torque)
    else:
        entries = table.torque
        lost = loss(table.torque.astype(np.float32).astype(np.float64) - table.torque)
    text = lost.text(learned.unit, f"rounding to {'int16' if short else 'float'}")
    count = table.position.size
    step = (table.position[-1] - table.position[0]) / (count - 1)
    defines = {
        "START": _float(table.position[0]) + " /* rad */",
        "STEP": _float(step) + " /* rad */",
        "POSITIONS": str(count),
        "ROWS": str(table.speed.size),
        "NODES": str(at.speed.size),
    }
    if short:
        defines["SCALE"] = f"{_float(quantised.scale)} /* {unit} */"
    defines |= _friction(learned)
    kind = "int16_t" if short else "float"
    functions = FUNCTIONS.format(
        p=name,
        P=macro,
        type=kind,
        unit=unit,
        q=learned.quantity,
        Q=learned.quantity.capitalize(),
        scaled=f"{macro}_SCALE * " if short else "",
        place=(CLAMPED if table.period is None else PERIODIC).format(P=macro),
        covers=_covers(macro) if table.period is None else "position == position && ",
    )
    parts = [
        comment(_head(learned, name, text)),
        f"#ifndef {macro}_H\n#define {macro}_H\n",
        "#include <math.h>\n#include <stdint.h>\n",
        "".join(f"#define {macro}_{key} {value}\n" for key, value in defines.items()),
        "/* Nodes of interpolation over speed, rad/s: each has a row of the table, by a factor. */",
        _array(f"float {name}_speed[{macro}_NODES]", at.speed),
        _array(f"uint16_t {name}_row_of[{macro}_NODES]", at.row),
        _array(f"float {name}_factor[{macro}_NODES]", at.factor),
        f"/* {learned.quantity.capitalize()}, {'codes' if short else unit}. */",
        _rows(f"{kind} {name}_table[{macro}_ROWS][{macro}_POSITIONS]", entries),
        functions,
        f"#endif /* {macro}_H */",
    ]
    return "\n".join(parts) + "\n", text


def identifier(stem: str) -> str:
    """Return a C identifier made of a file's name, its ending left out."""
    found = re.sub(r"[^a-z0-9]+", "_", stem.lower()).strip("_")
    return found if found and not found[0].isdigit() else f"table_{found}".rstrip("_")


def comment(lines: Sequence[str]) -> str:
    """Return lines as a C comment; nothing in the lines can end it."""
    return "/*\n" + "".join(f" * {c_comment(line)}".rstrip() + "\n" for line in lines) + " */"


def _head(learned: LearnedTable, name: str, lost: str) -> list[str]:
    return [
        f"{learned.quantity.capitalize()} [{learned.unit}] by position [rad] and speed [rad/s] of "
        "the motor shaft.",
        "",
        *learned.origin,
        "",
        *learned.rule(),
        f"{name}_{learned.quantity}(position, speed) does so; {name}_covers(position, speed) says",
        "where it is valid. Positions are floats: keep them within a few turns of zero.",
        *learned.friction_lines(),
        f"Lost: {lost}.",
    ]


def _friction(learned: LearnedTable) -> dict[str, str]:
    units = {COULOMB: "N m", VISCOUS: "N m s/rad"}
    return {
        key.removeprefix("feedforward_").upper(): f"{_float(q.value)} /* {units[key]} */"
        for key, q in learned.friction.items()
    }


def _covers(macro: str) -> str:
    return (
        f"position >= {macro}_START - 0.001f * {macro}_STEP\n"
        f"        && position <= {macro}_START + ({macro}_POSITIONS - 0.999f) * {macro}_STEP\n"
        "        && "
    )


def _float(value: float) -> str:
    text = str(np.float32(value))  # as few digits as distinguish it from its neighbours
    return (text if any(c in text for c in ".en") else text + ".0") + "f"


def _numbers(values: Array | NDArray[np.int64]) -> list[str]:
    if values.dtype.kind == "f":
        return [_float(value) for value in values]
    return [str(int(value)) for value in values]


def _wrapped(numbers: Sequence[str]) -> str:
    widest = max(map(len, numbers)) + 2
    each = max(1, (LINE_WIDTH - 4) // widest)
    lines = [", ".join(numbers[i : i + each]) for i in range(0, len(numbers), each)]
    return ",\n".join(f"    {line}" for line in lines)


def _array(declaration: str, values: Array | NDArray[np.int64]) -> str:
    return f"static const {declaration} = {{\n{_wrapped(_numbers(values))}\n}};"


def _rows(declaration: str, entries: Array | NDArray[np.int64]) -> str:
    rows = ",\n".join(f"  {{\n{_wrapped(_numbers(row))}\n  }}" for row in entries)
    return f"static const {declaration} = {{\n{rows}\n}};\n"
