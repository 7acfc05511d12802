"""The winding's time constant by the housing's temperature."""

from dataclasses import replace

import numpy as np
import pytest

from rigtool.experiments.torque_constant.staircases.fit import fit_staircases
from rigtool.experiments.torque_constant.staircases.model import arrange
from rigtool.experiments.torque_constant.staircases.plateaus import plateaus_of_set_point
from rigtool.experiments.torque_constant.staircases.winding_time import (
    LONGEST_TIME_CONSTANT,
    SHORTEST_TIME_CONSTANT,
    TRIED,
    WindingTime,
    _behind,
    _flown,
    winding_time,
    with_torque,
)
from rigtool.experiments.torque_constant.temperature_fit import calibrate
from tests.experiments.torque_constant.bench import Bench

SHARE = 0.1

LONGER = {"step_time": 0.8, "settle_time": 0.1, "sample_time": 8e-3}

SHORTER = LONGER | {"step_time": 0.3, "sample_time": 4e-3}

COOLING = LONGER | {"friction": 0.05e-3, "force_noise": 2e-4, "heating": 0.0}


def plateaus(bench, **changed):
    signals = bench.record((20, 35, 50), angles=6) | changed
    return plateaus_of_set_point(**signals, arm_length=0.54, settle_time=bench.settle_time)


def mean_and_u(found):
    """Return mean and standard deviation of the logarithm of tau."""
    probable = found.likelihood / found.likelihood.sum()
    mean = probable @ found.logarithm
    return mean, np.sqrt(probable @ (found.logarithm - mean) ** 2)


@pytest.mark.parametrize("time_constant", [6.0, 20.0, 45.0])
@pytest.mark.parametrize("lag", [0.0, 6.0])
def test_the_housing_shows_how_long_the_winding_keeps_its_heat(time_constant, lag):
    bench = Bench(time_constant=time_constant, housing_share=SHARE, sensor_lag=lag, **LONGER)
    found = winding_time(arrange(plateaus(bench)))
    mean, u = mean_and_u(found)
    # the winding follows the housing by its share of the heat capacity, or less where that drifts
    low, high = np.log(time_constant / (1 + SHARE)), np.log(time_constant)
    assert low - 2.5 * u < mean < high + 2.5 * u
    assert u < (0.8 if lag == 0 else 1.3)
    assert found.low < np.log(time_constant) < found.high


@pytest.mark.parametrize("share", [0.0, -SHARE])
def test_a_housing_that_does_not_warm_says_little(share):
    """A cooling body takes all heat; one that is cooled more by a fan says no more."""
    bench = Bench(time_constant=29.0, housing_share=share, **LONGER)
    found = winding_time(arrange(plateaus(bench)))
    assert found.low < np.log(10.0)
    assert found.high > np.log(80.0)


def test_a_temperature_that_was_not_recorded_says_nothing():
    bench = Bench(housing_share=SHARE, **LONGER)
    count = len(bench.record((20, 35, 50), angles=6)["time"])
    found = winding_time(arrange(plateaus(bench, temperature=np.full(count, 20.0))))
    np.testing.assert_allclose(found.likelihood, 1.0, rtol=1e-6)
    assert found.low == pytest.approx(np.log(SHORTEST_TIME_CONSTANT))
    assert found.high == pytest.approx(np.log(LONGEST_TIME_CONSTANT))


def test_a_winding_that_cools_shows_how_late_it_does():
    """Of 1 A, the housing gets less heat than from the winding that follows it to the room."""
    tau, share, to_room, room, step = 20.0, 0.12, 300.0, 27.0, 8e-3
    bench = Bench(time_constant=tau, **LONGER)
    up = np.linspace(0, 1, 11)
    signals = bench.record((20, 35, 50), 6, np.concatenate([up, up[-2::-1], up[1:], up[-2::-1]]))
    noise = 5e-3 * np.random.default_rng(0).standard_normal(len(signals["time"]))
    housing, winding = 0.0, 0.0
    for j, begins in enumerate(np.diff(signals["time"], prepend=-1e3) > 1.0):
        if begins:
            housing = winding = float(np.round(signals["temperature"][j]))
        signals["temperature"][j] = housing + noise[j]
        flow = (winding - housing) / tau
        winding += step * (0.02 * signals["current"][j] ** 2 - flow)
        housing += step * (share * flow - (housing - room) / to_room)
    mean, u = mean_and_u(winding_time(arrange(plateaus(bench, **signals))))
    assert abs(mean - np.log(tau)) < 2.5 * u
    assert u < 0.3


def test_torque_that_follows_the_winding_shows_how_late_it_does():
    """At 50 degC the motor cools, at 20 degC it warms."""
    benches = [
        Bench(ripple=(), saturation=0.0, time_constant=tau, housing_drift=drift, **COOLING)
        for tau in (12.0, 40.0)
        for drift in (0.02, -0.07)
    ]
    for cold, hot in (benches[:2], benches[2:]):
        one, other = cold.record((20,), 6), hot.record((50,), 6, seed=1)
        other["time"] = other["time"] + one["time"][-1] + 600.0
        signals = {name: np.concatenate([one[name], other[name]]) for name in one}
        every = plateaus_of_set_point(**signals, arm_length=0.54, settle_time=hot.settle_time)
        blind = WindingTime(np.log(np.geomspace(2.0, 300.0, TRIED)), np.ones(TRIED))
        shown, about = with_torque(blind, arrange(every), (), 1.2 * hot.coefficient)
        assert about == pytest.approx(hot.coefficient / (1 + hot.coefficient * 15), rel=0.01)
        mean, u = mean_and_u(shown)
        assert abs(mean - np.log(hot.time_constant)) < 2.5 * u
        assert u < 0.4
        found = calibrate(
            every,
            arm_length=0.54,
            arm_length_u=0.0,
            gauge_relative_u=0.0,
            reference_range_degc=(20.0, 35.0),
        )
        assert found.coefficient.value == pytest.approx(hot.coefficient, rel=6e-3)
        lines = {line.name: line.contribution for line in found.coefficient.budget}
        assert lines["lag of the winding in the slope"] > 0.5e-3 * abs(hot.coefficient)


def test_a_single_temperature_shows_no_time_constant_in_the_torque():
    stairs, blind = arrange(plateaus(Bench(**SHORTER))), WindingTime(np.zeros(1), np.ones(1))
    alike = np.full_like(stairs.temperature, 20.0)
    assert with_torque(blind, replace(stairs, temperature=alike), (), -1e-3) == (blind, -1e-3)


def test_the_loss_of_a_minute_follows_from_a_time_constant_that_shows():
    """Eighteen staircases alone leave tau open, and the loss by a minute with it."""
    shown, hidden = (
        fit_staircases(plateaus(Bench(time_constant=20.0, housing_share=share, **LONGER)))
        for share in (0.15, 0.0)
    )
    true = 1.16e-3 * 0.022 * 20.0 * -np.expm1(-3.0) / (1 - 1.16e-3 * 15)
    assert shown.lasting_heating.value == pytest.approx(true, rel=0.06)
    open_u = [each.lasting_heating.budget[1].contribution for each in (shown, hidden)]
    assert open_u[0] < 0.6 * open_u[1]


def test_the_heat_that_has_left_the_winding_is_that_of_small_steps():
    power, tau = np.array([1.0, 4.0, 0.0, 9.0]), 7.0
    begin, end = np.array([0.0, 0.5, 1.5, 4.0]), np.array([0.5, 1.5, 2.0, 5.0])
    step, heat, flown, shown = 1e-4, 0.0, 0.0, []
    middles = (begin + 2 * end) / 3
    for k in range(50_000):
        time = (k + 0.5) * step
        now = power[(begin <= time) & (time < end)].sum()
        heat += step * (now - heat / tau)
        flown += step * heat
        if np.abs(middles - (k + 1) * step).min() < step / 2:
            shown.append(flown)
    found = _flown(power, (begin, middles, end), np.array([1.0, tau]))
    np.testing.assert_allclose(found[1], shown, rtol=2e-3)


def test_a_lag_is_that_of_a_low_pass():
    time = np.arange(1, 200) * 0.1
    values = np.stack([time, time**2])
    late = time - 3.0 * -np.expm1(-time / 3.0)
    found = _behind(values, time, np.array([3.0]))
    np.testing.assert_allclose(found[0], late, rtol=1e-9)
    np.testing.assert_allclose(found[1], time**2 - 6.0 * late, atol=2e-3)
    np.testing.assert_allclose(_behind(values, time, np.array([[0.0], [3.0]]))[0], values)


def test_values_of_tau_are_close_enough_for_what_a_thermometer_shows():
    step = np.log(LONGEST_TIME_CONSTANT / SHORTEST_TIME_CONSTANT) / (TRIED - 1)
    assert step < 0.1
