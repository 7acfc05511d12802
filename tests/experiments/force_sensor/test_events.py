"""Events: contacts that the torque of a whole recording shows, as one where nothing lets go."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.signal import lfilter

from rigtool.experiments.force_filter.accuracy import COVERAGE_FACTOR
from rigtool.experiments.force_filter.motion_states import State
from rigtool.experiments.force_model.contacts import JUMP_WINDOW, Contact, contacts, trial
from rigtool.experiments.force_sensor.events import LET_GO_TIME, SURE, UNSEEN, events
from rigtool.experiments.force_sensor.results_over_time import ROWS_PER_PERIOD, TorqueRows

STEP, EVERY, HALF = 1e-3, 5, 1e-3
ROW = EVERY * STEP
LEAST_U = ROWS_PER_PERIOD * ROW / math.sqrt(12)
LIMITS = np.tile([0.5e-3, 6.0], (3, 1))


def shown(torque, found, half=HALF, states=State.AGAINST):
    """Return the events of rows whose torque is known to `half` either way, N m."""
    size = len(torque)
    u, states = np.full(size, half) / COVERAGE_FACTOR, np.full(size, states, dtype=np.int32)
    rows = TorqueRows(
        "made", ROW, ROW * np.arange(size), torque, u, states, contacts=tuple(found), every=EVERY
    )
    return events(rows)


def spans(found):
    """Return begin and end of events in steps."""
    return [(each.start[0] * EVERY, each.end[0] * EVERY) for each in found]


def listed(torque):
    """Return what is found in a torque at each step, and its events."""
    level = np.full(len(torque), 0.2e-3)
    tested = trial(torque, level, np.full(len(torque), State.AGAINST), STEP)
    found = contacts(tested, LIMITS)
    return found, shown(torque[::EVERY], found)


@pytest.mark.parametrize("hz", [0.7, 3.0, 8.0])
def test_a_force_that_swings_is_one_event(hz):
    time = STEP * np.arange(12000)
    torque = np.where((time > 4) & (time < 9), 20e-3 * np.sin(2 * np.pi * hz * (time - 4)), 0.0)
    found, own = listed(torque)
    ((begin, end),) = spans(own)
    assert len(found) > 3
    assert begin * STEP == pytest.approx(4.0, abs=0.1 / hz)
    assert end * STEP == pytest.approx(9.0, abs=0.5 / hz)
    assert own[0].found == found[0].found


@pytest.mark.parametrize(("apart", "count"), [(0.15, 1), (0.3, 2)])
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_what_lets_go_ends_an_event(apart, count, side):
    time = STEP * np.arange(9000)
    torque = 10e-3 * ((time > 4) & (time < 5))
    torque += side * 15e-3 * ((time > 5 + apart) & (time < 6))
    assert len(listed(torque)[1]) == count


def test_what_no_sample_so_far_shows_may_be_sure_before_it_starts():
    torque = np.repeat([0.0, 5e-3, 20e-3, 0.0], [50, 4, 50, 96])
    (event,) = shown(torque, [])
    assert event.found == UNSEEN
    assert event.start[0] == pytest.approx(53.5, abs=1)
    assert event.end[0] == pytest.approx(103.5, abs=1)


def test_the_rows_of_an_event_are_those_between_its_start_and_its_end():
    """A row more, whose torque is that of before, makes means of short contacts too small."""
    (own,) = shown(np.repeat([0.0, 20e-3, 0.0], [50, 45, 100]), [Contact(250, 252, 474)])
    assert own.start[0] == pytest.approx(49.5)
    assert own.rows == slice(50, 95)
    assert replace(own, start=(50.2, 0.1), end=(50.8, 0.1)).rows == slice(50, 51)


def test_what_may_be_nothing_for_long_is_touched_by_nobody():
    """Without a value, the interval holds everything."""
    rows, half = np.full(200, 5e-3), np.full(200, HALF)
    half[90:140] = np.inf
    found = [Contact(100, 110, 449), Contact(450, 460, 690), Contact(700, 710, 900)]
    assert [own.found for own in shown(rows, found, half)] == [110, 710]


@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize("late", [-80, -5, 0, 25, 65])
def test_a_contact_lasts_while_the_torque_of_the_whole_recording_does(side, late):
    """Samples so far show begin and end otherwise."""
    rows = np.zeros(200)
    rows[20:60] = 20e-3
    rows[60:70] = 1.5e-3
    (own,) = shown(side * rows, [Contact(100 + late, 180, 300 + late)])
    begin, end = spans([own])[0]
    assert begin == pytest.approx(97.5, abs=0.1)
    assert end == pytest.approx(297.5, abs=1.5)
    assert own.start[1] == pytest.approx(LEAST_U / ROW, rel=0.1)
    rows[60:70] = 18e-3  # still above half of the mean
    (own,) = shown(side * rows, [Contact(100 + late, 180, 300 + late)])
    assert spans([own])[0][1] == pytest.approx(347.5, abs=0.5)


def test_the_fall_of_a_contact_is_no_contact():
    """It begins with the end of the contact, and soon shows nothing."""
    rows = np.zeros(200)
    rows[20:60], rows[60:66] = 20e-3, 5e-3
    found = [Contact(100, 110, 300), Contact(300, 310, 600)]
    assert spans(shown(rows, found)) == spans(shown(rows, found[:1]))
    rows[60:100] = 5e-3
    ((begin, end),) = spans(shown(rows, found))
    assert (begin, end) == (pytest.approx(97.5, abs=0.1), pytest.approx(497.5, abs=1.0))


def test_what_the_filter_remembers_of_a_contact_is_no_contact():
    """Its level seems to be one for a second; a few intervals miss zero by chance."""
    rows = np.zeros(400)
    rows[20:60], rows[60:140], rows[110:120] = 20e-3, 0.6e-3, 1.95e-3
    first = Contact(100, 110, 300)
    remembered = [Contact(300, 340, 700), Contact(450, 560, 700)]
    for other in remembered:
        assert len(shown(rows, [first, other])) == 1
    # the same is one where nothing is remembered, or where twice the interval does not hold zero
    later = Contact(540, 560, 700)
    rows[20:60], rows[30:50] = 0.0, 20e-3
    assert len(shown(rows, [Contact(150, 160, 250)])) == 1
    assert [own.found for own in shown(rows, [Contact(150, 160, 250), later])] == [160]
    rows[110:120] = 2.1e-3
    found = shown(rows, [Contact(150, 160, 250), remembered[0]])
    assert [own.found for own in found] == [160, 550]
    rows[20:60] = 0.0
    assert [own.found for own in shown(rows, [later])] == [560]


def test_a_touch_that_the_memory_of_another_one_hides_begins_where_it_does():
    rows = np.zeros(400)
    rows[20:60], rows[60:110], rows[110:180] = 20e-3, 0.6e-3, 8e-3
    first = Contact(100, 110, 300)
    for seen in (380, 550, 620):
        _, own = shown(rows, [first, Contact(300, seen, 900)])
        assert own.found == max(seen, 550)
        assert spans([own]) == [(pytest.approx(547.5, abs=1.0), pytest.approx(897.5, abs=1.0))]


@pytest.mark.parametrize(("size", "count"), [(0.95 * SURE, 0), (1.05 * SURE, 1)])
def test_what_surely_touches_is_an_event_though_no_sample_showed_it_in_time(size, count):
    rows = np.zeros(400)
    rows[100 : 100 + round(LET_GO_TIME / ROW)] = size * HALF
    found = shown(rows, [])
    assert len(found) == count
    assert all(own.found == UNSEEN for own in found)
    assert shown(np.where(np.arange(400) == 100, 0.0, rows), []) == []


def test_what_surely_touches_before_it_is_found_belongs_to_it():
    """Nothing is tested in the first seconds of a recording."""
    rows = np.zeros(800)
    rows[20:600] = 5e-3
    states = np.full(800, State.AGAINST)
    (own,) = shown(rows, [Contact(2000, 2001, 2990)], states=states)
    assert own.found == 2001
    assert own.start[0] == pytest.approx(19.5, abs=0.1)
    # it may have begun before there was a value
    states[:20] = State.OUTSIDE
    (own,) = shown(rows, [Contact(2000, 2001, 2990)], states=states)
    assert own.start[1] == pytest.approx(
        math.hypot(19.5 / COVERAGE_FACTOR, LEAST_U / ROW), rel=0.05
    )


def test_a_time_is_known_as_far_as_the_interval_holds_half_of_the_torque():
    """Friction hides a torque at rest: it may have come at any time of the rest."""
    rows, half = np.zeros(400), np.full(400, HALF)
    rows[200:300], half[150:200], half[300:340] = 8e-3, 6e-3, 6e-3
    (own,) = shown(rows, [Contact(1000, 1010, 1499)], half)
    for (place, u), nearest, farthest in ((own.start, 199.5, 149), (own.end, 299.5, 340)):
        assert place == pytest.approx(nearest, abs=0.1)
        assert u == pytest.approx(
            math.hypot((farthest - place) / COVERAGE_FACTOR, LEAST_U / ROW), rel=0.02
        )


def test_a_force_that_is_found_early_starts_where_it_passes_half_of_what_it_grows_to():
    """A strong force that takes 0.2 s shows long before: the time at which it does is no start."""
    rows, found = np.interp(np.arange(300), [100, 140, 250], [0.0, 50e-3, 50e-3]), 103
    (own,) = shown(rows, [Contact(found * EVERY, found * EVERY, 1200)])
    behind = found + round(JUMP_WINDOW / ROW)
    assert own.start[0] == pytest.approx((100 + behind) / 2, abs=0.1)
    assert own.found == found * EVERY


def test_intervals_of_start_and_end_hold_the_times_of_weak_pulses():
    """Errors with a memory of 0.1 s, torques of 4 to 15 times their deviation."""
    rng, kept, size = np.random.default_rng(7), math.exp(-ROW / 0.1), 800
    pulls = []
    for _ in range(300):
        begin, lasts, torque = rng.uniform(200, 300), rng.uniform(60, 300), rng.uniform(2e-3, 8e-3)
        noise = lfilter([math.sqrt(1 - kept**2)], [1, -kept], rng.standard_normal(size))
        place = np.arange(size)
        rise = np.clip(np.minimum(place - begin, begin + lasts - place) / 10, 0, 1)
        rows = torque * rise + HALF / COVERAGE_FACTOR * noise
        found = round(begin + 10) * EVERY
        own = shown(rows, [Contact(found, found, round(begin + lasts) * EVERY)])
        assert len(own) == 1
        pulls.append((own[0].start[0] - begin - 5) / own[0].start[1])
        pulls.append((own[0].end[0] - begin - lasts + 5) / own[0].end[1])
    assert np.mean(np.abs(pulls) < COVERAGE_FACTOR) > 0.93
    assert np.sqrt(np.mean(np.square(pulls))) > 0.3


def test_an_event_starts_behind_the_one_before():
    """Between them the interval holds zero, but the torque is more than half of the second one."""
    rows = np.full(400, 0.9e-3)
    rows[:20], rows[20:60], rows[300:340] = 0.0, 20e-3, 1.5e-3
    first, second = shown(rows, [Contact(100, 110, 300), Contact(1500, 1510, 1699)])
    assert first.end[0] < second.start[0] < 61


def test_events_share_no_row():
    rng = np.random.default_rng(3)
    for _ in range(20):
        rows = np.repeat(rng.choice([0.0, 0.0, 1.5e-3, 4e-3, -9e-3], 40), 30)
        rows = rows + 0.4e-3 * rng.standard_normal(len(rows))
        begins = np.sort(rng.choice(len(rows) * EVERY // 100, 8, replace=False)) * 100
        found = [Contact(int(b), int(b) + 20, int(b) + 99) for b in begins]
        own = shown(rows, found)
        for one, other in pairwise(own):
            assert one.rows.stop <= other.rows.start
        assert all(0 <= one.start[0] <= one.end[0] < len(rows) for one in own)


def test_a_jump_is_longer_than_the_least_uncertainty_of_a_time():
    assert JUMP_WINDOW / math.sqrt(12) > LEAST_U
