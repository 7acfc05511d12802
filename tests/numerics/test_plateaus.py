"""Plateaus of a signal: steps come back, ramps and slow waves are none."""

import numpy as np

from rigtool.numerics.plateaus import find_plateaus


def test_steps_come_back_and_ramps_do_not():
    level = np.concatenate([np.full(10, 1.0), np.full(8, 2.0), np.linspace(2, 9, 50), [9.0] * 5])
    found = find_plateaus(level, 0.2, 0.5)
    assert [(a, b) for a, b in found if b - a < 20] == [(0, 10)]
    assert find_plateaus(level, 0.1, 0.5) == [(0, 10), (10, 19), (67, 73)]


def test_a_slow_wave_is_no_plateau():
    assert find_plateaus(np.sin(np.linspace(0, 20, 2000)), 0.02, 0.05) == []
