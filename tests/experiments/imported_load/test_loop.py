"""The loop of recordings that is compared with those learned."""

import numpy as np
from numpy.testing import assert_allclose

from rigtool.experiments.imported_load.loop import learn_loop


def test_mean_and_deviation_are_those_of_the_recordings():
    place = np.tile(np.linspace(0.001, 0.999, 2000), 6)
    rising = np.repeat([True, False] * 3, 2000)
    recording = np.repeat([0, 1, 2], 4000)
    half = np.array([1.0, 2.0, 4.5])[recording]
    found = learn_loop(place, rising, np.where(rising, half, -half), recording)
    assert_allclose(found.mean, np.full(found.mean.shape, 5.0), rtol=1e-12)
    assert_allclose(found.offset, np.std([2.0, 4.0, 9.0], ddof=1), rtol=1e-12)
    assert_allclose(found.shape, 0, atol=1e-12)
    assert found.recordings == 3
