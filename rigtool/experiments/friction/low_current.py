"""Linearity of the amplifier at the small currents that friction takes [6.2.2, Appendix C].

measured current = offset + gain * set point + deviation(set point), by least squares through the
means of bins of set point. The deviations of a sound amplifier are small against the current that
friction takes; those of the IDM640 in Appendix C were not.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from rigtool.errors import InsufficientDataError
from rigtool.numerics.checks import require_signals

SETPOINT_BINS = 60
"""Number of bins of set point."""

MIN_SAMPLES_IN_BIN = 50
"""Smallest number of samples in a bin."""

DEVIATION_LIMIT = 0.04
"""Largest rms deviation, relative to the current that friction takes."""

BY_CHANCE = 0.01
"""How seldom noise of the reading alone leaves as large deviations."""

SHAKEN_RATIO = 5.0
"""Set points of this many times the current that friction takes are the loop's answer to the steps
of the encoder, or to noise: a current that lags behind them is no line over them."""


def require_linear_at_low_current(
    *, current_setpoint: ArrayLike, current: ArrayLike, friction_current: float
) -> None:
    """Raise `InsufficientDataError` where the amplifier is not linear at low current.

    `current_setpoint` and `current` (n,) in A from holds, `friction_current` in A.
    """
    from scipy.special import chdtri

    setpoint, measured = require_signals(
        MIN_SAMPLES_IN_BIN, current_setpoint=current_setpoint, current=current
    )
    low, high = np.percentile(setpoint, [0.5, 99.5])
    number = np.floor((setpoint - low) / max(high - low, 1e-300) * SETPOINT_BINS)
    inside = (number >= 0) & (number < SETPOINT_BINS)
    index = number[inside].astype(np.int64)
    count = np.bincount(index, minlength=SETPOINT_BINS)
    full = count >= MIN_SAMPLES_IN_BIN
    if np.count_nonzero(full) < 5:
        return  # too few set points for linearity
    level = (
        np.bincount(index, weights=setpoint[inside], minlength=SETPOINT_BINS)[full] / count[full]
    )
    mean = np.bincount(index, weights=measured[inside], minlength=SETPOINT_BINS)[full] / count[full]
    design = np.column_stack([np.ones(len(level)), level])
    weight = np.sqrt(count[full])
    line = np.linalg.pinv(design * weight[:, None]) @ (mean * weight)
    deviation = mean - design @ line
    # What noise of the reading leaves of the means of n samples each: sigma2/n, a chi-square.
    square = float(np.sum(count[full] * deviation**2))
    noise = np.mean((measured[inside] - line[0] - line[1] * setpoint[inside]) ** 2)
    by_noise = float(noise) * chdtri(len(level) - 2, BY_CHANCE)
    rms = math.sqrt(max(square - by_noise, 0.0) / float(np.sum(count[full])))
    limit = DEVIATION_LIMIT * friction_current
    if (
        rms > limit
        and (shaken := float(np.abs([low, high]).max())) > SHAKEN_RATIO * friction_current
    ):
        raise InsufficientDataError(
            f"the current set point shakes by {shaken * 1e3:.3g} mA, limit "
            f"{SHAKEN_RATIO * friction_current * 1e3:.3g} mA ({SHAKEN_RATIO:g} times what friction "
            "takes), and the current lags behind it: noise, ripple or steps of the encoder in the "
            "loop, or hardly any friction; take an encoder with more counts, or a softer controller"
        )
    if rms > limit:
        worst = int(np.argmax(np.abs(deviation)))
        raise InsufficientDataError(
            f"the amplifier's current deviates from its set point by {rms * 1e3:.3g} mA rms, worst "
            f"{deviation[worst] * 1e3:.3g} mA at {level[worst] * 1e3:.3g} mA, limit "
            f"{limit * 1e3:.3g} mA ({DEVIATION_LIMIT:.0%} of the current that friction takes): it "
            "is not linear at low current; use another amplifier"
        )
