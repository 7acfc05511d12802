"""Where a load model gives values: at the learned places, speeds and torques."""

import numpy as np
import pytest

from rigtool.experiments.imported_load.region import learn_region

PHASE = np.linspace(0.05, np.pi - 0.05, 2000)
PLACE, SPEED = (1 - np.cos(PHASE)) / 2, np.sin(PHASE)


@pytest.mark.parametrize("several", [True, False])
def test_other_speeds_are_inside_only_where_speeds_were_learned(several):
    """Along one sine the speed follows from the place."""
    region = learn_region(PLACE, SPEED, np.zeros(2000), np.ones((2, 2)), several=several)
    inner = (PLACE > 0.1) & (PLACE < 0.9)
    assert region.holds(PLACE, SPEED, np.zeros(2000)).all()
    for ratio in (0.85, 1.09):
        inside = region.moves(PLACE, ratio * SPEED)[inner].mean()
        assert inside > 0.5 if several else inside < 0.4
