"""What a check of a table states in numbers and in words, from changes that are known."""

import math

import numpy as np
import pytest

from rigtool.control.lookup_table import LookupTable
from rigtool.experiments.learning.check.results import outcome_of, table_verdict
from rigtool.experiments.learning.check.table_health import HealthChange, ParityPart, TableHealth
from rigtool.experiments.learning.learned_table import COULOMB, VISCOUS, LearnedTable
from rigtool.experiments.learning.rows import Row
from rigtool.quantity import Quantity

COUNTS = 4000


def health(**changes):
    """Return a check of a whole turn whose pattern is another one; a move scatters by 0.2 mN m."""
    made = {
        "shift": HealthChange(0.5, 0.02),
        "whole_turn": True,
        "reach": math.pi,
        "scale": HealthChange(1.5, 0.01),
        "friction": HealthChange(0.0, 1e-5),
        "offset": HealthChange(0.0, 1e-5),
        "mismatch": 1e-3,
        "shape": 1.1e-3,
        "scaled": 0.9e-3,
        "shifted": 0.8e-3,
        "even": 0.9e-3,
        "odd": 0.4e-3,
        "unexplained": HealthChange(0.62, 0.05),
        "pattern": 1.2e-3,
        "limit": 0.2e-3,
    }
    return TableHealth(**(made | changes))


def learned():
    position = 2 * math.pi * np.arange(8) / 8
    rows = 1e-3 * np.stack([np.cos(position), 2 * np.cos(position)])
    low = np.array([0.0, 2.0])
    table = LookupTable(
        position, np.array([2.0, 5.0]), rows, low, np.array([0.0, 1.0]), 2 * math.pi
    )
    return LearnedTable(table, 0 * rows, "torque", "N m", {}, 40.0, None, ())


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (
            {"mismatch": 0.19e-3},
            "the table fits: a single move scatters by 0.2 mN m rms, the table",
        ),
        ({}, "part independent of direction has another shape, as after a power cycle"),
        ({"even": 0.3e-3}, "friction by position has another shape"),
        ({"scaled": 0.1e-3}, "the pattern is at the same position, 1.5 times as large"),
        (
            {"shifted": 0.1e-3},
            "it is the same pattern, shifted by 28.65 +- 1.15 deg (318 +- 13 counts), as after "
            "another index; shifting the table by that is enough, and leaves 0.1 mN m rms",
        ),
        ({"shifted": 0.0}, "leaves nothing above the scatter"),
        ({"shift": HealthChange(-math.pi + 0.05, 0.02), "shifted": 0.0}, "by half a turn, -177.14"),
        ({"shift": HealthChange(math.pi - 0.009, 0.0), "shifted": 0.0}, "by half a turn, 179.48"),
        ({"shift": HealthChange(-math.pi + 0.07, 0.02), "shifted": 0.0}, "shifted by -175.99"),
        (
            {"whole_turn": False, "reach": 0.25},
            "(or it is shifted by 28.6 deg, or by more than 14.3: a part of the turn",
        ),
        (
            {"shape": 0.1e-3, "friction": HealthChange(-0.4e-3, 2e-5)},
            "friction has changed by -0.4 +- 0.02 mN m; a shift is not enough: learn again",
        ),
        (
            {"shape": 0.1e-3, "offset": HealthChange(0.4e-3, 2e-5)},
            "both directions are off by +0.4 +- 0.02 mN m",
        ),
        (
            {"shape": 0.1e-3, "offset": HealthChange(0.4e-3, 2e-5), "friction": None},
            "friction, or an offset, is off by +0.4 +- 0.02 mN m",
        ),
        (
            {"shifted": 0.1e-3, "friction": HealthChange(-0.4e-3, 2e-5)},
            "; a shift alone is not enough: learn again",
        ),
        (
            {"shifted": 0.1e-3, "offset": HealthChange(0.4e-3, 2e-5)},
            "; a shift alone is not enough: learn again",
        ),
        ({"shape": 0.1e-3}, "several parts changed slightly"),
    ],
)
def test_the_verdict_names_what_changed_and_by_how_much(changes, words):
    verdict = table_verdict(health(**changes), COUNTS)
    assert words in verdict
    if "fits" not in words:
        assert verdict.startswith("the table does not fit, the table is off by 1 mN m rms while a")


def test_numbers_have_the_degrees_of_freedom_of_the_fewest_moves():
    table = learned()
    position = np.array([0.3, 2.0, 4.0])
    rng = np.random.default_rng(1)
    rows = [Row(2.0, 1e-3 * rng.standard_normal((4, 3))), Row(5.0, rng.standard_normal((6, 3)))]
    found_parts = [
        ParityPart(row.speed, False, np.zeros(3), np.zeros(3), row.moves) for row in rows
    ]
    found = outcome_of(health(), found_parts, rows, position, table, COUNTS)
    results = found.results
    for name, value, u in (
        ("table_shift", 0.5, 0.02),
        ("table_shift_counts", 0.5 * COUNTS / (2 * math.pi), 0.02 * COUNTS / (2 * math.pi)),
        ("table_scale", 1.5, 0.01),
        ("shape_difference", 0.62, 0.05),
        ("friction_change", 0.0, 1e-5),
        ("offset_change", 0.0, 1e-5),
        ("non_repeatable_rms", 0.2e-3, 0.2e-3 / math.sqrt(6)),  # of 3 degrees of freedom
    ):
        assert (results[name].value, results[name].u) == pytest.approx((value, u), rel=1e-12)
        assert results[name].dof == 3
    assert results["table_fits"].value == 0
    for name, value in (("", 1e-3), ("pattern_", 1.1e-3), ("shifted_", 0.8e-3)):
        assert results[f"{name}mismatch_rms"].value == value
    off = [
        row.mean - scale * np.interp(position, *_line(table))
        for row, scale in zip(rows, (1, 2), strict=True)
    ]
    health_by_speed = found.tables["table_health"]
    np.testing.assert_allclose(
        health_by_speed["mismatch_rms"], [np.sqrt(np.mean(o**2)) for o in off], rtol=1e-9
    )
    np.testing.assert_allclose(health_by_speed["mean_change"], [o.mean() for o in off], rtol=1e-9)
    scatter = [np.sqrt(row.moves.var(axis=0, ddof=1).mean()) for row in rows]
    np.testing.assert_allclose(health_by_speed["non_repeatable_rms"], scatter)
    waves = found.tables["health_waveforms"]
    for table_of in (health_by_speed, waves):
        assert table_of["speed"].tolist() == [2.0, 5.0]
    np.testing.assert_array_equal(waves["position"], position)
    expected = [row.moves.std(axis=0, ddof=1) / math.sqrt(len(row.moves)) for row in rows]
    np.testing.assert_allclose(waves["u"], expected)
    np.testing.assert_allclose(waves["now"] - waves["learned"], off, rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(np.ravel(waves["dof"]), [3, 5])


def _line(learned):
    """Return position and the first row of a table, written out over a turn."""
    table = learned.table
    return np.append(table.position, 2 * math.pi), np.append(table.torque[0], table.torque[0, 0])


def test_without_a_pattern_there_is_no_shift():
    part = ParityPart(2.0, False, np.zeros(3), np.zeros(3), np.zeros((2, 3)))
    rows = [Row(2.0, np.zeros((2, 3)))]
    found = outcome_of(
        health(shift=None, scale=None, friction=None), [part], rows, np.arange(3.0), learned(), 16
    )
    for name in ("table_shift", "table_shift_counts", "table_scale"):
        assert math.isnan(found.results[name].value)
        assert "no pattern above its noise" in found.results[name].reason
    assert "friction_change" not in found.results
    assert found.notes[-1].startswith("one direction alone")


def test_the_band_is_in_orders_of_the_turn():
    table = learned()
    own = dict(vars(table))
    assert table.band_order(5.0) == table.band_order(-5.0) == int(40 * 2 * math.pi / 5)
    assert LearnedTable(**own | {"band_speed": 2.0}).band_order(5.0) == int(40 * math.pi)
    assert LearnedTable(**own | {"band_hz": None}).band_order(5.0) is None


def test_the_rule_between_entries_states_where_the_table_ends():
    table = learned()
    assert "Periodic over 6.28318531 rad" in table.rule()[1]
    part = LookupTable(
        **{
            name: getattr(table.table, name)
            for name in ("position", "speed", "torque", "low_speed", "amplitude")
        }
    )
    friction = {COULOMB: Quantity(2e-3, "N m", 0.0), VISCOUS: Quantity(5e-5, "N m s/rad", 0.0)}
    cut = LearnedTable(**dict(vars(table)) | {"table": part, "friction": friction})
    assert "outside 0 to 5.49779 rad are clamped" in cut.rule()[1]
    assert cut.friction_lines()[1] == "0.002 N m * tanh(v) + 5e-05 N m s/rad * v"
    assert table.friction_lines() == []


@pytest.mark.parametrize(
    ("value", "u", "changed"),
    [
        (0.11e-3, 1e-6, True),
        (0.09e-3, 1e-6, False),
        (0.4e-3, 0.3e-3, False),
        (-0.11e-3, 1e-6, True),
    ],
)
def test_a_mean_has_changed_where_it_is_certain_and_half_of_what_a_move_scatters(value, u, changed):
    own = HealthChange(value, u)
    assert health(friction=own).friction_changed == changed
    assert health(offset=own).offset_changed == changed
    assert health(friction=None).friction_changed is False
    # a part of a turn has part of a pattern in its mean
    part = {"whole_turn": False, "shape": 0.3e-3}
    assert not health(offset=HealthChange(0.29e-3, 1e-6), **part).offset_changed
    assert health(offset=HealthChange(0.31e-3, 1e-6), **part).offset_changed
