"""What a grid of hypotheses leaves open."""

import numpy as np
import pytest

from rigtool.experiments.torque_constant.hypotheses import TAU_STEP, _untried
from rigtool.experiments.torque_constant.staircase_model import HEATING_TIME, Common


@pytest.mark.parametrize("time_constant", [5.0, 30.0, 150.0])
def test_between_two_time_constants_a_loss_is_as_uncertain_as_their_distance(time_constant):
    """Against drawn time constants, all of which have the same loss after a staircase."""
    tau = time_constant * np.exp(TAU_STEP * np.linspace(-0.5, 0.5, 10_001))
    grown = np.expm1(-HEATING_TIME / tau) / np.expm1(-8.0 / tau)
    found = _untried(Common(None, 1.0, None, time_constant), 8.0)
    assert found == pytest.approx(np.std(np.log(grown)), rel=0.02, abs=0)
    assert _untried(Common(None, 1.0, None, time_constant), HEATING_TIME) == 0.0
