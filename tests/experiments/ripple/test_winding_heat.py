"""The torque constant's fall by the winding's heat, against an independent simulation of heat."""

import numpy as np
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
    return TurnCurrents(recorded, edges, current, steady=True, housing=0.0), GAIN * heat


def test_the_fall_is_found_for_each_recording_with_the_heat_left_by_the_one_before():
    rng, pulls = np.random.default_rng(3), []
    for _ in range(40):
        first, fell = held(3.5, 2e-3, rng)
        hot = fell[-1] / GAIN * np.exp(-2.0 / TAU)
        second, again = held(1.0, 2e-3, rng, start=first.passed[-1] + 2.0, before=hot)
        found = winding_heat([second, first])  # in any order
        assert found[1].u < 0.08 * fell.mean()
        pulls.append((found[1].fall.mean() - fell.mean()) / found[1].u)
        pulls.append((found[0].fall.mean() - again.mean()) / found[0].u)
    assert 0.7 < np.std(pulls) < 1.4
    assert abs(np.mean(pulls)) < 0.5


def test_turns_without_a_constant_torque_show_no_heat():
    edges, current = TURN * np.arange(5), np.array([1.0, 1.1, 1.2, 1.3])
    turns = TurnCurrents((0.0, 20.0), edges, current, steady=False, housing=0.0)
    (found,) = winding_heat([turns])
    assert found.u == 0.0
    assert not found.fall.any()
