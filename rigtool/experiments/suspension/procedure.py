"""`suspension`: stiffness of the leaf springs, and torque of eccentric pulleys [App. E, J]."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from rigtool.errors import RecipeError, UsageError
from rigtool.experiments.outcome import Outcome
from rigtool.experiments.procedure import Procedure, channels, record
from rigtool.experiments.suspension.springs import (
    LeafSprings,
    SpringCurve,
    eccentric_torque,
    eigenfrequency,
    spring_curve,
)
from rigtool.quantity import Quantity
from rigtool.recipe import Recipe
from rigtool.recipe.rig import MotorSuspension
from rigtool.rigs import Load, Rig, Task
from rigtool.rigs.motion import CurrentSteps
from rigtool.runfile import Column, RecordingSpec, Run, RunWriter, Table

READING_TIME = 0.1
"""Duration of each reading, s."""

RECORD_EVERY = 80

ANGLES = 361
"""Points over a turn in the table of torques."""


def recordings(recipe: Recipe) -> tuple[RecordingSpec, ...]:
    """One recording for each force."""
    return tuple(
        RecordingSpec(
            f"pull_{number:03d}",
            channels("time", "deflection"),
            {"radial_force": (force, "N")},
            RECORD_EVERY,
        )
        for number, force in enumerate(recipe.suspension.forces)
    )


def measure(rig: Rig, recipe: Recipe, recorder: RunWriter) -> None:
    """Pull at the motor with each force and read the micrometer."""
    _described(recipe)
    for spec in recordings(recipe):
        load = Load(radial_force=spec.conditions["radial_force"][0])
        task = Task(CurrentSteps((0.0,), READING_TIME), load=load, record_every=spec.record_every)
        record(rig, task, recorder, spec.name)


def analyse(runs: Sequence[Run], recipe: Recipe) -> Outcome:
    """Return stiffness by dimensions and by measurement, and the torques by eccentricity.

    Raises `UsageError` for more than one run.
    """
    if len(runs) > 1:
        raise UsageError(f"{len(runs)} run files: suspension takes one, with all its forces")
    springs, pulls = _described(recipe), runs[0].recordings_named("pull_")
    force = np.array([pull.condition("radial_force") for pull in pulls])
    deflection = np.array([pull.read("deflection").mean() for pull in pulls])
    curve = spring_curve(force, deflection)
    speeds = [2 * math.pi * speed for speed in recipe.suspension.speeds_rev_per_s]
    return Outcome(
        {**_stiffness(springs, curve), **_torques(springs, curve, speeds)},
        {
            "spring_curve": Table(
                ("force",),
                {
                    "force": Column(force, "N", "on the motor"),
                    "deflection": Column(deflection, "m", "by the micrometer"),
                    "line": Column(curve.deflection, "m", "straight line through all readings"),
                },
                "deflection",
                "Deflection of the leaf springs against force (Fig. 70)",
            ),
            "eccentric_torque": _torque_table(springs, curve.stiffness, speeds),
        },
        (
            "the torques are those of the eccentricities in the recipe, at the measured stiffness; "
            "the uncertainty of the eccentricities is not known",
        ),
    )


def _described(recipe: Recipe) -> MotorSuspension:
    if recipe.rig.suspension is None:
        raise RecipeError(
            "the recipe has no table [rig.suspension] with the dimensions of the leaf springs: "
            "add one; recipes/briaire-2006.toml shows it"
        )
    return recipe.rig.suspension


def _stiffness(springs: MotorSuspension, curve: SpringCurve) -> dict[str, Quantity]:
    computed = LeafSprings(
        springs.elasticity, springs.length, springs.width, springs.thickness
    ).stiffness
    relative_u = math.hypot(
        springs.elasticity_relative_u,
        springs.dimension_u / springs.width,
        3 * springs.dimension_u / springs.length,
        3 * springs.thickness_u / springs.thickness,
    )
    measured = curve.stiffness
    return {
        "spring_constant": Quantity(measured, "N/m", curve.stiffness_u, float(curve.dof)),
        "spring_constant_computed": Quantity(computed, "N/m", computed * relative_u),
        "pretension_deflection": Quantity(
            springs.pretension / measured,
            "m",
            springs.pretension / measured**2 * curve.stiffness_u,
            float(curve.dof),
        ),
        "eigenfrequency": Quantity(
            eigenfrequency(measured, springs.mass),
            "Hz",
            eigenfrequency(measured, springs.mass) * curve.stiffness_u / measured / 2,
            float(curve.dof),
        ),
    }


def _torques(
    springs: MotorSuspension, curve: SpringCurve, speeds: Sequence[float]
) -> dict[str, Quantity]:
    """Return the largest torque of the springs, and of the mass at the lowest and highest speed."""
    reason = "the uncertainty of the eccentricities is not known"
    eccentricity = springs.motor_eccentricity + springs.tool_eccentricity

    def largest(which: int, speed: float) -> Quantity:
        torques = eccentric_torque(
            np.array([math.pi / 4]),
            eccentricity=eccentricity,
            stiffness=curve.stiffness,
            mass=springs.mass,
            speed=speed,
        )
        return Quantity(float(np.abs(torques[which][0])), "N m", reason=reason)

    return {
        "eccentric_spring_torque": largest(0, 0.0),
        "eccentric_inertia_torque_slow": largest(1, min(speeds)),
        "eccentric_inertia_torque_fast": largest(1, max(speeds)),
    }


def _torque_table(springs: MotorSuspension, stiffness: float, speeds: Sequence[float]) -> Table:
    angle = np.linspace(0, 2 * math.pi, ANGLES)
    eccentricity = springs.motor_eccentricity + springs.tool_eccentricity
    torques = [
        eccentric_torque(
            angle, eccentricity=eccentricity, stiffness=stiffness, mass=springs.mass, speed=speed
        )
        for speed in speeds
    ]
    return Table(
        ("speed", "angle"),
        {
            "speed": Column(np.array(speeds), "rad/s", "of the pulleys"),
            "angle": Column(angle, "rad", "of the pulleys"),
            "spring": Column(np.stack([t[0] for t in torques]), "N m", "of the leaf springs"),
            "inertia": Column(np.stack([t[1] for t in torques]), "N m", "of the moving mass"),
        },
        "inertia",
        "Torque of eccentric pulleys (Fig. 75)",
    )


PROCEDURE = Procedure(
    "suspension",
    recordings,
    measure,
    analyse,
    bare_motor=True,
    analysis_settings=(
        "suspension.speeds_rev_per_s",
        "rig.suspension.elasticity_relative_u",
        "rig.suspension.dimension_u",
        "rig.suspension.thickness_u",
    ),
)
