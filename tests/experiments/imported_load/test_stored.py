"""A stored model is the one that was learned, in every number."""

from dataclasses import fields, is_dataclass, replace

import numpy as np
import pytest

from rigtool.experiments.imported_load.learning import learn_load_model
from rigtool.experiments.imported_load.stored import MODEL_TABLE, _model_from, model_tables
from rigtool.runfile import Table
from tests.experiments.imported_load.loaded_drive import observations


def require_equal(one, other, name=""):
    if is_dataclass(one):
        assert type(one) is type(other)
        for each in fields(one):
            require_equal(getattr(one, each.name), getattr(other, each.name), each.name)
    elif isinstance(one, tuple) and one and is_dataclass(one[0]):
        for a, b in zip(one, other, strict=True):
            require_equal(a, b, name)
    else:
        np.testing.assert_array_equal(np.asarray(one), np.asarray(other), err_msg=name)


def test_a_stored_model_is_the_learned_one():
    model = learn_load_model(observations(frequencies=(0.2,)), turn=10.0).model
    first, second = (side.covariance for side in model.sides)
    assert not np.array_equal(first, second)
    tables = model_tables(model, "A")
    found, unit = _model_from(tables)
    assert unit == "A"
    require_equal(model, found)
    weights = tables[MODEL_TABLE]
    fewer = {
        name: replace(column, values=column.values[1:]) for name, column in weights.columns.items()
    }
    shorter = Table(weights.axes, fewer, weights.signal, "")
    with pytest.raises(ValueError, match=r"\d+ weights for \d+ functions"):
        _model_from(tables | {MODEL_TABLE: shorter})
