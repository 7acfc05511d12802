"""The model for force over time in run files: how it is written and read back."""

from __future__ import annotations

from dataclasses import asdict, fields

import numpy as np

from rigtool.errors import RunFileError
from rigtool.experiments.force_filter.motion_states import KIND_COUNT
from rigtool.experiments.force_model.contacts import MotionKind
from rigtool.experiments.force_model.deviations import Deviations
from rigtool.experiments.force_model.force_model import ForceModel
from rigtool.experiments.force_model.learning import LearnedModel
from rigtool.experiments.force_model.model import Kind, Known, Shape, Term
from rigtool.experiments.force_model.sliding_problem import SLIDING_PARAMETERS
from rigtool.numerics.arrays import Array
from rigtool.quantity import Quantity
from rigtool.recipe import Recipe
from rigtool.runfile import Column, Run, Table

TERMS, COVARIANCE = "force_terms", "force_covariance"
SCALES, LIMITS = "force_scales", "contact_thresholds"

MODEL_PREFIX = "model_"
"""Prefix of results that belong to the model."""

OFFSET, CONSTANT = "offset_current", "torque_constant"

MODEL_UNITS = {
    "bearing_length": "rad",
    "housing_length": "rad",
    "tip_length": "rad",
    "stribeck_speed": "rad/s",
    "ripple_time": "s",
    "stiffness": "N m/rad",
    "damping": "N m s/rad",
    "tip_friction": "N m",
    "grasper_inertia": "kg m2",
    "load_onset": "N m",
    "direction_ratio": "1",
    "stroke": "N m",
    "load": "1",
    "noise": "N m",
    "noise_time": "s",
    OFFSET: "A",
}
"""Units of shape, deviations and the amplifier's offset."""

BEST_READ = ("bearing_length", "housing_length", "tip_length", "stribeck_speed")
"""What rest and reversals determine: the filter reads best with these, in steps of time and counts
that the contacts do not have. They are off by more than its search shows."""

_MOTIONS = ", ".join(f"{motion.value} {motion.name.lower()}" for motion in MotionKind)

_FORMS = {
    "smoothed": "torque from the whole recording",
    "causal": "torque from samples up to its time",
}
_OF_SCALES = {"": "c", "_share": "g"}

_ABOUT = {
    "kind": "what it is a function of: " + ", ".join(f"{k.value} {k.name.lower()}" for k in Kind),
    "order": "of the rotor's or the output's angle, 0 for none",
    "quarter": "0 cosine, 1 sine of the angle",
    "spread": "of the coefficient, before anything was known",
}


def model_results(model: ForceModel) -> dict[str, Quantity]:
    """Return shape and deviations of a model as results."""
    scatter = {
        name: Quantity(value, MODEL_UNITS[name], reason="a measure of scatter itself")
        for name, value in asdict(model.deviations).items()
    }
    offset = model.learned.known.offset
    scatter[OFFSET] = Quantity(offset, "A", reason="that of the calibration")
    named = {MODEL_PREFIX + name: result for name, result in scatter.items()}
    return shape_results(model.learned) | named


def shape_results(learned: LearnedModel) -> dict[str, Quantity]:
    """Return the shape of a model as results, with standard uncertainty where it has one."""
    relative = dict(
        zip(SLIDING_PARAMETERS, np.sqrt(np.diag(learned.covariance)).tolist(), strict=False)
    )

    def result(name: str, value: float) -> Quantity:
        if name in BEST_READ:
            return Quantity(value, MODEL_UNITS[name], reason="what this filter reads best with")
        return Quantity(value, MODEL_UNITS[name], value * relative[name])

    shape = asdict(learned.shape)
    return {MODEL_PREFIX + name: result(name, value) for name, value in shape.items()}


def model_tables(model: ForceModel) -> dict[str, Table]:
    """Return coefficients and covariance of a model, which `model_from` reads back."""
    learned = model.learned
    us = np.sqrt(np.diag(learned.covariance))[len(SLIDING_PARAMETERS) :]
    every = np.arange(len(learned.covariance))
    return {
        TERMS: Table(
            ("term",),
            {
                "term": Column(np.arange(len(learned.terms)), "1"),
                **{
                    name: Column([float(getattr(term, name)) for term in learned.terms], "1", about)
                    for name, about in _ABOUT.items()
                },
                "coefficient": Column(learned.coefficient, "1", "N m for each SI unit of the term"),
                "u": Column(us, "1", "standard uncertainty"),
            },
            "coefficient",
            "what the motor's current does besides the torque on the output, as a sum of functions",
        ),
        COVARIANCE: Table(
            ("parameter", "other_parameter"),
            {
                "parameter": Column(
                    every, "1", "logarithms of " + ", ".join(SLIDING_PARAMETERS) + "; terms"
                ),
                "other_parameter": Column(every, "1"),
                "covariance": Column(learned.covariance, "1", "SI units of both"),
            },
            "covariance",
            "covariance of the model's shape and of the terms' coefficients",
        ),
        SCALES: Table(
            ("state",),
            {
                "state": Column(
                    np.arange(KIND_COUNT),
                    "1",
                    f"as in table force; {KIND_COUNT - 1} sliding, but creeping",
                ),
                **{
                    name + part: Column(model.scales[form, :, column], "1", f"{about}, {of}")
                    for column, (part, about) in enumerate(_OF_SCALES.items())
                    for form, (name, of) in enumerate(_FORMS.items())
                },
            },
            "smoothed",
            "c and g of the standard uncertainty u of a torque M: u^2 = (c s)^2 + (g M)^2, s the "
            "filter's deviation",
        ),
        LIMITS: Table(
            ("motion",),
            {
                "motion": Column(np.arange(len(MotionKind)), "1", _MOTIONS),
                "jump": Column(_finite(model.limits[:, 0]), "N m", "of the torque"),
                "level": Column(_finite(model.limits[:, 1]), "1", "of torque over deviation"),
            },
            "jump",
            "thresholds by which contacts are found; NaN where too little was recorded",
        ),
    }


def _finite(values: Array) -> Array:
    return np.where(np.isfinite(values), values, np.nan)


def model_from(run: Run, recipe: Recipe) -> ForceModel:
    """Return the model of a run of `ilc-learn --implementation D`, for the rig of a recipe.

    Raises `RunFileError` where the run holds none, or a broken one.
    """
    if missing := [name for name in (TERMS, COVARIANCE, SCALES, LIMITS) if name not in run.tables]:
        raise RunFileError(
            f"{run.path}: holds no model of motor and instrument (table {missing[0]}): learn again "
            "with ilc-learn --implementation D"
        )
    table = run.table(TERMS, **dict.fromkeys((*_ABOUT, "coefficient"), "1"))
    rig = (run.recipe or recipe).rig  # coefficients rest on its values

    try:
        terms = tuple(
            Term(Kind(int(kind)), float(spread), int(order), int(quarter))
            for kind, spread, order, quarter in zip(
                *(table[name] for name in ("kind", "spread", "order", "quarter")), strict=True
            )
        )
        sizes = {f.name: _value(run, f.name, positive=True) for f in fields(Shape)}
        covariance = run.table(COVARIANCE, covariance="1")["covariance"]
        learned = LearnedModel(
            terms,
            Shape(**sizes),
            Known(rig.angle_ratio, rig.torque_factor, rig.nominal_inertia, _value(run, OFFSET)),
            table["coefficient"],
            covariance.reshape(len(SLIDING_PARAMETERS) + len(terms), -1),
            np.zeros(2),
        )
        random = {
            f.name: _value(run, f.name, positive=f.name == "noise_time") for f in fields(Deviations)
        }
        scales = run.table(
            SCALES, **dict.fromkeys([name + p for name in _FORMS for p in _OF_SCALES], "1")
        )
        factors = np.array([[scales[name + part] for part in _OF_SCALES] for name in _FORMS])
        factors = factors.astype(np.float64).swapaxes(1, 2).reshape(2, KIND_COUNT, 2)
        limits = run.table(LIMITS)
        finite = np.array([limits["jump"], limits["level"]], dtype=np.float64).T
        thresholds = np.where(np.isnan(finite), np.inf, finite).reshape(len(MotionKind), 2)
    except (KeyError, TypeError, ValueError, ArithmeticError) as error:
        raise RunFileError(
            f"{run.path}: its model of motor and instrument cannot be used: {error}; learn it again"
        ) from None
    return ForceModel(learned, Deviations(**random), factors, thresholds)


def _value(run: Run, name: str, *, positive: bool = False) -> float:
    value = run.result(MODEL_PREFIX + name, MODEL_UNITS[name]).value
    if positive and not value > 0:
        raise ValueError(f"{MODEL_PREFIX}{name} is {value:g}, must be positive")
    return value
