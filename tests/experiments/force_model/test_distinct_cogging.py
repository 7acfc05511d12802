"""Cogging of few, strong orders is found among all that strokes show, and where there is none,
nothing is."""

from dataclasses import replace

import numpy as np
import pytest

from rigtool.experiments.force_model.deviations import Deviations
from rigtool.experiments.force_model.drawn_ripple import learned_ripple
from rigtool.experiments.force_model.drive import drive_of
from rigtool.experiments.force_model.force_model import ForceModel
from rigtool.experiments.force_model.learning import learn_sliding
from rigtool.experiments.force_model.model import Kind, Known
from tests.experiments.force_model import known_plant as plant
from tests.experiments.force_model.known_plant import strokes

KNOWN = Known(plant.RATIO, plant.FACTOR, plant.INERTIA)
CALM = Deviations(2e-4, 1e-3, 1e-4, 0.1)
AMPLITUDES = {7: 1.5e-3, 14: 2.5e-3, 36: 0.4e-3}


def learned(amplitudes):
    """Learn from strokes to which cogging by the rotor's angle was added, with noise."""
    records = []
    for number, (load, speed) in enumerate((m, v) for m in (0.0, 50e-3) for v in (1.0, 4.0)):
        one = strokes(load, speed, noise=(5e-5, 0.15), seed=number)
        added = sum(a * np.sin(order * one.angle + 1) for order, a in amplitudes.items())
        records.append(replace(one, current=one.current + added / plant.CONSTANT))
    return learn_sliding(records, KNOWN, plant.COUNT, CALM).learned


def distinct(model):
    return {t.order for t in model.terms if t.kind is Kind.DISTINCT_COGGING}


@pytest.fixture(scope="module")
def geared():
    return learned(AMPLITUDES)


def test_orders_that_stand_out_are_learned_alike_at_all_speeds(geared):
    assert distinct(geared) == set(AMPLITUDES)
    angle = np.linspace(0.5, 2.0, 500)
    torque, _ = drive_of(geared).torque(angle, np.zeros(500), plant.CONSTANT, 10.0)
    waves = [q(order * angle) for order in AMPLITUDES for q in (np.sin, np.cos)]
    slow = [q(k * angle / 2) for k in range(5) for q in (np.sin, np.cos)]
    found = np.linalg.lstsq(np.array([*waves, *slow]).T, -torque, rcond=None)[0][:6]
    amplitude = np.hypot(*found.reshape(-1, 2).T)
    assert amplitude == pytest.approx(list(AMPLITUDES.values()), rel=0.1)


def test_another_power_up_draws_no_cogging(geared):
    drawn = learned_ripple(ForceModel(geared, CALM))
    by_order = dict(zip(drawn.orders.tolist(), drawn.drawn[::2].tolist(), strict=True))
    assert np.sqrt(max(by_order.get(order, 0.0) for order in (7, 14))) < 0.15e-3


def test_nothing_stands_out_of_what_the_other_terms_explain():
    assert distinct(learned({2: 0.2e-3, 4: 0.1e-3})) == set()
