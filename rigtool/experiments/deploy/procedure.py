"""`deploy`: a learned table into the drive that it was learned with.

The drive adds the table by itself, at its own rate; it stores one map of the turn in A.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from rigtool.errors import HardwareError, InsufficientDataError, UsageError
from rigtool.experiments.deploy.position_map import PositionMap, position_map
from rigtool.experiments.deploy.quantised_table import Sampled, interpolated_codes
from rigtool.experiments.deploy.stored_export import (
    calibration_remarks,
    in_unit,
    require_own_calibration,
)
from rigtool.experiments.learning.stored_table import learned_table_from
from rigtool.numerics.arrays import Array
from rigtool.recipe import Recipe
from rigtool.rigs.operator import Operator
from rigtool.rigs.serial.drivers import REPLAY_DRIVER, driver
from rigtool.rigs.serial.line import Line
from rigtool.rigs.serial.table_store import DriveTable, EncoderZero, TableStore
from rigtool.runfile import Run

FLASH_TIMEOUT = 1.0
"""Longest wait for an answer, s: a drive that writes its flash is busy."""

WAVEFORM_TABLE = "residual_waveforms"
"""Table of a run with waveforms before, and with the learned table switched on."""

TABLE_ON = "cogging table is on"
"""Part of a drive's identity where its own table was in use."""


@dataclass(frozen=True)
class Deployed:
    """The stored table, or the one to be stored: lines about it, and remarks."""

    lines: tuple[str, ...]
    remarks: tuple[str, ...]


def deploy(
    tables: Run,
    recipe: Recipe,
    *,
    speed: float | None,
    kt: Run | None,
    dry_run: bool,
    operator: Operator,
) -> Deployed:
    """Store the table of a run in the drive of a recipe; with `dry_run` change nothing.

    Raises `UsageError` for a table that no drive can hold or that is not this rig's,
    `InsufficientDataError` for one that made the motor run worse when it was tried,
    `HardwareError` for a drive that keeps no table, or where storing fails: then the old table
    is restored.
    """
    make_store, usual_baud_rate = _store_of(recipe)
    turn, remarks = _map(tables, recipe, speed, kt)
    remarks.append(_ripple_remark(tables, turn.speed))
    remarks = [*remarks, *_origin_remarks(tables, recipe)]
    settings = recipe.line
    baud_rate = settings.baud_rate or usual_baud_rate
    with Line(
        settings.port, baud_rate, timeout=FLASH_TIMEOUT, spy=operator.spy, driver=settings.driver
    ) as line:
        store = make_store(line, recipe)
        identity = store.connect()
        _require_same_drive(tables, identity)
        zero = store.zero()
        sampled = interpolated_codes(
            turn.by_encoder(zero.sign, zero.offset),
            store.size,
            store.largest_code,
            store.scale_step,
        )
        new = DriveTable(sampled.stored.codes, sampled.stored.scale)
        before = store.read()
        plan = [f"{identity} on {settings.port}", *_plan(turn, sampled, zero, before)]
        if dry_run:
            return Deployed((*plan, "nothing was changed"), tuple(remarks))
        operator.permit(
            "\n".join([*plan, *remarks]),
            "the drive's table would be replaced",
            "Store this in the drive's flash now?",
        )
        store.store(new, before)
        retries = line.counts.retries
    done = f"stored and read back: {store.size} codes and their scale are in the drive's flash"
    if retries:
        remarks.append(f"{retries} requests on the line were repeated")
    return Deployed((*plan, done), tuple(remarks))


def _store_of(recipe: Recipe) -> tuple[Callable[[Line, Recipe], TableStore], int]:
    """Return the maker of the table store of the recipe's drive, and the usual baud rate, bit/s."""
    if recipe.rig.source != "serial" or recipe.serial is None:
        raise UsageError(
            f"the rig {recipe.rig.name} is {recipe.rig.source}: a table is stored in a drive; give "
            "a recipe with rig.source = serial"
        )
    name = recipe.serial.driver
    if name == REPLAY_DRIVER:
        raise UsageError("serial.driver is replay: a record has no memory to store a table in")
    found = driver(name)
    make_drive, table_store = found.make_drive, found.table_store
    if make_drive is None or table_store is None:
        raise HardwareError(
            f"{name} keeps no table that can be stored over its line: rigtool adds a learned table "
            "as feed-forward while it runs; to use it elsewhere, export it"
        )
    return lambda line, recipe: table_store(make_drive(line, recipe)), found.baud_rates[0]


def _map(
    tables: Run, recipe: Recipe, speed: float | None, kt: Run | None
) -> tuple[PositionMap, list[str]]:
    """Return the map for the drive, in A, and remarks."""
    learned = learned_table_from(tables)
    for run in (tables, kt):
        if run is not None and run.rig is not None and run.rig != recipe.rig.name:
            raise UsageError(
                f"{run.path}: was measured on the rig {run.rig}, the recipe is of "
                f"{recipe.rig.name}: a table fits the motor it was learned on only"
            )
    require_own_calibration(tables, kt)
    turn = in_unit(position_map(learned.table, learned.u, speed), learned, "moteus", kt)
    peak, limit = float(np.abs(turn.values).max()), recipe.line.limits.current
    if peak > limit:
        raise UsageError(
            f"{tables.path}: takes up to {peak:.4g} A, beyond serial.limits.current = "
            f"{limit:g} A: a table of cogging is far smaller; check how it was learned"
        )
    return turn, turn.remarks("A") + calibration_remarks(learned, kt) + learned.friction_lines()


def _ripple_remark(tables: Run, speed: float) -> str:
    """State the ripple with and without the table while learning, at the speed next to this one.

    Raises `InsufficientDataError` where it reduced nothing.
    """
    if WAVEFORM_TABLE not in tables.tables:
        return "the table was not tried while it was learned: its effect on ripple is not known"
    tried = tables.table(WAVEFORM_TABLE, speed="rad/s", before="N m", residual="N m")
    distance = np.abs(np.abs(tried["speed"]) - abs(speed))
    next_to = distance == distance.min()
    before, after = (_ripple(tried[name][next_to]) for name in ("before", "residual"))
    change = f"from {before * 1e3:.3g} to {after * 1e3:.3g} mN m (rms, mean of directions)"
    if after >= before:
        raise InsufficientDataError(
            f"{tables.path}: with the table switched on, ripple went {change}: it would make the "
            "motor run worse. [rig.controller] has to be the loop that the drive closes, and "
            "ilc_learn.robustness_hz below its bandwidth: correct them, and learn again"
        )
    return f"when the table was tried while learning, ripple went {change}"


def _ripple(waveforms: Array) -> float:
    """Return the rms of waveforms (directions, positions), their mean without its offset."""
    return float(np.std(waveforms.mean(axis=0)))


def _line_facts(run: Run) -> dict[str, Any]:
    return json.loads(run.provenance.get("line") or "{}")


def _origin_remarks(tables: Run, recipe: Recipe) -> list[str]:
    """Refuse a table that was learned through another kind of drive; return remarks."""
    facts = _line_facts(tables)
    if not facts:
        return [
            "the run does not state with which drive it was learned: position zero and direction "
            "have to be those of this drive"
        ]
    driver = facts.get("driver")
    if driver != recipe.line.driver:
        raise UsageError(
            f"{tables.path}: was learned through {driver}, whose position zero is not that of a "
            f"{recipe.line.driver}: learn it with the drive that is to hold it"
        )
    if TABLE_ON in str(facts.get("identity", "")):
        raise UsageError(
            f"{tables.path}: was learned while the drive's own table was on, and holds only the "
            "remainder of that: switch it off (motor.cogging_dq_scale 0), and learn again"
        )
    return []


def _require_same_drive(tables: Run, identity: str) -> None:
    """Refuse a table of another specimen; its encoder has another angle on the shaft."""
    there = _serial_number(str(_line_facts(tables).get("identity", "")))
    here = _serial_number(identity)
    if there and here and there != here:
        raise UsageError(
            f"{tables.path}: was learned with the drive of serial number {there}, on the line is "
            f"{here}: learn it with the drive that is to hold it"
        )


def _serial_number(identity: str) -> str:
    words = identity.replace(",", " ").replace(";", " ").split()
    return words[words.index("serial") + 1] if "serial" in words[:-1] else ""


def _plan(turn: PositionMap, sampled: Sampled, zero: EncoderZero, before: DriveTable) -> list[str]:
    stored = sampled.stored
    peak = float(np.abs(turn.values).max())
    u = float(np.sqrt(np.mean(turn.u**2)))
    ways = "both directions" if turn.both_directions else "one direction"
    change = int(np.count_nonzero(before.codes != stored.codes))
    was = f"scale {before.scale:.4g} A" if before.scale else "off"
    direction = "with" if zero.sign > 0 else "against"
    return [
        f"map of the turn at {turn.speed:.4g} rad/s, mean of {ways}: up to {peak:.4g} A, standard "
        f"uncertainty {u:.2g} A (rms over the turn)",
        f"position 0 is at {math.degrees(zero.offset):.3f} deg (u {math.degrees(zero.u):.1g} deg) "
        f"of the encoder by which the drive reads its table, which counts {direction} the position",
        f"{stored.codes.size} codes, scale {stored.scale:.6g} A; lost "
        + sampled.loss.text("A", "rounding"),
        f"the table that is there is {was}; {change} codes change",
    ]
