"""Results of the springs, beside differences of their formulas."""

import math

import numpy as np
import pytest

from rigtool.experiments.suspension import procedure
from rigtool.experiments.suspension.springs import SpringCurve
from rigtool.recipe import load_recipe
from tests.experiments.virtual_runs import RECIPE

SPRINGS = load_recipe(RECIPE, ())[0].rig.suspension
CURVE = SpringCurve(15e3, 120.0, np.zeros(6), 4)
SUM = SPRINGS.motor_eccentricity + SPRINGS.tool_eccentricity


def test_the_computed_stiffness_has_the_u_of_each_dimension():
    def computed(springs=SPRINGS):
        return procedure._stiffness(springs, CURVE, 0.0)["spring_constant_computed"]

    us = {
        "elasticity": SPRINGS.elasticity * SPRINGS.elasticity_relative_u,
        "length": SPRINGS.dimension_u,
        "width": SPRINGS.dimension_u,
        "thickness": SPRINGS.thickness_u,
    }
    for line in computed().budget:
        value, step = getattr(SPRINGS, line.name), 1e-6 * getattr(SPRINGS, line.name)
        up, down = (
            computed(SPRINGS.model_copy(update={line.name: value + way * step})).value
            for way in (1, -1)
        )
        slope = (up - down) / (2 * step)
        assert line.sensitivity == pytest.approx(slope, rel=1e-5)
        assert line.u == pytest.approx(us[line.name], rel=1e-9)
    assert len(computed().budget) == sum(u > 0 for u in us.values())


def test_what_follows_from_the_measured_stiffness_scales_with_its_u():
    results = procedure._stiffness(SPRINGS, CURVE, 0.01)
    relative = math.hypot(120.0 / 15e3, 0.01)
    frequency = math.sqrt(15e3 / SPRINGS.mass) / (2 * math.pi)
    for name, value, power in (
        ("spring_constant", 15e3, 1.0),
        ("pretension_deflection", SPRINGS.pretension / 15e3, 1.0),
        ("eigenfrequency", frequency, 0.5),
    ):
        assert results[name].value == pytest.approx(value, rel=1e-12)
        assert results[name].u == pytest.approx(power * relative * value, rel=1e-9)
        assert results[name].budget[0].dof == 4


def test_torques_over_a_turn_are_slopes_of_energies():
    """Of springs that are bent by e sin(theta), and of a mass that moves by e omega cos(theta)."""
    speeds = [3.0, 20.0]
    table = procedure._torque_table(procedure._torques(SPRINGS, CURVE.stiffness), speeds)
    angle = table["angle"]
    assert (angle[0], angle[-1]) == (0.0, pytest.approx(2 * math.pi))
    spring = CURVE.stiffness * (SUM * np.sin(angle)) ** 2 / 2
    for row, speed in enumerate(speeds):
        mass = SPRINGS.mass * (SUM * speed * np.cos(angle)) ** 2 / 2
        for name, energy in (("spring", spring), ("inertia", mass)):
            slope = np.gradient(energy, angle)[1:-1]
            error = table[name][row][1:-1] - slope
            assert np.abs(error).max() < 1e-3 * np.abs(slope).max()
    results = procedure._largest(procedure._torques(SPRINGS, CURVE.stiffness), speeds)
    largest = np.abs(table["spring"]).max(axis=1), np.abs(table["inertia"]).max(axis=1)
    assert results["eccentric_spring_torque"].value == pytest.approx(largest[0][0], rel=1e-3)
    assert results["eccentric_inertia_torque_slow"].value == pytest.approx(largest[1][0], rel=1e-3)
    assert results["eccentric_inertia_torque_fast"].value == pytest.approx(largest[1][1], rel=1e-3)
