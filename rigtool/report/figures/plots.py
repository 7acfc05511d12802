"""The list of figures: one function draws each, from tables of the runs of one command."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from rigtool.report.figures import style
from rigtool.report.units import other_unit
from rigtool.runfile import Run

MAP = "map"
"""What an imported run learns: a map by measured position, without set points."""

DrawFunction = Callable[..., "style.Figure"]

HEADLINE = 100
"""Number of the figure that opens a report; those of the thesis are below it."""

FIRST_OWN_NUMBER = HEADLINE + 1


@dataclass(frozen=True)
class Plot:
    """One figure: its number and title, and the function that draws it.

    The function takes a run of `command` and the `tables` of that run. `implementations` are the
    ways of learning that the figure shows; empty means any. The labels of a figure of `any_unit`
    state the units of its tables.
    """

    number: int
    command: str
    title: str
    tables: tuple[str, ...]
    implementations: tuple[str, ...]
    function: DrawFunction
    any_unit: bool = False

    def fits(self, run: Run) -> bool:
        """Return whether a run is of the command, learned in one of the ways, with the tables.

        Their columns are in the units that the figure's labels state.
        """
        if self.command != run.command or not all(name in run.tables for name in self.tables):
            return False
        if not self.any_unit and other_unit(run, *self.tables) is not None:
            return False
        learned = MAP if run.recipe is None else run.recipe.ilc_learn.implementation
        return not self.implementations or learned in self.implementations

    def draw(self, run: Run) -> style.Figure:
        """Return the figure of a run that `fits`."""
        return self.function(run, *(run.table(name) for name in self.tables))


PLOTS: dict[int, Plot] = {}
"""By number; each module of figures adds its own."""


def plot(
    number: int,
    command: str,
    title: str,
    *tables: str,
    implementations: tuple[str, ...] = (),
    any_unit: bool = False,
) -> Callable[[Any], Any]:
    """Let a function draw the figure of this number."""

    def add(function: DrawFunction) -> DrawFunction:
        PLOTS[number] = Plot(number, command, title, tables, implementations, function, any_unit)
        return function

    return add


def other_unit_drawn(run: Run) -> str | None:
    """Return what is in a unit that keeps a figure of a run from being drawn."""
    plots = [plot for plot in PLOTS.values() if plot.command == run.command and not plot.any_unit]
    names = dict.fromkeys(name for plot in plots for name in plot.tables if name in run.tables)
    return other_unit(run, *names)
