"""A load on a spring: at rest, at a small swing, and against scipy's integration."""

import math

import numpy as np
import pytest
from scipy import constants
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from rigtool.experiments.load_disturbance.tendon import (
    CONTACT_ANGLE,
    Tendon,
    contact,
    swing,
)

ARM = 0.02


@pytest.mark.parametrize("stiffness", [0.1, 0.2, 1.0])
def test_a_slow_motion_carries_what_statics_say(stiffness):
    angle = np.pi / 2 + 0.6 * np.sin(2 * np.pi * np.arange(512) / 512)
    torque, grasper = swing(angle, 60.0, Tendon(stiffness, 2e-3, 0.0), 0.05, ARM)
    expected = [
        brentq(lambda s, b=b: s - 0.05 * math.sin(b - s / stiffness), 0, 0.1) for b in angle
    ]
    np.testing.assert_allclose(torque, expected, atol=2e-4 * 0.05)
    np.testing.assert_allclose(grasper, angle - np.array(expected) / stiffness, atol=1e-3)


def test_a_fast_motion_is_what_scipy_integrates():
    period, moment, tendon = 0.6, 0.04, Tendon(0.2, 1e-3, 0.0)
    count, inertia = 512, 0.04 * ARM / constants.g
    time = np.arange(count) * period / count
    turn = 2 * np.pi / period

    def motor(t):
        return np.pi / 2 + 1.2 * np.sin(turn * t), 1.2 * turn * np.cos(turn * t)

    def slope(t, state):
        b, speed = motor(t)
        carried = tendon.stiffness * (b - state[0]) + tendon.damping * (speed - state[1])
        return [state[1], (carried - moment * math.sin(state[0])) / inertia]

    last = 8 * period
    solved = solve_ivp(
        slope, (0, last), [1.5, 0], t_eval=last - period + time, rtol=1e-8, atol=1e-10
    )
    torque, grasper = swing(motor(time)[0], period, tendon, moment, ARM)
    np.testing.assert_allclose(grasper, solved.y[0], atol=0.03)
    b, speed = motor(time)
    carried = tendon.stiffness * (b - solved.y[0]) + tendon.damping * (speed - solved.y[1])
    assert np.std(torque - carried) < 0.02 * np.std(carried)


def test_friction_of_the_joint_adds_while_rising_and_takes_off_while_falling():
    angle = np.pi / 2 + 0.6 * np.sin(2 * np.pi * np.arange(512) / 512)
    free, _ = swing(angle, 20.0, Tendon(50.0, 0.05, 0.0), 0.05, ARM)
    held, _ = swing(angle, 20.0, Tendon(50.0, 0.05, 1e-3), 0.05, ARM)
    difference = held - free
    assert np.median(difference[:100]) == pytest.approx(1e-3, rel=0.02)
    assert np.median(difference[160:350]) == pytest.approx(-1e-3, rel=0.02)


def test_without_a_load_the_grasper_follows_at_once():
    angle = np.sin(2 * np.pi * np.arange(256) / 256)
    torque, grasper = swing(angle, 1.0, Tendon(0.2, 1e-4, 0.0), 0.0, ARM)
    np.testing.assert_allclose(grasper, angle, atol=5e-3)
    assert np.abs(torque).max() < 1e-3


def test_contact_turns_round_over_its_angle():
    count = 4096
    speed = np.where(np.arange(count) < count / 2, 1.0, -1.0)
    direction = contact(speed, 2.0)
    assert direction[count // 4] == pytest.approx(1, rel=1e-9)
    assert direction[-1] == pytest.approx(-1, rel=1e-9)
    way = np.argmax(direction[count // 2 :] < 0) * 2.0 / count
    assert 0.3 * CONTACT_ANGLE < way < CONTACT_ANGLE
