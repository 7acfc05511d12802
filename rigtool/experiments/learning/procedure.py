"""`ilc-learn`: learn the repeatable disturbance [7.2.4].

The recipe's `ilc_learn.implementation` states how; each way is a module of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from importlib import import_module
from typing import TYPE_CHECKING, Any

from rigtool.errors import UsageError
from rigtool.experiments.between_set_points import unsampled_note
from rigtool.experiments.outcome import Outcome
from rigtool.experiments.procedure import Procedure
from rigtool.experiments.running.options import CommonOptions
from rigtool.experiments.torque_per_ampere import constant_result, torque_per_ampere
from rigtool.recipe import Recipe
from rigtool.rigs import Rig
from rigtool.runfile import RecordingSpec, Run, RunWriter

if TYPE_CHECKING:
    from rigtool.experiments.learning.implementations.skeleton import Implementation

IMPLEMENTATIONS = {
    "A": ("a_one_speed", "OneSpeed"),
    "B": ("b_all_speeds", "AllSpeeds"),
    "C": ("c_limited_angle", "LimitedAngle"),
    "D": ("d_known_loads", "KnownLoads"),
    "standard": ("standard_trajectory", "RepeatedMove"),
}
"""Ways to learn that exist, by the thesis's letter: module and class, imported when asked for."""


def implementation_of(name: str) -> type[Implementation[Any]]:
    """Return one of `IMPLEMENTATIONS`."""
    module, kind = IMPLEMENTATIONS[name]
    return getattr(import_module(f"rigtool.experiments.learning.implementations.{module}"), kind)


def asked(options: CommonOptions, name: str | None, *, validate: bool) -> CommonOptions:
    """Return the options with the choices of the command line, which override the recipe."""
    if name is not None:
        options = options.with_override(f"ilc_learn.implementation={name}")
        if name in IMPLEMENTATIONS and implementation_of(name).BARE_MOTOR:
            options = replace(options, overrides=("rig.attachment=pulley", *options.overrides))
    return options.with_override("ilc_learn.validation=true") if validate else options


def _implementation(recipe: Recipe) -> type[Implementation[Any]]:
    name = recipe.ilc_learn.implementation
    implementation = implementation_of(name)
    if implementation.BARE_MOTOR and recipe.rig.attachment != "pulley":
        raise UsageError(
            f"implementation {name} turns the shaft continuously, which the "
            f"{recipe.rig.attachment} cannot: take it off, and add --set rig.attachment=pulley"
        )
    return implementation


def rig_needs(recipe: Recipe) -> tuple[str, ...]:
    """Return the abilities for motions that are only known once a table is learned."""
    return (_implementation(recipe).RIG_NEED,)


def recordings(recipe: Recipe) -> tuple[RecordingSpec, ...]:
    """List the recordings of the implementation."""
    return _implementation(recipe).recordings(recipe)


def measure(rig: Rig, recipe: Recipe, recorder: RunWriter, **inputs: Run) -> None:
    """Learn, and record the remainder with the learned table switched on."""
    _implementation(recipe).measure(rig, recipe, recorder, **inputs)


def analyse(
    runs: Sequence[Run], recipe: Recipe, *, kt: Run, prior: Run | None = None, **inputs: Run
) -> Outcome:
    """Learn from the stored signals, and report the remainder.

    Raises `UsageError` for a `prior`, which imported runs take.
    """
    if prior is not None:
        raise UsageError("--prior: is for imported runs, the bench's own rig is learned anew")
    outcome = _implementation(recipe).analyse(runs, recipe, kt=kt, **inputs)
    constant = torque_per_ampere(kt).value
    return replace(
        outcome,
        results={**outcome.results, **constant_result(constant)},
        notes=(*outcome.notes, *unsampled_note(runs, constant)),
    )


def _analyse_imported(
    room: str,
    runs: Sequence[Run],
    *,
    friction: Run | None = None,
    plant: Run | None = None,
    **inputs: Any,
) -> Outcome:
    """Learn from imported runs; raises `UsageError` for options of the bench's own rig."""
    for name, given in (("friction", friction), ("plant", plant)):
        if given is not None:
            raise UsageError(f"--{name}: is of the bench's own rig, imported runs do without")
    return import_module(f"rigtool.experiments.{room}.imported").analyse_imported(runs, **inputs)


PROCEDURE = Procedure(
    "ilc-learn",
    recordings,
    measure,
    analyse,
    needed=("kt",),
    analyse_imported=partial(_analyse_imported, "learning"),
    rig_needs=rig_needs,
    analysis_settings=(
        "ilc_learn.robustness_hz",
        "ilc_learn.robustness_order",
        "ilc_learn.learning_factor",
        "ilc_learn.learning_filter",
        "ilc_learn.cancel_radius",
    ),
)


def of_stored(name: str | None) -> Procedure:
    """Return the procedure for stored runs of an implementation; None: of that they name.

    Imported runs hold no recipe that names one: D learns from those with known loads. Raises
    `UsageError` for a name that there is not.
    """
    if name is None:
        return PROCEDURE
    if name not in IMPLEMENTATIONS:
        raise UsageError(f"implementation {name}: there are {', '.join(IMPLEMENTATIONS)}")
    procedure = replace(PROCEDURE, analyse=partial(_analyse_named, name))
    if name != "D":
        return procedure
    settings = {"measure_force.lowpass_hz": "bandwidth_hz"}
    loads = partial(_analyse_imported, "imported_load")
    return replace(procedure, analyse_imported=loads, imported_settings=settings)


def _analyse_named(name: str, runs: Sequence[Run], recipe: Recipe, **inputs: Run | None) -> Outcome:
    """Learn as `analyse` from a stored run of one implementation; `UsageError` for any other."""
    if (recorded := recipe.ilc_learn.implementation) != name:
        raise UsageError(
            f"--implementation {name}: {runs[0].path} was recorded with implementation {recorded}, "
            "which moves in another way: leave the option out, or measure again from the recipe"
        )
    return analyse(runs, recipe, **inputs)  # type: ignore[arg-type]
