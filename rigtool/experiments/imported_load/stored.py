"""A load model in run files: how `ilc-learn --implementation D` writes it and others read it.

For runs of other rigs; `force_model.stored` holds what is learned on the bench's own rig.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, fields
from typing import Any

import numpy as np

from rigtool.errors import RunFileError
from rigtool.experiments.imported_load.basis import FUNCTION_GROUPS, Scales, size_of
from rigtool.experiments.imported_load.loop import StrokeLoop
from rigtool.experiments.imported_load.model import SIDE_SIGNS, LoadModel, Side
from rigtool.experiments.imported_load.noise import OCTAVES, LearnedNoise
from rigtool.experiments.imported_load.region import STROKE_CELLS, Region
from rigtool.runfile import Column, Run, Table

MODEL_TABLE = "load_model"
"""The first table of a model; the names of its other tables begin likewise."""

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

_CELL = ("1", "of the stroke, from its lower end")


def _table(index: str, columns: Mapping[str, tuple[Any, ...]], main: str, about: str) -> Table:
    """Return a table of columns: values, unit, description."""
    return Table(
        tuple(index.split()),
        {name: Column(np.asarray(values), *what) for name, (values, *what) in columns.items()},
        main,
        about,
    )


def model_tables(model: LoadModel, effort_unit: str) -> dict[str, Table]:
    """Return the tables of a model; `effort_unit` is that of what the motor does."""
    sides, loop, noise = model.sides, model.loop, model.noise
    groups = [
        np.repeat(
            [FUNCTION_GROUPS.index(g) for g in side.groups], [size_of(g) for g in side.groups]
        )
        for side in sides
    ]
    sign = np.repeat(SIDE_SIGNS, [len(group) for group in groups])
    term = np.arange(len(sign))
    covariance = np.zeros((len(term), len(term)))
    for own, side in zip(SIDE_SIGNS, sides, strict=True):
        where = np.flatnonzero(sign == own)
        covariance[np.ix_(where, where)] = side.covariance
    scales = asdict(model.scales) | {
        "lowest": model.torque_range[0],
        "highest": model.torque_range[1],
        "bandwidth": model.bandwidth_hz,
        "direction": float(model.direction),
        "slack": model.slack,
    }
    signs = (np.array(SIDE_SIGNS, dtype=float), "1", "sign of the speed")
    levels = [len(side.levels) for side in sides]
    parts = {
        "": _table(
            "term",
            {
                "term": (term, "1", "of one sign of the speed, then of the other"),
                "sign": (sign, "1", "of the speed"),
                "group": (np.concatenate(groups), "1", "of functions, by its number"),
                "weight": (
                    np.concatenate([side.weights for side in sides]),
                    "1",
                    "times the unit of effort",
                ),
            },
            "weight",
            "effort of the motor by motion and torque: weights of smooth functions",
        ),
        "_covariance": _table(
            "term other",
            {
                "term": (term, "1"),
                "other": (term, "1"),
                "covariance": (covariance, "1", "of the weights"),
            },
            "covariance",
            "of the weights, from how whole recordings disagree",
        ),
        "_scales": _table(
            "model",
            {
                "model": (np.arange(1), "1"),
                "effort": ([model.effort_scale], effort_unit, "unit of effort"),
                **{key: ([scales[key]], *about) for key, about in _SCALES.items()},
            },
            "effort",
            "what makes numbers near 1 of position, speed, torque and effort",
        ),
        "_scatter": _table(
            "side coefficient",
            {
                "side": signs,
                "coefficient": (np.arange(3), "1", "constant, log of speed, torque"),
                "scatter": (
                    [side.scatter for side in sides],
                    "1",
                    "logarithm of the variance of effort",
                ),
                "slope": ([side.slope for side in sides], "1", "usual one of effort"),
                "elsewhere": (
                    [side.elsewhere for side in sides],
                    "1",
                    "factor on uncertainty, for strokes at other places",
                ),
                "between": (
                    [side.between for side in sides],
                    "1",
                    "the same at other speeds, where two were learned",
                ),
            },
            "scatter",
            "scatter beside the model",
        ),
        "_factors": _table(
            "row",
            {
                "row": (np.arange(sum(levels)), "1"),
                "side": (np.repeat(SIDE_SIGNS, levels), "1", "as there"),
                "torque": (np.concatenate([side.levels for side in sides]), "1"),
                "factor": (
                    np.concatenate([side.factors for side in sides]),
                    "1",
                    "on uncertainty, from the level and from speeds left out",
                ),
            },
            "factor",
            "what makes intervals hold at each load level",
        ),
        "_region": _table(
            "side cell",
            {
                "side": signs,
                "cell": (np.arange(STROKE_CELLS), *_CELL),
                **{key: (getattr(model.region, key), "1", what) for key, what in _REGION.items()},
            },
            "highest",
            "speeds and torques at which the model was learned, margins included",
        ),
        "_strokes": _table(
            "stroke",
            {
                "stroke": (np.arange(len(model.strokes)), "1"),
                "middle": (model.strokes, "rad", "of the motor"),
            },
            "middle",
            "places of the strokes that were learned",
        ),
        "_paces": _table(
            "pace",
            {
                "pace": (np.arange(len(model.paces)), "1"),
                "speed": (model.paces, "rad/s", "root mean square, of the motor"),
            },
            "speed",
            "speeds of the strokes, where two were learned",
        ),
        "_noise": _table(
            "octave",
            {
                "octave": (np.arange(OCTAVES), "1", "from twice the bandwidth on"),
                "lowest": (noise.lowest, "s", "density"),
                "highest": (noise.highest, "s", "density"),
                "rounding": (np.full(OCTAVES, noise.rounding), "1", "variance, of all frequencies"),
            },
            "highest",
            "noise of the effort above the bandwidth, by its unit squared",
        ),
        "_loop": _table(
            "cell",
            {
                "cell": (np.arange(STROKE_CELLS), *_CELL),
                "mean": (loop.mean, "1", "torque while rising less while falling"),
                "shape": (loop.shape, "1", "standard deviation, less the offset's"),
                "offset": (
                    np.full(STROKE_CELLS, loop.offset),
                    "1",
                    "standard deviation of the whole's",
                ),
                "recordings": (np.full(STROKE_CELLS, loop.recordings), "1", "it is from"),
            },
            "mean",
            "loop of the torque that recordings of this mounting show, each left out",
        ),
    }
    return {MODEL_TABLE + name: table for name, table in parts.items()}


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
    terms, scales, covariance, scatter, factors, region, noise, loop = (
        tables[MODEL_TABLE + part]
        for part in (
            *("", "_scales", "_covariance", "_scatter"),
            *("_factors", "_region", "_noise", "_loop"),
        )
    )
    paces = tables.get(MODEL_TABLE + "_paces")  # none in older tables
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
                between=float(scatter["between"][number]) if "between" in scatter.columns else 1.0,
            )
        )
    model = LoadModel(
        scales=Scales(**{field.name: float(scales[field.name][0]) for field in fields(Scales)}),
        strokes=tables[MODEL_TABLE + "_strokes"]["middle"],
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
        paces=paces["speed"] if paces is not None else np.empty(0),
        noise=LearnedNoise(noise["lowest"], noise["highest"], float(noise["rounding"][0])),
    )
    return model, scales.columns["effort"].unit
