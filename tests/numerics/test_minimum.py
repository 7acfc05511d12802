"""Minimum of one positive number, and the checks that analyses share."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from rigtool.errors import InsufficientDataError
from rigtool.numerics.checks import require_rising, require_signals
from rigtool.numerics.minimum import minimum


@given(bottom=st.floats(1e-6, 1e6), width=st.floats(0.1, 5.0))
@settings(max_examples=50, deadline=None)
def test_bottom_of_a_valley_is_found(bottom, width):
    found = minimum(lambda x: (math.log(x / bottom) / width) ** 2, bottom / 300, bottom * 70)
    assert_allclose(found, bottom, rtol=2e-3)


def test_minimum_at_a_bound_stays_there():
    assert_allclose(minimum(lambda x: x, 0.5, 20.0), 0.5, rtol=2e-3)
    assert_allclose(minimum(lambda x: -x, 0.5, 20.0), 20.0, rtol=2e-3)


def test_signals_come_back_as_floats():
    time, torque = require_signals(3, time=[0, 1, 2], torque=np.arange(3, dtype=np.float32))
    assert time.dtype == torque.dtype == np.float64
    assert require_rising(time) == 1.0


@pytest.mark.parametrize(
    ("signals", "message"),
    [
        ({"a": [1.0, 2.0, np.nan, np.nan]}, r"a is nan at sample 2 \(2 of 4"),
        ({"a": [1.0, 2.0, 3.0], "b": [1.0]}, "b has 1 samples but a has 3"),
        ({"a": [[1.0, 2.0, 3.0]]}, "2 dimensions"),
        ({"a": [1.0]}, "1 samples are too few, 3 are needed"),
    ],
)
def test_signals_that_cannot_be_analysed(signals, message):
    with pytest.raises(InsufficientDataError, match=message):
        require_signals(3, **signals)


def test_time_must_rise():
    with pytest.raises(InsufficientDataError, match="does not rise at sample 2"):
        require_rising(np.array([0.0, 1.0, 1.0, 2.0]))
