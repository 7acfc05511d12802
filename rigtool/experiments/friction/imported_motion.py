"""Results of `stribeck` from any motion: inertia and friction in its equation of motion."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from rigtool.experiments.friction.direction_fit import DIRECTION_NAMES
from rigtool.experiments.friction.inverse_dynamics import Dynamics, identify_dynamics
from rigtool.experiments.friction.motion_terms import SmoothedMotion
from rigtool.experiments.friction.offset import undivided
from rigtool.experiments.friction.results import SAME_COULOMB, Findings
from rigtool.numerics.arrays import TINY, Array
from rigtool.quantity import Quantity
from rigtool.runfile import Column, Table

NEGATIVE_INERTIA = -3.0
"""An inertia below this multiple of its uncertainty is negative, which is impossible."""

NOTED_POWER = 0.1
"""Part of the residual's power, as a function of speed or position, that gets a note."""

TABLE_RANGES = 60
"""Number of ranges of speed in the table of the fit."""


def add_dynamics(motions: Sequence[SmoothedMotion], found: Findings) -> None:
    """Fit the equation of motion to all motions and add its parameters.

    Raises `InsufficientDataError` where they do not determine friction.
    """
    dynamics = identify_dynamics(motions)
    dof = float(dynamics.dof)
    add_inertia(dynamics, found)
    found.add("viscous_friction", dynamics.estimate("viscous"), "N m s/rad", dof)
    coulomb, u = dynamics.estimate("coulomb")
    found.add("coulomb_friction", (coulomb, u), "N m", dof)
    offset, offset_u = dynamics.estimate("offset")
    found.add("friction_offset", (offset, offset_u), "N m", dof)
    unknown = undivided((offset, offset_u), max(coulomb, u, TINY)).unknown
    for direction in DIRECTION_NAMES.values():
        found.add(f"coulomb_friction_{direction}", (coulomb, math.hypot(u, unknown)), "N m", dof)
    found.notes.append(SAME_COULOMB)
    if dynamics.by_direction:
        for direction, sign in zip(DIRECTION_NAMES.values(), ("", "-"), strict=True):
            value = dynamics.estimate("viscous", f"{sign}viscous_difference")
            found.add(f"viscous_friction_{direction}", value, "N m s/rad", dof)
        found.notes.append("viscous friction differs by direction: viscous_friction is the mean")
    found.results["residual_rms"] = Quantity(
        dynamics.residual_rms, "N m", reason="a measure of scatter itself"
    )
    found.notes.extend(_notes(dynamics))
    found.tables["dynamics_fit"] = _fit_table(dynamics)


def add_inertia(dynamics: Dynamics, found: Findings) -> None:
    """Add the inertia, or why it is not stated."""
    if dynamics.without_inertia is not None:
        found.notes.append(f"no inertia is stated: {dynamics.without_inertia}")
        return
    inertia, u = dynamics.estimate("inertia")
    if inertia <= NEGATIVE_INERTIA * u:
        found.notes.append(
            f"no inertia is stated: it comes out as {inertia:.3g} (SI), below zero, so a spring "
            "acts as well, which an oscillation at one frequency does not separate from inertia"
        )
        return
    found.add("inertia", (inertia, u), "kg m2", float(dynamics.dof))
    if dynamics.single_frequency:
        found.notes.append(
            "the motion has one frequency: a spring would look like less inertia; move at several "
            "frequencies to separate them"
        )


def _notes(dynamics: Dynamics) -> list[str]:
    motions = dynamics.motions
    cutoffs = [motion.cutoff for motion in motions]
    left_out = sum(motion.left_out for motion in motions)
    total = sum(motion.samples for motion in motions)
    notes = [
        "from the dynamics of the motion, J a + fv v + fc sign(v) + offset, that explain "
        f"{100 * dynamics.explained:.1f} % of its variance up to {min(cutoffs):.3g} Hz or more",
        "the model is that of one axis: torque of other joints of an arm that move is not in u",
        f"{left_out} of {total} samples left out: below {100 * dynamics.standstill:.0f} % of the "
        "highest speed, as the residuals ask for, or at an end; what that changes is part of u",
    ]
    for share, what in (
        (dynamics.by_speed, "speed: friction is not a straight line over speed"),
        (dynamics.by_position, "position: ripple, a spring or a load acts as well"),
    ):
        if share > NOTED_POWER:
            notes.append(
                f"{100 * share:.0f} % of the unexplained power is a function of {what}; its "
                "possible effect on the results is part of their uncertainties"
            )
    if dynamics.is_late:
        delay, u = dynamics.estimate("delay")
        notes.append(
            f"the effort is {delay * 1e3:.3g} ms (u {u * 1e3:.1g} ms) later than the position, as "
            "the residuals show: the fit takes that off"
        )
    if resampled := sum(motion.resampled for motion in motions):
        notes.append(f"{resampled} irregular time axes were resampled at their median rate")
    return notes


def _fit_table(dynamics: Dynamics) -> Table:
    """Return the means of torque and model by range of speed, over all motions."""
    motions = dynamics.motions
    speed = np.concatenate([motion.design[motion.used, 1] for motion in motions])
    torque = np.concatenate([motion.torque[motion.used] for motion in motions])
    model = np.concatenate([dynamics.torque(motion)[motion.used] for motion in motions])
    edges = np.linspace(speed.min(), speed.max(), TABLE_RANGES + 1)
    index = np.clip(np.digitize(speed, edges) - 1, 0, TABLE_RANGES - 1)
    count = np.bincount(index, minlength=TABLE_RANGES)
    there = count > 0

    def mean(values: Array) -> Array:
        return np.bincount(index, values, TABLE_RANGES)[there] / count[there]

    return Table(
        ("speed",),
        {
            "speed": Column(((edges[1:] + edges[:-1]) / 2)[there], "rad/s"),
            "torque": Column(mean(torque), "N m", "mean in this range of speed"),
            "model": Column(mean(model), "N m", "the same of the fitted model"),
        },
        "torque",
        "Torque against speed, inertia included",
    )
