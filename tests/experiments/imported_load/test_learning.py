"""Levels, speeds, strokes and folds of recordings; how far beyond its levels a model holds."""

import itertools
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from rigtool.errors import InsufficientDataError
from rigtool.experiments.force_filter.motion_states import State
from rigtool.experiments.imported_load import learning
from rigtool.experiments.imported_load.learning import (
    _folds,
    _friction,
    _inner,
    _margins,
    _paces,
    _slack,
    _strokes,
    _turns,
    learn_load_model,
    level_numbers,
    resisted_direction,
)
from rigtool.experiments.imported_load.region import MARGIN, NARROW
from rigtool.experiments.imported_load.side import INTERVAL_COVERAGE
from tests.experiments.imported_load.loaded_drive import observations, observe


def moving(low, high, speed=1.0):
    """A recording whose transient at its start is elsewhere and faster."""
    position, speeds = np.array([99.0, low, high, high]), np.array([50.0, speed, -speed, speed])
    regular = np.array([False, True, True, True])
    return SimpleNamespace(path=SimpleNamespace(position=position, speed=speeds, regular=regular))


def test_strokes_at_one_place_are_one_whatever_their_order():
    middles, number = _strokes(
        [moving(4.0, 6.0), moving(0.0, 1.0), moving(4.05, 6.0), moving(0.0, 1.01)]
    )
    np.testing.assert_allclose(middles, [(0.5 + 0.505) / 2, (5 + 5.025) / 2], rtol=1e-12)
    assert number.tolist() == [1, 0, 1, 0]


def test_strokes_are_apart_by_a_part_of_the_longest():
    """A short stroke beside a long one is the same place."""
    middles, number = _strokes([moving(0.0, 10.0), moving(5.1, 5.3)])
    assert number.tolist() == [0, 0]
    assert len(middles) == 1


def test_paces_are_those_of_the_motion_without_its_transients():
    assert _paces([moving(0, 1, 2.0), moving(0, 1, 1.0), moving(0, 1, 2.02)]).tolist() == [1, 0, 1]
    still = moving(0, 1, 1.0)
    still.path.regular[:] = False
    assert _paces([moving(0, 1, 2.0), still]).tolist() == [1, 0]


@pytest.mark.parametrize(
    ("values", "levels"),
    [
        ([1.0, 3.0, 2.0, -1.01], [0, 2, 1, 0]),
        ([1.0, 1.09], [0, 0]),  # a tenth of the highest apart: repeats
        ([1.0, 1.12], [0, 1]),
        ([0.0, 4.0, 4.9, 9.0], [0, 1, 1, 2]),  # a quarter of the widest gap
        ([0.0, 4.0, 5.1, 9.0], [0, 1, 2, 3]),
        ([5.0], [0]),
        ([0.0, 0.0], [0, 0]),
    ],
)
def test_levels_are_apart_by_a_quarter_of_the_widest_gap(values, levels):
    assert level_numbers(values) == levels


def test_folds_leave_each_load_out_once():
    numbers = np.repeat(np.arange(4), 3)
    folds, levels = _folds(numbers)
    assert (folds.tolist(), levels) == (numbers.tolist(), 4)
    folds, levels = _folds(np.arange(25))
    assert levels == 25
    counts = np.bincount(folds)
    assert len(counts) == 10
    assert set(counts.tolist()) == {2, 3}
    assert _folds(np.array([0, 0, 1, 1]))[1] == 2
    with pytest.raises(InsufficientDataError, match="are at one load"):
        _folds(np.zeros(5, dtype=int))
    with pytest.raises(InsufficientDataError, match="3 recordings at two loads leave nothing"):
        _folds(np.array([0, 0, 1]))


def test_recordings_are_left_out_with_other_repeats_of_other_levels():
    level = np.repeat(np.arange(3), 3)
    turns = _turns(level)
    for one in range(3):
        assert sorted(level[turns == one].tolist()) == [0, 1, 2]
        repeats = np.flatnonzero(turns == one) % 3
        assert len(set(repeats.tolist())) == 3


def test_errors_of_levels_left_out_are_within_their_u():
    """And loads are looked for up to a part of their distance beyond them."""
    learned = learn_load_model(observations(frequencies=(0.15, 0.3)))
    found, model = learned.validation, learned.model
    held = np.abs(found.error) <= 1.96 * found.u
    assert 0.92 < held.mean() < 0.995
    for against in (True, False):
        rows = found.against == against
        rms = np.sqrt(np.mean(found.error[rows] ** 2))
        assert rms == pytest.approx(np.sqrt(np.mean(found.u[rows] ** 2)), rel=0.5)
    # loads of 20 to 80 mN m vary by a tenth along the stroke
    ends = np.array([-0.08 * 1.097, -0.02 * 0.903])
    beyond = MARGIN * np.ptp(ends) / 3 * np.array([-1, 1])
    expected = (ends + beyond) / model.scales.torque
    np.testing.assert_allclose(model.torque_range, expected, atol=0.02)


def test_the_first_and_the_last_are_no_inner_ones():
    assert _inner(np.array([0, 1, 2, 3, 2])).tolist() == [-1, 1, 2, -1, 2]


def side(levels, factors):
    return SimpleNamespace(levels=np.array(levels), factors=np.array(factors))


EVEN = [1.0, 1.0, 1.0, 1.0, 1.0, 1.0]
LEVELS = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]


@pytest.mark.parametrize(("direction", "driving"), [(1, 1), (-1, 0)])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_model_holds_beyond_its_levels_but_not_where_the_heaviest_drives(
    direction, driving, sign
):
    levels = np.sort(sign * np.array(LEVELS))
    found = _margins([side(levels, EVEN)] * 2, direction, [NARROW, 1.0])
    expected = np.full((2, 2), MARGIN)
    expected[driving, 1 if sign > 0 else 0] = NARROW
    np.testing.assert_array_equal(found, expected)


def test_an_end_that_asked_for_a_wider_interval_holds_less_far():
    ratio = 1.96 / 1.44
    wide, less = (side(LEVELS, [part * ratio, 1, 1, 1, 1, 1]) for part in (1.01, 0.99))
    np.testing.assert_array_equal(_margins([wide, wide], 1, [1.0, 1.0])[0], [NARROW, MARGIN])
    np.testing.assert_array_equal(_margins([less, less], 1, [1.0, 1.0])[0], [MARGIN, MARGIN])
    few = side([0.0, 1.0, 2.0, 3.0], [1.0] * 4)
    np.testing.assert_array_equal(_margins([few, few], 1, [1.0, 1.0]), np.full((2, 2), NARROW))
    scatter = _margins([few, few], 1, [0.1, 1.0])  # no farther than that
    np.testing.assert_array_equal(scatter, [[0.1, 0.1], [NARROW, NARROW]])


def test_dead_bands_hold_the_torque_at_each_level():
    """By the quantile of what readings at rest are off beyond a rectangle of their u."""
    off = np.linspace(0, 1, 201)
    states = np.where(np.arange(201) % 2, State.STILL, State.AGAINST)
    at_rest = np.arange(201) % 2 == 1

    def read(one):
        return SimpleNamespace(states=states, torque=one.sensor + one.off, u=np.full(201, 0.1))

    model = SimpleNamespace(read=read, scales=SimpleNamespace(torque=2.0))
    signals = [SimpleNamespace(sensor=np.ones(201), off=-factor * off) for factor in (1.0, 3.0)]
    expected = np.quantile(3 * off[at_rest], INTERVAL_COVERAGE) - 0.1 * np.sqrt(3)
    found = _slack(model, signals, np.array([0, 1]))
    assert found == pytest.approx(expected / 2, rel=1e-9)
    quiet = [SimpleNamespace(sensor=np.ones(201), off=0 * off)]
    assert _slack(model, quiet, np.array([0])) == 0.0


@pytest.mark.parametrize("load", [1, -1])
@pytest.mark.parametrize("wired", [1, -1])
def test_the_load_resists_the_direction_in_which_it_adds_to_friction(load, wired):
    """Whatever the signs of load and current."""
    rows = [
        SimpleNamespace(effort=np.array([wired * (2.0 * load + way)]), torque=np.array([load]))
        for way in (1, -1)
    ]
    assert resisted_direction(rows, 2.0 * wired) == load


def test_friction_by_load_is_half_of_what_slopes_of_both_directions_differ_by():
    cells = 20
    place = np.tile((np.arange(cells) + 0.5) / cells, 2)
    against = np.repeat([True, False], cells)
    mu = 0.1 + 0.05 * place
    slope = 3.0 * np.where(against, 1 + mu, 1 - mu)
    scales = SimpleNamespace(low=10.0, high=30.0)
    each = [np.where(against, slope * f, slope) for f in (0.98, 1.0, 1.02)]
    found = _friction(place, against, scales, slope, each)
    centre = (found.position - 10.0) / 20.0
    np.testing.assert_allclose(found.mu, 0.1 + 0.05 * centre, atol=3e-3)
    assert found.dof == 2
    # the jackknife over the folds: (n - 1)/n times the sum of squares
    means = [f * (1 + found.mu) for f in (0.98, 1.0, 1.02)]
    folds = np.array([(up - (1 - found.mu)) / (up + (1 - found.mu)) for up in means])
    np.testing.assert_allclose(found.u, np.std(folds, axis=0) * np.sqrt(2), rtol=1e-2)


@pytest.mark.parametrize(
    ("frequencies", "zeros", "several"),
    [((0.2,), (0.0,), False), ((0.15, 0.3), (0.0,), True), ((0.2,), (0.0, 40.0), True)],
)
def test_speeds_are_compared_where_several_or_other_strokes_were_learned(
    monkeypatch, frequencies, zeros, several
):
    class LearnedError(Exception):
        pass

    def region(*values, several):
        raise LearnedError(several)

    monkeypatch.setattr(learning, "learn_region", region)
    made = [
        one
        for zero in zeros
        for one in observations(loads=(0.02, 0.05, 0.08), frequencies=frequencies, zero=zero)
    ]
    with pytest.raises(LearnedError) as found:
        learn_load_model(made)
    assert found.value.args == (several,)


def test_the_loop_of_three_loads_is_that_of_tables_which_show_how_effort_bends():
    """Left out, the middle one of three is on a line between the others."""
    bent = []
    for load, frequency in itertools.product((0.02, 0.05, 0.08), (0.1, 0.2, 0.3)):
        own = observe(load, frequency, seed=len(bent))
        way = np.tanh(own.path.speed / 0.5)
        bent.append(replace(own, effort=own.effort + 30 * way * own.sensor**2))
    learned = learn_load_model(bent)
    assert learned.model.loop.offset * learned.model.scales.torque < 1e-3
    left_out = learned.validation
    middle = left_out.level == 1
    apart = [np.mean(left_out.error[middle & way]) for way in (left_out.against, ~left_out.against)]
    assert abs(apart[0] - apart[1]) > 3e-3
