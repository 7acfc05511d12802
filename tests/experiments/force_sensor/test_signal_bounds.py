"""Signals are a fault beyond the bounds of friction, loads and the learned motion, and not below.

The bounds are computed here from the plant of the tests; each is tried a little below and above.
"""

import re
from dataclasses import replace

import numpy as np
import pytest

from rigtool.experiments.controller_torque import LoopAnswer
from rigtool.experiments.force_sensor.signal_faults import SignalFault, SignalWatch
from tests.experiments.deploy.sensors import CONSTANT, COUNTS, REACH, Model, instrument

INTERVAL, WARM = 1e-3, 27.0
TIME = np.arange(0, 8, INTERVAL)
NOISE = 0.01 * np.random.default_rng(3).standard_normal(len(TIME))
KT = CONSTANT[0] + CONSTANT[1] * WARM
PLANT = Model().plant(INTERVAL)
COUNT = 2 * np.pi / COUNTS
BOTH = pytest.mark.parametrize("beyond", [False, True])


def faults(encoder, current, setpoint=None, **options):
    watch = SignalWatch(instrument(interval=INTERVAL, loop_time=INTERVAL), **options)
    watch.add(np.array([encoder, current, np.full(len(TIME), WARM)]), setpoint)
    return watch.faults()


def to_and_fro(first=0.0):
    """Strokes of 600 counts that last 2 s each, and their direction."""
    phase = TIME / 2 % 2 - 1
    return first + np.floor(600 * np.abs(phase)), np.sign(phase)


@BOTH
def test_a_rotor_at_rest_is_held_by_friction_and_the_largest_load(beyond):
    """From the largest torque in one direction to that in the other: T = 2 F + (1 + 2 m) M / n,
    with the static friction of the bearings and the highest of the housing, and by load."""
    housing = np.abs(PLANT.friction_map[:, 0]).max() + abs(PLANT.housing_asymmetry)
    friction = PLANT.static * (1 + abs(PLANT.asymmetry)) + PLANT.housing_friction * housing
    by_load = PLANT.load_friction + PLANT.friction_map[:, 1].max()
    most = 2 * friction + (1 + 2 * by_load) * REACH.torque / PLANT.torque_factor
    swing = most * (1.04 if beyond else 0.96) / KT
    current = np.where((TIME > 2) & (TIME < 5), swing, 0.0) + np.where(TIME < 7, 0.0, 1e-6)
    found = faults(np.full(len(TIME), 12.0), current)
    assert len(found) == beyond
    for fault in found:
        assert fault.no_value
        assert f"up to {most * 1e3:.3g} mN m" in fault.text
        assert f"changes by {swing * KT * 1e3:.3g} mN m" in fault.text
        assert "stays at 12 " in fault.text
        assert (fault.start, fault.end) == pytest.approx((0.0, 8.0), abs=0.02)


@BOTH
@pytest.mark.parametrize("gain", [0.7, 0.1])
def test_a_set_point_leaves_a_rotor_at_rest_by_no_more_than_the_loop_answers(beyond, gain):
    """Strokes of the set point while the encoder stays: 0.1 rad and the change of torque over the
    loop's smallest gain; without a set point, or a gain, nothing is known."""
    change = 5e-3
    most = 0.1 + change / gain
    phase = np.abs(TIME / 2 % 2 - 1)
    wanted = 3.0 + most * (1.04 if beyond else 0.96) * phase
    current = change / KT * np.round(phase) + np.where(TIME < 7, 0.0, 1e-6)
    still = np.full(len(TIME), 12.0)
    found = faults(still, current, setpoint=wanted, commanded=True, loop=LoopAnswer(gain))
    found = [fault for fault in found if "further" not in fault.text]  # its mean may be, besides
    assert len(found) == beyond
    for fault in found:
        assert fault.no_value
        assert "goes away by " + f"{np.ptp(wanted[::20]):.3g} rad" in fault.text
        assert f"changes by {change * 1e3:.3g} mN m only" in fault.text
        assert (fault.start, fault.end) == pytest.approx((0.0, 8.0), abs=0.02)
    assert not faults(still, current, setpoint=wanted, commanded=True)
    assert not faults(still, current, commanded=True, loop=LoopAnswer(gain))
    encoder = np.floor(wanted / COUNT)  # a rotor that moves
    assert not faults(
        encoder, current + NOISE, setpoint=wanted, commanded=True, loop=LoopAnswer(gain)
    )


@BOTH
@pytest.mark.parametrize("behind", [True, False])
def test_a_loop_leaves_no_mean_distance_of_the_set_point_that_it_does_not_answer(beyond, behind):
    """The mean of a second: 0.05 rad and, over the loop's smallest gain, the torque's mean and the
    friction of bearings and housing that may be fed forward. As at first, it may be anything."""
    gain, current = 0.5, 0.4 + NOISE
    answer = 0.4 * KT + PLANT.coulomb + PLANT.housing_friction
    most = 0.05 + answer / gain
    encoder, _ = to_and_fro()
    off = np.where(TIME > 4, most * (1.05 if beyond else 0.93), 0.0) if behind else most + 1.0
    found = faults(
        encoder, current, setpoint=encoder * COUNT + off, commanded=True, loop=LoopAnswer(gain)
    )
    assert len(found) == (beyond and behind)
    for fault in found:
        assert fault.no_value
        assert f"is {most * 1.05:.3g} rad further" in fault.text
        assert (fault.start, fault.end) == pytest.approx((4.0, 8.0), abs=0.1)
    assert not faults(encoder, current, setpoint=encoder * COUNT + off, loop=LoopAnswer(gain))


def test_a_current_at_its_limit_explains_any_distance():
    encoder, _ = to_and_fro()
    still = (TIME > 2.6) & (TIME < 5.4)  # it is held there
    encoder = np.where(still, encoder[still][0], encoder)
    away = (TIME > 3) & (TIME < 5)
    wanted, limit = encoder * COUNT + 0.5 * away, instrument().current_limit
    for current, seen in ((0.4, True), (limit, False)):
        driven = np.where((TIME > 2.5) & (TIME < 5.5), current, 0.4) + NOISE * (TIME > 6)
        found = faults(encoder, driven, setpoint=wanted, commanded=True, loop=LoopAnswer(2.0))
        assert any("further from" in fault.text for fault in found) == seen
        assert any("goes away by" in fault.text for fault in found) == seen


@BOTH
@pytest.mark.parametrize("side", [1, -1])
def test_a_set_point_that_comes_nearer_leaves_the_torque_as_it_is(beyond, side):
    """What the loop's own part loses, its integrator adds, here all of it: 0.6 rad are no fault.
    Beyond the rotor, and away from it, both add: there 0.1 rad are left without an answer."""
    wanted = side * np.interp(TIME, [3.0, 5.0], [0.6, -0.104 if beyond else -0.096])
    found = faults(np.zeros(len(TIME)), NOISE, wanted, commanded=True, loop=LoopAnswer(0.5))
    stays = [fault for fault in found if "stays" in fault.text]
    assert len(stays) == beyond
    assert all("goes away by 0.104 rad" in fault.text for fault in stays)


@BOTH
def test_a_loop_that_leads_answers_a_set_point_that_slows_down(beyond):
    """It answers d + t v: as the set point of 3 rad/s stops, v gives what d demands."""
    lead, time = 0.04, TIME - 4
    encoder = np.floor(3 * np.minimum(time, 0) / COUNT)
    wanted = np.where(time < 0, 3 * time, 3 * lead * -np.expm1(-np.maximum(time, 0) / lead))
    loop = LoopAnswer(0.5, 0.0 if beyond else lead)
    found = faults(encoder, NOISE, wanted, commanded=True, loop=loop)
    assert any("goes away" in fault.text for fault in found) == beyond


@BOTH
def test_a_mean_distance_is_that_of_two_periods_of_the_integrator(beyond):
    """A soft loop swings in motion: over a second the distance is large, and the torque is not."""
    encoder, _ = to_and_fro()
    off = 0.3 * np.sin(np.pi * TIME)
    loop = LoopAnswer(0.5, turn=0.1 if beyond else 1.0)
    found = faults(encoder, 0.1 + NOISE, encoder * COUNT + off, commanded=True, loop=loop)
    assert len(found) == beyond
    assert all("in the mean of 1 s and more" in fault.text for fault in found)


def test_a_rotor_that_is_held_while_the_loop_answers_is_no_fault():
    wanted, gain = 0.2 * np.sin(TIME), 0.03
    held = np.full(len(TIME), 12.0)
    assert not faults(
        held, gain * wanted / KT, setpoint=wanted, commanded=True, loop=LoopAnswer(gain)
    )
    assert faults(held, NOISE, setpoint=wanted, commanded=True, loop=LoopAnswer(gain))


@BOTH
@pytest.mark.parametrize("load", [0.0, 1.0])
def test_a_motor_brakes_by_less_than_friction_and_loads_let_it(beyond, load):
    """Work above -F L / 2 - M R / (2 n), by a path L within a range R, is no fault. A load that
    helps in one stroke of two does its part of that; the motor brakes evenly otherwise."""
    encoder, direction = to_and_fro()
    path = np.abs(np.diff(encoder)).sum() * COUNT
    friction = (PLANT.coulomb + PLANT.housing_friction) / 2
    helped = REACH.torque / PLANT.torque_factor / 2 * np.ptp(encoder) * COUNT
    braking = friction + helped / path
    uneven = 1 + load * np.sign(np.sin(np.pi * TIME / 4))
    current = -direction * uneven * braking * (1.1 if beyond else 0.92) / KT
    found = faults(encoder, current + 1e-3 * NOISE, commanded=True)
    assert len(found) == beyond
    for fault in found:
        shown = [float(text) for text in re.findall(r"by (\d+\.?\d*) mN m", fault.text)]
        assert shown == pytest.approx([braking * 1.1e3, 2e3 * friction], rel=0.03)
        assert (fault.start, fault.end) == pytest.approx((0.0, 8.0), abs=0.02)


@BOTH
@pytest.mark.parametrize("way", [1, -1])
def test_an_encoder_leaps_where_it_passes_five_times_the_learned_speed(beyond, way):
    """Up to 1.1 of the speed that was learned, a rotor moves."""
    most = 5 * 1.1 * REACH.speed * INTERVAL / COUNT
    assert most > 5
    encoder, direction = to_and_fro()
    encoder = encoder + way * np.where(TIME > 3.0, np.ceil(most + 1 if beyond else most - 3), 0)
    found = faults(encoder, 0.3 * direction + NOISE)
    assert len(found) == beyond
    for fault in found:
        assert f"speed is {most:.0f}" in fault.text
        assert fault.start == fault.end == pytest.approx(3.0, abs=2e-3)
        assert f"from {fault.start:.3f} to" in fault.text


@BOTH
def test_at_a_low_learned_speed_five_counts_are_a_leap(beyond):
    slow = instrument(interval=INTERVAL, loop_time=INTERVAL, reach=replace(REACH, speed=0.1))
    watch = SignalWatch(slow)
    encoder = np.where(np.arange(3000) < 2000, 0.0, 6.0 if beyond else 5.0)
    watch.add(np.array([encoder, 0.1 + NOISE[:3000], np.full(3000, WARM)]))
    assert len(watch.faults()) == beyond


def moving_under(current, stays, counts):
    """Return signals whose current stays for some seconds, while the rotor moves by some counts."""
    first = (len(TIME) - round(stays / INTERVAL)) // 2
    part = slice(first, first + round(stays / INTERVAL))
    same = current + NOISE
    same[part] = same[first]
    speed = np.full(len(TIME), 200.0)
    speed[part] = counts / stays
    return np.floor(np.cumsum(speed) * INTERVAL), same, TIME[part]


@pytest.mark.parametrize(
    ("stays", "counts", "seen"),
    [(0.94, 100, False), (1.1, 100, True), (1.1, 44, False), (1.1, 58, True)],
)
def test_a_current_is_looked_at_that_stays_for_a_second_of_fifty_counts(stays, counts, seen):
    encoder, current, part = moving_under(0.3, stays, counts)
    found = faults(encoder, current, commanded=True)
    assert len(found) == seen
    for fault in found:
        assert (fault.start, fault.end) == pytest.approx((part[0], part[-1]), abs=0.021)
        assert f"stays at {current[np.argmax(part[0] <= TIME)]:.6g} A" in fault.text
        moved = float(re.search(r"moves by (\d+) counts", fault.text)[1])
        assert moved == pytest.approx(counts, abs=5)
        first, last = (round(time / INTERVAL) for time in (fault.start, fault.end))
        assert moved == np.ptp(encoder[first:last])
        assert "0 % of the other time" in fault.text
        assert fault.no_value


@pytest.mark.parametrize(("other", "seen"), [(2.2, True), (1.3, False)])
def test_what_stays_longer_than_the_rest_is_usual(other, seen):
    """Of a recording that ends soon after, nothing is known about currents that change."""
    encoder, current, _ = moving_under(0.3, 1.8, 400)
    begin = (len(TIME) - 1800) // 2
    cut = slice(begin - round(other / 2 / INTERVAL), begin + 1800 + round(other / 2 / INTERVAL))
    watch = SignalWatch(instrument(interval=INTERVAL, loop_time=INTERVAL))
    watch.add(np.array([encoder[cut], current[cut], np.full(len(TIME), WARM)[cut]]))
    assert len(watch.faults()) == seen


@pytest.mark.parametrize(("parts", "seen"), [(2, True), (11, False)])
def test_a_current_that_often_stays_is_usual(parts, seen):
    """In a tenth of the other time and more it is the way of the instrument."""
    encoder, current, _ = moving_under(0.3, 1.2, 300)
    for number in range(parts):
        begin = 100 + 300 * number + 2300 * (number >= 8)
        current[begin : begin + 95] = current[begin]
    assert len(faults(encoder, current)) == seen


@pytest.mark.parametrize(("windows", "seen"), [(4, False), (5, True)])
def test_a_current_is_cut_off_that_is_at_one_end_in_five_windows(windows, seen):
    encoder = np.floor(200 * TIME)
    current = 0.3 * np.sin(2 * np.pi * 0.7 * TIME) + NOISE
    end = current.max() + 1e-3
    for number in range(windows):  # windows of 20 ms; none beside another one
        current[1000 * number + 200 : 1000 * number + 220] = end
    found = faults(encoder, current, commanded=True)
    assert len(found) == windows * seen
    if found:
        assert (
            f"stays at {end:.6g} A, its largest or smallest value, in {windows * 0.02:.3g} s"
            in (found[0].text)
        )
        for number, fault in enumerate(found):
            assert (fault.start, fault.end) == pytest.approx(
                (number + 0.2, number + 0.22), abs=1e-9
            )
            assert fault.no_value
            assert bool(fault.text) == (number == 0)


@pytest.mark.parametrize(("ends", "inner", "seen"), [(5, 1, True), (9, 2, False), (10, 2, True)])
def test_an_end_counts_that_is_five_times_as_frequent_as_any_other_value(ends, inner, seen):
    encoder = np.floor(200 * TIME)
    current = 0.3 * np.sin(2 * np.pi * 0.7 * TIME) + NOISE
    end = current.min() - 1e-3
    for number in range(ends):
        current[600 * number + 200 : 600 * number + 220] = end
    for number in range(inner):
        current[600 * number + 500 : 600 * number + 520] = 0.1
    assert bool(faults(encoder, current)) == seen


@BOTH
def test_a_step_of_a_hundredth_of_the_range_is_that_of_a_current_of_steps(beyond):
    """An end whose next value is further away is a step of the current, which stays as well."""
    encoder = np.floor(200 * TIME)
    inner = 0.4 * np.sin(2 * np.pi * 0.7 * TIME)
    step = (0.0115 if beyond else 0.0085) * (inner.max() - inner.min())
    current = inner.copy()
    for number in range(7):
        current[1000 * number + 200 : 1000 * number + 220] = inner.max() + step
    assert bool(faults(encoder, current)) == (not beyond)


def test_a_fault_has_no_value_a_second_about_it():
    fault = SignalFault(3.0, 5.0, "", True)
    time = np.array([1.99, 2.01, 2.99, 3.01, 5.99, 6.01])
    assert fault.within(time, causal=False).tolist() == [False, *[True] * 4, False]
    assert fault.within(time, causal=True).tolist() == [False, False, False, True, True, False]
    assert not SignalFault(3.0, 5.0, "", False).within(time, causal=False).any()


def test_faults_come_in_order_of_time():
    encoder, current, _ = moving_under(0.3, 1.2, 300)
    found = faults(encoder + 500 * (TIME > 7), current)
    assert len(found) == 2
    assert found[0].start < found[1].start
    assert "leaps" in found[1].text


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize(("gap", "seen"), [(1e-3, True), (0.15, False)])
def test_the_step_that_counts_is_that_from_the_end_to_the_next_value(side, gap, seen):
    """Whatever lies behind that one: here a single sample, far from all others."""
    encoder = np.floor(200 * TIME)
    current = 0.3 * np.sin(2 * np.pi * 0.7 * TIME) + NOISE
    alone = current.max() + 0.151 - gap
    end = alone + gap
    current[610] = alone
    for number in range(7):
        current[1000 * number + 200 : 1000 * number + 220] = end
    assert bool(faults(encoder, side * current)) == seen
