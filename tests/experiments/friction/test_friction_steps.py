"""Holds, sweeps, breakaway and currents, step by step against what the texts state."""

import math
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.signal import lfilter
from scipy.stats import chi2
from scipy.stats import t as student

from rigtool.errors import InsufficientDataError
from rigtool.experiments.friction import procedure, procedure_analysis
from rigtool.experiments.friction.breakaway import (
    BREAKAWAY_TIME,
    Breakaway,
    TorqueRamp,
    _onset,
    around_turn,
    find_ramps,
)
from rigtool.experiments.friction.holds import (
    MIN_KEPT,
    Holds,
    _shaking,
    _steady_stretches,
    _uncertainty,
    _uneven,
    find_holds,
    pool,
)
from rigtool.experiments.friction.low_current import (
    deviation_at_low_current,
    require_calibrated_gain,
)
from rigtool.experiments.friction.procedure_analysis import (
    _fit_sweep,
    _note_lacking,
    fit_holds,
    separate,
)
from rigtool.experiments.friction.results import Findings, Scale
from rigtool.experiments.friction.stribeck_fit import fit_directions
from rigtool.experiments.friction.sweep import SPEED_BINS, torque_speed_curve
from rigtool.quantity import Quantity
from rigtool.recipe import load_recipe
from tests.experiments.virtual_runs import RECIPE

# -- holds


def staircase(*levels, sample=1e-2):
    """Return time and set point of (speed rad/s, samples) one after the other."""
    speed = np.repeat([s for s, _ in levels], [n for _, n in levels])
    return sample * np.arange(len(speed) + 1), np.append(0.0, np.cumsum(speed) * sample)


def test_stretches_are_those_of_one_speed_that_is_not_standstill():
    time, wanted = staircase((5.0, 40), (10.0, 30), (0.0, 25), (-2.0, 20), (0.005, 30), (0.02, 50))
    found = _steady_stretches(time, wanted)
    edges = np.cumsum([0, 40, 30, 25, 20, 30, 50])
    long = [(a, b) for a, b in found if b - a > 3]
    # a thousandth of the highest speed, and less, is standstill
    assert long == [(int(edges[n]), int(edges[n + 1]) + 1) for n in (0, 1, 3, 5)]


def test_a_change_of_a_thousandth_of_the_highest_speed_a_second_is_steady():
    time = 1e-2 * np.arange(401)
    for rate, steady in ((0.9e-3, True), (1.1e-3, False)):
        wanted = 10 * time + 0.5 * 10 * rate * time**2
        whole = [b - a for a, b in _steady_stretches(time, wanted) if b - a > 100]
        assert bool(whole) == steady


def test_a_gap_in_time_ends_a_stretch():
    time, _ = staircase((4.0, 100))
    for gap, parts in ((0.4e-2, 1), (0.6e-2, 2)):  # half of a sample more
        late = time + np.where(np.arange(101) >= 50, gap, 0.0)
        found = [b - a for a, b in _steady_stretches(late, 4.0 * late) if b - a > 20]
        assert len(found) == parts
    assert _steady_stretches(time, 0 * time) == []


@pytest.mark.parametrize(("kept", "found"), [(MIN_KEPT - 1, False), (MIN_KEPT, True)])
def test_eight_samples_are_the_fewest_that_may_be_left(kept, found):
    """Of 16 samples half are settling, and a whole turn leaves some of the other half."""
    time = np.arange(16.0)
    wanted = 2 * np.pi / (kept - 1) * time
    angle = wanted - np.where(time < 8, 1.0, 0.0)
    signals = {"time": time, "angle": angle, "torque": 1 + 0 * time, "inertia": 1e-5}
    if not found:
        with pytest.raises(InsufficientDataError, match="leaves 8 samples"):
            find_holds(**signals, setpoint=wanted)
        return
    hold = find_holds(**signals, setpoint=wanted)
    assert (hold.revolutions[0], hold.settled[0]) == (1, 8.0)


def test_whole_turns_are_taken_from_the_end():
    """Speed and mean torque are those of the last whole turns; ripple is none of them."""
    time = np.linspace(0, 10, 5001)
    angle = -2 * np.pi * 3.4 * time / 10
    torque = 2e-3 + 1e-3 * np.cos(angle) + np.where(angle > -0.38 * 2 * np.pi, 1.0, 0.0)
    hold = find_holds(time=time, angle=angle, torque=torque, setpoint=angle, inertia=1e-5)
    assert hold.revolutions[0] == 3
    assert hold.speed[0] == pytest.approx(-2 * np.pi * 0.34)
    assert hold.torque[0] == pytest.approx(2e-3, rel=2e-3)
    assert hold.settled[0] == 0


def test_without_a_set_point_the_later_of_both_warm_ups_counts():
    rng = np.random.default_rng(0)
    time = 1e-2 * np.arange(2000)
    for speed_up, torque_up in ((300, 0), (0, 500)):
        rate = np.where(np.arange(2000) < speed_up, 3.0, 1.0) + 1e-3 * rng.standard_normal(2000)
        torque = np.where(np.arange(2000) < torque_up, 3.0, 1.0) + 1e-2 * rng.standard_normal(2000)
        angle = np.cumsum(rate) * 1e-2
        hold = find_holds(time=time, angle=angle, torque=torque, setpoint=None, inertia=1e-5)
        assert hold.settled[0] == pytest.approx(max(speed_up, torque_up) * 1e-2, abs=0.11)


@pytest.mark.parametrize(("ratio", "steady"), [(0.245, True), (0.255, False)])
def test_a_shaft_that_fast_torque_shakes_is_not_steady(ratio, steady):
    """Torque of 60 Hz on the inertia makes a speed of T / (2 pi f J sqrt 2) rms."""
    sample, inertia, hertz, speed = 1e-3, 1e-5, 60.0, 5.0
    time = sample * np.arange(8000)
    swing = ratio * speed * np.sqrt(2) * 2 * np.pi * hertz * inertia
    torque = 2e-3 + swing * np.cos(2 * np.pi * hertz * time)
    found = _shaking(torque, sample, inertia)
    assert found == pytest.approx(ratio * speed, rel=0.02)
    hold = find_holds(time=time, angle=speed * time, torque=torque, setpoint=None, inertia=inertia)
    assert hold.shaking[0] == pytest.approx(found / speed, rel=0.05)
    assert bool(hold.steady[0]) == (hold.shaking[0] <= 0.25)
    own = Holds(*np.array([[speed], [1.0], [0.1], [5.0], [3.0], [ratio], [0.0], [0.0], [0.0]]))
    assert own.steady.tolist() == [steady]
    uneven = Holds(*np.array([[speed], [1.0], [0.1], [5], [3], [0.0], [0], [0], [ratio * 0.48]]))
    assert uneven.steady.tolist() == [steady]


def test_samples_that_are_far_apart_show_no_shaking():
    rng = np.random.default_rng(1)
    assert _shaking(rng.standard_normal(400), 5.2e-3, 1e-5) > 0
    assert _shaking(rng.standard_normal(400), 5.3e-3, 1e-5) == 0  # 9.4 samples of 50 ms


def test_unevenness_is_that_of_the_way_in_three_counts_or_five_milliseconds():
    rng = np.random.default_rng(2)
    for step, sample, count in ((0.2, 1e-3, 0.5), (2.0, 1e-3, 0.5), (0.01, 1e-2, 1e-9)):
        angle = np.cumsum(step * (1 + 0.3 * rng.standard_normal(4000)))
        width = math.ceil(max(3 * count, 5e-3 / sample * step) / step)
        moved = [angle[k + width] - angle[k] for k in range(4000 - width)]
        square = max(np.var(moved) - count**2 / 4, 0)
        assert _uneven(angle, step, sample, count) == pytest.approx(
            math.sqrt(square) / (step * width)
        )
        assert _uneven(-angle, -step, sample, count) == _uneven(angle, step, sample, count)


@pytest.mark.parametrize("revolutions", [1, 3])
def test_the_uncertainty_of_a_mean_is_that_of_the_likelihood_over_corners(revolutions):
    """The text of the module, corner by corner."""
    rng = np.random.default_rng(3)
    torque = np.cumsum(rng.standard_normal(300)) * 0.05 + rng.standard_normal(300)
    n = len(torque)
    spectrum = [
        abs(np.sum((torque - torque.mean()) * np.exp(-2j * np.pi * k * np.arange(n) / n))) ** 2 / n
        for k in range(n // 2 + 1)
    ]
    lowest = [k for k in range(1, n // 2 + 1) if revolutions < 2 or k % revolutions][:24]
    corners = [*np.geomspace(0.5, 200.0, 24), 1e9]
    logs, values = [], []
    for corner in corners:
        shape = [1 / (1 + (k / corner) ** 2) for k in lowest]
        level = np.mean([spectrum[k] / s for k, s in zip(lowest, shape, strict=True)])
        logs.append(-sum(math.log(level * s) for s in shape))
        cycles = 2 * math.pi * corner
        values.append(math.log(level / n * (1 - (1 - math.exp(-cycles)) / cycles)))
    weight = np.exp(np.array(logs) - max(logs))
    weight /= weight.sum()
    mean = weight @ values
    spread = weight @ (np.array(values) - mean) ** 2 + 1 / len(lowest)
    u, dof = _uncertainty(torque, revolutions)
    assert u == pytest.approx(math.exp(mean / 2), rel=1e-9)
    assert dof == pytest.approx(2 / spread, rel=1e-9)


def test_pooled_holds_are_one_behind_the_other():
    parts = [Holds(*(np.arange(9.0 * k, 9.0 * k + 9)[:, None] + [[0, 0.5]])) for k in range(2)]
    whole = pool(parts)
    for name in Holds.__dataclass_fields__:
        assert_allclose(
            getattr(whole, name), np.concatenate([getattr(part, name) for part in parts])
        )


def holds(speed, torque=None, u=1e-5, shaking=0.0, uneven=0.0):
    speed = np.asarray(speed, dtype=float)
    if torque is None:
        torque = np.sign(speed) * (2e-3 + 5e-5 * np.abs(speed))
    one = np.ones(len(speed))
    columns = (
        speed,
        torque,
        u * one,
        20 * one,
        3 * one,
        shaking * one,
        0 * one,
        0 * one,
        uneven * one,
    )
    return Holds(*columns)


SPEEDS = np.array([1.0, 2.0, 5.0, 10.0, 20.0, 30.0])


def test_holds_that_shake_are_left_out_by_what_shakes_them():
    """The encoder's steps, where they make most of the variance; friction and ripple elsewhere."""
    whole = holds(
        SPEEDS, shaking=np.array([0.3, 0.3, 0.24, 0, 0, 0]), uneven=np.array([0, 0, 0, 0.2, 0, 0])
    )
    steps = np.array([0.3 / math.sqrt(2) * 1.02, 0.3 / math.sqrt(2) * 0.98, 0.3, 0, 0, 0])
    fits, left, notes = fit_holds([whole], steps)
    assert left.speed.tolist() == [5.0, 20.0, 30.0]
    assert set(fits) == {1}
    starts = {"2": "starts and stops", "1": "encoder's steps", "10": "ripple or friction"}
    assert len(notes) == 3
    for note in notes:
        speed = note.split("left out at ")[1].split(" rad/s")[0]
        assert starts[speed] in note
        assert f"more than {12 if speed == '10' else 25} %" in note
    _, _, plain = fit_holds([whole])  # without an encoder that is known, it is the shaft
    assert sorted("starts and stops" in note for note in plain) == [False, True]
    with pytest.raises(InsufficientDataError, match=r"left out at 1.*do not separate"):
        fit_holds([whole[np.array([0, 2, 4])]])


@pytest.mark.parametrize(
    ("current", "state"), [(0.9e-4, "none"), (1e-3, "note"), (6e-3, "refused")]
)
def test_current_between_set_points_is_noted_or_refused_by_its_part(current, state):
    """0.05 N m/A: 0.0045, 0.05 and 0.3 mN m of 2.6 mN m of friction."""
    found = Findings(Scale(Quantity(0.05, "N m/A", 0.0)))
    sizes = {1.0: 0.1, 2.0: 0.2, 5.0: -1.0, 10.0: 0.5, 20.0: 0.1, 30.0: 0.0}
    lacking = SimpleNamespace(
        at=lambda speed: current * sizes[float(speed)],
        line=lambda constant: (constant, 2 * constant),
    )
    own = holds(-SPEEDS)
    if state == "refused":
        with pytest.raises(InsufficientDataError, match=r"at 5 rad/s by -0.3 mN m.*10 %"):
            _note_lacking(lacking, own, found)
        return
    _note_lacking(lacking, own, found)
    assert found.common["current between set points"] == (0.05, 0.1)
    assert len(found.notes) == (state == "note")
    if found.notes:
        assert "at 5 rad/s by -0.05 mN m" in found.notes[0]


def test_offset_is_separated_at_speeds_of_both_directions():
    """Half of the speeds of one direction, from the lowest that both fits take, within 1 %."""
    speed = np.concatenate([SPEEDS, -SPEEDS * 1.005])
    shift = 3e-4
    friction = 2e-3 + 5e-5 * np.abs(speed)
    torque = np.sign(speed) * friction + shift
    own = holds(speed, torque)
    fits = fit_directions(own.speed, own.torque, own.u)
    found = separate(fits, own, [])
    assert found.offset[0] == pytest.approx(shift, rel=0.05)
    assert separate({1: fits[1]}, own, []) is None
    for others, enough in ((SPEEDS[:3], True), (SPEEDS[:2], False)):
        few = holds(np.concatenate([SPEEDS, -others, -SPEEDS[len(others) :] * 1.02]))
        both = fit_directions(few.speed, few.torque, few.u)
        assert (separate(both, few, []) is not None) == enough


# -- sweeps


def test_scatter_of_a_sweep_is_that_of_third_differences(monkeypatch):
    """A curve of second order has none; noise keeps its standard deviation."""
    rng, seen = np.random.default_rng(4), []
    monkeypatch.setattr(procedure_analysis, "fit_directions", lambda *given: seen.append(given))
    speed = np.linspace(1, 30, 400_000)
    torque = 2e-3 + 5e-5 * speed + 1e-4 * speed**2 + 3e-5 * rng.standard_normal(400_000)
    whole = SimpleNamespace(speed=speed, torque=torque, revolutions=np.ones(400_000))
    _fit_sweep(whole)
    assert_allclose(seen[0][2], 3e-5, rtol=0.01)
    few = SimpleNamespace(
        speed=speed[:6], torque=torque[:6], revolutions=np.array([1, 1, 1, 1, 1, 0])
    )
    with pytest.raises(InsufficientDataError, match="at 5 speeds, 6 are needed"):
        _fit_sweep(few)
    few.revolutions[-1] = 1
    _fit_sweep(few)
    assert len(seen[1][0]) == 6


def swept(top=30.0, seconds=60.0, sample=2e-3, back=False):
    time = np.arange(0, seconds, sample)
    phase = time / seconds
    speed = top * (1 - np.abs(2 * phase - 1)) if back else top * phase
    return time, np.cumsum(speed) * sample, speed


@pytest.mark.parametrize("back", [False, True])
def test_a_bin_of_a_sweep_is_the_mean_of_its_whole_turns(back):
    """Torque less that of the inertia; ripple of the turn is none of it."""
    inertia, rng = 3e-5, np.random.default_rng(5)
    time, angle, speed = swept(back=back)
    per_turn = 1e-4 * rng.standard_normal(int(angle[-1] / (2 * np.pi)) + 2)
    acceleration = np.gradient(np.gradient(angle, time), time)
    torque = 2e-3 + 5e-5 * speed + inertia * acceleration + 1e-3 * np.cos(angle)
    torque += per_turn[(angle / (2 * np.pi)).astype(int)]
    found = torque_speed_curve(time=time, setpoint=angle, torque=torque, inertia=inertia)
    assert len(found.speed) == SPEED_BINS
    width = np.ptp(speed) / SPEED_BINS
    assert_allclose(np.diff(found.speed[5:]), width, rtol=0.1)
    turning = found.revolutions >= 2
    assert turning.sum() > 30
    # turns of a pass through a bin: its time times its mean speed, and what is whole of it
    passes = 2 if back else 1
    turns = found.speed * (60.0 / SPEED_BINS / passes) / (2 * np.pi)
    assert np.all(found.revolutions[10:-2] <= passes * (turns[10:-2] + 0.1))
    assert np.all(found.revolutions[10:-2] >= passes * (turns[10:-2] - 1.1))
    off = (found.torque - 2e-3 - 5e-5 * found.speed)[turning]
    assert np.abs(off).max() < 5e-4
    # two turns of one pass show noise beside ripple
    assert np.isfinite(found.u[found.revolutions >= 3 * passes - 1]).all()
    assert np.isnan(found.u[found.revolutions < 2 * passes - 1]).all()


@pytest.mark.parametrize("back", [False, True])
@pytest.mark.parametrize("corner_time", [0.0, 0.15])
def test_u_of_a_sweep_is_the_scatter_of_repeats(back, corner_time):
    """Neighbouring turns share noise that varies in 0.15 s; slope, ripple and the loop's faster
    noise are none of it."""
    rng, sample = np.random.default_rng(6), 2e-3
    time, angle, speed = swept(seconds=120.0 if back else 60.0, sample=sample, back=back)
    kept = math.exp(-sample / corner_time) if corner_time else 0.0
    found = []
    for _ in range(30):
        white = math.sqrt(1 - kept**2) * 1e-4 * rng.standard_normal(len(time))
        ripple = 1e-3 * np.cos(angle + rng.uniform(0, 2 * np.pi))
        loop = 1e-4 * rng.standard_normal(len(time)) * (corner_time > 0)
        torque = 2e-3 + 5e-5 * speed + ripple + loop + lfilter([1.0], [1.0, -kept], white)
        curve = torque_speed_curve(time=time, setpoint=angle, torque=torque, inertia=0.0)
        found.append((curve.torque - 5e-5 * curve.speed, curve.u, curve.dof))
    level, u, dof = np.moveaxis(np.array(found)[..., 30:], 1, 0)
    scatter = level.std(axis=0, ddof=1) / np.sqrt(np.mean(u**2, axis=0))
    assert_allclose(np.sqrt(np.mean(scatter**2)), 1.0, atol=0.15)
    inside = np.abs(level - level.mean(axis=0)) <= u * student.ppf(0.975, dof)
    assert 0.92 < np.mean(inside) < 0.98


# -- breakaway


def a_ramp(direction=1.0, position=0.3, samples=400, slip=0.8, end=1e-2):
    """Torque rises evenly; the shaft runs off behind a part of it."""
    time = np.linspace(0, 10, samples)
    angle = position + direction * 5.0 * np.maximum(time - 10 * slip, 0) ** 2
    return {"time": time, "angle": angle, "torque": direction * end * time / 10}


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_ramps_end_where_torque_falls_or_time_has_a_gap(direction):
    one, parts, clock = a_ramp(direction), [], 0.0
    for wait in (0.0, 0.2, 0.3):  # samples are 25 ms apart: a gap is more than ten of them
        clock += wait
        parts.append({**one, "time": one["time"] + clock})
        clock = parts[-1]["time"][-1]
    parts[1]["torque"] = parts[1]["torque"][-1] * np.ones(400)  # goes on at the highest torque
    whole = {name: np.concatenate([part[name] for part in parts]) for name in one}
    found = find_ramps(**whole, threshold=0.02)
    assert [(ramp.begin, ramp.end) for ramp in found] == [(0, 800), (800, 1200)]
    assert all(ramp.direction == direction for ramp in found)
    assert [ramp.position for ramp in found] == pytest.approx([0.3, 0.3])
    assert found[1].torque == pytest.approx(8e-3, rel=0.01)


@pytest.mark.parametrize(("drop", "parts"), [(0.018, 1), (0.022, 2)])
def test_a_fall_of_two_hundredths_of_the_highest_torque_ends_a_ramp(drop, parts):
    one = a_ramp()
    one["torque"][200:] -= drop * 1e-2 + 1e-2 / 399
    assert len(find_ramps(**one, threshold=0.02)) == parts


@pytest.mark.parametrize(("end", "count"), [(0.9e-3, 1), (1.2e-3, 2)])
def test_a_torque_of_a_tenth_of_the_highest_is_no_ramp(end, count):
    whole = {n: np.append(a_ramp()[n], (a_ramp(end=end)[n] + 20 * (n == "time"))) for n in a_ramp()}
    assert len(find_ramps(**whole, threshold=0.02)) == count


@given(st.floats(0.01, 0.3), st.floats(0.5, 0.95))
def test_the_onset_is_where_the_motion_begins_as_a_straight_line(threshold, begins):
    """A shaft that runs off at an even speed from a time on broke away then; creep before it, back
    or on, does not move that."""
    time = np.linspace(0, 1, 4001)
    angle = np.where(time < 0.1, -0.2 * time, -0.02) + np.maximum(time - begins, 0) * 40.0
    found = _onset(time, angle, threshold)
    if threshold / 40.0 > BREAKAWAY_TIME * begins:
        return
    assert found == pytest.approx(begins, abs=1e-3)


def test_a_recording_that_ends_in_the_motion_goes_on_as_it_went():
    time = np.linspace(0, 1, 4001)
    angle = np.maximum(time - 0.8, 0) * 0.3  # ends at 0.06 rad; the double of 0.04 is beyond
    assert _onset(time, angle, 0.04) is None  # as slow as the ramp
    angle = np.maximum(time - 0.99, 0) * 6.0
    assert _onset(time, angle, 0.04) == pytest.approx(0.99, abs=1e-3)


@pytest.mark.parametrize("fewer", [1.0, -1.0])
def test_positions_are_those_of_the_direction_with_more_ramps(fewer):
    places = 2 * np.pi * np.arange(8) / 8
    ramps = [
        TorqueRamp(0, 9, place, sign, 4e-3 + 1e-3 * sign)
        for sign in (1.0, -1.0)
        for place in (places[:3] + 0.05 if sign == fewer else places)
    ]
    found = around_turn(ramps)
    assert_allclose(found.position, places, atol=1e-9)
    missing = found.positive if fewer > 0 else found.negative
    assert np.isfinite(missing).sum() == 3
    assert found.paired == 3
    assert found.stuck == 0
    assert (found.lowest, found.highest) == (3e-3, 5e-3)
    assert found.middle.value == pytest.approx(1e-3)
    assert found.level.value == pytest.approx(4e-3)


def test_scatter_is_pooled_over_directions_with_four_positions():
    rng = np.random.default_rng(6)
    places = 2 * np.pi * np.arange(12) / 12
    noise = {1.0: 1e-5 * rng.standard_normal(12), -1.0: 5e-5 * rng.standard_normal(12)}
    ramps = [
        TorqueRamp(0, 9, place, sign, 4e-3 + noise[sign][k])
        for sign in (1.0, -1.0)
        for k, place in enumerate(places)
    ]
    found = around_turn(ramps)
    own = [around_turn([r for r in ramps if r.direction == sign]) for sign in (1.0, -1.0)]
    assert found.dof == own[0].dof + own[1].dof
    square = sum(one.scatter**2 * one.dof for one in own) / found.dof
    assert found.scatter == pytest.approx(math.sqrt(square))
    few = around_turn([r for r in ramps if r.direction > 0 or r.position < 1.2])
    assert few.dof == own[0].dof
    assert few.scatter == pytest.approx(own[0].scatter)
    three = around_turn([r for r in ramps if r.position < 1.2])
    assert three.dof == 0
    assert math.isnan(three.scatter)


@pytest.mark.parametrize(("stuck", "refused"), [(3, False), (4, True)])
def test_half_of_the_ramps_must_break_away(stuck, refused):
    ramps = [TorqueRamp(0, 9, k, 1.0, math.nan if k < stuck else 4e-3) for k in range(8)]
    if refused:
        with pytest.raises(InsufficientDataError, match="in 4 of 8 ramps"):
            around_turn(ramps, np.arange(6.0))
        return
    found = around_turn(ramps, np.arange(6.0))
    assert isinstance(found, Breakaway)
    assert found.stuck == 3


# -- the amplifier at low current


@pytest.mark.parametrize(("times", "passes"), [(0.997, True), (1.003, False)])
@pytest.mark.parametrize("by", ["scatter", "calibration", "bend", "allowed"])
def test_a_gain_differs_by_four_uncertainties_and_what_is_allowed(times, passes, by):
    """Means of 64 parts: the slope and its standard uncertainty by least squares."""
    rng = np.random.default_rng(7)
    asked = np.repeat(0.05 * rng.standard_normal(64), 10)
    scatter = np.repeat(rng.standard_normal(64), 10) * (1e-4 if by == "scatter" else 0.0)
    means = asked.reshape(64, 10)[:, 0]
    design = np.column_stack([np.ones(64), means])
    line, left = np.linalg.lstsq(design, scatter.reshape(64, 10)[:, 0], rcond=None)[:2]
    square = (left[0] if len(left) else 0.0) / 62 * np.linalg.inv(design.T @ design)[1, 1]
    limits = {
        "scatter": 4 * math.sqrt(square),
        "calibration": 4 * 2e-3,
        "bend": 4 * 1e-4 / means.std(),
        "allowed": 0.01 * 1.2,
    }
    gain = 1.2 + times * limits[by] - line[1]
    known = Quantity(1.2, "1", 2e-3 if by == "calibration" else 0.0)
    signals = {
        "current_setpoint": asked,
        "current": 1e-3 + gain * asked + scatter,
        "calibrated": known,
        "deviation": 1e-4 if by == "bend" else 0.0,
        "allowed": 0.01 if by == "allowed" else 0.0,
    }
    if passes:
        require_calibrated_gain(**signals)
        return
    with pytest.raises(InsufficientDataError, match="not the one that was calibrated"):
        require_calibrated_gain(**signals)


def test_stretches_of_parts_do_not_overlap():
    time, wanted = staircase((5.0, 40), (10.0, 30), (3.0, 25))
    found = _steady_stretches(time, wanted)
    assert all(a[1] <= b[0] + 1 for a, b in pairwise(found))


def test_two_samples_in_a_range_of_speed_are_the_fewest():
    """A sweep whose speed passes each of 60 ranges in two samples, or in one."""
    for per_range, count in ((2, SPEED_BINS), (3, SPEED_BINS)):
        size = per_range * SPEED_BINS
        speed = np.linspace(1.0, 2.0, size)
        time = 1e-3 * np.arange(size)
        angle = np.concatenate([[0], np.cumsum((speed[1:] + speed[:-1]) / 2) * 1e-3])
        found = torque_speed_curve(time=time, setpoint=angle, torque=5 * speed, inertia=0.0)
        assert len(found.speed) >= count - 5
        assert_allclose(found.torque, 5 * found.speed, rtol=0.02)


@pytest.mark.parametrize("noise", [1e-4, 1e-3])
@pytest.mark.parametrize("passes", [True, False])
def test_deviations_beyond_noise_are_a_25th_of_the_current_that_friction_takes(noise, passes):
    """Least squares through means; the chi-square of scipy that noise leaves in one of 100."""
    rng, bins, size = np.random.default_rng(8), 20, 60
    level = np.repeat(np.linspace(0.04, 0.06, bins), size)
    scatter = noise * np.tile(rng.permutation(np.linspace(-1, 1, size)), bins)
    current = 2e-3 + 1.1 * level + scatter + 2e-3 * np.repeat(rng.standard_normal(bins), size)
    ones = np.ones_like(level)
    design = np.column_stack([ones, level])
    line = design @ np.linalg.lstsq(design, current, rcond=None)[0]
    off = (current - line).reshape(bins, size).mean(axis=1)
    by_noise = np.mean((current - line) ** 2) * chi2.isf(0.01, bins - 2)
    rms = math.sqrt((size * off @ off - by_noise) / (bins * size))
    # few samples at one higher set point, which is no part of the range
    signals = {
        "current_setpoint": np.append(level, np.full(9, 0.07)),
        "current": np.append(current, np.full(9, 9.0)),
        "sample_time": 0.02,
    }
    friction = rms / 0.04 * (1.001 if passes else 0.999)
    if passes:
        found = deviation_at_low_current(**signals, friction_current=friction)
        assert found == pytest.approx(rms, rel=1e-6)
        return
    with pytest.raises(InsufficientDataError, match="not linear at low current"):
        deviation_at_low_current(**signals, friction_current=friction)


def test_a_profile_changes_speed_at_one_rate_and_holds_whole_turns():
    settings = load_recipe(RECIPE, ())[0].stribeck
    holds = [(5.0, 3), (20.0, 2), (-20.0, 2)]
    found = procedure._profile(settings, holds)
    times, speeds = np.array(found.times), np.array(found.speeds)
    rate = settings.speed_max / procedure.RUN_UP
    lasting = [procedure.SETTLE_TIME + n * 2 * np.pi / abs(v) for v, n in holds]
    assert_allclose(speeds, [0, 5, 5, 20, 20, -20, -20, 0])
    assert_allclose(np.diff(times)[1::2], lasting)
    assert_allclose(np.diff(times)[::2], np.array([5, 15, 40, 20]) / rate)
