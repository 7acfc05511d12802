"""Turns against a map, both made of known orders: what is left of them by complex numbers alone."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from rigtool.control.lookup_table import LookupTable
from rigtool.errors import InsufficientDataError, UsageError
from rigtool.experiments.learning.check import imported
from rigtool.experiments.learning.learned_table import LearnedTable
from rigtool.experiments.ripple.orders import WAVEFORM_CELLS
from tests.experiments.ripple.fine import FINE

SPEEDS = np.array([-6.0, 2.0, 6.0])
MAP = {3: 0.5 * np.exp(0.4j), 7: 1.0 * np.exp(-1.2j), 12: 0.3j}
MEANS = np.array([0.2, 0.1, -0.1])
CELLS = 2 * np.pi * (np.arange(WAVEFORM_CELLS) + 0.5) / WAVEFORM_CELLS


def wave(orders, angle, width=0.0):
    """Return the sum of orders at angles, as means over a `width` in turns."""
    parts = [np.sinc(k * width) * np.real(a * np.exp(1j * k * angle)) for k, a in orders.items()]
    return np.sum(parts, axis=0)


def learned(period=2 * math.pi, start=0.3):
    position = start + 2 * math.pi * np.arange(600) / 600
    rows = np.stack([wave(MAP, position) * scale for scale in (-1.0, 0.1, 1.0)])
    table = LookupTable(
        position,
        SPEEDS,
        rows + MEANS[:, None],
        np.array([0.0, 2.0]),
        np.array([0.0, 1.0]),
        period=period,
    )
    return LearnedTable(table, np.zeros(rows.shape), "torque", "N m", {}, None, None, ())


def turned(orders, turns=6, speed=6.1, noise=1e-3, seed=1, mean=0.25):
    """Return the comparison of turns of these orders, and their group and means."""
    rng = np.random.default_rng(seed)
    torque = wave(orders, CELLS, 1 / WAVEFORM_CELLS) + mean
    torque = torque + noise * rng.standard_normal((turns, WAVEFORM_CELLS))
    torque += 0.01 * rng.standard_normal((turns, 1))
    group = SimpleNamespace(
        speed=speed, sampling=FINE, turns=turns, runs=2, label=lambda: "6.1 rad/s"
    )
    return imported._compare(group, torque, learned(), 40), group, torque.mean(axis=1)


def power(orders):
    return sum(abs(a) ** 2 for a in orders.values()) / 2


def test_what_the_map_leaves_is_the_difference_of_complex_orders():
    shown = {3: 0.55 * np.exp(0.4j), 7: 0.95 * np.exp(-1.15j), 12: 0.3j, 20: 0.02}
    found, group, means = turned(shown)
    left = {k: shown[k] - MAP.get(k, 0.0) for k in shown}
    results = found.results("N m", "torque")
    assert results["table_fits"].value == 1
    before, after = math.sqrt(power(shown)), math.sqrt(power(left))
    assert results["ripple_rms"].value == pytest.approx(before, rel=1e-3)
    assert results["remaining_rms"].value == pytest.approx(after, rel=1e-2)
    assert results["removed"].value == pytest.approx(1 - after / before, abs=1e-3)
    assert found.left_part == pytest.approx(power(left) / power(shown), rel=2e-2)
    assert (
        f"it would have removed {100 * (1 - math.sqrt(found.left_part)):.1f} %"
        in found.notes(group)[0]
    )
    assert found.notes(group)[0].startswith("6 turns of 2 runs at 6.1 rad/s: the table fits")
    for k in (3, 7, 12):
        expected = 1 - abs(left[k]) / abs(shown[k])
        assert results[f"order_{k}_removed"].value == pytest.approx(expected, abs=5e-3)
    assert set(results) >= {"order_7_removed", "order_3_removed"}
    assert found.strongest()[:3] == [7, 3, 12]
    change = results["mean_torque_change"]
    assert change.value == pytest.approx(means.mean() + 0.1, rel=1e-9)
    assert change.u == pytest.approx(means.std(ddof=1) / math.sqrt(6), rel=1e-9)
    table = found.table("N m")
    at = [2, 6, 11, 19]
    for name, orders in (("amplitude", shown), ("learned", MAP), ("remaining", left)):
        expected = [abs(orders.get(k, 0.0)) for k in (3, 7, 12, 20)]
        np.testing.assert_allclose(table[name][at], expected, atol=1e-3)
    np.testing.assert_array_equal(table["order"], 1 + np.arange(len(table["order"])))
    np.testing.assert_allclose(
        table["removed"][at[:3]], [results[f"order_{k}_removed"].value for k in (3, 7, 12)]
    )
    np.testing.assert_allclose(
        table["removed_u"][at[:3]], [results[f"order_{k}_removed"].u for k in (3, 7, 12)]
    )
    np.testing.assert_array_equal(table["noise_floor"], found.shown.noise_floor)
    np.testing.assert_array_equal(table["remaining_noise_floor"], found.left.noise_floor)
    ends = results["ripple_rms"], results["remaining_rms"]
    relative = [one.u / one.value for one in ends]
    ratio_u = (1 - results["removed"].value) * math.hypot(*relative)
    assert results["removed"].u == pytest.approx(ratio_u, rel=1e-9)
    match = found.match
    assert (results["table_shift"].value, results["table_shift"].u) == (match.shift, match.shift_u)
    assert results["table_scale"].value == match.scale


def test_what_all_turns_left_out_is_bridged_by_what_is_left_of_the_map():
    """Where the map is all that turns, the bridges are the map itself."""
    torque = np.tile(wave(MAP, CELLS, 1 / WAVEFORM_CELLS), (3, 1))
    torque[:, 40:60] = np.nan
    group = SimpleNamespace(speed=6.0, sampling=FINE, turns=3, runs=1, label=lambda: "6 rad/s")
    found = imported._compare(group, torque, learned(), 40)
    np.testing.assert_allclose(found.left.amplitude, 0, atol=1e-9)
    np.testing.assert_allclose(found.shown.amplitude[[2, 6, 11]], [0.5, 1.0, 0.3], atol=1e-9)


def test_uncertainties_are_what_the_results_scatter_by():
    shown = {3: 0.5 * np.exp(0.5j), 7: 0.9 * np.exp(-1.1j), 12: 0.28j}
    drawn = [turned(shown, noise=0.2, seed=n)[0].results("N m", "torque") for n in range(60)]
    for name in ("ripple_rms", "order_7_removed", "order_3_removed"):
        scatter = np.std([results[name].value for results in drawn], ddof=1)
        stated = np.sqrt(np.mean([results[name].u ** 2 for results in drawn]))
        assert stated == pytest.approx(scatter, rel=0.35)


def test_noise_that_scatter_shows_is_no_part_of_what_is_left():
    found, *_ = turned(MAP, noise=1.0, turns=20)
    # of 40 orders, in the mean of 20 turns of so many cells
    scatter = math.sqrt(2 * 40 / WAVEFORM_CELLS / 20)
    left = found.results("N m", "torque")["remaining_rms"].value
    assert left == pytest.approx(scatter, rel=0.2)
    assert found.left_part < 0.02
    alone, *_ = turned(MAP, noise=1.0, turns=1)
    assert alone.noise == 0
    assert alone.results("N m", "torque")["mean_torque_change"].u is None


@pytest.mark.parametrize("by", [-0.15, 0.3])
def test_a_map_that_is_shifted_is_told_by_its_angle(by):
    found, group, _ = turned({k: a * np.exp(-1j * k * by) for k, a in MAP.items()})
    results = found.results("N m", "torque")
    assert results["table_fits"].value == 0
    assert results["table_shift"].value == pytest.approx(by, abs=1e-3)
    assert results["table_scale"].value == pytest.approx(1, rel=1e-2)
    assert (
        f"the same map, shifted by {math.degrees(found.match.shift):.2f} +-"
        in (found.notes(group)[0])
    )


def test_another_map_is_neither():
    found, group, _ = turned({5: 0.8, 9: 0.3j})
    assert not found.fits
    assert not found.shifted
    assert "a shift is not enough" in found.notes(group)[0]


def test_a_map_of_another_size_is_not_shifted():
    found, group, _ = turned({k: a / 2 for k, a in MAP.items()})
    exact = replace(found, match=replace(found.match, shift=0.0, shift_u=0.0))
    for one in (found, exact):
        assert not one.fits
        assert not one.shifted
    assert "correlation 1.000 as it is" in found.notes(group)[0]


def test_waveforms_add_up():
    shown = {3: 0.5, 7: 0.2j}
    table = turned(shown, noise=0.0)[0].waveforms(learned())
    np.testing.assert_allclose(table["position"], CELLS, rtol=1e-12)
    np.testing.assert_allclose(table["ripple"], wave(shown, CELLS, 1 / WAVEFORM_CELLS), atol=1e-9)
    np.testing.assert_allclose(table["learned"], wave(MAP, CELLS), atol=1e-9)
    left = table["remaining"] + table["learned"]
    np.testing.assert_allclose(left, table["ripple"], atol=1e-12)


@pytest.mark.parametrize("speed", [5.45, 6.55, -5.5])
def test_the_row_is_that_of_the_speed_within_a_tenth(speed):
    assert imported._row(learned(), speed) == (2 if speed > 0 else 0)


@pytest.mark.parametrize("speed", [5.35, 6.65, 2.5, -2.0])
def test_a_speed_that_was_not_learned_is_refused(speed):
    with pytest.raises(InsufficientDataError, match="check at a speed that was learned"):
        imported._row(learned(), speed)


def test_a_table_of_a_part_of_a_turn_is_refused():
    with pytest.raises(UsageError, match="not of a whole turn"):
        imported._orders_of(learned(period=None), 6.0)


def test_the_part_of_the_record_is_that_of_all_samples(monkeypatch):
    """Two records of other lengths, longer than a block: noise stays."""
    rng = np.random.default_rng(2)
    orders = np.zeros(12, dtype=complex)
    orders[2], orders[6], orders[11] = MAP[3], MAP[7], MAP[12]
    sizes, drawn = (40000, 10000), (0.5, 2.0)
    angles = [np.linspace(0, 2 * np.pi * 50, n, endpoint=False) for n in sizes]
    torques = [
        3.0 + wave(MAP, angle) + noise * rng.standard_normal(n)
        for angle, n, noise in zip(angles, sizes, drawn, strict=True)
    ]
    monkeypatch.setattr(imported, "effort_of", lambda n, _: SimpleNamespace(values=torques[n]))
    monkeypatch.setattr(imported, "position_of", lambda n: angles[n])
    found = imported._of_record([0, 1], None, orders)
    left = [y - wave(MAP, angle) for y, angle in zip(torques, angles, strict=True)]
    before, after = (np.average([np.var(y) for y in ys], weights=sizes) for ys in (torques, left))
    assert found == pytest.approx(1 - after / before, rel=1e-9)
    assert 0.3 < found < 0.5
