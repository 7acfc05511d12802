"""A load model in run files: how `ilc-learn --implementation D` writes it and others read it.

For runs of other rigs; `force_model.stored` holds what is learned on the bench's own rig.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields
from typing import Any

import numpy as np

from rigtool.errors import RunFileError
from rigtool.experiments.imported_load.basis import FUNCTION_GROUPS, Scales, size_of
from rigtool.experiments.imported_load.loop import StrokeLoop
from rigtool.experiments.imported_load.model import SIDE_SIGNS, LoadModel, Paces, Side
from rigtool.experiments.imported_load.noise import OCTAVES, LearnedNoise
from rigtool.experiments.imported_load.region import STROKE_CELLS, Region
from rigtool.runfile import Column, Run, Table

MODEL_TABLE = "load_model"
"""The first table of a model; the names of its other tables begin likewise."""

_PARTS = (
    *("", "_covariance", "_scales", "_scatter", "_factors"),
    *("_region", "_strokes", "_paces", "_noise", "_loop"),
)
"""Ends of these names, in the order of the file."""

_SCALES = {
    "low": ("rad", "lowest position"),
    "high": ("rad", "highest position"),
    "speed": ("rad/s", "unit of speed: the highest, but for one sample in a hundred"),
    "standstill": ("rad/s", "below this speed friction is undetermined"),
    "acceleration": ("rad/s2", "unit of acceleration"),
    "torque": ("N m", "unit of torque: the highest"),
    "turn": ("rad", "one turn of the encoder; 0: no orders of rotation in the model"),
    "lowest": ("1", "torque that is looked for, by its unit"),
    "highest": ("1", "torque that is looked for, by its unit"),
    "bandwidth": ("Hz", "of all signals"),
    "direction": ("1", "of the speed that the load resists"),
    "slack": ("1", "of dead bands at either end, by the unit of torque"),
}

_REGION = {
    "slowest": "magnitude of the speed",
    "fastest": "magnitude of the speed",
    "lowest": "torque",
    "highest": "torque",
}

_SIGNS = (np.array(SIDE_SIGNS, dtype=float), "1", "sign of the speed")
_CELLS = (np.arange(STROKE_CELLS), "1", "of the stroke, from its lower end")


def _table(index: str, main: str, about: str, /, **columns: tuple[Any, ...]) -> Table:
    """Return a table of columns: values, unit, description."""
    return Table(
        tuple(index.split()),
        {name: Column(values, *what) for name, (values, *what) in columns.items()},
        main,
        about,
    )


def model_tables(model: LoadModel, effort_unit: str) -> dict[str, Table]:
    """Return the tables of a model; `effort_unit` is that of what the motor does."""
    tables = _side_tables(model.sides) | _motion_tables(model, effort_unit)
    return {MODEL_TABLE + part: tables[part] for part in _PARTS}


def _side_tables(sides: Sequence[Side]) -> dict[str, Table]:
    """Return weights, scatter and factors of both signs of the speed."""
    from scipy.linalg import block_diag

    groups = [
        np.repeat([FUNCTION_GROUPS.index(g) for g in side.groups], list(map(size_of, side.groups)))
        for side in sides
    ]
    sign = np.repeat(SIDE_SIGNS, [len(group) for group in groups])
    term = np.arange(len(sign))
    weights = np.concatenate([side.weights for side in sides])
    levels = [len(side.levels) for side in sides]
    torque = np.concatenate([side.levels for side in sides])
    factor = np.concatenate([side.factors for side in sides])
    return {
        "": _table(
            "term",
            "weight",
            "effort of the motor by motion and torque: weights of smooth functions",
            term=(term, "1", "of one sign of the speed, then of the other"),
            sign=(sign, "1", "of the speed"),
            group=(np.concatenate(groups), "1", "of functions, by its number"),
            weight=(weights, "1", "times the unit of effort"),
        ),
        "_covariance": _table(
            "term other",
            "covariance",
            "of the weights, from how whole recordings disagree",
            term=(term, "1"),
            other=(term, "1"),
            covariance=(block_diag(*(side.covariance for side in sides)), "1", "of the weights"),
        ),
        "_scatter": _table(
            "side coefficient",
            "scatter",
            "scatter beside the model",
            side=_SIGNS,
            coefficient=(np.arange(3), "1", "constant, log of speed, torque"),
            scatter=([side.scatter for side in sides], "1", "logarithm of the variance of effort"),
            slope=([side.slope for side in sides], "1", "usual one of effort"),
            elsewhere=(
                [side.elsewhere for side in sides],
                "1",
                "factor on uncertainty, for strokes at other places",
            ),
            other_speeds=(
                [side.other_speeds for side in sides],
                "1",
                "errors over uncertainty at the first and the last speed, left out",
            ),
            bend=([side.bend for side in sides], "1", "of effort between two loads, if unknown"),
        ),
        "_factors": _table(
            "row",
            "factor",
            "what makes intervals hold at each load level",
            row=(np.arange(sum(levels)), "1"),
            side=(np.repeat(SIDE_SIGNS, levels), "1", "as there"),
            torque=(torque, "1"),
            factor=(factor, "1", "on uncertainty, from the level and from speeds left out"),
        ),
    }


def _motion_tables(model: LoadModel, effort_unit: str) -> dict[str, Table]:
    """Return units, and what both signs of the speed share: region, strokes, noise and loop."""
    loop, noise = model.loop, model.noise
    scales = asdict(model.scales) | {
        "lowest": model.torque_range[0],
        "highest": model.torque_range[1],
        "bandwidth": model.bandwidth_hz,
        "direction": float(model.direction),
        "slack": model.slack,
    }
    offset = np.full(STROKE_CELLS, loop.offset)
    return {
        "_scales": _table(
            "model",
            "effort",
            "what makes numbers near 1 of position, speed, torque and effort",
            model=(np.arange(1), "1"),
            effort=([model.effort_scale], effort_unit, "unit of effort"),
            **{key: ([scales[key]], *about) for key, about in _SCALES.items()},
        ),
        "_region": _table(
            "side cell",
            "highest",
            "speeds and torques at which the model was learned, margins included",
            side=_SIGNS,
            cell=_CELLS,
            **{key: (getattr(model.region, key), "1", what) for key, what in _REGION.items()},
        ),
        "_strokes": _table(
            "stroke",
            "middle",
            "places of the strokes that were learned",
            stroke=(np.arange(len(model.strokes)), "1"),
            middle=(model.strokes, "rad", "of the motor"),
        ),
        "_paces": _table(
            "pace",
            "speed",
            "speeds of the strokes",
            pace=(np.arange(len(model.paces.speeds)), "1"),
            speed=(model.paces.speeds, "rad/s", "root mean square, of the motor"),
            lowest=(model.paces.lowest, "1", "torque there, margin included"),
            highest=(model.paces.highest, "1", "torque there, margin included"),
        ),
        "_noise": _table(
            "octave",
            "highest",
            "noise of the effort above the bandwidth, by its unit squared",
            octave=(np.arange(OCTAVES), "1", "from twice the bandwidth on"),
            lowest=(noise.lowest, "s", "density"),
            highest=(noise.highest, "s", "density"),
            rounding=(np.full(OCTAVES, noise.rounding), "1", "variance, of all frequencies"),
        ),
        "_loop": _table(
            "cell",
            "mean",
            "loop of the torque that recordings of this mounting show, each left out",
            cell=_CELLS,
            mean=(loop.mean, "1", "torque while rising less while falling"),
            shape=(loop.shape, "1", "standard deviation, less the offset's"),
            offset=(offset, "1", "standard deviation of the whole's"),
            recordings=(np.full(STROKE_CELLS, loop.recordings), "1", "it is from"),
        ),
    }


def load_model_from(run: Run) -> tuple[LoadModel, str]:
    """Return the model of a run and the unit of its effort.

    Raises `RunFileError` where the run holds none or its tables do not belong together.
    """
    run.require_command("ilc-learn")
    if MODEL_TABLE not in run.tables:
        raise RunFileError(
            f"{run.path}: holds no load model: learn one with ilc-learn --implementation D from "
            "imported runs with a reference torque"
        )
    try:
        return _model_from(run.tables)
    except (KeyError, ValueError, IndexError) as error:
        raise RunFileError(
            f"{run.path}: its load model cannot be used: {error}; learn it again"
        ) from None


def _model_from(tables: Mapping[str, Table]) -> tuple[LoadModel, str]:
    terms, covariance, scales, scatter, factors, region, strokes, paces, noise, loop = (
        tables[MODEL_TABLE + part] for part in _PARTS
    )
    sides = []
    for number, sign in enumerate(SIDE_SIGNS):
        where = np.flatnonzero(terms["sign"] == sign)
        groups = tuple(FUNCTION_GROUPS[n] for n in dict.fromkeys(terms["group"][where].astype(int)))
        if (count := sum(size_of(name) for name in groups)) != len(where):
            raise ValueError(f"{len(where)} weights for {count} functions")
        own = factors["side"] == sign
        sides.append(
            Side(
                groups=groups,
                weights=terms["weight"][where],
                covariance=covariance["covariance"][np.ix_(where, where)],
                scatter=scatter["scatter"][number],
                levels=factors["torque"][own],
                factors=factors["factor"][own],
                slope=float(scatter["slope"][number]),
                elsewhere=float(scatter["elsewhere"][number]),
                other_speeds=float(scatter["other_speeds"][number]),
                bend=float(scatter["bend"][number]),
            )
        )
    model = LoadModel(
        scales=Scales(**{field.name: float(scales[field.name][0]) for field in fields(Scales)}),
        strokes=strokes["middle"],
        bandwidth_hz=float(scales["bandwidth"][0]),
        effort_scale=float(scales["effort"][0]),
        sides=(sides[0], sides[1]),
        torque_range=(float(scales["lowest"][0]), float(scales["highest"][0])),
        direction=int(scales["direction"][0]),
        region=Region(**{key: region[key] for key in _REGION}),
        loop=StrokeLoop(
            loop["mean"], loop["shape"], float(loop["offset"][0]), int(loop["recordings"][0])
        ),
        slack=float(scales["slack"][0]),
        paces=Paces(*(paces[name] for name in ("speed", "lowest", "highest"))),
        noise=LearnedNoise(noise["lowest"], noise["highest"], float(noise["rounding"][0])),
    )
    return model, scales.columns["effort"].unit
