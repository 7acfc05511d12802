"""Repeats in groups by condition and speed, and what is stated of them."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from rigtool.experiments.ripple import imported_groups
from rigtool.experiments.ripple.imported_groups import RepeatedRuns, cells_for, groups_of
from rigtool.experiments.ripple.imported_turns import Turns
from rigtool.experiments.ripple.orders import (
    HIGHEST_ORDER,
    WAVEFORM_CELLS,
    Ripple,
    Spectrum,
    spectrum,
)
from rigtool.quantity import Quantity, combined, error_line
from tests.experiments.ripple.fine import FINE


def recording(setpoint=None, **conditions):
    stated = {name: Quantity(float(value), "1", 0.0) for name, value in conditions.items()}
    signals = {"encoder": np.zeros(4), "position": np.zeros(4), "time": np.arange(4.0)}
    if setpoint is not None:
        signals["speed_setpoint"] = np.array(setpoint)
    return SimpleNamespace(conditions=stated, has=signals.__contains__, read=signals.__getitem__)


def turns(speed, value=0.0, rows=2, orders=10, step=0.01, a_row=1.0, leak=0.0):
    torque = np.full((rows, 50), value)
    return Turns(
        torque, 2 * torque, speed, 0.0, orders, a_row, step, np.full(20, 30.0), np.full(20, leak)
    )


def test_repeats_are_of_one_condition_and_speed_within_a_tenth():
    given = [
        (recording(compensation=0), turns(3.0, 1.0, orders=12, leak=0.2)),
        (recording(compensation=1), turns(3.0, 2.0)),
        (recording(compensation=0), turns(3.29, 3.0, rows=3, a_row=1.5, step=0.03, leak=0.4)),
        (recording(compensation=0), turns(3.31, 4.0)),
        (recording(compensation=0), turns(-3.0, 5.0)),
    ]
    found = groups_of(*zip(*given, strict=True))
    assert [group.runs for group in found] == [2, 1, 1, 1]
    first = found[0]
    assert first.conditions == {"compensation": 0.0}
    assert first.speed == pytest.approx(3.145)
    assert first.torque.mean(axis=1).tolist() == [1, 1, 3, 3, 3]
    assert first.deviation.mean(axis=1).tolist() == [2, 2, 6, 6, 6]
    assert first.orders == 10
    assert first.turns == pytest.approx(2 + 3 * 1.5)
    assert first.sampling.step == pytest.approx(0.02)
    assert first.alias.tolist() == [30.0] * 10
    np.testing.assert_allclose(first.leak, np.full(10, 0.3))
    assert [group.label() for group in found[:2]] == [
        "compensation 0, 3.15 rad/s",
        "compensation 1, 3 rad/s",
    ]


def test_a_group_of_three_has_the_means_of_what_they_sample_by():
    own = [turns(speed, step=step) for speed, step in ((3.0, 0.01), (3.1, 0.02), (3.05, 0.06))]
    (group,) = groups_of([recording() for _ in own], own)
    assert group.sampling.step == pytest.approx(0.03)
    assert group.speed == pytest.approx(3.05)


def test_a_gap_limits_the_orders_to_half_a_cycle_in_it():
    own = turns(3.0, 1.0, orders=20)
    own.torque[:, 10:15] = np.nan  # a tenth of a turn
    (group,) = groups_of([recording()], [own])
    assert group.orders == 5
    assert np.isfinite(group.torque).all()


@pytest.mark.parametrize(
    ("asked", "expected"),
    [(None, None), ([3.0, 3.002, 2.999, 9.0], 3.0), ([3.0, 3.1, 4.0, 9.0], None)],
)
def test_a_speed_that_was_asked_for_is_that_of_most_samples(asked, expected):
    (group,) = groups_of([recording(asked)], [turns(3.0)])
    assert group.setpoint == (None if expected is None else pytest.approx(expected, rel=1e-3))


def repeated(torque, leak=None):
    orders = 20
    rows = Ripple(torque, FINE)
    leak = np.zeros(orders) if leak is None else leak
    none = np.full(orders, np.nan)
    group = RepeatedRuns({}, 3.0, 1, torque, torque, orders, len(torque), FINE, none, leak)
    group.spectra["torque"] = spectrum(rows, orders)
    return group


def test_u_is_the_scatter_of_amplitudes_and_what_an_alias_may_hide():
    angle = 2 * np.pi * (np.arange(WAVEFORM_CELLS) + 0.5) / WAVEFORM_CELLS
    rng = np.random.default_rng(1)
    wave = 0.5 * np.cos(3 * angle)
    groups = [repeated(wave + rng.normal(0, 0.5, (10, WAVEFORM_CELLS))) for _ in range(60)]
    amplitude = [group.spectra["torque"].amplitude[2] for group in groups]
    stated = np.sqrt(np.mean([group.u[2] ** 2 for group in groups]))
    assert stated == pytest.approx(np.std(amplitude), rel=0.25)
    # what leaks in lies evenly in a rectangle of all that shows (GUM 4.3.7)
    leak = np.zeros(20)
    leak[2] = 0.8
    hidden = repeated(np.tile(wave, (4, 1)), leak).u
    assert hidden[2] == pytest.approx(0.8 * 0.5 / math.sqrt(3), rel=1e-3)
    assert hidden[5] == pytest.approx(0, abs=1e-9)


def test_degrees_of_freedom_are_those_of_the_turns_and_more_where_an_alias_may_hide():
    rows = np.random.default_rng(3).normal(0, 0.5, (7, WAVEFORM_CELLS))
    np.testing.assert_allclose(repeated(rows).dof, 12, rtol=1e-9)  # two for each repeat
    leak = np.full(20, 0.9)
    group = repeated(rows, leak)
    found = group.spectra["torque"]
    for order, dof in enumerate(group.dof):
        hidden = 0.9 * found.amplitude[order] / math.sqrt(3)
        lines = [
            error_line("scatter", found.u[order], "N m", 12),
            error_line("alias", hidden, "N m"),
        ]
        assert dof == pytest.approx(combined(0.0, "N m", lines).dof)
    assert np.isinf(repeated(rows[:1], leak).dof).all()


def test_of_noise_alone_one_order_stands_out_on_average():
    rng = np.random.default_rng(2)
    order = np.arange(1.0, 401)
    counts = []
    for _ in range(200):
        # squared amplitudes of noise are exponential
        amplitude = np.sqrt(rng.exponential(1.0, 400))
        group = repeated(np.zeros((2, WAVEFORM_CELLS)))
        group.spectra["torque"] = Spectrum(order, amplitude, 0 * order, np.ones(400))
        counts.append(group.clear().sum())
    assert np.mean(counts) <= 1.2


def test_a_turn_has_as_many_cells_as_samples_fill(monkeypatch):
    samples = {"dense": 12000, "sparse": 900}
    angles = {name: 2 * np.pi * np.linspace(0, 3, 3 * count) for name, count in samples.items()}
    angles["gap"] = angles["dense"][np.abs(np.mod(angles["dense"], 2 * np.pi) - 1) > 0.02]
    monkeypatch.setattr(imported_groups, "position_of", angles.__getitem__)
    # two samples a cell, five cells an order, at most 1000 orders
    assert cells_for(["dense"]) == 5 * 1000
    assert cells_for(["dense", "sparse"]) == WAVEFORM_CELLS
    assert cells_for(["gap"]) == WAVEFORM_CELLS
    angles["middle"] = 2 * np.pi * np.linspace(0, 3, 3 * 6006)
    assert cells_for(["middle", "dense"]) == 5 * 600
    assert HIGHEST_ORDER < 600


@pytest.mark.parametrize(("missing", "fine"), [(2, True), (3, False)])
def test_a_gap_of_half_a_cycle_of_the_highest_order_is_the_largest(monkeypatch, missing, fine):
    """Of 1000 orders in 5000 cells: two and a half."""
    turned = np.linspace(0, 3, 36000)
    cell = np.floor(np.mod(turned, 1.0) * 5000)
    kept = (cell < 100) | (cell >= 100 + missing)
    monkeypatch.setattr(imported_groups, "position_of", lambda _: 2 * np.pi * turned[kept])
    assert cells_for(["gap"]) == (5000 if fine else WAVEFORM_CELLS)
