"""A model is learned from strokes that formulas made, and gives them back."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from rigtool.errors import InsufficientDataError
from rigtool.experiments.force_model import learning
from rigtool.experiments.force_model.deviations import (
    MAX_SCATTER_RATIO,
    UNSEEN_PART,
    Deviations,
    deviations,
    kept_by_mean,
    scatter_hz,
    scatter_ratios,
    unseen_deviations,
)
from rigtool.experiments.force_model.force_model import ForceModel
from rigtool.experiments.force_model.learning import ENOUGH, learn_sliding
from rigtool.experiments.force_model.model import Kind, Known
from rigtool.experiments.force_model.procedure_learning import LearnedForce, untouched_motions
from rigtool.experiments.force_model.records import ROWS_HZ
from rigtool.experiments.force_model.sliding_problem import (
    SLIDING_PARAMETERS,
    Problem,
    logarithms,
    stepped_shape,
)
from rigtool.experiments.learning.implementations.d_tendon import stroke_notes, tendon_results
from rigtool.recipe import load_recipe
from tests.experiments.force_model import known_plant as plant
from tests.experiments.force_model.known_plant import strokes
from tests.experiments.virtual_runs import RECIPE

KNOWN = Known(plant.RATIO, plant.FACTOR, plant.INERTIA)
CALM = Deviations(2e-4, 1e-3, 1e-4, 0.1)
LOADS, SPEEDS = (0.0, 2e-3, 10e-3, 50e-3), (1.0, 4.0)


def coefficient(model, kind, order=0, quarter=0):
    (found,) = (
        value
        for term, value in zip(model.terms, model.coefficient, strict=True)
        if (term.kind, term.order, term.quarter) == (kind, order, quarter)
    )
    return found


@pytest.fixture(scope="module")
def fit():
    records = [strokes(load, speed) for load in LOADS for speed in SPEEDS]
    return learn_sliding(records, KNOWN, plant.COUNT, CALM)


@pytest.fixture(scope="module")
def learned(fit):
    return fit.learned


def test_no_shape_near_the_learned_one_costs_less_than_the_last_step_of_a_search_may_bring(fit):
    _, least = fit.problem.cost(fit.learned.shape)
    u = np.sqrt(np.diag(fit.learned.covariance))[: len(SLIDING_PARAMETERS)]
    for way in (*np.diag(u), *-np.diag(u)):
        assert fit.problem.cost(stepped_shape(fit.learned.shape, way))[1] > least - ENOUGH**2


def test_bristles_begin_at_more_counts_with_a_fine_encoder():
    records = [strokes(load, 4.0) for load in (0.0, 50e-3)]
    fine, coarse = (
        learn_sliding(records, KNOWN, count, CALM).learned.shape
        for count in (plant.COUNT / 10, plant.COUNT)
    )
    assert fine.bearing_length == pytest.approx(8 / 10 * plant.COUNT)
    assert fine.housing_length == pytest.approx(6 * fine.bearing_length)
    assert coarse.bearing_length == pytest.approx(plant.COUNT, rel=1e-12)


def test_the_unit_of_torque_changes_nothing():
    """Model and covariance from strokes whose torques, moments and inertias are larger."""
    unit, records = 64.0, [strokes(load, 4.0) for load in (LOADS[0], LOADS[-1])]
    larger = [
        replace(
            record,
            torque_constant=unit * record.torque_constant,
            moment=unit * record.moment,
            load_inertia=unit * record.load_inertia,
            torques=unit * record.torques,
        )
        for record in records
    ]
    deviation = replace(CALM, stroke=unit * CALM.stroke, noise=unit * CALM.noise)
    one = learn_sliding(records, KNOWN, plant.COUNT, CALM)
    known = replace(KNOWN, inertia=unit * KNOWN.inertia)
    other = learn_sliding(larger, known, plant.COUNT, deviation)
    found = one.learned, other.learned
    without = (Kind.LOAD_FRICTION, Kind.CARRIED, Kind.GAIN_RIPPLE, Kind.SQUARE_RIPPLE, Kind.DELAY)
    sizes = np.array([1.0 if term.kind in without else unit for term in found[0].terms])
    # the drive's current flows as before
    np.testing.assert_allclose(
        found[1].coefficient / sizes, found[0].coefficient, rtol=1e-3, atol=1e-7
    )
    named = ("stiffness", "damping", "tip_friction", "grasper_inertia", "load_onset")
    for name, value in vars(found[0].shape).items():
        size = unit if name in named else 1.0
        assert getattr(found[1].shape, name) / size == pytest.approx(value, rel=1e-3)
    whole = np.append(np.ones(len(SLIDING_PARAMETERS)), sizes)
    u, other_u = (np.sqrt(np.diag(model.covariance)) for model in found)
    np.testing.assert_allclose(other_u / whole, u, rtol=1e-3)
    chosen = [True] * len(records)
    spread, other_spread = (
        np.sqrt(np.diag(fit.covariance_of(fit.learned, chosen))) for fit in (one, other)
    )
    np.testing.assert_allclose(other_spread / whole, spread, rtol=2e-3)


def test_a_longer_step_that_raises_the_cost_is_shortened(fit):
    problem, shape = fit.problem, fit.learned.shape
    normal = problem.normal(shape, fit.learned.coefficient).sum(axis=0)
    normal[: len(SLIDING_PARAMETERS), -1] += 100 * np.diag(normal)[: len(SLIDING_PARAMETERS)]
    steps = [
        problem.solved(normal, shape, len(SLIDING_PARAMETERS), lift)[0]
        for lift in (0.0, 1.0, 100.0)
    ]
    lengths = [
        np.linalg.norm(step[: len(SLIDING_PARAMETERS)] / problem.shape_spread) for step in steps
    ]
    assert lengths[0] > lengths[1] > 10 * lengths[2]


class Scripted:
    """A problem of which each step, in logarithms of one parameter, is known beforehand."""

    def __init__(self, *steps):
        self.steps, self.near, self.costs = iter(steps), [], iter(range(100, 0, -1))

    def cost(self, shape):
        return np.zeros(1), next(self.costs)

    def normal(self, shape, coefficient):
        return np.zeros((1, 1, 1))

    def solved(self, normal, shape, first, lift=0.0):
        return np.eye(first)[0] * next(self.steps), np.eye(first)

    def weigh(self, shape, coefficient, near):
        self.near.append(near)


def test_records_keep_the_weights_of_their_own_until_the_search_ends(fit):
    problem = Scripted(0.6, 0.1, 0.4, 0.35, 0.2)
    learning._searched(problem, fit.learned.shape)
    assert problem.near == [False, True, True, True]
    assert next(problem.steps, None) is None
    at_once = Scripted(0.1, 0.1)  # no end without weights of their own
    learning._searched(at_once, fit.learned.shape)
    assert at_once.near == [True]


def test_tendon_and_load_friction_are_given_back(learned):
    assert learned.shape.stiffness == pytest.approx(plant.STIFFNESS, rel=0.01)
    carried = np.array([5e-3, 20e-3, 50e-3])
    onset = learned.shape.load_onset
    upright = sum(  # at 90 degrees
        coefficient(learned, Kind.LOAD_FRICTION, order, quarter) * value
        for order, quarter, value in ((0, 0, 1), (1, 1, 1), (2, 0, -1))
    )
    found = upright * (np.hypot(carried, onset) - onset)
    expected = plant.LOAD_FRICTION * (np.hypot(carried, plant.ONSET) - plant.ONSET)
    np.testing.assert_allclose(found, expected, rtol=0.03)


def test_what_the_bench_has_wrong_is_in_the_budget_of_the_tendon(fit, learned):
    """What the loads are the measure of grows with them; how they swing, with length squared."""
    rig = load_recipe(RECIPE)[0].rig
    off = rig.instrument.model_copy(
        update={"grasper_length_u": 0.2e-3, "angle_ratio_relative_u": 0.01}
    )
    rig = rig.model_copy(update={"weights_relative_u": 0.01, "instrument": off})
    force = LearnedForce(ForceModel(learned, CALM), fit, {}, {}, True)
    first, *_, last = fit.problem.records
    pairs = [SimpleNamespace(loaded=one, unloaded=()) for one in (first, last)]
    found = tendon_results(force, pairs, np.array([1.0, 2.0]), rig)
    assert {"tendon_stiffness_shift", "tendon_stiffness_resonance"} < set(found)
    relative = {
        name: {line.name: line.u * line.sensitivity / one.value for line in one.budget}
        for name, one in found.items()
    }
    assert relative["tendon_stiffness"]["weights"] == pytest.approx(0.01, rel=0.1)
    assert 0.009 < relative["tendon_stiffness"]["length to the load"] < 0.021
    assert abs(relative["tendon_stiffness"]["angle ratio"]) > 0.01
    assert all(len(lines) == 4 for lines in relative.values())
    number = SLIDING_PARAMETERS.index("stiffness")
    u = np.sqrt(fit.covariance_of(learned, [True] * len(fit.problem.records))[number, number])
    assert relative["tendon_stiffness"]["strokes under known loads"] == pytest.approx(u, rel=0.05)


def test_a_coarse_encoder_leaves_the_tendon_uncertain_where_the_rotor_turns(fit, learned):
    """Friction of the tip changes the swing after a turn most like an angle that is off there."""
    every, number = [True] * len(fit.problem.records), SLIDING_PARAMETERS.index("tip_friction")
    fine, coarse = (
        replace(fit, count=factor * fit.count).covariance_of(learned, every)[number, number]
        for factor in (0.01, 60)
    )
    assert coarse > 2 * fine > 0


def test_friction_is_given_back_wherever_it_slides(learned):
    """What belongs to which term is not seen while sliding; their sum is."""
    angle = np.linspace(0.6, 2.0, 30)
    for speed in SPEEDS:
        total = np.full(angle.size, learned.shape.tip_friction / plant.FACTOR)
        for term, value in zip(learned.terms, learned.coefficient, strict=True):
            wave = (np.sin if term.quarter else np.cos)(term.order * angle / plant.RATIO)
            if term.kind in (Kind.BEARING, Kind.HOUSING):
                total += value * wave
            elif term.kind is Kind.STRIBECK:
                total += value * math.exp(-((speed / learned.shape.stribeck_speed) ** 2))
            elif term.kind is Kind.VISCOUS:
                turned = (np.sin if term.quarter else np.cos)(term.order * angle)
                total += value * speed * turned
        expected = plant.COULOMB + plant.VISCOUS * speed
        np.testing.assert_allclose(total, expected, rtol=0.02)


@pytest.mark.parametrize("factor", [0.2, 2.0])
def test_any_stiffness_is_found_from_the_same_begin(monkeypatch, factor):
    monkeypatch.setattr(plant, "STIFFNESS", factor * plant.STIFFNESS)
    records = [strokes(load, speed) for load in (0.0, 20e-3, 50e-3) for speed in SPEEDS]
    found = learn_sliding(records, KNOWN, plant.COUNT, CALM).learned
    u = np.sqrt(
        found.covariance[
            SLIDING_PARAMETERS.index("stiffness"), SLIDING_PARAMETERS.index("stiffness")
        ]
    )
    assert u < 0.35
    assert np.log(found.shape.stiffness / plant.STIFFNESS) == pytest.approx(0, abs=max(0.03, 2 * u))


def test_what_friction_deviates_is_measured():
    records = [
        strokes(load, 1.0, cycles=30, deviation=0.4e-3, noise=(0.1e-3, 0.15), seed=seed)
        for seed, load in enumerate((0.0, 0.0, 20e-3, 50e-3))
    ]
    found = deviations(records, plant.RATIO, plant.FACTOR)
    assert found.stroke == pytest.approx(0.4e-3, rel=0.15)
    assert found.noise == pytest.approx(0.1e-3, rel=0.3)
    assert 0.05 < found.noise_time < 0.45
    assert 50e-3 / plant.FACTOR * found.load < found.stroke / 2  # nothing grew with the load


@pytest.mark.parametrize("part", [0.1, 0.4, 0.6])
def test_a_period_may_begin_anywhere_in_a_stroke(part):
    """Where it cuts a stroke in two, the second half belongs to the cycle before."""
    records = [
        strokes(0.0, 1.0, cycles=30, deviation=0.4e-3, noise=(0.1e-3, 0.15), seed=seed)
        for seed in range(2)
    ]
    turned = []
    for record in records:
        by = round(part * record.angle.size)
        rows = round(part * record.count)
        series = record.torques.reshape(-1)[rows : len(record.torques[0]) * -1 + rows or None]
        turned.append(
            replace(
                record,
                angle=np.roll(record.angle, -by),
                current=np.roll(record.current, -by),
                trusted=np.roll(record.trusted, -by),
                torques=series.reshape(-1, record.count),
                cycles=record.cycles - 1,
            )
        )
    found = deviations(turned, plant.RATIO, plant.FACTOR)
    assert found.stroke == pytest.approx(0.4e-3, rel=0.15)
    assert found.noise == pytest.approx(0.1e-3, rel=0.4)


@pytest.mark.parametrize("payback", [0.0, 0.9])
def test_a_few_cycles_show_as_much_as_many(payback):
    """What their mean takes away of each of three is given back."""
    records = [
        strokes(0.0, 1.0, cycles=3, deviation=0.4e-3, payback=payback, seed=seed)
        for seed in range(16)
    ]
    assert {record.cycles for record in records} == {3}
    found = deviations(records, plant.RATIO, plant.FACTOR)
    expected = 0.4e-3 * np.hypot(1, payback)
    assert found.stroke == pytest.approx(expected, rel=0.13)


def test_cycles_that_differ_by_more_than_friction_does_do_not_repeat():
    every = [
        strokes(load, 1.0, cycles=8, deviation=deviation, seed=seed)
        for seed, (load, deviation) in enumerate(
            [(0.0, 0.2e-3), (0.0, 0.3e-3), (20e-3, 0.3e-3), (50e-3, 5e-3)]
        )
    ]
    swings = [ratio > MAX_SCATTER_RATIO for ratio in scatter_ratios(every)]
    assert swings == [False, False, False, True]


@pytest.mark.parametrize(
    ("hertz", "cause"), [(1.0, "lets the load swing"), (4.0, "something else")]
)
def test_a_load_that_swings_anew_in_each_cycle_gets_a_remark(fit, learned, hertz, cause):
    calm = strokes(50e-3, 1.0, cycles=8, deviation=0.3e-3, seed=1)
    inertia = learned.shape.stiffness / (2 * math.pi) ** 2  # swings at 1 Hz
    time = np.arange(calm.count) / ROWS_HZ
    phases = np.linspace(0, 5, 8)[:, None]
    wave = 5e-3 * np.sin(2 * math.pi * hertz * time + phases)
    swinging = replace(calm, torques=calm.torques + wave, load_inertia=inertia)
    found = {"known_000_000": calm, "known_000_001": swinging}
    scatter = {"known_000_000": 1.0, "known_000_001": 9.0}
    force = LearnedForce(ForceModel(learned, CALM), fit, found, scatter, True)
    recipe = load_recipe(RECIPE)[0]
    (note,) = stroke_notes(force, recipe)
    assert note.startswith("known_000_001: its cycles scatter by 9 times")
    assert cause in note
    assert scatter_hz(swinging) == pytest.approx(hertz, abs=0.2)
    short, _ = stroke_notes(replace(force, shown=False), recipe)
    assert "shorter than 1 s" in short
    assert "slower speed to ilc_learn.loads.speeds_rev_per_s" in short


def test_the_time_by_which_the_current_is_late_is_found(fit):
    """All currents are asked for 0.2 ms before they act: by their spectra, without the prior."""
    own, late = fit.problem, 0.2e-3

    def asked(record):
        way = 2j * np.pi * np.fft.rfftfreq(record.current.size, record.interval)
        sooner = np.fft.irfft(np.fft.rfft(record.current) * np.exp(way * late), record.current.size)
        return replace(record, current=sooner)

    def delay(records):
        terms = [replace(t, spread=1.0) if t.kind is Kind.DELAY else t for t in own.terms]
        problem = Problem(records, tuple(terms), KNOWN, own.start, own.deviation, own.friction)
        problem.variance = own.variance
        found, _ = problem.cost(fit.learned.shape)
        return found[[term.kind for term in terms].index(Kind.DELAY)]

    change = delay([asked(record) for record in own.records]) - delay(own.records)
    assert change == pytest.approx(late, rel=0.03)  # ripple by current takes a part


def test_what_comes_back_in_each_pass_is_no_news(fit):
    again = [replace(record, passes=4) for record in fit.problem.records]
    found = learn_sliding(again, KNOWN, plant.COUNT, CALM).learned
    assert found.shape.stiffness == pytest.approx(fit.learned.shape.stiffness, rel=0.05)
    of = SLIDING_PARAMETERS.index("stiffness"), SLIDING_PARAMETERS.index("stiffness")
    assert found.covariance[of] > 2 * fit.learned.covariance[of]


@pytest.mark.parametrize(("payback", "low", "high"), [(0.0, 0.8, 1.0), (0.9, 0.01, 0.04)])
def test_what_strokes_pay_back_hardly_moves_their_mean(payback, low, high):
    """By its weights, a mean of 30 keeps 1.2 or 0.013 of the variance of independent ones."""
    records = [
        strokes(0.0, 1.0, cycles=30, deviation=0.4e-3, payback=payback, seed=seed)
        for seed in range(4)
    ]
    assert low <= kept_by_mean(records, plant.RATIO) <= high


def test_without_cycles_nothing_is_claimed_to_be_measured():
    fast = [strokes(load, 4.0, cycles=6, deviation=0.4e-3) for load in (0.0, 50e-3)]
    for records in ([], fast):
        assert deviations(records, plant.RATIO, plant.FACTOR) is None
        assert unseen_deviations(records).stroke > 0
    friction = plant.COULOMB + 4.0 * plant.VISCOUS
    assert unseen_deviations(fast).stroke == pytest.approx(UNSEEN_PART * friction, rel=0.2)


def test_too_slow_strokes_are_refused():
    with pytest.raises(InsufficientDataError, match="higher speeds"):
        learn_sliding([strokes(0.0, 0.1, cycles=1)], KNOWN, plant.COUNT, CALM)


def test_loads_alone_are_refused():
    with pytest.raises(InsufficientDataError, match="without load"):
        learn_sliding([strokes(10e-3, 2.0)], KNOWN, plant.COUNT, CALM)


class Motion:
    def __init__(self, name, **conditions):
        self.name, self.condition = name, conditions.__getitem__


def test_contacts_are_distinguished_from_errors_at_every_learned_speed():
    strokes = [Motion(f"{v} {f}", speed=v, force=f) for v in (2.0, 4.0) for f in (0.0, 1.0)]
    moves = [Motion(str(v), speed=v) for v in (1.0, 2.0, 4.0, 8.0)]
    slow, faster = untouched_motions(strokes, moves, [])
    assert [motion.name for motion in slow] == ["2.0 0.0"]
    assert [motion.name for motion in faster] == ["4.0", "8.0"]


def test_rounding_decides_no_step_of_a_search(fit):
    """Many terms look alike: the cost is as exact as it is stationary in the coefficients."""
    shape, own = fit.learned.shape, fit.problem
    solution, cost = own.cost(shape)
    normal = own.normal(shape, None).sum(axis=0)
    far = np.append(-solution, 1.0)
    away = (logarithms(shape) - logarithms(own.start)) / own.shape_spread
    waves = own.spread > 0
    squares = far @ normal @ far + away @ away + np.sum((solution[waves] / own.spread[waves]) ** 2)
    assert cost == pytest.approx(squares, rel=1e-9)
