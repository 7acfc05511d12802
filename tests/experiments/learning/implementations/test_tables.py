"""Where tables of a range and of one speed lie, and what they are between their entries."""

import math
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

from rigtool.errors import InsufficientDataError, RunFileError
from rigtool.experiments.learning.implementations import a_one_speed, c_limited_angle
from rigtool.experiments.learning.learned_table import COULOMB, VISCOUS
from rigtool.experiments.learning.rows import Row
from rigtool.quantity import Quantity
from rigtool.recipe import load_recipe
from tests.experiments.virtual_runs import RECIPE


@pytest.mark.parametrize("end", [0.0, 7.3, 30.0])
@pytest.mark.parametrize("counts", [4000, 1000])
def test_positions_are_all_counts_of_the_range_without_its_ends(end, counts):
    recipe = load_recipe(RECIPE, (f"rig.encoder_counts={counts}", "ilc_learn.angle=120"))[0]
    found = c_limited_angle.positions(recipe, end)
    count = 2 * math.pi / counts
    ratio = recipe.rig.angle_ratio
    low, high = math.radians(end) * ratio, math.radians(120 - end) * ratio
    np.testing.assert_allclose(np.diff(found), count, rtol=1e-9)
    np.testing.assert_allclose(found / count, np.round(found / count), atol=1e-9)
    assert low - 1e-12 <= found[0] < low + count
    assert high - count < found[-1] <= high + 1e-12


def test_moves_are_at_speeds_of_the_output_and_one_runs_in():
    recipe = load_recipe(RECIPE, ("rig.attachment=instrument",))[0]
    (slow, fast) = c_limited_angle.specs(recipe, "learn", [0.5, 2.0], 8)
    ratio = recipe.rig.angle_ratio
    assert [spec.name for spec in (slow, fast)] == ["learn_000", "learn_001"]
    for spec, rev in ((slow, 0.5), (fast, 2.0)):
        assert spec.conditions["speed"][0] == pytest.approx(2 * math.pi * rev * ratio)
        motion = c_limited_angle.motion(recipe, spec)
        assert motion.cycles == 9
        assert motion.speed == pytest.approx(spec.conditions["speed"][0])


def loop(corner, sample_time=1e-3):
    """A loop whose response falls as a first-order low-pass."""
    return SimpleNamespace(
        system=SimpleNamespace(sample_time=sample_time),
        loop_response=lambda frequency: 1 / (1 + 1j * frequency / corner),
    )


@pytest.mark.parametrize("corner", [1.0, 40.0, 300.0])
def test_the_bandwidth_is_where_the_response_has_fallen_by_three_decibels(corner):
    assert a_one_speed.bandwidth(loop(corner)) == pytest.approx(corner, rel=1e-3)


@pytest.mark.parametrize("corner", [0.04, 600.0])
def test_a_loop_without_a_bandwidth_below_half_the_rate_is_refused(corner):
    with pytest.raises(InsufficientDataError, match="no bandwidth below half"):
        a_one_speed.bandwidth(loop(corner))


def test_a_map_of_one_speed_is_the_same_at_all_speeds_and_fades_towards_rest():
    recipe = load_recipe(
        RECIPE,
        (
            "rig.encoder_counts=100",
            "ilc_learn.turning.speeds_rev_per_s=[1, 5]",
            "ilc_learn.turning.low_speeds_rev_per_s=[0.25]",
        ),
    )[0]
    moves = np.random.default_rng(1).standard_normal((3, 100))
    row = Row(2 * math.pi, moves)
    table = a_one_speed.untuned(row, recipe)
    rev = 2 * math.pi * np.array([-5.0, -1.0, -0.25, 0.25, 0.7, 5.0, 0.125, 0.0])
    position = np.full(8, table.position[3])
    parts = [1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.5, 0.0]
    found = table.evaluate(position, rev)
    np.testing.assert_allclose(found, np.array(parts) * row.mean[3], atol=1e-12)
    inside = table.covers(np.zeros(4), 2 * math.pi * np.array([-5.0, 5.0, -5.1, 5.1]))
    assert inside.tolist() == [True, True, False, False]
    assert table.period == pytest.approx(2 * math.pi)


def test_at_other_speeds_q_is_cut_off_where_the_same_orders_are(monkeypatch):
    """But not below that of learning."""
    made = a_one_speed.OneSpeed.__new__(a_one_speed.OneSpeed)
    made.recipe = load_recipe(RECIPE, ("rig.encoder_counts=100",))[0]
    turned = [SimpleNamespace(speed=speed) for speed in (-2.0, 2.0, 6.0, 12.0)]
    cutoffs = []

    def learned(item, learning, counts):
        cutoffs.append(learning.cutoff_hz)
        assert counts == 100
        return item

    table = SimpleNamespace(speed=np.ones(4), low_speed=np.array([0.0, 1.0]))
    monkeypatch.setattr(a_one_speed.OneSpeed, "learning", Cut(30.0))
    monkeypatch.setattr(a_one_speed.OneSpeed, "turned", lambda self, others: others)
    monkeypatch.setattr(a_one_speed, "_ripple", lambda item: item)
    monkeypatch.setattr(a_one_speed, "learned_by", learned)
    monkeypatch.setattr(a_one_speed, "tune", lambda row, rows: rows)
    monkeypatch.setattr(a_one_speed, "written_out", lambda angles, row, rows: (table, None))
    row = SimpleNamespace(speed=4.0, dof=9)
    found = made.finish(SimpleNamespace(row=row, history=[]), turned)
    assert cutoffs == [30.0, 30.0, 45.0, 90.0]
    assert found.tuning == found.others == turned
    np.testing.assert_array_equal(found.dof, 9)


@dataclass(frozen=True)
class Cut:
    cutoff_hz: float


@pytest.mark.parametrize(("part", "refused"), [(1.0, False), (0.97, True), (1.03, True)])
def test_friction_is_compared_where_rising_moves_have_their_speed(part, refused):
    """Not while they turn, nor on the way back, where it has the other sign."""
    recipe = load_recipe(RECIPE, ("rig.attachment=instrument",))[0]
    used = c_limited_angle.positions(recipe, recipe.ilc_learn.end_angle)
    up = np.linspace(used[0] - 0.2, used[-1] + 0.2, 400)
    setpoint = np.concatenate([up, up[::-1]])
    friction = (2e-3 * math.tanh(3.0) + 1e-4 * 3.0) / 0.05
    current = part * friction * np.repeat([1.0, -1.0], 400)
    current[(setpoint < used[0]) | (setpoint > used[-1])] = 7.0
    signals = {"position_setpoint": setpoint, "feedforward_current": current}
    recording = SimpleNamespace(
        name="learn_000", read=signals.__getitem__, condition={"speed": 3.0}.__getitem__
    )
    fed = {COULOMB: Quantity(2e-3, "N m", 0.0), VISCOUS: Quantity(1e-4, "N m s/rad", 0.0)}
    if refused:
        with pytest.raises(RunFileError, match="recording learn_000: friction of"):
            c_limited_angle.require_feedforward(recording, recipe, 0.05, fed)
    else:
        c_limited_angle.require_feedforward(recording, recipe, 0.05, fed)
