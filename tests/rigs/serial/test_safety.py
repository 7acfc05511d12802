"""Limits: what a motion will ask, and what a running one measures."""

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from rigtool.control.lookup_table import LookupTable
from rigtool.errors import HardwareError, RecipeError, UsageError
from rigtool.recipe.serial import Limits
from rigtool.rigs import Feedforward, Load, Task
from rigtool.rigs.motion import CurrentRamp, CurrentSteps, Move, Observe, SpeedProfile, Triangle
from rigtool.rigs.operator import Operator
from rigtool.rigs.serial import safety
from rigtool.rigs.serial.rig import describe_load

DT = 125e-6
LIMITS = Limits(current=2, speed=10, position=(-1, 4), temperature_degc=50, duration=100)


def extremes(motion, feedforward=Feedforward(), origin=0.0, constant=0.05):  # noqa: B008
    return safety.extremes(Task(motion, feedforward), origin, DT, constant)


def test_extremes_of_a_triangle_are_those_of_its_formulas():
    found = extremes(Triangle(0.5, 2.5, 4.0, 0.3, cycles=2))
    turn = 2 * 0.3 / 4.0
    assert found.duration == pytest.approx(2 * 2 * (1.4 / 4 + 2 * turn), rel=1e-9)
    assert found.position == pytest.approx((0.5, 2.5), abs=1e-6)
    assert found.speed == pytest.approx(4.0, rel=1e-9)
    assert found.acceleration == pytest.approx(4 * math.pi / (2 * turn), rel=1e-4)
    assert found.current == 0.0


def test_extremes_of_a_move_are_those_of_a_minimum_jerk():
    found = extremes(Move(-3.0, 2.0), origin=1.0)
    assert found.position == pytest.approx((-2.0, 1.0), abs=1e-6)
    assert found.speed == pytest.approx(15 / 8 * 3 / 2, rel=1e-6)
    assert found.acceleration == pytest.approx(10 / math.sqrt(3) * 3 / 4, rel=1e-6)
    assert found.end == pytest.approx(-2.0, rel=1e-9)


def test_extremes_in_open_loop():
    found = extremes(CurrentRamp(-0.5, -1.5))
    assert found.current == pytest.approx(1.5, rel=1e-3)
    assert math.isnan(found.position[0])
    assert extremes(CurrentSteps((0.0, 0.4, -0.7), 0.1)).current == 0.7


def test_a_set_point_that_jumps_is_found_whatever_the_motion():
    """Turn angles that overlap once made strokes that jump back at each reversal."""
    with pytest.raises(RecipeError, match=r"set point of Triangle jumps by .* rad at"):
        extremes(Triangle(0.0, 1.0, 4.0, 0.8, cycles=2))

    class Jumping(Move):
        def setpoint(self, time):
            position, speed, acceleration = super().setpoint(time)
            return position + 0.1 * (time > 9.0), speed, acceleration  # in the second block

    with pytest.raises(RecipeError, match=r"jumps by 0\.1 rad at 9 s"):
        extremes(Jumping(1.0, 10.0))


@given(
    speed=st.floats(0.01, 500),
    turn=st.floats(1e-3, 0.49),
    high=st.floats(0.01, 20),
    counts=st.lists(st.floats(-500, 500), min_size=1, max_size=5),
)
def test_set_points_that_follow_from_their_speeds_do_not_jump(speed, turn, high, counts):
    motion = Triangle(0.0, high, speed, turn * high, cycles=1)
    if motion.duration < 20:
        extremes(motion)
    times = tuple(0.05 * n for n in range(len(counts) + 2))
    extremes(SpeedProfile(times, (0.0, *counts, 0.0)))


def test_observing_asks_for_nothing():
    found = extremes(Observe(30.0))
    assert (found.duration, found.speed, found.current) == (30.0, 0.0, 0.0)
    assert math.isnan(found.end)
    safety.require_within_limits(found, LIMITS)


def test_feed_forward_current_adds_up():
    table = LookupTable(
        np.array([0.0, 1.0]), np.array([1.0]), np.full((1, 2), 3e-3),
        np.array([0.0, 1.0]), np.array([0.0, 1.0]),
    )  # fmt: skip
    signal = np.array([0.0, 2e-3])
    added = Feedforward(inertia=0, coulomb=1e-3, viscous=5e-4, table=table, signal=signal)
    found = extremes(SpeedProfile((0.0, 1.0), (2.0, 2.0)), added)
    torque = 1e-3 * math.tanh(2) + 1e-3 + 3e-3 + 2e-3
    assert found.current == pytest.approx(torque / 0.05, rel=1e-9)


@given(
    st.lists(st.floats(-20, 20), min_size=2, max_size=6),
    st.floats(-5, 5),
)
def test_extremes_hold_at_every_sample(speeds, origin):
    motion = SpeedProfile(tuple(0.1 * n for n in range(len(speeds))), tuple(speeds))
    found = extremes(motion, origin=origin)
    time = (np.arange(round(motion.duration / DT)) + 0.5) * DT
    position, speed, acceleration = motion.setpoint(time)
    assert found.position[0] <= (position + origin).min()
    assert found.position[1] >= (position + origin).max()
    assert found.speed == np.abs(speed).max()
    assert found.acceleration == np.abs(acceleration).max()


@pytest.mark.parametrize(
    ("motion", "feedforward", "message"),
    [
        (Triangle(0, 5, 4, 0.3, 1), Feedforward(), r"position 5 rad beyond .* \[-1, 4\]"),
        (Triangle(-1.1, 2, 4, 0.3, 1), Feedforward(), "position -1.1 rad"),
        (Triangle(0, 2, 12, 0.3, 1), Feedforward(), "speed 12 rad/s beyond .*speed = 10 rad/s"),
        (Move(1, 101), Feedforward(), "duration 101 s"),
        (CurrentSteps((3.0,), 1), Feedforward(), "current 3 A beyond"),
        (SpeedProfile((0, 1), (0, 2)), Feedforward(inertia=0.06), "current 2.4 A"),
    ],
)
def test_motions_beyond_the_limits_are_refused(motion, feedforward, message):
    with pytest.raises(RecipeError, match=message):
        safety.require_within_limits(extremes(motion, feedforward), LIMITS)


def test_all_that_is_beyond_is_said_at_once():
    with pytest.raises(RecipeError, match=r"current .*; speed .*; position"):
        safety.require_within_limits(
            extremes(Triangle(0, 9, 40, 0.3, 1), Feedforward(inertia=1.0)), LIMITS
        )


def test_motion_at_the_limits_is_allowed():
    safety.require_within_limits(extremes(Triangle(-1, 4, 10, 0.3, 1)), LIMITS)


def signals(count=400, dt=1e-3, **channels):
    time = np.arange(count) * dt
    block = {"time": time, "encoder": np.zeros(count), "current": np.zeros(count)}
    return block | {name: np.asarray(values, float) for name, values in channels.items()}


def watched(block, pieces=7, limits=LIMITS):
    """Return the first problem that a watch finds in signals that come in pieces."""
    watch = safety.Watch(limits, 4000)
    for part in np.array_split(np.arange(len(block["time"])), pieces):
        if problem := watch.problem({name: values[part] for name, values in block.items()}):
            return problem
    return None


@pytest.mark.parametrize("pieces", [1, 7, 400])
def test_watch_sees_what_is_beyond_and_only_that(pieces):
    time = np.arange(400) * 1e-3
    count = 4000 / (2 * math.pi)
    assert watched(signals(), pieces) is None
    assert watched(signals(encoder=np.floor(9.9 * time * count)), pieces) is None
    found = watched(signals(encoder=np.floor(10.9 * np.minimum(time, 0.3) * count)), pieces)
    assert "speed reached" in found
    assert "limit of 10 rad/s" in found
    assert watched(signals(current=np.full(400, -2.05)), pieces) is None
    assert "current reached 2.2" in watched(signals(current=np.full(400, -2.2)), pieces)
    assert watched(signals(temperature=20 + time * 75), pieces) is None
    assert "temperature reached 5" in watched(signals(temperature=20 + time * 100), pieces)
    assert watched(signals(encoder=np.full(400, -0.9 * count)), pieces) is None
    assert "position reached -1.2" in watched(signals(encoder=np.full(400, -1.2 * count)), pieces)
    assert "position reached 4.2" in watched(signals(encoder=np.full(400, 4.2 * count)), pieces)


@pytest.mark.parametrize("closed", [True, False])
def test_watch_sees_a_shaft_that_does_not_follow(closed):
    time = np.arange(400) * 1e-3
    count = 4000 / (2 * math.pi)
    block = signals(encoder=np.floor(3 * time * count)) | {"position_setpoint": 3 * time}
    stuck = signals() | {"position_setpoint": 3 * time}
    limits = LIMITS.model_copy(update={"following_error": 0.5})

    def found(what):
        return safety.Watch(limits, 4000, closed=closed).problem(what)

    assert found(block) is None
    if closed:
        assert "following_error = 0.5 rad" in found(stuck)
        assert "set point at" in found(stuck)
    else:  # an open loop has no set point of position
        assert found(stuck) is None
    assert found({name: values[:160] for name, values in stuck.items()}) is None


def test_watch_forgives_a_single_noisy_sample_and_missing_ones():
    current = np.zeros(400)
    current[200] = 15.0
    assert watched(signals(current=current)) is None
    current[:] = np.nan
    assert watched(signals(current=current, encoder=current, temperature=current)) is None


def test_one_count_at_8_khz_is_no_speed():
    encoder = np.zeros(4000)
    encoder[2000:] = 1.0
    assert watched(signals(4000, DT, encoder=encoder, current=np.zeros(4000))) is None


# -- what a watch promises, with drives that answer when they can

COUNT = 2 * math.pi / 4000
FAR = LIMITS.model_copy(update={"position": (-1e9, 1e9)})


@st.composite
def exchanges(draw):
    """Return times of readings (n,) and their stamps (n,), s: questions asked one after another.

    Most answers come soon, some wait for a computer that is busy, or for a retry. Stamps are those
    of the readings, of the answers, or in the middle of question and answer.
    """
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    period, share = (
        draw(st.floats(2.5e-4, 0.03) | st.just(2.5e-4)),
        draw(st.sampled_from([0.0, 0.02, 0.5])),
    )
    count = min(400, math.ceil(1.5 / period))
    longest = np.where(random.random(count) < share, 4 * period, 0.9 * period)
    waits = np.maximum(random.random(count) * longest, 1e-6)
    asked, answered, free = np.empty(count), np.empty(count), 0.0
    for n in range(count):
        asked[n] = max(free, n * period)
        answered[n] = free = asked[n] + waits[n]
    read = asked + random.random(count) * waits
    return read, {"read": read, "middle": (asked + answered) / 2, "answer": answered}[
        draw(st.sampled_from(["read", "middle", "answer"]))
    ]


def judged(stamps, angle, limit, pieces=9, missing=()):
    encoder = np.floor(angle / COUNT)
    encoder[[n for n in missing if n < len(stamps)]] = np.nan
    signal = {"time": stamps, "encoder": encoder, "current": np.zeros(len(stamps))}
    limits = FAR.model_copy(update={"speed": limit})
    return watched(signal, min(pieces, len(stamps)), limits)


@given(
    exchanges(),
    st.floats(0.2, 50) | st.just(0.2),
    st.floats(-1, 1) | st.sampled_from([-1, 1]),
    st.floats(-1, 1) | st.sampled_from([-1, 1]),
    st.floats(0, 1.5),
    st.sets(st.integers(0, 40)),
    st.sampled_from([1, 9, 10**6]),
)
def test_a_motor_within_the_limit_never_trips(
    exchanged, limit, first, then, change, missing, pieces
):
    read, stamps = exchanged
    turns = first * np.minimum(read, change) + then * np.maximum(read - change, 0)
    assert judged(stamps, (1 - 1e-9) * limit * turns, limit, pieces, missing) is None


@given(
    exchanges(),
    st.floats(0.2, 50),
    st.sampled_from(safety.SPEED_WINDOWS.tolist()),
    st.floats(0, 1),
    st.sampled_from([-1, 1]),
    st.sets(st.integers(0, 40)),
)
def test_a_speed_beyond_the_limit_always_trips_in_time(
    exchanged, limit, window, start, way, missing
):
    read, stamps = exchanged
    there = np.ones(len(read), bool)
    there[[n for n in missing if n < len(read)]] = False
    interval = np.diff(stamps[there], prepend=0.0).max()
    lasts = window + 6 * interval
    assume(
        interval < safety.MAX_BLIND_TIME and 2.01 * interval < window and lasts < read[there][-1]
    )
    margin = limit * (window + 2 * interval) + 2 * COUNT
    speed = 1.001 * margin / (window - 2 * interval)
    begin = start * (read[there][-1] - lasts)
    angle = way * speed * np.clip(read - begin, 0, lasts)
    assert "speed reached" in judged(stamps, angle, limit, 9, missing)


@given(
    exchanges(),
    st.floats(0, 1),
    st.sampled_from([1.0, -1.0, 0.0]),
    st.booleans(),
    st.sets(st.integers(0, 40)),
)
def test_current_is_judged_by_its_magnitude(exchanged, start, sign, beyond, missing):
    _, time = exchanged
    current = (1.05 + (1e-9 if beyond else -1e-9)) * LIMITS.current * np.ones(len(time))
    current *= sign or np.where(np.arange(len(time)) % 2, 1, -1)  # or it oscillates
    there = np.ones(len(time), bool)
    there[[n for n in missing if n < len(time)]] = False
    interval = np.diff(time[there], prepend=0.0).max()
    lasts = safety.CURRENT_WINDOW + 2 * interval
    begin = start * (time[-1] - lasts)
    if beyond:
        current[(time < begin) | (time > begin + lasts)] = 0.0
    current[~there] = np.nan
    found = watched({"time": time, "current": current}, 9)
    assert ("current reached" in found) if beyond else (found is None)


@pytest.mark.parametrize("pieces", [1, 40, 4000])
def test_a_position_that_is_missing_for_long_is_a_problem(pieces):
    time = np.arange(4000) * 1e-3
    for gone, seconds in ((time > 3.4, None), (time > 3.6, 0.4), ((time > 1) & (time < 1.4), 0.4)):
        encoder = np.where(gone, np.nan, 0.0)
        found = watched(signals(4000, encoder=encoder, current=np.zeros(4000)), pieces)
        assert (found is None) == (seconds is not None)
    assert "position was missing for" in watched(
        signals(4000, encoder=np.full(4000, np.nan), current=np.zeros(4000)), pieces
    )


def test_samples_that_come_rarely_are_not_missing():
    assert watched(signals(20, 1.0, encoder=np.zeros(20), current=np.zeros(20))) is None


@pytest.mark.parametrize("period", [DT, 4e-3, 0.02])
@pytest.mark.parametrize("jump", [-4000, 4000, 65536])
def test_an_encoder_that_jumps_is_a_problem_that_names_it(period, jump):
    count = round(0.5 / period)
    encoder = np.where(np.arange(count) < count // 2, 0.0, jump)
    found = watched(signals(count, period, encoder=encoder, current=np.zeros(count)), 40, FAR)
    assert "speed reached" in found
    if period < 0.01:
        assert "may also be a jump of the position" in found


# -- the operator


def operator(*answers, present=True):
    asked, said = [], []
    replies = iter(answers)

    def ask(question):
        asked.append(question)
        return next(replies)

    return Operator(ask=ask, say=said.append, present=present), asked, said


def test_reading_is_repeated_until_it_is_taken():
    person, asked, said = operator("1,5", "r", "much", "2.5", "")
    assert person.reading("force", "N") == 2.5
    assert said == ["'much' is not a number of N"]
    assert asked[1] == "force 1.5 N: Enter to take it, r to repeat:"


def test_only_enter_alone_takes_a_reading():
    person, asked, said = operator("150", "15", "15", "")  # the right value at the wrong question
    assert person.reading("temperature", "degC") == 15
    assert said == ["150 degC is not taken: type the reading, then Enter alone"]
    assert len(asked) == 4


def test_nobody_there_is_an_error_that_says_what_was_to_do():
    person, _, _ = operator(present=False)
    with pytest.raises(HardwareError, match="to do this: Hang 5 N"):
        person.done("Hang 5 N")


def test_permission_needs_a_yes():
    for answer, agreed in (("y", True), ("yes", True), ("", False), ("no", False)):
        person, _, said = operator(answer)
        if agreed:
            person.permit("plan", "the rig would move", "Move now?")
        else:
            with pytest.raises(UsageError, match="not agreed to"):
                person.permit("plan", "the rig would move", "Move now?")
        assert said == ["plan"]


def test_loads_are_described_as_requests():
    assert describe_load(Load(force=2.5), "instrument") == (
        "Hang 2.5 N (254.9 g) on the grasper, see that the arm is away from the force gauge"
    )
    text = describe_load(Load(torque=0.014, radial_force=22.0), "pulley")
    assert text.startswith("Load the shaft with 14 mN m (weight on a cord), pull the shaft")
    assert describe_load(Load(clamped=True), "pulley").startswith("Remove all loads")


@pytest.mark.parametrize("period", [0.002, 0.004, 0.01])
def test_runaway_is_noticed_at_the_speed_that_is_stated(period):
    limits, acceleration = LIMITS, 2000.0
    stated = safety.runaway(limits, 4000, period, acceleration)
    watch = safety.Watch(limits, 4000)
    time = np.arange(0.0, 1.0, period)
    encoder = np.floor(acceleration * time**2 / 2 / (2 * math.pi) * 4000)
    problems = [
        watch.problem({"time": time[n : n + 1], "encoder": encoder[n : n + 1]})
        for n in range(len(time))
    ]
    first = next(n for n, problem in enumerate(problems) if problem)
    assert stated == pytest.approx(acceleration * time[first], rel=1e-9)
    assert stated > limits.speed
