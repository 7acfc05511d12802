"""The steady part of a recording, found by looking at few of its samples."""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rigtool.errors import InsufficientDataError
from rigtool.experiments.ripple.procedure_steady import (
    collected,
    steady_samples,
    temperature_at_turns,
)
from rigtool.runfile import open_run
from rigtool.runfile.schema import CHUNK

FIXTURES = Path(__file__).parents[2] / "fixtures"


class Stored:
    """A recording of nothing but time, which counts the chunks that are unpacked."""

    name = "speed_000"

    def __init__(self, time, steady_from, steady_until):
        self._time, self.size, self.unpacked = time, len(time), 0
        self._conditions = {"steady_from": steady_from, "steady_until": steady_until}

    def condition(self, name):
        return self._conditions[name]

    def read(self, channel, start, stop):
        assert channel == "time"
        stop = min(stop, self.size)
        self.unpacked += (stop - 1) // CHUNK - start // CHUNK + 1
        return self._time[start:stop]


@given(
    size=st.one_of(
        st.integers(5, 50),
        st.integers(1, 4).flatmap(lambda n: st.integers(n * CHUNK - 2, n * CHUNK + 2)),
    ),
    begin=st.sampled_from([0.0, 0.1, -3.7, 1e6]),
    places=st.tuples(st.floats(-0.1, 1.1), st.floats(-0.1, 1.1)),
    on_samples=st.booleans(),
)
def test_it_is_what_a_search_through_all_samples_finds(size, begin, places, on_samples):
    time = begin + 1.25e-4 * np.arange(size)
    since = time - time[0]
    low, high = (place * since[-1] for place in sorted(places))
    if on_samples:
        low, high = (float(since[min(np.searchsorted(since, t), size - 1)]) for t in (low, high))
    first, last = (int(np.sum(since < seconds)) for seconds in (low, high))
    stored = Stored(time, low, high)
    if last - first < 4:
        with pytest.raises(InsufficientDataError, match="too few"):
            steady_samples(stored)
    else:
        assert steady_samples(stored) == range(first, last)


def test_an_hour_takes_two_looks_at_each_halving_of_its_chunks():
    size = 3516 * CHUNK
    stored = Stored(np.arange(size) / 8000, 0.5, size / 8000 - 1)
    assert len(steady_samples(stored)) == size - 4000 - 8000
    assert stored.unpacked <= 1 + 2 * (math.ceil(math.log2(3516)) + 1)


def test_the_temperature_follows_a_housing_that_warms_exponentially():
    """Late at first, as its winding does; NaN, and noise, are in between."""

    def housing(seconds):
        return 25 + 10 * (1 - (360 * np.exp(-seconds / 360) - 22 * np.exp(-seconds / 22)) / 338)

    time, firsts = np.arange(0.0, 760.0, 0.05), 60 + 100 * np.arange(151)
    degc = housing(time) + 0.3 * np.sin(40 * time)
    degc[::7] = np.nan

    class Warming:
        def has(self, name):
            return name == "temperature"

        def blocks(self, *names, start, stop, finite):
            assert (names, finite) == (("temperature",), False)
            for part in np.array_split(degc[start:stop], 4):
                yield (part,)

    true = housing(time[firsts])
    assert np.abs(temperature_at_turns(Warming(), firsts) - true).max() < 0.03
    two = temperature_at_turns(Warming(), firsts[:3])
    assert np.abs(two - true[:3]).max() < 0.1


def test_a_turn_has_the_temperature_of_its_own_samples():
    """Turns over several blocks, several in one, one of no sample, one of NaN alone."""
    firsts = np.array([5, 9, 9, 31, 33, 34])
    degc = np.repeat([90.0, 20.0, 24.0, 22.0, np.nan, 90.0], [5, 4, 22, 2, 1, 6])

    class Steps:
        def has(self, name):
            return True

        def blocks(self, *names, start, stop, finite):
            for begin in range(start, stop, 6):
                yield (degc[begin : min(begin + 6, stop)],)

    # Three means that are known, a parabola through them, at the middle of each turn.
    through = np.polyfit([0.5, 2.5, 3.5], [20.0, 24.0, 22.0], 2)
    expected = np.polyval(through, np.arange(6.0))
    assert temperature_at_turns(Steps(), firsts) == pytest.approx(expected)


def test_the_samples_of_turns_are_those_of_the_recording():
    with open_run(FIXTURES / "ripple.h5") as run:
        recording = run.recordings_named("speed_")[0]
        found = collected(recording, steady_samples(recording), run.recipe, None)
        begins = np.searchsorted(recording.read("time"), found.passed)
    assert len(begins) > 5
    # the last bit decides where a turn begins at a sample
    assert np.abs(found.firsts - begins).max() <= 1
    assert np.mean(found.firsts == begins) > 0.5


def test_no_thermometer_shows_no_temperature():
    class Without:
        def has(self, name):
            return False

    assert np.isnan(temperature_at_turns(Without(), np.arange(4))).all()
