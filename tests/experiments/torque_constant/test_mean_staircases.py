"""What hypotheses make of mean staircases."""

import numpy as np
import pytest

from rigtool.experiments.torque_constant.hypotheses import weigh_hypotheses
from rigtool.experiments.torque_constant.staircase import plateaus_of_set_point
from rigtool.experiments.torque_constant.staircase_model import arrange
from tests.experiments.torque_constant.staircases import Bench


def test_friction_is_the_bench_s_and_none_where_a_hypothesis_has_none():
    bench = Bench(friction=4e-3, force_noise=1e-4, ripple=(), saturation=0.0)
    signals = bench.record((20, 50), angles=2)
    stairs = arrange(plateaus_of_set_point(**signals, arm_length=0.54, settle_time=0.08))
    found = weigh_hypotheses(stairs, bench.coefficient, np.zeros(4))
    assert found.means.friction(found.weighed.best) == pytest.approx(4e-3, rel=0.05)
    without = type(found.weighed.best)(None, 1.0, None, 30.0)
    assert found.means.friction(without) == 0.0
    assert found.means.plateaus == 41


def test_noise_comes_back_into_the_courses_alone():
    bench = Bench(ripple=(), saturation=0.0)
    stairs = arrange(
        plateaus_of_set_point(**bench.record((20,), angles=2), arm_length=0.54, settle_time=0.08)
    )
    means = weigh_hypotheses(stairs, bench.coefficient, np.zeros(2)).means
    noisy, quiet = means.with_noise().stairs.courses, means.stairs.courses
    assert np.array_equal(noisy.course, quiet.course + stairs.courses.dropped)
    assert np.abs(noisy.course - quiet.course).max() > 1e-5
    assert means.stairs.courses is quiet
