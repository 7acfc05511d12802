"""The amplifier at the small currents that friction takes [6.2.2, Appendix C]: its linearity, and
whether it is the one that was calibrated.

measured current = offset + gain * set point + deviation(set point), by least squares through the
means of bins of set point. Both are means over a time against which the lag of an amplifier is
short: its current does not follow each step of a set point, which shakes differently at each speed.
The deviations of a sound amplifier are small against the current that friction takes; those of the
IDM640 in Appendix C were not.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from rigtool.errors import InsufficientDataError
from rigtool.numerics.arrays import TINY
from rigtool.numerics.checks import require_signals
from rigtool.quantity import Quantity

SETPOINT_BINS = 60
"""Number of bins of set point."""

MEAN_TIME = 0.02
"""Time over which currents are averaged, s: some ten lags of a current loop of 100 Hz."""

MIN_MEANS_IN_BIN = 10
"""Smallest number of these means in a bin."""

DEVIATION_LIMIT = 0.04
"""Largest rms deviation, relative to the current that friction takes."""

BY_CHANCE = 0.01
"""How seldom noise of the reading alone leaves as large deviations."""

GAIN_PARTS = 64
"""Parts of the holds whose mean currents show the gain: their scatter is its uncertainty."""

GAIN_LIMIT = 4.0
"""Multiple of the uncertainties of both gains by which they may differ."""


def require_calibrated_gain(
    *,
    current_setpoint: ArrayLike,
    current: ArrayLike,
    calibrated: Quantity,
    deviation: float,
    allowed: float,
) -> None:
    """Raise `InsufficientDataError` where the gain of the amplifier is not the calibrated one.

    `current_setpoint` and `current` (n,) in A from holds in both directions; `deviation`, A, is how
    far the `calibrated` amplifier was off its straight line. A relative change by `allowed` passes,
    and what scatter of both gains and that deviation may make.
    """
    asked, shown = (
        np.array([part.mean() for part in np.array_split(np.asarray(signal), GAIN_PARTS)])
        for signal in (current_setpoint, current)
    )
    away = asked - asked.mean()
    power = float(away @ away)
    if not power > 0:
        return
    gain = float(away @ shown) / power
    left = shown - shown.mean() - gain * away
    square = float(left @ left) / (GAIN_PARTS - 2) / power
    bent = deviation / math.sqrt(power / GAIN_PARTS)
    limit = GAIN_LIMIT * math.sqrt(square + (calibrated.u or 0.0) ** 2 + bent**2)
    limit += allowed * abs(calibrated.value)
    if abs(gain - calibrated.value) > limit:
        raise InsufficientDataError(
            f"the current changes by {gain:.4g} of its set point, but by {calibrated.value:.4g} in "
            f"the calibration, limit {limit:.2g} apart: the amplifier, or what reads its current, "
            "is not the one that was calibrated, and set points no longer show the torque; run "
            "calibrate-kt again"
        )


def deviation_at_low_current(
    *,
    current_setpoint: ArrayLike,
    current: ArrayLike,
    sample_time: float,
    friction_current: float,
) -> float:
    """Return how far the current is off its line beyond noise of the reading, rms A.

    `current_setpoint` and `current` (n,) in A from holds, `sample_time` s apart;
    `friction_current` in A. Zero for too few set points. Raises `InsufficientDataError` where the
    amplifier is not linear at low current.
    """
    from scipy.special import chdtri

    every = max(1, round(MEAN_TIME / sample_time))
    setpoint, measured = (
        signal[: len(signal) // every * every].reshape(-1, every).mean(axis=1)
        for signal in require_signals(every, current_setpoint=current_setpoint, current=current)
    )
    low, high = np.percentile(setpoint, [0.5, 99.5])
    number = np.floor((setpoint - low) / max(high - low, TINY) * SETPOINT_BINS)
    inside = (number >= 0) & (number < SETPOINT_BINS)
    setpoint, measured, index = setpoint[inside], measured[inside], number[inside].astype(np.int64)
    count = np.bincount(index, minlength=SETPOINT_BINS)
    full = count >= MIN_MEANS_IN_BIN
    if np.count_nonzero(full) < 5:
        return 0.0
    level, mean = (
        np.bincount(index, weights=signal, minlength=SETPOINT_BINS)[full] / count[full]
        for signal in (setpoint, measured)
    )
    design = np.column_stack([np.ones(len(level)), level])
    weight = np.sqrt(count[full])
    line = np.linalg.pinv(design * weight[:, None]) @ (mean * weight)
    deviation = mean - design @ line
    # What noise of the reading leaves of the means of n values each: sigma2/n, a chi-square.
    square = float(np.sum(count[full] * deviation**2))
    noise = np.mean((measured - line[0] - line[1] * setpoint) ** 2)
    by_noise = float(noise) * chdtri(len(level) - 2, BY_CHANCE)
    rms = math.sqrt(max(square - by_noise, 0.0) / float(np.sum(count[full])))
    limit = DEVIATION_LIMIT * friction_current
    if rms > limit:
        worst = int(np.argmax(np.abs(deviation)))
        raise InsufficientDataError(
            f"the amplifier's current deviates from its set point by {rms * 1e3:.3g} mA rms, worst "
            f"{deviation[worst] * 1e3:.3g} mA at {level[worst] * 1e3:.3g} mA, limit "
            f"{limit * 1e3:.3g} mA ({100 * DEVIATION_LIMIT:.0f} % of the current that friction "
            "takes): it is not linear at low current; use another amplifier"
        )
    return rms
