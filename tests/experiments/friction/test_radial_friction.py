"""Friction by radial force: holds at equal speeds, with and without the force."""

import math
from dataclasses import replace

import numpy as np
import pytest

from rigtool.experiments.friction.holds import Holds
from rigtool.experiments.friction.offset import Offset
from rigtool.experiments.friction.results import Findings, Scale
from rigtool.experiments.friction.results_radial import add_radial_friction
from rigtool.quantity import Quantity


def holds(speed, torque, u, dof):
    speed = np.array(speed, dtype=float)
    none = np.zeros(len(speed))
    return Holds(speed, np.array(torque), np.full(len(speed), u), none + dof, *[none] * 5)


def test_growth_is_that_at_equal_speeds_with_the_scatter_of_both():
    rng = np.random.default_rng(3)
    speed = [0.5, 1, 2, 5, -0.5, -1, -2, -5]
    friction = np.sign(speed) * (2e-3 + 1e-4 * np.abs(speed)) + 0.3e-3
    before = holds(speed, friction, 6e-6, 20)
    chosen = [5, 1, 6, 2]
    added = 1e-3 + 0.5e-5 * rng.standard_normal(4)
    torque = friction[chosen] + np.sign(np.array(speed)[chosen]) * added
    after = holds([*np.array(speed)[chosen], 9.0], [*torque, 1.0], 8e-6, 5)
    found = Findings(Scale(Quantity(0.05, "N m/A", 0.0)))
    add_radial_friction(before, after, 20.0, found, weights_u=0.01)
    result = found.results["radial_load_friction"]
    assert result.value == pytest.approx(added.mean(), rel=1e-9)
    # four pairs: u/sqrt(4) of each series, and the force's part
    assert result.u == pytest.approx(math.hypot(3e-6, 4e-6, 0.01 * added.mean()), rel=1e-6)
    by_name = {line.name: line for line in result.budget}
    assert by_name["scatter"].dof == pytest.approx(80)
    assert by_name["scatter with the force"].dof == pytest.approx(20)
    assert found.results["radial_friction_coefficient"].value == pytest.approx(result.value / 20)


def test_friction_that_wanders_from_hold_to_hold_is_part_of_u():
    """Growth by 8, 12, 9 and 11 e-4 forwards, and as much more at each speed backwards: to and fro
    at one speed have the same friction, which their mean holds whole. Each u is 1e-5."""
    found = Findings(Scale(Quantity(0.05, "N m/A", 0.0)))
    speed = np.array([1.0, 2.0, 3.0, 5.0, -1.0, -2.0, -3.0, -5.0])
    grown = np.array([8, 12, 9, 11, 18, 22, 19, 21]) * 1e-4
    before = holds(speed, np.sign(speed) * 2e-3, 1e-5, 9)
    after = holds(speed, np.sign(speed) * (2e-3 + grown), 1e-5, 9)
    add_radial_friction(before, after, 20.0, found)
    (line,) = (
        line
        for line in found.results["radial_load_friction"].budget
        if line.name == "friction from hold to hold"
    )
    # of the mean of four speeds, about it: squares 4 + 4 + 1 + 1 over three degrees of freedom;
    # eight holds with and eight without the force explain 2e-10/8
    square = 10e-8 / 3 / 4
    variance = square - 2e-10 / 8
    assert line.contribution == pytest.approx(math.sqrt(variance), rel=1e-9)
    assert line.dof == pytest.approx(3 * (variance / square) ** 2, rel=1e-9)


def test_holds_to_and_fro_that_differ_the_opposite_way_do_not_wander():
    """What one direction has more of, the other has less: their mean is the same at each speed."""
    found = Findings(Scale(Quantity(0.05, "N m/A", 0.0)))
    speed = np.array([1.0, 2.0, 3.0, -1.0, -2.0, -3.0])
    grown = np.array([9, 10, 11, 11, 10, 9]) * 1e-4
    before = holds(speed, np.sign(speed) * 2e-3, 1e-5, 9)
    after = holds(speed * 1.001, np.sign(speed) * (2e-3 + grown), 1e-5, 9)
    add_radial_friction(before, after, 20.0, found)
    result = found.results["radial_load_friction"]
    assert result.value == pytest.approx(1e-3, rel=1e-9)
    assert result.u == pytest.approx(1e-5 * math.sqrt(2 / 6), rel=1e-9)


def test_wander_that_the_scatter_of_holds_nearly_hides_is_known_by_little():
    """Four growths whose variance is twice what their own u explains."""
    found = Findings(Scale(Quantity(0.05, "N m/A", 0.0)))
    speed = np.array([1.0, 2.0, 3.0, 5.0])
    grown = 1e-3 + np.array([1, -1, 1, -1]) * 1e-5
    own = 1e-10 * 4 / 3 / 2
    before = holds(speed, speed * 0 + 2e-3, math.sqrt(own / 2), math.inf)
    after = holds(speed, 2e-3 + grown, math.sqrt(own / 2), math.inf)
    add_radial_friction(before, after, 20.0, found)
    result = found.results["radial_load_friction"]
    # Half of u squared is of the difference, with 3/4 degrees: together the 3 of the variance.
    assert result.u == pytest.approx(math.sqrt(2 * own / 4), rel=1e-9)
    assert result.dof == pytest.approx(3.0, rel=1e-9)


def test_other_speeds_are_not_compared():
    found = Findings(Scale(Quantity(0.05, "N m/A", 0.0)))
    add_radial_friction(
        holds([1, 2], [1e-3, 1e-3], 1e-6, 9), holds([3.0], [2e-3], 1e-6, 9), 22, found
    )
    assert not found.results
    assert any("no speed was held" in note for note in found.notes)


def test_a_hold_under_force_that_turns_unevenly_does_not_count():
    found = Findings(Scale(Quantity(0.05, "N m/A", 0.0)))
    before, after = holds([1, 2], [1e-3, 1e-3], 1e-6, 9), holds([1, 2], [3e-3, 2e-3], 1e-6, 9)
    add_radial_friction(before, replace(after, uneven=np.array([0.3, 0.0])), 20.0, found)
    assert found.results["radial_load_friction"].value == pytest.approx(1e-3)
    assert not add_radial_friction(before, replace(after, uneven=np.ones(2)), 20.0, found)
    assert "no speed was held" in found.notes[-1]


def test_holds_without_scatter_or_speed_divide_nothing():
    """A current that stays on one step of its drive has no scatter; a shaft at rest no speed."""
    found = Findings(Scale(Quantity(0.05, "N m/A", 0.0)))
    before = holds([1, 2, 0], [1e-3, 1e-3, 0], 0.0, 0.0)
    add_radial_friction(before, holds([1, 0], [2e-3, 0], 0.0, 4.0), 20.0, found)
    result = found.results["radial_load_friction"]
    assert (result.value, result.u) == (pytest.approx(1e-3), 0.0)


@pytest.mark.parametrize("held", [[1, 2, -1], [1, 2], [-1]])
@pytest.mark.parametrize("separated", [True, False])
def test_friction_that_differs_between_directions_is_taken_off(held, separated):
    """A fifth more forwards and a fifth less backwards, whatever is held."""
    found = Findings(Scale(Quantity(0.05, "N m/A", 0.0)))
    speed = np.array([1.0, 2.0, -1.0, -2.0])
    apart = 1 + 0.2 * np.sign(speed)
    before = holds(speed, np.sign(speed) * 2e-3 * apart, 1e-6, 9)
    here = np.isin(speed, held)
    after = holds(speed[here], (np.sign(speed) * 3e-3 * apart)[here], 1e-6, 9)
    offset = Offset((0.0, 1e-6), (0.2, 0.05), True) if separated else None
    add_radial_friction(before, after, 20.0, found, offset=offset)
    result, one = found.results["radial_load_friction"], len(np.unique(np.sign(held))) == 1
    if separated or not one:
        assert result.value == pytest.approx(1e-3, rel=1e-9)
        assert (result.u > 0.04e-3) == one
    else:
        assert "direction alone" in found.notes[-1]
