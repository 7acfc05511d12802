"""Signals that contradict each other are found, those of a rig at rest or in motion are not."""

import numpy as np
import pytest

from rigtool.experiments.force_sensor.signal_faults import SETTLING_TIME, SignalWatch
from tests.experiments.deploy.sensors import COUNTS, instrument

INTERVAL = 125e-6
TIME = np.arange(0, 8, INTERVAL)
NOISE = 0.01 * np.random.default_rng(7).standard_normal(len(TIME))


def faults(encoder, current, pieces=(1, 30000, 30001), **options):
    samples = np.array([encoder, current, np.full(len(TIME), 27.0)])
    watch = SignalWatch(instrument(), **options)
    for piece in np.split(samples, pieces, axis=1):
        watch.add(piece)
    return watch.faults()


def strokes():
    """To and fro by 600 counts at 300 counts/s, with the current of friction."""
    encoder = np.floor(600 * np.abs((TIME / 2) % 2 - 1))
    return encoder, 0.3 * np.sign((TIME / 2) % 2 - 1) + NOISE


def between(first, last):
    return (first <= TIME) & (last > TIME)


def test_motion_and_rest_under_a_load_that_changes_have_no_fault():
    assert faults(*strokes()) == ()
    held = 0.5 + 0.45 * np.sin(TIME) + NOISE  # a hold under a load that comes and goes
    assert faults(np.full(len(TIME), 12.0), held) == ()


def test_a_hand_that_moves_a_motor_without_current_is_no_fault():
    assert faults(strokes()[0], np.zeros(len(TIME))) == ()


@pytest.mark.parametrize("commanded", [True, False])
@pytest.mark.parametrize("signs", [(-1, 1), (1, -1)])
def test_current_and_encoder_of_opposite_signs_are_a_fault(signs, commanded):
    encoder, current = strokes()
    helped = current - 0.6 * between(0, 2) * np.sign(current)  # by a load, in one stroke
    assert faults(encoder, 3 * helped, commanded=commanded) == ()
    (fault,) = faults(signs[0] * encoder, signs[1] * 3 * current, commanded=commanded)
    assert "opposite signs" in fault.text
    assert fault.no_value == commanded
    assert fault.within(TIME[:-200], causal=True).all() == commanded


def test_a_load_that_drives_the_rotor_against_a_current_at_its_limit_is_no_fault():
    """More than was learned, it turns the rotor back for half a turn; the signs are right."""
    encoder, current = strokes()
    drives = between(2, 5)
    encoder = np.floor(encoder - 4000 * np.clip(TIME - 2, 0, 3))
    limit = instrument().current_limit
    assert faults(encoder, np.where(drives, limit, current), commanded=True) == ()
    (fault,) = faults(encoder, np.where(drives, 0.98 * limit, current) + NOISE, commanded=True)
    assert "opposite signs" in fault.text


def test_a_dead_encoder_under_a_current_that_grows_has_no_value():
    encoder, current = strokes()
    encoder[between(3, 6)] = encoder[np.argmax(TIME >= 3)]
    current[between(3, 6)] += 3.0 * (TIME[between(3, 6)] - 3)
    fault, leap = sorted(faults(encoder, current), key=lambda one: "leaps" in one.text)
    assert "leaps" in leap.text  # where it counts again
    assert fault.start == pytest.approx(3, abs=0.03)
    assert fault.end == pytest.approx(6, abs=0.03)
    assert "does not count" in fault.text
    assert fault.no_value
    time = np.array([2.9, 3.1, 6.0 + SETTLING_TIME - 0.1, 6.1 + SETTLING_TIME])
    np.testing.assert_array_equal(fault.within(time, causal=True), [False, True, True, False])
    np.testing.assert_array_equal(fault.within(time, causal=False), [True, True, True, False])


def test_counts_that_are_lost_at_once_are_a_leap():
    encoder, current = strokes()
    encoder[TIME >= 4.5] += 70
    encoder[TIME >= 5.5] -= 90
    (fault,) = faults(encoder, current)
    assert "2 times" in fault.text
    assert "-90 counts" in fault.text
    assert (fault.start, fault.end) == pytest.approx((4.5, 5.5), abs=1e-3)


@pytest.mark.parametrize("pieces", [(), (1, 30000, 30001, 36000, 36001), range(35990, 36010)])
def test_what_leaps_while_the_rotor_moves_is_put_back(pieces):
    """Whatever the pieces are that samples come in: lost counts, and a glitch of a few samples."""
    truth, current = strokes()
    encoder = truth + 70 * (TIME >= 4.5)
    encoder[between(5.5, 5.501)] -= 3000
    encoder[TIME >= 6.5] -= 90
    watch = SignalWatch(instrument())
    samples = np.array([encoder, current, np.full(len(TIME), 27.0)])
    found = np.hstack([watch.add(part) for part in np.split(samples, pieces, axis=1)])
    np.testing.assert_array_equal(found[1:], samples[1:])
    np.testing.assert_allclose(found[0], truth, atol=4)  # one each: a count may pass meanwhile
    np.testing.assert_array_equal(samples[0], encoder)
    (fault,) = watch.faults()
    assert "4 times" in fault.text
    assert "are put back" in fault.text
    behind = SignalWatch(instrument(), before=watch)  # of a gap
    np.testing.assert_allclose(behind.add(samples[:, -9:])[0], truth[-9:], atol=4)


def test_between_leaps_that_are_put_back_there_are_values():
    encoder, current = strokes()
    first, second = faults(encoder + 70 * (TIME >= 2.5) - 90 * (TIME >= 6.5), current)
    assert "2 times from 2.500 to 6.500 s" in first.text
    assert not second.text
    assert (first.start, first.end) == pytest.approx((2.5, 2.5), abs=1e-3)
    assert (second.start, second.end) == pytest.approx((6.5, 6.5), abs=1e-3)
    # none where what settles behind the first one meets what is before the second
    (both,) = faults(encoder + 70 * (TIME >= 2.5) - 90 * (TIME >= 4.3), current)
    assert (both.start, both.end) == pytest.approx((2.5, 4.3), abs=1e-3)


@pytest.mark.parametrize("wraps", [2**16, COUNTS])
@pytest.mark.parametrize("still", [True, False])
def test_a_counter_that_wraps_is_put_back_and_keeps_its_values(wraps, still):
    truth, current = strokes()
    raw = np.where(truth >= truth[np.argmax(TIME >= 3.5)], truth - wraps, truth)
    if still:
        truth = np.full(len(TIME), 12.0)
        raw = truth - wraps * between(4, 5)
    watch = SignalWatch(instrument())
    found = watch.add(np.array([raw, current, np.full(len(TIME), 27.0)]))
    np.testing.assert_array_equal(found[0], truth + (raw - truth)[0])
    wrapped, *_ = (one for one in watch.faults() if "wraps" in one.text)
    assert not wrapped.no_value
    assert f"wraps at {wraps} counts" in wrapped.text


def test_what_leaps_at_rest_and_back_is_taken_as_it_is():
    encoder, current = np.full(len(TIME), 12.0), 0.2 + NOISE
    encoder[4000:4003] += 700
    watch = SignalWatch(instrument())
    found = watch.add(np.array([encoder, current, np.full(len(TIME), 27.0)]))
    np.testing.assert_array_equal(found[0], encoder)
    (leap,) = (one for one in watch.faults() if "leaps" in one.text)
    assert "for 2 of them came after a rest" in leap.text


def test_what_rests_before_a_leap_was_not_counted():
    encoder, current = strokes()
    encoder[between(3.5, 6)] = encoder[np.argmax(TIME >= 3.5)]
    (fault,) = faults(encoder, current)
    assert (fault.start, fault.end) == pytest.approx((3.5, 6), abs=0.01)


@pytest.mark.parametrize("commanded", [True, False])
def test_a_current_that_stops_while_the_rotor_moves_is_remarked(commanded):
    encoder, current = strokes()
    current[between(2, 5)] = current[np.argmax(TIME >= 2)]
    (fault,) = faults(encoder, current, commanded=commanded)
    assert "while the rotor moves by" in fault.text
    assert fault.no_value == commanded


@pytest.mark.parametrize("commanded", [True, False])
def test_a_current_that_is_cut_off_has_no_value_there(commanded):
    encoder, current = strokes()
    current += 0.2 * np.sin(3 * TIME)
    assert faults(encoder, current, commanded=commanded) == ()
    first, *others = faults(encoder, np.clip(current, -0.4, 0.35), commanded=commanded)
    assert "-0.4 and 0.35 A" in first.text
    assert not any(fault.text for fault in others)
    ends = [time for fault in (first, *others) for time in (fault.start, fault.end)]
    edges = np.clip(current, -0.4, 0.35) != current
    found = np.concatenate([between(*pair) for pair in zip(ends[::2], ends[1::2], strict=True)])
    assert found.reshape(len(ends) // 2, -1).any(axis=0)[edges].mean() > 0.6
    assert first.no_value == commanded


def test_a_current_that_is_cut_off_at_last_has_no_value_until_the_end():
    encoder, current = strokes()
    current += 0.2 * np.cos(3 * (8 - TIME))
    *_, last = faults(encoder, np.minimum(current, 0.35), commanded=True)
    assert last.end == pytest.approx(8, abs=0.03)


def test_a_current_of_few_steps_is_not_cut_off():
    encoder, current = strokes()
    assert faults(encoder, 0.1 * np.round(current / 0.1), commanded=True) == ()


def test_channels_that_all_stop_are_no_rest_like_the_others():
    encoder, current = np.floor(300 * np.minimum(TIME, 1.0)), 0.2 + NOISE
    assert faults(encoder, current) == ()
    current[between(5, 7)] = current[np.argmax(TIME >= 5)]
    (fault,) = faults(encoder, current)
    assert "like the encoder's count" in fault.text
    assert (fault.start, fault.end) == pytest.approx((5, 7), abs=0.03)
