"""A model comes back from a run file as it was, and a broken one is refused."""

from dataclasses import replace

import numpy as np
import pytest

from rigtool.errors import RunFileError
from rigtool.experiments.force_filter.motion_states import KIND_COUNT
from rigtool.experiments.force_model.contacts import MotionKind
from rigtool.experiments.force_model.deviations import Deviations
from rigtool.experiments.force_model.force_model import ForceModel
from rigtool.experiments.force_model.learning import LearnedModel
from rigtool.experiments.force_model.model import Kind, Known, Shape, Term
from rigtool.experiments.force_model.sliding_problem import SLIDING_PARAMETERS
from rigtool.experiments.force_model.stored import (
    LIMITS,
    TERMS,
    model_from,
    model_results,
    model_tables,
)
from rigtool.quantity import Quantity
from rigtool.recipe import load_recipe
from rigtool.runfile import RunWriter, open_run
from tests.experiments.virtual_runs import RECIPE

RECIPE_HERE, _ = load_recipe(RECIPE, ())
RIG = RECIPE_HERE.rig
RNG = np.random.default_rng(1)
SIZE = len(SLIDING_PARAMETERS) + 3
ROOT = RNG.normal(size=(SIZE, SIZE))
SHAPE = Shape(1e-3, 2e-2, 3e-2, 0.4, 5e-3, 0.6, 7e-4, 8e-3, 9e-6, 1e-3, 1.1)
MODEL = ForceModel(
    LearnedModel(
        (
            Term(Kind.HOUSING, 0.1, 3, 1),
            Term(Kind.BEARING, 0.2),
            Term(Kind.LOAD_FRICTION, 0.3, 1, 0),
        ),
        SHAPE,
        Known(RIG.angle_ratio, RIG.torque_factor, RIG.nominal_inertia, 6e-3),
        RNG.normal(size=3),
        ROOT @ ROOT.T,
        np.array([0.3, 0.4]),
    ),
    Deviations(1e-4, 2e-2, 3e-5, 0.4),
    RNG.uniform(1, 2, (2, KIND_COUNT, 2)),
    np.append(RNG.uniform(1, 2, (len(MotionKind) - 1, 2)), [[np.inf, np.inf]], axis=0),
)


def stored(path, tables=None, **changes):
    with RunWriter(path, command="ilc-learn") as writer:
        writer.finish(model_results(MODEL) | changes, model_tables(MODEL) | (tables or {}))
    return open_run(path)


def test_all_numbers_come_back(tmp_path):
    with stored(tmp_path / "model.h5") as run:
        found = model_from(run, RECIPE_HERE)
    one, other = found.learned, MODEL.learned
    assert (one.terms, one.shape, one.known) == (other.terms, other.shape, other.known)
    assert found.deviations == MODEL.deviations
    np.testing.assert_array_equal(one.coefficient, other.coefficient)
    np.testing.assert_array_equal(one.covariance, other.covariance)
    np.testing.assert_array_equal(found.scales, MODEL.scales)
    np.testing.assert_array_equal(found.limits, MODEL.limits)


def test_each_parameter_has_the_u_of_its_logarithm():
    """But for those that the filter reads best with: their search was 3 u off and more."""
    results = model_results(MODEL)
    lengths = ["bearing_length", "housing_length", "tip_length"]
    without = [*lengths, "stribeck_speed"]
    for number, name in enumerate(SLIDING_PARAMETERS):
        if name not in without:
            relative = np.linalg.norm(ROOT[number])
            expected = relative * getattr(SHAPE, name)
            assert results[f"model_{name}"].u == pytest.approx(expected, rel=1e-9)
    for name in without:
        found = results[f"model_{name}"]
        assert (found.value, found.u) == (getattr(SHAPE, name), None)
        assert "reads best" in found.reason
    table = model_tables(MODEL)[TERMS]
    u = np.linalg.norm(ROOT[len(SLIDING_PARAMETERS) :], axis=1)
    np.testing.assert_allclose(table["u"], u, rtol=1e-9)
    assert np.isnan(model_tables(MODEL)[LIMITS]["jump"][-1])


@pytest.mark.parametrize("name", ["stiffness", "noise_time"])
def test_a_size_that_is_not_positive_is_refused(tmp_path, name):
    unit = {"stiffness": "N m/rad", "noise_time": "s"}[name]
    broken = {f"model_{name}": Quantity(0.0, unit, reason="made")}
    with (
        stored(tmp_path / "model.h5", **broken) as run,
        pytest.raises(RunFileError, match=f"model_{name} is 0, must be positive"),
    ):
        model_from(run, RECIPE_HERE)


def test_a_run_without_a_model_or_of_other_sizes_is_refused(tmp_path):
    with RunWriter(tmp_path / "none.h5", command="ilc-learn") as writer:
        writer.finish(model_results(MODEL), {})
    with (
        open_run(tmp_path / "none.h5") as run,
        pytest.raises(RunFileError, match="holds no model of motor and instrument"),
    ):
        model_from(run, RECIPE_HERE)
    learned = replace(
        MODEL.learned,
        terms=MODEL.learned.terms[1:],
        coefficient=np.ones(2),
        covariance=np.eye(SIZE - 1),
    )
    terms = model_tables(replace(MODEL, learned=learned))[TERMS]
    with (
        stored(tmp_path / "other.h5", {TERMS: terms}) as run,
        pytest.raises(RunFileError, match="cannot be used"),
    ):
        model_from(run, RECIPE_HERE)
