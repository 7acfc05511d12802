"""A load model in run files: how `ilc-learn --implementation D` writes it and others read it.

For runs of other rigs; `load_disturbance` holds what is learned on the bench's own rig.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields

import numpy as np

from rigtool.errors import RunFileError
from rigtool.experiments.imported_load.basis import GROUPS, Scales, size_of
from rigtool.experiments.imported_load.loop import Loop
from rigtool.experiments.imported_load.model import SIGNS, LoadModel, Side
from rigtool.experiments.imported_load.region import CELLS, Region
from rigtool.runfile import Column, Run, Table

MODEL = "load_model"
"""The first table of a model; the names of its other tables begin likewise."""

WIDE_MODEL = "wide_load_model"
"""The same for a model of a wider bandwidth."""

RANDOM = "random_split"
"""The table of errors at samples chosen at random."""

_SCALES = {
    "low": ("rad", "lowest position"),
    "high": ("rad", "highest position"),
    "speed": ("rad/s", "unit of speed: the highest, but for one sample in a hundred"),
    "standstill": ("rad/s", "below this speed friction is undetermined"),
    "acceleration": ("rad/s2", "unit of acceleration"),
    "torque": ("N m", "unit of torque: the highest"),
    "turn": ("rad", "one turn of the encoder; 0: no orders of rotation in the model"),
}

_REGION = {
    "slowest": "magnitude of the speed",
    "fastest": "magnitude of the speed",
    "lowest": "torque",
    "highest": "torque",
}

_LIMITS = {
    "lowest": ("1", "torque that is looked for, by its unit"),
    "highest": ("1", "torque that is looked for, by its unit"),
    "bandwidth": ("Hz", "of all signals"),
    "direction": ("1", "of the speed that the load resists"),
}


def tables_of(model: LoadModel, effort_unit: str, name: str = MODEL) -> dict[str, Table]:
    """Return the tables of a model, whose names begin with `name`.

    `effort_unit` is that of what the motor does.
    """
    sizes = [[size_of(group) for group in side.groups] for side in model.sides]
    group = [GROUPS.index(key) for side in model.sides for key in side.groups]
    every = [size for side in sizes for size in side]
    sign = np.repeat(SIGNS, [sum(side) for side in sizes])
    term = np.arange(sum(every))
    covariance = np.zeros((len(term), len(term)))
    for number, side in enumerate(model.sides):
        where = np.flatnonzero(sign == SIGNS[number])
        covariance[np.ix_(where, where)] = side.covariance

    signs = Column(np.array(SIGNS, dtype=float), "1", "sign of the speed")
    scales = {
        **{key: getattr(model.scales, key) for key in _SCALES},
        "lowest": model.torque_range[0],
        "highest": model.torque_range[1],
        "bandwidth": model.bandwidth_hz,
        "direction": float(model.direction),
    }
    return {
        name: Table(
            ("term",),
            {
                "term": Column(term, "1", "of one sign of the speed, then of the other"),
                "sign": Column(sign, "1", "of the speed"),
                "group": Column(np.repeat(group, every), "1", "of functions, by its number"),
                "weight": Column(
                    np.concatenate([item.weights for item in model.sides]),
                    "1",
                    "times the unit of effort",
                ),
            },
            "weight",
            "effort of the motor by motion and torque: weights of smooth functions",
        ),
        f"{name}_covariance": Table(
            ("term", "other"),
            {
                "term": Column(term, "1"),
                "other": Column(term, "1"),
                "covariance": Column(covariance, "1", "of the weights"),
            },
            "covariance",
            "of the weights, from how whole recordings disagree",
        ),
        f"{name}_scales": Table(
            ("model",),
            {
                "model": Column(np.arange(1), "1"),
                "effort": Column(np.array([model.effort_scale]), effort_unit, "unit of effort"),
                **{
                    key: Column(np.array([value]), *(_SCALES | _LIMITS)[key])
                    for key, value in scales.items()
                },
            },
            "effort",
            "what makes numbers near 1 of position, speed, torque and effort",
        ),
        f"{name}_scatter": Table(
            ("side", "coefficient"),
            {
                "side": signs,
                "coefficient": Column(np.arange(3), "1", "constant, log of speed, torque"),
                "scatter": Column(
                    np.stack([side.scatter for side in model.sides]),
                    "1",
                    "logarithm of the variance of effort",
                ),
                "slope": Column(
                    np.array([side.slope for side in model.sides]), "1", "usual one of effort"
                ),
            },
            "scatter",
            "scatter beside the model",
        ),
        f"{name}_factors": Table(
            ("row",),
            {
                "row": Column(np.arange(sum(len(side.levels) for side in model.sides)), "1"),
                "side": Column(
                    np.repeat(SIGNS, [len(side.levels) for side in model.sides]), "1", "as there"
                ),
                "torque": Column(np.concatenate([side.levels for side in model.sides]), "1"),
                "factor": Column(
                    np.concatenate([side.factors for side in model.sides]),
                    "1",
                    "on uncertainty, from the level and from speeds left out",
                ),
            },
            "factor",
            "what makes intervals hold at each load level",
        ),
        f"{name}_region": Table(
            ("side", "cell"),
            {
                "side": signs,
                "cell": Column(np.arange(CELLS), "1", "of the stroke, from its lower end"),
                **{
                    key: Column(getattr(model.region, key), "1", what)
                    for key, what in _REGION.items()
                },
            },
            "highest",
            "speeds and torques at which the model was learned, margins included",
        ),
        f"{name}_loop": Table(
            ("cell",),
            {
                "cell": Column(np.arange(CELLS), "1", "of the stroke, from its lower end"),
                "mean": Column(model.loop.mean, "1", "torque while rising less while falling"),
                "shape": Column(model.loop.shape, "1", "standard deviation, less the offset's"),
                "offset": Column(
                    np.full(CELLS, model.loop.offset), "1", "standard deviation of the whole loop's"
                ),
                "recordings": Column(np.full(CELLS, model.loop.recordings), "1", "it is from"),
            },
            "mean",
            "loop of the torque that recordings of this mounting show, each left out",
        ),
    }


def load_model_from(run: Run, name: str = MODEL) -> tuple[LoadModel, str]:
    """Return a model of a run and the unit of its effort.

    Raises `RunFileError` where the run holds none or its tables do not belong together.
    """
    run.require_command("ilc-learn")
    if name not in run.tables:
        raise RunFileError(
            f"{run.path}: holds no load model: learn one with ilc-learn --implementation D from "
            "imported runs with a reference torque"
        )
    try:
        return _model_from(run.tables, name)
    except (KeyError, ValueError, IndexError) as error:
        raise RunFileError(
            f"{run.path}: its load model cannot be used: {error}; learn it again"
        ) from None


def _model_from(tables: Mapping[str, Table], name: str) -> tuple[LoadModel, str]:
    terms, scales, covariance, scatter, factors, region, loop = (
        tables[name + part]
        for part in ("", "_scales", "_covariance", "_scatter", "_factors", "_region", "_loop")
    )
    sides = []
    for number, sign in enumerate(SIGNS):
        where = np.flatnonzero(terms["sign"] == sign)
        groups = tuple(GROUPS[n] for n in dict.fromkeys(terms["group"][where].astype(int)))
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
            )
        )
    model = LoadModel(
        scales=Scales(**{field.name: float(scales[field.name][0]) for field in fields(Scales)}),
        bandwidth_hz=float(scales["bandwidth"][0]),
        effort_scale=float(scales["effort"][0]),
        sides=(sides[0], sides[1]),
        torque_range=(float(scales["lowest"][0]), float(scales["highest"][0])),
        direction=int(scales["direction"][0]),
        region=Region(**{key: region[key] for key in _REGION}),
        loop=Loop(
            loop["mean"], loop["shape"], float(loop["offset"][0]), int(loop["recordings"][0])
        ),
    )
    return model, scales.columns["effort"].unit
