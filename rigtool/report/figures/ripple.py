"""Figures 23-28: torque ripple by rotor position, current and speed [7.1.3]."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import cycle

import numpy as np

from rigtool.report.figures import style
from rigtool.report.figures.axes import COUNTS_LABEL, MILLI, TORQUE_LABEL, Array, counts, thin
from rigtool.report.figures.plots import plot
from rigtool.runfile import Run, Table

MAX_POINTS = 1000
MAX_SPECTRA = 4
"""Most speeds whose spectra are shown."""

BAR_ORDERS = 8
"""Orders whose amplitudes are shown as bars."""


@plot(23, "fft-ripple", "Ripple after power off and on", "power_waveforms")
def draw_power_cycles(run: Run, table: Table) -> style.Figure:
    """Fig. 23: ripple before and after the amplifier was switched off and on."""
    return _by_condition(run, table, (f"start-up {n + 1}" for n in range(table.shape[0])))


@plot(24, "fft-ripple", "Ripple of single revolutions", "revolutions")
def draw_revolutions(run: Run, table: Table) -> style.Figure:
    """Fig. 24: many revolutions in one plot; their spread shows how well the ripple repeats."""
    figure, axes = style.one_panel(COUNTS_LABEL, TORQUE_LABEL)
    position, waves = _waveforms(run, table)
    axes.plot(position, waves.T, color=style.BLUE, linewidth=0.6, alpha=0.6)
    _one_turn(axes, position)
    return figure


@plot(25, "fft-ripple", "Ripple grows with motor current", "torque_waveforms")
def draw_ripple_by_current(run: Run, table: Table) -> style.Figure:
    """Fig. 25: ripple at several constant torques, on one scale."""
    return _by_condition(run, table, (f"at {MILLI * t:.4g} mN m" for t in table["torque"]))


def _by_condition(run: Run, table: Table, labels: Iterable[str]) -> style.Figure:
    figure, axes = style.one_panel(COUNTS_LABEL, TORQUE_LABEL)
    position, waves = _waveforms(run, table)
    for label, wave, dashes in zip(labels, waves, cycle(style.DASHES), strict=False):
        axes.plot(position, wave, linestyle=dashes, label=label)
    style.legend_above(axes, 4)
    _one_turn(axes, position)
    return figure


@plot(
    26,
    "fft-ripple",
    "Ripple changes its shape with motor current",
    "torque_waveforms",
    "torque_spectrum",
)
def draw_shape_by_current(run: Run, table: Table, spectrum: Table) -> style.Figure:
    """Fig. 26: the same, each on its own scale, with its content by order of rotation."""
    torques = table["torque"]
    position, waves = _waveforms(run, table)
    figure = style.empty(0.8 + 1.3 * len(torques))
    grid = figure.subplots(
        len(torques), 2, sharex="col", squeeze=False, gridspec_kw={"width_ratios": (3, 2)}
    )
    for row, torque, wave, amplitude in zip(
        grid, torques, waves, spectrum["amplitude"], strict=True
    ):
        row[0].plot(position, wave, color=style.BLUE)
        row[0].set_title(f"at {MILLI * torque:.4g} mN m", loc="left")
        row[0].set_ylabel(TORQUE_LABEL)
        _one_turn(row[0], position)
        _bars(row[1], spectrum["order"], MILLI * amplitude)
    grid[-1][0].set_xlabel(COUNTS_LABEL)
    grid[-1][1].set_xlabel("order of rotation")
    return figure


@plot(27, "fft-ripple", "Ripple at all motor speeds", "speed_waveforms")
def draw_ripple_by_speed(run: Run, table: Table) -> style.Figure:
    """Fig. 27: ripple at each speed, one above the other on one scale."""
    position, waves = _waveforms(run, table)
    step = 1.1 * float(np.ptp(waves, axis=1).max())
    figure, axes = style.one_panel(COUNTS_LABEL, "motor speed [rad/s]", 5.2)
    levels = step * np.arange(len(waves))
    for level, wave in zip(levels, waves, strict=True):
        axes.plot(position, level + wave, color=style.BLUE)
    axes.set_yticks(levels, [f"{speed:.3g}" for speed in table["speed"]])
    _one_turn(axes, position)
    _scale_bar(axes, step)
    return figure


@plot(28, "fft-ripple", "PSD of the ripple at all motor speeds", "speed_psd")
def draw_psd_by_speed(run: Run, table: Table) -> style.Figure:
    """Fig. 28: power spectral densities of some of these signals, slow to fast.

    Dotted lines mark the first and second order of rotation.
    """
    speeds, frequency = table["speed"], np.asarray(table["frequency"])
    rows = np.unique(np.linspace(0, len(speeds) - 1, MAX_SPECTRA).round().astype(int))
    figure, axes = style.panels(len(rows), "frequency [Hz]", [""] * len(rows), 1 + 1.1 * len(rows))
    middle = axes[(len(rows) - 1) // 2]  # or the gap below it
    middle.set_ylabel("PSD [(mN m)²/Hz]", y=0.5 if len(rows) % 2 else -0.1)
    highest = 3.2 * speeds.max() / (2 * np.pi)
    shown = (frequency > 0) & (frequency <= highest)
    levels = MILLI**2 * table["psd"][:, shown]
    for panel, row in zip(axes, rows, strict=True):
        first = speeds[row] / (2 * np.pi)
        for order in (1, 2):
            label = "first and second order of rotation" if order == 1 else None
            panel.axvline(order * first, color=style.GREY, lw=0.8, linestyle=":", label=label)
        panel.semilogy(frequency[shown], levels[row], color=style.BLUE)
        panel.set_ylim(levels[levels > 0].min() / 2, levels.max() * 3)
        panel.set_title(f"{speeds[row]:.3g} rad/s", loc="right", pad=2)
    axes[-1].set_xlim(0, highest)
    style.legend_above(axes[0])
    return figure


def _waveforms(run: Run, table: Table) -> tuple[Array, Array]:
    """Return positions in counts, and waveforms in mN m less their means."""
    position, waves = thin(MAX_POINTS, counts(run, table), MILLI * table[table.signal])
    return position, waves - waves.mean(axis=-1, keepdims=True)


def _one_turn(axes: style.Axes, position: Array) -> None:
    axes.set_xlim(0, np.ceil(position[-1] / 100) * 100)


def _bars(axes: style.Axes, order: Array, amplitude: Array) -> None:
    shown = (order >= 1) & (order <= BAR_ORDERS)
    axes.bar(order[shown], amplitude[shown], color=style.ORANGE, width=0.6)
    axes.set_xticks(range(1, BAR_ORDERS + 1))
    axes.set_ylabel("ampl. [mN m]")
    axes.grid(visible=False, axis="x")


def _scale_bar(axes: style.Axes, step: float) -> None:
    """Draw a scale bar of torque beside the curves."""
    length = float(f"{step:.1g}")
    right = axes.get_xlim()[1] * 1.015
    axes.plot([right, right], [0, length], color=style.BLACK, linewidth=2, clip_on=False)
    axes.text(right * 1.01, length / 2, f"{length:g} mN m", va="center", rotation=90)
