"""Breakaway from slow ramps: a shaft on Dahl contacts, simulated from rest until it runs off."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from rigtool.errors import InsufficientDataError
from rigtool.experiments.friction.breakaway import around_turn, find_ramps
from rigtool.experiments.friction.results import (
    Findings,
    Scale,
    add_breakaway,
    add_static_friction,
)
from rigtool.quantity import Quantity

COUNT = 2 * np.pi / 4000


@dataclass(frozen=True)
class Shaft:
    """Rotor on bristle contacts under a slow ramp of torque; cogging helps or hinders."""

    static: float = 4e-3
    cogging: float = 1e-3  # second order
    presliding_angle: float = 1.5e-3
    inertia: float = 1.5e-5
    rate: float = 1e-3  # N m/s
    limit: float = 12e-3
    stop: float = 0.09
    sample_time: float = 1e-3

    def ramp(self, position: float, direction: float) -> dict[str, np.ndarray]:
        """Return the signals of one ramp; 8 steps of the simulation a sample."""
        dt, angle, speed, z = self.sample_time / 8, position, 0.0, 0.0
        rows = []
        for k in range(round(self.limit / self.rate / dt)):
            drive = direction * self.rate * k * dt
            z = (z + speed * dt / self.presliding_angle) / (
                1 + abs(speed) * dt / self.presliding_angle
            )
            # damping of the bristles keeps pre-sliding from ringing
            friction = self.static * (z + 0.02 * speed / self.presliding_angle * (1 - abs(z)))
            torque = drive + self.cogging * np.cos(2 * position) - friction
            speed += dt * torque / self.inertia
            angle += dt * speed
            if k % 8 == 7:
                rows.append((k * dt, np.floor(angle / COUNT) * COUNT, drive))
            if abs(angle - position) > self.stop:
                break
        time, place, torque = np.array(rows).T
        return {"time": time, "angle": place, "torque": torque}

    def series(self, count: int = 8) -> dict[str, np.ndarray]:
        """Return ramps at equally spaced positions in both directions, behind each other."""
        parts, clock = [], 0.0
        for direction in (1.0, -1.0):
            for k in range(count):
                part = self.ramp(2 * np.pi * k / count + 0.01, direction)
                part["time"] = part["time"] + clock
                clock = part["time"][-1] + 1.5
                parts.append(part)
        return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


@pytest.fixture(scope="module")
def signals():
    return Shaft().series()


def test_breakaway_around_the_turn(signals):
    found = around_turn(find_ramps(**signals, threshold=0.02))
    assert_allclose(found.position, 2 * np.pi * np.arange(8) / 8 + 0.01, atol=2e-3)
    help_ = 1e-3 * np.cos(2 * found.position)
    # 0.1 mN m: the ramp goes on for 0.1 s while the shaft gathers speed
    assert_allclose(found.positive, 4e-3 - help_, atol=0.12e-3)
    assert_allclose(found.negative, 4e-3 + help_, atol=0.12e-3)
    assert_allclose([found.lowest, found.highest], [3e-3, 5e-3], atol=0.12e-3)
    assert_allclose(found.level.value, 4e-3, atol=0.1e-3)
    # positions are not quite those of the cogging's extremes
    assert_allclose(found.middle.value, 0.0, atol=0.03e-3)


def test_threshold_within_presliding_is_doubled_until_the_shaft_runs_off():
    soft = Shaft(presliding_angle=0.01, cogging=0.0, stop=0.2)
    ramp = soft.ramp(0.0, 1.0)
    # the threshold is passed in pre-sliding already, far below the static friction
    passed = ramp["torque"][np.argmax(ramp["angle"] > 0.01)]
    assert passed < 0.7 * 4e-3
    (found,) = find_ramps(**ramp, threshold=0.01)
    assert_allclose(found.torque, 4e-3, rtol=0.08)


def test_a_shaft_that_does_not_move_has_no_breakaway_torque():
    (found,) = find_ramps(**Shaft(limit=3e-3, cogging=0.0).ramp(0.0, 1.0), threshold=0.02)
    assert np.isnan(found.torque)
    with pytest.raises(InsufficientDataError, match="breakaway_limit"):
        around_turn([found])


def test_positions_that_do_not_break_away_leave_no_mean(signals):
    """What is missing is what is largest: the mean of the others is too low."""
    ramps = find_ramps(**signals, threshold=0.02)
    worst = int(np.argmax([ramp.torque for ramp in ramps]))
    ramps[worst] = replace(ramps[worst], torque=np.nan)
    found = around_turn(ramps)
    assert found.stuck == 1
    assert np.isnan([found.level.u, found.middle.u]).all()
    results = Findings(Scale(Quantity(0.05, "N m/A", 0.0)))
    add_breakaway(found, results)
    add_static_friction(found, {}, None, results)
    assert set(results.results) == {"breakaway_torque_min"}


def test_a_shaft_that_creeps_on_has_no_breakaway_torque():
    """The ramp ends before the shaft's motion shows whether it slides."""
    time = np.arange(0, 4.0, 2e-3)
    creep = 0.09 * (time / 4) ** 3  # passes 0.08 rad late in the ramp, and slowly
    (found,) = find_ramps(time=time, angle=creep, torque=1e-3 * time, threshold=0.02)
    assert np.isnan(found.torque)
    run_off = creep + 50 * np.maximum(time - 3.93, 0) ** 2
    (found,) = find_ramps(time=time, angle=run_off, torque=1e-3 * time, threshold=0.1)
    assert_allclose(found.torque, 3.93e-3, rtol=0.01)


def test_radial_load_adds_at_each_position(signals):
    unloaded = around_turn(find_ramps(**signals, threshold=0.02))
    heavier = Shaft(static=5e-3).series()
    loaded = around_turn(find_ramps(**heavier, threshold=0.02), unloaded.position)
    assert_allclose(loaded.positive - unloaded.positive, 1e-3, atol=0.03e-3)
    assert_allclose(loaded.negative - unloaded.negative, 1e-3, atol=0.03e-3)


def test_ramps_of_other_positions_are_not_paired(signals):
    ramps = find_ramps(**signals, threshold=0.02)
    apart = around_turn(ramps[:1] + ramps[8:9], np.linspace(0.3, 5.9, 24))
    # ramps at 0.01 rad are further from all of these than half their spacing
    assert np.all(np.isnan(apart.positive))


def test_directions_that_broke_away_at_different_positions_have_no_mean(signals):
    ramps = find_ramps(**signals, threshold=0.02)
    apart = around_turn([*ramps[:4], *ramps[13:15]])
    assert apart.paired == 0
    for mean in (apart.level, apart.middle):
        assert np.isnan([mean.value, mean.u]).all()
        assert mean.dof == 0
    found = Findings(Scale(Quantity(0.05, "N m/A", 0.0)))
    add_static_friction(apart, {}, None, found)
    add_breakaway(apart, found)
    assert set(found.results) == {"breakaway_torque_min", "breakaway_torque_max"}
    assert any("broke away at 0 positions" in note for note in found.notes)


def test_ramps_of_few_samples_are_refused_by_their_number(signals):
    coarse = {name: values[::400] for name, values in signals.items()}
    with pytest.raises(InsufficientDataError, match=r"16 samples or more; the longest has 1[0-5]"):
        find_ramps(**coarse, threshold=0.02)


def test_repeated_ramps_are_averaged(signals):
    ramps = find_ramps(**signals, threshold=0.02)
    once, twice = around_turn(ramps), around_turn(ramps + ramps)
    assert_allclose(twice.positive, once.positive, rtol=1e-12)
    assert len(twice.position) == len(once.position)


def test_sixteen_samples_are_the_fewest():
    time = np.arange(16.0)
    ramp = {"time": time, "angle": 10 * np.maximum(time - 12, 0), "torque": 1e-3 * time}
    (found,) = find_ramps(**ramp, threshold=0.02)
    assert found.end == 16
    with pytest.raises(InsufficientDataError, match=r"16 samples or.* has 15.*breakaway_angle"):
        find_ramps(**{name: values[:15] for name, values in ramp.items()}, threshold=0.02)


@given(scale=st.floats(0.1, 50.0))
@settings(max_examples=10, deadline=None)
def test_torque_scales(scale):
    ramp = Shaft().ramp(1.0, -1.0)
    (one,) = find_ramps(**ramp, threshold=0.02)
    (other,) = find_ramps(**{**ramp, "torque": scale * ramp["torque"]}, threshold=0.02)
    assert_allclose(other.torque, scale * one.torque, rtol=1e-9)
    assert other.direction == -1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"torque": lambda x: 0 * x}, "no ramp"),
        ({"angle": lambda x: np.where(np.arange(len(x)) == 5, np.inf, x)}, "angle is inf"),
        ({"time": lambda x: x[:-3]}, "samples"),
    ],
)
def test_bad_signals_are_refused(signals, change, message):
    bad = {**signals, **{name: function(signals[name]) for name, function in change.items()}}
    with pytest.raises(InsufficientDataError, match=message):
        find_ramps(**bad, threshold=0.02)


@pytest.mark.parametrize("acceleration", [200.0, 2000.0])
def test_a_constant_torque_beyond_friction_is_named(acceleration):
    """It turns the shaft forwards whatever the ramp, the faster for fewer than 16 samples."""
    time = np.arange(round(np.sqrt(0.18 / acceleration) / 1e-3) + 1) * 1e-3
    angle, torque = acceleration * time**2 / 2, 1e-3 * (time + 1e-3)
    parts = [(time + 10 * number, angle, (-1) ** number * torque) for number in range(6)]
    names = ("time", "angle", "torque")
    columns = map(np.concatenate, zip(*parts, strict=True))
    signals = dict(zip(names, columns, strict=True))
    ramps = find_ramps(**signals, threshold=0.02)
    assert sum(ramp.against for ramp in ramps) == 3
    with pytest.raises(InsufficientDataError, match="turned the shaft against 3 of"):
        around_turn(ramps)


def test_a_shaft_that_springs_back_is_not_turned_by_a_constant_torque():
    time = np.linspace(0.0, 10.0, 1001)
    angle = np.where(time < 1, -0.03 * time, -0.03) + np.where(time > 6, time - 6, 0.0)
    (ramp,) = find_ramps(time=time, angle=angle, torque=1e-3 * time, threshold=0.02)
    assert not ramp.against
    assert ramp.torque == pytest.approx(6e-3, rel=0.01)
