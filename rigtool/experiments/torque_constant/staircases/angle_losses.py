"""Loss of the torque constant by heat at each rotor angle, and over all angles.

    torque = k (i - g i heat + b i |i|) + ...,   g = mean over a turn of the g of each angle

Ripple that grows with the current has a b of each angle. Without its column, which would take most
of the slope, part of it passes for heat: g differs from angle to angle. Orders of b that the angles
do not average out stay in the mean of all staircases.
"""

from __future__ import annotations

import math

import numpy as np

from rigtool.experiments.torque_constant.staircases.least_squares import LeastSquares
from rigtool.experiments.torque_constant.staircases.model import Stairs
from rigtool.numerics.angle_effects import fit_angle_effects
from rigtool.numerics.arrays import Array
from rigtool.numerics.residual_covariance import independent_samples, long_run_covariance
from rigtool.numerics.turn_mean import mean_over_turn


def heat_loss(stairs: Stairs, warmed: LeastSquares) -> tuple[float, float, float]:
    """Return g of (1), its standard uncertainty, 1/(A2 s), and degrees of freedom.

    The first columns of `warmed` are those of k and k g of each staircase. The uncertainty is that
    by scatter over the angles, or by lack of fit of the mean staircase, whichever is larger. At a
    single rotor angle it is unknown, and taken as large as the value. No magnet gains by heat:
    where g comes out negative, it is 0, and what it would be is part of its uncertainty.
    """
    mean = mean_over_turn(stairs.rotor_angle, _losses(warmed))
    loss = max(mean.value, 0.0)
    if mean.dof == 0:
        return loss, abs(mean.value), math.inf
    common, used = warmed.residual.mean(axis=0), np.mean(stairs.weight, axis=0) > 0
    independent = independent_samples(common, used, 1)
    covariance, dof = long_run_covariance(warmed.design, common, independent)
    lack = math.sqrt(float(covariance[1, 1])) / abs(float(np.mean(warmed.own[:, 0])))
    u, freedom = (mean.u, mean.dof) if mean.u > lack else (lack, float(dof))
    return loss, math.hypot(u, mean.value - loss), freedom


def hidden_loss(stairs: Stairs, warmed: LeastSquares, sigma: float) -> tuple[float, float]:
    """Return the standard uncertainty of g, of either sign, by what the angles do not show,
    1/(A2 s), and its degrees of freedom.

    Torques scatter by `sigma` N m. Orders of the ripple that the angles hide are as large as those
    that they show: `rigtool.numerics.angle_effects`. What scatter explains is taken off: it is
    stated on its own. At a single rotor angle it is unknown: infinite.
    """
    losses, angle = _losses(warmed), stairs.rotor_angle
    if mean_over_turn(angle, losses).dof == 0:
        return math.inf, math.inf
    u = sigma * np.linalg.norm(warmed.inverse[:, 1], axis=1) / np.abs(warmed.own[:, 0])
    found = fit_angle_effects(np.ones((len(u), 1)), losses, u, angle)
    square = float(found.covariance[0, 0]) - 1 / float(np.sum(u**-2))
    return math.sqrt(max(square, 0.0)), float(found.dof[0])


def _losses(warmed: LeastSquares) -> Array:
    """Return g of each staircase (m,), 1/(A2 s)."""
    return -warmed.own[:, 1] / warmed.own[:, 0]
