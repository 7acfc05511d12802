"""A load model in run files: how `ilc-learn --implementation D` writes it, others read it.

For runs of other rigs; what is learned on the bench's own rig is in `load_tables`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields

import numpy as np

from rigtool.analysis.load_basis import GROUPS, Scales
from rigtool.analysis.load_model import LoadModel
from rigtool.analysis.load_region import Region
from rigtool.errors import RunFileError
from rigtool.runfile import Column, Run, Table

MODEL = "load_model"
"""The table that says that a run holds such a model."""

_SCALES = {
    "low": ("rad", "lowest position"),
    "high": ("rad", "highest position"),
    "speed": ("rad/s", "unit of speed: the highest, but for one sample in a hundred"),
    "standstill": ("rad/s", "below this speed friction is undetermined"),
    "acceleration": ("rad/s2", "unit of acceleration"),
    "torque": ("N m", "unit of torque: the highest"),
    "turn": ("rad", "one turn of the encoder; 0: no orders of rotation in the model"),
}


def tables_of(model: LoadModel, effort_unit: str) -> dict[str, Table]:
    """Return the tables of a model; `effort_unit` is that of what the motor does."""
    sizes = model.sizes()
    group = np.repeat([GROUPS.index(name) for name in model.degree], sizes)
    degree = np.repeat(list(model.degree.values()), sizes)
    term = np.arange(len(group))
    scale = {
        name: Column(np.array([getattr(model.scales, name)]), unit, what)
        for name, (unit, what) in _SCALES.items()
    }
    return {
        MODEL: Table(
            ("term",),
            {
                "term": Column(term, "1", "in the order of the groups"),
                "group": Column(group, "1", "what kind of function, see the file format"),
                "degree": Column(degree, "1", "of smoothing, chosen by levels left out"),
                "weight": Column(model.weights, "1", "times the unit of effort"),
            },
            "weight",
            "effort of the motor by motion and torque: weights of smooth functions",
        ),
        "load_model_covariance": Table(
            ("term", "other"),
            {
                "term": Column(term, "1"),
                "other": Column(term, "1"),
                "covariance": Column(model.covariance, "1", "of the weights"),
            },
            "covariance",
            "from how whole recordings disagree",
        ),
        "load_model_scales": Table(
            ("model",),
            {
                "model": Column(np.arange(1), "1"),
                "effort": Column(np.array([model.effort_scale]), effort_unit, "unit of effort"),
                **scale,
                "bandwidth": Column(np.array([model.bandwidth_hz]), "Hz", "of all signals"),
                "direction": Column(
                    np.array([float(model.direction)]), "1", "of the speed that the load resists"
                ),
            },
            "effort",
            "what makes numbers near 1 of position, speed, torque and effort",
        ),
        "load_model_scatter": Table(
            ("side", "coefficient"),
            {
                "side": Column(np.array([1.0, -1.0]), "1", "sign of the speed"),
                "coefficient": Column(np.arange(3), "1", "constant, log of speed, torque"),
                "scatter": Column(model.scatter, "1", "logarithm of the variance of effort"),
                "factor": Column(model.factor, "1", "on uncertainty, from levels left out"),
                "common": Column(model.common, "N m", "S of the mean error of a recording"),
            },
            "scatter",
            "scatter beside the model",
        ),
        "load_model_region": Table(
            ("side", "face"),
            {
                "side": Column(np.array([1.0, -1.0]), "1", "sign of the speed"),
                "face": Column(np.arange(model.region.reach.shape[1]), "1"),
                "reach": Column(model.region.reach, "1", "of the half-space, margin included"),
            },
            "reach",
            "half-spaces of position, speed and torque in which the model was learned",
        ),
    }


def load_model_from(run: Run) -> tuple[LoadModel, str]:
    """Return the model of a run and the unit of its effort.

    Raises `RunFileError` where the run holds none or its tables do not belong together.
    """
    run.require_command("ilc-learn")
    if MODEL not in run.tables:
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
    terms, scales = tables[MODEL], tables["load_model_scales"]
    scatter = tables["load_model_scatter"]
    group = terms["group"].astype(int)
    degree = {GROUPS[int(n)]: float(terms["degree"][group == n][0]) for n in dict.fromkeys(group)}
    model = LoadModel(
        scales=Scales(**{field.name: float(scales[field.name][0]) for field in fields(Scales)}),
        bandwidth_hz=float(scales["bandwidth"][0]),
        effort_scale=float(scales["effort"][0]),
        degree=degree,
        weights=terms["weight"],
        covariance=tables["load_model_covariance"]["covariance"],
        scatter=scatter["scatter"],
        factor=scatter["factor"],
        common=scatter["common"],
        direction=int(scales["direction"][0]),
        region=Region(tables["load_model_region"]["reach"]),
    )
    if sum(model.sizes()) != len(model.weights):
        raise ValueError(f"{len(model.weights)} weights, {sum(model.sizes())} functions")
    return model, scales.columns["effort"].unit
