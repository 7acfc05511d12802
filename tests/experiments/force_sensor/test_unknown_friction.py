"""Friction that the tables do not hold is found in the motion; forces from outside are not it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rigtool.experiments.force_sensor.unknown_friction import (
    ANGLE_CELLS,
    DOUBTED,
    REFUSED,
    Passes,
    driven_part,
    lasting_torque,
    unknown_friction,
    unknown_share,
)
from tests.thorough import thorough

U, PASSES = 0.4e-3, 12


def strokes(rng, friction=0.0, load=lambda direction, cell: 0.0, touched=0.0):
    """Return passes to and fro: their own friction, some that others touch, and a load."""
    direction = np.tile([1.0, -1.0], PASSES)
    torque = rng.normal(0, 0.25e-3, (len(direction), 1)) + direction[:, None] * friction
    cells = np.arange(ANGLE_CELLS)
    torque = torque + np.array([[load(d, c) for c in cells] for d in direction])
    order = np.tile(rng.permuted(np.tile(np.arange(PASSES)[:, None], 2), axis=0).ravel(), 1)
    touching = order < touched * PASSES
    torque += np.where(touching[:, None], rng.choice([-30e-3, 30e-3], (len(direction), 1)), 0.0)
    return Passes(direction, torque, np.full_like(torque, U))


@given(
    seed=st.integers(0, 2**31),
    friction=st.floats(1e-3, 5e-3),
    sign=st.sampled_from([-1, 1]),
    touched=st.floats(0.0, 0.5),
)
def test_friction_in_both_directions_is_found_whatever_touches(seed, friction, sign, touched):
    passes = strokes(np.random.default_rng(seed), sign * friction, touched=touched)
    found = unknown_friction([passes])
    assert found.size == pytest.approx(friction, abs=0.35e-3)
    assert found.size <= found.widening <= 2 * found.size
    assert found.over_u > DOUBTED
    assert found.typical * U == pytest.approx(friction, abs=0.35e-3)


@pytest.mark.parametrize("count", [2, 8, *thorough(4)])
def test_few_strokes_that_deviate_by_u_show_friction_by_chance(count):
    rng, noted, learn_again = np.random.default_rng(count), 0, 0
    direction = np.tile([1.0, -1.0], count)
    for _ in range(300):
        torque = np.tile(rng.normal(0, U, (2 * count, 1)), ANGLE_CELLS)
        found = unknown_friction([Passes(direction, torque, np.full_like(torque, U))])
        if found is not None and found.over_u > DOUBTED:
            noted += 1
            assert found.passes == count
            learn_again += not found.by_chance
    assert noted > 10
    assert learn_again <= 6


LOADS = {
    "grasping while closing": lambda direction, cell: 20e-3 * (direction > 0),
    "grasping both ways": lambda direction, cell: 20e-3,
    "tissue": lambda direction, cell: 1e-3 * max(cell - 8, 0),
    "touching both ways at one place": lambda direction, cell: 10e-3 * direction * (cell == 7),
}


@pytest.mark.parametrize("load", LOADS.values(), ids=LOADS)
@given(seed=st.integers(0, 2**31), touched=st.floats(0.0, 0.3))
def test_forces_from_outside_are_no_friction(load, seed, touched):
    found = unknown_friction([strokes(np.random.default_rng(seed), load=load, touched=touched)])
    if found is not None:  # else too few passes are alike
        assert found.over_u < 0.6
        assert found.typical < 0.6
        assert found.widening < U


@pytest.mark.parametrize(("periods", "passes"), [(7 + 1 / 3, 24), (11 / 3, 50), (18 + 1 / 3, 10)])
@pytest.mark.parametrize("size", [6e-3, 10e-3])
def test_a_force_that_swings_all_the_time_is_no_friction(periods, passes, size):
    """It meets an angle at three phases, in either direction: a third of the passes are alike."""
    direction = np.tile([1.0, -1.0], passes // 2)
    place = np.arange(ANGLE_CELLS) / ANGLE_CELLS
    place = np.where(direction[:, None] > 0, place, 1 - place)
    turns = periods * (np.arange(passes)[:, None] / 2 + 0.41 * place)
    for begin in np.linspace(0, 1, 7):
        torque = size * np.sin(2 * np.pi * (turns + begin))
        found = unknown_friction([Passes(direction, torque, np.full_like(torque, U))])
        assert found is None or found.typical < REFUSED


def test_a_hand_that_moves_the_rig_is_no_friction():
    passes = strokes(np.random.default_rng(1), -16e-3)
    assert unknown_friction([passes]).typical > REFUSED
    assert unknown_friction([passes], hand=8e-3) is None
    assert unknown_friction([strokes(np.random.default_rng(1), 16e-3)], hand=8e-3) is not None


def test_passes_end_at_reversals_and_where_there_is_no_value():
    angle = np.concatenate([np.linspace(0, 1, 500), np.linspace(1, 0, 500)])
    torque = np.concatenate([np.full(500, 2e-3), np.full(500, -1e-3)])
    sliding = np.ones(1000, dtype=bool)
    sliding[[*range(20), *range(240, 260), *range(490, 520)]] = False
    passes = Passes.of(5e-3, angle, sliding, (0.0, 1.0), torque, np.full(1000, U))
    assert passes.direction.tolist() == [1.0, 1.0, -1.0]
    for row, value, cells in zip(passes.torque, (2e-3, 2e-3, -1e-3), (12, 11, 23), strict=True):
        known = np.isfinite(row)
        assert abs(known.sum() - cells) <= 1
        np.testing.assert_allclose(row[known], value, rtol=1e-9)
    assert unknown_friction([passes]) is None


@given(seed=st.integers(0, 2**31), friction=st.sampled_from([-4e-3, 2e-3, 4e-3]))
def test_two_passes_in_both_directions_show_friction(seed, friction):
    """A recording of two cycles shows an encoder that was zeroed elsewhere."""
    whole = strokes(np.random.default_rng(seed), friction)
    found = unknown_friction([Passes(whole.direction[:4], whole.torque[:4], whole.u[:4])])
    assert found.size == pytest.approx(abs(friction), abs=1e-3)
    assert found.over_u > DOUBTED


def test_stretches_count_together():
    passes = strokes(np.random.default_rng(2), 2e-3)
    parts = [
        Passes(passes.direction[rows], passes.torque[rows], passes.u[rows])
        for rows in (slice(0, 3), slice(3, None))
    ]
    assert unknown_friction(parts) == unknown_friction([passes])
    assert unknown_friction(parts[:1]) is None


def reversals(share, load, turns=6):
    """Return passes of strokes of 1 s, in each of which a `load` (turns,) N m touches."""
    step, rows = 5e-3, 200
    phase = np.arange(turns * rows)
    angle = 1e-2 * np.where(phase // rows % 2, rows - phase % rows, phase % rows)
    way = np.where(phase // rows % 2, -1.0, 1.0)
    acts = load[phase // rows]
    torque = acts + way * share * np.abs(acts)
    sliding = np.minimum(phase % rows, rows - phase % rows) > 5
    u = np.full(len(phase), U)
    return Passes.of(step, angle, sliding, (0.0, 2.0), torque, u)


@pytest.mark.parametrize("share", [-0.06, 0.1])
@pytest.mark.parametrize("load", [30e-3, -30e-3])
def test_friction_under_load_shows_where_the_load_stays_through_reversals(share, load):
    assert unknown_share([reversals(share, np.full(6, load))]) == pytest.approx(share, rel=0.1)


def test_a_spring_at_the_end_of_the_strokes_is_no_friction():
    """The rotor slides sooner before a turn than after it, where its bristles bend."""
    step, rows, turns = 5e-3, 200, 8
    phase = np.arange(turns * rows)
    angle = 1e-2 * np.where(phase // rows % 2, rows - phase % rows, phase % rows)
    torque = 40e-3 * np.maximum(angle - 1.0, 0.0)
    sliding = (phase % rows > 20) & (rows - phase % rows > 1)
    found = Passes.of(step, angle, sliding, (0.0, 2.0), torque, np.full(len(phase), U))
    assert len(found.shares) == 4
    np.testing.assert_allclose(found.shares, 0.0, atol=1e-3)


def test_loads_that_come_and_go_at_reversals_and_few_of_them_show_none():
    assert unknown_share([reversals(0.0, np.full(6, 30e-3))]) == 0.0
    assert unknown_share([reversals(0.1, np.full(4, 30e-3), turns=4)]) == 0.0
    assert unknown_share([reversals(0.0, np.array([40e-3, 0.0] * 3))]) == 0.0
    assert unknown_share([reversals(0.1, np.full(6, 1e-3))]) == 0.0


@given(seed=st.integers(0, 2**31), size=st.floats(1.5e-3, 20e-3), sign=st.sampled_from([-1, 1]))
def test_a_torque_that_lasts_is_found(seed, size, sign):
    rng = np.random.default_rng(seed)
    passes = strokes(rng, 0.3e-3, load=lambda direction, cell: sign * size)
    assert lasting_torque([passes]) == pytest.approx(sign * size, abs=0.4e-3)


@given(seed=st.integers(0, 2**31), begins=st.integers(4, 14))
def test_tissue_that_begins_along_the_stroke_does_not_last(seed, begins):
    rng = np.random.default_rng(seed)
    passes = strokes(rng, load=lambda direction, cell: 0.3e-3 + 4e-3 * max(cell - begins, 0))
    assert lasting_torque([passes]) == 0


@pytest.mark.parametrize("load", ["grasping while closing", "touching both ways at one place"])
@given(seed=st.integers(0, 2**31), friction=st.floats(-3e-3, 5e-3))
def test_what_does_not_act_everywhere_and_both_ways_does_not_last(load, seed, friction):
    passes = strokes(np.random.default_rng(seed), friction, load=LOADS[load])
    assert lasting_torque([passes]) == 0


@pytest.mark.parametrize(("driven", "part"), [(0.0, 0.0), (0.3, 0.0), (0.75, 0.75), (1.0, 1.0)])
def test_a_hand_drives_most_of_the_passes_or_is_not_said_to(driven, part):
    passes = strokes(np.random.default_rng(3))
    hand = np.arange(2 * PASSES) // 2 < driven * PASSES
    torque = passes.torque - np.where(hand, 9e-3 * passes.direction, 0.0)[:, None]
    own = Passes(passes.direction, torque, passes.u)
    assert driven_part([own], 6e-3) == pytest.approx(part)
    one_way = Passes(passes.direction, np.where(passes.direction[:, None] > 0, torque, 0), passes.u)
    assert driven_part([one_way], 6e-3) == 0
