"""Instruments beside the drive: force gauges and thermometers, or an operator who reads one.

A gauge fills one channel (`force` [N], `temperature` [degC] or `deflection` [m]). It reads on its
own line, in its own thread; its readings at the times of the samples are taken afterwards.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable
from types import ModuleType
from typing import Any, Protocol, Self

import numpy as np

from rigtool.errors import RecipeError
from rigtool.numerics.arrays import Array
from rigtool.recipe.serial import MeasuringInstrument
from rigtool.rigs.operator import Operator
from rigtool.rigs.serial.line import Line
from rigtool.signals import CHANNELS


class Gauge(Protocol):
    """An instrument that fills one channel; a context manager: open from `with` to its end."""

    def __enter__(self) -> Self:
        """Connect and begin to read. Raises `HardwareError` without a valid answer."""
        return self

    def __exit__(self, *details: object) -> None:
        """Release the line."""
        return None

    @property
    def name(self) -> str:
        """The instrument and its port, for the operator."""

    def begin(self, moment: float) -> None:
        """Prepare for a recording that begins at `moment` of the drive's line, s."""

    def at(self, moments: Array) -> Array:
        """Return readings at these moments of the drive's line, s, NaN where there is none near."""

    def problem(self) -> str | None:
        """Return why a run cannot go on with this instrument, None where it can."""
        return None

    def report(self) -> dict[str, Any]:
        """Return facts about the instrument that are stored with a run."""


class OperatorGauge(Gauge):
    """An instrument that the operator reads once for each recording."""

    def __init__(self, channel: str, settings: MeasuringInstrument, operator: Operator) -> None:
        self._channel, self._settings, self._operator = channel, settings, operator
        self._value = math.nan

    @property
    def name(self) -> str:
        """The instrument, for reports."""
        return "by the operator, once a recording"

    def begin(self, moment: float) -> None:
        """Ask for the reading."""
        unit = CHANNELS[self._channel][0]
        reading = self._operator.reading(self._channel, unit)
        self._value = self._settings.scale * reading + self._settings.offset

    def at(self, moments: Array) -> Array:
        """Return the reading at each moment."""
        return np.full(len(moments), self._value)

    def report(self) -> dict[str, Any]:
        """Return driver, scale and offset."""
        settings = self._settings
        return {"driver": "operator", "scale": settings.scale, "offset": settings.offset}


INSTRUMENT_MODULES = {
    "mark10": "rigtool.rigs.serial.instruments.mark10",
    "kern": "rigtool.rigs.serial.instruments.kern",
    "scpi": "rigtool.rigs.serial.instruments.scpi",
    "mecmesin": "rigtool.rigs.serial.instruments.mecmesin",
    "sauter": "rigtool.rigs.serial.instruments.sauter",
    "number-lines": "rigtool.rigs.serial.instruments.number_lines",
}
"""Modules by name: each has BAUD_RATE and `make_reader(line, channel)`, see `readings.Reader`.

`probe(line)` returns the identity of the instrument, None for another device; in this order.
"""

BY_CHARACTER = ("mecmesin", "sauter")
"""Instruments to which each character is a command: a question for another device may set or zero
them. They are probed only by name, and no other device is probed on their port then."""


def instrument_module(name: str) -> ModuleType:
    """Import the module of a kind of instrument."""
    return importlib.import_module(INSTRUMENT_MODULES[name])


def open_gauge(
    channel: str,
    settings: MeasuringInstrument,
    operator: Operator,
    beside: Callable[[], Line | None] = lambda: None,
) -> Gauge:
    """Return the gauge that a recipe names for a channel; not connected yet.

    `beside` returns the line of the drive once that is open: clock and spy file are shared. Raises
    as `require_instrument` does.
    """
    require_instrument(channel, settings)
    if settings.driver == "operator":
        return OperatorGauge(channel, settings, operator)
    from rigtool.rigs.serial.instruments.gauge import LineGauge

    module = instrument_module(settings.driver)
    return LineGauge(
        channel, settings, module.make_reader, baud_rate=module.BAUD_RATE, beside=beside
    )


def require_instrument(channel: str, settings: MeasuringInstrument) -> None:
    """Raise `RecipeError` for an instrument with an unknown driver, or one without a port."""
    if settings.driver == "operator":
        return
    if settings.driver not in INSTRUMENT_MODULES:
        raise RecipeError(
            f"serial.{channel}.driver {settings.driver!r} is not known: use one of operator, "
            f"{', '.join(INSTRUMENT_MODULES)}"
        )
    if not settings.port:
        raise RecipeError(
            f"serial.{channel}.port is missing: a {settings.driver} is on a port of its own"
        )
