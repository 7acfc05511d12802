"""Loads of closing strokes, against statistics of the strokes themselves."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from rigtool.experiments.force.imported_strokes import Strokes, stroke_loads


def test_a_load_is_the_mean_of_all_strokes_and_its_u_that_of_runs():
    luck = np.random.default_rng(5)
    place, middle = np.linspace(0, 1, 51), 25
    runs = [
        Strokes(place, 0.05 + 1e-3 * luck.standard_normal((count, 51)), np.full((count, 51), 0.049))
        for count in (3, 4)
    ]
    found = stroke_loads(runs, [0, 0])
    torque = np.concatenate([one.torque[:, middle] for one in runs])
    errors = [np.mean(one.torque[:, middle] - 0.049) for one in runs]
    assert_allclose(found["mean_torque"], [torque.mean()], rtol=1e-12)
    assert_allclose(found["std_torque"], [np.std(torque, ddof=1)], rtol=1e-12)
    assert_allclose(found["mean_torque_u"], [np.std(errors, ddof=1) / np.sqrt(2)], rtol=1e-12)
    assert_allclose(found["applied_torque"], [0.049], rtol=1e-12)


@pytest.mark.parametrize("direction", [1, -1])
def test_a_single_stroke_has_no_scatter(direction):
    place = np.linspace(0, 1, 51)
    one = Strokes(place, np.full((1, 51), 0.05 * direction), np.full((1, 51), 0.049 * direction))
    found = stroke_loads([one], [0])
    assert_allclose(found["mean_torque"], [0.05], rtol=1e-12)
    assert np.isnan(found["std_torque"]).all()
