"""Texts of learned tables: for drives, as Fourier coefficients, as plain numbers."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from rigtool.experiments.deploy.fourier_table import fourier_series
from rigtool.experiments.deploy.position_map import PositionMap
from rigtool.experiments.deploy.quantised_table import held_values, interpolated_codes
from rigtool.experiments.learning.learned_table import LearnedTable
from rigtool.numerics.arrays import Array

MOTEUS_SIZE, INT8 = 1024, 127
ODRIVE_SIZE = 3600


def moteus(learned: LearnedTable, turn: PositionMap) -> tuple[str, str]:
    """Return the configuration of a moteus drive with this map, in A, and its loss.

    The drive adds scale*code in A of Q current, code i at i/1024 of a turn of its commutation
    encoder and linear between. Lines are as its tools store and restore a configuration.
    """
    sampled = interpolated_codes(turn, MOTEUS_SIZE, INT8)
    text = sampled.loss.text("A", f"{MOTEUS_SIZE} codes of int8")
    head = [
        "Cogging table of a moteus drive; load by moteus_tool --restore-config, or send each line",
        "after 'conf set' and end with 'conf write'. The drive uses it in position mode.",
        "Code i is the value at i/1024 of a turn of the commutation encoder, linear between.",
        "Position zero and direction are those of the encoder that the table was learned with.",
        *_map_lines(learned, turn, "A"),
        f"Lost: {text}.",
    ]
    lines = [f"motor.cogging_dq_scale {np.float32(sampled.stored.scale):.9g}"]
    lines += [f"motor.cogging_dq_comp.{i} {code}" for i, code in enumerate(sampled.stored.codes)]
    return _hashed(head) + "\n".join(lines) + "\n", text


def odrive(learned: LearnedTable, turn: PositionMap, *, as_json: bool) -> tuple[str, str]:
    """Return a map of the size that ODrive uses, 3600 floats of N m, and its loss."""
    values, lost = held_values(turn, ODRIVE_SIZE)
    text = lost.text("N m", f"{ODRIVE_SIZE} steps of float")
    head = [
        "Map of the size that ODrive uses: value i holds from i/3600 to (i+1)/3600 of a turn.",
        "The drive takes no upload of its map: stream it as torque feed-forward by position.",
        "Position zero and direction are those of the encoder that the table was learned with.",
        *_map_lines(learned, turn, "N m"),
        f"Lost: {text}.",
    ]
    if as_json:
        torque = [float(f"{value:.9g}") for value in values]
        return _json(head, {"unit": "N m", "torque": torque, **_lost(lost, "N m")}), text
    rows = [(i, f"{value:.9g}") for i, value in enumerate(values)]
    return _hashed(head) + _csv(("index", "torque [N m]"), rows), text


def fourier(learned: LearnedTable, turn: PositionMap, *, as_json: bool) -> tuple[str, str]:
    """Return the orders above the noise as text, and their remainder."""
    series = fourier_series(turn, learned.band_order(turn.speed))
    unit = learned.unit
    text = series.lost.text(
        unit,
        f"leaving out orders below twice their noise, of {series.examined}; that is noise, too",
    )
    head = [
        f"map(position) = sum of amplitude*cos(order*position + phase), {unit}; position in rad.",
        f"{series.order.size} of the orders 1 to {series.examined} exceed their noise; "
        "u, standard uncertainty: the scatter of the table, spread evenly over these orders.",
        *_map_lines(learned, turn, unit),
        f"Lost: {text}.",
    ]
    columns = {
        "order": series.order,
        f"amplitude [{unit}]": series.amplitude,
        f"amplitude_u [{unit}]": series.amplitude_u,
        "phase [rad]": series.phase,
        "phase_u [rad]": series.phase_u,
    }
    if as_json:
        plain = {name.partition(" [")[0]: values.tolist() for name, values in columns.items()}
        more = {"unit": unit, "examined": series.examined, **_lost(series.lost, unit)}
        return _json(head, {**more, **plain}), text
    rows = zip(*(values.tolist() for values in columns.values()), strict=True)
    return _hashed(head) + _csv(tuple(columns), rows), text


NOTHING_LOST = "nothing: 8-byte numbers, as they were learned"


def table_csv(learned: LearnedTable) -> tuple[str, str]:
    """Return the whole table as CSV, a line for each speed and position; low speeds are rows."""
    speed, torque, u = _written_out(learned)
    position = learned.table.position
    unit = learned.unit
    names = ("speed [rad/s]", "position [rad]", f"{learned.quantity} [{unit}]", f"u [{unit}]")
    rows = zip(
        np.repeat(speed, position.size).tolist(),
        np.tile(position, speed.size).tolist(),
        torque.ravel().tolist(),
        u.ravel().tolist(),
        strict=True,
    )
    return _hashed(_table_head(learned)) + _csv(names, rows), NOTHING_LOST


def table_json(learned: LearnedTable) -> tuple[str, str]:
    """Return the whole table as JSON; low speeds are rows."""
    speed, torque, u = _written_out(learned)
    document = {
        "position": {"unit": "rad", "values": learned.table.position.tolist()},
        "period": learned.table.period,
        "speed": {"unit": "rad/s", "values": speed.tolist()},
        learned.quantity: {"unit": learned.unit, "values": torque.tolist()},
        "u": {"unit": learned.unit, "values": u.tolist()},
        "friction": {name: q.value for name, q in learned.friction.items()},
        "loss": {"largest": 0.0, "rms": 0.0, "unit": learned.unit},
    }
    return _json(_table_head(learned), document), NOTHING_LOST


def table_matlab(learned: LearnedTable) -> tuple[dict[str, Any], str]:
    """Return the whole table as variables of a .mat file; low speeds are rows."""
    speed, torque, u = _written_out(learned)
    period = learned.table.period
    contents = {
        "description": "\n".join(_table_head(learned)),
        "position": learned.table.position,
        "period": math.nan if period is None else period,
        "speed": speed,
        learned.quantity: torque,
        "u": u,
        "units": {"position": "rad", "speed": "rad/s", learned.quantity: learned.unit},
        "friction": {name: q.value for name, q in learned.friction.items()} or 0.0,
    }
    return contents, NOTHING_LOST


def _written_out(learned: LearnedTable) -> tuple[Array, Array, Array]:
    """Return speeds (m,), torque (m, n) and u (m, n) with the amplitude table as rows."""
    at = learned.table.nodes
    return at.speed, at.rows(learned.table.torque), at.rows(learned.u)


def _table_head(learned: LearnedTable) -> list[str]:
    return [
        f"Learned {learned.quantity} [{learned.unit}] by position and speed of the motor shaft.",
        *learned.origin,
        *learned.rule(),
        *learned.friction_lines(),
        f"Lost: {NOTHING_LOST}.",
    ]


def _map_lines(learned: LearnedTable, turn: PositionMap, unit: str) -> list[str]:
    ways = "mean of both directions" if turn.both_directions else "one direction only"
    lines = [
        *learned.origin,
        f"Of the table at {turn.speed:.6g} rad/s, {ways}; its mean over the turn, "
        f"{turn.mean:.4g} {unit}, is left out.",
    ]
    if not turn.both_directions:
        lines.append("Friction that varies with position is in it, and is wrong the other way.")
    return [*lines, *learned.friction_lines()]


def _lost(lost: Any, unit: str) -> dict[str, Any]:
    return {"loss": {"largest": lost.largest, "rms": lost.rms, "unit": unit}}


def _hashed(lines: Sequence[str]) -> str:
    return "".join(f"# {' '.join(line.split())}\n" for line in lines)


def _json(head: Sequence[str], document: Mapping[str, Any]) -> str:
    return json.dumps({"description": list(head), **document}, allow_nan=False) + "\n"


def _csv(names: Sequence[str], rows: Any) -> str:
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(names)
    writer.writerows(rows)
    return stream.getvalue()
