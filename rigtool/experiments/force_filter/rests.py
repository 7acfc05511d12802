"""Rests that limit what the filter learns of a stroke.

    n_k    steps up to step k in which the encoder stayed within two counts
    limit  n_k > `REST_TIME` / step >= n_(k-1), a rest has lasted, or the other way around, it ends

At both the deviations of a stroke return to their prior.
"""

from __future__ import annotations

import math

from rigtool.experiments.force_filter.plant import Record
from rigtool.numerics.compiled import compiled

REST_TIME = 1.0
"""Time within two counts, s, after which the stroke's deviation returns to its prior, and again as
the rotor leaves them: in a rest the errors of the equations, small but of one sign, pass for a
deviation, which is neither that of the stroke before nor that of the one after."""


@compiled
def rest_steps(span: float) -> float:
    """Return the steps, of `span` s, that `REST_TIME` holds."""
    return math.floor(REST_TIME / span + 1e-6)


@compiled
def limits_rest(s: Record, moved: float, width: float, span: float) -> bool:
    """Count the steps within two counts; return whether a rest has lasted for `REST_TIME`, or one
    that had ends, with this move, rad."""
    before, up, down = max(s.rested_up, s.rested_down), s.rested_up, s.rested_down
    s.rested_up, s.rested_down = 0.0, 0.0
    if abs(moved) < 0.5 * width:
        s.rested_up, s.rested_down = up + 1.0, down + 1.0
    elif abs(moved - width) < 0.5 * width:
        s.rested_down = up + 1.0
    elif abs(moved + width) < 0.5 * width:
        s.rested_up = down + 1.0
    after, limit = max(s.rested_up, s.rested_down), rest_steps(span)
    return before > limit > after or after > limit >= before
