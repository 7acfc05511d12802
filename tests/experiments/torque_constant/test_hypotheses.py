"""What a grid of hypotheses leaves open."""

import numpy as np
import pytest

from rigtool.experiments.torque_constant import hypotheses
from rigtool.experiments.torque_constant.hypotheses import (
    LONGEST_TIME_CONSTANT,
    SHORTEST_TIME_CONSTANT,
)
from rigtool.experiments.torque_constant.staircase import plateaus_of_set_point
from rigtool.experiments.torque_constant.staircase_fit import fit_staircases
from tests.experiments.torque_constant.staircases import Bench


def test_friction_is_tried_as_well_with_every_time_constant(monkeypatch):
    """Else a friction that fits a little less well speaks for the time constant beside it."""
    tried = []
    joined = hypotheses._joined
    monkeypatch.setattr(
        hypotheses, "_joined", lambda parts: tried.append(joined(parts)) or tried[-1]
    )
    bench = Bench()
    signals = bench.record((20, 50), angles=2)
    fit_staircases(plateaus_of_set_point(**signals, arm_length=0.54, settle_time=0.08))
    best = tried[-1].commons[int(np.argmin(tried[-1].square))]
    beside = {
        round(one.time_constant, 6)
        for one in tried[-1].commons
        if one.transition == best.transition and one.exponent == best.exponent
    }
    assert len(beside) >= 11
    assert min(beside) == pytest.approx(SHORTEST_TIME_CONSTANT)
    assert max(beside) == pytest.approx(LONGEST_TIME_CONSTANT)


def test_what_all_staircases_have_in_common_makes_the_loss_by_heat_uncertain():
    """A curve of the gauge is alike at all angles, so that they do not scatter by it."""
    bench = Bench(saturation=0.0)
    signals = bench.record((20, 50), angles=4)
    bent = signals | {"force": signals["force"] + 3e-4 * np.sin(40 * signals["force"])}
    straight, curved = (
        fit_staircases(plateaus_of_set_point(**each, arm_length=0.54, settle_time=0.08))
        for each in (signals, bent)
    )
    assert curved.heating_u > 3 * straight.heating_u
