"""Rigs drawn as `make coverage` draws them: their results lie within what is stated."""

import math
from pathlib import Path

from scipy import stats

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"
FAR = 5.0


def test_a_drawn_rig_is_within_what_is_stated(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    from designs import DESIGNS
    from trials import trials

    (number,) = (n for n, design in enumerate(DESIGNS) if design.name == "calibrate-kt, 3 x 2")
    (tried,) = trials([number], seed=2)
    assert tried.refusal is None
    names = {name for name, _ in tried.found}
    assert {"torque_constant", "amplifier_gain"} <= names
    for error, u, dof in tried.found.values():
        width = u * stats.t.ppf(0.975, dof) / stats.norm.ppf(0.975)
        assert abs(error) < FAR * width
        assert 0 < u < math.inf


def test_designs_that_learn_the_same_loads_share_a_rig(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    import designs

    groups = {tuple(designs.group(number)) for number in range(len(designs.DESIGNS))}
    assert sorted(number for group in groups for number in group) == [*range(len(designs.DESIGNS))]
    shared = [[designs.DESIGNS[n] for n in group] for group in groups if len(group) > 1]
    assert [len({one.draw for one in group}) for group in shared] == [1, 1]
    assert all(one.learns is not None for group in shared for one in group)


def test_ripple_grows_with_the_current_that_holds_the_friction_at_its_speed(monkeypatch):
    """Of a motor whose friction at rest is twice as much, and 1.25 times as much forwards."""
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    import designs
    from trials import RECIPE

    from rigtool.recipe import load_recipe

    names = "coulomb_friction=4e-3", "static_friction=8e-3", "stribeck_velocity=1"
    settings = (*names, "friction_asymmetry=0.25")
    recipe, _ = load_recipe(RECIPE, tuple(f"virtual.motor.{name}" for name in settings))
    falls = math.exp(-4)
    assert designs.dry_friction(recipe, 2.0) == 1.25 * (4e-3 + 4e-3 * falls)
    slow, fast = (designs.true_orders(recipe, v, 0.05, 20.0) for v in (0.01, 10.0))
    assert slow[2] > 1.02 * fast[2] > 0
