"""Leaf springs and eccentric pulleys: the thesis's own numbers, and what must hold for any."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import linregress

from rigtool.errors import InsufficientDataError
from rigtool.experiments.suspension.springs import (
    eccentric_torque,
    eigenfrequency,
    spring_curve,
)

E = 60e-6


def largest(speed):
    angle = np.linspace(0, 2 * np.pi, 721)
    return [
        np.abs(torque).max()
        for torque in eccentric_torque(
            angle, eccentricity=E, stiffness=14.5e3, mass=1.025, speed=speed
        )
    ]


def test_torques_are_those_of_appendix_j():
    spring, slow = largest(0.2 * 2 * np.pi)
    assert spring == pytest.approx(26.1e-6, abs=0.05e-6)
    assert slow == pytest.approx(2.9e-9, abs=0.05e-9)
    assert largest(5 * 2 * np.pi)[1] == pytest.approx(1.8e-6, abs=0.05e-6)
    assert eigenfrequency(14.5e3, 1.025) == pytest.approx(18.9, abs=0.05)


@given(st.floats(1e3, 1e5), st.floats(0.1, 10), st.floats(0.01, 1))
def test_at_the_eigenfrequency_spring_and_mass_cancel(stiffness, mass, angle):
    speed = 2 * math.pi * eigenfrequency(stiffness, mass)
    spring, inertia = eccentric_torque(
        angle, eccentricity=E, stiffness=stiffness, mass=mass, speed=speed
    )
    assert spring + inertia == pytest.approx(0, abs=1e-9 * abs(float(spring)))


def test_the_curve_agrees_with_scipy():
    rng = np.random.default_rng(1)
    force = np.linspace(0, 20, 11)
    deflection = force / 14.5e3 + 1e-5 + rng.normal(0, 5e-6, 11)
    found, theirs = spring_curve(force, deflection), linregress(force, deflection)
    assert found.stiffness == pytest.approx(1 / theirs.slope, rel=1e-9)
    assert found.stiffness_u == pytest.approx(theirs.stderr / theirs.slope**2, rel=1e-9)
    assert abs(found.stiffness - 14.5e3) < 3 * found.stiffness_u
    assert found.dof == 9


@pytest.mark.parametrize(
    ("force", "deflection", "message"),
    [
        ([2] * 5, range(5), "different forces"),
        ([0, 1, 2], [0, 1, 2], "too few"),
        (range(5), [0, 1, 0, 1, 0], "pull harder"),
        (range(5), [0, -1, -2, -3, -4], "check the sign"),
    ],
)
def test_readings_that_carry_no_stiffness(force, deflection, message):
    with pytest.raises(InsufficientDataError, match=message):
        spring_curve(force, deflection)


def test_no_frequency_without_a_mass():
    with pytest.raises(ValueError, match="do not oscillate"):
        eigenfrequency(1.0, 0.0)


@given(st.floats(0, 6.3))
def test_it_is_the_second_order_of_the_turn(angle):
    """Derivative of the springs' energy k (e sin angle)^2 / 2, by central differences."""
    near = angle + np.array([-1e-4, 1e-4])
    energy = 14.5e3 * (E * np.sin(near)) ** 2 / 2
    spring, _ = eccentric_torque(angle, eccentricity=E, stiffness=14.5e3, mass=1.0, speed=0.0)
    assert float(spring) == pytest.approx(float(np.diff(energy)[0]) / 2e-4, rel=0, abs=1e-11)


@pytest.mark.parametrize(("ratio", "refused"), [(3.05, False), (2.95, True), (-30.0, True)])
def test_a_spring_shows_where_it_yields_by_three_u(ratio, refused):
    force, scatter = np.array([0.0, 1.0, 2.0, 3.0, 4.0]), np.array([1.0, -1.0, 0.0, -1.0, 1.0])
    left = scatter - np.polyval(np.polyfit(force, scatter, 1), force)
    u = linregress(force, left).stderr
    deflection = ratio * u * force + left
    if refused:
        with pytest.raises(InsufficientDataError, match="at least 3 u are needed"):
            spring_curve(force, deflection)
    else:
        found = spring_curve(force, deflection)
        assert found.stiffness == pytest.approx(1 / (ratio * u), rel=1e-9)
        assert found.stiffness_u == pytest.approx(found.stiffness**2 * u, rel=1e-9)


@pytest.mark.parametrize(("apart", "refused"), [(1e-7, False), (1e-10, True)])
def test_forces_are_different_beyond_their_rounding(apart, refused):
    force = 200.0 * (1 + apart * np.arange(6.0))
    if refused:
        with pytest.raises(InsufficientDataError, match="forces are 200 N"):
            spring_curve(force, force)
    else:
        assert spring_curve(force, force / 1e4).stiffness == pytest.approx(1e4, rel=1e-2)
