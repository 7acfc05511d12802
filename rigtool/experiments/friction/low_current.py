"""Is the amplifier linear at the small currents that friction takes [6.2.2, Appendix C]?

measured current = offset + gain * set point + deviation(set point), by least squares through the
means of bins of set point. A healthy amplifier leaves deviations that do not matter beside the
current that friction takes; the IDM640 of Appendix C did not.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rigtool.errors import InsufficientDataError
from rigtool.numerics.checks import require_signals

Array = NDArray[np.float64]

BINS = 60
"""Bins of set point."""

FEWEST = 50
"""Samples that a bin needs."""

LIMIT = 0.04
"""Deviation, rms, relative to the current that friction takes."""


def require_linear_at_low_current(
    *, current_setpoint: ArrayLike, current: ArrayLike, friction_current: float
) -> None:
    """Raise `InsufficientDataError` where the amplifier is not linear at low current.

    `current_setpoint` and `current` (n,) in A from holds, `friction_current` in A.
    """
    setpoint, measured = require_signals(FEWEST, current_setpoint=current_setpoint, current=current)
    low, high = np.percentile(setpoint, [0.5, 99.5])
    number = np.floor((setpoint - low) / max(high - low, 1e-300) * BINS)
    inside = (number >= 0) & (number < BINS)
    index = number[inside].astype(np.int64)
    count = np.bincount(index, minlength=BINS)
    full = count >= FEWEST
    if np.count_nonzero(full) < 5:
        return  # a few set points say nothing about linearity
    level = np.bincount(index, weights=setpoint[inside], minlength=BINS)[full] / count[full]
    mean = np.bincount(index, weights=measured[inside], minlength=BINS)[full] / count[full]
    design = np.column_stack([np.ones(len(level)), level])
    weight = np.sqrt(count[full])
    line = np.linalg.pinv(design * weight[:, None]) @ (mean * weight)
    deviation = mean - design @ line
    rms = float(np.sqrt(np.average(deviation**2, weights=count[full])))
    if rms > LIMIT * friction_current:
        worst = int(np.argmax(np.abs(deviation)))
        raise InsufficientDataError(
            f"the amplifier's current deviates from its set point by {rms * 1e3:.3g} mA rms, worst "
            f"{deviation[worst] * 1e3:.3g} mA at {level[worst] * 1e3:.3g} mA, limit "
            f"{LIMIT * friction_current * 1e3:.3g} mA ({LIMIT:.0%} of the current that "
            "friction takes): it is not linear at low current (thesis Appendix C); use another "
            "amplifier"
        )
