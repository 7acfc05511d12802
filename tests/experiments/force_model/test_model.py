"""What a model of motor and instrument may learn, and its maps over the turn."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rigtool.experiments.force_model.drive import tabulated
from rigtool.experiments.force_model.model import Kind, Known, Sizes, Term, terms_for
from rigtool.experiments.force_model.sliding_problem import _strokes
from tests.experiments.force_model import known_plant

KNOWN = Known(3.4, 3.2, 3e-6)
OF_FRICTION = {
    Kind.OFFSET,
    Kind.BEARING,
    Kind.STRIBECK,
    Kind.BEARING_DAMPING,
    Kind.HOUSING,
    Kind.HOUSING_SIDED,
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
