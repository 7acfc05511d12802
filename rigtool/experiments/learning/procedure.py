"""`ilc-learn`: learn the repeatable disturbance [7.2.4].

How to learn is the recipe's `ilc_learn.implementation`; each is a module of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from rigtool.errors import UsageError
from rigtool.experiments.between_set_points import unsampled_note
from rigtool.experiments.learning.implementations import a_one_speed as one_speed
from rigtool.experiments.learning.implementations import b_all_speeds as all_speeds
from rigtool.experiments.learning.implementations import c_limited_angle as limited_angle
from rigtool.experiments.learning.implementations import d_known_loads as known_loads
from rigtool.experiments.learning.implementations import standard_trajectory as trajectory
from rigtool.experiments.learning.imported import analyse_imported
from rigtool.experiments.options import CommonOptions
from rigtool.experiments.outcome import Outcome
from rigtool.experiments.procedure import Procedure
from rigtool.experiments.torque_per_ampere import torque_per_ampere
from rigtool.recipe import Recipe
from rigtool.rigs import Rig
from rigtool.runfile import RecordingSpec, Run, RunWriter

COMMAND = "ilc-learn"


def _turning(recipe: Recipe) -> int:
    return recipe.ilc_learn.turning.record_every


IMPLEMENTATIONS = {
    "A": Procedure(
        COMMAND,
        one_speed.recordings,
        one_speed.measure,
        one_speed.analyse,
        bare_motor=True,
        record_every=_turning,
    ),
    "B": Procedure(
        COMMAND,
        all_speeds.recordings,
        all_speeds.measure,
        all_speeds.analyse,
        bare_motor=True,
        record_every=_turning,
    ),
    "C": Procedure(COMMAND, limited_angle.recordings, limited_angle.measure, limited_angle.analyse),
    "D": Procedure(
        COMMAND,
        known_loads.recordings,
        known_loads.measure,
        known_loads.analyse,
        record_every=lambda recipe: recipe.ilc_learn.loads.record_every,
    ),
    "standard": Procedure(COMMAND, trajectory.recordings, trajectory.measure, trajectory.analyse),
}
"""Ways to learn by the thesis's letter; those for the bare motor turn the shaft round and round."""


def asked(options: CommonOptions, name: str | None, *, validate: bool) -> CommonOptions:
    """Return the options with the choices of the command line put above the recipe."""
    if name is not None:
        options = options.with_override(f"ilc_learn.implementation={name}")
        if IMPLEMENTATIONS[name].bare_motor:
            options = options.with_override("rig.attachment=pulley")
    return options.with_override("ilc_learn.validation=true") if validate else options


def _implementation(recipe: Recipe) -> Procedure:
    name = recipe.ilc_learn.implementation
    implementation = IMPLEMENTATIONS[name]
    if implementation.bare_motor and recipe.rig.attachment != "pulley":
        raise UsageError(
            f"implementation {name} turns the shaft round and round, which the "
            f"{recipe.rig.attachment} cannot: take it off, and say --set rig.attachment=pulley"
        )
    return implementation


def rig_needs(recipe: Recipe) -> tuple[str, ...]:
    """Return what a rig has to offer for motions that are only known once something is learned."""
    return ("signal",) if recipe.ilc_learn.implementation == "standard" else ("table",)


def recordings(recipe: Recipe) -> tuple[RecordingSpec, ...]:
    """List what the implementation records."""
    return _implementation(recipe).recordings(recipe)


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
    _implementation(recipe).measure(rig, recipe, recorder, kt=kt, friction=friction, plant=plant)


def analyse(
    runs: Sequence[Run],
    recipe: Recipe,
    *,
    kt: Run,
    friction: Run | None = None,
    plant: Run | None = None,
) -> Outcome:
    """Learn from the stored signals, and say what remained."""
    outcome = _implementation(recipe).analyse(runs, recipe, kt=kt, friction=friction, plant=plant)
    return replace(
        outcome, notes=(*outcome.notes, *unsampled_note(runs, torque_per_ampere(kt).value))
    )


PROCEDURE = Procedure(
    COMMAND,
    recordings,
    measure,
    analyse,
    needed=("kt",),
    analyse_imported=analyse_imported,
    rig_needs=rig_needs,
    record_every=lambda recipe: _implementation(recipe).record_every(recipe),
)
