"""Figures of the thesis, drawn from tables of run files with the same axes and units."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from rigtool.report.figures import (  # noqa: F401  each adds its figures to PLOTS
    force,
    headline,
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
from rigtool.report.figures.plots import HEADLINE, PLOTS
from rigtool.report.published import is_of_thesis
from rigtool.runfile.opened import guard

if TYPE_CHECKING:
    from rigtool.runfile import Run


@dataclass(frozen=True)
class Picture:
    """One figure as bytes; `name` is the stem of its files, `number` that of `PLOTS`."""

    name: str
    number: int
    title: str
    svg: str
    png: bytes


def draw_figures(run: Run, label: str) -> Iterator[Picture]:
    """Draw every figure whose tables the run holds; `label` distinguishes this run from others."""
    for number, plot in sorted(PLOTS.items()):
        if plot.fits(run):
            with style.styled(), guard(run.path, f"what figure {number} shows"):
                svg, png = style.render(plot.draw(run))
            figure = f"Fig. {number}. " if number < HEADLINE and is_of_thesis(run.rig) else ""
            title = f"{figure}{plot.title} ({label})"
            yield Picture(f"figure-{number}-{label}", number, title, svg, png)
