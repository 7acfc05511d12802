"""Ripple that has grown with the current adds its errors to those of what is followed."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from rigtool.experiments.force_sensor.sensor import Sensor
from rigtool.experiments.force_sensor.stretch import Stretch
from tests.experiments.deploy.sensors import CONSTANT, GROWING, LEARNED, WARM, instrument, motions
from tests.experiments.force_sensor.test_rest_between_forms import Certain


def growing(size):
    """Return an instrument whose ripple grows with the current `size` times as much, in quadrature
    with what it is: rows do not grow."""
    coefficient, terms = LEARNED.coefficient.copy(), list(LEARNED.terms)
    coefficient[-len(GROWING) :] *= size
    terms[-len(GROWING) :] = [replace(t, quarter=1 - t.quarter) for t in terms[-len(GROWING) :]]

    class Own(Certain):
        learned = SimpleNamespace(**{**vars(LEARNED), "coefficient": coefficient, "terms": terms})

    return instrument(model=Own())


def smoothed(own, samples):
    """Return the rows that are read of samples, smoothed."""
    with ThreadPoolExecutor(1) as worker:
        reader = Stretch("growing", own, 0.0, samples.shape[1], (worker, worker))
        reader.add(samples)
        (rows,) = reader.reading()
    return rows


def test_smoothed_u_holds_both_errors_as_of_one_phase():
    """Of u^2, 2 r V grows with the size and what is not followed with its square."""
    samples = motions()["strokes"]
    none, once, twice = (smoothed(growing(size), samples) for size in (0.0, 1.0, 2.0))
    np.testing.assert_array_equal(twice.torque, none.torque)
    more, most = once.u**2 - none.u**2, twice.u**2 - none.u**2
    linear = 2 * more - most / 2

    own = growing(1.0)
    sensor = Sensor(own)
    sensed = sensor.add(samples, last=True)
    angle = sensed.estimate.low + own.count / 2
    _, variance, _ = sensor.power_up.again()(angle, np.zeros(len(angle)))
    rows = slice(None, None, round((none.time[1] - none.time[0]) / own.grid.step_time))
    np.testing.assert_allclose(linear, (2 * sensed.grown * variance)[rows], rtol=1e-3, atol=1e-15)
    assert np.median(linear / none.u**2) > 0.02
    ripple = variance * (1 + 2 * sensed.grown) + sensor.power_up.counted * sensed.unfollowed
    np.testing.assert_allclose(once.doubts, ripple[rows], rtol=1e-3)

    size = np.abs(samples[1])
    gain, square = GROWING.values()
    drawn = sum(value**2 for value in LEARNED.coefficient[: -len(GROWING)])
    share = (CONSTANT[0] + CONSTANT[1] * WARM) * size * np.hypot(gain, square * size)
    assert np.median(sensed.grown) == pytest.approx(np.median(share) / np.sqrt(drawn), rel=0.1)
