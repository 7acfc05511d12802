"""When current is read between two set points, and what is made of it."""

import math

import numpy as np
import pytest

from rigtool.rigs.serial.drive import Sample
from rigtool.rigs.serial.hosted.between import MIN_READINGS, MIN_ROOM, READING_PERIODS, Between
from tests.rigs.serial.hosted.test_hosted_bias import HOLD, emulated, perform


def sample(time, current):
    return Sample(time, 0.0, math.nan, current, math.nan)


def looked(reading):
    between = Between()
    between.reading = reading
    return between


def test_a_reading_is_due_every_few_ticks_and_only_where_it_fits():
    between = looked(2e-3)
    assert [tick for tick in range(16) if between.moment(tick, 0.0, 0.01) is not None] == [
        tick for tick in range(16) if tick % READING_PERIODS == READING_PERIODS - 1
    ]
    fits = MIN_ROOM * between.reading
    assert between.moment(READING_PERIODS - 1, 0.0, 0.999 * fits) is None
    assert between.moment(READING_PERIODS - 1, 0.0, 1.001 * fits) is not None


@pytest.mark.parametrize("count", [10, 37, 200])
def test_readings_fill_what_is_left_of_the_period_evenly(count):
    between = looked(2e-3)
    moments = np.array([between.moment(READING_PERIODS - 1, 5.0, 5.01) for _ in range(count)])
    assert moments.min() >= 5.0
    assert moments.max() + between.reading <= 5.01
    gaps = np.diff(np.concatenate([[5.0], np.sort(moments), [5.008]]))
    # three lengths at most, the longest 2.618 times the shortest (the three-gap theorem)
    assert gaps.max() < 2.7 * 0.008 / count


def test_the_difference_is_from_the_line_between_two_samples_along_the_motion():
    between = looked(1e-3)
    for n in range(MIN_READINGS):
        for speed in (12.0, -12.0):
            way = math.copysign(1.0, speed)
            ends = sample(0.0, way * 0.1), sample(0.01, way * 0.3)
            error = 1e-3 if n % 2 else -1e-3
            between.compare(speed, ends[0], sample(0.0025, way * (0.15 + 0.02 + error)), ends[1])
    (found,) = between.found()
    assert found["speed"] == 12.0
    assert found["lacking_current"] == pytest.approx(0.02, rel=1e-9)
    count = 2 * MIN_READINGS
    assert found["u"] == pytest.approx(1e-3 / math.sqrt(count - 1), rel=1e-9)
    assert found["readings"] == count


def test_few_readings_tell_nothing():
    between = looked(1e-3)
    for _ in range(MIN_READINGS - 1):
        between.compare(12.0, sample(0.0, 0.1), sample(0.005, 0.2), sample(0.01, 0.1))
    assert list(between.found()) == []


@pytest.mark.parametrize("delay", [3e-4, 3e-3])
def test_the_set_point_of_a_sample_is_that_of_its_time(world, delay):
    """However long the answer takes."""
    _, rig = emulated(world, "moteus", 0.02, delay=delay)
    with rig:
        got = perform(rig, HOLD)
    # The first question is sent as the motion begins, and answered at a delay each way.
    since = got["time"] - got["time"][0] + delay
    wanted, _, _ = HOLD.motion.setpoint(since)
    np.testing.assert_allclose(got["position_setpoint"], wanted, rtol=0, atol=12.0 * 2e-4)
