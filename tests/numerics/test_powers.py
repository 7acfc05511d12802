"""Powers of many numbers at once against numpy's."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from rigtool.numerics.powers import raise_to


@pytest.mark.parametrize("size", [1, 3, 64])
def test_powers_are_those_of_numpy(size):
    rng = np.random.default_rng(size)
    base = np.exp(rng.uniform(np.log(1e-300), np.log(1e3), size))
    base[:: size // 3 or 1] = 1.0
    exponent = rng.uniform(-0.5, 1.0, size)
    expected, power = base**exponent, base.copy()
    raise_to(power, power.view(np.uint64), exponent, np.empty(size))
    assert_allclose(power, expected, rtol=2e-11)
