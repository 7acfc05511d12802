"""Loss of the torque constant by a current that lasts, from hypotheses about the staircases.

    loss = mean over hypotheses of g tau (1 - exp(-t/tau)),   t = HEATING_TIME

with g of (1) in `rigtool.experiments.torque_constant.staircase_model`. A staircase shows how much
its own heat takes, and little of a time constant tau beyond its length: the loss by a lasting
current is an extrapolation along tau. Where friction is large, an error of its law passes for
another tau: friction that falls with speed is less in the swings than where the arm rests. What a
hypothesis leaves below `LAW` of friction is no evidence: that squared is added to each Q.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from rigtool.experiments.torque_constant.hypotheses import (
    LONGEST_TIME_CONSTANT,
    SHORTEST_TIME_CONSTANT,
    TIME_CONSTANTS,
    Hypotheses,
)
from rigtool.experiments.torque_constant.staircase_model import Common

TAU_STEP = math.log(LONGEST_TIME_CONSTANT / SHORTEST_TIME_CONSTANT) / (TIME_CONSTANTS - 1)
"""Distance of the values of tau that are tried, logarithm."""

LAW = 2e-3
"""Relative standard uncertainty of friction by its law: swings of 0.04 rad/s lower friction with a
Stribeck velocity of 0.3 rad/s by 0.2 to 0.9 % for a moment."""


def loss_by_heat(hypotheses: Hypotheses) -> tuple[float, float]:
    """Return the relative loss of the constant within `HEATING_TIME`, over the square of the
    current, 1/A2, and its standard uncertainty by what the hypotheses leave open."""
    means, found = hypotheses.means, hypotheses.weighed
    probable = found.probable(means.plateaus * (LAW * means.contacts(found.best).level) ** 2)
    losses = found.slope[:, 2]
    loss = float(probable @ losses)
    spread = math.sqrt(float(probable @ ((losses - loss) ** 2 + found.variance[:, 2])))
    stairs = means.stairs
    length = float(np.mean(stairs.end.max(axis=1) - stairs.begin.min(axis=1)))
    return loss, math.hypot(spread, loss * _untried(found.best, length))


def _untried(best: Common, length: float) -> float:
    """Return the relative standard uncertainty of a loss by heat, as tau is tried in steps.

    The loss is known at the end of a staircase of `length` s, whatever tau is; from there to
    `HEATING_TIME` it grows by tau, which lies anywhere within a step (GUM 4.3.7).
    """
    edges = [
        replace(best, time_constant=best.time_constant * math.exp(side * TAU_STEP / 2))
        for side in (-1, 1)
    ]
    low, high = (math.log(edge.warming() / edge.warming(length)) for edge in edges)
    return abs(high - low) / math.sqrt(12)
