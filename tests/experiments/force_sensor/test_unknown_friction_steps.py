"""Passes, reversals and cells of friction that tables do not hold, against loops over them."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from rigtool.experiments.force_sensor.unknown_friction import (
    ANGLE_CELLS,
    Passes,
    _shares,
    _untouched,
    unknown_friction,
    unknown_share,
)

REACH, STEP = (0.2, 2.6), 0.02


def drawn(seed, size=600):
    """Return rows of a motion to and fro within the learned angles, and beyond, with pauses."""
    rng = np.random.default_rng(seed)
    speed = np.repeat(rng.choice([-2.0, -1.0, 0.0, 1.0, 2.0], size // 20), 20)
    angle = 1.4 + np.cumsum(speed) * STEP * 0.7
    sliding = (speed != 0) & (rng.random(size) > 0.01)
    torque = 1e-3 * rng.standard_normal(size) + np.where(rng.random() < 0.5, 20e-3, -20e-3)
    return angle, sliding, torque, 1e-3 * rng.uniform(0.5, 1.5, size)


@pytest.mark.parametrize("step_time", [0.02, 0.008])
@pytest.mark.parametrize("seed", range(3))
def test_passes_are_stretches_of_one_direction_in_cells_of_the_angle(seed, step_time):
    angle, sliding, torque, u = drawn(seed)
    half, size = max(1, round(0.055 / step_time / 2)), len(angle)
    ways = [
        np.sign(angle[min(k + half, size - 1)] - angle[max(k - half, 0)]) if sliding[k] else 0
        for k in range(size)
    ]
    spans, first = [], 0
    for k in range(1, size + 1):
        if k == size or ways[k] != ways[first]:
            if ways[first]:
                spans.append(range(first, k))
            first = k
    found = Passes.of(step_time, angle, sliding, REACH, torque, u)
    assert len(found.direction) == len(spans) > 3
    for number, span in enumerate(spans):
        assert found.direction[number] == ways[span[0]]
        for cell in range(ANGLE_CELLS):
            places = [int((angle[k] - 0.2) / 2.4 * ANGLE_CELLS // 1) for k in span]
            own = [k for k, at in zip(span, places, strict=True) if min(max(at, 0), 23) == cell]
            for given, means in ((torque, found.torque), (u, found.u)):
                if own:
                    assert means[number, cell] == pytest.approx(given[own].mean())
                else:
                    assert math.isnan(means[number, cell])


@pytest.mark.parametrize("seed", range(4))
def test_shares_are_those_of_reversals_under_a_load(seed):
    """0.06 s after it, the same angles in 0.4 s before it, 0.4 s apart; loads of ten u and more."""
    rng = np.random.default_rng(seed)
    lengths, gaps = rng.integers(1, 30, 120), rng.choice([0, 5, 20, 21], 120)
    spans, at, parts, here = [], 0, [], 0.0
    signs = rng.choice([1.0, -1.0], 120)
    for length, gap, sign in zip(lengths.tolist(), gaps.tolist(), signs, strict=True):
        spans.append(slice(at, at + length))
        parts.append(here + sign * np.arange(length + gap) * (np.arange(length + gap) < length))
        here, at = parts[-1][length - 1] + rng.choice([0.0, sign]), at + length + gap
    angle = np.concatenate(parts)
    load = np.repeat(rng.choice([-30e-3, 9e-3, 30e-3], 120), lengths + gaps)
    torque = load + 2e-3 * rng.standard_normal(at)
    u = 1e-3 * rng.choice([0.7, 1.0, 1.3], at)
    expected = []
    for number in range(119):
        before, after = spans[number], spans[number + 1]
        if signs[number] == signs[number + 1] or after.start - before.stop > 20:
            continue
        passed = {float(angle[k]): k for k in range(before.start, before.stop)}
        two = [k for k in range(after.start, after.stop) if k > after.start or angle[k] in passed]
        two = two[:3]
        if len(two) < 3 or any(float(angle[k]) not in passed for k in two):
            continue
        one = [passed[float(angle[k])] for k in two]
        if before.stop - min(one) > 20:
            continue
        first, second = torque[one].mean(), torque[two].mean()
        if abs(first + second) / 2 > 10 * max(u[one].mean(), u[two].mean()):
            expected.append(signs[number] * (first - second) / abs(first + second))
    assert len(expected) > 3
    assert_allclose(_shares(spans, signs, angle, torque, u, STEP), expected, rtol=1e-9)


def of_shares(*values):
    return Passes(np.empty(0), np.empty((0, 24)), np.empty((0, 24)), np.array(values))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_share_is_the_median_of_those_that_are_frictions(sign):
    """Both quartiles beyond 0.02 on one side; shares beyond 0.3 are contacts, fewer than half."""
    seen = sign * np.array([0.03, 0.05, 0.06, 0.08])
    assert unknown_share([of_shares(*seen[:2]), of_shares(*seen[2:])]) == pytest.approx(
        sign * 0.055
    )
    assert unknown_share([of_shares(*seen[:3])]) == 0.0
    more = np.append(seen, [0.9, -0.31, 0.31, -5.0])
    assert unknown_share([of_shares(*more)]) == pytest.approx(sign * 0.055)
    assert unknown_share([of_shares(*more, 0.4)]) == 0.0
    low = np.array([0.012, 0.015, 0.06, 0.07, 0.08]) * sign
    assert unknown_share([of_shares(*low)]) == 0.0  # the quartile is 0.015
    assert unknown_share([of_shares(*np.append(low[1:], sign * 0.09))]) == pytest.approx(
        0.07 * sign
    )


def test_the_torque_of_what_nothing_touches_is_that_of_passes_like_the_lower_quartile():
    """Within three u of it, and more than two in five of them; in three rounds."""
    free = np.array([1.0, 1.1, 0.9, 1.2])
    assert _untouched(np.append(free, [9.0, -8.0, 30.0]), 0.2) == pytest.approx(1.05)
    assert _untouched(np.array([1.0, 1.5, 7.0, 9.0]), 0.2) == pytest.approx(1.25)
    assert math.isnan(_untouched(np.array([1.0, 1.5, 7.0, 9.0, 30.0]), 0.2))
    assert math.isnan(_untouched(np.array([1.0, 5.0, 7.0, 9.0, 30.0]), 0.2))
    # one round moves the middle, the next one takes in what is near to it
    rising = np.array([1.0, 1.4, 1.8, 2.2, 2.6])
    assert _untouched(rising, 0.34) == pytest.approx(1.8)


def cells(up, down, u, passes=3):
    """Return passes whose torques in each cell are those of both directions."""
    direction = np.tile([1.0, -1.0], passes)
    torque = np.where(direction[:, None] > 0, up, down)
    return Passes(direction, torque, u + np.zeros_like(torque))


def test_friction_is_what_opposes_both_directions():
    """Sizes from the median of three cells beside each other: a load may touch at one, or at an
    end."""
    up, down = np.full(ANGLE_CELLS, 3e-3), np.full(ANGLE_CELLS, -2e-3)
    up[[0, 7, 23]], down[[0, 7, 23]] = 50e-3, -50e-3
    up[12:16] = -1e-3  # a load of one sign
    u = np.where(np.arange(ANGLE_CELLS) < 12, 0.5e-3, 1e-3)
    least = np.where(up * down < 0, np.minimum(abs(up), abs(down)), 0.0)
    smooth = [np.median(least[[abs(k - 1), k, 23 - abs(22 - k)]]) for k in range(24)]
    found = unknown_friction([cells(up, down, u)])
    size = math.sqrt(np.mean(np.square(smooth)))
    assert found.size == pytest.approx(size)
    assert found.over_u == pytest.approx(size / 0.75e-3)
    assert found.typical == pytest.approx(np.median(smooth / u))
    both = np.minimum(np.abs([up, down]), 2 * size)
    assert found.widening == pytest.approx(math.sqrt(np.mean(both**2)))
    for bare in (0.5 * size, 1.5 * size):  # ripple that hides friction makes the rest larger
        both = np.minimum(np.abs([up, down]), 4 * max(size, bare) - 2 * size)
        wider = unknown_friction([cells(up, down, u)], bare=bare)
        assert wider.widening == pytest.approx(math.sqrt(np.mean(both**2)))
        assert wider.size == found.size
    # tables that hold too much drive every pass
    turned = unknown_friction([cells(-up, -down, u)])
    assert turned == found


def test_ripple_that_lags_is_no_friction():
    """Where the torque that is given differs less between the directions, ripple was taken off;
    where it shows nothing, and of friction that ripple hides in one direction, all counts."""
    up, down = np.full(ANGLE_CELLS, 3e-3), np.full(ANGLE_CELLS, -2e-3)
    for own in (cells(up, down, 1e-3), cells(-up, -down, 1e-3)):
        found = unknown_friction([own], given=[cells(up - 2.6e-3, down + 2.2e-3, 1e-3)])
        assert found.size == pytest.approx(0.1e-3)
        assert found.widening == pytest.approx(0.2e-3)
        assert found.typical == pytest.approx(0.1)
        whole = unknown_friction([own])
        assert unknown_friction([own], given=[cells(0 * up, down - 3e-3, 1e-3)]) == whole
        assert unknown_friction([own], given=[cells(up, down, 1e-3, passes=1)]) == whole


def test_cells_without_two_passes_of_each_direction_show_nothing():
    up, down = np.full(ANGLE_CELLS, 3e-3), np.full(ANGLE_CELLS, -2e-3)
    own = cells(up, down, 1e-3, passes=2)
    own.torque[0, 3:] = np.nan
    assert unknown_friction([own]).size == pytest.approx(2e-3)
    own.torque[0, 2] = np.nan
    assert unknown_friction([own]) is None
    split = [Passes(own.direction[k], own.torque[k], own.u[k]) for k in (slice(1), slice(1, 4))]
    assert unknown_friction(split) is None


def test_what_drives_a_pass_by_more_than_friction_is_a_hand():
    up, down = np.full(ANGLE_CELLS, 3e-3), np.full(ANGLE_CELLS, -2e-3)
    own = cells(up, down, 1e-3)
    own.torque[0], own.torque[1] = -9e-3, 9e-3
    assert unknown_friction([own], hand=8e-3).size == pytest.approx(2e-3)
    helped = cells(-up, -down, 1e-3)
    assert unknown_friction([helped], hand=2.5e-3) is None
    assert unknown_friction([helped], hand=3.5e-3).size == pytest.approx(2e-3)
