"""Ripple of another power-up is found in the torque, that of the learned one is left alone."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import butter, lfilter

from rigtool.experiments.force_filter.plant import GRASPER, HOUSING, SPEED, STATES, TORQUE
from rigtool.experiments.force_model.deviations import Deviations
from rigtool.experiments.force_model.force_model import ForceModel
from rigtool.experiments.force_model.learning import LearnedModel
from rigtool.experiments.force_model.model import Kind, Known, Shape, Term
from rigtool.experiments.force_model.sliding_problem import SLIDING_PARAMETERS
from rigtool.experiments.force_sensor.power_up.power_up import PowerUp
from rigtool.experiments.force_sensor.sensor import Sensor
from tests.experiments.deploy import sensors

STEP, BANDWIDTH = 1e-3, 10.0
FACTOR, LAG, RATIO = 1.2, 0.05, 0.85
LEARNED = {(1, 0): 0.3e-3, (1, 1): -0.2e-3, (2, 0): 0.1e-3, (2, 1): 0.8e-3}
OTHER = {(1, 0): -0.1e-3, (1, 1): 0.4e-3, (2, 0): 0.7e-3, (2, 1): -0.3e-3}
STROKE, CONSTANT, MASS = 0.3e-3, 0.045, 3e-3


def model(uncertain=0.0, growing=(), waves=LEARNED):
    """Return a model: `uncertain` is what waves are off by beyond what was learned, N m; `growing`
    are kind, order and quarter of ripple by the current, and size; `waves` the learned ripple."""
    terms = [Term(Kind.BEARING, 1.0), Term(Kind.HOUSING, 1.0)]
    terms += [Term(Kind.RIPPLE, 1e-3, *key) for key in waves]
    terms += [Term(kind, 1.0, *key) for kind, *key, _ in growing]
    coefficient = np.array([2e-3, 9e-3, *waves.values(), *(size for *_, size in growing)])
    shape = Shape(2e-3, 8e-3, 5e-3, 0.3, LAG, 0.2, 8e-4, 1e-3, 2e-6, 1.8e-3)
    size = len(SLIDING_PARAMETERS) + len(terms)
    known, covariance = Known(RATIO, FACTOR, 2e-5), uncertain**2 * np.eye(size)
    learned = LearnedModel(tuple(terms), shape, known, coefficient, covariance, np.ones(2))
    return ForceModel(learned, Deviations(STROKE, 0.01, 0.1e-3, 0.15))


def motion(seconds=40.0, way=1.25):
    """Strokes of twice a way, rad: angles and the filter's states, but for the torque."""
    time = np.arange(round(seconds / STEP)) * STEP
    angle = 1.25 + way * np.sin(0.8 * time)
    states = np.zeros((len(time), STATES))
    states[:, GRASPER] = angle / RATIO
    states[:, SPEED] = np.gradient(angle, STEP)
    states[:, HOUSING] = np.clip(3.75 / way * states[:, SPEED], -1, 1)
    return time, angle, states


def follows(states, current=0.0):
    """Return gains that do not count, as the motion is so slow that the bearings hold the rotor;
    the motor's torque and current; and that nothing is taken off the filter's drive torque."""
    drive = np.tile([CONSTANT * current, current], (len(states), 1))
    return np.zeros((len(states), 6)), drive, np.zeros(len(states))


def ripple(coefficients, angle):
    """Return a ripple behind its lag, N m at the output."""
    waves = sum(
        value * (np.sin if quarter else np.cos)(order * angle)
        for (order, quarter), value in coefficients.items()
    )
    kept, found, y = np.exp(-STEP / LAG), np.empty(len(angle)), waves[0]
    for k, wave in enumerate(waves):
        y = kept * y + (1 - kept) * wave
        found[k] = y
    return FACTOR * found


def noise(time, states, seed=3):
    """Return what strokes deviate by, each by its own."""
    number = np.cumsum(np.abs(np.diff(np.sign(states[:, SPEED]), prepend=0.0)) > 0)
    return STROKE * np.random.default_rng(seed).standard_normal(number.max() + 1)[number]


def contact(time):
    """Return pulses of 30 mN m that come and go."""
    return np.where(time % 7.0 > 5.0, 30e-3, 0.0)


@pytest.fixture(scope="module")
def another():
    time, angle, states = motion()
    added = ripple(OTHER, angle) - ripple(LEARNED, angle)
    states[:, TORQUE] = contact(time) + noise(time, states) + added
    power_up = PowerUp(model(), STEP, BANDWIDTH)
    found, variance, *_ = power_up.add(angle, states, *follows(states))
    return power_up, angle, states, added, found, variance


def test_ripple_of_another_power_up_is_found_under_contacts(another):
    power_up, angle, states, added, found, variance = another
    assert power_up.probability > 0.99
    late = slice(round(10 / STEP), None)
    assert np.sqrt(np.mean((found - added)[late] ** 2)) < 0.35 * np.sqrt(np.mean(added**2))
    assert np.mean(np.abs(found - added)[late] < 1.96 * np.sqrt(variance[late])) > 0.95
    whole, left, _ = power_up.again()(angle, states[:, TORQUE])
    assert np.sqrt(np.mean((whole - added) ** 2)) < 0.3 * np.sqrt(np.mean(added**2))
    assert np.mean(np.abs(whole - added) < 1.96 * np.sqrt(left)) > 0.95


@pytest.mark.parametrize("slow", [0.2, 1.01])
def test_a_rotor_that_creeps_shows_no_ripple(another, slow):
    """The fastest turns by 1 rad/s, and slides from 0.3 rad/s on."""
    plain, angle, states, _, found, _ = another
    power_up = PowerUp(model(), STEP, BANDWIDTH, slow)
    own, *_ = power_up.add(angle, states, *follows(states))
    if slow < 0.3:
        np.testing.assert_array_equal(own, found)
    else:
        none = PowerUp(model(), STEP, BANDWIDTH).probability
        assert power_up.probability == pytest.approx(none, abs=1e-6) != plain.probability


def test_rows_see_the_torque_as_if_nothing_had_been_taken_off(another):
    """Where the bearings hold the rotor, the filter's torque lacks within 12 ms what was taken."""
    plain, angle, states, _, found, variance = another
    power_up, felt, first, parts = PowerUp(model(), STEP, BANDWIDTH), [0.0], 0, []
    while first < len(angle):
        part = slice(first, first + power_up.steps_ahead)
        taken = power_up.ahead(angle[part])
        for torque in taken:
            felt.append(felt[-1] + (1 - np.exp(-STEP / 12e-3)) * (torque - felt[-1]))
        own = states[part].copy()
        own[:, TORQUE] -= FACTOR * np.array(felt[-len(taken) :])
        parts.append(power_up.add(angle[part], own, *follows(own)[:2], taken))
        first += len(taken)
    left, doubt, *_ = (np.concatenate(values) for values in zip(*parts, strict=True))
    section = butter(2, BANDWIDTH, fs=1 / STEP)
    np.testing.assert_allclose(left, found - FACTOR * lfilter(*section, felt[1:]), atol=1e-12)
    np.testing.assert_allclose(doubt, variance, rtol=1e-6)
    assert power_up.probability == pytest.approx(plain.probability)
    late = slice(round(10 / STEP), None)
    assert np.std(felt[1:][late]) > 0.5e-3
    assert np.std(left[late]) < 0.2 * np.std(found[late])


def in_unit(own, unit):
    """Return a model whose torques are in another unit than N m."""
    learned, shape, known = own.learned, own.learned.shape, own.learned.known
    names = ("stiffness", "damping", "tip_friction", "grasper_inertia", "load_onset")
    changed = {name: unit * getattr(shape, name) for name in names}
    deviations = replace(
        own.deviations, stroke=unit * own.deviations.stroke, noise=unit * own.deviations.noise
    )
    return ForceModel(
        replace(
            learned,
            terms=tuple(replace(term, spread=unit * term.spread) for term in learned.terms),
            shape=replace(shape, **changed),
            known=replace(known, inertia=unit * known.inertia),
            coefficient=unit * learned.coefficient,
            covariance=unit**2 * learned.covariance,
        ),
        deviations,
    )


@pytest.mark.parametrize("gain", [0.0, 0.01])
def test_the_unit_of_torque_changes_nothing(gain):
    """Also where the filter follows by its own gains instead of bearings that hold the rotor."""
    time, angle, states = motion(15.0)
    added = ripple(OTHER, angle) - ripple(LEARNED, angle)
    states[:, TORQUE] = ramps(time, 4e-3, 8.0) + contact(time) + noise(time, states) + added
    unit, results = 64.0, []
    for scale in (1.0, unit):
        gains, drive, taken = follows(states)
        gains += gain * np.array([1.0, 1.0, 1.0, scale, scale, scale])
        scaled = states.copy()
        scaled[:, TORQUE] *= scale
        power_up = PowerUp(in_unit(model(1e-4), scale), STEP, BANDWIDTH)
        found, variance, less, *_ = power_up.add(angle, scaled, gains, drive, taken)
        whole, left, _ = power_up.again()(angle, scaled[:, TORQUE])
        torques, variances = np.stack([found, less, whole]), np.stack([variance, left])
        results.append((torques / scale, variances / scale**2, power_up.probability))
    for one, other in zip(*results, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-6, atol=1e-12)


def test_motion_over_a_small_part_of_a_turn_shows_the_mean_of_the_ripple_there():
    """But for a part that a load which hangs may have as well."""
    time, angle, states = motion(way=0.25)
    added = ripple(OTHER, angle) - ripple(LEARNED, angle)
    states[:, TORQUE] = contact(time) + noise(time, states) + added
    power_up = PowerUp(model(), STEP, BANDWIDTH)
    found, variance, *_ = power_up.add(angle, states, *follows(states))
    late = slice(round(20 / STEP), None)
    assert abs(added[late].mean()) > 0.8e-3
    assert abs((found - added)[late].mean()) < 0.3 * abs(added[late].mean())
    assert np.mean(np.abs(found - added)[late] < 1.96 * np.sqrt(variance[late])) > 0.95


def test_the_learned_power_up_changes_nothing():
    time, angle, states = motion()
    states[:, TORQUE] = contact(time) + noise(time, states)
    power_up = PowerUp(model(), STEP, BANDWIDTH)
    found, variance, *_ = power_up.add(angle, states, *follows(states))
    late = slice(round(10 / STEP), None)
    assert power_up.probability < 0.05
    assert np.abs(found[late]).max() < 0.2 * STROKE
    assert np.sqrt(variance[late]).max() < 0.5 * STROKE


@pytest.mark.parametrize("share", [0.1, 0.2, 0.4])
def test_u_holds_a_ripple_that_has_changed_a_little(share):
    """0.1 to 0.5 mN m: the learned one is not taken for it."""
    time, angle, states = motion()
    added = share * (ripple(OTHER, angle) - ripple(LEARNED, angle))
    late, held = slice(round(20 / STEP), None), []
    for seed in range(3, 6):
        states[:, TORQUE] = contact(time) + noise(time, states, seed) + added
        power_up = PowerUp(model(), STEP, BANDWIDTH)
        found, variance, *_ = power_up.add(angle, states, *follows(states))
        whole, left, _ = power_up.again()(angle, states[:, TORQUE])
        held.append(np.abs(found - added)[late] < 1.96 * np.sqrt(variance[late]))
        held.append(np.abs(whole - added)[late] < 1.96 * np.sqrt(left[late]))
    assert np.mean(held) > 0.9


@pytest.mark.parametrize("torque", [1e-3, -1.3e-3])
@pytest.mark.parametrize("other", [False, True])
def test_a_weak_contact_that_lasts_is_not_taken_for_ripple(torque, other):
    """Ripple of low orders has a mean along a part of a turn, as a weak load has."""
    time, angle, states = motion()
    added = other * (ripple(OTHER, angle) - ripple(LEARNED, angle))
    states[:, TORQUE] = torque + noise(time, states) + added
    power_up = PowerUp(model(0.3e-3), STEP, BANDWIDTH)
    found, variance, *_ = power_up.add(angle, states, *follows(states))
    late = slice(round(10 / STEP), None)
    assert np.mean(np.abs(found - added)[late] < 1.96 * np.sqrt(variance[late] + STROKE**2)) > 0.9
    whole, left, _ = power_up.again()(angle, states[:, TORQUE])
    assert np.mean(np.abs(whole - added) < 1.96 * np.sqrt(left + STROKE**2)) > 0.9


def test_ripple_of_pole_pairs_is_found_at_another_power_up():
    """Of seven: orders 7 and 14."""
    time, angle, states = motion()
    waves, other = (
        {(7 * order, quarter): value for (order, quarter), value in some.items()}
        for some in (LEARNED, OTHER)
    )
    added = ripple(other, angle) - ripple(waves, angle)
    states[:, TORQUE] = contact(time) + noise(time, states) + added
    power_up = PowerUp(model(waves=waves), STEP, BANDWIDTH)
    power_up.add(angle, states, *follows(states))
    assert power_up.probability > 0.99
    found, variance, _ = power_up.again()(angle, states[:, TORQUE])
    assert np.std(found - added) < 0.2 * np.std(added)
    assert np.mean(np.abs(found - added) < 1.96 * np.sqrt(variance)) > 0.9


def test_blocks_of_any_length_give_the_same(another):
    _, angle, states, _, found, variance = another
    parts, again = PowerUp(model(), STEP, BANDWIDTH), []
    for first, last in ((0, 7), (7, 7), (7, 5001), (5001, None)):
        again.append(parts.add(angle[first:last], states[first:last], *follows(states[first:last])))
    torques, variances, *_ = zip(*again, strict=True)
    np.testing.assert_array_equal(np.concatenate(torques), found)
    np.testing.assert_array_equal(np.concatenate(variances), variance)


def test_at_rest_nothing_is_learned_and_the_doubt_stays():
    _, angle, states = motion(5.0)
    angle[:], states[:, SPEED], states[:, HOUSING] = 0.5, 0.0, 0.3
    found, variance, *_ = PowerUp(model(), STEP, BANDWIDTH).add(angle, states, *follows(states))
    settled = slice(round(1 / STEP), None)
    # half of the mean of a ripple that is all its own: minus the learned one
    gone = -ripple(LEARNED, angle)
    np.testing.assert_allclose(found[settled], gone[settled] / 2, rtol=0, atol=1e-6)
    assert np.sqrt(variance[-1]) > 0.4e-3


def test_an_order_that_was_learned_too_small_may_be_larger_at_another_power_up():
    """Friction of the housing looks like the low orders along a part of a turn."""
    time, angle, states = motion()
    large = {**OTHER, (1, 0): -0.9e-3, (1, 1): 1.2e-3}
    added = ripple(large, angle) - ripple(LEARNED, angle)
    states[:, TORQUE] = contact(time) + noise(time, states) + added
    late, errors = slice(round(10 / STEP), None), {}
    for uncertain in (0.0, 0.5e-3):
        found, variance, *_ = PowerUp(model(uncertain), STEP, BANDWIDTH).add(
            angle, states, *follows(states)
        )
        errors[uncertain] = np.sqrt(np.mean((found - added)[late] ** 2))
    assert errors[0.5e-3] < 0.15 * np.sqrt(np.mean(added**2))
    assert errors[0.5e-3] < 0.7 * errors[0.0]
    assert np.mean(np.abs(found - added)[late] < 1.96 * np.sqrt(variance[late])) > 0.95


@pytest.mark.parametrize("current", [0.3, -1.2])
def test_ripple_that_grows_with_the_current_of_friction_and_load_is_in_the_variance(current):
    """Of other phases, as long as nobody knows them: in the mean over phases and a turn."""
    angle = np.linspace(0.0, 40 * np.pi, 40000)
    sizes = [(Kind.GAIN_RIPPLE, 1, 0, 3e-3), (Kind.GAIN_RIPPLE, 2, 1, 4e-3)]
    sizes += [(Kind.SQUARE_RIPPLE, 1, 1, 2e-3), (Kind.SQUARE_RIPPLE, 9, 0, 15e-3)]
    states = np.zeros((len(angle), STATES))
    states[:, SPEED] = np.gradient(angle, STEP)
    by_current, in_doubt = (
        PowerUp(model(u, sizes), STEP, BANDWIDTH).add(angle, states, *follows(states, current))[3]
        for u in (0.0, 1e-3)
    )
    own = np.zeros((9, 2))
    for kind, order, quarter, size in sizes:
        own[order - 1, quarter] += size * (abs(current) if kind is Kind.SQUARE_RIPPLE else 1.0)
    squares = []
    for phase in np.arange(0, 2 * np.pi, 0.5):
        turn = np.array([[np.cos(phase), np.sin(phase)], [-np.sin(phase), np.cos(phase)]])
        off = own @ turn - own
        keys = {(order + 1, q): off[order, q] for order in range(9) for q in range(2)}
        squares.append((CONSTANT * current * ripple(keys, angle))[20000:] ** 2)
    assert by_current[20000:].mean() == pytest.approx(np.mean(squares), rel=0.05)
    np.testing.assert_array_equal(in_doubt, by_current)  # squares hold those of the errors already


@pytest.mark.parametrize("stiffness", [20e-3, 30e-3])
def test_a_force_that_repeats_with_the_angle_is_no_ripple(stiffness):
    """Tissue: a spring from 1.5 rad on, far larger than what a power-up draws."""
    time, angle, states = motion()
    spring = stiffness * np.maximum(angle - 1.5, 0.0)
    states[:, TORQUE] = spring + noise(time, states)
    power_up = PowerUp(model(), STEP, BANDWIDTH)
    found, variance, *_ = power_up.add(angle, states, *follows(states))
    assert power_up.probability < 0.2
    late = slice(round(20 / STEP), None)
    assert np.abs(found[late]).max() < 0.5 * STROKE
    assert np.sqrt(variance[late]).max() < 2 * STROKE
    again, left, _ = power_up.again()(angle, states[:, TORQUE])
    for ripple_, doubt in ((found[late], variance[late]), (again, left)):
        assert np.mean(np.abs(ripple_) < 1.96 * np.sqrt(doubt)) > 0.95
    # before that, no more is taken for ripple than a power-up may draw
    largest = 3 * FACTOR * sum(np.hypot(LEARNED[n, 0], LEARNED[n, 1]) for n in (1, 2))
    assert np.abs(found).max() < 1.5 * largest


def test_u_holds_a_weak_force_that_repeats_with_the_angle():
    """A third of it: as another ripple and a load that hangs explain it, it stays in doubt."""
    time, angle, states = motion()
    states[:, TORQUE] = 10e-3 * np.maximum(angle - 1.5, 0.0) + noise(time, states)
    power_up = PowerUp(model(), STEP, BANDWIDTH)
    found, variance, *_ = power_up.add(angle, states, *follows(states))
    again, left, _ = power_up.again()(angle, states[:, TORQUE])
    late = slice(round(20 / STEP), None)
    assert np.abs(found[late]).max() > STROKE
    for ripple_, doubt in ((found[late], variance[late]), (again, left)):
        assert np.mean(np.abs(ripple_) < 1.96 * np.sqrt(doubt)) > 0.95


@pytest.mark.parametrize("coefficients", [LEARNED, OTHER], ids=["learned", "another"])
def test_a_weak_mass_that_hangs_from_the_first_sample_on_is_no_ripple(coefficients):
    """Along a part of a turn its torque is that of low orders: in doubt at first, then a load."""
    time, angle, states = motion()
    added = ripple(coefficients, angle) - ripple(LEARNED, angle)
    mass = MASS * np.sin(states[:, GRASPER])
    states[:, TORQUE] = mass + noise(time, states) + added
    power_up = PowerUp(model(), STEP, BANDWIDTH)
    found, variance, *_ = power_up.add(angle, states, *follows(states))
    again, left, _ = power_up.again()(angle, states[:, TORQUE])
    late = slice(round(20 / STEP), None)
    assert np.sqrt(np.mean((found - added)[late] ** 2)) < 0.3 * np.sqrt(np.mean(mass**2))
    for ripple_, doubt in ((found, variance), (again, left)):
        held = np.abs(ripple_ - added) < 1.96 * np.sqrt(doubt)
        assert np.mean(held[late]) > 0.95


def ramps(time, largest, every):
    """Return a torque that grows to its largest in the last 3 s of each period."""
    return largest * np.maximum(time % every - (every - 3.0), 0.0) / 3.0


@pytest.mark.parametrize("largest", [2.5e-3, 4e-3, 9e-3])
def test_weak_contacts_that_grow_slowly_are_no_ripple(largest):
    time, angle, states = motion()
    states[:, TORQUE] = ramps(time, largest, 10.0) + noise(time, states)
    found, variance, *_ = PowerUp(model(), STEP, BANDWIDTH).add(angle, states, *follows(states))
    assert np.sqrt(np.mean(found**2)) < 0.5 * STROKE
    assert np.mean(np.abs(found) < 1.96 * np.sqrt(variance)) > 0.95


def test_a_contact_that_is_recognised_by_its_end_leaves_nothing_in_the_ripple():
    time, angle, states = motion()
    added = ripple(OTHER, angle) - ripple(LEARNED, angle)
    states[:, TORQUE] = ramps(time, 4e-3, 8.0) + noise(time, states) + added
    power_up = PowerUp(model(), STEP, BANDWIDTH)
    found, variance, *_ = power_up.add(angle, states, *follows(states))
    assert power_up.probability > 0.99
    assert np.mean(np.abs(found - added) < 1.96 * np.sqrt(variance)) > 0.95
    whole, left, _ = power_up.again()(angle, states[:, TORQUE])
    assert np.sqrt(np.mean((whole - added) ** 2)) < 0.6 * STROKE
    assert np.mean(np.abs(whole - added) < 1.96 * np.sqrt(left)) > 0.95


@pytest.mark.parametrize("frequency", [10.0, 12.5, 25.0])
def test_a_force_that_swings_with_rows_of_20_ms_is_no_ripple(frequency):
    """From the first row to the last one: rows of one length meet it at two to five phases."""
    time, angle, states = motion(30.0)
    added, held = ripple(OTHER, angle) - ripple(LEARNED, angle), []
    for part in range(3):
        swing = 5e-3 * np.sin(2 * np.pi * (frequency * time + part / 3) + 0.1)
        states[:, TORQUE] = swing + noise(time, states, part) + added
        power_up = PowerUp(model(), STEP, BANDWIDTH)
        power_up.add(angle, states, *follows(states))
        whole, left, _ = power_up.again()(angle, states[:, TORQUE])
        held.append(np.mean(np.abs(whole - added) < 1.96 * np.sqrt(left)))
    assert np.mean(held) > 0.7


@pytest.mark.parametrize(("frequency", "share"), [(0.5, 0.75), (0.7, 0.95)])
def test_a_weak_force_that_swings_all_the_time_decides_for_no_power_up(frequency, share):
    """In the first second it may look like ripple; then both hypotheses see a contact."""
    time, angle, states = motion(30.0)
    held = []
    for part in range(6):
        swing = 2e-3 * np.sin(2 * np.pi * (frequency * time + part / 6))
        states[:, TORQUE] = swing + noise(time, states, part)
        power_up = PowerUp(model(), STEP, BANDWIDTH)
        found, variance, *_ = power_up.add(angle, states, *follows(states))
        held.append(np.mean(np.abs(found) < 1.96 * np.sqrt(variance)))
    assert np.mean(held) > share


def test_in_fast_motion_ripple_is_what_the_filter_shows_of_it():
    """Ten strokes in a second: the filter shows the second order late and in part."""
    time = np.arange(round(10.0 / sensors.INTERVAL)) * sensors.INTERVAL
    samples = sensors.moved(1.3 - 1.3 * np.cos(2 * np.pi * 5.0 * time), np.zeros(len(time)))
    angle, kept = samples[0] * sensors.WIDTH, np.exp(-sensors.INTERVAL / LAG)
    ripple = lfilter([1 - kept], [1, -kept], 1.5e-3 * np.sin(2 * angle))
    samples[1] += ripple / (sensors.CONSTANT[0] + sensors.CONSTANT[1] * sensors.WARM)
    found = Sensor(sensors.instrument()).add(samples, last=True)
    less = found.less
    acts = ripple[: 8 * len(less)].reshape(-1, 8).mean(axis=1)
    late = slice(round(4.0 / STEP), None)
    assert (less - acts)[late].std() < 0.4 * acts[late].std()
    # what is known is taken off the drive torque: little of it is left in the filter's torque
    assert found.estimate.torque[late].std() < 0.6 * acts[late].std()
