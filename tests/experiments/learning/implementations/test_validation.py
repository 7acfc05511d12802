"""What remains at constant speeds and along a sweep, beside numpy, scipy and counting by chance."""

import math

import numpy as np
import pytest
from scipy import optimize, stats

from rigtool.experiments.learning.implementations.validation import (
    FALSE_ALARM_PROBABILITY,
    SPEED_BIN,
    Steady,
    Sweep,
    midpoints,
    steady_outcome,
)
from rigtool.experiments.learning.rows import Row

WAVE = np.sin(2 * np.pi * np.arange(40) / 40)


def row(speed, amplitude, scatter, moves=5, seed=1):
    rng = np.random.default_rng(seed)
    return Row(speed, amplitude * WAVE + scatter * rng.standard_normal((moves, 40)))


def test_speeds_come_in_order_with_what_remains():
    found = [
        Steady(row(3.0, 2e-3, 1e-4), row(3.0, 0.5e-3, 1e-4, seed=2), "learned"),
        Steady(row(-3.0, 2e-3, 1e-4), row(-3.0, 0.7e-3, 2e-4, 9, seed=3), "learned"),
        Steady(row(1.0, 2e-3, 1e-4), row(1.0, 0.9e-3, 1e-4, seed=4), "between"),
    ]
    outcome = steady_outcome(found)
    table, order = outcome.tables["validation"], [found[1], found[2], found[0]]
    assert table["speed"].tolist() == [-3.0, 1.0, 3.0]
    assert table["learned"].tolist() == [1, 0, 1]
    assert table["between"].tolist() == [0, 1, 0]
    for name, rows in (("off", [s.before for s in order]), ("on", [s.after for s in order])):
        means = np.array([np.mean(each.moves, axis=0) for each in rows])
        np.testing.assert_allclose(table[f"{name}_peak"], np.abs(means).max(axis=1), rtol=1e-12)
        np.testing.assert_allclose(table[f"{name}_rms"], np.sqrt(np.mean(means**2, axis=1)))
    scatter = [np.sqrt(np.mean(np.var(s.after.moves, axis=0, ddof=1))) for s in order]
    np.testing.assert_allclose(table["non_repeatable_rms"], scatter, rtol=1e-12)
    # the largest of the learned speeds, with the u of its mean there
    peak = outcome.results["validation_peak_learned"]
    moves = found[1].after.moves
    where = np.argmax(np.abs(moves.mean(axis=0)))
    assert peak.value == pytest.approx(abs(moves[:, where].mean()), rel=1e-12)
    assert peak.u == pytest.approx(stats.sem(moves[:, where]), rel=1e-12)
    assert peak.dof == 8
    assert outcome.results["validation_peak_between"].dof == 4
    assert "validation_peak_tuned" not in outcome.results
    assert outcome.notes[0].startswith("at none of 3 speeds")


def test_u_of_an_rms_is_what_it_scatters_by():
    tables = [
        steady_outcome(
            [Steady(row(1.0, 1.0, 0.3, 12, seed), row(1.0, 2.0, 0.5, 6, seed + 500))]
        ).tables["validation"]
        for seed in range(200)
    ]
    for name in ("off_rms", "on_rms"):
        scatter = np.std([table[name][0] for table in tables], ddof=1)
        stated = np.sqrt(np.mean([table[f"{name}_u"][0] ** 2 for table in tables]))
        assert stated == pytest.approx(scatter, rel=0.15)


@pytest.mark.parametrize("count", [1, 4])
@pytest.mark.parametrize("beyond", [0.99, 1.01])
def test_a_table_is_worse_where_the_rms_rises_beyond_chance(count, beyond):
    """By Student's t of the side with fewer moves, for as many speeds as are compared."""

    def both(speed, change):
        before, after = row(speed, 1.0, 0.1, 4), row(speed, 1.0, 0.1, 7, seed=2)
        return Steady(before, Row(speed, after.moves * change))

    def pull(change):
        table = steady_outcome([both(2.0, change)]).tables["validation"]
        risen = table["on_rms"][0] - table["off_rms"][0]
        return risen / math.hypot(table["on_rms_u"][0], table["off_rms_u"][0])

    limit = stats.t.isf(FALSE_ALARM_PROBABILITY / count, 3)
    change = optimize.brentq(lambda c: pull(c) - beyond * limit, 1, 3)
    others = [both(3.0 + n, 0.5) for n in range(count - 1)]
    outcome = steady_outcome([both(2 * np.pi, change), *others])
    assert outcome.tables["validation"]["worse"].sum() == (beyond > 1)
    if beyond > 1:
        assert outcome.notes == ("more remains than with the table off at 1 rev/s of the motor",)


def test_nothing_recorded_is_nothing_reported():
    assert not steady_outcome([]).results


def test_speeds_between_are_half_way():
    assert midpoints([4.0, 1.0, 2.0]) == (1.5, 3.0)


def test_a_sweep_is_reported_by_bins_of_speed_and_along_its_time():
    rng = np.random.default_rng(5)
    count = 30000
    time = 7.0 + 1e-3 * np.arange(count)
    speed = np.linspace(-10, 10, count)
    torque = {
        "off": (1 + np.abs(speed)) * rng.standard_normal(count),
        "on": 0.1 * rng.standard_normal(count),
    }
    outcome = Sweep(time, speed, torque, np.abs(speed)).outcome()
    bins = outcome.tables["sweep_by_speed"]
    edges = np.append(bins["speed"] - SPEED_BIN / 2, bins["speed"][-1] + SPEED_BIN / 2)
    assert np.ptp(np.diff(bins["speed"])) < 1e-9
    for variant, values in torque.items():
        square = stats.binned_statistic(speed, values**2, "mean", edges).statistic
        peak = stats.binned_statistic(speed, np.abs(values), "max", edges).statistic
        np.testing.assert_allclose(bins[f"{variant}_rms"] ** 2, square, rtol=1e-9)
        np.testing.assert_allclose(bins[f"{variant}_peak"], peak, rtol=1e-12)
        rms = outcome.results[f"sweep_rms_{variant}"].value
        assert rms == pytest.approx(math.sqrt(np.mean(values**2)), rel=1e-12)
        level = outcome.results[f"sweep_level_{variant}"].value
        assert level == pytest.approx(stats.gmean(np.sqrt(square)), rel=1e-9)
    drawn = outcome.tables["sweep"]
    assert drawn["time"][0] == 0
    np.testing.assert_allclose(np.diff(drawn["time"]), 2e-3, rtol=1e-6)
    np.testing.assert_array_equal(drawn["speed"], speed[::2])
    np.testing.assert_array_equal(drawn["off"], torque["off"][::2])
    np.testing.assert_array_equal(drawn["table"], np.abs(speed)[::2])
