"""Loads on a drive whose tendon, friction and ripple are known are read with what was learned."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from rigtool.errors import InsufficientDataError
from rigtool.experiments.force_model.deviations import Deviations
from rigtool.experiments.force_model.learning import LearnedModel, learn_sliding
from rigtool.experiments.force_model.model import Kind, Shape, Term
from rigtool.experiments.force_model.sliding_problem import SLIDING_PARAMETERS, stepped_shape
from rigtool.experiments.load_disturbance import reading
from rigtool.experiments.load_disturbance.reading import (
    LoadedPair,
    dead_band,
    read_loads,
    scatter_of_mean,
)
from rigtool.numerics.steady_mean import steady_mean
from tests.experiments.load_disturbance.known_drive import (
    ARM,
    COUNT,
    KNOWN,
    STIFFNESS,
    TIP_FRICTION,
    strokes,
)

SPEEDS = (0.5, 1.5)
LOADS = (0.002, 0.01, 0.03, 0.06)
SCATTER = 0.1e-3
LARGEST, ANGLE, BANDWIDTH = 0.06, math.pi / 2, 5.0
CALM = Deviations(1e-4, 1e-3, 1e-5, 0.1)


@pytest.fixture(scope="module")
def unloaded():
    return {speed: (strokes(0.0, speed, scatter=SCATTER, seed=90),) for speed in SPEEDS}


@pytest.fixture(scope="module")
def sliding(unloaded):
    pairs = [(speed, load) for speed in SPEEDS for load in LOADS]
    records = [
        strokes(load, speed, scatter=SCATTER, seed=n) for n, (speed, load) in enumerate(pairs)
    ]
    records += [record for each in unloaded.values() for record in each]
    return learn_sliding(records, KNOWN, COUNT, CALM)


def compared(unloaded, load, speed=0.5, **changes):
    own = {"scatter": SCATTER, "seed": 33, "known": False, **changes}
    return LoadedPair(strokes(load, speed, **own), unloaded[speed], ARM)


def read(model, pair):
    (found,) = read_loads(model, [pair], LARGEST, ANGLE, BANDWIDTH)
    return found


def test_the_tendon_comes_back(sliding):
    shape = sliding.learned.shape
    assert shape.stiffness == pytest.approx(STIFFNESS, rel=0.02)
    assert shape.tip_friction == pytest.approx(TIP_FRICTION, abs=0.6e-3)


@pytest.mark.parametrize("speed", SPEEDS)
@pytest.mark.parametrize("load", [0.005, 0.02, 0.05])
def test_loads_between_the_learned_ones_are_read(sliding, unloaded, load, speed):
    found = read(sliding.learned, compared(unloaded, load, speed))
    assert found.moment == pytest.approx(load, abs=max(0.005 * load, 3 * found.quantity.u))
    assert found.at_angle.mean() == pytest.approx(load, rel=0.03, abs=0.1e-3)
    assert found.cycles.std(ddof=1) == pytest.approx(SCATTER, rel=1)
    own = found.cycles - found.cycles.mean()  # what a cycle's load is off shows at the angle, too
    assert own @ found.at_angle > 0.3 * (own @ own)


def test_what_the_record_states_of_its_load_informs_nothing(sliding, unloaded):
    stated, hidden = (
        read(sliding.learned, compared(unloaded, 0.02, known=known)) for known in (True, False)
    )
    assert stated.moment == hidden.moment


def test_the_dead_band_is_half_of_what_lifting_and_lowering_differ_by(sliding, unloaded):
    found = dead_band(sliding.learned, compared(unloaded, 0.05), ANGLE, BANDWIDTH)
    # 10 mN m without load, a tenth of the load beyond the onset, the joint's own
    assert found.half == pytest.approx(10e-3 + 0.1 * 48e-3 + 0.8e-3, rel=0.1)
    assert found.middle == pytest.approx(0.05, rel=0.05)


def test_a_friction_level_that_drifts_moves_no_reading(sliding, unloaded):
    still, drifted = (
        read(sliding.learned, compared(unloaded, 0.02, drift=drift)) for drift in (0.0, 1e-3)
    )
    assert drifted.moment == pytest.approx(still.moment, rel=3e-3)


def test_a_load_left_out_of_the_learning_is_read(sliding, unloaded):
    less = sliding.learned_from([record.moment != 0.03 for record in sliding.problem.records])
    found = read(less, compared(unloaded, 0.03))
    assert found.moment == pytest.approx(0.03, rel=0.01)
    own = SLIDING_PARAMETERS.index("stiffness")
    assert less.covariance[own, own] > sliding.learned.covariance[own, own]


def test_a_load_under_which_the_rotor_does_not_slide_is_not_read(sliding, unloaded):
    pair = compared(unloaded, 0.02)
    held = replace(pair.loaded, trusted=np.zeros_like(pair.loaded.trusted))
    pairs = [replace(pair, loaded=held), pair]
    slow, found = read_loads(sliding.learned, pairs, LARGEST, ANGLE, BANDWIDTH)
    assert isinstance(slow, InsufficientDataError)
    assert "slides evenly in 0 rows of a stroke" in str(slow)
    assert found.moment == pytest.approx(0.02, rel=0.01)


@pytest.mark.parametrize(("rows", "refused"), [(4, True), (5, False)])
def test_a_load_and_three_levels_of_friction_need_more_rows_than_they_are(rows, refused):
    record = SimpleNamespace(used=np.arange(9) < rows)
    if not refused:
        reading._require_sliding(record)
        return
    with pytest.raises(InsufficientDataError, match="evenly in 4 rows of a stroke, more than 4"):
        reading._require_sliding(record)


def test_levels_of_friction_change_with_the_output_s_angle():
    """A mean and an eccentricity of any phase, in the direction of motion."""
    way, output = np.array([1.0, -1.0, 0.5]), np.array([0.2, 1.1, 2.0])
    record = SimpleNamespace(angle=0.7 * output, rows=lambda values: values[:, 1:])
    own = SimpleNamespace(record=record, housing=way, known=SimpleNamespace(angle_ratio=0.7))
    expected = way[1:] * [[1, 1], np.sin(output[1:]), np.cos(output[1:])]
    np.testing.assert_allclose(reading._own(own), expected, rtol=1e-12)


def of_another_power_up(found):
    (line,) = [one for one in found.quantity.budget if one.name == "ripple of another power-up"]
    return line.u


def test_ripple_of_the_learned_power_up_makes_no_reading_wider(sliding, unloaded):
    found = read(sliding.learned, compared(unloaded, 0.05))
    assert found.another < 1e-3
    assert of_another_power_up(found) < 0.2 * found.quantity.u


@pytest.mark.parametrize("phase", [1.5, 3.0, 4.5])
def test_ripple_of_another_power_up_is_seen_and_uncertain(sliding, unloaded, phase):
    other = {0.5: (strokes(0.0, 0.5, scatter=SCATTER, seed=90, phase=phase),)}
    found = read(sliding.learned, compared(other, 0.05, phase=phase))
    assert found.another > 0.99
    assert found.moment == pytest.approx(0.05, abs=2 * found.quantity.u)
    assert 0.001 * 0.05 < of_another_power_up(found) < 0.02 * 0.05


@pytest.mark.parametrize("load", [0.001, 0.01, 0.03, 0.04, 0.05, 0.06])
def test_a_load_that_swings_near_its_resonance_is_found(load):
    """At 50 mN m a search from the mean torque alone ends at 14 mN m, which fits less well."""
    soft = {"stiffness": 0.1, "damping": 4e-4, "tip_friction": 1e-9}
    drive = {"friction": 0.0, "ripple": 0.0, "scatter": 0.02e-3, **soft}
    shape = Shape(1e-3, 1e-2, 1e-2, 0.1, 0.01, grasper_inertia=1e-7, load_onset=1e-3, **soft)
    terms = (Term(Kind.HOUSING, 1.0),)
    count = len(SLIDING_PARAMETERS) + len(terms)
    plain = LearnedModel(
        terms, shape, KNOWN, np.full(1, 8.5e-3), np.zeros((count, count)), np.ones(2)
    )
    pair = LoadedPair(strokes(load, 1.8, **drive), (strokes(0.0, 1.8, **drive),), ARM)
    assert read(plain, pair).moment == pytest.approx(load, rel=0.03, abs=0.05e-3)


def test_a_load_far_beyond_the_learned_ones_is_refused(sliding, unloaded):
    found = read(sliding.learned, compared(unloaded, 0.6, stiffness=50.0, damping=1e-2))
    assert isinstance(found, InsufficientDataError)
    assert "no load up to 3 times the largest learned one, 60 mN m" in str(found)


def test_the_budget_holds_scatter_zero_disturbance_and_misfit(sliding, unloaded):
    found = read(sliding.learned, compared(unloaded, 0.03))
    budget = {line.name: line for line in found.quantity.budget}
    assert set(budget) == {
        "scatter",
        "reading without load",
        "disturbance as learned",
        "what the disturbance leaves",
        "ripple of another power-up",
    }
    total = math.hypot(*(line.u for line in budget.values()))
    assert found.quantity.u == pytest.approx(total, rel=1e-9, abs=0)
    assert found.scatter_u == budget["scatter"].u
    # Welch and Satterthwaite (GUM G.4.1): both of these are from the same number of strokes
    finite = [line for line in budget.values() if line.dof is not None]
    assert found.quantity.dof == pytest.approx(total**4 / sum(x.u**4 / x.dof for x in finite))
    assert budget["scatter"].dof > 0


def test_strokes_without_load_hide_as_much_of_an_error_as_their_mean_scatters(
    sliding, unloaded, monkeypatch
):
    """Where all strokes scatter alike, and hide all that the disturbance leaves."""
    monkeypatch.setattr(reading, "scatter_of_mean", lambda torques, fitted: 1.0)

    def hidden(count):
        pair = compared(unloaded, 0.03)
        found = read(sliding.learned, replace(pair, unloaded=count * pair.unloaded))
        return {line.name: line.u for line in found.quantity.budget}["what the disturbance leaves"]

    alone = hidden(1)
    for count in (2, 3):
        assert (hidden(count) / alone) ** 2 == pytest.approx((1 + 1 / count) / 2)


def test_strokes_without_load_that_pairs_share_show_their_payback_once(
    sliding, unloaded, monkeypatch
):
    given = []

    def noticed(series, shares):
        given.extend(zip(map(len, series), shares, strict=True))
        return [(1.0, 9.0)] * len(series)

    monkeypatch.setattr(reading, "steady_us", noticed)
    pairs = [compared(unloaded, load) for load in (0.01, 0.03, 0.06)]
    pairs.append(compared(unloaded, 0.03, speed=1.5))
    read_loads(sliding.learned, pairs, LARGEST, ANGLE, BANDWIDTH)
    assert [share for _, share in given] == [1, 1 / 3, 1, 1 / 3, 1, 1 / 3, 1, 1]


@pytest.mark.parametrize("name", ["stiffness", "tip_friction", "coefficients"])
def test_u_of_the_disturbance_is_how_far_a_parameter_moves_the_reading(sliding, unloaded, name):
    """Also of friction and ripple that load and zero have in common."""
    model, pair = sliding.learned, compared(unloaded, 0.03)
    count = len(SLIDING_PARAMETERS)
    step = np.zeros(len(model.covariance))
    if name == "coefficients":
        step[count:] = 1e-4 * np.random.default_rng(1).standard_normal(len(model.terms))
    else:
        step[SLIDING_PARAMETERS.index(name)] = 1e-2

    def moved(way):
        shape = stepped_shape(model.shape, way * step[:count])
        other = replace(model, shape=shape, coefficient=model.coefficient + way * step[count:])
        return read(other, pair).moment

    found = read(replace(model, covariance=np.outer(step, step)), pair)
    (line,) = (each for each in found.quantity.budget if each.name == "disturbance as learned")
    assert line.u == pytest.approx(abs(moved(1) - moved(-1)) / 2, rel=0.05)


def test_what_cycles_scatter_in_the_mean_cycle_is_taken_off_its_misfit():
    rng = np.random.default_rng(4)
    fitted = np.linalg.qr(rng.standard_normal((80, 3)))[0]
    draws = rng.standard_normal((300, 6, 80))
    means = np.array([steady_mean(draw) for draw in draws])
    left = means - means @ fitted @ fitted.T
    stated = np.mean([scatter_of_mean(draw, fitted) for draw in draws])
    assert stated == pytest.approx(np.mean(left**2), rel=0.03)
    # What is alike in all cycles is no scatter.
    alike = draws[0] + rng.standard_normal(80)
    assert scatter_of_mean(alike, fitted) == pytest.approx(scatter_of_mean(draws[0], fitted))


def test_recordings_of_other_lengths_are_compared_at_the_same_points(sliding, unloaded):
    """A clock that is a little off makes a period longer by a row."""
    zero = strokes(0.0, 0.5 / 1.004, scatter=SCATTER, seed=90)
    pair = compared(unloaded, 0.03)
    assert zero.count != pair.loaded.count
    found = read(sliding.learned, LoadedPair(pair.loaded, (zero,), ARM))
    assert found.moment == pytest.approx(0.03, rel=0.01)
