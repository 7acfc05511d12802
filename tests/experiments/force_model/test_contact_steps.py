"""Tests for contacts, their thresholds and ends, against loops that write out the text."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from rigtool.experiments.force_filter.motion_states import CREEPING_KIND, State
from rigtool.experiments.force_model.contacts import (
    FALSE_ALARMS,
    LEVEL_MEMORY,
    MIN_BLOCKS,
    TAIL_QUANTILE,
    Contact,
    MotionKind,
    Trial,
    contacts,
    thresholds,
    trial,
)

STEP = 2e-3
WINDOW = 30


def stretch(seed, size=2400):
    """Return torque, deviation, kinds and doubt of steps of 2 ms."""
    rng = np.random.default_rng(seed)
    torque = np.repeat(rng.choice([0.0, 0.0, 6e-3, -9e-3], size // 100), 100)
    torque = torque + 5e-4 * rng.standard_normal(size)
    every = [State.OUTSIDE, State.AGAINST, State.WITH, State.REVERSED, State.STILL, CREEPING_KIND]
    chances = [0.02, 0.3, 0.25, 0.05, 0.35, 0.03]
    kinds = np.repeat(rng.choice(every, size // 40, p=chances), 40).astype(np.int32)
    return torque, rng.uniform(1e-3, 2e-3, size), kinds, rng.uniform(0, 1e-3, size)


@pytest.mark.parametrize("seed", range(4))
def test_a_trial_has_jump_level_and_motion_of_each_step(seed):
    torque, deviation, kinds, doubt = stretch(seed)
    found = trial(torque, deviation, kinds, STEP, doubt)
    kept, smooth, last = math.exp(-STEP / 5e-3), [], 0.0
    for value in torque:
        last = kept * last + (1 - kept) * value
        smooth.append(last)
    motion = []
    for k in range(len(torque)):
        before = kinds[max(0, k - 90) : k + 1]  # three windows
        kind = MotionKind.STEADY
        if np.isin(before, (State.REVERSED, CREEPING_KIND)).any():
            kind = MotionKind.REVERSED
        if kinds[k] == State.STILL:
            kind = MotionKind.STILL
        outside = (kinds[max(0, k - WINDOW) : k + 1] == State.OUTSIDE).any()
        motion.append(-1 if outside or k < 1000 else kind)
    whole = np.hypot(deviation, doubt)
    jump = np.append(np.zeros(WINDOW), np.array(smooth)[WINDOW:] - np.array(smooth)[:-WINDOW])
    assert_allclose(found.torque, smooth, atol=1e-8)
    assert_allclose(found.jump, jump * deviation / whole, atol=1e-8)
    assert_allclose(found.level, smooth / whole, atol=1e-4)
    assert found.motion.tolist() == motion
    assert found.step_time == STEP


def of_values(values, motion=MotionKind.STILL):
    """Return a trial whose highest values in blocks of a window are these."""
    jump = np.zeros((len(values), WINDOW), dtype=np.float32)
    jump[:, 7] = values
    jump[::2, 7] *= -1
    one = jump.ravel()
    kinds = np.full(one.size, motion, dtype=np.int8)
    return Trial(0 * one, one, one, kinds, STEP)


def exceeded(values, probability):
    """The predictive tail of exponential values behind the quantile."""
    start = np.quantile(values, TAIL_QUANTILE)
    tail = [v - start for v in values if v > start]
    n = len(tail)
    return start + sum(tail) * (((1 - TAIL_QUANTILE) / probability) ** (1 / n) - 1)


def test_thresholds_follow_from_the_highest_values_in_blocks():
    """Of a window for jumps and of a second for levels, by motion; from fifty blocks on."""
    rng = np.random.default_rng(3)
    values = rng.exponential(1e-3, 1300).astype(np.float32)
    found = thresholds([of_values(values[:700]), of_values(values[700:])])
    rates = np.array(FALSE_ALARMS)
    jump = exceeded(values.astype(float), rates[MotionKind.STILL, 0] * 0.06)
    assert found[MotionKind.STILL, 0] == pytest.approx(jump, rel=1e-6)
    seconds, blocks = round(LEVEL_MEMORY / STEP), []
    for part in (values[:700], values[700:]):
        one = np.abs(of_values(part).level)
        blocks += one[: one.size // seconds * seconds].reshape(-1, seconds).max(axis=1).tolist()
    level = exceeded(np.array(blocks, dtype=float), rates[MotionKind.STILL, 1] * LEVEL_MEMORY)
    assert found[MotionKind.STILL, 1] == pytest.approx(level, rel=1e-6)
    assert np.isinf(found[[MotionKind.STEADY, MotionKind.REVERSED]]).all()
    for count, known in ((MIN_BLOCKS - 1, False), (MIN_BLOCKS, True)):
        few = thresholds([of_values(values[:count])])
        assert np.isfinite(few[MotionKind.STILL, 0]) == known
    doubled = thresholds([of_values(values)], rates=2 * rates)
    assert doubled[MotionKind.STILL, 0] < found[MotionKind.STILL, 0]
    alike = thresholds([of_values(np.full(60, 2e-3))])
    assert alike[MotionKind.STILL, 0] == pytest.approx(2e-3)


def blocks_of(one, motion, kind, size):
    for first in range(0, len(one) // size * size, size):
        own = [
            abs(v)
            for v, m in zip(one[first : first + size], motion[first : first + size], strict=True)
            if m == kind
        ]
        if own:
            yield max(own)


def test_only_steps_of_the_motion_count_in_a_block():
    rng = np.random.default_rng(4)
    jump = rng.standard_normal(6000).astype(np.float32)
    motion = np.repeat(rng.integers(-1, 3, 600), 10).astype(np.int8)
    found = thresholds([Trial(jump, jump, jump, motion, STEP)])
    for kind in MotionKind:
        values = [*blocks_of(jump.tolist(), motion.tolist(), kind, WINDOW)]
        expected = exceeded(np.array(values), FALSE_ALARMS[kind][0] * 0.06)
        assert found[kind, 0] == pytest.approx(expected, rel=1e-5)


def looked_for(test, limits):
    """Contacts step by step, as the module's text has them."""
    torque, found, open_, ending = test.torque.astype(float), [], None, False
    for k in range(len(torque)):
        motion = test.motion[k]
        if open_ is not None:
            begin, since, side, values = open_
            values.append(side * torque[k])
            if motion < 0 or side * torque[k] < np.mean(values) / 2:
                found.append(Contact(begin, since, k))
                open_, ending = None, True
            continue
        if motion < 0:
            continue
        jump, level = float(test.jump[k]), float(test.level[k])
        rises = jump * torque[k] > 0 and abs(torque[k]) > abs(jump) / 2
        rises = rises and abs(jump) > limits[motion, 0]
        high = abs(level) > limits[motion, 1]
        ending = ending and high
        if not (rises or (high and not ending)):
            continue
        side = np.sign(torque[k])
        half = max(side * torque[k : k + WINDOW + 1]) / 2
        earliest = max(found[-1].end if found else 0, k - round(LEVEL_MEMORY / STEP))
        begin = k
        while begin > earliest and side * torque[begin - 1] > half:
            begin -= 1
        open_ = begin, k, side, [abs(torque[k])]
    if open_ is not None:
        found.append(Contact(open_[0], open_[1], len(torque) - 1))
    return found


@pytest.mark.parametrize("seed", range(5))
def test_contacts_are_those_of_the_text(seed):
    torque, deviation, kinds, doubt = stretch(seed, 6000)
    own = trial(torque, deviation, kinds, STEP, doubt)
    limits = np.array([[3e-3, 3.0], [5e-3, 4.0], [2.5e-3, 2.5]])
    found = contacts(own, limits)
    assert found == looked_for(own, limits)
    assert len(found) > 5
