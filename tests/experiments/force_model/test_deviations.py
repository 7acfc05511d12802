"""Deviations of cycles: strokes, scatter and payback by formulas of this file."""

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from rigtool.experiments.force_model import deviations as module
from rigtool.experiments.force_model.deviations import (
    MIN_STROKE_ROWS,
    ROWS_APART,
    Deviations,
    _strokes,
    deviations,
    kept_by_mean,
    scatter_hz,
    scatter_ratios,
    unseen_deviations,
)
from rigtool.experiments.force_model.records import ROWS_HZ, Record
from rigtool.numerics.steady_mean import steady_us

RATIO, FACTOR, PERIOD, COUNT = 0.9, 1.1, 4.0, 400
PHASE = 2 * np.pi * np.arange(2000) / 2000


def record(torques, moment=0.0, turn=0.0):
    """Return a motion to and fro in 4 s, at rest at both ends; rows that turn do not count."""
    angle = 1.3 - 1.3 * np.cos(PHASE + turn)
    trusted = np.abs(np.sin(PHASE + turn)) > 0.2
    return Record(
        PERIOD / 2000, angle, 0 * angle, trusted, 0.05, moment, 0.0, len(torques), torques
    )


def drawn(cycles=6, seed=1, size=1e-3):
    return size * np.random.default_rng(seed).standard_normal((cycles, COUNT))


def test_a_cycle_has_two_strokes_of_rows_that_count():
    """Each in its own direction, every fifth row, less the mean of the cycles."""
    own = record(drawn(), moment=0.05)
    found = _strokes(own, RATIO, FACTOR)
    angle, speed = (own.rows(values) for values in (own.angle, own.speed))
    left = own.torques - own.torques.mean(axis=0)
    assert len(found) == 2
    for stroke, sign in zip(found, (1, -1), strict=True):
        rows = np.flatnonzero(own.used & (sign * speed > 0))[::ROWS_APART]
        assert_allclose(stroke.own, left[:, rows])
        output = angle[rows] / RATIO
        alike = np.outer(np.sin(output), np.sin(output)) + np.outer(np.cos(output), np.cos(output))
        assert_allclose(stroke.alike, alike, atol=1e-12)
        carried = np.abs(0.05 * np.sin(output)) / FACTOR
        assert_allclose(stroke.loaded, np.outer(carried, carried), atol=1e-15)
        assert_allclose(stroke.apart, np.abs(np.subtract.outer(rows, rows)) / ROWS_HZ, atol=1e-9)
        assert stroke.count == 6


def test_a_stroke_that_the_period_cuts_goes_on_in_the_next_cycle():
    whole, cut = (record(drawn(7), turn=turn) for turn in (0.0, np.pi / 2))
    found = _strokes(cut, RATIO, FACTOR)
    lengths = sorted(len(stroke.own) for stroke in found)
    assert lengths == [6, 7]  # one cycle less of the stroke that is cut
    (split,) = (stroke for stroke in found if len(stroke.own) == 6)
    rows = np.flatnonzero(cut.used & (cut.rows(cut.speed) < 0))
    if rows[0] > 0 or rows[-1] < COUNT - 1:
        rows = np.flatnonzero(cut.used & (cut.rows(cut.speed) > 0))
    gap = np.flatnonzero(np.diff(rows) > 1)[0] + 1
    late, early = rows[gap:], rows[:gap]
    left = cut.torques - cut.torques.mean(axis=0)
    expected = np.hstack([left[:-1, late], left[1:, early]])[:, ::ROWS_APART]
    assert_allclose(split.own, expected)
    place = np.concatenate([late, early + COUNT])[::ROWS_APART] / ROWS_HZ
    assert_allclose(split.apart, np.abs(np.subtract.outer(place, place)), atol=1e-9)
    assert len(_strokes(whole, RATIO, FACTOR)[0].own) == 7


def test_strokes_of_few_rows_show_nothing():
    for slow, count in ((0.74, 0), (0.7, 2)):
        own = record(drawn())
        own = replace(own, trusted=np.abs(np.sin(PHASE)) > slow)
        rows = np.flatnonzero(own.used & (own.rows(own.speed) > 0))[::ROWS_APART]
        assert (len(rows) >= MIN_STROKE_ROWS) == (count > 0)
        assert len(_strokes(own, RATIO, FACTOR)) == count
    assert deviations([record(drawn(2))], RATIO, FACTOR) is None


def log_density(found, strokes, kept, white):
    """The logarithm of the normal density of all cycles under deviations, times -2."""
    total = 0.0
    for s in strokes:
        whole = (1 - kept / s.count) * (found.stroke**2 * s.alike + found.load**2 * s.loaded)
        fading = np.exp(-s.apart / found.noise_time)
        whole = whole + (1 - 1 / s.count) * found.noise**2 * fading
        whole = whole + white * np.eye(len(whole))
        total += len(s.own) * np.linalg.slogdet(whole)[1]
        total += sum(row @ np.linalg.solve(whole, row) for row in s.own)
    return total


def test_deviations_are_those_under_which_the_cycles_are_most_likely():
    """No other ones nearby are likelier, with the prior of a tenth of a unit of the logarithms."""
    rng = np.random.default_rng(2)
    records = []
    for moment in (0.0, 0.06):
        own = record(drawn(30), moment=moment)
        angle, speed = (own.rows(values) for values in (own.angle, own.speed))
        way, output = np.sign(speed), angle / RATIO
        b = rng.standard_normal((30, 3)) * np.array([4e-4, 4e-4, 0.02])
        shapes = np.stack(
            [np.sin(output), np.cos(output), moment * np.abs(np.sin(output)) / FACTOR]
        )
        records.append(replace(own, torques=way * (b @ shapes) + drawn(30, 5, 1e-5)))
    found = deviations(records, RATIO, FACTOR)
    strokes = [s for r in records for s in _strokes(r, RATIO, FACTOR)]
    size = max(math.sqrt(np.mean(s.own**2)) for s in strokes)
    white, kept = (0.05 * size) ** 2, kept_by_mean(records, RATIO)
    start = np.array([size, 0.01, size, 0.1])

    def cost(values):
        prior = 0.01 * np.sum(np.log(np.array(values) / start) ** 2)
        return log_density(Deviations(*values), strokes, kept, white) + prior

    least = [found.stroke, found.load, found.noise, found.noise_time]
    for number in range(4):
        for by in (0.7, 1.4):
            other = [*least]
            other[number] *= by
            assert cost(other) > cost(least) - 1.0
    assert found.stroke == pytest.approx(4e-4, rel=0.2)
    assert found.load == pytest.approx(0.02, rel=0.4)


def test_unseen_deviations_are_parts_of_the_friction_without_load():
    torques = 5e-3 + drawn(3)
    own = [record(torques), record(100 * torques, moment=0.05)]
    friction = math.sqrt(np.mean(torques[:, own[0].used] ** 2))
    expected = Deviations(0.03 * friction, 0.01, 0.01 * friction, 0.1)
    assert vars(unseen_deviations(own)) == pytest.approx(vars(expected))
    assert unseen_deviations(own[1:]).stroke == pytest.approx(0.03 * module.UNSEEN_FRICTION)


def test_scatter_is_compared_with_that_of_most_records():
    records = [record(drawn(5, n, size)) for n, size in enumerate((1e-3, 1.1e-3, 0.9e-3, 9e-3))]
    scatters = [r.scatter for r in records]
    assert scatter_ratios(records) == pytest.approx(np.array(scatters) / np.median(scatters))
    still = [record(np.zeros((3, COUNT)))] * 2
    assert scatter_ratios(still) == [0.0, 0.0]


def test_motions_of_which_no_row_counts_have_no_scatter():
    """Where most motions are so slow, that of the others is the usual one."""
    unused = replace(record(drawn()), trusted=np.zeros(2000, dtype=bool))
    assert scatter_ratios([unused, record(drawn()), unused, unused]) == [0.0, 1.0, 0.0, 0.0]


@pytest.mark.parametrize("hertz", [0.75, 3.0])
def test_cycles_differ_most_at_the_frequency_of_a_swing(hertz):
    time = np.arange(6 * COUNT) / ROWS_HZ
    swing = np.sin(2 * np.pi * hertz * time + 0.4 * time).reshape(6, COUNT)
    own = record(2.0 + swing + 5 * np.sin(PHASE[:: 2000 // COUNT]))
    assert scatter_hz(own) == pytest.approx(hertz + 0.4 / (2 * np.pi), abs=0.05)


def test_the_mean_keeps_what_strokes_do_not_pay_back():
    """By the sine along each direction: its u2 over that of independent strokes."""
    rng = np.random.default_rng(6)
    for payback, low, high in ((0.0, 0.7, 1.0), (0.95, 0.0, 0.3)):
        fresh = rng.standard_normal(41)
        series = 1e-3 * (fresh[1:] - payback * fresh[:-1])
        angle = record(drawn()).rows(1.3 - 1.3 * np.cos(PHASE))
        own = record(drawn(40, 7, 1e-6) + np.outer(series, np.sin(angle / RATIO)))
        sine, speed = np.sin(own.rows(own.angle) / RATIO), own.rows(own.speed)
        every = []
        for sign in (1, -1):
            rows = own.used & (sign * speed > 0)
            every.append(own.torques[:, rows] @ sine[rows] / (sine[rows] @ sine[rows]))
        shares = [
            u**2 * 40 / np.var(one, ddof=1)
            for one, (u, _) in zip(every, steady_us(every), strict=True)
        ]
        assert kept_by_mean([own], RATIO) == pytest.approx(min(1.0, np.median(shares)))
        assert low <= kept_by_mean([own], RATIO) <= high
    assert kept_by_mean([record(drawn(2))], RATIO) == 1.0


def fading(rng, memory, cycles):
    """Return first-order noise of unit variance, (cycles, rows)."""
    kept = math.exp(-1 / (memory * ROWS_HZ))
    fresh = rng.standard_normal(cycles * COUNT + 200)
    noise = np.zeros_like(fresh)
    for k in range(1, len(fresh)):
        noise[k] = kept * noise[k - 1] + math.sqrt(1 - kept**2) * fresh[k]
    return noise[200:].reshape(cycles, COUNT)


def test_neither_a_coarse_encoder_nor_a_load_that_swings_passes_for_friction():
    """White noise of all readings; under the load a swing of 6.3 Hz of any phase in each cycle."""
    rng, records, cycles = np.random.default_rng(9), [], 30
    for moment in (0.0, 0.0, 0.06):
        phase = rng.uniform(0, 2 * np.pi, (cycles, 1))
        swing = np.sin(2 * np.pi * 6.3 * np.arange(COUNT) / ROWS_HZ + phase)
        torques = 1e-4 * fading(rng, 0.12, cycles) + 2e-4 * rng.standard_normal((cycles, COUNT))
        records.append(record(torques + 1e-3 * (moment > 0) * swing, moment=moment))
    found = deviations(records, RATIO, FACTOR)
    assert found.noise == pytest.approx(1e-4, rel=0.25)
    assert found.noise_time == pytest.approx(0.12, rel=0.5)


@pytest.mark.parametrize("cycles", [3, 8])
def test_noise_that_fades_is_that_of_single_cycles(cycles):
    """The mean of three cycles takes a third of its variance away, which is given back."""
    rng = np.random.default_rng(8)
    records = [record(4e-4 * fading(rng, 0.15, cycles)) for _ in range(48 // cycles)]
    found = deviations(records, RATIO, FACTOR)
    assert found.noise == pytest.approx(4e-4, rel=0.12)
    assert found.noise_time == pytest.approx(0.15, rel=0.4)
    assert found.stroke < 2e-4
