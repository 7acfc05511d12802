"""Which run taught the table, how its noise adds up, why learning ended, what was fed forward."""

import itertools
import math
from types import SimpleNamespace

import numpy as np
import pytest

from rigtool.errors import InsufficientDataError, RunFileError, UsageError
from rigtool.experiments.learning.check import procedure
from rigtool.experiments.learning.convergence import LearningRun
from rigtool.experiments.learning.implementations import c_limited_angle, signals
from rigtool.experiments.learning.implementations.runs import (
    iterations_notes,
    iterations_table,
    kind_of,
    last_update,
    recorded_runs,
    runs_at_most,
)
from rigtool.experiments.learning.learned_table import COULOMB, VISCOUS
from rigtool.experiments.procedure import only_run
from rigtool.quantity import Quantity
from rigtool.recipe import load_recipe
from rigtool.rigs import Load
from tests.experiments.virtual_runs import RECIPE


def judged(*ratios):
    """Runs of which noise explains a ratio of two."""
    return [
        LearningRun(3e-3 - 1e-4 * n, 1e-5, 5e-3, 2e-5, 7, 0.4e-3 + n * 1e-5, ratio, 2.0)
        for n, ratio in enumerate(ratios)
    ]


@pytest.mark.parametrize(
    ("ratios", "last"), [((9.0,), 0), ((1.0,), 0), ((9.0, 1.9), 0), ((9.0, 2.1), 1), ((9, 3, 1), 1)]
)
@pytest.mark.parametrize("factor", [1.0, 0.4])
def test_a_run_that_finds_nothing_makes_no_update(ratios, last, factor):
    """The noise of a table after its updates, in that of one run: f' = (1 - p) f + p n."""
    found, variance = last_update(judged(*ratios), factor)
    assert found == last
    carried = sum(
        (factor * (1 - factor) ** (last - n)) ** 2 for n in range(last + 1)
    )  # each run's noise fades with the later updates
    assert variance == pytest.approx(carried / factor**2, rel=1e-12)


def test_runs_are_those_that_were_made():
    recipe = load_recipe(RECIPE, ("ilc_learn.iterations=3",))[0]
    assert runs_at_most(recipe) == 3
    for name, runs in (("A", 10), ("standard", 10), ("B", 1), ("C", 1)):
        own = load_recipe(RECIPE, (f"ilc_learn.implementation={name}",))[0]
        assert runs_at_most(own) == runs
    assert [kind_of(n) for n in (0, 1, 12)] == ["learn", "iterate_01", "iterate_12"]
    made = {"learn_": ["a"], "iterate_01_": ["b"], "iterate_02_": [], "iterate_03_": ["d"]}
    run = SimpleNamespace(
        recordings_named=lambda kind: made[kind], recordings_of=lambda kind: made[f"{kind}_"]
    )
    assert recorded_runs(run, recipe) == [["a"], ["b"]]


def test_notes_state_why_learning_ended_and_what_remains():
    def note(*ratios, most=5):
        return " ".join(iterations_notes(judged(*ratios), "mN m", most))

    assert note(1.0) == (
        "nothing repeats above chance: all there is, 0.4 mN m rms in a single cycle, cannot be "
        "learned"
    )
    assert note(9.0, 3.0, 1.0).startswith("learning ended after 2 updates: ")
    assert "the remainder, 0.42 mN m rms in a single cycle," in note(9.0, 3.0, 1.0)
    assert note(9.0, 3.21) == (
        "after 1 of at most 5 learning runs another update would still change 3.21 times what "
        "noise explains; the non-repeatable part is 0.41 mN m rms in a single cycle"
    )
    assert note(9.0, most=1) == ""


def test_the_table_has_a_row_for_each_run():
    table = iterations_table(judged(9.0, 3.0), "N m", "controller torque")
    np.testing.assert_array_equal(table["iteration"], [0, 1])
    np.testing.assert_allclose(table["rms"], [3e-3, 2.9e-3])
    np.testing.assert_allclose(table["non_repeatable_rms"], [0.4e-3, 0.41e-3])
    np.testing.assert_allclose(table["ratio"], [9, 3])
    np.testing.assert_allclose(table["dof"], [7, 7])


FRICTION = {COULOMB: Quantity(2e-3, "N m", 0.0), VISCOUS: Quantity(1e-4, "N m s/rad", 0.0)}


@pytest.mark.parametrize("speed", [3.0, -0.5])
@pytest.mark.parametrize(("off", "refused"), [(1.019, False), (1.025, True), (0.975, True)])
def test_friction_that_was_fed_forward_is_that_of_the_model_within_a_fiftieth(speed, off, refused):
    recorded = off * (2e-3 * math.tanh(speed) + 1e-4 * speed)
    if refused:
        with pytest.raises(RunFileError, match=f"friction of {recorded * 1e3:.3g} mN m was fed"):
            signals.require_friction_fed("learn_000", recorded, speed, FRICTION)
    else:
        signals.require_friction_fed("learn_000", recorded, speed, FRICTION)


def test_without_friction_none_was_fed_forward():
    signals.require_friction_fed("learn_000", 1e-10, 3.0, {})
    with pytest.raises(RunFileError, match="0 mN m are expected without --friction"):
        signals.require_friction_fed("learn_000", 1e-6, 3.0, {})
    with pytest.raises(UsageError, match="2 run files: ilc-learn takes one, with all its speeds"):
        only_run([1, 2], "ilc-learn", "speeds")


@pytest.mark.parametrize(("part", "refused"), [(0.51, False), (0.49, True)])
def test_moves_and_table_share_half_of_the_positions(monkeypatch, part, refused):
    recipe = load_recipe(RECIPE)[0]
    every = c_limited_angle.positions(recipe, recipe.ilc_learn.turn_angle)
    table = SimpleNamespace(position=every[: math.ceil(part * every.size)])
    recorded = [SimpleNamespace(condition=lambda name: 3.0) for _ in range(2)]
    monkeypatch.setattr(c_limited_angle, "moves_of", lambda recording, *others: (recording, None))
    monkeypatch.setattr(procedure, "learned_rows", lambda moves, *others: [moves])
    if refused:
        with pytest.raises(InsufficientDataError, match="check where it was learned"):
            procedure._moved_rows(recorded, recipe, 0.05, None, table)
    else:
        position, rows = procedure._moved_rows(recorded, recipe, 0.05, None, table)
        np.testing.assert_array_equal(position, table.position)
        assert rows == recorded


@pytest.mark.parametrize(
    ("force", "remedy"), [(0.0, "lower the speed"), (1.0, "use a smaller force")]
)
def test_a_loop_that_saturates_ends_the_recording_at_once(force, remedy):
    """A rig that goes on for ever is stopped behind the first block at the limit, which is kept."""
    recipe, appended = load_recipe(RECIPE)[0], []
    names = "time", "current_setpoint", "feedforward_current"

    def perform(task):
        for number in itertools.count():
            current = np.full(100, recipe.rig.current_limit if number == 2 else 0.4)
            yield dict(zip(names, (np.arange(100.0), current, current), strict=True))

    rig = SimpleNamespace(perform=perform)
    recorder = SimpleNamespace(
        channel_names=lambda name: names, append=lambda name, block: appended.append(block)
    )
    task = SimpleNamespace(load=Load(force=force))
    with pytest.raises(InsufficientDataError, match=f"recording known_003: .*{remedy}"):
        signals.record_loop(rig, recipe, task, recorder, "known_003")
    assert len(appended) == 3
