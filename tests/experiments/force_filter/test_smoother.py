"""The backward equations against the joint normal distribution of a linear system."""

import numpy as np

from rigtool.experiments.force_filter.plant import (
    ANGLE,
    MOVING_STATES,
    NOISE,
    STATES,
    TORQUE,
)
from rigtool.experiments.force_filter.smoother import backwards, room

KEPT = 0.9


def linear_system(rng, count, fresh_at):
    """Return transition matrices, process covariances, start, and measurements of the angle."""
    transitions = []
    for k in range(count):
        phi = np.eye(STATES)
        phi[:MOVING_STATES] += 0.2 * rng.standard_normal((MOVING_STATES, STATES))
        phi[NOISE, NOISE] = KEPT
        noise = np.diag(rng.uniform(0.1, 0.5, STATES))
        if k == fresh_at:
            phi[7:10] = 0.0
            noise[7:10] *= 3.0
        transitions.append((phi, noise))
    root = rng.standard_normal((STATES, STATES))
    return transitions, root @ root.T, rng.standard_normal(count)


def test_smoothed_torque_is_the_conditional_mean():
    rng = np.random.default_rng(4)
    count, spread = 12, 0.3
    transitions, start, measured = linear_system(rng, count, fresh_at=5)
    # forwards, keeping what the smoother needs
    mean, covariance = np.zeros(STATES), start.copy()
    steps = room(count)
    derivative, fresh, correction, weight, variance, gain, torque_row, passed_row = steps
    torque, deviation = np.empty(count), np.empty(count)
    for k, (phi, noise) in enumerate(transitions):
        mean, covariance = phi @ mean, phi @ covariance @ phi.T + noise
        s2 = covariance[ANGLE, ANGLE]
        left = spread**2 / (s2 + spread**2)
        column = covariance[:, ANGLE] / s2
        residual = measured[k] - mean[ANGLE]
        derivative[k], fresh[k] = phi[:MOVING_STATES], k == 5
        correction[k], weight[k], variance[k] = (1 - left) * residual / s2, 1 - left, s2
        gain[k] = column
        mean = mean + column * (1 - left) * residual
        covariance = covariance - np.outer(column, column) * s2 * (1 - left)
        torque_row[k] = passed_row[k] = covariance[TORQUE]
        torque[k], deviation[k] = mean[TORQUE], np.sqrt(covariance[TORQUE, TORQUE])
    adjoint, information = np.zeros(STATES), np.zeros((STATES, STATES))
    half = count // 2  # in two pieces, as a long recording is
    late, early = (tuple(a[half:] for a in steps), tuple(a[:half] for a in steps))
    backwards(adjoint, information, KEPT, late, torque[half:], deviation[half:])
    backwards(adjoint, information, KEPT, early, torque[:half], deviation[:half])
    expected, spreads = conditional(transitions, start, measured, spread)
    np.testing.assert_allclose(torque, expected, rtol=1e-8, atol=1e-9)
    np.testing.assert_allclose(deviation, spreads, rtol=1e-8)


def conditional(transitions, start, measured, spread):
    """Return mean and deviation of all torques given all measurements, from one joint normal."""
    count = len(transitions)
    blocks = np.zeros((STATES * count, STATES * (count + 1)))
    before = np.zeros((STATES, STATES * (count + 1)))
    before[:, :STATES] = np.linalg.cholesky(start)
    for k, (phi, noise) in enumerate(transitions):
        before = phi @ before
        before[:, STATES * (k + 1) : STATES * (k + 2)] += np.sqrt(noise)
        blocks[STATES * k : STATES * (k + 1)] = before
    angles, torques = blocks[ANGLE::STATES], blocks[TORQUE::STATES]
    seen = angles @ angles.T + spread**2 * np.eye(count)
    weights = np.linalg.solve(seen, angles @ torques.T).T
    left = torques @ torques.T - weights @ angles @ torques.T
    return weights @ measured, np.sqrt(np.diag(left))
