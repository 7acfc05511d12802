"""`ilc-learn`: learn the repeatable disturbance [7.2.4].

How to learn is the recipe's `ilc_learn.implementation`; each is a module of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import ModuleType

from rigtool.errors import UsageError
from rigtool.experiments.between_set_points import remark
from rigtool.experiments.learning.implementations import a_one_speed as one_speed
from rigtool.experiments.learning.implementations import b_all_speeds as all_speeds
from rigtool.experiments.learning.implementations import c_limited_angle as limited_angle
from rigtool.experiments.learning.implementations import d_known_loads as known_loads
from rigtool.experiments.learning.implementations import standard_trajectory as trajectory
from rigtool.experiments.learning.imported import analyse_imported as analyse_imported
from rigtool.experiments.options import CommonOptions
from rigtool.experiments.outcome import Outcome
from rigtool.experiments.torque_per_ampere import torque_per_ampere
from rigtool.recipe import Recipe
from rigtool.rigs import Rig
from rigtool.runfile import RecordingSpec, Run, RunWriter

COMMAND = "ilc-learn"

NEEDED = ("kt",)

IMPLEMENTATIONS: dict[str, tuple[str, ModuleType]] = {
    "A": ("turning at one speed, by position, amplitude and phase by speed", one_speed),
    "B": ("turning, both directions, by position and speed", all_speeds),
    "C": ("limited angle, both directions, by position and speed", limited_angle),
    "D": ("as C, and known loads: torque as a third input", known_loads),
    "standard": ("a repeated move, by time", trajectory),
}
"""Ways to learn that exist, by the thesis's letter: what they do, and their module."""

BARE = ("A", "B")
"""Implementations that turn the shaft round and round: no instrument can follow."""


def require_implementation(name: str) -> None:
    """Raise `UsageError` unless learning of this name exists."""
    if name not in IMPLEMENTATIONS:
        known = ", ".join(f"{key} ({what})" for key, (what, _) in IMPLEMENTATIONS.items())
        raise UsageError(f"--implementation {name} does not exist yet; there is {known}")


def asked(options: CommonOptions, name: str | None, *, validate: bool) -> CommonOptions:
    """Return the options with what the command line asks for put above the recipe.

    Raises `UsageError` for learning that does not exist.
    """
    if name is not None:
        require_implementation(name)
        options = options.with_override(f"ilc_learn.implementation={name}")
        if name in BARE:
            options = options.with_override("rig.attachment=pulley")
    return options.with_override("ilc_learn.validation=true") if validate else options


def _module(recipe: Recipe) -> ModuleType:
    name = recipe.ilc_learn.implementation
    require_implementation(name)
    if name in BARE and recipe.rig.attachment != "pulley":
        raise UsageError(
            f"implementation {name} turns the shaft round and round, which the "
            f"{recipe.rig.attachment} cannot: take it off, and say --set rig.attachment=pulley"
        )
    return IMPLEMENTATIONS[name][1]


def rig_needs(recipe: Recipe) -> tuple[str, ...]:
    """Return what a rig has to offer for motions that are only known once something is learned."""
    return ("signal",) if recipe.ilc_learn.implementation == "standard" else ("table",)


def recordings(recipe: Recipe) -> tuple[RecordingSpec, ...]:
    """List what the implementation records."""
    specs: tuple[RecordingSpec, ...] = _module(recipe).recordings(recipe)
    return specs


def measure(
    rig: Rig,
    recipe: Recipe,
    recorder: RunWriter,
    *,
    kt: Run,
    friction: Run | None = None,
    plant: Run | None = None,
) -> None:
    """Learn, and record what remains with what was learned switched on."""
    _module(recipe).measure(rig, recipe, recorder, kt=kt, friction=friction, plant=plant)


def analyse(
    runs: Sequence[Run],
    recipe: Recipe,
    *,
    kt: Run,
    friction: Run | None = None,
    plant: Run | None = None,
) -> Outcome:
    """Learn from the stored signals, and say what remained."""
    outcome: Outcome = _module(recipe).analyse(runs, recipe, kt=kt, friction=friction, plant=plant)
    return replace(outcome, notes=(*outcome.notes, *remark(runs, torque_per_ampere(kt).value)))
