"""What hypotheses make of mean staircases."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from rigtool.experiments.torque_constant.staircases import fit
from rigtool.experiments.torque_constant.staircases.arm_motion import (
    Arm,
    Contacts,
    one_sided,
    within_limits,
)
from rigtool.experiments.torque_constant.staircases.fit import fit_staircases
from rigtool.experiments.torque_constant.staircases.friction_of_each import friction_of_each
from rigtool.experiments.torque_constant.staircases.hypotheses import weigh_hypotheses
from rigtool.experiments.torque_constant.staircases.mean_staircases import (
    ASYMMETRY,
    MeanStaircases,
)
from rigtool.experiments.torque_constant.staircases.model import Common, arrange, winding
from rigtool.experiments.torque_constant.staircases.swings import (
    friction_state,
    mean_courses,
    straight_path,
)
from rigtool.numerics.residual_covariance import independent_samples
from tests.experiments.torque_constant.bench import Bench, plateaus_in


def test_friction_is_the_bench_s_and_none_where_a_hypothesis_has_none():
    bench = Bench(friction=4e-3, force_noise=1e-4, ripple=(), saturation=0.0)
    signals = bench.record((20, 50), angles=2)
    stairs = arrange(plateaus_in(signals))
    found = weigh_hypotheses(stairs, bench.coefficient, np.zeros(4))
    assert found.means.contacts(found.weighed.best).level == pytest.approx(4e-3, rel=0.05)
    without = type(found.weighed.best)(None, 1.0, None, 30.0)
    assert found.means.contacts(without).level == 0.0
    assert found.means.plateaus == 41


@pytest.fixture(scope="module")
def stairs():
    signals = Bench(saturation=0.0).record((20, 50), angles=2)
    return arrange(plateaus_in(signals))


@pytest.mark.parametrize("friction", [2e-3, -2e-3, 0.06])
@pytest.mark.parametrize("loss", [1e-4, -1e-4])
def test_a_hypothesis_leaves_what_least_squares_leave_of_the_mean_staircase(stairs, friction, loss):
    """Friction opposes motion and is not most of the torque; no magnet gains by heat: what least
    squares find of that stays with the hypothesis that has no heat."""
    rng = np.random.default_rng(3)
    coefficient, s, tau, exponent = -1e-3, 0.012, 25.0, 1.5
    trend = np.array([-1.0, -1.0, 1.0, 1.0]) / 60
    heat, warmth = winding(stairs, tau)
    drift = warmth - warmth.mean(axis=1, keepdims=True)
    current = stairs.current * (1 + coefficient * drift)
    a, b = (each[0] for each in friction_state(straight_path(stairs.courses), s, exponent))
    torque = 0.05 * current * (1 - loss * heat) - friction * a + 0.01
    torque = torque * np.array([1.0, 1.0, 0.97, 0.97])[:, None]
    torque = torque + 1e-5 * rng.standard_normal(torque.shape)
    means = MeanStaircases(replace(stairs, torque=torque), coefficient, trend)
    count = torque.shape[1]
    assert means.dof == count - 7
    axes = [np.log([s / exponent]), np.log([tau]), np.log([exponent])]
    found = means.try_all(axes)
    free, square, slope, variance = (each[0, int(loss > 0)] for each in found[:4])
    common = Common(None if free else s, exponent, None, tau)
    mean = current.mean(axis=0)
    columns = [mean, np.ones(count), stairs.last_step[0]]
    if loss > 0:
        columns.append((current * heat).mean(axis=0))
    if friction > 0:
        columns += [-a, -b]
    both = np.column_stack([torque.mean(axis=0), trend @ torque])

    def fitted(columns):
        design = np.column_stack(columns)
        found = np.linalg.lstsq(design, both, rcond=None)[0]
        return found, np.sum((both - design @ found)[:, 0] ** 2)

    _, left = fitted([*columns, mean * np.abs(mean)])
    without_curve, _ = fitted(columns)
    if friction > 0.25 * np.ptp(torque.mean(axis=0)):
        assert square == np.inf
        return
    # what least squares find of friction is possible, or else next to none is
    assert square == pytest.approx(left, rel=1e-6 if friction > 0 else 0.3)
    np.testing.assert_allclose(slope[0], without_curve[0, 0], rtol=1e-6 if friction > 0 else 2e-4)
    # a loss by heat does not change with the temperature; friction may, by little, or may not
    heat_free = columns[:3] + columns[3 + (loss > 0) :]
    expected = fitted([*heat_free[:3], *heat_free[4:]])[0][0, 1]
    assert slope[2] == pytest.approx(expected, rel=1e-6 if friction > 0 else 0.01)
    if friction > 0:
        every = [*columns, mean * np.abs(mean)]
        rest = both - np.column_stack(every) @ fitted(every)[0]
        row = np.zeros((1, len(heat_free)))
        row[0, 3] = np.sqrt(rest[:, 1] @ rest[:, 1] / means.dof)
        row[0, 3] /= 5e-3 * fitted(every)[0][len(columns) - 2, 0]
        design = np.vstack([np.column_stack(heat_free), row])
        expected = np.linalg.lstsq(design, np.append(both[:, 1], 0.0), rcond=None)[0][0]
    assert slope[1] == pytest.approx(expected, rel=1e-6 if friction > 0 else 0.01)
    assert (variance[0] > 0) == (friction < 0)
    assert free == (friction < 0)
    if loss < 0:
        assert found[1][0, 1] == pytest.approx(square, rel=0.3)
    # of a loss by heat both signs are found, with the scatter that least squares state
    value, lost_variance, lost_square = found[4][0]
    columns = [mean, np.ones(count), stairs.last_step[0], (current * heat).mean(axis=0)]
    columns += [-a, -b] if friction > 0 else []
    least, _ = fitted(columns)
    _, left = fitted([*columns, mean * np.abs(mean)])
    inverse = np.linalg.pinv(np.column_stack(columns))[3]
    scatter = inverse @ inverse * left / means.dof / least[0, 0] ** 2
    exact = 1e-6 if friction > 0 else 0.05
    lost = -least[3, 0] / least[0, 0]
    assert value == pytest.approx(lost * common.warming(), rel=1e-2 if loss < 0 else exact)
    if friction > 0:
        assert lost_variance == pytest.approx(scatter * common.warming() ** 2, rel=1e-2)
        assert lost_square == pytest.approx(left, rel=1e-6)
    if friction > 0 and loss > 0:
        rest = means.residual(common)
        assert rest @ rest == pytest.approx(left, rel=1e-6)
        used = np.ones(count, dtype=bool)
        assert means.independent(common) == independent_samples(rest, used, 1) - 7


@pytest.fixture(scope="module")
def swinging_arm():
    """Return mean staircases of two temperatures and two angles, the law of their friction, and the
    states (m, p) of friction that arms with ten times as fine steps of their motion have.

    Torques at rest differ by the constant, which falls with the temperature, and by ripple.
    """
    law = Common(0.02, 1.0, 0.011, 30.0)
    level, parts, size = 6e-3, 96, np.array([1.0, 1.01, 0.97, 0.98])
    up = np.arange(9.0)
    setpoint = np.tile(np.concatenate([up, up[-2::-1]]), (4, 1))
    arm = Arm(frequency=55.0, lag=law.lag, steps=40)
    rest = 0.01 * size[:, None] * setpoint
    bare = mean_courses(
        setpoint,
        rest,
        np.repeat(rest[:, :, None], parts, axis=2),
        np.full(rest.shape, 0.4),
        np.array([20.0, 20.0, 50.0, 50.0]),
        noise=1e-9,
    )
    bare = replace(bare, torque=rest, course=bare.course[[0] * 4], part=bare.part[[0] * 4])
    contacts = Contacts(level, np.zeros(rest.shape), law.transition, law.exponent)
    # The motor's torque is what the gauge shows at rest, and friction: found by repetition.
    for _ in range(20):
        a, _ = arm.friction_state(bare, contacts)
        contacts = replace(contacts, state=np.column_stack([np.zeros(4), a[:, 1:]]))
    course = rest[:, :, None] + arm.swings(bare, contacts)
    stairs = SimpleNamespace(
        courses=mean_courses(
            setpoint,
            rest,
            course,
            np.full(rest.shape, 0.4),
            np.array([20.0, 20.0, 50.0, 50.0]),
            noise=1e-9,
        ),
        weight=np.ones(rest.shape),
        torque=rest,
        last_step=np.diff(setpoint, axis=1, prepend=0.0),
        current=setpoint,
        temperature=np.full(rest.shape, 20.0),
        begin=np.arange(17) * 0.4 + 100 * np.arange(4)[:, None],
        middle=np.arange(0.5, 17) * 0.4 + 100 * np.arange(4)[:, None],
        end=np.arange(1, 18) * 0.4 + 100 * np.arange(4)[:, None],
    )
    means = MeanStaircases(stairs, 0.0, np.zeros(4))
    means.arm = replace(arm, steps=4)
    means._time_constant = law.time_constant
    return means, law, contacts


def mean_of(contacts: Contacts) -> Contacts:
    """Return the friction of the mean staircase as one hypothesis of several at once."""
    return Contacts(
        np.array([[contacts.level]]),
        contacts.state.mean(axis=0)[None, None],
        np.array([[contacts.transition]]),
        np.array([[contacts.exponent]]),
    )


def test_friction_of_each_staircase_is_on_average_that_of_the_mean(swinging_arm, monkeypatch):
    """Under a law for which the motion shows other friction than that with which the arm moves."""
    means, law, contacts = swinging_arm
    shown = replace(contacts, level=5 * contacts.level, state=contacts.state.mean(axis=0)[None])
    monkeypatch.setattr(means, "_moves", lambda *_: mean_of(contacts))
    monkeypatch.setattr(means, "contacts", lambda common: shown)
    mean, each = means._friction_under(law)[0], friction_of_each(means, law)[0]
    assert np.abs(each.mean(axis=0) - mean[0]).max() < 0.01


def test_friction_of_each_staircase_follows_its_own_torque(swinging_arm, monkeypatch):
    """Turns count only above the noise of a course; the arm's motion has the smaller ones, too."""
    means, law, contacts = swinging_arm
    courses = replace(means.stairs.courses, noise=np.array([1e-4]))
    monkeypatch.setattr(means.stairs, "courses", courses)
    monkeypatch.setattr(means, "moves", lambda common: mean_of(contacts))
    by_arm = friction_of_each(means, law)[0]
    monkeypatch.setattr(means, "arm", None)
    by_turns = friction_of_each(means, law)[0]
    off, rough = (np.abs(-each - contacts.state)[:, 1:].max() for each in (by_arm, by_turns))
    assert off < 3e-3
    assert rough > 2 * off
    assert np.ptp(contacts.state[:, 1:], axis=0).max() > 8e-3
    assert friction_of_each(means, replace(law, transition=None)) == ()


def test_friction_of_each_staircase_begins_with_its_own(swinging_arm, monkeypatch):
    """Against motions that begin with it; that of the mean changes the way, too."""
    means, law, contacts = swinging_arm
    courses, begins = means.stairs.courses, np.array([-0.4, 0.1, 0.5, -0.2])
    monkeypatch.setattr(means, "moves", lambda common: mean_of(contacts))
    torque, course, _ = courses.of_each()
    each = replace(courses, torque=torque, course=course, part=courses.part[[0] * 4])
    arms = replace(means.arm, steps=40)
    own = contacts
    for _ in range(20):
        own = replace(own, state=np.column_stack([begins, own.state[:, 1:]]))
        a, b = arms.friction_state(each, own)
        own = replace(own, state=a + b * begins[:, None])

    def off(*known) -> float:
        a, b = friction_of_each(means, law, *known)
        return float(np.abs(-a - b * begins[:, None] - own.state)[:, 1:].max())

    assert off(begins) < 5e-3
    assert off() > 3 * off(begins)


def test_friction_that_differs_by_temperature_moves_each_arm(swinging_arm, monkeypatch):
    means, law, contacts = swinging_arm
    courses, sizes = means.stairs.courses, np.array([1.3, 1.3, 0.7, 0.7])
    monkeypatch.setattr(means, "moves", lambda common: mean_of(contacts))
    torque, course, _ = courses.of_each()
    each = replace(courses, torque=torque, course=course, part=courses.part[[0] * 4])
    arms, begins = replace(means.arm, steps=40), np.zeros(4)
    own = replace(contacts, level=contacts.level * sizes)
    for _ in range(20):
        own = replace(own, state=np.column_stack([begins, own.state[:, 1:]]))
        own = replace(own, state=arms.friction_state(each, own)[0])

    def off(*known) -> float:
        return float(np.abs(-friction_of_each(means, law, *known)[0] - own.state)[:, 1:].max())

    assert off(begins, sizes) < 0.3 * off(begins)


@pytest.fixture
def motion(monkeypatch):
    """Return what finds the friction with which staircases begin, and which moves their arms."""
    asked = []

    def spied(means, common, *known):
        asked.append(known)
        return friction_of_each(means, common, *known)

    def motion(signals):
        plateaus = plateaus_in(signals)
        slopes = fit_staircases(plateaus)
        return slopes, *asked[-1]

    monkeypatch.setattr(fit, "friction_of_each", spied)
    return motion


def test_each_staircase_is_fitted_with_the_friction_with_which_it_begins(motion):
    """Cogging of order 2 winds each arm before its staircase: friction opposes that."""
    bench = Bench(friction=4e-3, force_noise=1e-4, cogging=5e-3)
    slopes, begins, _ = motion(bench.record((20,), angles=8))
    assert np.ptp(begins) > 0.2
    assert abs(np.corrcoef(begins, slopes.zero)[0, 1]) > 0.9


def test_each_arm_is_moved_with_the_friction_at_its_temperature(motion):
    bench = Bench(friction=8e-3, force_noise=1e-4, ripple=(), saturation=0.0)
    cold, warm = (
        replace(bench, friction=size * bench.friction).record((degc,), angles=2)
        for size, degc in ((1.1, 20), (0.9, 50))
    )
    warm["time"] = warm["time"] + cold["time"][-1] + 600.0
    _, _, sizes = motion({name: np.concatenate([cold[name], warm[name]]) for name in cold})
    np.testing.assert_allclose(sizes, [1.1, 1.1, 0.9, 0.9], atol=0.01)


@pytest.mark.parametrize("asymmetry", [-0.15, 0.0, 0.15])
def test_friction_that_is_larger_in_one_direction_is_found(asymmetry):
    bench = Bench(asymmetry=asymmetry, force_noise=1e-4, ripple=(), saturation=0.0)
    signals = bench.record((20, 50), angles=2)
    stairs = arrange(plateaus_in(signals))
    means = MeanStaircases(stairs, bench.coefficient, np.zeros(4))
    common = Common(bench.stiffness * bench.presliding_angle, 1.0, None, bench.time_constant)
    for _ in range(3):
        doubt = means.find_asymmetry(common)
    assert means.asymmetry == pytest.approx(asymmetry, abs=0.04)
    assert 0 < doubt < 0.04
    assert means.find_asymmetry(replace(common, transition=None)) == 0.0


@pytest.mark.parametrize("asymmetry", [-2.0, -0.5, 0.2, 0.5, 2.0])
def test_friction_of_any_asymmetry_grows_with_its_state(asymmetry):
    ends = np.array([-1.0, 1.0])
    _, slope = one_sided(ends, np.ones(2), within_limits(asymmetry))
    assert slope.min() > 0.05


def test_an_asymmetry_that_friction_s_law_may_explain_is_as_uncertain_as_it_scatters():
    """Transition and exponent are not known beforehand."""
    quiet = {"force_noise": 1e-6, "ripple": (), "saturation": 0.0}
    bench = Bench(presliding_angle=3e-3, friction=4e-3, **quiet)
    signals = bench.record((20, 50), angles=2)
    stairs = arrange(plateaus_in(signals))
    common = Common(bench.stiffness * bench.presliding_angle, 1.0, None, bench.time_constant)
    rng, found, doubts = np.random.default_rng(1), [], []
    for _ in range(60):
        noise = 3e-5 * rng.standard_normal(stairs.torque.shape)
        means = MeanStaircases(replace(stairs, torque=stairs.torque + noise), -1e-3, np.zeros(4))
        doubts.append(means.find_asymmetry(common))
        known = 1 - (doubts[-1] / ASYMMETRY) ** 2
        found.append(means.asymmetry / known)
    own = np.array(doubts) / np.sqrt(1 - (np.array(doubts) / ASYMMETRY) ** 2)
    assert np.std(found) == pytest.approx(np.sqrt(np.mean(own**2)), rel=0.3)
