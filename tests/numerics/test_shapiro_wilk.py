"""The test of Shapiro and Wilk, against scipy's."""

import numpy as np
import pytest
from scipy import stats

from rigtool.numerics.shapiro_wilk import shapiro_wilk


@pytest.mark.parametrize("count", [3, 4, 5, 6, 11, 12, 40, 500, 5000])
@pytest.mark.parametrize("shape", ["standard_normal", "exponential", "random", "standard_cauchy"])
def test_agrees_with_scipy(count, shape):
    readings = np.sort(getattr(np.random.default_rng(count), shape)(size=count))
    scaled = (readings - readings.mean()) / readings.std()
    w, p = shapiro_wilk(scaled)
    expected = stats.shapiro(scaled)
    assert w == pytest.approx(expected.statistic, rel=1e-6)  # scipy's scores have seven digits
    assert p == pytest.approx(expected.pvalue, rel=1e-5, abs=1e-12)
