"""Learning in several runs: their recordings, the table `iterations`, the rest [Fig. 44]."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from rigtool.experiments.learning.convergence import LearningRun, carried_noise
from rigtool.recipe import Recipe
from rigtool.runfile import Column, Recording, Run, Table, dof_column

DEFAULT_RUNS = {"A": 10, "standard": 10}
"""Learning runs [Fig. 44]; the other implementations make one at each speed."""


def runs_at_most(recipe: Recipe) -> int:
    """Return how many learning runs may be made."""
    settings = recipe.ilc_learn
    return settings.iterations or DEFAULT_RUNS.get(settings.implementation, 1)


def kind_of(updates: int) -> str:
    """Return the kind of the recordings of a learning run after this number of updates."""
    return "learn" if updates == 0 else f"iterate_{updates:02d}"


def recorded_runs(run: Run, recipe: Recipe) -> list[list[Recording]]:
    """Return the recordings of each learning run that was made."""
    kinds = map(kind_of, range(1, runs_at_most(recipe)))
    later = (run.recordings_named(f"{kind}_") for kind in kinds)
    return [run.recordings_of(kind_of(0)), *(recordings for recordings in later if recordings)]


def last_update(history: Sequence[LearningRun], factor: float) -> tuple[int, float]:
    """Return the run of the last update, and the variance of the torque relative to that update.

    A run that found nothing left to learn makes no update; `factor` is p.
    """
    last = len(history) - 1
    if last > 0 and history[last].finished:
        last -= 1
    return last, carried_noise(last + 1, factor) / factor**2


def iterations_table(history: Sequence[LearningRun], unit: str, what: str) -> Table:
    """Return amplitude against iteration; `what` names the signal."""

    def column(read: Callable[[LearningRun], float], text: str, of: str = unit) -> Column:
        return Column([read(run) for run in history], of, text)

    return Table(
        ("iteration",),
        {
            "iteration": Column(np.arange(float(len(history))), "1", "updates made before"),
            "rms": column(lambda run: run.rms, "of the repeatable part"),
            "rms_u": column(lambda run: run.rms_u, "standard uncertainty"),
            "peak": column(lambda run: run.peak, "of the repeatable part"),
            "peak_u": column(lambda run: run.peak_u, "standard uncertainty"),
            "dof": dof_column([run.dof for run in history]),
            "non_repeatable_rms": column(
                lambda run: run.scatter, "scatter of a single cycle: no learning can remove it"
            ),
            "ratio": column(
                lambda run: run.ratio,
                "power that another update would change over that explained by noise",
                "1",
            ),
            "limit": column(
                lambda run: run.limit, "ratio that chance exceeds once in a hundred times", "1"
            ),
        },
        "rms",
        f"{what} run by run, within the band of Q",
    )


def iterations_notes(history: Sequence[LearningRun], unit: str, most: int) -> tuple[str, ...]:
    """State why learning ended, and the remainder; `unit` is a thousandth of the signal's."""
    learned = len(history) > 1 and history[-1].finished
    rest = f"{history[-1].scatter * 1e3:.3g} {unit} rms in a single cycle"
    if history[0].finished:
        return (f"nothing repeats above chance: all there is, {rest}, cannot be learned",)
    if learned:
        return (
            f"learning ended after {len(history) - 1} updates: another one would change no more "
            f"than noise does; the remainder, {rest}, does not repeat",
        )
    if most == 1:
        return ()
    return (
        f"after {len(history) - 1} of at most {most} learning runs another update would still "
        f"change {history[-1].ratio:.3g} times what noise explains; the non-repeatable part is "
        f"{rest}",
    )
