"""The backward equations against the joint normal distribution of a linear system."""

import numpy as np

from rigtool.experiments.force_filter.linear import ROW_LENGTH, forwards
from rigtool.experiments.force_filter.plant import ANGLE, FACTOR_COUNT, NOISE, STATES, TORQUE
from rigtool.experiments.force_filter.smoother import room, smooth_steps

KEPT = 0.9
SAMPLES = 2


def linear_system(rng, count, fresh_at):
    """Return factors, transition matrices with process covariances, start, and measured angles."""
    transitions = []
    factors = 0.4 * rng.standard_normal((count * SAMPLES, FACTOR_COUNT))
    factors[:, -1] = 0.0
    for k in range(count):
        rows = np.eye(STATES, ROW_LENGTH).ravel()
        for sample in range(SAMPLES):
            forwards(rows, STATES, factors, k * SAMPLES + sample)
        phi = rows.reshape(STATES, ROW_LENGTH)[:, :STATES].copy()
        phi[NOISE] *= KEPT
        noise = np.diag(rng.uniform(0.1, 0.5, STATES))
        if k == fresh_at:
            phi[7:10] = 0.0
            noise[7:10] *= 3.0
        transitions.append((phi, noise))
    root = rng.standard_normal((STATES, STATES))
    return factors, transitions, root @ root.T, rng.standard_normal(count)


def test_smoothed_torque_is_the_conditional_mean():
    rng = np.random.default_rng(4)
    count, spread = 12, 0.3
    factors, transitions, start, measured = linear_system(rng, count, fresh_at=5)
    # forwards, keeping what the smoother needs
    mean, covariance = np.zeros(STATES), start.copy()
    steps = room(count, SAMPLES)
    kept, fresh, correction, weight, variance, gain, torque_row, passed_row = steps
    kept[:] = factors
    torque, deviation = np.empty(count), np.empty(count)
    for k, (phi, noise) in enumerate(transitions):
        mean, covariance = phi @ mean, phi @ covariance @ phi.T + noise
        s2 = covariance[ANGLE, ANGLE]
        left = spread**2 / (s2 + spread**2)
        column = covariance[:, ANGLE] / s2
        residual = measured[k] - mean[ANGLE]
        fresh[k] = k == 5
        correction[k], weight[k], variance[k] = (1 - left) * residual / s2, 1 - left, s2
        gain[k] = column
        mean = mean + column * (1 - left) * residual
        covariance = covariance - np.outer(column, column) * s2 * (1 - left)
        torque_row[k] = passed_row[k] = covariance[TORQUE]
        torque[k], deviation[k] = mean[TORQUE], np.sqrt(covariance[TORQUE, TORQUE])
    rows, half = np.zeros(STATES * ROW_LENGTH), count // 2  # in two pieces, as a long recording is
    late = (factors[half * SAMPLES :], *(a[half:] for a in steps[1:]))
    early = (factors[: half * SAMPLES], *(a[:half] for a in steps[1:]))
    smooth_steps(rows, KEPT, late, torque[half:], deviation[half:])
    smooth_steps(rows, KEPT, early, torque[:half], deviation[:half])
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
