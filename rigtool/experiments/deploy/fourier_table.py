"""A map of the turn as Fourier coefficients: the orders that exceed the noise.

    map(angle) = sum over orders n of amplitude_n cos(n angle + phase_n)

The noise floor of an order, the rms amplitude that scatter alone gives it, is that of the map's
standard uncertainty u(position) spread evenly over the orders 1..m that the map holds:
floor = sqrt(2/m) * rms of u. Scatter that is not white has more of it at some orders, less at
others.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rigtool.errors import InsufficientDataError
from rigtool.experiments.deploy.position_map import PositionMap
from rigtool.experiments.deploy.quantised_table import Loss, loss
from rigtool.experiments.ripple.orders import SIGNIFICANT_RATIO
from rigtool.numerics.arrays import Array


@dataclass(frozen=True, eq=False)
class FourierSeries:
    """Orders above the noise (k,): amplitude and phase, rad, each with its u.

    `examined` is the highest order examined, `lost` the remainder of the map.
    """

    order: NDArray[np.int64]
    amplitude: Array
    amplitude_u: Array
    phase: Array
    phase_u: Array
    examined: int
    lost: Loss


def fourier_series(turn: PositionMap, band: int | None) -> FourierSeries:
    """Return the orders of a map above the noise, up to order `band`, the highest that passed Q.

    Without `band` it is the highest that the map's positions resolve. Raises
    `InsufficientDataError` where there is none.
    """
    count = turn.values.size
    carried = (count - 1) // 2
    highest = carried if band is None else max(1, min(band, carried))
    order = np.arange(1, highest + 1)
    found = np.fft.rfft(turn.values)[1 : highest + 1] * (2 / count)
    found *= np.exp(-1j * order * turn.start)
    amplitude = np.abs(found)
    rounding = 10 * np.finfo(np.float64).eps * float(np.abs(turn.values).max())
    held = np.flatnonzero(amplitude > rounding)
    highest = int(held[-1]) + 1 if held.size else highest
    floor = max(math.sqrt(2 / highest * float(np.mean(turn.u**2))), rounding)
    clear = amplitude > SIGNIFICANT_RATIO * floor
    if not clear.any():
        raise InsufficientDataError(
            f"none of the orders 1 to {highest} exceeds the noise by a factor of "
            f"{SIGNIFICANT_RATIO:g} (the largest has {amplitude.max():.3g}, the noise floor is "
            f"{floor:.3g}): learn from more revolutions"
        )
    u = np.full(int(clear.sum()), floor / math.sqrt(2))
    kept = found[clear]
    position = turn.start + np.arange(count) * (2 * math.pi / count)
    series = np.cos(np.multiply.outer(position, order[clear]) + np.angle(kept)) @ np.abs(kept)
    return FourierSeries(
        order=order[clear],
        amplitude=np.abs(kept),
        amplitude_u=u,
        phase=np.angle(kept),
        phase_u=u / np.abs(kept),
        examined=highest,
        lost=loss(series - turn.values),
    )
