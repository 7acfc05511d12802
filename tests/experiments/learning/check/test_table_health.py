"""What became of a learned table: each change is found and reported by its size, and no other."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rigtool.control.lookup_table import LookupTable
from rigtool.errors import InsufficientDataError
from rigtool.experiments.learning.check.results import table_verdict
from rigtool.experiments.learning.check.table_health import _leftovers, _nearest, judge_table, parts
from rigtool.experiments.learning.rows import Row
from tests.thorough import first_of

TURN = 2 * math.pi
COUNT = 1000
SPEED = 6.0
MOVES = 6
FRICTION = 2e-3
ANGLE = np.arange(COUNT) * TURN / COUNT


def pattern(angle, seed=0):
    """Cogging and ripple of several orders, different with each seed."""
    random = np.random.default_rng([9, seed])
    orders = np.array([1, 2, 3, 4, 6, 12])
    amplitude = np.array([0.4, 0.9, 0.3, 0.2, 0.15, 0.1]) * 1e-3 * random.uniform(0.7, 1.3, 6)
    phase = random.uniform(0, TURN, 6)
    return np.cos(np.multiply.outer(angle, orders) + phase) @ amplitude


def noise(random, moves, count, scatter):
    """Scatter of moves with the few cycles a turn that friction has."""
    white = random.standard_normal((moves, count))
    spectrum = np.fft.rfft(white) / np.sqrt(1 + (np.arange(count // 2 + 1) / 5) ** 2)
    drawn = np.fft.irfft(spectrum, count)
    return drawn * scatter / drawn.std()


def learned(seed=0, scatter=1e-4, moves=20, part=slice(None), speeds=(-SPEED, SPEED)):
    random = np.random.default_rng([1, seed])
    position = ANGLE[part]
    rows = []
    for speed in speeds:
        there = pattern(ANGLE) + FRICTION * np.sign(speed)
        rows.append((there + noise(random, moves, COUNT, scatter).mean(axis=0))[part])
    table = LookupTable(
        position,
        np.array(speeds),
        np.stack(rows),
        np.array([0.0, SPEED]),
        np.array([0.0, 1.0]),
        period=TURN if position.size == COUNT else None,
    )
    return table, np.full(table.torque.shape, scatter / math.sqrt(moves))


def now(table, seed=0, *, shift=0.0, scale=1.0, friction=0.0, offset=0.0, other=0, scatter=1e-4):
    """Return rows that a rig shows whose pattern has shifted, grown, changed."""
    random = np.random.default_rng([2, seed])
    first = round(table.position[0] / TURN * COUNT)
    rows = []
    for speed in table.speed:
        there = scale * pattern(ANGLE - shift, other) + offset
        there = there + (FRICTION + friction) * np.sign(speed)
        moves = there + noise(random, MOVES, COUNT, scatter)
        rows.append(Row(float(speed), moves[:, first : first + table.position.size]))
    return rows


def checked(table, u, rows):
    return judge_table(parts(table, u, rows, table.position), table.position, table.period)


SEEDS = range(6)
QUARTER = slice(100, 600)


@pytest.mark.parametrize("seed", first_of(SEEDS))
@pytest.mark.parametrize("part", [slice(None), QUARTER])
def test_an_unchanged_rig_fits(seed, part):
    table, u = learned(seed, part=part)
    found = checked(table, u, now(table, seed))
    assert found.fits
    assert found.pattern_fits
    assert not found.friction_changed
    assert not found.offset_changed
    assert not found.shift_is_enough
    assert abs(found.shift.value) < 5 * found.shift.u
    assert abs(found.scale.value - 1) < 5 * found.scale.u
    assert found.limit == pytest.approx(1e-4, rel=0.4, abs=0)


@pytest.mark.parametrize("seed", first_of(SEEDS))
@pytest.mark.parametrize("shift", [math.pi, 0.5, -2.0])
def test_a_shifted_pattern_is_reported_by_its_shift(seed, shift):
    table, u = learned(seed)
    found = checked(table, u, now(table, seed, shift=shift))
    assert not found.fits
    assert found.shift_is_enough
    assert not found.scale_is_enough
    off = math.remainder(found.shift.value - shift, TURN)
    assert abs(off) < 5 * found.shift.u
    assert found.shift.u < 0.03
    assert found.scale.value == pytest.approx(1, rel=0, abs=5 * found.scale.u)
    assert not found.friction_changed


@settings(max_examples=25, deadline=None)
@given(shift=st.floats(-math.pi, math.pi), seed=st.integers(0, 10_000))
def test_without_scatter_shifts_are_exact(shift, seed):
    table, u = learned(scatter=1e-9)
    found = checked(table, u, now(table, seed, shift=shift, scatter=1e-8))
    # The table is linear between its entries.
    assert abs(math.remainder(found.shift.value - shift, TURN)) < 1e-4
    assert found.scale.value == pytest.approx(1, rel=0, abs=1e-3)


@pytest.mark.parametrize("seed", first_of(SEEDS))
def test_friction_that_has_changed_is_reported_by_its_size(seed):
    table, u = learned(seed)
    found = checked(table, u, now(table, seed, friction=0.5e-3))
    assert not found.fits
    assert found.pattern_fits
    assert found.friction_changed
    assert not found.offset_changed
    assert found.friction.value == pytest.approx(0.5e-3, rel=0, abs=5 * found.friction.u)


def test_what_pulls_one_way_is_no_friction():
    table, u = learned()
    found = checked(table, u, now(table, offset=-0.5e-3))
    assert not found.fits
    assert found.offset_changed
    assert not found.friction_changed
    assert found.offset.value == pytest.approx(-0.5e-3, rel=0, abs=5 * found.offset.u)


@pytest.mark.parametrize("seed", first_of(SEEDS))
@pytest.mark.parametrize("part", [slice(None), QUARTER])
def test_another_pattern_is_neither_shift_nor_scale(seed, part):
    table, u = learned(seed, part=part)
    found = checked(table, u, now(table, seed, other=seed + 1))
    assert not found.fits
    assert not found.pattern_fits
    assert not found.shift_is_enough
    assert not found.scale_is_enough
    if table.period is not None:
        assert found.unexplained.certain
    assert found.even > found.odd


def test_what_shift_and_scale_leave_scatters_by_its_uncertainty():
    variances = []
    for other in (1, 3):
        learnings = [learned(seed) for seed in range(15)]
        found = [
            checked(table, u, now(table, seed, other=other)).unexplained
            for seed, (table, u) in enumerate(learnings)
        ]
        scatter = np.var([one.value for one in found], ddof=1)
        variances.append((scatter, np.mean([one.u**2 for one in found])))
    scatter, stated = np.mean(variances, axis=0)
    assert 1 < stated / scatter < 2.2**2


def test_a_larger_pattern_is_reported_by_its_scale():
    table, u = learned()
    found = checked(table, u, now(table, scale=1.4))
    assert not found.fits
    assert found.scale_is_enough
    assert not found.shift_is_enough
    assert found.scale.value == pytest.approx(1.4, rel=0, abs=5 * found.scale.u)


def test_a_range_does_not_tell_a_shift_for_certain():
    """Half a turn is out of reach, a few degrees may be another pattern."""
    table, u = learned(part=QUARTER)
    for shift in (0.3, math.pi):
        found = checked(table, u, now(table, shift=shift))
        assert not found.fits
        assert not found.whole_turn
        assert not found.shift_is_enough
    assert found.reach == pytest.approx(TURN / 8, rel=0.02, abs=0)


def test_one_direction_cannot_tell_friction():
    table, u = learned(speeds=(SPEED,))
    found = checked(table, u, now(table, friction=0.5e-3))
    assert found.friction is None
    assert found.offset_changed
    assert not found.friction_changed


def test_a_table_without_pattern_has_no_shift():
    table, u = learned()
    flat = LookupTable(
        table.position,
        table.speed,
        np.sign(table.speed)[:, None] * np.full((2, COUNT), FRICTION),
        table.low_speed,
        table.amplitude,
        period=TURN,
    )
    found = checked(flat, u, now(table, other=3))
    assert found.shift is None
    assert found.scale is None
    assert not found.fits
    assert not found.shift_is_enough


@pytest.mark.parametrize("seed", first_of(SEEDS))
def test_uncertainties_hold(seed):
    """Over draws, errors of friction and scale are as large as is said: reduced chi square."""
    errors = []
    for draw in range(12):
        table, u = learned(100 * seed + draw)
        found = checked(table, u, now(table, 100 * seed + draw, shift=1.0, friction=1e-4))
        errors.append((found.friction.value - 1e-4) / found.friction.u)
        errors.append((found.scale.value - 1) / found.scale.u)
    assert 0.3 < np.mean(np.square(errors)) < 3.5


def test_a_scatter_above_the_table_tells_nothing():
    table, u = learned()
    with pytest.raises(InsufficientDataError, match="they do not resolve it"):
        checked(table, u, now(table, scatter=5e-3))


def test_one_move_has_no_scatter():
    table, u = learned()
    rows = [Row(row.speed, row.moves[:1]) for row in now(table)]
    with pytest.raises(InsufficientDataError, match="at least 2"):
        checked(table, u, rows)


def test_a_speed_that_was_not_learned_is_refused():
    table, u = learned()
    rows = [Row(2 * row.speed, row.moves) for row in now(table)]
    with pytest.raises(InsufficientDataError, match="does not cover -12 rad/s"):
        checked(table, u, rows)


@pytest.mark.parametrize(
    ("good", "periodic", "shift"),
    [
        ([8, 3], True, -2),
        ([2, 7], True, 2),
        ([5], True, 5),
        ([6], True, -4),
        ([3], False, -2),
        ([1, 8], False, 3),
    ],
)
def test_of_equally_good_shifts_the_smallest_counts(good, periodic, shift):
    """Ten shifts of a turn, or eleven to either side of a range."""
    left = np.ones(10 if periodic else 11)
    left[good] = 0.005
    left[good[-1]] = 0.0  # the best by less than counts
    assert _nearest(left, periodic) == shift


@pytest.mark.parametrize("margin", [0, 3])
def test_what_a_shift_leaves_is_that_of_a_line_through_zero(margin):
    random = np.random.default_rng(3)
    learned = random.standard_normal((2, 16))
    there = random.standard_normal((2, 16 - 2 * margin))
    there -= there.mean(axis=1, keepdims=True)
    found = _leftovers(learned, there, margin)
    if margin:
        moved = [learned[:, s : s + 10] for s in range(6, -1, -1)]  # later, by -3 to 3
    else:
        moved = [np.roll(learned, s, axis=1) for s in range(16)]
    for left, known in zip(found, moved, strict=True):
        known = known - known.mean(axis=1, keepdims=True)
        scale = max(np.sum(known * there) / np.sum(known**2), 0.0)
        expected = np.sum((there - scale * known) ** 2) / np.sum(there**2)
        assert left == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("part", [None, QUARTER])
def test_the_unit_of_torque_changes_no_verdict(part):
    table, u = learned() if part is None else learned(part=part)
    rows = now(table, shift=0.3, friction=0.3e-3)
    one = checked(table, u, rows)
    unit = 128.0
    larger = [Row(row.speed, unit * row.moves) for row in rows]
    other = checked(replace(table, torque=unit * table.torque), unit * u, larger)
    for name, value in vars(one).items():
        size = unit if name in UNIT_OF_TORQUE else 1.0
        found = getattr(other, name)
        if hasattr(value, "u"):
            assert (found.value, found.u) == pytest.approx(
                (size * value.value, size * value.u), rel=1e-5, abs=1e-7 * size
            )
        else:
            assert found == pytest.approx(size * value, rel=1e-6, abs=1e-9 * size)


UNIT_OF_TORQUE = [
    "friction",
    "offset",
    "mismatch",
    "shape",
    "scaled",
    "shifted",
    "even",
    "odd",
    "pattern",
    "limit",
]


def test_a_shift_with_other_friction_is_not_mended_by_the_shift():
    table, u = learned()
    for change in ({"friction": 0.5e-3}, {"offset": 0.5e-3}):
        found = checked(table, u, now(table, shift=0.5, **change))
        assert found.shift_is_enough
        assert found.friction_changed != found.offset_changed
        assert "a shift alone is not enough: learn again" in table_verdict(found, 4000)
    found = checked(table, u, now(table, shift=0.5))
    assert "not enough" not in table_verdict(found, 4000)


def test_the_noise_of_the_table_adds_to_that_of_the_moves():
    table, u = learned()
    rows = now(table)
    stated = [checked(table, factor * u, rows).friction.u for factor in (0.0, 2.0, 4.0)]
    added = [(found / stated[0]) ** 2 - 1 for found in stated[1:]]
    assert added[1] == pytest.approx(4 * added[0], rel=1e-9, abs=0)
    # u2 of the table over the variance of a mean, both of half the moves' two directions
    mean = np.mean([row.moves.var(axis=0, ddof=1).mean() / MOVES for row in rows])
    assert added[0] == pytest.approx(float((2 * u[0, 0]) ** 2) / mean, rel=0.2, abs=0)
