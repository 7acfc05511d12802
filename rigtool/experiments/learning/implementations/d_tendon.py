"""The tendon's parameters as results of implementation D, with what the bench may have wrong."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from rigtool.experiments.force_model import stored
from rigtool.experiments.force_model.deviations import (
    MAX_SCATTER_RATIO,
    MIN_STROKE_ROWS,
    ROWS_APART,
    UNSEEN_PART,
    scatter_hz,
)
from rigtool.experiments.force_model.learning import LearnedModel, SlidingFit
from rigtool.experiments.force_model.model import INERTIA_SPREAD, Kind
from rigtool.experiments.force_model.procedure_learning import LearnedForce
from rigtool.experiments.force_model.records import ROWS_HZ, Record
from rigtool.experiments.force_model.sliding_problem import SLIDING_PARAMETERS
from rigtool.experiments.learning.implementations.d_saturated import driven, swing_hz, yielding_hz
from rigtool.experiments.load_disturbance.reading import LoadedPair
from rigtool.experiments.load_disturbance.results_known_loads import ANGLE_RATIO, LOAD_ARM, WEIGHTS
from rigtool.numerics.arrays import Array
from rigtool.quantity import Component, Quantity, combined, error_line
from rigtool.recipe import Recipe
from rigtool.recipe.rig import RigDescription

TENDON = {
    "stiffness": "tendon_stiffness",
    "damping": "tendon_damping",
    "tip_friction": "tip_friction",
}
"""Parameters of the model that are results of their own."""

SAME_FREQUENCY = 1.4
"""Ratio up to which two frequencies are those of one swing: gravity and damping shift it. The lower
one is that of a rotor which yields."""


def tendon_results(
    learned: LearnedForce, pairs: Sequence[LoadedPair], speed: Array, rig: RigDescription
) -> dict[str, Quantity]:
    """Return the tendon's parameters, its stiffness also by the slowest and fastest speed alone.

    `speed` (n,) rad/s of the motor is that of each of the `pairs`. The slowest shows the stiffness
    by the shift of the peak, the fastest by how the load swings; what the bench may have wrong
    counts for each as for all together. All are those of sliding alone: the residuals of its rows
    show how uncertain they are.
    """
    sliding = learned.sliding
    lines = _bench_lines(sliding, rig)

    def stated(parameter: str, model: LearnedModel, chosen: Sequence[bool]) -> Quantity:
        number = SLIDING_PARAMETERS.index(parameter)
        value, unit = float(getattr(model.shape, parameter)), stored.MODEL_UNITS[parameter]
        off = [
            replace(line, sensitivity=value * float(moved[number]) / line.u)
            for line, moved in lines
        ]
        relative = math.sqrt(sliding.covariance_of(model, chosen)[number, number])
        own = error_line("strokes under known loads", value * relative, unit)
        return combined(value, unit, [own, *off])

    every = [True] * len(sliding.problem.records)
    results = {
        name: stated(parameter, sliding.learned, every) for parameter, name in TENDON.items()
    }
    if np.ptp(speed):
        for name, own_speed in (("shift", speed.min()), ("resonance", speed.max())):
            own_pairs = [p for p, v in zip(pairs, speed, strict=True) if v == own_speed]
            used = [record for pair in own_pairs for record in (pair.loaded, *pair.unloaded)]
            chosen = [any(r is u for u in used) for r in sliding.problem.records]
            alone = sliding.learned_from(chosen)
            results[f"tendon_stiffness_{name}"] = stated("stiffness", alone, chosen)
    return results


def inertia_notes(model: LearnedModel) -> Iterator[str]:
    """Yield a remark where the turns of strokes show an inertia that is two standard deviations of
    its prior off the stated one: they are not fitted as well as they could be."""
    error, stated = model.total(Kind.INERTIA), model.known.inertia
    if abs(error) > 2 * INERTIA_SPREAD * stated:
        yield (
            f"the turns of strokes show an inertia of some {stated + error:.2g} kg m2 on the motor "
            f"shaft, {100 * abs(error) / stated:.0f} % {'less' if error < 0 else 'more'} than the "
            f"{stated:.3g} kg m2 of [rig.inertia], so that intervals of force over time may not "
            "hold: measure it with identify-plant, state it, and learn again"
        )


def stroke_notes(learned: LearnedForce, recipe: Recipe) -> Iterator[str]:
    """Yield a remark where no stroke is long enough, and for each load whose cycles do not repeat,
    with the frequencies that show whether it swings on its tendon: that of the scatter, and those
    of the load where the rotor is at rest and where it yields."""
    shape = learned.model.learned.shape
    if not learned.shown:
        yield (
            "no stroke shows how strokes deviate from each other: each is shorter than "
            f"{MIN_STROKE_ROWS * ROWS_APART / ROWS_HZ:g} s at constant speed. "
            f"{UNSEEN_PART * 100:g} % of the friction is assumed for force over time; to learn it, "
            "add a slower speed to ilc_learn.loads.speeds_rev_per_s"
        )
    for name, record in learned.strokes.items():
        if (ratio := learned.scatter[name]) <= MAX_SCATTER_RATIO:
            continue
        own_hz, seen_hz = swing_hz(shape, record.load_inertia), scatter_hz(record)
        lower_hz = yielding_hz(shape, record.load_inertia, recipe)
        cause = (
            "so the loop lets the load swing: move more slowly, or turn over a wider angle"
            f"{driven(recipe, seen_hz)}"
        )
        if not lower_hz / SAME_FREQUENCY < seen_hz < own_hz * SAME_FREQUENCY:
            cause = "so something else differs from cycle to cycle: look at its recording"
        yield (
            f"{name}: its cycles scatter by {ratio:.3g} times what those of most strokes do, "
            f"mostly at {seen_hz:.3g} Hz; on its tendon the output swings at {own_hz:.3g} Hz, "
            f"at {lower_hz:.3g} Hz where the rotor yields, {cause}. "
            "The model is learned from the whole recording instead of its mean cycle"
        )


def _bench_lines(sliding: SlidingFit, rig: RigDescription) -> list[tuple[Component, Array]]:
    """Return the budget line of each thing that the bench may have wrong, and by how much it moves
    the logarithms of the shape (p,): one more step of the search, with it off by its u."""
    weights, length = rig.weights_relative_u, rig.load_arm_u / rig.load_arm
    ratio, known = rig.angle_ratio_relative_u, sliding.problem.known
    turned = replace(
        known,
        angle_ratio=known.angle_ratio * (1 + ratio),
        torque_factor=known.torque_factor / (1 + ratio),
    )

    def hung(moment: float, inertia: float) -> list[Record]:
        return [
            replace(r, moment=r.moment * moment, load_inertia=r.load_inertia * inertia)
            for r in sliding.problem.records
        ]

    longer = 1 + length
    cases = [
        (WEIGHTS, 1.0, "1", weights, hung(1 + weights, 1 + weights), known),
        (LOAD_ARM, rig.load_arm, "m", rig.load_arm_u, hung(longer, longer**2), known),
        (ANGLE_RATIO, rig.angle_ratio, "1", rig.angle_ratio * ratio, hung(1, 1), turned),
    ]
    return [
        (Component(name, value, unit, u), sliding.moved_by(records, other))
        for name, value, unit, u, records, other in cases
        if u
    ]
