"""The exploring motion keeps to its range and speed, and ends at rest."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rigtool.experiments.force_model.procedure_exploration import exploration

COUNT = 2 * np.pi / 4000


@settings(max_examples=25, deadline=None)
@given(st.floats(0.5, 5.0), st.floats(1.0, 40.0), st.floats(1.0, 20.0))
def test_it_keeps_to_range_and_speed(span, fastest, time):
    motion = exploration(0.2, 0.2 + span, COUNT, fastest, time)
    position, speed, _ = motion.setpoint(np.arange(0, motion.duration, 2e-3))
    assert position.min() > -1e-9
    assert position.max() < span + 1e-9
    assert np.abs(speed).max() <= fastest * (1 + 1e-9)
    assert motion.speeds[0] == motion.speeds[-1] == 0.0
    assert np.all(np.diff(motion.times) > 0)


def test_it_repeats_itself_exactly():
    assert exploration(0, 2.0, COUNT, 10.0, 5.0) == exploration(0, 2.0, COUNT, 10.0, 5.0)


def test_a_finer_encoder_shows_shorter_triangles_besides_the_same():
    coarse, fine = (exploration(0.0, 2.6, COUNT / by, 10.0, 0.0) for by in (1, 16))
    seen = np.arange(1.5 - coarse.duration, 0.0, 1e-3)
    longest = [np.ptp(one.setpoint(seen + one.duration)[0]) for one in (coarse, fine)]
    assert longest[0] / longest[1] == pytest.approx(16 / 8)  # as a 70th of 2.6 rad allows
    assert len(fine.times) - len(coarse.times) == 3 * 6 * 3  # triangles, strokes, points
