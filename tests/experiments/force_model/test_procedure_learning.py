"""What recordings of a learned model are taken for, and the conditions that they are under."""

import math
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

from rigtool.experiments.controller_torque import LoopSignals
from rigtool.experiments.force_model import procedure_learning as module
from rigtool.experiments.force_model.deviations import Deviations
from rigtool.experiments.force_model.procedure_learning import (
    FREE_TIME,
    _compared,
    _condition,
    _interval,
    _motion,
    exploring,
    untouched_motions,
)
from rigtool.experiments.force_model.records import LoadCase
from rigtool.quantity import STANDARD_GRAVITY, Quantity
from rigtool.recipe import load_recipe
from tests.experiments.virtual_runs import RECIPE


@dataclass(frozen=True)
class Recorded:
    """A recording of which only the conditions are asked for."""

    speed: float
    force: float

    def condition(self, name):
        return getattr(self, name)


STROKES = [Recorded(speed, force) for speed in (1.0, 2.0, 5.0, 9.0) for force in (0.0, 1.0, 3.0)]
MOVES = [Recorded(speed, 0.0) for speed in (1.0, 2.0, 9.0)]


def test_checks_and_slow_strokes_without_load_and_faster_moves_are_untouched():
    checks = [Recorded(math.nan, force) for force in (0.0, 1.0, 3.0)]  # of speeds that vary
    slow, faster = untouched_motions(STROKES, MOVES, checks)
    assert slow == [checks[0], Recorded(1.0, 0.0)]
    assert faster == [Recorded(2.0, 0.0), Recorded(9.0, 0.0)]


def test_the_slowest_two_speeds_are_compared_without_load_and_under_the_largest():
    found = _compared([*STROKES, STROKES[0]])
    pairs = {(one.speed, one.force) for one in found}
    assert pairs == {(1.0, 0.0), (1.0, 3.0), (2.0, 0.0), (2.0, 3.0)}
    assert len(found) == 4


@pytest.mark.parametrize(("speeds", "fastest"), [([0.9, 1.5], 1.5), ([0.9, 3.0], 2.0)])
def test_the_exploration_covers_the_stroke_up_to_two_turns_a_second(speeds, fastest, monkeypatch):
    """Of the output, or to the fastest speed that is learned; the motor turns by the ratio."""
    sets = ("rig.attachment=instrument", f"ilc_learn.speeds_rev_per_s={speeds}")
    recipe = load_recipe(RECIPE, sets)[0]
    rig, given = recipe.rig, []
    monkeypatch.setattr(module, "exploration", lambda *own: given.append(own))
    exploring(recipe)
    exploring(recipe, 3)
    high = math.radians(recipe.measure_force.angle) * rig.angle_ratio
    most = 2 * math.pi * fastest * rig.angle_ratio
    expected = (0.0, high, 2 * math.pi / rig.encoder_counts, most, FREE_TIME)
    assert given == [(*map(pytest.approx, expected), number) for number in (0, 3)]


def test_a_load_has_its_moment_and_inertia_on_the_arm(monkeypatch):
    recipe = load_recipe(RECIPE, ("rig.attachment=instrument",))[0]
    monkeypatch.setattr(
        module, "torque_per_ampere_at", lambda kt, degc: Quantity(0.05 - 1e-4 * degc, "N m/A", 0.0)
    )
    found, rig = _condition(recipe, None, 30.0, 2.0), recipe.rig
    assert found == LoadCase(
        pytest.approx(0.047),
        pytest.approx(2.0 * rig.load_arm),
        pytest.approx(2.0 / STANDARD_GRAVITY * rig.load_arm**2),
        pytest.approx(2 * math.pi / rig.encoder_counts),
        pytest.approx(rig.sample_time / 2),
    )


def test_the_filter_gets_the_interval_of_the_recording_and_that_of_the_loop():
    time = 0.3 + 2e-3 * np.arange(11)
    values = {name: np.arange(11.0) for name in LoopSignals.__dataclass_fields__}
    own = LoopSignals(**{**values, "time": time})
    assert _interval(own) == pytest.approx(2e-3)
    found = _motion(own, LoadCase(0.05, 0.0, 0.0, 1e-3, lead=0.25e-3))
    assert (found.sample_time, found.loop_time) == (pytest.approx(2e-3), 0.5e-3)
    assert (found.torque_constant, found.count) == (0.05, 1e-3)
    assert found.encoder is own.encoder


class Warm(Recorded):
    """A recording of a motor whose temperature rises by 2 K."""

    @property
    def name(self):
        return f"load_{self.force:g}"

    def read(self, channel):
        assert channel == "temperature"
        return 20 + 5 * self.force + np.array([0.0, 1.0, 2.0])


def test_moves_have_the_mean_temperature_of_strokes_and_the_exploration_its_own(monkeypatch):
    class Done(Exception):
        pass

    def ended(*given):
        raise Done

    given, recipe = [], load_recipe(RECIPE)[0]
    monkeypatch.setattr(module, "stroke_record", lambda *own: None)
    monkeypatch.setattr(module, "scatter_ratios", lambda records: [0.0] * len(records))
    monkeypatch.setattr(
        module, "_repeated", lambda r, recipe, kt, degc, force: given.append((degc, force))
    )
    monkeypatch.setattr(
        module, "_condition", lambda recipe, kt, degc, force: given.append((degc, force))
    )
    monkeypatch.setattr(module, "_signals", ended)
    strokes = [Warm(1.0, 0.0), Warm(1.0, 4.0)]
    with pytest.raises(Done):
        module.learn_force(strokes, [Warm(9.0, 0.0)], [], Warm(1.0, 2.0), [], recipe, None)
    assert given == [(31.0, 0.0), (31.0, 0.0)]


@pytest.mark.parametrize("interval", [1e-3, 2e-3])
def test_rest_is_learned_from_the_slowest_moves_with_the_table_as_well(monkeypatch, interval):
    """As many samples as the exploration has, where they have one length with it; at the mean
    temperature of the strokes."""

    class Done(Exception):
        pass

    def signals(recording, recipe):
        size, step = (40, 1e-3) if recording.speed == 7.0 else (90, interval)
        values = {
            name: recording.speed + np.arange(size) for name in LoopSignals.__dataclass_fields__
        }
        return LoopSignals(**{**values, "time": step * np.arange(size)})

    def rest(learned, explorations, uncertainty):
        given.append(explorations)
        raise Done

    given, recipe = [], load_recipe(RECIPE)[0]
    quiet = SimpleNamespace(learned=None, stroke=1.0, load=1.0, uncertainty=None)
    monkeypatch.setattr(module, "stroke_record", lambda *own: None)
    monkeypatch.setattr(module, "scatter_ratios", lambda records: [0.0] * len(records))
    monkeypatch.setattr(module, "_condition", lambda r, kt, degc, f: LoadCase(degc, f, 0.0, 1e-3))
    monkeypatch.setattr(module, "_signals", signals)
    monkeypatch.setattr(module, "single", lambda *own: None)
    monkeypatch.setattr(module, "deviations", lambda *own: Deviations(1.0, 1.0, 1.0, 1.0))
    monkeypatch.setattr(module, "kept_by_mean", lambda *own: 1.0)
    monkeypatch.setattr(module, "learn_sliding", lambda *own: quiet)
    monkeypatch.setattr(module, "ForceModel", lambda *own: quiet)
    monkeypatch.setattr(module, "learn_rest", rest)
    switched = [Warm(9.0, 0.0), Warm(3.0, 0.0), Warm(5.0, 0.0)]
    kt = SimpleNamespace(results={})
    with pytest.raises(Done):
        module.learn_force([Warm(1.0, 4.0)], [], switched, Warm(7.0, 2.0), [], recipe, kt)
    ((first, *others),) = given
    assert (first.encoder[0], first.torque_constant) == (7.0, 31.0)
    assert [one.encoder.tolist() for one in others] == (
        [] if interval == 2e-3 else [(3 + np.arange(40)).tolist()]
    )
    assert all(one.torque_constant == 41.0 and len(one.current) == 40 for one in others)
