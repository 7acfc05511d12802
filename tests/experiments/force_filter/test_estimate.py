"""The filter finds a torque that the plant's own equations have felt, and says how well."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import butter, sosfilt, sosfiltfilt

from rigtool.experiments.force_filter import estimate
from rigtool.experiments.force_filter.estimate import Filter, Signals
from rigtool.experiments.force_filter.plant import (
    ANGLE,
    BRISTLE,
    GRASPER,
    HOUSING,
    NOISE,
    SPEED,
    STATES,
    TIP,
    TORQUE,
    advance,
    as_record,
)
from rigtool.experiments.force_filter.smoothed import Again, smoothed
from tests.experiments.force_filter.plants import PLANT, UNCERTAINTY

WIDTH = 2 * np.pi / 4000
STEP = 8
BAND = 10.0
SMOOTHED = "rigtool.experiments.force_filter.smoothed"
SECTIONS = butter(2, BAND, fs=1 / (STEP * PLANT.sample_time), output="sos")


def pulses(time):
    """Return a torque that comes and goes, N m."""
    return 0.03 * np.clip(np.minimum((time % 3.1 - 1) / 0.05, (2.2 - time % 3.1) / 0.05), 0, 1)


def simulated(seconds, seed=1, acting=pulses):
    """Move the plant by a controller to and fro with rests, while a torque acts."""
    rng = np.random.default_rng(seed)
    count, dt = round(seconds / PLANT.sample_time), PLANT.sample_time
    time = np.arange(count) * dt
    torque = acting(time)
    pace = np.where(time % 4 < 3, 1.0, 0.0)
    wanted = 0.8 * np.sin(2.0 * np.cumsum(pace) * dt)
    x, record = np.zeros(STATES), as_record(PLANT)[0]
    low, drive = np.empty(count), np.empty(count)
    kept, integral = np.exp(-dt / UNCERTAINTY.friction_noise_time), 0.0
    for k in range(count):
        low[k] = np.floor(x[ANGLE] / WIDTH) * WIDTH
        error = wanted[k] - x[ANGLE]
        integral += error * dt
        drive[k] = 2.0 * error + 30.0 * integral - 8e-3 * x[SPEED]
        x[TORQUE] = torque[k]
        x[NOISE] = kept * x[NOISE] + 0.1e-3 * np.sqrt(1 - kept**2) * rng.standard_normal()
        advance(x, record, PLANT.friction_map, drive[k], 5e-5, None, 0, 0.0, 0.0)
    signals = Signals(drive, np.full(count, 5e-5), low, WIDTH)
    return signals, torque[STEP - 1 :: STEP][: (count - 1) // STEP], wanted


@pytest.fixture(scope="module")
def recording():
    return simulated(16.0)


def test_a_current_that_passes_zero_is_no_motor_without_current():
    time = STEP * PLANT.sample_time
    needed, rng = round(estimate.IDLE_TIME / time), np.random.default_rng(5)
    lasting = np.array([needed // 2, 1, needed - 1, 1, needed + 3, 2, 4 * needed, 1]) * STEP
    later = [(needed + 3) * STEP, STEP + 1] * STEP  # without and with, from each sample of a step
    lasting = np.concatenate([lasting, later])
    idle = np.repeat(np.resize([True, False], len(lasting)), lasting)
    nothing, rest = np.zeros(len(idle)), np.full(len(idle), WIDTH)
    found, run, filtered, at = [], needed, [], 0
    for none in (idle[k] and idle[k - 1] for k in range(STEP, len(idle), STEP)):
        run = run + 1 if none else 0  # as if there had been none before the first sample
        found.append(run >= needed)
    parts = Filter(PLANT, UNCERTAINTY, STEP, BAND)
    while at < len(idle):
        part = slice(at, at := at + int(rng.integers(1, 3 * STEP * needed)))
        signals = Signals(nothing[part], nothing[part], rest[part], WIDTH, idle[part])
        filtered.append(parts.add(signals).idle)
    assert np.array_equal(np.concatenate(filtered), found)
    assert 0 < np.sum(found) < len(found)


def test_blocks_of_any_length_give_the_same(recording):
    signals, _, _ = recording
    whole = Filter(PLANT, UNCERTAINTY, STEP, BAND).add(signals)
    parts, by_blocks = Filter(PLANT, UNCERTAINTY, STEP, BAND), []
    edges = [0, 1, 5, 8, 9, 1000, 1003, 40000, len(signals.low)]
    for first, last in itertools.pairwise(edges):
        span = slice(first, last)
        piece = Signals(signals.drive_torque[span], signals.viscous[span], signals.low[span], WIDTH)
        by_blocks.append(parts.add(piece))
    states = np.concatenate([found.states for found in by_blocks])
    deviation = np.concatenate([found.deviation for found in by_blocks])
    np.testing.assert_array_equal(states, whole.states)
    np.testing.assert_array_equal(deviation, whole.deviation)
    assert len(whole.torque) == (len(signals.low) - 1) // STEP


@pytest.mark.compiles
def test_torque_is_found_and_its_uncertainty_holds(recording):
    signals, truth, _ = recording
    causal = Filter(PLANT, UNCERTAINTY, STEP, BAND).add(signals)
    later = smoothed(PLANT, UNCERTAINTY, STEP, BAND, signals)
    used = slice(1000, -1000)  # after the start, whose history is unknown
    behind = {
        "causal": (causal.passed, sosfilt(SECTIONS, truth), causal.deviation),
        "smoothed": (sosfiltfilt(SECTIONS, later[0]), sosfiltfilt(SECTIONS, truth), later[1]),
    }
    for name, (torque, acting, deviation) in behind.items():
        error = (torque - acting)[used]
        # of 30 mN m that come and go; friction is 14 mN m at the output
        assert np.sqrt(np.mean(error**2)) < 1.2e-3, name
        assert np.mean(np.abs(error) < 1.96 * deviation[used]) > 0.9, name
        assert np.sqrt(np.mean(deviation[used] ** 2)) < 2.0e-3, name
    bristles = causal.states[:, [BRISTLE, HOUSING, TIP]]
    assert np.abs(bristles).max() <= 1.0
    angle = causal.states[used, ANGLE]
    inside = signals.low[STEP::STEP][: len(truth)][used]
    assert np.mean((angle > inside - 0.2 * WIDTH) & (angle < inside + 1.2 * WIDTH)) > 0.999


OF_TORQUE = (
    *("inertia", "coulomb", "static", "stiffness", "damping", "grasper_inertia"),
    *("housing_friction", "housing_viscous", "tip_friction", "load_friction_onset"),
)
"""Parameters of the plant in proportion to the unit of torque."""


def test_the_unit_of_torque_changes_nothing(recording):
    """Causal and smoothed."""
    unit, whole = 64.0, recording[0]
    count = round(4.5 / PLANT.sample_time)  # a rest, and contacts before and after it
    signals = Signals(whole.drive_torque[:count], whole.viscous[:count], whole.low[:count], WIDTH)
    plant = replace(PLANT, **{name: unit * getattr(PLANT, name) for name in OF_TORQUE})
    names = ("stroke", "friction_noise", "torque_start")
    names += ("torque_rate", "slow_torque_rate", "step_torque_rate")
    doubt = replace(UNCERTAINTY, **{name: unit * getattr(UNCERTAINTY, name) for name in names})
    scaled = replace(
        signals, drive_torque=unit * signals.drive_torque, viscous=unit * signals.viscous
    )
    one = Filter(PLANT, UNCERTAINTY, STEP, BAND).add(signals)
    other = Filter(plant, doubt, STEP, BAND).add(scaled)
    for name in ("torque", "passed", "deviation"):
        np.testing.assert_allclose(
            getattr(other, name) / unit, getattr(one, name), rtol=1e-6, atol=1e-9
        )
    later = smoothed(PLANT, UNCERTAINTY, STEP, BAND, signals)
    again = smoothed(plant, doubt, STEP, BAND, scaled)
    for first, second in zip(later, again, strict=True):
        np.testing.assert_allclose(second / unit, first, rtol=1e-6, atol=1e-9)


def test_the_amplitude_of_a_sine_at_the_bandwidth_is_right():
    signals, truth, _ = simulated(8.0, acting=lambda t: 0.02 + 0.01 * np.sin(2 * np.pi * BAND * t))
    causal = Filter(PLANT, UNCERTAINTY, STEP, BAND).add(signals)
    torque, _ = smoothed(PLANT, UNCERTAINTY, STEP, BAND, signals)
    step_time = STEP * PLANT.sample_time
    sections = butter(2, BAND, fs=1 / step_time, output="sos")
    # whole periods of motion: within a count at rest, a swing of 10 mN m shows in part
    used = np.r_[1000:3000, 5000:7000]
    wave = np.exp(-2j * np.pi * BAND * step_time * np.arange(len(truth)))[used]
    for found, true in ((causal.passed, sosfilt(sections, truth)), (torque, truth)):
        gain = np.mean(found[used] * wave) / np.mean(true[used] * wave)
        assert abs(gain) == pytest.approx(1.0, abs=0.05)
        assert abs(np.angle(gain, deg=True)) < 5.0


def test_a_force_that_swings_is_followed_where_single_changes_do_not_show():
    """With the noise of a single change, the error is 1.9 mN m, and 85 % are within."""
    signals, truth, _ = simulated(12.0, acting=lambda t: 0.01 * np.sin(2 * np.pi * t))
    found = Filter(PLANT, UNCERTAINTY, STEP, BAND).add(signals)
    error = np.abs(found.passed - sosfilt(SECTIONS, truth))[2000:]
    assert np.sqrt(np.mean(error**2)) < 1.7e-3
    assert np.mean(error < 1.96 * found.deviation[2000:]) > 0.87


def test_smoothing_is_better_and_does_not_depend_on_its_pieces(recording, monkeypatch):
    signals, truth, _ = recording
    torque, deviation = smoothed(PLANT, UNCERTAINTY, STEP, BAND, signals)
    causal = Filter(PLANT, UNCERTAINTY, STEP, BAND).add(signals)
    used = slice(1000, -1000)  # where something came before, and something later
    later, at_once = ((found - truth)[used] for found in (torque, causal.torque))
    assert np.mean(later**2) < 0.4 * np.mean(at_once**2)
    assert np.mean(deviation) < np.mean(causal.deviation)
    monkeypatch.setattr(f"{SMOOTHED}.PIECE_STEPS", 777)
    again, same = smoothed(PLANT, UNCERTAINTY, STEP, BAND, signals)
    np.testing.assert_allclose(again, torque, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(same, deviation, rtol=1e-9)


def test_a_load_that_comes_at_rest_is_not_spread_over_the_rest_before_it(recording, monkeypatch):
    signals, truth, _ = recording
    time = np.arange(len(truth)) * STEP * PLANT.sample_time
    before = (time > 6.8) & (time < 7.2)  # at rest; the load comes at 7.2 s, and 30 ms later shows
    torque, _ = smoothed(PLANT, UNCERTAINTY, STEP, BAND, signals)
    monkeypatch.setattr(f"{SMOOTHED}.ONSET_TIME", 0.0)
    spread, _ = smoothed(PLANT, UNCERTAINTY, STEP, BAND, signals)
    error, without = (np.sqrt(np.mean((t - truth)[before] ** 2)) for t in (torque, spread))
    assert error < 0.7 * without


@pytest.mark.parametrize("ends", [7.8, 7.95])
def test_a_load_that_ends_with_a_rest_is_not_spread_over_the_rest(ends):
    """The rotor stays within a count for 0.4 s, until the load of 12 mN m ends."""
    signals, truth, _ = simulated(9.0, acting=lambda t: 0.012 * np.clip((ends - t) / 0.05, 0, 1))
    torque, deviation = smoothed(PLANT, UNCERTAINTY, STEP, BAND, signals)
    time = np.arange(len(truth)) * STEP * PLANT.sample_time
    rest = (time > 7.1) & (time < ends - 0.1)
    error = np.abs(torque - truth)[rest]
    assert np.sqrt(np.mean(error**2)) < 1.5e-3
    assert np.all(error < 1.96 * deviation[rest])


def test_a_count_shows_what_it_shows_once():
    """An edge is passed, and nothing changes afterwards: nothing more is known of the torque."""
    low = np.where(np.arange(400 * STEP) < 100 * STEP, 0.0, WIDTH)
    nothing, viscous = np.zeros(len(low)), np.full(len(low), 5e-5)
    found = Filter(PLANT, UNCERTAINTY, STEP, BAND).add(Signals(nothing, viscous, low, WIDTH))
    assert found.deviation[300] > 0.8 * found.deviation[105]


def test_what_comes_long_afterwards_does_not_matter(recording, monkeypatch):
    signals, _, _ = recording
    torque, deviation = smoothed(PLANT, UNCERTAINTY, STEP, BAND, signals)
    monkeypatch.setattr(f"{SMOOTHED}.PIECE_STEPS", 500)
    monkeypatch.setattr(f"{SMOOTHED}.BLOCK", 2.0)
    monkeypatch.setattr(f"{SMOOTHED}.AHEAD", 7.0)  # more than a cycle of this motion
    again, same = smoothed(PLANT, UNCERTAINTY, STEP, BAND, signals)
    assert np.abs((again - torque) / deviation).max() < 1e-2
    np.testing.assert_allclose(same, deviation, rtol=1e-3)


def test_without_motion_the_friction_of_an_unknown_history_stays_in_the_uncertainty():
    count = 8001
    low = np.zeros(count)
    still = Signals(np.full(count, 5e-3), np.full(count, 5e-5), low, WIDTH)
    found = Filter(PLANT, UNCERTAINTY, STEP, BAND).add(still)
    # friction of bearings and housing may be anywhere between plus and minus 12 mN m at the motor
    assert found.deviation[-1] > 4e-3
    assert abs(found.torque[-1]) < 20e-3
    assert np.isfinite(found.states).all()
    assert abs(found.states[-1, GRASPER]) < 0.2


def test_what_is_subtracted_is_as_a_drive_that_has_less(recording):
    """In both filters, whatever the blocks are."""
    signals = recording[0].part(0, 2000 * STEP + 1)
    less = 2e-3 * np.sin(np.arange(2000) / 50)
    drive = signals.drive_torque.copy()
    drive[:-1] -= np.repeat(less, STEP)
    found = []
    for own, subtracted in ((signals, less), (replace(signals, drive_torque=drive), None)):
        causal = Filter(PLANT, UNCERTAINTY, STEP, BAND)
        again = Again(PLANT, UNCERTAINTY, STEP, BAND)
        for first, last in ((0, 700), (700, 2000)):
            part = own.part(STEP * first + (first > 0), STEP * last + 1)
            taken = None if subtracted is None else subtracted[first:last]
            passed = causal.add(part, less=taken)
            assert passed.idle.dtype == bool
            assert not passed.idle.any()
            later = again.add(part, passed, less=taken, last=last == 2000)
            found.append((passed.outputs, later.outputs))
    for one, other in zip(found[:2], found[2:], strict=True):
        for mine, expected in zip(one, other, strict=True):
            assert len(mine) > 500
            np.testing.assert_allclose(mine, expected, rtol=1e-9, atol=1e-12)


def test_less_than_a_step_gives_nothing():
    few = Signals(np.zeros(STEP), np.zeros(STEP), np.zeros(STEP), WIDTH)
    assert len(Filter(PLANT, UNCERTAINTY, STEP, BAND).add(few).torque) == 0
    with pytest.raises(ValueError, match="8 samples are less than a step of 8"):
        smoothed(PLANT, UNCERTAINTY, STEP, BAND, few)


def test_what_acted_before_the_first_sample_is_not_known():
    """Behind the low-pass, too: it held an unknown torque, not zero."""
    count = 20 * STEP
    rest = Signals(np.zeros(count), np.full(count, 5e-5), np.zeros(count), WIDTH)
    found = Filter(PLANT, UNCERTAINTY, STEP, 30.0).add(rest)
    assert found.deviation[0] == pytest.approx(UNCERTAINTY.torque_start, rel=0.7)
    assert found.deviation[0] >= 0.99 * found.deviation[-1]


def test_a_long_rest_says_nothing_of_the_stroke_before_it():
    """Errors of the equations, alike in each swing about an edge, pass for a stroke's deviation."""
    moved, *_ = simulated(1.5)
    rate = 1 / PLANT.sample_time
    time = np.arange(round(5 * rate)) / rate
    swing = np.sin(2 * np.pi * 150 * time)
    errors = 1.5e-3 * swing + 0.6e-3 * np.abs(swing) * np.sign(moved.drive_torque[-1])
    drive = np.concatenate([moved.drive_torque, 0.3 * moved.drive_torque[-1] + errors])
    low = np.concatenate([moved.low, moved.low[-1] + WIDTH * (np.sin(2 * np.pi * 150 * time) > 0)])
    before = slice(900, 1400)
    found = []
    for seconds in (3.0, 6.5):
        part = slice(0, round(seconds * rate))
        signals = Signals(drive[part], np.full(low[part].size, 5e-5), low[part], WIDTH)
        torque, _ = smoothed(PLANT, UNCERTAINTY, STEP, BAND, signals)
        found.append(torque[before])
    assert np.abs(found[1] - found[0]).max() < 0.1e-3
