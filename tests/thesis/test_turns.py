"""Figures 43, 45 and 68, drawn of stored signals."""

from pathlib import Path

import numpy as np
import pytest

from rigtool.runfile import open_run
from thesis import turns

FIXTURES = Path(__file__).parents[1] / "fixtures"


@pytest.fixture(scope="module")
def kt():
    with open_run(FIXTURES / "kt.h5") as run:
        yield run


def test_turns_are_those_of_the_recording_and_their_mean(kt):
    with open_run(FIXTURES / "turning.h5") as run:
        left, right = turns.draw_before_learning(run, kt).axes
        assert len(left.lines) == run.recording("learn_000").condition("revolutions")
        drawn = np.array([line.get_ydata() for line in left.lines])
        np.testing.assert_allclose(right.lines[0].get_ydata(), drawn.mean(axis=0), atol=1e-12)
        # What B learns of the same turns holds what repeats in them, besides the friction.
        table = run.table("residual_waveforms")
        speed = run.recording("learn_000").condition("speed")
        learned = 1e3 * table["before"][np.argmin(np.abs(table["speed"] - speed))]
    ripple = learned - learned.mean()
    assert np.ptp(right.lines[0].get_ydata()) == pytest.approx(np.ptp(ripple), rel=0.3)
    assert left.get_xlim()[1] < 2000


def test_constant_speeds_are_drawn_with_their_spread(kt):
    with open_run(FIXTURES / "friction.h5") as run:
        (axes,) = turns.draw_faulty_amplifier(run, kt).axes
        speeds = sorted(np.abs(axes.containers[0].lines[0].get_xdata()))
        torque = axes.containers[0].lines[0].get_ydata()
    np.testing.assert_allclose(speeds, np.repeat([1, 3, 8, 16, 30], 2), rtol=1e-3)
    assert axes.get_ylabel() == "torque [mN m]"
    assert 2 < np.abs(torque).min() < np.abs(torque).max() < 5
