"""Holds, friction models, torque-speed curves and the amplifier at low current."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy import stats
from scipy.optimize import curve_fit

from rigtool.errors import InsufficientDataError
from rigtool.experiments.friction.direction_fit import require_explained
from rigtool.experiments.friction.holds import Holds, find_holds, pool
from rigtool.experiments.friction.low_current import (
    deviation_at_low_current,
    require_calibrated_gain,
)
from rigtool.experiments.friction.offset import separate_offset
from rigtool.experiments.friction.procedure_analysis import fit_holds
from rigtool.experiments.friction.results import Findings, Scale, add_friction
from rigtool.experiments.friction.stribeck_fit import fit_direction, fit_directions
from rigtool.experiments.friction.sweep import torque_speed_curve
from rigtool.quantity import Quantity
from tests.experiments.friction.turning_motor import COUNT, Motor

SPEEDS = [0.5, 1, 2, 3, 5, 8, 12, 16, 20, 25, 30]


def holds_of(motor: Motor, speeds=tuple(SPEEDS), seed=0):
    return find_holds(**motor.hold(list(speeds), seed=seed), inertia=motor.inertia)


def curve(speed, coulomb, viscous, static, velocity, exponent=2.0):
    return (
        coulomb + viscous * speed + (static - coulomb) * np.exp(-((speed / velocity) ** exponent))
    )


# -- holds


def test_means_over_whole_turns_do_not_know_ripple():
    quiet = Motor(noise=0.0, ripple=5e-3)
    found = holds_of(quiet)
    assert_allclose(found.speed, SPEEDS, rtol=1e-3)
    assert_allclose(found.torque, quiet.friction(np.array(SPEEDS)), rtol=3e-3)
    assert np.all(found.revolutions >= 3)


def test_settling_is_left_out_by_itself():
    # Run-up and oscillation at the start of each hold; without settling left out, the mean of the
    # shortest holds would be off by the inertia's torque.
    motor = Motor(noise=0.0, ripple=0.0, inertia=2e-4)
    found = holds_of(motor)
    assert_allclose(found.torque, motor.friction(np.array(SPEEDS)), rtol=3e-3)


def test_standard_uncertainty_allows_for_correlated_samples():
    motor = Motor()
    errors, stated = [], []
    for seed in range(12):
        found = holds_of(motor, [2, 8, 20], seed)
        errors.extend((found.torque - motor.friction(found.speed)) / found.u)
        stated.extend(found.u)
    assert 0.7 < np.sqrt(np.mean(np.square(errors))) < 1.5
    # Were the samples independent, u would be far smaller: 0.12 mN m over some 2000 samples.
    assert np.median(stated) > 5 * 0.12e-3 / np.sqrt(2000)


def test_a_recording_without_set_point_is_one_hold():
    motor = Motor(noise=2e-5)
    parts = []
    for speed in (3.0, -3.0):
        signals = motor.hold([speed])
        signals["setpoint"] = None
        parts.append(find_holds(**signals, inertia=motor.inertia))
    both = pool(parts)
    assert_allclose(both.speed, [3.0, -3.0], rtol=0.02)
    assert_allclose(both.torque, motor.friction(np.array([3.0, -3.0])), rtol=0.02)


def test_a_shaft_that_starts_and_stops_is_noticed():
    motor = Motor(noise=0.0)
    signals = motor.hold([0.3, 5.0])
    calm = find_holds(**signals, inertia=motor.inertia)
    assert np.all(calm.shaking < 0.05)
    # a limit cycle at 60 Hz that would move this inertia at up to 0.53 rad/s
    shaken = signals["torque"] + 3e-3 * np.sin(2 * np.pi * 60 * signals["time"])
    found = find_holds(**{**signals, "torque": shaken}, inertia=motor.inertia)
    assert_allclose(found.shaking * found.speed, 0.53 / np.sqrt(2), rtol=0.1)


def test_no_hold_is_refused():
    time = np.arange(2000) * 1e-3
    with pytest.raises(InsufficientDataError, match="constant speed"):
        find_holds(time=time, angle=time**2, torque=time, setpoint=time**2, inertia=1e-5)


def test_a_hold_of_which_one_sample_is_left_is_left_out():
    """Three samples a turn: half of sixteen samples has no whole turns of eight samples."""
    time = np.arange(16) * 0.05
    angle = 40.0 * time
    behind = np.where(time < time[8], 1.0, 0.0)
    signals = {"time": time, "torque": np.ones(16), "setpoint": angle, "inertia": 1e-5}
    with pytest.raises(InsufficientDataError, match="leaves 8 samples once it has settled"):
        find_holds(angle=angle - behind, **signals)


# -- models


@pytest.mark.parametrize("exponent", [1.0, 2.0])
@pytest.mark.parametrize(("part", "shown"), [(0.3, False), (0.36, False), (0.385, True)])
def test_velocities_beyond_those_that_are_searched_are_not_stated(part, shown, exponent):
    """A third of the lowest speed is the least; within a tenth of it a search ends at the edge."""
    speed = np.array([1.0, 1.02, 1.04, 1.5, 2, 3, 5, 8, 12, 20])
    torque = curve(speed, 2e-3, 5e-5, 40e-3, part, exponent)
    found = fit_direction(speed, torque, np.full(10, 1e-7), {exponent: 0.0})
    assert found.exponent == (exponent if shown else None)
    if shown:
        assert found.parameters[3] == pytest.approx(part, rel=1e-3)


def test_a_direction_has_the_degrees_of_freedom_of_its_own_fit():
    """Five speeds forward and eight backward leave 3 and 6; for the mean, Welch-Satterthwaite."""
    rng = np.random.default_rng(1)
    speed = np.array([3.0, 8, 12, 20, 30, -2, -3, -5, -8, -12, -16, -20, -30])
    torque = np.sign(speed) * 2e-3 + 5e-5 * speed + 2e-5 * rng.standard_normal(len(speed))
    fits = fit_directions(speed, torque, np.full(len(speed), 2e-5))
    found = Findings(Scale(Quantity(0.045, "N m/A", 0.0)))
    add_friction(fits, None, found)
    sides = [found.results[f"viscous_friction_{name}"] for name in ("positive", "negative")]
    assert [side.dof for side in sides] == [3.0, 6.0]
    mean = found.results["viscous_friction"]
    assert mean.u == pytest.approx(np.hypot(*(side.u for side in sides)) / 2)
    spread = sum((side.u / 2) ** 4 / side.dof for side in sides)
    assert mean.dof == pytest.approx(mean.u**4 / spread)


def test_published_friction_comes_back():
    # thesis 7.2.1, 7.2.2: 2.3 mN m and 5.33e-5 N m s/rad
    motor = Motor(noise=0.06e-3)
    for sign in (1, -1):
        found = holds_of(motor, [sign * v for v in SPEEDS])
        fit = fit_direction(found.speed * sign, found.torque * sign, found.u)
        assert_allclose(fit.coulomb[0], 2.3e-3, rtol=0.02)
        assert_allclose(fit.viscous[0], 5.33e-5, rtol=0.03)
        # one speed alone shows the Stribeck effect: the line leaves it out
        assert fit.exponent is None
        assert fit.lowest >= 1


@pytest.mark.parametrize("largest", [2e-5, 4e-4])
def test_a_line_is_weighed_by_each_u_and_by_the_median_of_all(largest):
    """Of two variances, in equal parts; one u that is large changes no other weight."""
    rng, speed = np.random.default_rng(4), np.array([5.0, 10.0, 15.0, 20.0, 30.0])
    u = np.array([1e-5, 2e-5, largest, 1e-5, 3e-5])
    torque = 2e-3 + 5e-5 * speed + 1e-5 * rng.standard_normal(5)
    fit = fit_direction(speed, torque, u)
    weight = 1 / np.sqrt((u**2 + np.median(u) ** 2) / 2)
    viscous, coulomb = np.polyfit(speed, torque, 1, w=weight)
    assert fit.lowest == speed[0]
    assert_allclose((fit.coulomb[0], fit.viscous[0]), (coulomb, viscous), rtol=1e-6)


def test_stribeck_effect_is_found_where_data_carry_it():
    motor = Motor(stribeck_velocity=1.5, noise=0.05e-3)
    found = holds_of(motor, [0.4, 0.7, *SPEEDS[1:]])
    fit = fit_direction(found.speed, found.torque, found.u)
    assert fit.exponent == 2.0
    for (value, u), true in zip(
        (fit.coulomb, fit.viscous, fit.static, fit.stribeck_velocity),
        (2.3e-3, 5.33e-5, 4e-3, 1.5),
        strict=True,
    ):
        assert_allclose(value, true, rtol=0.06)
        assert abs(value - true) < 4 * u


@pytest.mark.parametrize("exponent", [1.0, 2.0])
def test_stribeck_fit_agrees_with_scipy(exponent):
    rng = np.random.default_rng(5)
    speed = np.geomspace(0.1, 30, 40)
    u = np.full(40, 8e-6)  # so little that no other model explains the points
    torque = curve(speed, 2.3e-3, 5e-5, 4e-3, 0.8, exponent) + u * rng.standard_normal(40)
    fit = fit_direction(speed, torque, u)
    start = [2e-3, 5e-5, 4e-3, 1.0]
    scipy, covariance = curve_fit(
        lambda v, *p: curve(v, *p, exponent), speed, torque, start, u, absolute_sigma=True
    )
    assert fit.exponent == exponent
    assert_allclose(fit.parameters, scipy, rtol=2e-3)
    ratio = np.diag(fit.covariance) / np.diag(covariance)
    assert_allclose(ratio, ratio[0], rtol=0.02)
    assert 0.98 < ratio[0] < 2.0  # the scatter decides where it is larger than stated


def test_errors_of_the_fit_scatter_as_stated():
    rng = np.random.default_rng(7)
    speed = np.array(SPEEDS[1:], dtype=float)
    errors = []
    for _ in range(200):
        # each point's uncertainty is itself an estimate with 12 degrees of freedom
        stated = 2e-5 * np.sqrt(rng.chisquare(12, len(speed)) / 12)
        torque = 2.3e-3 + 5.33e-5 * speed + 2e-5 * rng.standard_normal(len(speed))
        fit = fit_direction(speed, torque, stated)
        errors.append((fit.coulomb[0] - 2.3e-3) / fit.coulomb[1])
    assert 0.8 < np.std(errors) < 1.2


def test_an_effect_that_the_data_do_not_resolve_is_in_the_uncertainty():
    """The line is chosen; Stribeck curves that explain the holds as well have less friction."""
    rng = np.random.default_rng(17)
    speed = np.array([0.4, 0.45, 0.5, 0.55, 0.6, 0.75, *SPEEDS[1:]], dtype=float)
    pulls, widened, lines = [], [], 0
    for _ in range(60):
        u = np.full(len(speed), 3e-5)
        velocity = rng.uniform(0.3, 0.5)
        torque = curve(speed, 2.3e-3, 5e-5, 3.2e-3, velocity) + u * rng.standard_normal(len(speed))
        fit = fit_direction(speed, torque, u)
        if fit.exponent is None:
            lines += 1
            pulls.append((fit.coulomb[0] - 2.3e-3) / fit.coulomb[1])
            used = speed >= fit.lowest
            design = np.column_stack([np.ones(used.sum()), speed[used]]) / 3e-5
            widened.append(fit.coulomb[1] / np.sqrt(np.linalg.inv(design.T @ design)[0, 0]))
    assert lines >= 15
    # by scatter alone, the bias would be 1.5 u and more
    assert np.median(widened) > 1.2
    assert np.mean(np.abs(pulls) < 2) > 0.85


def test_an_effect_that_the_data_do_not_resolve_bends_no_line_to_one_side():
    """The line through it has too little slope and too much Coulomb friction, by most of u in
    the mean; the mean over the models that explain the holds does not lean."""
    rng = np.random.default_rng(29)
    speed = np.array([0.4, 0.45, 0.5, 0.55, 0.6, 0.75, *SPEEDS[1:]], dtype=float)
    pulls = []
    for _ in range(120):
        u = np.full(len(speed), spread := 10 ** rng.uniform(-5.0, -4.0))
        static, velocity = 2.3e-3 * rng.uniform(1, 2), rng.uniform(0.2, 0.5)
        noise = spread * rng.standard_normal(len(speed))
        fit = fit_direction(speed, curve(speed, 2.3e-3, 5e-5, static, velocity) + noise, u)
        if fit.exponent is None:
            (coulomb, coulomb_u), (viscous, viscous_u) = fit.coulomb, fit.viscous
            pulls.append([(coulomb - 2.3e-3) / coulomb_u, (viscous - 5e-5) / viscous_u])
    assert len(pulls) > 50
    assert np.all(np.abs(np.mean(pulls, axis=0)) < 0.3), np.mean(pulls, axis=0)


@given(
    coulomb=st.floats(1e-4, 1.0),
    relative=st.floats(1e-3, 0.2),
    scale=st.floats(0.01, 100),
)
@settings(max_examples=25, deadline=None)
def test_fit_follows_units(coulomb, relative, scale):
    speed = np.array(SPEEDS, dtype=float)
    torque = coulomb * (1 + relative * speed)
    u = np.full(len(speed), 1e-3 * coulomb)
    fit = fit_direction(speed * scale, torque, u)
    assert_allclose(fit.coulomb[0], coulomb, rtol=1e-6)
    assert_allclose(fit.viscous[0], coulomb * relative / scale, rtol=1e-6)


def test_both_directions_have_one_law():
    rng = np.random.default_rng(11)
    speed = np.geomspace(0.1, 30, 25)
    both = np.concatenate([speed, -speed])
    u = np.full(50, 6e-5)
    apart, pulls = 0, []
    for _ in range(60):
        friction = curve(speed, 2.3e-3, 5e-5, 3.4e-3, 0.8, 1.0)
        torque = np.concatenate([friction, -friction]) + u * rng.standard_normal(50)
        own = [
            fit_direction(speed, torque[:25], u[:25]).exponent,
            fit_direction(speed, -torque[25:], u[25:]).exponent,
        ]
        fits = fit_directions(both, torque, u)
        if None not in own and own[0] != own[1]:
            apart += 1
            assert fits[1].exponent == fits[-1].exponent
            velocities = [fit.stribeck_velocity for fit in fits.values()]
            mean = np.mean([value for value, _ in velocities])
            pulls.append((mean - 0.8) / (np.hypot(*(u for _, u in velocities)) / 2))
        elif own[0] == own[1]:
            assert [fit.exponent for fit in fits.values()] == own
    assert apart >= 3
    # a mean over two models was 15 standard uncertainties off; the shape itself may still be wrong
    assert np.median(np.abs(pulls)) < 4


def test_an_effect_that_one_direction_shows_alone_is_not_stated():
    """Noise makes the effect wider and lower there: here static friction would be 5 u low."""
    speed = np.array([0.4, 0.45, 0.5, 0.55, 0.6, 0.75, 1, 2, 3, 5, 8, 12, 16, 20, 25, 30])
    friction, u = curve(speed, 2.06e-3, 6.7e-5, 2.49e-3, 0.29), np.full(32, 7.5e-6)
    torque = np.append(friction, -friction) + u * np.random.default_rng(16).standard_normal(32)
    own = fit_direction(speed, torque[:16], u[:16]), fit_direction(speed, -torque[16:], u[16:])
    (shown,) = (fit for fit in own if fit.exponent is not None)
    assert shown.static[0] + 5 * shown.static[1] < 2.49e-3
    for fit in fit_directions(np.append(speed, -speed), torque, u).values():
        assert fit.exponent is None
        assert abs(fit.coulomb[0] - 2.06e-3) < 2.5 * fit.coulomb[1]
        assert abs(fit.viscous[0] - 6.7e-5) < 2.5 * fit.viscous[1]


@pytest.mark.parametrize("exponent", [1.0, 2.0])
def test_a_swing_of_the_speed_does_not_smooth_the_law(exponent):
    """The steps of the encoder swing the speed by up to a quarter: each hold is a mean of speeds,
    here of a sine, which a fit to the mean speeds takes for a higher and wider peak."""
    speed = np.array([0.4, 0.45, 0.5, 0.55, 0.6, 0.75, 1, 2, 3, 5, 8, 12, 16, 20, 25, 30])
    law = (2.77e-3, 6.1e-5, 5.4e-3, 0.34 if exponent == 2 else 0.25, exponent)
    swing = 0.25 * speed * (0.4 / speed) ** 1.5
    moments = speed + math.sqrt(2) * swing * np.sin(np.linspace(0, 2 * np.pi, 400))[:, None]
    u = np.full(len(speed), 3e-6)
    torque = curve(moments, *law).mean(axis=0)
    torque += u * np.random.default_rng(3).standard_normal(len(speed))
    for known, holds in ((swing, True), (None, False)):
        fit = fit_direction(speed, torque, u, {exponent: 0.0}, known)
        pulls = [
            (value - true) / own
            for (value, own), true in zip(
                (fit.static, fit.stribeck_velocity), law[2:4], strict=True
            )
        ]
        assert (np.max(np.abs(pulls)) < 3) == holds, pulls


def test_holds_in_which_the_speed_swings_are_fitted_as_means_over_it():
    """From holds to the law: the swing is what shakes each of them, in both directions."""
    speed = np.array([0.5, 0.55, 0.6, 0.75, 1, 2, 3, 5, 8, 12, 16, 20, 25, 30])
    both, shaking = np.append(speed, -speed), np.tile(0.25 * (0.5 / speed) ** 1.5, 2)
    moments = speed + speed * shaking[:14] * np.array([[-1.0], [1.0]])  # a square wave
    torque = curve(moments, 2.77e-3, 6.1e-5, 5.4e-3, 0.34).mean(axis=0)
    nothing = np.zeros(28)
    holds = Holds(
        both, np.append(torque, -torque), nothing + 4e-6, *[nothing] * 2, shaking, *[nothing] * 3
    )
    fits, *_ = fit_holds([holds])
    for fit in fits.values():
        assert fit.static[0] == pytest.approx(5.4e-3, abs=2 * fit.static[1])
        assert fit.static[1] < 0.3e-3


def test_a_curve_that_no_friction_model_explains_is_refused():
    # Appendix C: bumps against speed, repeatable and far beyond scatter
    speed = np.geomspace(0.5, 30, 14)
    torque = 2.3e-3 + 5.33e-5 * speed + 0.5e-3 * np.sin(2.5 * speed)
    fit = fit_direction(speed, torque, np.full(14, 1e-5))
    with pytest.raises(InsufficientDataError, match="No friction model explains"):
        require_explained([fit])


def test_the_same_bumps_within_scatter_are_not_structure():
    speed = np.geomspace(0.5, 30, 14)
    torque = 2.3e-3 + 5.33e-5 * speed + 0.5e-3 * np.sin(2.5 * speed)
    fit = fit_direction(speed, torque, np.full(14, 0.6e-3))
    require_explained([fit])
    assert fit.coulomb[1] > 1e-4


def test_noise_of_uncertain_size_is_not_structure():
    """Means of noisy holds, whose u rests on few degrees of freedom: intervals, no refusal."""
    random, pulls = np.random.default_rng(8), []
    speed = np.concatenate([np.geomspace(0.5, 30, 12), -np.geomspace(0.5, 30, 12)])
    for _ in range(30):
        noise = 0.35e-3 * random.standard_normal(24)
        u = 0.35e-3 * np.sqrt(random.chisquare(8, 24) / 8)
        fits = fit_directions(speed, 2.3e-3 * np.sign(speed) + 5e-5 * speed + noise, u)
        pulls += [(fit.coulomb[0] - 2.3e-3) / fit.coulomb[1] for fit in fits.values()]
    assert np.mean(np.abs(pulls) < 2.2) >= 0.9


@pytest.mark.parametrize(
    ("speed", "torque", "message"),
    [
        ([1.0, 2.0], [1e-3, 1e-3], "measure 3 speeds"),
        ([10.0, 11.0, 12.0], [1e-3, 1e-3, 1e-3], "factor of 2"),
        ([1.0, np.nan, 3.0], [1e-3, 1e-3, 1e-3], "speed is nan at sample 1"),
    ],
)
def test_bad_curves_are_refused(speed, torque, message):
    with pytest.raises(InsufficientDataError, match=message):
        fit_direction(np.array(speed), np.array(torque), np.full(len(speed), 1e-5))


def test_torque_along_the_motion_is_a_wrong_sign():
    speed = np.array(SPEEDS, dtype=float)
    fit = fit_direction(speed, -2e-3 - 5e-5 * speed, np.full(len(speed), 1e-5))
    with pytest.raises(InsufficientDataError, match="signs of current and encoder"):
        require_explained([fit])


def test_a_torque_that_does_not_depend_on_the_motion_is_no_friction():
    speed = np.array(SPEEDS, dtype=float)
    u = np.full(len(speed), 1e-5)
    with pytest.raises(InsufficientDataError, match="which may not change"):
        fit_directions(np.append(speed, -speed), np.full(2 * len(speed), 1e-3), np.append(u, u))


def test_a_constant_torque_above_friction_is_no_wrong_sign():
    speed = np.array(SPEEDS, dtype=float)
    u = np.full(len(speed), 1e-5)
    fits = [fit_direction(speed, 2e-3 + 5e-5 * speed + shift, u) for shift in (-5e-3, 5e-3)]
    require_explained(fits)


# -- offset against asymmetry


def test_offset_and_asymmetry_are_told_apart_by_levels_of_friction():
    level = np.array([2.3e-3, 2.4e-3, 3.7e-3, 4.75e-3])
    found = separate_offset(level, -0.4e-3 + 0.12 * level, np.full(4, 1e-5), np.zeros(4))
    assert found.separated
    assert_allclose(found.offset[0], -0.4e-3, rtol=1e-9)
    assert_allclose(found.asymmetry[0], 0.12, rtol=1e-9)
    assert found.offset[1] > 0.1 * 0.12 * 2.3e-3  # proportionality is an assumption


def test_one_level_of_friction_leaves_offset_and_asymmetry_together():
    found = separate_offset(np.full(5, 2.3e-3), np.full(5, 0.1e-3), np.full(5, 1e-5), np.zeros(5))
    assert not found.separated
    assert_allclose(found.offset[0], 0.1e-3, rtol=1e-9)
    assert found.offset[1] >= 0.1e-3
    assert found.asymmetry[0] == 0


@pytest.mark.parametrize(("asymmetry_u", "separated"), [(0.095, True), (0.105, False)])
def test_an_asymmetry_is_separated_that_is_known_to_a_tenth(asymmetry_u, separated):
    """Otherwise a tenth of friction may be in the offset: u of a slope, written out."""
    level = np.array([2.3e-3, 2.4e-3, 3.7e-3, 4.75e-3])
    u = asymmetry_u * math.sqrt(np.sum((level - level.mean()) ** 2))
    found = separate_offset(level, np.zeros(4), np.full(4, u), np.zeros(4))
    assert found.separated == separated
    assert found.asymmetry == pytest.approx((0.0, asymmetry_u if separated else 0.1), abs=1e-12)
    if not separated:
        assert found.offset[1] == pytest.approx(math.hypot(u / 2, 0.1 * level.mean()))


@pytest.mark.parametrize("spanned", [0.1e-3, 1.5e-3])
def test_offset_and_asymmetry_scatter_by_their_uncertainty(spanned):
    """Viscous friction that differs between directions shows at the same speeds."""
    random = np.random.default_rng(11)
    speed = np.array([0.2, 0.5, 1, 2, 3, 5, 8, 12, 16, 20, 25, 30])
    level = 2.3e-3 + spanned * np.exp(-((speed / 1.0) ** 2))
    u = np.full(len(speed), 2e-5)
    errors = []
    for _ in range(300):
        middle = -0.05e-3 + 0.01 * level + 4e-6 * speed + random.normal(0, u)
        found = separate_offset(level, middle, u, speed)
        (offset, offset_u), (asymmetry, asymmetry_u) = found.offset, found.asymmetry
        errors.append([(offset + 0.05e-3) / offset_u, (asymmetry - 0.01) / asymmetry_u])
        assert found.separated == (spanned > 1e-3)
    scatter = np.sqrt(np.mean(np.square(errors), axis=0))
    if spanned > 1e-3:
        assert np.all((scatter > 0.8) & (scatter < 1.15)), scatter
    else:
        assert np.all(scatter < 1), scatter


# -- torque against speed


def test_torque_speed_curve_is_friction_and_knows_no_ripple():
    motor = Motor(noise=0.0)
    signals = motor.sweep()
    found = torque_speed_curve(
        time=signals["time"],
        setpoint=signals["setpoint"],
        torque=signals["torque"],
        inertia=motor.inertia,
    )
    assert len(found.speed) == 60
    turning = found.revolutions >= 1
    assert np.count_nonzero(turning) > 40
    assert_allclose(found.torque[turning], motor.friction(found.speed[turning]), rtol=0.02)


def test_a_constant_speed_is_no_sweep():
    time = np.arange(1000) * 1e-3
    with pytest.raises(InsufficientDataError, match="a sweep runs through speeds"):
        torque_speed_curve(time=time, setpoint=3 * time, torque=time, inertia=1e-5)


def test_a_sweep_in_coarse_steps_is_refused():
    """No two samples in a row lie in one range of speed."""
    time = np.arange(400) * 0.01
    setpoint = np.cumsum(np.tile([1.0, 2.0, 3.0, 1.0], 100)) * 0.01
    with pytest.raises(InsufficientDataError, match="too coarse for a curve"):
        torque_speed_curve(time=time, setpoint=setpoint, torque=time, inertia=1e-5)


# -- the amplifier at low current


@pytest.mark.parametrize(("gain", "offset"), [(1.0, 0.0), (1.05, 0.01)])
def test_a_healthy_amplifier_passes(gain, offset):
    rng = np.random.default_rng(1)
    setpoint = 0.05 + 0.02 * rng.standard_normal(20000)
    current = offset + gain * setpoint + 1e-3 * rng.standard_normal(20000)
    deviation_at_low_current(
        current_setpoint=setpoint, current=current, sample_time=0.02, friction_current=0.05
    )


def test_noise_of_the_current_reading_is_not_blamed_on_the_amplifier():
    rng = np.random.default_rng(1)
    setpoint = 0.05 + 0.02 * rng.standard_normal(20000)
    current = setpoint + 0.2 * rng.standard_normal(20000)
    signals = {"current_setpoint": setpoint, "current": current}
    assert not deviation_at_low_current(**signals, sample_time=0.02, friction_current=0.05)


def test_an_amplifier_with_steps_is_refused():
    rng = np.random.default_rng(1)
    setpoint = 0.05 + 0.02 * rng.standard_normal(20000)
    current = setpoint + 5e-3 * np.sin(2 * np.pi * setpoint / 0.02)
    with pytest.raises(InsufficientDataError, match="not linear at low current"):
        deviation_at_low_current(
            current_setpoint=setpoint, current=current, sample_time=0.02, friction_current=0.05
        )


@pytest.mark.parametrize("steps", [0.0, 5e-3])
def test_a_current_that_lags_behind_a_shaking_set_point_is_not_blamed_on_the_amplifier(steps):
    """A lag of 0.2 ms behind steps of an encoder that shake some holds by ten times as much."""
    rng = np.random.default_rng(1)
    friction = np.repeat(np.linspace(-0.06, 0.06, 20), 10000)
    shaking = np.repeat([0.01, 0.1], 100000) * rng.standard_normal(200000)
    shaking -= np.roll(shaking, 1)  # a loop that holds the angle
    setpoint = friction + shaking
    lagging = friction + 0.8 * shaking + 0.2 * np.roll(shaking, 1)
    signals = {
        "current_setpoint": setpoint,
        "current": lagging + steps * np.sin(2 * np.pi * friction / 0.04),
    }
    if not steps:
        assert deviation_at_low_current(**signals, sample_time=1e-3, friction_current=0.03) < 6e-4
        return
    with pytest.raises(InsufficientDataError, match="not linear at low current"):
        deviation_at_low_current(**signals, sample_time=1e-3, friction_current=0.03)


@pytest.mark.parametrize(
    ("gain", "linearity", "passes"),
    [
        (1.0, 0.0, True),
        (1.007, 0.0, True),
        (1.02, 0.0, False),
        (0.95, 0.0, False),
        (0.95, 1.5e-3, True),  # an amplifier that bends by that much may have this slope here
    ],
)
def test_another_amplifier_than_the_calibrated_one_is_refused(gain, linearity, passes):
    rng = np.random.default_rng(2)
    # holds in both directions, in which the loop shakes and the current lags
    asked = np.repeat([0.06, -0.05], 20000)
    shaking = 0.02 * rng.standard_normal(len(asked))
    shown = 1e-3 + gain * asked + 0.7 * shaking + 1e-3 * rng.standard_normal(len(asked))
    signals = {"current_setpoint": asked + shaking, "current": shown, "deviation": linearity}
    known = {"calibrated": Quantity(1.0, "1", 1e-5), "allowed": 0.01}
    if passes:
        require_calibrated_gain(**signals, **known)
        return
    with pytest.raises(InsufficientDataError, match=r"but by 1 in the.*calibrate-kt again"):
        require_calibrated_gain(**signals, **known)


def test_count_is_the_encoders():
    # the helper quantises like the encoder that it stands for
    signals = Motor(noise=0.0).hold([3.0])
    steps = signals["angle"] / COUNT
    assert_allclose(steps, np.round(steps), atol=1e-6)


def test_few_speeds_hold_what_a_stribeck_effect_that_they_do_not_resolve_may_change():
    """Five speeds leave no residuals to choose a curve by: it is possible, and in u."""
    rng = np.random.default_rng(12)
    ratios = []
    for _ in range(60):
        speed = np.sort(np.exp(rng.uniform(np.log(0.4), np.log(30), 5)))
        velocity, coulomb, viscous = rng.uniform(0.3, 1.5), 2e-3, rng.uniform(2e-5, 8e-5)
        torque = coulomb * (1 + np.exp(-((speed / velocity) ** 2))) + viscous * speed
        torque += 1e-5 * rng.standard_normal(speed.size)
        try:
            fit = fit_direction(speed, torque, np.full(speed.size, 1e-5))
        except InsufficientDataError:  # all speeds fall
            continue
        limit = stats.t.ppf(0.975, fit.dof)
        for (value, u), true in ((fit.coulomb, coulomb), (fit.viscous, viscous)):
            ratios.append(abs(value - true) / u / limit)
    assert len(ratios) > 80
    assert np.mean(np.array(ratios) < 1) > 0.9
    assert max(ratios) < 5 / 1.96


def test_friction_that_falls_with_the_speed_shows_no_coulomb_and_viscous_friction():
    speed = np.array([0.5, 0.7, 0.9, 1.2])
    falling = 2e-3 + 2e-3 * np.exp(-((speed / 1.5) ** 2)) + 4e-5 * speed
    with pytest.raises(InsufficientDataError, match=r"falls from 0\.5 to 1\.2 rad/s.*hold higher"):
        fit_direction(speed, falling, np.full(4, 1e-5))
    level = fit_direction(speed, np.full(4, 2e-3) + 1e-6 * speed, np.full(4, 1e-5))
    assert level.viscous[0] == pytest.approx(1e-6, abs=2 * level.viscous[1])
