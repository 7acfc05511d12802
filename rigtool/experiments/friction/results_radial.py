"""What a radial force on the shaft adds to friction: at breakaway, and in motion."""

from __future__ import annotations

import math

import numpy as np

from rigtool.experiments.friction.breakaway import Breakaway
from rigtool.experiments.friction.direction_fit import DIRECTION_NAMES
from rigtool.experiments.friction.holds import SAME_SPEED, Holds
from rigtool.experiments.friction.offset import Offset
from rigtool.experiments.friction.results import SCATTER_LINE, Findings
from rigtool.numerics.arrays import TINY
from rigtool.quantity import combined, error_line, scaled


def add_radial_breakaway(
    unloaded: Breakaway, loaded: Breakaway, found: Findings, weights_u: float = 0.0
) -> None:
    """Add the increase of breakaway torque by a radial force, paired by position [7.1.2.2].

    `weights_u` is the relative standard uncertainty of the force.
    """
    added = np.concatenate(
        [loaded.positive - unloaded.positive, loaded.negative - unloaded.negative]
    )
    added = added[np.isfinite(added)]
    if len(added) < 2:
        found.notes.append(
            "no two positions were measured with and without radial force: nothing to compare"
        )
        return
    value, u = float(added.mean()), float(added.std(ddof=1)) / math.sqrt(len(added))
    lines = [
        error_line(SCATTER_LINE, u, "N m", float(len(added) - 1)),
        error_line("hung weights", value * weights_u, "N m"),
    ]
    found.results["radial_load_breakaway"] = found.scale.quantity(value, "N m", lines)


def add_radial_friction(
    unloaded: Holds,
    loaded: Holds,
    force: float,
    found: Findings,
    weights_u: float = 0.0,
    offset: Offset | None = None,
) -> None:
    """Add the increase of friction in motion by a radial force, N, at speeds held without, too.

    `unloaded` turn evenly; of `loaded`, those that do not are left out. The mean over both
    directions, or one direction's over 1 +- the asymmetry, which `offset` holds. Where contacts are
    soft, the shaft breaks away at less than the friction that it then has, with and without the
    force: breakaway does not show it. `weights_u` is the relative standard uncertainty of the
    force.
    """
    loaded = loaded[loaded.steady]
    nearest = np.argmin(np.abs(unloaded.speed - loaded.speed[:, None]), axis=1)
    same = np.abs(unloaded.speed[nearest] - loaded.speed) < SAME_SPEED * np.abs(loaded.speed)
    if not same.any():
        found.notes.append("no speed was held with and without radial force: nothing to compare")
        return
    before, after = unloaded[nearest[same]], loaded[same]
    sign = np.sign(after.speed)
    directions, index, count = np.unique(sign, return_inverse=True, return_counts=True)
    share = 1 / (len(directions) * count[index])
    asymmetry, asymmetry_u = (0.0, 0.0) if offset is None else offset.asymmetry
    if len(directions) == 1:
        share /= 1 + directions[0] * asymmetry
        if offset is None:
            found.notes.append(
                f"radial_load_friction is that of the {DIRECTION_NAMES[int(directions[0])]} "
                "direction alone: hold more speeds in both"
            )
    else:
        asymmetry_u = 0.0
    grown = sign * (after.torque - before.torque)
    value = float(share @ grown)
    unlike = grown - np.bincount(index, grown)[index] / count[index]
    # Friction that wanders more slowly than a hold makes holds differ by more than their scatter.
    # To and fro at one speed are held one after the other, with nearly the same of it: both are one
    # (C.-E. Sarndal et al., Model Assisted Survey Sampling, 1992, 4.2: clusters).
    alike = np.round(np.log(np.abs(after.speed) / np.abs(after.speed).max()) / SAME_SPEED)
    sums = np.bincount(np.unique(alike, return_inverse=True)[1], share * unlike)
    free = len(sums) - 1
    own = float(share**2 @ (before.u**2 + after.u**2))
    square = float(sums @ sums) * len(sums) / max(free, 1)
    wander = max(square - own, 0.0)
    # The difference of two variances is as uncertain as the larger one: 2 square^2/free.
    wander_dof = free * (wander / max(square, TINY)) ** 2
    lines = [
        error_line(
            "friction from hold to hold",
            math.sqrt(wander),
            "N m",
            wander_dof or None,
        ),
        error_line("hung weights", value * weights_u, "N m"),
        error_line("asymmetry", value * asymmetry_u, "N m"),
    ]
    for name, holds in ((SCATTER_LINE, before), ("scatter with the force", after)):
        parts = [
            error_line(name, u * part, "N m", dof)
            for u, part, dof in zip(
                holds.u.tolist(), share.tolist(), holds.dof.tolist(), strict=True
            )
        ]
        mean = combined(0.0, "N m", parts)
        lines.append(error_line(name, mean.u or 0.0, "N m", mean.dof))
    added = found.scale.quantity(value, "N m", lines)
    found.results["radial_load_friction"] = added
    found.results["radial_friction_coefficient"] = scaled(added, 1 / force, "N m/N")
