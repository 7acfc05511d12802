"""Instruments beside the drive: force gauges and thermometers, or an operator who reads one.

A gauge fills one channel (`force` [N], `temperature` [degC] or `deflection` [m]). It reads on its
own line, in its own thread, and is asked afterwards what it read at the times of the samples.
"""

from __future__ import annotations

import math
from typing import Protocol, Self

import numpy as np
from numpy.typing import NDArray

from rigtool.errors import RecipeError
from rigtool.recipe.serial import Instrument
from rigtool.rigs.base import CHANNELS
from rigtool.rigs.bench import Operator

Array = NDArray[np.float64]


class Gauge(Protocol):
    """An instrument that fills one channel; a context manager: open from `with` to its end."""

    def __enter__(self) -> Self:
        """Connect and begin to read. Raises `HardwareError` where nothing sensible answers."""
        ...

    def __exit__(self, *details: object) -> None:
        """Let go of the line."""
        ...

    def begin(self) -> None:
        """A recording is about to begin: here an operator is asked."""
        ...

    def at(self, moments: Array) -> Array:
        """Return readings at these moments of `time.monotonic()`, NaN where there is none near."""
        ...


class OperatorGauge:
    """An instrument that the operator reads once for each recording."""

    def __init__(self, channel: str, settings: Instrument, operator: Operator) -> None:
        self._channel, self._settings, self._operator = channel, settings, operator
        self._value = math.nan

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *details: object) -> None:
        pass

    def begin(self) -> None:
        """Ask for the reading."""
        unit = CHANNELS[self._channel][0]
        reading = self._operator.reading(self._channel, unit)
        self._value = self._settings.scale * reading + self._settings.offset

    def at(self, moments: Array) -> Array:
        """Return what was read, for each moment."""
        return np.full(len(moments), self._value)


def open_gauge(channel: str, settings: Instrument, operator: Operator) -> Gauge:
    """Return the gauge that a recipe names for a channel; not connected yet.

    Raises `RecipeError` for an unknown driver.
    """
    if settings.driver == "operator":
        return OperatorGauge(channel, settings, operator)
    raise RecipeError(
        f"serial.{channel}.driver {settings.driver!r} is not known: use one of operator"
    )
