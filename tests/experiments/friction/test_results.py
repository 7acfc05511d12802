"""Results and tables of friction, line by line of their budgets."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import sem, ttest_1samp

from rigtool.experiments.friction.breakaway import Breakaway, TorqueRamp
from rigtool.experiments.friction.direction_fit import DirectionFit
from rigtool.experiments.friction.holds import Holds
from rigtool.experiments.friction.offset import Offset
from rigtool.experiments.friction.results import (
    MODEL_POINTS,
    RAMP_POINTS,
    Findings,
    Scale,
    add_breakaway,
    add_flatness,
    add_friction,
    add_static_friction,
    breakaway_table,
    holds_table,
    model_table,
    ramp_table,
    torque_speed_table,
)
from rigtool.experiments.friction.results_radial import add_radial_breakaway
from rigtool.experiments.friction.sweep import TorqueSpeed
from rigtool.quantity import combined, error_line

CONSTANT = combined(0.05, "N m/A", [error_line("gauge", 2e-4, "N m/A", 9)])
RELATIVE = 2e-4 / 0.05
POSITION = np.linspace(0, 2 * np.pi, 12, endpoint=False)
COVARIANCE = np.diag([1e-5, 1e-6, 3e-5, 0.02]) ** 2


def findings(**common):
    return Findings(Scale(CONSTANT), common=common)


def fit(coulomb, exponent=2.0, dof=8, lowest=0.1):
    parameters = np.array([coulomb, 5e-5, 1.5 * coulomb, 0.4])
    averaged = np.array([coulomb, 5e-5])
    return DirectionFit(
        parameters if exponent else parameters[:2],
        averaged, COVARIANCE, exponent, dof, lowest, 30.0, 0.0, 1.0, coulomb,
    )  # fmt: skip


def breakaway(extra=0.0, seed=1, dof=20.0):
    rng = np.random.default_rng(seed)
    ripple = 0.5e-3 * np.sin(2 * POSITION)
    drawn = 3e-5 * rng.standard_normal((2, 12))
    return Breakaway(
        POSITION, 4e-3 + extra + ripple + drawn[0], 3e-3 + extra - ripple + drawn[1], 3e-5, dof
    )


def test_a_mean_of_directions_has_half_of_each_scatter_and_what_they_share():
    fits = {1: fit(2.4e-3, dof=8), -1: fit(2.0e-3, dof=4)}
    offset = Offset((0.2e-3, 2e-5), (0.01, 0.1), False, 5e-5)
    found = findings(temperature=(4e-6, 2e-7))
    add_friction(fits, offset, found)
    mean = found.results["coulomb_friction"]
    lines = [
        error_line("forward", 0.5e-5, "N m", 8),
        error_line("backward", 0.5e-5, "N m", 4),
        error_line("temperature", 4e-6, "N m"),
        error_line("constant", 2.2e-3 * RELATIVE, "N m", 9),
    ]
    expected = combined(2.2e-3, "N m", lines)
    assert mean.value == pytest.approx(2.2e-3)
    assert mean.u == pytest.approx(expected.u, rel=1e-9)
    assert mean.dof == pytest.approx(expected.dof, rel=1e-9)
    for name, sign in (("positive", 1), ("negative", -1)):
        own = found.results[f"coulomb_friction_{name}"]
        value = fits[sign].coulomb[0] - sign * 0.2e-3
        assert own.value == pytest.approx(value)
        parts = 1e-5, 4e-6, value * RELATIVE, 2e-5, 5e-5
        assert own.u == pytest.approx(math.hypot(*parts), rel=1e-9)
        viscous = found.results[f"viscous_friction_{name}"]
        assert viscous.u == pytest.approx(math.hypot(1e-6, 2e-7, 5e-5 * RELATIVE), rel=1e-9)
        velocity = found.results[f"stribeck_velocity_{name}"]
        assert (velocity.value, velocity.u) == (0.4, pytest.approx(0.02))  # no torque
    assert found.results["friction_offset"].u == pytest.approx(
        math.hypot(2e-5, 0.2e-3 * RELATIVE), rel=1e-9
    )
    assert found.results["friction_asymmetry"].u == pytest.approx(0.1)
    assert any("same in both directions" in note for note in found.notes)


def test_a_stribeck_effect_that_does_not_show_is_named():
    found = findings()
    lines = {1: fit(2e-3, None, lowest=0.1), -1: fit(2e-3, None, lowest=0.25)}
    add_friction(lines, None, found)
    assert "a Stribeck effect in positive and negative direction: Coulomb" in found.notes[-1]
    assert "a line above 0.25 rad/s" in found.notes[-1]
    assert "stribeck_velocity" not in found.results
    alone = findings()
    add_friction({-1: fit(2e-3)}, None, alone)
    assert "only the negative direction" in alone.notes[0]
    assert alone.results["coulomb_friction"].u == alone.results["coulomb_friction_negative"].u


def test_breakaway_has_the_scatter_of_one_ramp_at_its_ends_and_of_their_mean():
    own, found = breakaway(), findings()
    add_breakaway(own, found)
    for name, value in (
        ("min", min(own.positive.min(), own.negative.min())),
        ("max", max(own.positive.max(), own.negative.max())),
    ):
        result = found.results[f"breakaway_torque_{name}"]
        assert result.value == value
        assert result.u == pytest.approx(math.hypot(3e-5, value * RELATIVE), rel=1e-9)
        assert result.budget[0].dof == 20
    unknown = findings()
    add_breakaway(breakaway(dof=0.0), unknown)
    assert unknown.results["breakaway_torque_max"].u is None
    offset = Offset((0.4e-3, 2e-5), (0.0, 0.0), True)
    add_static_friction(own, {}, offset, found)
    half = (own.positive + own.negative) / 2
    assert found.results["static_friction"].value == pytest.approx(half.mean(), rel=1e-3)
    for sign, name in ((1, "positive"), (-1, "negative")):
        shift = ((own.positive - own.negative) / 2).mean() - 0.4e-3
        value = half.mean() + sign * shift
        result = found.results[f"static_friction_{name}"]
        assert result.value == pytest.approx(value, rel=1e-3)
        total = math.hypot(own.level.u, own.middle.u, 2e-5, result.value * RELATIVE)
        assert result.u == pytest.approx(total, rel=1e-9)


def test_static_friction_without_breakaway_is_the_models():
    found = findings()
    add_static_friction(None, {1: fit(2.4e-3), -1: fit(2.0e-3, None)}, None, found)
    result = found.results["static_friction"]
    assert result.value == pytest.approx(3.6e-3)
    assert result.u == pytest.approx(math.hypot(3e-5, 3.6e-3 * RELATIVE), rel=1e-9)
    assert "extrapolated to standstill" in found.notes[-1]


def test_a_radial_force_adds_to_breakaway_what_pairs_differ_by():
    before, after = breakaway(), breakaway(1e-3, seed=2)
    after.positive[3] = np.nan
    found = findings()
    add_radial_breakaway(before, after, found, 0.01)
    pairs = np.concatenate([after.positive - before.positive, after.negative - before.negative])
    pairs = pairs[np.isfinite(pairs)]
    result = found.results["radial_load_breakaway"]
    assert result.value == pytest.approx(pairs.mean())
    parts = sem(pairs), 0.01 * result.value, RELATIVE * result.value
    assert result.u == pytest.approx(math.hypot(*parts), rel=1e-9)
    assert result.budget[0].dof == ttest_1samp(pairs, 0).df
    none = findings()
    add_radial_breakaway(before, breakaway(np.nan), none)
    assert not none.results
    assert "nothing to compare" in none.notes[0]


def test_what_compensation_leaves_is_judged_where_it_is_complete():
    """tanh(v) is within half a percent of one from 3 rad/s on."""
    speed = np.array([-9.0, -3.0, -2.9, 0.0, 2.9, 3.1, 8.0])
    torque = np.array([1.0, 2.0, 50.0, 60.0, 50.0, 4.0, 5.0]) * 1e-3
    found = findings()
    add_flatness(TorqueSpeed(speed, torque, *np.ones((3, 7))), found)
    expected = np.std(np.array([1.0, 2.0, 4.0, 5.0]) * 1e-3)
    assert found.results["compensated_torque_rms"].value == pytest.approx(expected)
    slow = findings()
    add_flatness(TorqueSpeed(speed[2:5], torque[2:5], *np.ones((3, 3))), slow)
    assert not slow.results


def test_tables_are_in_the_order_of_speed():
    speed = np.array([3.0, -1.0, 1.0])
    rows = Holds(speed, speed * 1e-3, speed**2, speed + 10, speed + 5, *[np.zeros(3)] * 2,
                 *[np.zeros(3)] * 2)  # fmt: skip
    table = holds_table(rows, settled=True)
    for name, values in (
        ("speed", [-1, 1, 3]),
        ("torque", [-1e-3, 1e-3, 3e-3]),
        ("u", [1, 1, 9]),
        ("dof", [9, 11, 13]),
        ("revolutions", [4, 6, 8]),
    ):
        np.testing.assert_allclose(table[name], values)
    swept = TorqueSpeed(*np.arange(15.0).reshape(5, 3))
    table = torque_speed_table(swept, "feed-forward off")
    assert table.description == "Torque against speed, feed-forward off"
    for name in ("speed", "torque", "revolutions", "u", "dof"):
        np.testing.assert_array_equal(table[name], getattr(swept, name), err_msg=name)
    curve = model_table({1: fit(2e-3, lowest=0.1), -1: fit(1e-3, None, lowest=0.3)})
    assert len(curve["speed"]) == 2 * MODEL_POINTS
    assert (np.diff(curve["speed"]) > 0).all()
    np.testing.assert_allclose(np.abs(curve["speed"]).min(), 0.1)
    v = curve["speed"]
    own = np.where(v > 0, 2e-3 + 1e-3 * np.exp(-((v / 0.4) ** 2)) + 5e-5 * v, -1e-3 + 5e-5 * v)
    np.testing.assert_allclose(curve["torque"], own, rtol=1e-9)


def test_the_ramp_that_is_stored_is_the_highest():
    time = 5.0 + 1e-3 * np.arange(30000)
    ramps = [
        TorqueRamp(begin=b, end=e, torque=t, position=0.0, direction=1.0)
        for b, e, t in ((0, 9000, 2e-3), (9000, 18001, 3e-3), (20000, 30000, np.nan))
    ]
    table = ramp_table(ramps, time, time * 2, time * 3)
    assert table["time"][0] == 0
    np.testing.assert_allclose(np.diff(table["time"]), 5e-3, rtol=1e-6)
    assert len(table["time"]) <= RAMP_POINTS
    np.testing.assert_allclose(table["position"], 2 * (table["time"] + time[9000]))
    np.testing.assert_allclose(table["torque"], 3 * (table["time"] + time[9000]))


def test_breakaway_is_stored_by_direction_and_load():
    places, *columns = np.arange(15.0).reshape(5, 3)
    plain, loaded = (SimpleNamespace(positive=a, negative=b) for a, b in (columns[:2], columns[2:]))
    both = breakaway_table(places, plain, loaded)
    assert both.signal == "positive"
    names = ("positive", "negative", "loaded_positive", "loaded_negative")
    for name, values in zip(names, columns, strict=True):
        np.testing.assert_array_equal(both[name], values, err_msg=name)
    np.testing.assert_array_equal(both["position"], places)
    alone = breakaway_table(places, None, loaded)
    assert (alone.signal, set(alone.columns)) == ("loaded_positive", {"position", *names[2:]})
    assert set(breakaway_table(places, plain, None).columns) == {"position", *names[:2]}
