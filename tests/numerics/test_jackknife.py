import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from rigtool.numerics.jackknife import jackknife


@settings(max_examples=50, deadline=None)
@given(st.lists(st.floats(-1e3, 1e3), min_size=2, max_size=30))
def test_of_a_mean_is_its_standard_error(values):
    data = np.array(values)
    value, u = jackknife(len(data), lambda keep: float(data[keep].mean()))
    assert value == pytest.approx(data.mean(), rel=1e-12, abs=1e-12)
    assert u == pytest.approx(stats.sem(data), rel=1e-6, abs=1e-9)


def test_of_an_rms_agrees_with_error_propagation():
    data = np.random.default_rng(5).normal(3, 0.1, 200)
    _, u = jackknife(len(data), lambda keep: float(np.sqrt(np.mean(data[keep] ** 2))))
    assert u == pytest.approx(0.1 / np.sqrt(200), rel=0.1, abs=0)


def test_one_repeat_is_refused():
    with pytest.raises(ValueError, match="at least 2"):
        jackknife(1, lambda keep: 0.0)
