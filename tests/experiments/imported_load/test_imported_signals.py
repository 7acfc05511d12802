"""Imported signals at even times: gaps, samples that are no numbers, a current that is stuck."""

from types import SimpleNamespace

import numpy as np
import pytest

from rigtool.errors import InsufficientDataError
from rigtool.experiments.imported_load.imported_signals import _read, at_even_times, at_limit
from rigtool.experiments.imported_load.learning import learn_load_model
from tests.experiments.imported_load.loaded_drive import BANDWIDTH_HZ, observations, record


@pytest.fixture(scope="module")
def model():
    return learn_load_model(observations(frequencies=(0.15, 0.2, 0.3))).model


def read(time, **channels):
    """Return the signals of a recording with such channels."""
    named = {"time": time, **channels}
    recording = SimpleNamespace(
        name="imported", path="r.h5", conditions={}, has=named.__contains__, read=named.__getitem__
    )
    return _read(recording, None, BANDWIDTH_HZ)


def recorded(seed=3, seconds=24.0):
    time, position, effort, torque = record(0.05, 0.2, seed=seed, seconds=seconds)
    return {"time": time, "position": position, "current": effort, "reference_torque": torque}


def held(model, signals):
    """Return the share of intervals that hold, and of rows with a value."""
    found = model.read(signals)
    ok = np.abs(found.torque - signals.sensor) <= 1.96 * found.u
    return np.mean(ok[found.inside]), np.mean(found.inside)


@pytest.mark.parametrize(
    "kept",
    [
        lambda time, random: (time < 8) | (time > 10.7),  # a gap over a reversal
        lambda time, random: random.random(len(time)) < 0.6,
        lambda time, random: (time < 12) | (np.arange(len(time)) % 4 == 0),  # another rate
    ],
)
def test_a_recording_that_is_not_even_is_read_as_one_that_is(model, kept):
    whole = recorded()
    rows = kept(whole["time"], np.random.default_rng(4))
    part = read(**{name: values[rows] for name, values in whole.items()})
    coverage, share = held(model, part)
    assert coverage > 0.93
    assert share > 0.6
    even = read(**whole)
    assert held(model, even)[1] > share - 0.02
    assert part.path.time[-1] == pytest.approx(even.path.time[-1], abs=0.1)


def test_behind_a_long_gap_nothing_is_known_until_the_next_reversal(model):
    whole = recorded()
    rows = (whole["time"] < 8) | (whole["time"] > 10.2)  # reversals at 6.25, 8.75, 11.25 s
    found = read(**{name: values[rows] for name, values in whole.items()}).path
    lost = ~found.regular
    assert found.time[lost].min() == pytest.approx(8.0, abs=0.3)
    assert found.time[lost].max() == pytest.approx(11.25, abs=0.2)
    assert np.mean(lost[(found.time > 8) & (found.time < 11.2)]) > 0.98


def test_samples_that_are_no_numbers_are_left_out(model):
    whole = recorded()
    bad = np.random.default_rng(5).random(len(whole["time"])) < 0.05
    whole["current"] = np.where(bad, np.nan, whole["current"])
    coverage, share = held(model, read(**whole))
    assert coverage > 0.93
    assert share > 0.7
    whole["current"] = np.full(len(bad), np.nan)
    with pytest.raises(InsufficientDataError, match="no samples at which all signals are numbers"):
        read(**whole)


def test_one_lost_sample_is_no_gap_and_a_longer_one_is():
    time = np.delete(np.arange(200) * 0.02, [50, 100, 101, 102])
    even, (same,), lost = at_even_times(time, 10.0, 3 * time)
    np.testing.assert_allclose(same, 3 * even, rtol=1e-9)
    np.testing.assert_allclose(even[lost], [1.98, 2.0, 2.02, 2.04], rtol=1e-9)


@pytest.mark.parametrize(("every", "period"), [(1, 5.0), (1, 2 * np.pi), (8, 11.0)])
def test_an_angle_that_begins_again_is_refused(every, period):
    channels = {name: values[::every] for name, values in recorded().items()}
    channels["position"] = channels["position"] % period
    with pytest.raises(InsufficientDataError, match=r"r\.h5: the position jumps .* wraps_at"):
        read(**channels)


def test_a_wrong_sample_and_the_way_of_a_gap_are_no_jumps(model):
    channels = recorded()
    channels["position"][[0, 4000, -1]] += 100.0
    channels = {name: np.delete(values, slice(2750, 3250)) for name, values in channels.items()}
    assert np.abs(np.diff(channels["position"]))[2749] > np.ptp(recorded()["position"]) / 2
    assert held(model, read(**channels))[0] > 0.93


@pytest.mark.parametrize(("unit", "remedy"), [(1e-3, "1 s at either end"), (1e3, "samples a sec")])
def test_a_time_in_another_unit_is_named(unit, remedy):
    channels = recorded()
    channels["time"] = unit * channels["time"]
    with pytest.raises(InsufficientDataError, match=f"{remedy}.*unit of time"):
        read(**channels)


def test_a_time_in_milliseconds_read_as_seconds_is_named():
    time = np.arange(200) * 5.0
    with pytest.raises(InsufficientDataError, match=r"0\.2 samples a second .* unit of time"):
        at_even_times(time, 5.0, np.sin(time))


@pytest.mark.parametrize("value", [0.0, 0.1])
def test_an_effort_that_never_changes_is_refused(value):
    channels = recorded()
    channels["current"] = np.full_like(channels["current"], value)
    with pytest.raises(InsufficientDataError, match=f"effort is {value:g} throughout"):
        read(**channels)


def test_a_current_that_stays_at_a_value_for_long_is_stuck():
    random = np.random.default_rng(6)
    effort = np.round(np.sin(np.arange(4000) / 300) + random.normal(0, 0.02, 4000), 2)
    assert not at_limit(effort).any()
    effort[2000:2500] = effort[2000]
    found = at_limit(effort)
    assert found[2000:2500].all()
    assert found.sum() < 510


@pytest.mark.parametrize("by", [0.3, -2.0])
def test_a_path_with_another_zero_is_that_of_positions_with_it(by):
    channels = recorded()
    moved = read(**channels).path.moved(by)
    expected = read(**channels | {"position": channels["position"] + by}).path
    for name, values in vars(expected).items():
        if isinstance(values, np.ndarray):
            size = np.abs(values).max()
            np.testing.assert_allclose(getattr(moved, name), values, atol=1e-6 * size, err_msg=name)
