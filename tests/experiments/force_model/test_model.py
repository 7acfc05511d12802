"""What a model of motor and instrument may learn, and its equations beside those of the filter."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rigtool.experiments.force_filter.plant import (
    ANGLE,
    GRASPER,
    SPEED,
    STATES,
    TORQUE,
    advance,
    as_record,
)
from rigtool.experiments.force_model.drive import drive_of, plant_of, tabulated
from rigtool.experiments.force_model.learning import LearnedModel
from rigtool.experiments.force_model.model import (
    Kind,
    Known,
    Prediction,
    RecordState,
    Shape,
    Sizes,
    Term,
    functions,
    terms_for,
)
from rigtool.experiments.force_model.records import Record
from rigtool.experiments.force_model.sliding_problem import SLIDING_PARAMETERS, _strokes, measured
from tests.experiments.force_model import known_plant

KNOWN = Known(3.4, 3.2, 3e-6)
OF_FRICTION = {
    Kind.OFFSET,
    Kind.BEARING,
    Kind.STRIBECK,
    Kind.BEARING_DAMPING,
    Kind.HOUSING,
    Kind.VISCOUS,
}


@given(st.floats(0.01, 100), st.floats(0.01, 100), st.floats(0.01, 100))
def test_what_may_be_learned_scales_with_the_rig(friction, ripple, speed):
    usual = terms_for(Sizes(5e-3, 1e-3, 0.05, 1.0, 20.0), KNOWN)
    other = terms_for(Sizes(5e-3 * friction, 1e-3 * ripple, 0.05, 1.0, 20.0 * speed), KNOWN)
    for one, two in zip(usual, other, strict=True):
        factor = friction if one.kind in OF_FRICTION else 1.0
        if one.kind == Kind.VISCOUS:
            factor /= speed
        if one.kind in (Kind.COGGING, Kind.RIPPLE):
            factor = ripple
        assert two.spread == pytest.approx(one.spread * factor, rel=1e-9)
        assert (two.kind, two.order, two.quarter) == (one.kind, one.order, one.quarter)


def test_waves_have_cosine_and_sine_of_each_order_and_fade_with_it():
    """Cogging by its order, ripple and friction by its root, the others not at all."""
    terms = terms_for(Sizes(5e-3, 1e-3, 0.05, 1.0, 20.0), KNOWN)
    fades = {Kind.COGGING: 1.0, Kind.RIPPLE: 0.5, Kind.HOUSING: 0.5}
    for kind in Kind:
        waves = {(t.order, t.quarter): t.spread for t in terms if t.kind is kind and t.order}
        orders = sorted({order for order, _ in waves})
        assert orders == list(range(1, len(orders) + 1))
        assert set(waves) == {(order, quarter) for order in orders for quarter in (0, 1)}
        for (order, _), spread in waves.items():
            assert spread == pytest.approx(waves[1, 0] * order ** -fades.get(kind, 0.0))
    assert len({(t.kind, t.order, t.quarter) for t in terms}) == len(terms)


def test_maps_go_once_around_the_turn():
    terms = (Term(Kind.COGGING, 1.0, 3, 1), Term(Kind.VISCOUS, 1.0, 1, 0))
    maps = tabulated(terms, np.array([2.0, 0.5]))
    turn = np.arange(len(maps)) / (len(maps) - 1)
    assert {tuple(np.round(column, 9)) for column in maps.T} == {
        tuple(np.round(2 * np.sin(6 * np.pi * turn), 9) + 0.0),
        tuple(np.round(0.5 * np.cos(2 * np.pi * turn), 9) + 0.0),
        tuple(np.zeros(len(maps))),
    }


@pytest.mark.parametrize("cycles", [3, 6])
def test_a_stroke_begins_where_the_motion_turns(cycles):
    record = known_plant.strokes(2e-3, 4.0, cycles=cycles)
    begins = np.flatnonzero(np.diff(_strokes(record, 0.05)))
    step = record.count / record.angle.size
    turns = np.flatnonzero(np.diff(np.sign(np.diff(record.angle))))
    assert len(begins) == 2  # the record is the mean cycle: to and fro
    for begin in begins:
        assert np.abs(turns * step - begin).min() < 0.05 * record.count / len(begins)


STEP, CONSTANT, MOMENT, INERTIA = 0.2e-3, 0.05, 0.06, 2e-4
SHAPE = Shape(0.02, 0.15, 0.01, 2.0, 5e-3, 1.0, 2e-3, 1e-3, 1e-6, 2e-3)
COEFFICIENTS = {
    Term(Kind.OFFSET, 1.0): 1e-3,
    Term(Kind.INERTIA, 1.0): 1e-5,
    Term(Kind.VISCOUS, 1.0): 1e-4,
    Term(Kind.VISCOUS, 1.0, 1, 1): 3e-5,
    Term(Kind.COGGING, 1.0, 2, 0): 1e-3,
    Term(Kind.RIPPLE, 1.0, 3, 1): 2e-3,
    Term(Kind.GAIN_RIPPLE, 1.0, 1, 0): 0.05,
    Term(Kind.SQUARE_RIPPLE, 1.0, 2, 1): 0.04,
    Term(Kind.BEARING, 1.0): 4e-3,
    Term(Kind.STRIBECK, 1.0): 3e-3,
    Term(Kind.BEARING_DAMPING, 1.0): 1e-5,
    Term(Kind.HOUSING, 1.0): 5e-3,
    Term(Kind.LOAD_FRICTION, 1.0): 0.2,
    Term(Kind.CARRIED, 1.0): 0.05,
    Term(Kind.DELAY, 1.0): 1e-3,
}


def moved_by_the_filter(coefficients, shape):
    """Return a model, and its motion under a load by the equations of the filter: 1.2 s, to and
    fro behind a set point."""
    known = Known(3.4, 3.2, 3e-5, 5e-3)
    values, none = (
        np.array(list(coefficients.values())),
        np.eye(len(SLIDING_PARAMETERS) + len(coefficients)),
    )
    model = LearnedModel(tuple(coefficients), shape, known, values, none, np.ones(2))
    plant, drive = plant_of(model, STEP), drive_of(model)
    plant = replace(plant, grasper_inertia=plant.grasper_inertia + INERTIA)
    numbers, x, lagging = as_record(plant)[0], np.zeros(STATES), np.zeros(2)
    angle, current = np.empty((2, 6000))
    for k, phase in enumerate(2 * math.pi * 1.3 * STEP * np.arange(6000)):
        away = 1.5 * (1 - math.cos(phase)) - x[ANGLE]
        slower = 1.5 * 2 * math.pi * 1.3 * math.sin(phase) - x[SPEED]
        angle[k], current[k] = x[ANGLE], (0.3 * away + 5e-3 * slower) / CONSTANT
        own = slice(k, k + 1)
        torque, drag = drive.torque(angle[own], current[own], CONSTANT, STEP, lagging)
        x[TORQUE] = MOMENT * math.sin(x[GRASPER])
        advance(x, numbers, plant.friction_map, torque[0], drag[0], None, 0, 0.0, 0.0)
    trusted = np.ones(6000, dtype=bool)
    return model, Record(
        STEP, angle, current, trusted, CONSTANT, MOMENT, INERTIA, 0, np.empty((0, 0))
    )


WAVE, LOAD_WAVE = (
    {Term(Kind.HOUSING, 1.0, 1, 0): 2e-3},
    {Term(Kind.LOAD_FRICTION, 1.0, 2, 1): 0.1},
)


@pytest.mark.parametrize(
    ("more", "ratio"),
    [(WAVE, 1.0), ({}, 1.25), (LOAD_WAVE, 1.0), (WAVE | LOAD_WAVE, 0.8)],
)
def test_what_is_learned_is_what_the_filter_moves_by(more, ratio):
    """Each term is 0.15 to 4 mN m of the torque, which adds up within 0.06; friction that differs
    by direction is 1 mN m of it."""
    shape = replace(SHAPE, direction_ratio=ratio)
    model, record = moved_by_the_filter(COEFFICIENTS | more, shape)
    state = RecordState.of(shape, model.known, record)
    values = functions(model.terms, state)
    inside = slice(30, -30)
    for term, value in zip(model.terms, record.rows(values)[:, inside], strict=True):
        assert np.sqrt(np.mean(value**2)) * (COEFFICIENTS | more)[term] > 0.14e-3
    found = model.coefficient @ values + state.carried / model.known.torque_factor
    error = record.rows(found - measured(record, model.known))[inside]
    assert np.sqrt(np.mean(error**2)) < 0.06e-3
    # a prediction that is made at one shape holds at others
    predicted = Prediction(model.terms, model.coefficient, values, shape, state)
    np.testing.assert_allclose(predicted.torque(shape), found, rtol=0, atol=1e-12)
    for name in ("ripple_time", "stribeck_speed", "load_onset", "stiffness", "direction_ratio"):
        other = replace(shape, **{name: 1.3 * getattr(shape, name)})
        there = RecordState.of(other, model.known, record)
        whole = model.coefficient @ functions(model.terms, there)
        whole += there.carried / model.known.torque_factor
        np.testing.assert_allclose(predicted.torque(other), whole, rtol=0, atol=1e-12)
