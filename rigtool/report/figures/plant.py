"""Figures 35, 39 to 41, 76: plant, position loop, learning filter, convergence."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rigtool.numerics.arrays import Array
from rigtool.report.figures import style
from rigtool.report.figures.plots import plot
from rigtool.runfile import Run, Table

FREQUENCY_LABEL = "frequency [Hz]"
MAGNITUDE_LABEL = "magnitude [dB]"
PHASE_LABEL = "phase [deg]"
PLANT_HEIGHT = 4.6


@plot(
    35,
    "identify-plant",
    "Frequency response of the plant, and its mass line",
    "frequency_response",
    "fit",
)
def draw_measured_plant(run: Run, measured: Table, fit: Table) -> style.Figure:
    """Fig. 35: measured response of the plant with its uncertainty, and the mass line."""
    figure, magnitude, phase = _bode()
    _measured(measured, magnitude, phase)
    line = _within(measured, fit)
    crossing = run.result("mass_line_crossing").value
    magnitude.plot(
        line["frequency"],
        decibel(line["mass_line"]),
        color=style.GREY,
        ls="--",
        label=f"mass line, 0 dB at {crossing:.3g} Hz",
    )
    style.legend_above(magnitude, 2)
    return figure


@plot(
    39,
    "identify-plant",
    "Fitted and measured frequency response of the plant",
    "frequency_response",
    "fit",
)
def draw_fitted_plant(run: Run, measured: Table, fit: Table) -> style.Figure:
    """Fig. 39: simulated (the fit) and measured response of the plant."""
    figure, magnitude, phase = _bode()
    _measured(measured, magnitude, phase)
    line = _within(measured, fit)
    magnitude.plot(line["frequency"], decibel(line["magnitude"]), color=style.ORANGE, label="fit")
    phase.plot(line["frequency"], degrees(line["phase"]), color=style.ORANGE)
    style.legend_above(magnitude, 2)
    return figure


@plot(
    76,
    "identify-plant",
    "Open loop and sensitivities with the measured plant",
    "frequency_response",
    "sensitivities",
)
def draw_open_loop(run: Run, measured: Table, sensitivities: Table) -> style.Figure:
    """Fig. 76: the open loop and its sensitivities."""
    figure, magnitude, phase = _bode()
    table = _within(measured, sensitivities)
    frequency = table["frequency"]
    names = {"open_loop": "open loop", "t": "T", "s": "S"}
    for (name, label), dashes in zip(names.items(), style.DASHES, strict=False):
        magnitude.plot(frequency, decibel(table[f"{name}_magnitude"]), ls=dashes, label=label)
        phase.plot(frequency, degrees(table[f"{name}_phase"]), ls=dashes)
    style.legend_above(magnitude, 3)
    return figure


@plot(40, "ilc-learn", "Complementary sensitivity T and learning filter L, its inverse", "transfer")
def draw_learning_filter(run: Run, whole: Table) -> style.Figure:
    """Fig. 40, right: T and the learning filter L, with and without its phase advance."""
    figure, magnitude, phase = _bode()
    # Close to half the sampling rate T vanishes.
    table = _positive(whole, 0.25 * float(whole["frequency"][-1]))
    frequency = table["frequency"]
    magnitude.plot(frequency, decibel(table["t_magnitude"]), color=style.BLUE, label="T")
    magnitude.plot(frequency, decibel(table["l_magnitude"]), color=style.ORANGE, ls="--", label="L")
    phase.plot(frequency, degrees(table["t_phase"]), color=style.BLUE)
    advanced = "L with its phase advance"
    shifted = degrees(table["l_shifted_phase"])
    phase.plot(frequency, shifted, color=style.ORANGE, ls="--", label=advanced)
    phase.plot(
        frequency, degrees(table["l_phase"]), color=style.ORANGE, ls=":", label="L without it"
    )
    style.legend_above(magnitude, 2)
    style.legend_above(phase, 2)
    return figure


@plot(41, "ilc-learn", "Convergence criterion", "convergence")
def draw_convergence(run: Run, whole: Table) -> style.Figure:
    """Fig. 41: the convergence criterion; dashed: its bound over the plant's uncertainty."""
    figure, axes = style.one_panel(FREQUENCY_LABEL, "|Q (1 − p L T)| [dB]")
    table = _positive(whole)
    frequency = table["frequency"]
    axes.plot(frequency, decibel(table["magnitude"]), label="criterion")
    if "bound" in table.columns and np.isfinite(table["bound"]).any():
        axes.plot(
            frequency,
            decibel(table["bound"]),
            color=style.ORANGE,
            ls="--",
            label="over the plant's uncertainty",
        )
    axes.axhline(0, color=style.GREY, lw=0.8, label="limit")
    axes.set_xscale("log")
    peak = float(np.nanmax(decibel(table["magnitude"])))
    axes.set_ylim(min(peak, 0.0) - 80, 5)
    style.legend_above(axes, 3)
    return figure


def decibel(values: NDArray[Any]) -> Array:
    """Return magnitudes in dB, NaN where they are zero or NaN."""
    magnitude = np.where(np.asarray(values) > 0, values, np.nan)
    return np.asarray(20 * np.log10(magnitude), dtype=np.float64)


def degrees(phase: NDArray[Any]) -> Array:
    """Return an unwrapped phase in degrees, shifted to begin between -270 and 90."""
    first = 2 * np.pi * np.ceil(phase[0] / (2 * np.pi) - 0.25)
    return np.asarray(np.degrees(phase - first), dtype=np.float64)


def _bode() -> tuple[style.Figure, style.Axes, style.Axes]:
    figure, (magnitude, phase) = style.panels(
        2, FREQUENCY_LABEL, [MAGNITUDE_LABEL, PHASE_LABEL], PLANT_HEIGHT
    )
    magnitude.set_xscale("log")
    return figure, magnitude, phase


def _measured(table: Table, magnitude: style.Axes, phase: style.Axes) -> None:
    """Draw a measured response, in grey where a line was not used."""
    frequency, value, radius = (table[name] for name in ("frequency", "magnitude", "radius"))
    used = table["used"] == 1
    turns = degrees(table["phase"])
    low = np.maximum(value - radius, 1e-3 * value)
    magnitude.fill_between(
        frequency, decibel(low), decibel(value + radius), color=style.SKY, alpha=0.4, lw=0
    )
    around = np.degrees(np.arcsin(np.minimum(radius / value, 1)))
    phase.fill_between(frequency, turns - around, turns + around, color=style.SKY, alpha=0.4, lw=0)
    for lines, colour, label in ((used, style.BLUE, "measured"), (~used, style.GREY, "not used")):
        if lines.any():
            magnitude.plot(frequency[lines], decibel(value[lines]), ".", color=colour, label=label)
            phase.plot(frequency[lines], turns[lines], ".", color=colour)


def _within(measured: Table, table: Table) -> Table:
    """Return the lines of a table near the measured frequencies."""
    low, high = measured["frequency"][[0, -1]]
    return _between(table, low / 2, 2 * high)


def _positive(table: Table, highest: float = np.inf) -> Table:
    """Return the lines of a table without frequency zero, up to a highest one."""
    return _between(table, np.nextafter(0, 1), highest)


def _between(table: Table, low: float, high: float) -> Table:
    keep = (table["frequency"] >= low) & (table["frequency"] <= high)
    columns = {name: replace(own, values=own.values[keep]) for name, own in table.columns.items()}
    return replace(table, columns=columns)
