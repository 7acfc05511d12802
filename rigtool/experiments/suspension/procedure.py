"""`suspension`: stiffness of the leaf springs, and torque of eccentric pulleys [App. E, J]."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from rigtool.errors import RecipeError
from rigtool.experiments.outcome import Outcome
from rigtool.experiments.procedure import Procedure, channels, only_run, record
from rigtool.experiments.suspension.springs import (
    SpringCurve,
    eccentric_torque,
    eigenfrequency,
    spring_curve,
)
from rigtool.numerics.arrays import Array
from rigtool.quantity import Component, Quantity, combined, error_line
from rigtool.recipe import Recipe
from rigtool.recipe.rig import MotorSuspension
from rigtool.rigs import Load, Rig, Task
from rigtool.rigs.motion import CurrentSteps
from rigtool.runfile import Column, RecordingSpec, Run, RunWriter, Table

Torques = Callable[..., tuple[Array, Array]]
"""`eccentric_torque` of a rig, by angle and `speed`."""

READING_TIME = 0.1
"""Duration of each reading, s."""

RECORD_EVERY = 80

TORQUE_ANGLES = 361
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
    run = only_run(runs, "suspension", "forces")
    springs, pulls = _described(recipe), run.recordings_named("pull_")
    force = np.array([pull.condition("radial_force") for pull in pulls])
    deflection = np.array([pull.read("deflection").mean() for pull in pulls])
    curve = spring_curve(force, deflection)
    speeds = [2 * math.pi * speed for speed in recipe.suspension.speeds_rev_per_s]
    torques = _torques(springs, curve.stiffness)
    return Outcome(
        {
            **_stiffness(springs, curve, recipe.rig.weights_relative_u),
            **_largest(torques, speeds),
        },
        {
            "spring_curve": Table(
                ("force",),
                {
                    "force": Column(force, "N", "on the motor"),
                    "deflection": Column(deflection, "m", "by the micrometer"),
                    "line": Column(curve.deflection, "m", "straight line through all readings"),
                },
                "deflection",
                "Deflection of the leaf springs against force",
            ),
            "eccentric_torque": _torque_table(torques, speeds),
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
            "add one; `rigtool recipe briaire-2006` shows it"
        )
    return recipe.rig.suspension


def _stiffness(
    springs: MotorSuspension, curve: SpringCurve, weights_relative_u: float
) -> dict[str, Quantity]:
    # k = 2 E b t^3 / a^3
    computed = 2 * springs.elasticity * springs.width * springs.thickness**3 / springs.length**3
    elasticity_u = springs.elasticity * springs.elasticity_relative_u
    parts = [
        ("elasticity", springs.elasticity, "Pa", elasticity_u, 1),
        ("width", springs.width, "m", springs.dimension_u, 1),
        ("length", springs.length, "m", springs.dimension_u, -3),
        ("thickness", springs.thickness, "m", springs.thickness_u, 3),
    ]
    dimensions = [
        Component(name, value, unit, u, None, power * computed / value)
        for name, value, unit, u, power in parts
    ]
    measured = curve.stiffness
    stiffness = [
        error_line("scatter about the line", curve.stiffness_u, "N/m", float(curve.dof)),
        Component("weights", 1.0, "1", weights_relative_u, None, measured),
    ]

    def by_stiffness(value: float, unit: str, power: float) -> Quantity:
        """Return what is proportional to a power of the measured stiffness."""
        per_stiffness = power * value / measured
        lines = [replace(x, sensitivity=per_stiffness * x.sensitivity) for x in stiffness]
        return combined(value, unit, lines)

    return {
        "spring_constant": by_stiffness(measured, "N/m", 1.0),
        "spring_constant_computed": combined(computed, "N/m", dimensions),
        "pretension_deflection": by_stiffness(springs.pretension / measured, "m", -1.0),
        "eigenfrequency": by_stiffness(eigenfrequency(measured, springs.mass), "Hz", 0.5),
    }


def _torques(springs: MotorSuspension, stiffness: float) -> Torques:
    eccentricity = springs.motor_eccentricity + springs.tool_eccentricity
    return partial(
        eccentric_torque, eccentricity=eccentricity, stiffness=stiffness, mass=springs.mass
    )


def _largest(torques: Torques, speeds: Sequence[float]) -> dict[str, Quantity]:
    """Return the largest torque of the springs, and of the mass at the lowest and highest speed."""
    reason = "the uncertainty of the eccentricities is not known"

    def largest(which: int, speed: float) -> Quantity:
        torque = torques(np.array([math.pi / 4]), speed=speed)[which]
        return Quantity(float(np.abs(torque[0])), "N m", reason=reason)

    return {
        "eccentric_spring_torque": largest(0, 0.0),
        "eccentric_inertia_torque_slow": largest(1, min(speeds)),
        "eccentric_inertia_torque_fast": largest(1, max(speeds)),
    }


def _torque_table(torques: Torques, speeds: Sequence[float]) -> Table:
    angle = np.linspace(0, 2 * math.pi, TORQUE_ANGLES)
    spring, inertia = zip(*(torques(angle, speed=speed) for speed in speeds), strict=True)
    return Table(
        ("speed", "angle"),
        {
            "speed": Column(speeds, "rad/s", "of the pulleys"),
            "angle": Column(angle, "rad", "of the pulleys"),
            "spring": Column(spring, "N m", "of the leaf springs"),
            "inertia": Column(inertia, "N m", "of the moving mass"),
        },
        "inertia",
        "Torque of eccentric pulleys",
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
        "rig.weights_relative_u",
    ),
)
