"""Rows of the path of a shaft."""

import numpy as np
import pytest

from rigtool.experiments.imported_load.basis import END_TIME, block_means, path_of

RATE = 990.0


@pytest.mark.parametrize(
    ("bandwidth_hz", "size", "factor"),
    [(2.0, 19, 1), (30.0, 6, 3)],  # no more than leave 50 and 150 per second
)
def test_rows_are_all_that_are_not_at_the_ends(bandwidth_hz, size, factor):
    time = np.arange(round(10 * RATE)) / RATE
    path, _ = path_of(time, np.sin(time), bandwidth_hz)
    thinned = block_means(time, size)[::factor]
    first, last = thinned[0] + END_TIME, thinned[-1] - END_TIME
    expected = thinned[(thinned >= first) & (thinned <= last)]
    np.testing.assert_allclose(path.time, expected, rtol=0, atol=1e-12)
