"""Torque constant from staircases simulated from physics, beside a file of bad input."""

import math
from dataclasses import replace
from types import SimpleNamespace

import GTC
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy import stats

from rigtool.errors import InsufficientDataError
from rigtool.experiments.torque_constant.clampings import clamping_angles
from rigtool.experiments.torque_constant.ripple_over_turn import (
    _alike,
    _nothing,
    alias_of,
    carried_by_arm,
    first_ripple,
    ripple_over_turn,
    stated_ripple,
)
from rigtool.experiments.torque_constant.staircases import fit
from rigtool.experiments.torque_constant.staircases.fit import (
    _solve,
    _trend_scatter,
    fit_staircases,
)
from rigtool.experiments.torque_constant.staircases.friction_change import either, friction_changes
from rigtool.experiments.torque_constant.staircases.friction_of_each import friction_of_each
from rigtool.experiments.torque_constant.staircases.least_squares import without_known
from rigtool.experiments.torque_constant.staircases.mean_staircases import MeanStaircases
from rigtool.experiments.torque_constant.staircases.model import (
    HEATING_TIME,
    Common,
    arrange,
    winding,
)
from rigtool.experiments.torque_constant.staircases.plateaus import (
    Linearity,
    amplifier_linearity,
    plateaus_of_set_point,
)
from rigtool.experiments.torque_constant.staircases.swings import mean_courses
from rigtool.experiments.torque_constant.temperature_fit import (
    Calibration,
    _fit_temperature,
    _require_linear,
    calibrate,
)
from rigtool.numerics.angle_effects import AngleEffects, fit_angle_effects
from rigtool.numerics.arrays import Array
from rigtool.numerics.turn_mean import mean_over_turn
from rigtool.quantity import Quantity, combined, error_line
from tests.experiments.torque_constant.bench import Bench, plateaus_in

MEAN = 45.8e-3 * (1 - 1.16e-3 * 7.5)
"""Of a bench, over 20 to 35 degC, N m/A."""
ARM = {"arm_length_u": 0.2e-3, "gauge_relative_u": 3e-4, "reference_range_degc": (20.0, 35.0)}


def analyse(bench: Bench, signals: dict[str, np.ndarray], **stated: object) -> Calibration:
    plateaus = plateaus_in(signals, bench.settle_time)
    return calibrate(plateaus, arm_length=bench.arm_length, **ARM | stated)


@pytest.fixture(scope="module")
def thesis() -> Calibration:
    bench = Bench()
    return analyse(bench, bench.record())


@pytest.fixture
def fitted(thesis, monkeypatch):
    """Give the staircases of `thesis` its slopes: what is stated of instruments moves none."""
    path = "rigtool.experiments.torque_constant.temperature_fit.fit_staircases"
    monkeypatch.setattr(path, lambda plateaus: thesis.slopes)


def test_thesis_values_come_back(thesis):
    # thesis 7.1.1: 45.8 mN m/A at 20 degC, -0.116 %/K, and 0.9 % for a constant over 20-35 degC
    assert thesis.torque_constant is not None
    assert thesis.coefficient is not None
    assert_allclose(thesis.torque_constant.value, 45.8e-3, rtol=5e-4)
    assert_allclose(thesis.coefficient.value, -1.16e-3, rtol=0.05)
    assert_allclose(thesis.mean.value, MEAN, rtol=5e-4)
    assert_allclose(thesis.constant_error.value, 0.9e-2, atol=0.03e-2)


def test_friction_hysteresis_is_reported_and_its_transition_found(thesis):
    # sliding on either branch in the middle of the span: twice the friction
    assert_allclose(thesis.slopes.hysteresis, 4e-3, rtol=0.01)
    # Dahl: exp(-deflection / presliding angle), deflection = torque / stiffness of the arm
    quiet = Bench(force_noise=5e-5, current_noise=3e-5)
    assert_allclose(analyse(quiet, quiet.record()).slopes.transition, 8e-4 * 15.0, rtol=0.02)
    middle = len(thesis.slopes.level) // 2
    assert_allclose(thesis.slopes.falling[middle], 2e-3, rtol=0.03)
    assert_allclose(thesis.slopes.rising[middle], -2e-3, rtol=0.03)


def test_derivatives_are_those_of_gtc(fitted):
    """k(T) = g (k0 + b (T - T0)) written out with GTC's uncertain numbers."""
    bench = Bench()
    signals = bench.record()
    ends, wrong = (20.0, 45.0), {"gauge_linearity": 1e-3, "current_reading_relative_u": 2e-3}
    found = analyse(bench, signals, **wrong, thermometer_u=0.5, reference_range_degc=ends)

    inputs = {line.name: line for line in found.constant_error.budget + found.mean.budget}
    numbers = {
        name: GTC.ureal(line.value, line.u, line.dof or math.inf, label=name)
        for name, line in inputs.items()
    }
    every = dict(numbers)
    own = ("friction and resolution in the slope", "lag of the winding in the slope")
    value, slope = (numbers.pop(name) for name in ("staircases", "slope of the staircases"))
    more = [numbers.pop(name) for name in own]
    off = numbers.pop("thermometer")
    gain = GTC.constant(1.0)
    for number in numbers.values():
        gain = gain * number / GTC.value(number)
    centre = 20.0 - (found.torque_constant.value - value.x) / slope.x
    # an error of the value is also one of the slope, as is a gain that grows with the force
    slope = slope + _fit_temperature(found.slopes).tilt * (value - value.x)
    grows = numbers["gauge linearity"] / GTC.value(numbers["gauge linearity"])
    slope = grows * sum(more, slope)

    def at(temperature):
        return gain * (value + slope * (temperature - centre + off))

    mean = at(np.mean(ends))
    worst = max((mean / at(end) - 1 for end in ends), key=lambda error: abs(error.x))
    expected = {
        "torque_constant": at(20.0),
        "coefficient": slope * gain / at(20.0),
        "mean": mean,
        "constant_error": worst if worst.x > 0 else -worst,
    }
    for name, number in expected.items():
        result = getattr(found, name)
        assert result.value == pytest.approx(number.x, rel=1e-9)
        assert result.u == pytest.approx(number.u, rel=1e-9)
        assert result.dof == pytest.approx(number.df, rel=1e-6)
        for line in result.budget:
            derivative = GTC.reporting.sensitivity(number, every[line.name])
            assert line.sensitivity == pytest.approx(derivative, rel=1e-9), (name, line.name)


def test_an_error_of_the_trend_is_one_of_the_coefficient_whatever_the_ripple():
    # Ripple that three angles do not resolve scales value and slope alike: both err together, but
    # what friction may add to the slope is about the temperatures that were measured.
    for amplitude in (0.0, 0.02):
        bench = Bench(ripple=(0.0, amplitude), saturation=0.0)
        found = analyse(bench, bench.record((20, 50), angles=3, shifted=False))
        lines = {line.name: line for line in found.coefficient.budget}
        trend = lines["friction and resolution in the slope"]
        size = trend.sensitivity * found.torque_constant.value
        assert size == pytest.approx(1.0, abs=0.03), amplitude
        assert lines["staircases"].value == pytest.approx(float(np.mean(found.value)), rel=0.01)
        assert lines["staircases"].contribution < 0.01 * found.coefficient.value * -1


@pytest.mark.parametrize("exponent", [0.7, 1.5])
def test_the_exponent_of_friction_comes_from_the_staircases(exponent):
    bench = Bench(friction=5e-3, exponent=exponent, force_noise=1e-4)
    found = analyse(bench, bench.record((20, 50)))
    assert abs(np.log(found.slopes.exponent / exponent)) < 0.33
    assert abs(found.torque_constant.value - 45.8e-3) < 2.5 * found.torque_constant.u


def test_friction_that_changes_a_slope_by_a_third_is_taken_out():
    bench = Bench(friction=30e-3, presliding_angle=3e-3)
    found = analyse(bench, bench.record((20,), angles=4)).mean
    assert found.u < 0.02 * found.value
    assert abs(found.value - bench.torque_constant) < 2 * found.u


def test_friction_that_is_too_large_is_the_reason_of_the_refusal():
    bench = Bench(friction=45e-3, presliding_angle=3e-3)
    with pytest.raises(InsufficientDataError, match=r"friction of the shaft shows .* raise curr"):
        analyse(bench, bench.record((20,), angles=4))


def test_stated_uncertainty_holds_what_is_common_to_all_points(thesis):
    # 0.2 times the squared part of a slope that friction takes is stated for its model.
    model = thesis.components["model of friction"]
    assert_allclose(model, 0.2 * thesis.slopes.friction_share**2, rtol=1e-9)
    common = np.hypot(np.hypot(0.2 / 540, 3e-4), thesis.components["friction of the shaft"])
    relative = thesis.torque_constant.u / thesis.torque_constant.value
    assert common < relative < 1.1 * common
    # what scales all points cancels in the relative coefficient
    assert thesis.coefficient.u < 2e-5


def test_ripple_over_rotor_angles_is_found():
    # amplitudes a_k of orders k give a standard deviation of sqrt(sum a_k^2 / 2)
    uneven = Bench(saturation=0.0)
    found = analyse(uneven, uneven.record((20, 50))).ripple
    assert_allclose(found.value, np.sqrt((2 * 0.004**2 + 0.001**2) / 2), rtol=0.1)
    smooth = Bench(ripple=(), saturation=0.0)
    assert analyse(smooth, smooth.record((20, 50))).ripple.value < 1e-4
    assert analyse(smooth, smooth.record((20, 50), angles=1, shifted=False)).ripple is None


@pytest.mark.parametrize("saturation", [0.0, 0.004])
def test_ripple_where_the_current_is_small_is_without_what_grows(saturation):
    bench = Bench(saturation=saturation)
    found = analyse(bench, bench.record())
    small = math.sqrt(sum(a**2 for a in bench.ripple) / 2)
    assert_allclose(found.first_ripple.value, small, rtol=0.1)
    if saturation:
        assert found.ripple.value > 2 * small


def test_ripple_that_grows_bends_a_staircase_and_does_not_scatter_its_slope():
    def scatter(saturation: float) -> float:
        bench = Bench(saturation=saturation, force_noise=1e-4)
        signals = bench.record((20, 50))
        return float(np.median(fit_staircases(plateaus_in(signals)).u))

    assert_allclose(scatter(0.004), scatter(0.0), rtol=0.3)


def test_scatter_of_a_change_with_temperature_is_that_of_noise_on_the_plateaus():
    # contacts that bend by far more than the arm gives way look like a part of the slope
    bench = Bench(presliding_angle=30e-3, force_noise=2e-4, current_noise=1e-5)
    signals = bench.record((20, 35, 50), angles=6)
    stairs = arrange(plateaus_in(signals))
    rise = stairs.temperature.mean(axis=1) - stairs.temperature.mean()
    trend = rise / (rise @ rise)
    common = Common(30e-3 * bench.stiffness, 1.0, None, bench.time_constant)
    friction = friction_of_each(MeanStaircases(stairs, bench.coefficient, trend), common)
    solution = _solve(
        stairs, winding(stairs, bench.time_constant), friction, bench.coefficient, rise
    )
    noise = (
        2e-4
        * 0.54
        / math.sqrt(30)
        * np.random.default_rng(1).standard_normal((300, *stairs.torque.shape))
    )
    expected = np.std([trend @ solution.fit.solve(each)[0][:, 0] for each in noise])
    own = np.linalg.norm(trend * solution.u)
    assert expected > 1.5 * own
    beyond = _trend_scatter(stairs, solution, trend, 0.0)
    assert_allclose(np.hypot(beyond, own), expected, rtol=0.4)
    # what the gauge's resolution gives is stated on its own
    assert_allclose(_trend_scatter(stairs, solution, trend, 0.6 * beyond), 0.8 * beyond)
    assert _trend_scatter(stairs, solution, trend, 2 * beyond) == 0.0


def staircases_with_soft_contacts(noise: float):
    """Return what makes staircases of friction that follows the current, nearly, and changes by a
    part `growth` within 30 K."""
    bench = Bench(saturation=0.0)
    signals = bench.record((20, 50))
    stairs = arrange(plateaus_in(signals, 0.1))
    rise = np.where(stairs.temperature[:, 0] > 35, 15.0, -15.0)
    rising = np.diff(stairs.setpoint, axis=1, prepend=-1.0) > 0
    loop = np.where(rising, -0.1, 0.1) * np.minimum(stairs.current, 1.0) - stairs.current / 4
    begun = np.exp(-np.arange(loop.shape[1])) + 0.0 * loop
    drawn = noise * np.random.default_rng(4).standard_normal(loop.shape)

    def solved(growth):
        size = (1 + growth * rise / 30)[:, None]
        level = (0.05 * (1 - 1e-3 * rise))[:, None] * stairs.current
        own = replace(stairs, torque=level + 2e-3 * size * loop + drawn)
        given = own, winding(own, 20.0), (loop, begun), -1e-3, rise
        return own, (_solve(*given), _solve(*given, steady=True)), rise / (rise @ rise)

    return solved


def changes_of(stairs, both, trend):
    return friction_changes(stairs.weight, *(each.fit for each in both), trend)


def test_friction_changes_with_the_temperature_where_the_staircases_show_it():
    solved = staircases_with_soft_contacts(1e-5)

    def found(growth):
        own, both, trend = solved(growth)
        probability, known = changes_of(own, both, trend)
        return probability, known, [trend @ each.slope for each in both]

    # none: a change that is nearly known from the staircases is not there
    probability, known, _ = found(0.0)
    assert probability < 0.3
    assert 0.8 < known < 1.0
    # a tenth: what takes it for none is off
    probability, _, values = found(0.1)
    assert probability > 0.999
    assert abs(values[1] + 5e-5) > 5 * abs(values[0] + 5e-5)


def test_a_change_of_friction_that_no_staircase_shows_is_as_large_as_known_beforehand():
    own, both, trend = staircases_with_soft_contacts(3e-3)(0.0)
    probability, known = changes_of(own, both, trend)
    assert known < 0.1
    assert_allclose(probability, 0.5, atol=0.05)
    # the variance left is that of 0.5 % a kelvin
    scatter = (trend @ both[0].fit.residual).var() / (trend @ trend)
    change = math.sqrt(known / (1 - known) * scatter * both[0].fit.shared_cover[-1, -1])
    assert_allclose(change, 5e-3 * abs(both[1].fit.shared[1]), rtol=0.1)


def test_a_change_with_temperature_is_that_of_least_squares_with_a_pseudo_observation():
    """Beforehand a parameter is 0 with a variance: as a row of the design."""
    drawn = np.random.default_rng(2)
    design, torque, variance = drawn.standard_normal((9, 4)), drawn.standard_normal(9), 0.7
    q, r = np.linalg.qr(design)
    inverse = np.linalg.inv(r)
    found = inverse @ (q.T @ torque)
    row = np.array([[0.0, 0.0, 0.0, 1 / math.sqrt(variance)]])
    expected = np.linalg.lstsq(np.vstack([design, row]), np.append(torque, 0.0), rcond=None)[0]
    given = inverse[None, None], found[None, None], [-1]
    each = (without_known(*given, size)[0, 0] for size in (np.array([[variance]]), 0.0))
    tied = np.linalg.lstsq(design[:, :3], torque, rcond=None)[0]
    assert_allclose(list(each), [expected[0], tied[0]])


def test_either_of_two_values_is_uncertain_by_their_difference():
    drawn = np.random.default_rng(5)
    first = drawn.random(200_000) < 0.3
    each = np.where(first, 2.0, 1.0) + np.where(first, 0.4, 0.1) * drawn.standard_normal(200_000)
    assert_allclose(either(0.3, [2.0, 1.0], [0.4, 0.1]), (each.mean(), each.std()), rtol=5e-3)


def test_the_coefficient_is_the_mean_of_both_alternatives(monkeypatch):
    bench = Bench()
    plateaus = plateaus_in(bench.record((20, 50)))
    each = []
    for more in (0.0, 1e-6):
        monkeypatch.setattr(
            fit, "either", lambda _, trends, us, more=more: (trends[0] + more, 5e-7)
        )
        each.append(fit_staircases(plateaus))
    first, second = (_fit_temperature(slopes) for slopes in each)
    assert_allclose(second.slope - first.slope, 1e-6, rtol=1e-3)
    assert_allclose(second.value, first.value, rtol=1e-6)
    assert second.trend_u >= 5e-7


def test_what_passes_for_heat_passes_for_a_change_with_temperature_as_copper_does(thesis):
    """A loss that is not there is taken off by 0.393 % of it more a kelvin, from 20 degC on."""
    none = _fit_temperature(replace(thesis.slopes, heating_u=0.0))
    heated = _fit_temperature(replace(thesis.slopes, heating_u=5e-3))
    growth = 0.00393 / (1 + 0.00393 * (none.temperature - 20))
    added = math.sqrt(heated.trend_u**2 - none.trend_u**2)
    assert_allclose(added, 5e-3 * growth * none.value, rtol=1e-6)


def test_what_a_step_leaves_of_lagging_ripple_is_no_friction():
    """Where contacts hardly slide, friction that grew with the ripple would take it for its own."""
    bench = Bench(saturation=0.0)
    stairs = arrange(plateaus_in(bench.record((20,)), 0.1))
    turn = 0.01 * np.cos(2 * stairs.rotor_angle)
    rising = np.diff(stairs.setpoint, axis=1, prepend=-1.0) > 0
    loop = stairs.setpoint - 0.05 * np.where(rising, 1.0, -1.0) * stairs.setpoint**2
    begun = np.exp(-np.arange(loop.shape[1])) + 0.0 * loop
    steps = np.diff(stairs.setpoint, axis=1, prepend=0.0)
    level = 0.05 * ((1 + turn)[:, None] * stairs.setpoint - 0.01 * turn[:, None] * steps)
    torque = level - 2e-3 * loop
    courses = mean_courses(
        stairs.setpoint,
        torque,
        np.repeat(torque[:, :, None], 16, axis=2),
        np.full(torque.shape, 0.4),
        np.full(len(turn), 20.0),
        noise=1e-9,
    )
    stairs = replace(
        stairs,
        torque=torque,
        current=stairs.setpoint,
        temperature=0 * torque + 20.0,
        courses=courses,
    )
    solution = _solve(stairs, winding(stairs, 20.0), (-loop, begun), 0.0, np.zeros(len(turn)))
    weight = turn / (turn @ turn)
    assert_allclose(weight @ solution.slope, 0.05, rtol=1e-3)
    blind = replace(stairs, courses=replace(courses, score=0 * courses.score))
    without = _solve(blind, winding(blind, 20.0), (-loop, begun), 0.0, np.zeros(len(turn)))
    assert np.abs(solution.fit.residual).max() < 0.05 * np.abs(without.fit.residual).max()
    # what noise gives the slopes in proportion to the ripple is a common factor of it, and in its u
    noise = 1e-4 * np.random.default_rng(2).standard_normal((300, *torque.shape))
    scattered = np.std([weight @ solution.fit.solve(each)[0][:, 0] for each in noise])
    noisy = replace(stairs, torque=torque + noise[0])
    found = _solve(noisy, winding(noisy, 20.0), (-loop, begun), 0.0, np.zeros(len(turn)))
    both = np.hypot(_trend_scatter(noisy, found, weight, 0.0), np.linalg.norm(weight * found.u))
    assert_allclose(both, scattered, rtol=0.3)


def test_ripple_that_few_angles_may_not_show_has_no_uncertainty():
    # six angles show nothing of order 6, nine show all of it
    sixth = Bench(ripple=(0.0, 0.0, 0.0, 0.0, 0.0, 0.006), saturation=0.0)
    few = analyse(sixth, sixth.record((20, 50), angles=6, shifted=False)).ripple
    assert few.value < 1e-3
    assert few.u is None
    assert "6 rotor angles do not show all orders" in few.reason
    enough = analyse(sixth, sixth.record((20, 50), angles=13, shifted=False)).ripple
    assert abs(enough.value - 0.006 / np.sqrt(2)) < 3 * enough.u


def test_what_the_ripple_is_uncertain_by(thesis):
    """Each part alone, against the formula written out; dof by Welch and Satterthwaite."""
    amplitudes = np.zeros(24)
    amplitudes[4] = 2e-4  # cosine of order 3
    found = AngleEffects(
        *([np.zeros(1)] * 4), 2e-4 / np.sqrt(2), 1e-6, 10.0, amplitudes, np.zeros(12), 0.0
    )
    none = {"friction_share": 0.0, "deflection": 0.0, "deflection_u": 0.02}
    none |= {"ripple_u": 0.0, "rounding": np.zeros((1, len(thesis.slopes.zero)))}
    none |= {"zero_u": 0.0 * thesis.slopes.zero}
    bare = replace(thesis.slopes, zero=0.0 * thesis.slopes.zero, **none)
    deflected = found.deviation * 0.05 * (3 * 0.02) ** 2

    def of(**changes) -> tuple[float, float, float]:
        own = replace(bare, **changes)
        ripple = ripple_over_turn(found, 0.045, own, carried_by_arm(own))
        return ripple.value * 0.045, ripple.u * 0.045, ripple.dof

    value, u, dof = of()
    assert_allclose([value, u], [found.deviation, np.hypot(1e-6, deflected)], rtol=1e-6)
    assert_allclose(dof, 10.0 * (u / 1e-6) ** 4, rtol=1e-6)
    value, u, _ = of(friction_share=0.1)
    assert_allclose(value, found.deviation)
    assert_allclose(u, np.linalg.norm([1e-6, deflected, 0.015 * found.deviation]), rtol=1e-6)
    _, u, _ = of(ripple_u=0.03)  # friction of the staircases, which may follow the ripple
    assert_allclose(u, np.linalg.norm([1e-6, deflected, 0.03 * found.deviation]), rtol=1e-6)
    # 1 mN m without current: its slope over the angle, times 0.02 rad, which turns the ripple's
    # order in phase with it, or none of it
    top = float(np.ptp(bare.level))
    for order, phase, in_phase in ((2, 0.3, 0.0), (3, 0.3, math.sin(0.3)), (3, 0.0, 0.0)):
        value, u, _ = of(zero=1e-3 * np.cos(order * bare.rotor_angle + phase))
        carried = order * 1e-3 / np.sqrt(2) * 0.02 / top
        assert_allclose(value, found.deviation, rtol=1e-6)  # not known to be carried at all
        more = np.hypot(found.deviation, carried) - found.deviation
        assert_allclose(u, np.linalg.norm([1e-6, deflected, more, carried * in_phase]), rtol=0.02)
    # a gauge that rounds by its zero: the root mean square of what each place adds
    angle = bare.rotor_angle
    errors = np.stack([3e-6 * np.cos(angle), 4e-6 * np.cos(angle) + 1e-3])
    _, u, _ = of(rounding=errors)
    rounded = math.sqrt((3e-6**2 + 4e-6**2) / 2) * np.std(np.cos(angle))
    assert_allclose(u, np.linalg.norm([1e-6, deflected, rounded]), rtol=1e-6)
    _, own, _ = of(friction_share=0.1)
    own = math.sqrt(own**2 - deflected**2)
    for order, in_phase in ((3, math.cos(0.3)), (2, 0.0)):  # what begins a staircase, and ripple
        offset = 1e-3 * np.cos(order * bare.rotor_angle + 0.3)
        _, u, _ = of(friction_share=0.1, zero=offset, deflection_u=0.0)
        begin = 0.015 * in_phase * 1e-3 / np.sqrt(2) / np.ptp(bare.level)
        assert_allclose(u, np.hypot(own, begin), rtol=0.02)


def test_what_an_unknown_phase_has_in_common_with_the_ripple():
    """By phases drawn: of orders that the ripple has, of one it has not, and of one above it."""
    rng, count, angles = np.random.default_rng(1), 20000, 32
    angle = 2 * np.pi * (np.arange(angles) + rng.random(angles)) / angles
    amplitudes = {2: 3e-4, 5: 1e-4}
    ripple = np.zeros(24)
    ripple[[2, 9]] = list(amplitudes.values())  # cosine of order 2, sine of order 5
    shape = 3e-4 * np.cos(2 * angle) + 1e-4 * np.sin(5 * angle)
    for unknown in ((2, 5), (5,), (3,)):
        wide = np.zeros(48)
        wide[np.array(unknown) - 1] = 4e-8 / 2  # mean squares of amplitudes of 2e-4
        carried = replace(_nothing(24), unknown=wide, angles=angles)
        own = sum(
            amplitudes.get(order, 0.0) * 2e-4 * np.cos(rng.uniform(0, 7, count)) / 2
            for order in unknown
        ) / math.sqrt(sum(each**2 for each in amplitudes.values()) / 2)
        assert_allclose(_alike(ripple, carried), np.std(own), rtol=0.1, atol=1e-9)
    order = rng.integers(13, 49, count)
    waves = 2e-4 * np.cos(np.outer(angle, order) + rng.uniform(0, 2 * np.pi, count))
    shape -= shape.mean()
    own = shape @ (waves - waves.mean(axis=0)) / angles / np.std(shape)
    carried = replace(_nothing(24), unknown=np.repeat([0.0, 2e-8 / 36], [12, 36]), angles=angles)
    assert_allclose(_alike(ripple, carried), np.std(own), rtol=0.15)


@pytest.mark.parametrize("rise", [0.0, 1.0])
def test_ripple_of_small_currents_is_scatter_about_a_line_without_its_own(rise):
    degc = 20 + rise * np.array([0.0, 10.0, 20.0, 30.0, 5.0])
    first = 0.05 + 1e-4 * np.array([1.0, -2.0, 0.5, 1.5, -0.4]) - 2e-5 * degc
    slopes = SimpleNamespace(temperature=degc, first=first, first_u=np.zeros(5))
    if rise:
        line = stats.linregress(degc, first)
        scatter = line.stderr * np.sqrt(np.sum((degc - degc.mean()) ** 2))
    else:
        scatter = np.std(first, ddof=1)
    free = 3 if rise else 4
    assert_allclose(first_ripple(slopes).value, scatter / np.mean(first), rtol=1e-6)
    # own scatter is taken off, but for the standard deviation of its square
    for part in (0.5, 2.0):
        slopes.first_u = np.full(5, part * scatter)
        left = max(1 - part**2, 0) + part**2 * np.sqrt(2 / free)
        expected = scatter * np.sqrt(left) / np.mean(first)
        assert_allclose(first_ripple(slopes).value, expected, rtol=1e-6)


def test_the_smearing_of_an_order_is_that_of_a_line_of_least_squares():
    u, a = np.linspace(0, 1, 2001), 0.1
    line = np.polyfit(u, u * np.exp(1j * a * u), 1)[0]
    assert_allclose(abs(line), 1 + 0.05 * a**2, atol=1e-5)


def test_torque_without_current_is_no_ripple_where_the_rotor_position_is_recorded():
    # order 2 of 2 mN m, on an arm that gives way by 12 mrad: 2 * 2e-3 * 0.012 / 4 of slope
    bench = Bench(ripple=(), saturation=0.0, friction=2e-4, cogging=2e-3, force_noise=5e-5)
    signals = bench.record((20, 50))
    position = signals.pop("position")
    hidden = analyse(bench, signals)
    assert (hidden.slopes.deflection, hidden.slopes.deflection_u) == (0.0, 0.02)
    hidden = hidden.ripple.value * 0.045
    assert_allclose(hidden, 2 * 2e-3 * 0.012 / 4 / np.sqrt(2), rtol=0.1)
    shown = analyse(bench, signals | {"position": position})
    assert_allclose(shown.slopes.deflection, 4 * 0.0455 / bench.stiffness, rtol=0.02)
    assert shown.slopes.deflection_u < 1e-4
    assert shown.ripple.value * 0.045 < 0.15 * hidden
    step = 2 * np.pi / 500  # larger than the deflection
    coarse = {"position": np.floor(position / step) * step, "count": step}
    known = analyse(bench, signals | coarse).slopes
    assert abs(known.deflection - shown.slopes.deflection) < 2 * known.deflection_u
    assert known.deflection_u >= step / np.sqrt(6)


def test_torque_without_current_of_an_order_that_the_angles_hide_is_in_the_ripples_u(thesis):
    """Eighteen angles do not show which order 22 is, which an arm that gives way by 0.08 rad
    carries by 1.5 of itself."""
    angle = clamping_angles((20.0, 30.0, 40.0), 6).ravel()
    ones, top = np.ones((len(angle), 1)), float(np.ptp(thesis.slopes.level))

    def torque(at: Array, phases: tuple[float, ...]) -> Array:
        waves = zip((1, 3, 22), phases, strict=True)
        return sum(5e-4 * np.cos(order * at + phase) for order, phase in waves)

    def slope_of(size: float, *phases: float) -> Array:
        moved = torque(angle + 0.08, phases) - torque(angle, phases)
        return 0.045 + size * np.cos(3 * angle) + moved / top

    def ripple(size: float, *phases: float) -> Quantity:
        found = fit_angle_effects(ones, slope_of(size, *phases), slopes.u, angle)
        own = replace(slopes, zero=torque(angle, phases))
        return ripple_over_turn(found, 0.045, own, carried_by_arm(own))

    alike = {"u": np.full(len(angle), 1e-5), "rounding": np.zeros((1, len(angle)))}
    alike |= {"zero_u": np.full(len(angle), 1e-6)}
    alike |= {"deflection": 0.08, "deflection_u": 0.0, "ripple_u": 0.0, "friction_share": 0.0}
    slopes = replace(thesis.slopes, rotor_angle=angle, **alike)
    # without ripple, what the angles hide is off the square of what passes for some
    passes = fit_angle_effects(ones, slope_of(0.0, 1, 3, 22), slopes.u, angle).deviation / 0.045
    assert ripple(0.0, 1, 3, 22).value < 0.85 * passes
    found = ripple(2e-4, 1, 3, 22)
    drawn = [ripple(2e-4, *phases) for phases in np.random.default_rng(0).uniform(0, 7, (60, 3))]
    pulls = [(each.value - 2e-4 / np.sqrt(2) / 0.045) / each.u for each in (found, *drawn)]
    assert 0.7 < np.sqrt(np.mean(np.square(pulls))) < 1.3
    assert np.max(np.abs(pulls)) < 5
    assert stated_ripple(found, 18, 1e-4).u == found.u
    hides = combined(1e-3, "1", [error_line("deflection of the arm", 2e-3, "1")])
    assert "take a stiffer arm" in stated_ripple(hides, 18, 1e-4).reason


@pytest.mark.parametrize("parts", [16, 32])
def test_cogging_that_equal_angles_take_for_a_lower_order_is_found_by_the_slopes(thesis, parts):
    """Order m - 2 passes for order 2, m + 3 for 3; the ripple that is left is that of order 5."""
    angle, own = 2 * np.pi * np.arange(parts) / parts, 2e-4 / 0.045
    bend, top, size = 0.05, float(np.ptp(thesis.slopes.level)), 5e-4
    alike = {"u": np.full(parts, 1e-6), "rounding": np.zeros((1, parts))}
    alike |= {"zero_u": np.full(parts, 1e-6), "deflection": bend, "deflection_u": 0.0}
    alike |= {"ripple_u": 0.0, "friction_share": 0.0}

    def found_at(angle: Array, *orders: int):
        def torque(at: Array) -> Array:
            return sum(size * np.cos(order * at + order) for order in orders)

        slope = 0.045 + 2e-4 * np.cos(5 * angle) + (torque(angle + bend) - torque(angle)) / top
        found = fit_angle_effects(np.ones((parts, 1)), slope, alike["u"], angle)
        slopes = replace(thesis.slopes, rotor_angle=angle, slope=slope, zero=torque(angle), **alike)
        carried = carried_by_arm(slopes)
        ripple = ripple_over_turn(found, 0.045, slopes, carried)
        return ripple, alias_of(ripple, found, 0.045, slopes, carried)

    for orders, order, shown in (((parts - 2,), parts - 2, 2), ((parts + 3, 4), parts + 3, 3)):
        ripple, alias = found_at(angle, *orders)
        assert (alias.order, alias.shown, alias.parts) == (order, shown, parts)
        assert_allclose(ripple.value - alias.less, own / np.sqrt(2), rtol=0.02)
        assert alias.less > 10 * ripple.u
        # cogging of the order m may be as large, and is the same for all slopes
        hidden = size / np.sqrt(2) * 2 * math.sin(parts * bend / 2) / top / 0.045
        assert_allclose(alias.constant, hidden, rtol=0.02)
        stated = stated_ripple(ripple, parts, 1e-6, alias)
        assert (stated.value, stated.u) == (ripple.value, None)
        assert (
            f"cogging of order {order} passes for order {shown} at {parts} equal" in stated.reason
        )
        assert stated_ripple(ripple, parts, 1e-6, replace(alias, less=0.9 * ripple.u)) == ripple
    for orders in ((2,), (3, 4), (5,)):
        ripple, alias = found_at(angle, *orders)
        assert alias is None
        assert_allclose(ripple.value, own / np.sqrt(2), rtol=0.02)
    apart = angle + np.random.default_rng(0).uniform(0, 2 * np.pi / parts, parts)
    assert found_at(apart, parts - 2)[1] is None


def test_cogging_of_an_order_that_no_zero_shows_is_in_the_budget_of_the_constant(
    thesis, monkeypatch
):
    """Order 16 at 16 angles, where order 14 shows in the slopes of an arm that gives way."""
    angle = 2 * np.pi * np.arange(16) / 16
    top = float(np.ptp(thesis.slopes.level))

    def calibrated(*orders: int) -> Calibration:
        def torque(at: Array) -> Array:
            return sum(5e-4 * np.cos(order * at + order) for order in orders)

        same = {"u": np.full(16, 1e-6), "rounding": np.zeros((1, 16)), "zero_u": np.full(16, 1e-6)}
        same |= {"deflection": 0.05, "temperature": np.full(16, 25.0), "rotor_angle": angle}
        same |= {"first": np.full(16, 0.045), "first_u": np.full(16, 1e-6)}
        slope = 0.045 + 2e-4 * np.cos(5 * angle) + (torque(angle + 0.05) - torque(angle)) / top
        slopes = replace(thesis.slopes, slope=slope, zero=torque(angle), **same)
        at = "rigtool.experiments.torque_constant.temperature_fit."
        monkeypatch.setattr(at + "fit_staircases", lambda _: slopes)
        monkeypatch.setattr(at + "amplifier_linearity", lambda _: thesis.linearity)
        return calibrate(None, arm_length=0.54, **ARM)

    line = "cogging that equal angles hide"
    assert calibrated(2).components[line] == 0.0
    found = calibrated(14, 16)
    assert_allclose(found.components[line], 5e-4 * 0.55 / top / 0.045, rtol=0.05)
    assert abs(found.mean.value - 0.045) > 2 * calibrated(2).mean.u
    assert abs(found.mean.value - 0.045) < 2 * found.mean.u


def test_ripple_below_the_scatter_of_a_staircase_has_no_uncertainty():
    noisy = Bench(ripple=(2e-4,), saturation=0.0, force_noise=0.05)
    found = analyse(noisy, noisy.record((20, 50), angles=13, shifted=False)).ripple
    assert found.u is None
    assert "a single staircase scatters by" in found.reason


def test_errors_scatter_as_stated():
    # The arm's length and the gauge are exact here: compare with the parts that do scatter.
    bench = Bench()
    errors = []
    for seed in range(5):
        found = analyse(bench, bench.record((20, 35, 50), seed=seed))
        scatter = [found.components[name] for name in ("scatter", "heat in the winding")]
        errors.append((found.mean.value / MEAN - 1) / np.hypot(*scatter))
        assert abs(found.coefficient.value + 1.16e-3) < 3 * found.coefficient.u
    assert 0.4 < np.sqrt(np.mean(np.square(errors))) < 2.0


@pytest.mark.parametrize(
    "bench",
    [
        Bench(friction=0.0),
        Bench(friction=6e-3, stiffness=40.0, housing_drift=-0.1),
        Bench(stiffness=400.0),  # friction that never slides within a staircase
        Bench(torque_constant=0.12, coefficient=-2e-3, ripple=(0.02, 0.0, 0.003)),
        Bench(heating=0.1, time_constant=12.0, amplifier_gain=1.03, amplifier_offset=-0.02),
    ],
    ids=["no friction", "more, drifting", "stiff arm", "other motor", "hot, amplifier"],
)
def test_other_rigs(bench):
    found = analyse(bench, bench.record())
    assert_allclose(found.torque_constant.value, bench.torque_constant, rtol=1.5e-3)
    assert abs(found.torque_constant.value - bench.torque_constant) < 3 * found.torque_constant.u
    assert_allclose(found.coefficient.value, bench.coefficient, atol=6e-5)
    assert_allclose(found.linearity.gain, bench.amplifier_gain, rtol=1e-4)
    assert_allclose(found.linearity.offset, bench.amplifier_offset, atol=2e-4)


def test_ignored_friction_would_show():
    # The same signals, the slope by a straight line: what the analysis has to take out.
    bench = Bench(stiffness=40.0, ripple=())
    plateaus = plateaus_in(bench.record())
    straight = np.polyfit(plateaus.current, plateaus.torque, 1)[0]
    assert straight < 45.8e-3 * (1 - 0.01)


def test_ripple_that_bends_a_staircase_is_not_taken_for_friction():
    # Contacts so soft make friction a spring: its state is nearly the torque itself, bend included.
    bench = Bench(presliding_angle=60e-3, friction=5e-3, ripple=(), saturation=0.01)
    found = analyse(bench, bench.record((20,), seed=1))
    assert_allclose(found.mean.value, bench.torque_constant, rtol=3e-3)


def test_same_angles_at_each_temperature():
    bench = Bench()
    found = analyse(bench, bench.record(shifted=False))
    assert found.rotor_angles == 8
    assert_allclose(found.torque_constant.value, 45.8e-3, rtol=5e-4)
    # An eighth order cannot be distinguished from the mean: that is uncertainty.
    assert found.components["ripple over rotor angles"] > 5 * found.components["scatter"]
    assert_allclose(found.coefficient.value, -1.16e-3, rtol=0.02)


def test_a_drift_within_the_staircases_is_taken_out_of_the_torque():
    """A motor that cools by 8 K in each: what stays is noise."""
    bench = Bench(housing_drift=-1.0, force_noise=5e-5, current_noise=3e-5, saturation=0.0)
    found = analyse(bench, bench.record((30, 50), angles=3))
    assert_allclose(found.coefficient.value, -1.16e-3, rtol=0.05)
    assert (found.slopes.u < 2.5e-5 * found.mean.value).all()


@pytest.mark.parametrize(
    "bench",
    [
        Bench(),
        Bench(time_constant=60.0),
        Bench(friction=0.2e-3, force_noise=1e-4, heating=0.05, time_constant=4.0),
    ],
)
def test_the_loss_by_a_lasting_current_is_as_uncertain_as_the_time_constant(bench):
    """A staircase of 8 s shows a winding of 4 s; of a slower one it shows how fast it warms."""
    plateaus = [
        plateaus_in(bench.record(), settle)
        for settle in (bench.settle_time, bench.settle_time + bench.sample_time)
    ]
    one, other = (fit_staircases(each) for each in plateaus)
    found, again = one.lasting_heating, other.lasting_heating
    warming = -bench.time_constant * math.expm1(-HEATING_TIME / bench.time_constant)
    true = -bench.coefficient * bench.heating * warming
    assert abs(found.value - true) < 2 * found.u
    assert abs(found.value - again.value) < found.u  # one sample of settling
    assert (found.budget[1].contribution > 0.1 * true) == (bench.time_constant > 20)


def test_one_rotor_angle_leaves_the_heat_unknown():
    bench = Bench(ripple=(), saturation=0.0)
    found = analyse(bench, bench.record((20, 35, 50), angles=1, shifted=False))
    assert found.components["heat in the winding"] == pytest.approx(found.slopes.heating, rel=1e-9)
    loss = found.slopes.lasting_heating
    assert loss.budget[-1].contribution == pytest.approx(abs(loss.value), rel=1e-9)
    assert abs(found.mean.value / MEAN - 1) < 2 * found.mean.u / 45e-3


def test_no_magnet_gains_by_heat():
    """Torque that rises with i2 over time is not heat: nothing is corrected, and u holds it."""
    bench = Bench(heating=-0.022, saturation=0.0)
    found = analyse(bench, bench.record((20, 50), angles=3))
    assert found.slopes.heating == 0
    # as much as it would be with the other sign
    assert found.slopes.heating_u > 3e-4


def test_unknown_rotor_angles():
    bench = Bench()
    found = analyse(bench, {**bench.record(), "rotor_angle": None})
    assert found.rotor_angles == 0
    assert abs(found.torque_constant.value - 45.8e-3) < 3 * found.torque_constant.u
    assert found.components["scatter"] > 3e-4  # the ripple scatters it


def test_resolution_of_the_gauge_is_seen_in_its_readings_and_stated():
    bench = Bench(force_noise=1e-4)
    signals = bench.record((20, 50))
    rounded = {**signals, "force": np.round(signals["force"] / 5e-3) * 5e-3}
    assert_allclose(plateaus_in(rounded).resolution, 5e-3 * 0.54, rtol=1e-6)
    found = analyse(bench, rounded)
    assert abs(found.mean.value / MEAN - 1) < 3 * found.mean.u / 45e-3
    fine = analyse(bench, signals)
    assert found.components["gauge resolution"] > 20 * fine.components["gauge resolution"]
    own = found.slopes.rounding - found.slopes.rounding.mean(axis=1, keepdims=True)
    shift = found.slopes.slope - fine.slopes.slope
    assert_allclose(np.sqrt(np.mean(own**2)), np.std(shift), rtol=0.4)
    stated = plateaus_of_set_point(
        **signals, arm_length=0.54, settle_time=0.08, gauge_resolution=5e-3
    ).resolution
    assert_allclose(stated, 5e-3 * 0.54, rtol=1e-12)


def test_readings_that_only_follow_the_steps_of_the_gauge_are_refused():
    """Steps of current that make whole steps of the gauge hide what is less than one."""
    bench = Bench(force_noise=0.0, friction=0.0, ripple=())
    signals = bench.record((20, 50))
    levels = np.unique(np.round(signals["current_setpoint"], 6))
    step = float(np.diff(levels)[0]) * 45.4e-3 / 0.54

    def calibrated(q):
        rounded = {**signals, "force": np.round(signals["force"] / q) * q}
        return analyse(bench, rounded)

    with pytest.raises(InsufficientDataError, match="whole steps of the gauge"):
        calibrated(step)
    found = calibrated(0.93 * step).mean
    assert abs(found.value / MEAN - 1) < 3 * found.u / 45e-3


def test_gauge_that_is_not_linear_is_in_the_budget(thesis, fitted):
    found = analyse(Bench(), Bench().record(), gauge_linearity=2e-3)
    assert_allclose(found.components["gauge linearity"], 2e-3 / np.sqrt(3), rtol=1e-12)
    more = np.hypot(thesis.mean.u / thesis.mean.value, 2e-3 / np.sqrt(3))
    # colder than the middle of the staircases, the force is larger by 0.9 %
    assert_allclose(found.mean.u / found.mean.value, more, rtol=0.01)


def test_a_gauge_that_reads_more_at_large_forces_changes_coefficient_and_ripple(thesis):
    """A torque that is larger by 1 % then reads larger by more."""
    bench, part = Bench(), 0.02
    signals = bench.record()
    signals["force"] = signals["force"] * (1 + part * signals["force"] / signals["force"].max())
    found = analyse(bench, signals, gauge_linearity=part)
    for name in ("mean", "coefficient", "ripple"):
        bent, right = getattr(found, name), getattr(thesis, name)
        off = bent.value / right.value - 1
        assert_allclose(off, part, atol=0.4 * part, rtol=0)  # a part bends the staircase
        assert off * abs(right.value) < 2 * bent.u
        line = next(line for line in bent.budget if line.name == "gauge linearity")
        assert_allclose(line.contribution / abs(bent.value), part / np.sqrt(3), rtol=0.05)


def test_one_temperature_carries_no_coefficient():
    bench = Bench()
    found = analyse(bench, bench.record((25.0,)))
    assert found.torque_constant is None
    assert found.coefficient is None
    assert_allclose(found.mean.value, 45.8e-3 * (1 - 1.16e-3 * 5), rtol=1e-3)


@given(factor=st.floats(0.05, 20.0), seed=st.integers(0, 3))
@settings(max_examples=2, deadline=None)
def test_torque_scales_the_constant_and_nothing_else(factor, seed):
    bench = Bench(force_noise=1e-4)
    signals = bench.record((20, 50), seed=seed)
    one = analyse(bench, signals)
    other = analyse(bench, {**signals, "force": signals["force"] * factor})
    assert_allclose(other.mean.value, one.mean.value * factor, rtol=1e-6)
    assert_allclose(other.mean.u, one.mean.u * factor, rtol=1e-3)
    assert_allclose(other.coefficient.value, one.coefficient.value, rtol=1e-4)
    alike = (
        "heating heating_u heating_dof friction_u friction_dof friction_share deflection "
        "deflection_u exponent time_constant temperature level dof hysteresis_dof"
    )
    scaled = (
        "slope first first_u zero zero_u u transition rising falling hysteresis hysteresis_u "
        "trend_u lag_u"
    )
    losses = (found.slopes.lasting_heating for found in (one, other))
    (a, a_u), (b, b_u) = ((loss.value, loss.u) for loss in losses)
    assert (b, b_u) == pytest.approx((a, a_u), rel=2e-3)
    for names, size in ((alike, 1.0), (scaled, factor)):
        for name in names.split():
            a, b = (getattr(found.slopes, name) for found in (one, other))
            limit = 1e-3 * size * np.max(np.abs(a))
            assert_allclose(b, np.multiply(a, size), rtol=2e-3, atol=limit, err_msg=name)


def test_a_staircase_that_was_broken_off_counts_as_far_as_it_went():
    bench = Bench(force_noise=5e-5)
    signals = bench.record((20, 50), angles=2)
    plateaus = plateaus_in(signals)
    last = np.flatnonzero(plateaus.staircase == 2)[-7:]
    kept = {name: np.delete(values, last, axis=0) for name, values in vars(plateaus).items()}
    one, other = (fit_staircases(each) for each in (plateaus, type(plateaus)(**kept)))
    assert_allclose(other.slope, one.slope, rtol=1e-3)
    assert_allclose(other.zero, one.zero, atol=3e-5)
    assert other.dof < one.dof
    assert_allclose(other.hysteresis, one.hysteresis, rtol=0.02)
    assert_allclose(other.heating, one.heating, rtol=0.3)  # of one degree of freedom


def test_components_add_up_to_the_u_of_the_mean_where_the_slope_has_no_part():
    """At the mean temperature of the staircases; four angles may hide ripple."""
    bench = Bench(force_noise=2e-3)
    signals = bench.record((20, 50), angles=4, shifted=False)
    signals["force"] = 64.0 * signals["force"]
    centre = _fit_temperature(fit_staircases(plateaus_in(signals))).temperature
    own = {"thermometer_u": 0.5, "current_reading_relative_u": 1e-3, "gauge_linearity": 1e-3}
    found = analyse(bench, signals, **own, reference_range_degc=(centre - 5, centre + 5))
    relative = found.mean.u / found.mean.value
    assert_allclose(math.hypot(*found.components.values()), relative, rtol=1e-6)
    assert_allclose(found.components["thermometer"], 0.5 * 1.16e-3, rtol=0.1)
    assert_allclose(found.components["arm length"], 0.2e-3 / 0.54, rtol=1e-9)
    assert min(found.components["scatter"], found.components["ripple over rotor angles"]) > 1e-5
    hidden = found.components["ripple that few angles hide"]
    assert_allclose(hidden**2 + found.components["ripple over rotor angles"] ** 2, 5e-3**2)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(("off", "refused"), [(0.98, False), (1.02, True)])
def test_an_amplifier_is_straight_within_a_part_of_the_span_or_four_u(sign, off, refused):
    level = np.array([-1.0, 0.0, 3.0])
    for limit, u in ((5e-3 * 4.0, 1e-3), (4 * 0.01, 0.01)):
        found = Linearity(sign * 1.0, 0, 0, 0, 1, off * limit, u, 1, level, level, np.zeros(3))
        if refused:
            with pytest.raises(InsufficientDataError, match=r"deviates by .* from a straight line"):
                _require_linear(found)
        else:
            _require_linear(found)


@pytest.mark.parametrize(("gain", "refused"), [(0.11, False), (0.09, True), (9, False), (11, True)])
def test_an_amplifier_gives_between_a_tenth_and_ten_times_of_what_it_is_asked(gain, refused):
    level = np.array([-1.0, 0.0, 3.0])
    found = Linearity(gain, 0, 0, 0, 1, 0.0, 0.0, 1, level, level, np.zeros(3))
    if refused:
        with pytest.raises(InsufficientDataError, match="for 1 A of set point"):
            _require_linear(found)
    else:
        _require_linear(found)


def test_plateaus_leave_the_settling_out():
    time = np.arange(4000) * 0.01
    setpoint = np.repeat(np.arange(10.0), 400)
    settling = np.exp(-(time % 4.0) / 0.05)
    plateaus = plateaus_of_set_point(
        time=time,
        current_setpoint=setpoint,
        current=setpoint + settling,
        force=2 * setpoint,
        temperature=np.full(4000, 25.0),
        rotor_angle=None,
        arm_length=0.5,
        settle_time=1.0,
    )
    assert_allclose(plateaus.current, np.arange(10.0), atol=1e-8)
    assert_allclose(plateaus.torque, np.arange(10.0), rtol=1e-12)
    assert_allclose(plateaus.begin, np.arange(10) * 4.0, atol=1e-9)
    assert np.all(np.isnan(plateaus.rotor_angle))


def test_a_gap_in_time_begins_a_staircase():
    bench = Bench()
    plateaus = plateaus_in(bench.record((20, 30), 3))
    assert_allclose(np.bincount(plateaus.staircase), np.full(6, 41), rtol=1e-9)


@pytest.mark.parametrize(
    ("gap", "turn", "staircases"),
    [(1.095, 0.0, 1), (1.105, 0.0, 2), (0.01, 0.009, 1), (0.01, 0.011, 2)],
)
def test_a_gap_is_longer_than_samples_and_half_the_settling(gap, turn, staircases):
    """Another angle begins a staircase as well."""
    time = np.arange(4000) * 0.01  # ten samples and half of 2 s: 1.1 s
    setpoint = np.repeat(np.arange(10.0), 400)
    plateaus = plateaus_of_set_point(
        time=time + np.where(setpoint > 4, gap - 0.01, 0.0),
        current_setpoint=setpoint,
        current=setpoint,
        force=setpoint,
        temperature=np.full(4000, 25.0),
        rotor_angle=np.where(setpoint > 4, turn, 0.0),
        arm_length=0.5,
        settle_time=2.0,
    )
    assert plateaus.staircase.max() + 1 == staircases


def test_the_line_of_levels_that_lie_on_it_is_as_uncertain_as_repeats_scatter():
    setpoint = np.repeat(np.array([0.0, 1.0, 2.0, 4.0]), 6)
    current = 1.02 * setpoint + 3e-3 + 1e-4 * np.tile([1.0, -1.0, 2.0, -2.0, 0.5, -0.5], 4)
    found = amplifier_linearity(SimpleNamespace(current_setpoint=setpoint, current=current))
    line = stats.linregress(setpoint, current)
    assert found.dof == found.deviation_dof == 20
    part = math.sqrt(22 / 20)  # scatter about the levels, not about the line
    assert_allclose([found.gain, found.offset], [line.slope, line.intercept], rtol=1e-9)
    assert_allclose(found.gain_u, line.stderr * part, rtol=1e-6)
    assert_allclose(found.offset_u, line.intercept_stderr * part, rtol=1e-6)


@pytest.mark.parametrize("unit", [1e-3, 1.0, 1e3])
def test_levels_are_those_of_the_set_point_in_any_unit(unit):
    setpoint = np.repeat(np.array([0.0, 1.0, 2.0, 4.0]), 6)
    setpoint += 1e-3 * np.tile([0.0, 0.5, 1.0, 0.2, 0.1, 0.7], 4)  # within the tolerance
    found = amplifier_linearity(
        SimpleNamespace(current_setpoint=unit * setpoint, current=2 * setpoint)
    )
    assert len(found.current_setpoint) == 4
    assert_allclose(found.gain, 2 / unit, rtol=1e-9)


def test_linearity_finds_the_worst_level():
    bench = Bench(cubic=1e-3)
    plateaus = plateaus_in(bench.record((20, 30), 3))
    found = amplifier_linearity(plateaus)
    x = np.unique(plateaus.current_setpoint)
    y = x * (1 + 1e-3 * x**2) + 1e-3
    gain, offset = np.polyfit(x, y, 1)
    assert_allclose(found.gain, gain, rtol=1e-4)
    assert_allclose(found.offset, offset, atol=5e-5)
    assert_allclose(found.deviation, np.max(np.abs(y - gain * x - offset)), rtol=0.02)
    # levels off the line set the uncertainty of the line; that of a level comes from its repeats
    assert found.dof == len(x) - 2
    assert found.deviation_dof == len(plateaus.current) - len(x)
    # one level is the worst beyond doubt
    level = np.searchsorted(x + 1e-6, plateaus.current_setpoint)
    scatter = (
        plateaus.current - np.bincount(level, plateaus.current)[level] / np.bincount(level)[level]
    )
    at_worst = np.count_nonzero(level == np.argmax(np.abs(found.deviations)))
    u = np.sqrt(np.sum(scatter**2) / found.deviation_dof / at_worst)
    assert_allclose(found.deviation_u, u, rtol=1e-9)


def test_the_largest_of_deviations_by_chance_is_no_larger_than_its_uncertainty_explains():
    rng = np.random.default_rng(91001)
    levels, repeats, pulls = 17, 8, []
    for _ in range(200):
        setpoint = np.tile(np.linspace(0, 4, levels), repeats)
        plateaus = SimpleNamespace(
            current_setpoint=setpoint, current=setpoint + 1e-4 * rng.standard_normal(setpoint.size)
        )
        found = amplifier_linearity(plateaus)
        pulls.append(found.deviation / found.deviation_u)
    assert np.mean(np.array(pulls) < 1.96) > 0.99


@pytest.mark.parametrize(
    ("bench", "change", "message"),
    [
        (Bench(cubic=3e-3), {}, "not proportional"),
        (Bench(), {"current": lambda s: 0 * s}, "for 1 A of set point"),
        (Bench(), {"current": lambda s: 1e3 * s}, "in another unit"),
        (Bench(), {"current_setpoint": lambda s: 0 * s}, "throughout"),
        (Bench(), {"force": lambda s: -s}, "reverse the sign"),
        (Bench(), {"force": lambda s: np.minimum(s, 0.25)}, "gauge is saturated"),
        (Bench(friction=15e-3), {"force": lambda s: np.minimum(s, 0.2)}, "gauge is saturated"),
        (Bench(), {"force": lambda s: s - 0.2 * np.maximum(s - 0.15, 0)}, "not linear there"),
        (
            Bench(),
            {"force": lambda s: s * (np.arange(len(s)) < 0.7 * len(s))},
            "staircase .*gauge's cable",
        ),
        (Bench(), {"force": lambda s: 0 * s + 0.1}, "54 mN m at the arm whatever the current"),
        (Bench(), {"force": lambda s: np.round(s, 1)}, "in steps of 54 mN m at the arm"),
        (Bench(), {"force": lambda s: np.where(np.arange(len(s)) == 77, np.nan, s)}, "sample 77"),
        (Bench(), {"temperature": lambda s: s[:-1]}, "samples"),
        (Bench(), {"time": lambda s: s[::-1]}, "does not rise"),
        (Bench(settle_time=0.3), {}, "hold each step longer"),
    ],
    ids=[
        "amplifier",
        "amplifier off",
        "milliamperes",
        "constant",
        "sign",
        "saturated",
        "saturated, with friction",
        "end stop",
        "cable",
        "still",
        "coarse",
        "nan",
        "length",
        "clock",
        "short steps",
    ],
)
def test_bad_signals_are_refused_with_a_reason(bench, change, message):
    signals = replace(bench, settle_time=0.08).record((20, 40), 2)
    for name, function in change.items():
        signals[name] = function(signals[name])
    with pytest.raises(InsufficientDataError, match=message):
        analyse(bench, signals)


def test_a_staircase_that_only_rises_is_refused():
    bench = Bench()
    signals = bench.record((20, 40), 2, np.linspace(0, 4, 12))
    with pytest.raises(InsufficientDataError, match="run it up and down"):
        analyse(bench, signals)


def test_mean_over_turn_averages_orders_out():
    angle = 2 * np.pi * np.arange(8) / 8
    value = 3.0 + 0.5 * np.cos(angle + 1) + 0.2 * np.cos(2 * angle) + 0.1 * np.cos(3 * angle)
    found = mean_over_turn(angle, value)
    assert_allclose(found.value, 3.0, rtol=1e-12)
    assert found.dof == 3
    # only the third order scatters beside the two that eight angles resolve
    assert_allclose(found.scatter**2 * 3, 8 * 0.1**2 / 2, rtol=1e-9)


@given(shift=st.floats(0, 6.2), noise=st.integers(0, 1000))
@settings(max_examples=30, deadline=None)
def test_mean_over_turn_does_not_care_where_the_turn_begins(shift, noise):
    rng = np.random.default_rng(noise)
    angle = 2 * np.pi * np.arange(12) / 12
    value = rng.standard_normal(12)
    here, there = mean_over_turn(angle, value), mean_over_turn(angle + shift, value)
    assert_allclose(there.value, here.value, atol=1e-12)
    assert_allclose(there.u, here.u, rtol=1e-9)


def test_an_error_of_the_thermometer_moves_the_constant_along_its_slope(fitted):
    found = analyse(Bench(), Bench().record(), thermometer_u=2.0)
    assert found.coefficient.value < 0
    shift = 2.0 * abs(found.coefficient.value)
    assert_allclose(found.components["thermometer"], shift, rtol=0.05)


@pytest.mark.parametrize(
    ("angles", "value", "u", "reason"),
    [
        (2, 0.01, None, None),
        (3, 0.01, None, "3 rotor angles do not show all orders"),
        (12, 0.01, None, "12 rotor angles do not show all orders"),
        (13, 0.0049, None, "a single staircase scatters by 0.5 %, more than the ripple"),
        (13, 0.0051, 1e-3, None),
    ],
)
def test_a_ripple_is_stated_as_far_as_the_angles_show_it(angles, value, u, reason):
    found = stated_ripple(Quantity(value, "1", 1e-3), angles, 0.005)
    if angles < 3:
        assert found is None
        return
    assert (found.value, found.u) == (value, u)
    assert (found.reason or "").startswith(reason or "")
