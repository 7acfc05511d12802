"""Excitation: only the lines asked for, as large as asked for, with a low peak."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rigtool.experiments.plant.multisine import periodic, quasi_log_lines, random_phases


@settings(max_examples=50, deadline=None)
@given(low=st.integers(1, 20), more=st.integers(1, 400), count=st.integers(2, 60))
def test_lines_are_whole_rise_and_reach_both_ends(low, more, count):
    lines = quasi_log_lines(low, low + more, count)
    assert (lines[0], lines[-1]) == (low, low + more)
    assert (np.diff(lines) > 0).all()
    assert len(lines) <= count


@pytest.mark.parametrize(("low", "high"), [(0, 10), (5, 5), (6, 5)])
def test_lines_that_do_not_rise_are_refused(low, high):
    with pytest.raises(ValueError, match="must rise from 1"):
        quasi_log_lines(low, high, 10)


def test_a_period_holds_its_lines_and_nothing_else():
    """Against the sum of cosines, written out."""
    lines, amplitude = np.array([1, 4, 9]), np.array([1.0, 2j, 0.5 - 0.5j])
    time = np.arange(64) / 64
    expected = sum(
        abs(a) * np.cos(2 * np.pi * k * time + np.angle(a))
        for k, a in zip(lines, amplitude, strict=True)
    )
    np.testing.assert_allclose(periodic(lines, amplitude, 64), expected, rtol=0, atol=1e-13)


def test_a_line_at_half_the_rate_is_refused():
    with pytest.raises(ValueError, match="line 32 of a period of 64"):
        periodic(np.array([1, 32]), np.ones(2, dtype=complex), 64)


def test_phases_are_chosen_for_a_low_peak():
    lines = quasi_log_lines(1, 200, 40)
    peak = np.abs(periodic(lines, random_phases(lines, 2000, np.random.default_rng(1)), 2000)).max()
    rng = np.random.default_rng(2)
    others = [
        np.abs(periodic(lines, np.exp(2j * np.pi * rng.random(len(lines))), 2000)).max()
        for _ in range(100)
    ]
    assert peak < np.quantile(others, 0.05)
    again = random_phases(lines, 2000, np.random.default_rng(1))
    assert np.abs(periodic(lines, again, 2000)).max() == peak
