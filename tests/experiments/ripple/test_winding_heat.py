"""The torque constant's fall by the winding's heat, against an independent simulation of heat."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from rigtool.experiments.ripple.winding_heat import TurnCurrents, winding_heat

TURN, RUN_UP = 5.0, 6.0
TAU, GAIN = 30.0, 1.5e-3


def held(amperes, noise, rng, *, start=0.0, before=0.0, count=20):
    """Turns that hold a constant torque, and the fall of k at their edges, by an ODE solver."""
    edges = start + RUN_UP + TURN * np.arange(count + 1)
    heat = solve_ivp(
        lambda t, h: ((amperes / (1 - GAIN * h)) ** 2 - h) / TAU,
        (start, edges[-1]),
        [before],
        t_eval=edges,
        rtol=1e-8,
    ).y[0]
    middle = 1 - GAIN * (heat[1:] + heat[:-1]) / 2
    current = amperes / middle + noise * rng.standard_normal(count)
    recorded = (start, float(edges[-1]))
    return turns_of(recorded, edges, current), GAIN * heat


def turns_of(recorded, edges, current, *, steady=True, housing=None, resistance=None):
    alike = np.zeros(edges.size), np.ones(current.size)
    housing, resistance = (
        given if given is not None else usual
        for given, usual in zip((housing, resistance), alike, strict=True)
    )
    return TurnCurrents(recorded, edges, current, steady, housing, resistance)


def test_the_fall_is_found_for_each_recording_with_the_heat_left_by_the_one_before():
    rng, pulls = np.random.default_rng(3), []
    for _ in range(40):
        first, fell = held(3.5, 2e-3, rng)
        hot = fell[-1] / GAIN * np.exp(-2.0 / TAU)
        second, again = held(1.0, 2e-3, rng, start=first.passed[-1] + 2.0, before=hot)
        found = winding_heat([second, first])  # in any order
        assert found[1].u < 0.09 * fell.mean()
        pulls.append((found[1].fall.mean() - fell.mean()) / found[1].u)
        pulls.append((found[0].fall.mean() - again.mean()) / found[0].u)
    assert 0.7 < np.std(pulls) < 1.4
    assert abs(np.mean(pulls)) < 0.5


def test_turns_without_a_constant_torque_show_no_heat():
    edges, current = TURN * np.arange(5), np.array([1.0, 1.1, 1.2, 1.3])
    turns = turns_of((0.0, 20.0), edges, current, steady=False)
    (found,) = winding_heat([turns])
    assert found.u == 0.0
    assert not found.fall.any()


@pytest.mark.parametrize("tau", [22.15, TAU, 39.0])
def test_the_winding_follows_a_housing_that_warms(tau):
    """Winding and housing as two masses, for many time constants of the winding."""
    per_kelvin, resistance, to_housing, to_room = 1.2e-3, 0.8, 0.6, 1.2
    capacities, count, copper = np.array([tau / to_housing, 300.0]), 150, 3.93e-3
    edges = RUN_UP + TURN * np.arange(count + 1)

    def current_at(winding):
        return 3.5 / (1 - per_kelvin * winding)

    def warming(t, degc):
        winding, housing = degc
        power = resistance * (1 + copper * winding) * current_at(winding) ** 2
        flow = (winding - housing) / to_housing
        return np.array([power - flow, flow - housing / to_room]) / capacities

    winding, housing = solve_ivp(warming, (0, edges[-1]), [0, 0], t_eval=edges, rtol=1e-9).y
    rng, middle = np.random.default_rng(5), (housing[1:] + housing[:-1]) / 2
    current = current_at((winding[1:] + winding[:-1]) / 2) + 3e-4 * rng.standard_normal(count)
    fall = np.log1p(-per_kelvin * housing.mean()) - np.log1p(-per_kelvin * housing)
    turns = turns_of((0.0, edges[-1]), edges, current, housing=fall, resistance=1 + copper * middle)
    (found,) = winding_heat([turns])
    behind = np.log1p(-per_kelvin * housing) - np.log1p(-per_kelvin * winding)
    assert found.fall.mean() == pytest.approx(behind.mean(), rel=0.03)
    assert found.u < 0.04 * behind.mean()
    np.testing.assert_allclose(found.fall, behind, atol=0.05 * behind.mean())
