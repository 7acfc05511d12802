"""Learned tables in run files: how `ilc-learn` writes them and other commands read them."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from rigtool.control.lookup_table import LookupTable
from rigtool.errors import RunFileError
from rigtool.experiments.learning.learned_table import COULOMB, VISCOUS, LearnedTable
from rigtool.experiments.learning.rows import Amplitudes
from rigtool.experiments.torque_per_ampere import learned_constant
from rigtool.numerics.arrays import Array
from rigtool.quantity import Quantity
from rigtool.recipe import Recipe
from rigtool.rigs import Feedforward
from rigtool.runfile import Column, Run, Table, dof_column

PERIOD_RESULT, LEARNING_CUTOFF = "lookup_period", "learning_cutoff"
"""Results: the angle after which a periodic table repeats, rad; the cut-off of Q, Hz, where the
recipe does not state it."""

TRAJECTORY_TABLE = "trajectory"
"""Table that a run has instead of a learned table, where it was learned by time."""


def tables_of(
    table: LookupTable,
    u: Array,
    amplitudes: Amplitudes,
    dof: Array,
    quantity: tuple[str, str] = ("torque", "N m"),
    *,
    measured: bool = False,
) -> dict[str, Table]:
    """Return the tables `lookup` and `amplitude` of a learned table.

    `u` is the standard uncertainty of its torque, of the same shape, N m, with `dof` (speeds,).
    What was learned may be another `quantity`, name and unit, and by the `measured` angle.
    """
    name, unit = quantity
    angle = "measured" if measured else "set point"
    entries = "periodic" if measured else "one entry a quad count"
    lookup = Table(
        axes=("speed", "position"),
        columns={
            "speed": Column(table.speed, "rad/s", f"{angle} of the motor shaft"),
            "position": Column(table.position, "rad", f"{angle} of the motor shaft"),
            name: Column(table.torque, unit, f"feed-forward {name} that was learned"),
            "u": Column(u, unit, "standard uncertainty: scatter of the moves/sqrt(moves)"),
            "dof": dof_column(dof),
        },
        signal=name,
        description=f"learned {name} by speed and position, {entries}; bilinear "
        "between entries, no extrapolation",
    )
    amplitude = Table(
        axes=("low_speed",),
        columns={
            "low_speed": Column(amplitudes.speed, "rad/s", "of the motor shaft, either direction"),
            "amplitude": Column(amplitudes.amplitude, "1", "factor on the lowest speed's row"),
            "u": Column(amplitudes.u, "1", "standard uncertainty; the ends are by definition"),
            "dof": dof_column(amplitudes.dof),
        },
        signal="amplitude",
        description="scales the row of the lowest learned speed at speeds below it; linear between",
    )
    return {"lookup": lookup, "amplitude": amplitude}


def period_results(table: LookupTable) -> dict[str, Quantity]:
    """Return the period of a learned table under the name of this module; empty without one."""
    if table.period is None:
        return {}
    return {
        PERIOD_RESULT: Quantity(
            table.period, "rad", reason="the table holds one turn by definition"
        )
    }


def friction_results(friction: Run | None) -> dict[str, Quantity]:
    """Return Coulomb and viscous friction of a run of `stribeck` under the names of this module.

    Empty without a run. They are stored beside a table, which holds only their remainder.
    """
    if friction is None:
        return {}
    friction.require_command("stribeck")
    return {
        COULOMB: friction.result("coulomb_friction", "N m"),
        VISCOUS: friction.result("viscous_friction", "N m s/rad"),
    }


def of_another_calibration(run: Run, kt: Run) -> bool:
    """Return whether a run of `ilc-learn` states that it was learned with other calibrations."""
    inputs = run.provenance["inputs"]
    own = [used["content_sha256"] for used in inputs if used["command"] == kt.command]
    return bool(own) and kt.content_sha256 not in own


def friction_beside(run: Run) -> dict[str, Quantity]:
    """Return the friction that is stored beside the table of a run of `ilc-learn`."""
    units = {COULOMB: "N m", VISCOUS: "N m s/rad"}
    return {name: run.result(name, unit) for name, unit in units.items() if name in run.results}


def lookup_table_from(run: Run) -> LookupTable:
    """Return the learned table of a run of `ilc-learn`, in N m.

    Raises `RunFileError` where the run is of another command or its table is broken.
    """
    table = stored_table_from(run)
    lookup = run.table("lookup")
    unit = lookup.columns[lookup.signal].unit
    if unit != "N m":
        raise RunFileError(
            f"{run.path}: its learned table holds {unit}, not torque: learn it with --kt"
        )
    return table


def stored_table_from(run: Run) -> LookupTable:
    """Return the learned table of a run of `ilc-learn`, in its stored unit.

    Raises `RunFileError` where the run is of another command or its table is broken.
    """
    run.require_command("ilc-learn")
    if TRAJECTORY_TABLE in run.tables:
        raise RunFileError(
            f"{run.path}: was learned by time, along one move, and holds no table by position: "
            "learn with another --implementation"
        )
    found = run.table("lookup", "speed", "position", speed="rad/s", position="rad")
    lookup = run.table("lookup", **{found.signal: found.columns[found.signal].unit})
    amplitude = run.table("amplitude", "low_speed", low_speed="rad/s", amplitude="1")
    try:
        return LookupTable(
            position=lookup["position"],
            speed=lookup["speed"],
            torque=lookup[lookup.signal],
            low_speed=amplitude["low_speed"],
            amplitude=amplitude["amplitude"],
            period=run.result(PERIOD_RESULT, "rad").value if PERIOD_RESULT in run.results else None,
        )
    except (KeyError, ValueError) as error:
        raise RunFileError(
            f"{run.path}: its learned table cannot be used: {error}; learn it again"
        ) from None


def learned_table_from(run: Run) -> LearnedTable:
    """Return the learned table of a run of ilc-learn; raises `RunFileError` where it has none."""
    table = stored_table_from(run)
    stored = run.table("lookup")
    signal = stored.columns[stored.signal]
    band_hz, band_speed = _band(run)
    constant = learned_constant(run) if signal.unit == "N m" else None
    return LearnedTable(
        table=table,
        u=np.asarray(run.table("lookup", u=signal.unit)["u"], dtype=np.float64),
        quantity=stored.signal,
        unit=signal.unit,
        friction=friction_beside(run),
        band_hz=band_hz,
        band_speed=band_speed,
        origin=(*origin_of(run), *_about(constant)),
        constant=constant,
    )


def _about(constant: float | None) -> list[str]:
    if constant is None:
        return []
    return [f"Torque over {constant:.6g} N m/A is the current set point that was learned."]


def origin_of(run: Run) -> tuple[str, str]:
    """Return where learned tables come from, in lines."""
    made = run.provenance
    return (
        f"Rig {run.rig or 'unknown'}; learned on {made['date']}, rigtool {made['version']}.",
        f"File {run.path.name}, content sha256 {run.content_sha256}.",
    )


def _band(run: Run) -> tuple[float | None, float | None]:
    """Return the cut-off of Q, Hz, and the speed, rad/s, that it belongs to, None for each speed.

    Implementation A learns at one speed, whose orders it takes along to the others. A table
    outlives the recipes that this version reads: then neither is known.
    """
    try:
        settings = None if run.recipe is None else run.recipe.ilc_learn
    except RunFileError:
        return None, None
    if settings is None:
        return None, None
    if LEARNING_CUTOFF in run.results:
        one = 2 * math.pi * min(settings.turning.speeds_rev_per_s)
        return run.result(LEARNING_CUTOFF, "Hz").value, one
    return settings.robustness_hz, None


def feedforward(
    inertia: float, results: Mapping[str, Quantity], table: LookupTable | None = None
) -> Feedforward:
    """Return the feed-forward of this inertia, kg m2, and of the friction among `results`."""
    return Feedforward(
        inertia=inertia,
        coulomb=results[COULOMB].value if COULOMB in results else 0.0,
        viscous=results[VISCOUS].value if VISCOUS in results else 0.0,
        table=table,
    )


def feedforward_from(run: Run, inertia: float) -> Feedforward:
    """Return the feed-forward of a run of `ilc-learn`: its table and the models beside it.

    `inertia` is the nominal one on the motor shaft, kg m2.
    """
    return feedforward(inertia, friction_beside(run), lookup_table_from(run))


def require_same_rig(tables: Run, recipe: Recipe) -> None:
    """Raise `RunFileError` unless the tables were learned on the recipe's rig, as it is now.

    Compared are the rig's name, attachment, encoder and ratio; the table must hold both directions,
    and the angles and the speed at which `measure-force` reads.
    """
    require_rig(tables, recipe)
    _require_reach(tables, recipe)


def recipe_of(tables: Run) -> Recipe:
    """Return the recipe that tables were learned with; `RunFileError` for another run."""
    tables.require_command("ilc-learn")
    if tables.recipe is None:
        raise RunFileError(
            f"{tables.path}: does not state on which rig it was learned: learn again"
        )
    return tables.recipe


def require_rig(tables: Run, recipe: Recipe) -> None:
    """Raise `RunFileError` unless the tables were learned on the recipe's rig, as it is now.

    Compared are the rig's name, attachment, encoder, ratio, torque factor and inertia: models and
    tables are in terms of them.
    """
    learned = recipe_of(tables)
    for what, there, here in (
        ("rig", learned.rig.name, recipe.rig.name),
        ("attachment", learned.rig.attachment, recipe.rig.attachment),
        ("encoder", learned.rig.encoder_counts, recipe.rig.encoder_counts),
        ("motor angle per output angle", learned.rig.angle_ratio, recipe.rig.angle_ratio),
        ("torque factor", learned.rig.torque_factor, recipe.rig.torque_factor),
        ("nominal inertia, kg m2,", learned.rig.nominal_inertia, recipe.rig.nominal_inertia),
    ):
        if there != here:
            then, now = (f"{v:.6g}" if isinstance(v, float) else v for v in (there, here))
            raise RunFileError(
                f"{tables.path}: was learned with {what} {then}, the recipe has {now}: learn "
                "tables with this recipe, or give the recipe of that rig"
            )


def _require_reach(tables: Run, recipe: Recipe) -> None:
    """Raise `RunFileError` unless the table reaches as far as `measure-force` reads it."""
    table, settings = lookup_table_from(tables), recipe.measure_force
    for sign, name in ((1, "positive"), (-1, "negative")):
        if not (sign * table.speed > 0).any():
            raise RunFileError(
                f"{tables.path}: holds nothing for the {name} direction: learn both directions"
            )
    ratio = recipe.rig.angle_ratio
    speed = recipe.rig.motor_speed(settings.speed_rev_per_s)
    fastest = min(abs(table.speed[0]), abs(table.speed[-1]))
    if speed > fastest * (1 + 1e-9):
        raise RunFileError(
            f"{tables.path}: was learned up to {fastest:.4g} rad/s, measure_force moves at "
            f"{speed:.4g} rad/s: learn that speed, or lower measure_force.speed_rev_per_s"
        )
    low, high = (
        math.radians(angle) * ratio
        for angle in (settings.turn_angle, settings.angle - settings.turn_angle)
    )
    count = recipe.rig.count_angle
    if table.period is None and (
        table.position[0] > low + count or table.position[-1] < high - count
    ):
        raise RunFileError(
            f"{tables.path}: was learned from {math.degrees(table.position[0]):.4g} to "
            f"{math.degrees(table.position[-1]):.4g} deg of the motor, measure_force uses "
            f"{math.degrees(low):.4g} to {math.degrees(high):.4g} deg: learn with the angle and "
            "turn_angle of measure_force"
        )
