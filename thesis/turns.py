"""Figures 43, 45 and 68, from signals and the calibration: turns, and a faulty amplifier."""

from __future__ import annotations

import numpy as np

from rigtool.report.figures import style
from rigtool.report.figures.axes import COUNTS_LABEL, MILLI, TORQUE_LABEL, Array, fit_height, thin
from rigtool.runfile import Run

MAX_POINTS = 200
"""Points of a curve over one turn, in which Q passes at most twenty orders."""

MIN_HOLD_SAMPLES = 1000
"""A speed with fewer samples is a transition, not a hold."""

BAR_PERCENTILES = (0.5, 99.5)
"""Percentiles of the samples of a hold at the ends of its bar."""


def draw_before_learning(run: Run, kt: Run) -> style.Figure:
    """Fig. 43: twenty turns before learning, and their mean."""
    counts, turns = _turns(run, kt, "learn_000")
    figure = style.empty()
    left, right = figure.subplots(1, 2, sharey=True)
    left.plot(counts, turns.T, color=style.BLUE, linewidth=0.5, alpha=0.5)
    left.set_title(f"{len(turns)} revolutions", loc="left")
    right.plot(counts, turns.mean(axis=0), color=style.BLUE)
    right.set_title(f"mean of the {len(turns)} revolutions", loc="left")
    left.set_ylabel(TORQUE_LABEL)
    for axes in (left, right):
        axes.set_xlabel(COUNTS_LABEL)
        axes.set_xlim(0, counts[-1])
    return figure


def draw_after_learning(run: Run, kt: Run) -> style.Figure:
    """Fig. 45: the disturbance after the first learning run, on the scale of Fig. 43."""
    counts, turns = _turns(run, kt, "iterate_01_000")
    _, before = _turns(run, kt, "learn_000")
    figure, axes = style.one_panel(COUNTS_LABEL, TORQUE_LABEL)
    axes.plot(counts, turns.T, color=style.BLUE, linewidth=0.5, alpha=0.5)
    axes.set_xlim(0, counts[-1])
    fit_height(axes, before)
    return figure


def draw_faulty_amplifier(run: Run, kt: Run) -> style.Figure:
    """Fig. 68: torque against speed with an amplifier that is not linear at low current.

    Constant speeds only: the fault of the amplifier is detected before a sweep.
    """
    from rigtool.experiments.torque_per_ampere import torque_per_ampere

    holds = run.recording("holds")
    speed = np.gradient(holds.read("position_setpoint"), holds.read("time"))
    torque = MILLI * torque_per_ampere(kt).value * holds.read("current_setpoint")
    figure, axes = style.one_panel("motor speed [rad/s]", TORQUE_LABEL)
    rounded = np.round(speed, 3)
    found, often = np.unique(rounded, return_counts=True)
    levels = found[(often > MIN_HOLD_SAMPLES) & (found != 0)]
    parts = [torque[rounded == level] for level in levels]
    mean = np.array([part.mean() for part in parts])
    low, high = np.array([np.percentile(part, BAR_PERCENTILES) for part in parts]).T
    axes.errorbar(
        levels,
        mean,
        yerr=[mean - low, high - mean],
        fmt="o",
        markersize=3,
        capsize=2,
        color=style.BLUE,
        label="mean and 99 % of the samples at each speed",
    )
    style.legend_above(axes)
    return figure


def _turns(run: Run, kt: Run, name: str) -> tuple[Array, Array]:
    """Return quad counts (n,) and the controller's torque by turn, (turns, n), mN m.

    The torque is filtered with Q, as for learning; its mean, which is friction, is subtracted.
    """
    from rigtool.errors import RunFileError
    from rigtool.experiments.learning.implementations.a_one_speed import narrowed
    from rigtool.experiments.learning.implementations.bare_motor import turned
    from rigtool.experiments.learning.procedure_design import design_filters
    from rigtool.experiments.learning.turns import torque_row
    from rigtool.experiments.torque_per_ampere import torque_per_ampere

    if run.recipe is None:
        raise RunFileError(f"{run.path}: holds no recipe, so its turns cannot be cut: learn again")
    recipe, learning = run.recipe, narrowed(design_filters(run.recipe), run.recipe)
    cut = turned(run.recording(name), recipe, torque_per_ampere(kt).value)
    torque = torque_row(cut.turns, cut.speed, learning, recipe.rig.encoder_counts).moves
    places = np.arange(float(recipe.rig.encoder_counts))
    places, torque = thin(MAX_POINTS, places, MILLI * (torque - torque.mean()))
    return places, torque
