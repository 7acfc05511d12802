"""The disturbance of a load in run files: how implementation D writes it and others read it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from rigtool.errors import RunFileError
from rigtool.experiments.load_disturbance.model import Disturbance, LoadedPair, state_under
from rigtool.experiments.load_disturbance.tendon import Tendon
from rigtool.experiments.load_disturbance.terms import Kind, State, Term, functions
from rigtool.numerics.arrays import Array
from rigtool.quantity import Quantity
from rigtool.recipe import Recipe
from rigtool.runfile import Column, Run, Table

TERMS, COVARIANCE = "disturbance_terms", "disturbance_covariance"

LOAD_FRICTION = "load_friction"

ANGLE_STEP_DEG = 5.0
POINTS_OF_LOAD = 13
ROUNDS = 4
"""Times that the current of a point, which its own disturbance changes, is computed anew."""

TENDON = {
    "stiffness": ("N m/rad", "tendon_stiffness"),
    "damping": ("N m s/rad", "tendon_damping"),
    "tip_friction": ("N m", "tip_friction"),
}
"""Unit and result name of each of the tendon's parameters."""

_TERM_COLUMNS = {
    "kind": "1 friction by load, 2 viscous friction, 3 friction by angle, 4 ripple, 5 gain, 6 gain "
    "that grows with current",
    "spread": "of the coefficient, before anything is known",
    "order": "of the angle",
    "quarter": "0 cosine, 1 sine of the angle",
    "onset": "of friction by load",
    "sided": "1 where it changes sign with the direction",
    "speed": "of the motor for which it holds, 0 for all",
}


def tendon_results(disturbance: Disturbance) -> dict[str, Quantity]:
    """Return stiffness, damping and tip friction, with standard uncertainty."""
    us = np.sqrt(np.diag(disturbance.covariance)[:3])
    values = vars(disturbance.tendon)
    return {
        name: Quantity(values[field], unit, float(u))
        for (field, (unit, name)), u in zip(TENDON.items(), us, strict=True)
    }


def model_tables(disturbance: Disturbance) -> dict[str, Table]:
    """Return the coefficients and their covariance: what `disturbance_from` reads back."""
    terms = disturbance.terms
    units = {"onset": "N m", "speed": "rad/s"}
    numbers = np.arange(len(terms))
    columns = {
        name: Column(
            np.array([float(getattr(term, name)) for term in terms]), units.get(name, "1"), what
        )
        for name, what in _TERM_COLUMNS.items()
    }
    every = np.arange(len(disturbance.covariance))
    return {
        TERMS: Table(
            ("term",),
            {
                "term": Column(numbers, "1"),
                **columns,
                "coefficient": Column(
                    disturbance.coefficient, "1", "N m for each unit of the term"
                ),
                "u": Column(
                    np.sqrt(np.diag(disturbance.covariance)[3:]), "1", "standard uncertainty"
                ),
            },
            "coefficient",
            "what a load adds to the motor's torque besides itself, as a sum of functions",
        ),
        COVARIANCE: Table(
            ("parameter", "other_parameter"),
            {
                "parameter": Column(every, "1", "stiffness, damping, tip friction, then the terms"),
                "other_parameter": Column(every, "1"),
                "covariance": Column(disturbance.covariance, "1", "SI units of both"),
            },
            "covariance",
            "covariance of the tendon's parameters and of the terms' coefficients",
        ),
    }


def disturbance_from(run: Run) -> Disturbance:
    """Return the disturbance of a run of `ilc-learn --implementation D`.

    Raises `RunFileError` where the run holds none, or a broken one.
    """
    run.require_command("ilc-learn")
    if TERMS not in run.tables:
        raise RunFileError(
            f"{run.path}: was not learned with known loads, so no load can be corrected: learn "
            "with --implementation D, or measure with --correction none"
        )
    table, covariance = run.table(TERMS), run.table(COVARIANCE)["covariance"]
    try:
        return Disturbance(
            terms=tuple(_terms(table)),
            tendon=Tendon(**{f: run.result(name).value for f, (_, name) in TENDON.items()}),
            coefficient=table["coefficient"],
            covariance=covariance,
            torque=run.result("learned_torque").value,
            speeds=tuple(sorted({float(v) for v in table["speed"] if v})),
        )
    except (KeyError, ValueError) as error:
        raise RunFileError(
            f"{run.path}: its disturbance cannot be used: {error}; learn it again"
        ) from None


def _terms(table: Table) -> list[Term]:
    columns: dict[str, Any] = {name: table[name] for name in _TERM_COLUMNS}
    return [
        Term(
            kind=Kind(int(columns["kind"][i])),
            spread=float(columns["spread"][i]),
            order=int(columns["order"][i]),
            quarter=int(columns["quarter"][i]),
            onset=float(columns["onset"][i]),
            sided=bool(columns["sided"][i]),
            speed=float(columns["speed"][i]),
        )
        for i in range(len(columns["kind"]))
    ]


@dataclass(frozen=True, eq=False)
class Grid:
    """The disturbance on a grid.

    `angle` (a,) rad of the output, `load` (l,) N m that the tendon carries, by motor speed, rad/s:
    `torque` and `u` (a, l) of either direction (positive and negative speeds), and of `friction`
    and `friction_u` (positive speeds), half of what differs between them.
    """

    angle: Array
    load: Array
    torque: dict[float, Array]
    u: dict[float, Array]
    friction: dict[float, Array]
    friction_u: dict[float, Array]


def grid_of(disturbance: Disturbance, pairs: Sequence[LoadedPair], recipe: Recipe) -> Grid:
    """Return the disturbance at angles that `measure_force` uses and loads up to the largest."""
    settings, step = recipe.measure_force, ANGLE_STEP_DEG
    turn = settings.turn_angle
    angle = np.radians(np.arange(turn, settings.angle - turn + step / 2, step))
    load = np.linspace(0, disturbance.torque, POINTS_OF_LOAD)
    grid = Grid(angle, load, {}, {}, {}, {})
    covariance = disturbance.covariance[3:, 3:]

    def valued(design: Array) -> tuple[Array, Array]:
        variance = np.sum(design * np.tensordot(covariance, design, axes=1), axis=0)
        return np.tensordot(disturbance.coefficient, design, axes=1), np.sqrt(variance)

    for speed, motion in {each.loaded.speed: each for each in pairs}.items():
        up, down = (_design(disturbance, motion, side, angle, load) for side in (1.0, -1.0))
        grid.torque[speed], grid.u[speed] = valued(up)
        grid.torque[-speed], grid.u[-speed] = valued(down)
        grid.friction[speed], grid.friction_u[speed] = valued((up - down) / 2)
    return grid


def grid_tables(grid: Grid, recipe: Recipe) -> dict[str, Table]:
    """Return the disturbance by speed, position and load, and the friction that grows with load."""
    position = Column(grid.angle * recipe.rig.angle_ratio, "rad", "of the motor")
    load = Column(grid.load, "N m", "torque that the tendon carries, at the output")

    def table(values: dict[float, Array], u: dict[float, Array], what: str, about: str) -> Table:
        speeds = sorted(values)
        return Table(
            ("speed", "position", "load"),
            {
                "speed": Column(np.array(speeds), "rad/s", "of the motor shaft"),
                "position": position,
                "load": load,
                "torque": Column(np.stack([values[speed] for speed in speeds]), "N m", what),
                "u": Column(
                    np.stack([u[speed] for speed in speeds]), "N m", "standard uncertainty"
                ),
            },
            "torque",
            about,
        )

    return {
        "disturbance": table(
            grid.torque,
            grid.u,
            "what the load adds besides itself, at the output",
            "disturbance by speed, position and load",
        ),
        LOAD_FRICTION: table(
            grid.friction,
            grid.friction_u,
            "added while lifting, taken off while lowering, at the output",
            "friction that grows with load, by speed, position and load",
        ),
    }


def load_friction(tables: Run, speed: float, position: float, load: Array) -> tuple[Array, Array]:
    """Return friction that grows with load and its u, N m at the output, for loads (n,), N m.

    `speed` rad/s and `position` rad are those of the motor; between entries linearly.
    """
    table = tables.table(LOAD_FRICTION)

    def at(name: str) -> Array:
        values = np.apply_along_axis(
            lambda column: np.interp(position, table["position"], column), 1, table[name]
        )
        values = np.apply_along_axis(
            lambda column: np.interp(speed, table["speed"], column), 0, values
        )
        found: Array = np.interp(load, table["load"], values)
        return found

    return at("torque"), at("u")


def _design(
    disturbance: Disturbance, motion: LoadedPair, side: float, angle: Array, load: Array
) -> Array:
    """Return the terms' differences for a direction and speed, (t, angles, loads)."""
    rest = motion.unloaded[0]
    state = state_under(rest, disturbance.tendon, 0.0)
    ratio = rest.transmission.angle_ratio
    points = [rest.crossing(a * ratio, int(side)) for a in angle.tolist()]

    def there(signal: Array) -> Array:
        return np.array([float(rest.at(signal, point)) for point in points])

    current, carried = there(rest.lowpass(rest.current)), there(state.carried)
    scale, speed = rest.torque_per_ampere, side * rest.speed
    zero = _points(carried, angle, side, speed, current, scale, ratio, angle)
    base = functions(disturbance.terms, zero, rest.speed)
    design = np.empty((len(disturbance.terms), len(angle), len(load)))
    for number, value in enumerate(load.tolist()):
        grasper = angle - (value - carried) / disturbance.tendon.stiffness
        own = np.zeros_like(angle)
        full = np.full_like(angle, value)
        for _ in range(ROUNDS):
            drawn = current + (value - carried + own) / scale
            loaded = _points(full, grasper, side, speed, drawn, scale, ratio, angle)
            design[:, :, number] = functions(disturbance.terms, loaded, rest.speed) - base
            own = disturbance.coefficient @ design[:, :, number]
    return design


def _points(
    carried: Array,
    grasper: Array,
    side: float,
    speed: float,
    current: Array,
    torque_per_ampere: float,
    ratio: float,
    angle: Array,
) -> State:
    """Return a state at points of one direction."""
    ones = np.ones_like(carried)
    return State(
        direction=side * ones,
        turning=side * ones,
        angle=angle * ratio,
        rotor_speed=speed * ones,
        current=current,
        carried=carried,
        grasper=grasper,
        torque_per_ampere=torque_per_ampere,
    )
