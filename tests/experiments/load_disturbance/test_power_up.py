"""How far a load is off that is read at another power-up of the amplifier."""

from types import SimpleNamespace

import numpy as np
import pytest

from rigtool.experiments.force_model.model import Kind, Term
from rigtool.experiments.force_model.sliding_problem import SLIDING_PARAMETERS
from rigtool.experiments.load_disturbance.power_up import GROWING, ripple_u

ORDERS = (1, 2, 5)


@pytest.fixture
def given():
    """A model of three orders in all kinds of ripple, and the derivatives of a load by it."""
    kinds = (Kind.RIPPLE, *GROWING)
    terms = tuple(Term(kind, 1.0, n, k) for kind in kinds for n in ORDERS for k in (0, 1))
    rng, size = np.random.default_rng(5), len(SLIDING_PARAMETERS) + len(terms)
    root = rng.normal(size=(size, size))
    coefficient = rng.normal(size=len(terms))
    model = SimpleNamespace(terms=terms, coefficient=coefficient, covariance=root @ root.T)
    return model, rng.normal(size=size)


def test_a_power_up_turns_each_order_that_grows_by_a_phase_of_its_own(given):
    """By 20000 draws of the phases, all but their own scatter."""
    model, by = given
    model.covariance = 0 * model.covariance
    phases = np.random.default_rng(6).uniform(0, 2 * np.pi, (20000, len(ORDERS)))
    off = np.zeros(len(phases))
    derivative = by[len(SLIDING_PARAMETERS) :]
    for number, term in enumerate(model.terms):
        if term.kind in GROWING and term.quarter == 0:
            turn = phases[:, ORDERS.index(term.order)]
            a, b = model.coefficient[number : number + 2]
            along, across = derivative[number : number + 2]
            off += along * (a * np.cos(turn) - b * np.sin(turn) - a)
            off += across * (a * np.sin(turn) + b * np.cos(turn) - b)
    assert ripple_u(model, by) == pytest.approx(np.sqrt(np.mean(off**2)), rel=0.02)


def test_what_is_known_of_a_sum_alone_is_unknown_once_a_part_of_it_has_gone(given):
    model, by = given
    model.coefficient = 0 * model.coefficient
    others = by.copy()
    for number, term in enumerate(model.terms):
        if term.kind in GROWING:
            others[len(SLIDING_PARAMETERS) + number] = 0.0
    # the sum is known well, its parts are not
    size = len(by)
    model.covariance = np.eye(size) - (1 - 1e-4) * np.outer(by, by) / (by @ by)
    known, alone = (each @ model.covariance @ each for each in (by, others))
    assert alone > 100 * known
    assert ripple_u(model, by) == pytest.approx(np.sqrt(alone - known))
    # a part that is known better than the sum takes nothing off
    model.covariance = np.eye(size)
    assert ripple_u(model, by) == 0.0
