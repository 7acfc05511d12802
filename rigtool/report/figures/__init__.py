"""Figures of the thesis, drawn from tables of run files with the same axes and units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

from rigtool.report.figures import (  # noqa: F401  each adds its figures to PLOTS
    force,
    imports,
    instrument,
    learning,
    motor,
    over_time,
    plant,
    ripple,
    style,
    suspension,
    sweep,
)
from rigtool.report.figures.plots import HEADLINE, PLOTS, Plot
from rigtool.report.figures.side_by_side import Drawn, draw_all
from rigtool.report.published import is_of_thesis
from rigtool.runfile import Run
from rigtool.runfile.opened import guard


@dataclass(frozen=True)
class Picture:
    """One figure as bytes; `name` is the stem of its files, `number` that of `PLOTS`."""

    name: str
    number: int
    title: str
    svg: str
    png: bytes


def draw_figures(runs: Sequence[tuple[str, Run]]) -> list[Picture]:
    """Draw every figure whose tables the runs hold, by number; each run has a label."""
    found = [
        (number, plot, label, run)
        for number, plot in sorted(PLOTS.items())
        for label, run in runs
        if plot.fits(run)
    ]
    pictures = []
    with style.styled():
        drawn = draw_all([partial(_drawn, plot, run) for _, plot, _, run in found])
    for (number, plot, label, run), (svg, png) in zip(found, drawn, strict=True):
        figure = f"Fig. {number}. " if number < HEADLINE and is_of_thesis(run.rig) else ""
        title = f"{figure}{plot.title} ({label})"
        pictures.append(Picture(f"figure-{number}-{label}", number, title, svg, png))
    return pictures


def _drawn(plot: Plot, run: Run) -> Drawn:
    with guard(run.path, "a table"):
        return style.render_figure(plot.draw(run))
