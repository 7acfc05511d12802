"""Spans, states, rests and pieces, against loops that write out what the texts state."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rigtool.experiments.force_filter import estimate, kalman, passed, smoothed
from rigtool.experiments.force_filter.accuracy import LOAD_BAND_EDGES, accuracy, by_band_and_state
from rigtool.experiments.force_filter.estimate import Estimate, Signals
from rigtool.experiments.force_filter.motion_states import (
    CREEPING_KIND,
    Judge,
    Moments,
    Reach,
    State,
)
from rigtool.experiments.force_filter.plant import (
    ANGLE,
    BRISTLE,
    COSINE,
    GRASPER,
    GRASPER_SPEED,
    HOUSING,
    LOAD,
    NOISE,
    SINE,
    SPEED,
    STATES,
    TIP,
    TORQUE,
)
from rigtool.experiments.force_filter.smoothed import Again, Smoother
from tests.experiments.force_filter.plants import PLANT, UNCERTAINTY

COUNT, STEP = 1e-3, 10e-3
REACH = Reach((-0.2004, 0.4004), 2.0, 0.05, (20.0, 50.0), 0.3)


def wandering(seed, size=120):
    """Return moments that wander through all that a state depends on."""
    rng = np.random.default_rng(seed)
    speed = np.repeat(rng.choice([0.0, 0.0, 0.0, 0.02, 0.1, -0.3, 1.0, -2.5], size // 10), 10)
    low = np.floor(np.cumsum(speed) * STEP / COUNT) * COUNT
    return Moments(
        low,
        speed + 1e-3 * rng.standard_normal(size),
        rng.uniform(-1.1, 1.1, size),
        rng.choice([-0.06, -0.054, 0.01, 0.054], size) * rng.choice([1, 0.2], size),
        rng.choice([19.9, 20.0, 30.0, 50.0, 50.1], size, p=[0.02, 0.3, 0.36, 0.3, 0.02]),
        (rng.random(size) < 0.01).astype(float),
        rng.random(size) < 0.5,
    )


def spans(size, steps, causal):
    """Yield the indices from `steps` before each step, or before and after, within the array."""
    for k in range(size):
        yield range(
            max(0, k - (2 * steps if causal else steps)), min(size, k + 1 + steps * (not causal))
        )


@pytest.mark.parametrize("causal", [False, True])
@pytest.mark.parametrize("seed", range(6))
def test_states_kinds_and_holding_are_those_of_the_text(seed, causal):
    own, judge = wandering(seed), Judge(REACH, COUNT, STEP, causal)
    size, states, kinds, holding = len(own.low), [], [], []
    still = [*spans(size, 5, causal)]  # 0.1 s about each step
    limit = [*spans(size, 5 if causal else 10, causal)]  # 0.1 s before it, and behind
    mean = [*spans(size, 2, causal)]  # 0.05 s: round(2.5) steps of 10 ms on either side
    for k in range(size):
        way = np.ptp(own.low[still[k]])
        direction = np.sign(own.speed[k])
        first, last = mean[k][0], mean[k][-1]
        passing = (own.low[last] - own.low[first]) / (max(last - first, 1) * STEP)
        state = State.AGAINST if own.torque[k] * direction >= 0 else State.WITH
        if own.housing[k] * direction < 0.9:
            state = State.REVERSED
        if round(way / COUNT) <= 1:
            state = State.STILL
        if (
            not -0.2064 <= own.low[k] <= 0.4064
            or abs(passing) > 2.2
            or abs(own.torque[k]) > 0.055
            or not 20 <= own.temperature_degc[k] <= 50
            or own.limited[limit[k]].any()
        ):
            state = State.OUTSIDE
        slides = state in (State.AGAINST, State.WITH)
        states.append(state)
        kinds.append(CREEPING_KIND if slides and abs(passing) < 0.3 else state)
        crawls = abs(passing) < 1.5 * COUNT / 0.05
        before, behind = max(0, k - 25), k + 1 if causal else k + 25
        rests = k >= 24 and np.ptp(own.low[before:behind]) == 0  # 0.25 s
        holding.append((2 if crawls else 1) if own.idle[k] else 3 * rests)
    found = judge.judged(own)
    assert found.states.tolist() == states
    assert found.kinds.tolist() == kinds
    assert found.holding.tolist() == holding


def test_the_draws_hold_all_states():
    judge = Judge(REACH, COUNT, STEP)
    every = [judge.judged(own).kinds for own in map(wandering, range(6))]
    assert set(np.concatenate(every)) == {0, 1, 2, 3, 4, 5}
    holding = [judge.judged(own).holding for own in map(wandering, range(6))]
    assert {*np.concatenate(holding)} == {0, 1, 2, 3}


@given(st.floats(1e-4, 0.5))
def test_a_span_holds_the_time_about_a_limit_on_both_sides(step):
    """In steps, one at least: twice 0.1 s, of which the causal form looks at one side; a rest in a
    count is longer."""
    longest = max(2 * max(1, round(0.1 / step)), round(0.25 / step))
    assert Judge(REACH, COUNT, step).span == longest


def an_again():
    return Again(PLANT, UNCERTAINTY, 8, 10.0)


@given(st.lists(st.lists(st.integers(0, 1), max_size=7), min_size=1, max_size=6))
def test_rests_go_on_from_block_to_block(blocks):
    """Steps since the angle entered its count; before the first one, it has just entered it."""
    own, place, rested, found, expected = an_again(), 0, 0, [], []
    first = True
    for moves in blocks:
        low = []
        for moved in moves:
            place += moved
            rested = 0 if first or moved else rested + 1
            first = False
            low.append(float(place))
            expected.append(rested)
        part = own._rested(np.array(low))
        seen = np.zeros((len(part), 4))
        seen[:, 3] = part
        own._seen = np.concatenate([own._seen, seen])
        found += part.tolist()
    assert found == expected


@pytest.mark.parametrize("seed", range(4))
def test_noise_is_raised_before_a_step_and_about_a_rest_that_ends_at_another_torque(seed):
    """30 ms before the first filter's levels, and 30 ms about the end of a rest of 0.25 s in a
    count, where torque `busy_time` later differs from that before by 1.5 deviations."""
    rng, own = np.random.default_rng(seed), an_again()
    onset, settled, rest = 30, round(UNCERTAINTY.busy_time / 1e-3), 250
    size = 1500
    level = np.where(rng.random(size) < 2e-3, rng.choice([1.0, 2.0], size), 0.0)
    torque = np.repeat(rng.choice([0.0, 1.0, 1.9, 2.4], size // 100), 100)
    deviation = rng.choice([0.4, 0.6], size)
    rested, lasting = [], 0
    for k in range(size):
        ends = k in (240, 500, 760, 790, 1200, 1460)
        lasting = 0 if ends else lasting + 1
        rested.append(lasting)
    own._seen = np.column_stack([level, torque, deviation, rested])
    raised = np.zeros(size)
    for k in range(size):
        about = level[k]
        if k and rested[k] == 0 and rested[k - 1] >= rest:
            later = min(k + settled, size - 1)
            unsure = math.hypot(deviation[later], deviation[k - 1])
            if abs(torque[later] - torque[k - 1]) > 1.5 * unsure:
                behind = slice(k, k + onset + 1)
                raised[behind] = np.maximum(raised[behind], 2.0)
        raised[k] = max(raised[k], about)
    expected = [raised[k : k + onset + 1].max() for k in range(size)]
    np.testing.assert_array_equal(own._least(), expected)


def test_rests_with_and_without_another_torque_are_among_the_draws():
    own = an_again()
    steps = np.arange(600.0)
    for change, level in ((0.84, 0.0), (0.86, 2.0)):
        torque = np.where(steps < 300, 0.0, change)
        rested = np.where(steps < 300, steps, steps - 300)
        own._seen = np.column_stack([0 * steps, torque, 0.4 + 0 * steps, rested])
        assert own._least().max() == level  # 1.5 hypot(0.4, 0.4) = 0.849
        assert not own._least()[:270].any()
        assert not own._least()[331:].any()


@pytest.fixture
def pieces(monkeypatch):
    """Return estimates of given lengths whose torques are their number, unchanged by smoothing."""
    monkeypatch.setattr(smoothed.smoother, "smooth_steps", lambda *given: None)

    def made(*lengths):
        first = 0
        for length in lengths:
            states = np.zeros((length, STATES))
            states[:, estimate.TORQUE] = first + np.arange(length)
            outputs = np.zeros((length, kalman.OUTPUTS))
            outputs[:, 1] = -states[:, estimate.TORQUE]
            first += length
            low = np.zeros(length)
            yield Estimate(states, outputs, low, low.astype(bool), (np.empty(0),))

    return made


@pytest.mark.parametrize("step_time", [1e-2, 2e-2])
def test_steps_are_smoothed_in_blocks_that_enough_others_follow(pieces, step_time):
    """A block is 64 s; what it returns has 20 s behind it, in whole pieces."""
    block, ahead = round(64 / step_time), round(20 / step_time)
    lengths = [1000, 1, 0, 1700, 2500, 300, 0, 3000, 4000, 10, 9000, ahead - 1, 1]
    own, waiting, taken = Smoother(UNCERTAINTY, step_time), [], 0
    for number, piece in enumerate(pieces(*lengths)):
        if lengths[number]:
            waiting.append(lengths[number])
        due = 0
        if sum(waiting) >= block + ahead:
            while waiting and sum(waiting[1:]) >= ahead:
                due += waiting.pop(0)
        torque, deviation = own.add(piece)
        np.testing.assert_array_equal(torque, taken + np.arange(due))
        np.testing.assert_array_equal(deviation, -torque)
        taken += due
    assert 0 < taken < sum(lengths)
    torque, deviation = own.finish()
    np.testing.assert_array_equal(torque, np.arange(taken, sum(lengths)))
    np.testing.assert_array_equal(deviation, -torque)
    assert [len(part) for part in own.finish()] == [0, 0]


def test_the_noise_of_friction_fades_from_step_to_step(pieces, monkeypatch):
    kept = []
    monkeypatch.setattr(
        smoothed.smoother, "smooth_steps", lambda rows, factor, *rest: kept.append(factor)
    )
    own = Smoother(replace(UNCERTAINTY, friction_noise_time=0.2), 1e-2)
    own.add(next(pieces(5)))
    own.finish()
    assert kept == [pytest.approx(math.exp(-0.05))]


@pytest.mark.parametrize(("corner", "step"), [(10.0, 1e-3), (30.0, 2e-3), (1.0, 1.0), (1e-3, 1.0)])
def test_without_its_delay_a_deviation_is_earlier_and_holds_at_the_end(corner, step):
    deviation = np.arange(60.0) ** 2
    late = min(round(passed.delay(corner) / step), 59)
    found = smoothed.without_delay(deviation, corner, step)
    expected = [deviation[min(k + late, 59)] for k in range(60)]
    np.testing.assert_array_equal(found, expected)


def test_parts_of_signals_join_again():
    rng = np.random.default_rng(1)
    values = rng.standard_normal((3, 30))
    idle = rng.random(30) < 0.5
    for none in (None, idle):
        whole = Signals(*values, 0.3, none)
        first, second = whole.part(0, 11), whole.part(11, None)
        again = first.joined(second)
        for name in ("drive_torque", "viscous", "low"):
            np.testing.assert_array_equal(getattr(again, name), getattr(whole, name))
        assert (again.width, len(first.low)) == (0.3, 11)
        assert again.idle is None if none is None else np.array_equal(again.idle, idle)
    unknown = first.joined(replace(second, idle=None))
    assert unknown.idle is None


@given(st.lists(st.floats(-2, 2), min_size=1, max_size=30), st.integers(0, 2**31))
def test_accuracy_is_that_of_the_steps_that_count(errors, seed):
    rng = np.random.default_rng(seed)
    error = np.array(errors)
    error[rng.random(len(error)) < 0.2] = np.nan
    covered, among = rng.random((2, len(error))) < 0.6
    found = accuracy(error, covered, among)
    chosen = [k for k in range(len(error)) if among[k] and not math.isnan(error[k])]
    if not chosen:
        assert found.share == 0
        assert np.isnan([found.rmse, found.bias, found.coverage]).all()
        return
    assert found.share == pytest.approx(len(chosen) / np.isfinite(error).sum())
    assert found.rmse == pytest.approx(math.sqrt(sum(error[k] ** 2 for k in chosen) / len(chosen)))
    assert found.bias == pytest.approx(sum(error[k] for k in chosen) / len(chosen), abs=1e-12)
    assert found.coverage == pytest.approx(sum(covered[k] for k in chosen) / len(chosen))


def test_bands_hold_their_lower_edges_and_all_beyond():
    largest = 2.0
    edges = np.array(LOAD_BAND_EDGES) * largest
    reference = np.concatenate([edges, -edges, edges - 1e-9, [9.0]])
    states = np.full(len(reference), State.WITH, dtype=np.int32)
    states[3] = State.STILL
    found = by_band_and_state(
        np.ones(len(reference)), np.ones(len(reference), dtype=bool), reference, states, largest
    )
    shares = np.array([[one.share for one in row] for row in found])
    counts = np.zeros((4, 4))
    for value, state in zip(reference, states, strict=True):
        band = sum(abs(value) >= edge for edge in edges[1:-1])
        counts[band, [State.AGAINST, State.WITH, State.REVERSED, State.STILL].index(state)] += 1
    np.testing.assert_allclose(shares, counts / len(reference))


def test_a_filter_knows_no_deviation_before_its_first_step():
    own = estimate.Filter(PLANT, UNCERTAINTY, 8, 10.0)
    assert own.last_deviation == 0
    own._state = {"covariance": np.full((1, STATES, STATES), 9.0)}
    assert own.last_deviation == 3.0


def test_a_filter_begins_at_rest_between_two_edges_with_a_load_that_stretches_the_tendon():
    """Covariances by drawing: the output is where the tendon's torque leaves it."""
    low, width, low_pass = 1.7, 2e-3, passed.section(10.0, 1e-3)
    state = kalman.begin(PLANT, UNCERTAINTY, low, width, low_pass)[0]
    mean, covariance = state["mean"], state["covariance"]
    assert mean[ANGLE] == pytest.approx(low + width / 2)
    assert mean[GRASPER] == pytest.approx((low + width / 2) / PLANT.angle_ratio)
    assert np.count_nonzero(mean) == 2
    assert (state["direction"], state["low"]) == (1.0, low)
    u = UNCERTAINTY
    spread = {
        ANGLE: width / 2,
        SPEED: u.speed_start,
        GRASPER_SPEED: u.speed_start,
        BRISTLE: u.bristle_start,
        HOUSING: u.bristle_start,
        TIP: u.bristle_start,
        GRASPER: u.torque_start / PLANT.stiffness,
        SINE: u.stroke,
        COSINE: u.stroke,
        LOAD: u.load_stroke,
        NOISE: u.friction_noise,
        TORQUE: u.torque_start,
    }
    assert len(spread) == STATES
    for number, deviation in spread.items():
        assert math.sqrt(covariance[number, number]) == pytest.approx(deviation)
    own = covariance[:STATES, :STATES]
    apart = own - np.diag(np.diag(own))
    stretch = -0.999 * spread[TORQUE] ** 2 / PLANT.stiffness
    assert apart[GRASPER, TORQUE] == apart[TORQUE, GRASPER] == pytest.approx(stretch)
    assert np.count_nonzero(apart) == 2
    # a torque that has been there all the time is behind the low-pass as it is
    behind = passed.settled(low_pass)
    joint = np.outer(behind, own[TORQUE])
    found = covariance[STATES : passed.JOINT_STATES, :STATES]
    np.testing.assert_allclose(found, joint)
    np.testing.assert_allclose(
        covariance[STATES : passed.JOINT_STATES, STATES : passed.JOINT_STATES],
        np.outer(behind, behind) * own[TORQUE, TORQUE],
    )


@pytest.mark.parametrize("size", [1, 3])
def test_a_step_ends_at_the_sample_behind_it(size):
    low = 1e-3 * np.arange(10.0)
    own = estimate.Filter(PLANT, UNCERTAINTY, size, 10.0)
    found = own.add(Signals(0 * low, 5e-5 + 0 * low, low, 1e-3))
    np.testing.assert_array_equal(found.low, low[size::size])
    assert len(found.torque) == len(found.deviation) == 9 // size
