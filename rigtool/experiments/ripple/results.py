"""Results and tables of `fft-ripple`: orders of the motor's torque, and comparisons."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from rigtool.control.position_loop import position_loop
from rigtool.errors import InsufficientDataError
from rigtool.experiments.ripple.orders import (
    HIGHEST_ORDER,
    LoopRipple,
    Ripple,
    RippleComparison,
    Spectrum,
    scattered,
    spectrum,
)
from rigtool.experiments.ripple.shared_scatter import shared_floor
from rigtool.experiments.ripple.varying_speed import (
    motor_orders,
    speed_variation,
    uneven_orders,
)
from rigtool.numerics.arrays import Array, ComplexArray
from rigtool.quantity import Quantity, error_line
from rigtool.recipe import Recipe
from rigtool.runfile import Column, Recording, Table, dof_column

LOWEST_FOLLOWED = 0.5
"""Smallest |T| at which the controller's torque shows the motor's."""

INERTIA_U = 0.1 / math.sqrt(3)
"""Relative standard uncertainty of an inertia from data sheets: at most a tenth off."""

VARYING_LIMIT = 0.05
"""Relative standard deviation of the speed around the turn without a note: friction that changes
with the speed is then an order of some per cent of it."""

STANDING_LIMIT = 1.0
"""Relative standard deviation beyond which a rotor stands in places and leaps over others: that of
a sine is reached where the slowest speed is a seventh of the mean. Friction of a rotor that stands
follows its motion, so that torque is no function of the angle. Leaps have orders of the speed up to
`HIGHEST_ORDER`."""

FOLLOWED_HARMONICS = 2
"""Harmonics of the encoder's steps whose alias the loop may follow: higher ones are weaker."""

STORED_REVOLUTIONS = 100
"""Number of single revolutions, from the first, in the table; the signals hold all of them."""


def loop_note(recipe: Recipe, fastest: float) -> str:
    """State up to which order the loop follows ripple at the highest speed, turns a second."""
    order = np.arange(1.0, HIGHEST_ORDER + 1)
    lost = np.flatnonzero(np.abs(_loop(recipe, order * fastest)) < LOWEST_FOLLOWED)
    followed = int(lost[0]) if lost.size else HIGHEST_ORDER
    return (
        "amplitudes are those of the motor's torque: what the controller asks for less what "
        "accelerates the recipe's inertia; waveforms are what it asks for. Where the complementary "
        f"sensitivity |T| of the loop is below {LOWEST_FOLLOWED:g} there is no value: at the "
        f"highest speed above order {followed}"
    )


def varying_note(recordings: Sequence[Recording], ripples: Sequence[LoopRipple]) -> list[str]:
    """Return a note where ripple varies the speed beyond `VARYING_LIMIT`, and one where it makes
    the rotor stand.

    Raises `InsufficientDataError` where it stands in all recordings.
    """
    named = {r.name: own for r, own in zip(recordings, ripples, strict=True)}
    varying = {name: speed_variation(own.durations) for name, own in named.items()}
    standing = [name for name, own in named.items() if _leaping(own) > STANDING_LIMIT]
    notes = []
    if standing:
        sticks = (
            f"{', '.join(standing)}: the rotor sticks and slips (its speed varies by more than "
            f"{100 * STANDING_LIMIT:.0f} % around the turn): the friction of a rotor that stands "
            "is whatever holds it, so that no order is the motor's ripple"
        )
        remedy = "turn faster, or take a stiffer controller"
        if len(standing) == len(varying):
            raise InsufficientDataError(f"{sticks}: {remedy}")
        notes.append(f"{sticks}, and there is no value; {remedy}")
        varying = {name: part for name, part in varying.items() if name not in standing}
    uneven = [
        f"{name} by {100 * part:.0f} %" for name, part in varying.items() if part > VARYING_LIMIT
    ]
    if not uneven:
        return notes
    return [
        *notes,
        f"ripple varies the speed around the turn (limit {100 * VARYING_LIMIT:.0f} %) of "
        f"{', '.join(uneven)}: amplitudes are those of this motion, and friction that changes with "
        "the speed, and a ripple's lag behind its angle, are part of them, which u includes; take "
        "a stiffer controller for those of an even speed",
    ]


def _leaping(ripple: LoopRipple) -> float:
    """Return the variation of the speed with higher orders, which leaps have."""
    return speed_variation(ripple.durations, HIGHEST_ORDER)


def steps_note(recordings: Sequence[Recording], recipe: Recipe) -> list[str]:
    """Return a note on the speeds at which the loop follows the encoder's steps."""
    speeds = np.unique([recording.condition("speed") for recording in recordings])
    followed = [v for v in speeds if _followed_steps(recipe, v / (2 * math.pi))]
    if not followed:
        return []
    per_sample = recipe.rig.encoder_counts * recipe.rig.sample_time / (2 * math.pi)
    return [
        f"at {', '.join(f'{v:.3g}' for v in followed)} rad/s the encoder makes "
        f"{', '.join(f'{per_sample * v:.3f}' for v in followed)} counts from one sample of the "
        "loop to the next, so nearly a whole number or half of one that the loop follows the "
        "difference: any order may be one of the encoder's steps, which noise_floor and u "
        "include; change the speed by some per cent, or take an encoder with more counts"
    ]


def _followed_steps(recipe: Recipe, turns_per_s: float) -> float:
    """Return the amplitude, rad, of the encoder's steps that the loop follows as an alias, or 0.

    Steps, of variance step^2/12, have harmonics n of the rate of their edges, of which the n-th and
    its multiples are a part 1/n. An alias moves the rotor, which is then no longer known better
    than to these steps.
    """
    rig = recipe.rig
    harmonic = np.arange(1, FOLLOWED_HARMONICS + 1)
    per_sample = harmonic * rig.encoder_counts * turns_per_s * rig.sample_time
    whole = np.round(per_sample)
    answer = np.abs(_loop(recipe, np.abs(per_sample - whole) / rig.sample_time))
    followed = harmonic[(whole > 0) & (answer >= LOWEST_FOLLOWED)]
    step = rig.count_angle
    return step / math.sqrt(6) / int(followed[0]) if followed.size else 0.0


def _loop(recipe: Recipe, frequency: Array) -> ComplexArray:
    """Return T of the recipe's loop at these frequencies, Hz: from the motor's ripple to the torque
    that the loop asks for against it."""
    return position_loop(**recipe.rig.loop_design).complementary_sensitivity.response(frequency)


def _spectrum(
    ripple: LoopRipple, recipe: Recipe, turns_per_s: float
) -> tuple[Spectrum, Array, Array]:
    """Return the orders of the motor's torque, the degrees of freedom of their noise floor, and the
    u of their amplitudes by the motion. No order has a value where the rotor stands in places.

    What accelerates the inertia is as uncertain as it; what cells twice as wide change, they do not
    resolve; torque changes with an uneven speed. The encoder's steps are part of the noise floor.
    """
    order = np.arange(1.0, HIGHEST_ORDER + 1)
    loop = _loop(recipe, order * turns_per_s)
    # The torque of a sample is held until the next one: it acts half a sample later.
    late = np.exp(-1j * np.pi * order * turns_per_s * recipe.rig.sample_time)
    moved = ripple, recipe.rig.nominal_inertia, late
    asked, found = motor_orders(*moved)
    unresolved = np.abs((motor_orders(*moved, width=2)[1] - found).mean(axis=0))
    own = scattered(found, ripple.sampling)
    # Both parts of a coefficient scatter.
    floor, dof = shared_floor(order, own.noise_floor, 2 * (len(found) - 1))
    gain = np.abs(loop)
    plant = position_loop(**recipe.rig.loop_design).plant
    alias = _followed_steps(recipe, turns_per_s) / np.abs(plant.response(order * turns_per_s))
    total = np.hypot(floor, np.maximum(ripple.steps / gain, alias))
    with np.errstate(divide="ignore", invalid="ignore"):
        dof = dof * (total / floor) ** 4  # Welch and Satterthwaite
    followed = (gain >= LOWEST_FOLLOWED) & (_leaping(ripple) <= STANDING_LIMIT)
    known = np.where(followed, 1.0, np.nan)
    motor = replace(
        own, amplitude=known * own.amplitude, phase=known * own.phase, noise_floor=known * total
    )
    by_inertia = INERTIA_U * np.abs((asked - found).mean(axis=0))
    uneven = uneven_orders(ripple, HIGHEST_ORDER)
    return (
        motor,
        dof,
        np.sqrt(by_inertia**2 + unresolved**2 + uneven**2 + np.square(ripple.distorted)),
    )


def ripple_results(by_speed: Sequence[Ripple]) -> dict[str, Quantity]:
    """Return the strongest orders at both ends of the speeds, and the rms at the lowest, N m.

    Raises `InsufficientDataError` where no order is significant.
    """
    results = {}
    for name, ripple in (("lowest", by_speed[0]), ("highest", by_speed[-1])):
        orders = spectrum(ripple, HIGHEST_ORDER)
        strongest = orders.strongest()
        resolved = orders.amplitude[np.isfinite(orders.amplitude)]
        *_, second, first = np.sort([0.0, *resolved])
        results[f"strongest_order_{name}_speed"] = Quantity(
            float(strongest),
            "1",
            reason="a whole number; the next order has "
            f"{100 * second / first:.0f} % of its amplitude",
        )
    rms = by_speed[0].rms()
    results["repeatable_rms"] = Quantity(rms.repeatable, "N m", rms.repeatable_u, rms.dof)
    results["non_repeatable_rms"] = Quantity(
        rms.non_repeatable,
        "N m",
        rms.non_repeatable_u,
        rms.dof,
        reason="two revolutions do not resolve the uncertainty of their scatter"
        if rms.non_repeatable_u is None
        else None,
    )
    return results


def comparison_results(comparisons: Sequence[RippleComparison]) -> dict[str, Quantity]:
    """Return the comparison with the power cycle that changed the ripple most."""
    if not comparisons:
        return {}
    worst = min(comparisons, key=lambda found: found.correlation)

    def stated(value: float, unit: str, u: float) -> Quantity:
        line = error_line("scatter over the turns", u, unit, worst.dof)
        return Quantity(value, unit, u, worst.dof, budget=(line,))

    return {
        "power_cycle_correlation": stated(worst.correlation, "1", worst.correlation_u),
        "power_cycle_shift": stated(worst.shift, "rad", worst.shift_u),
    }


def condition_tables(
    kind: str,
    axis: str,
    unit: str,
    recordings: Sequence[Recording],
    ripples: Sequence[LoopRipple],
    constants: Mapping[str, Quantity],
    recipe: Recipe,
) -> dict[str, Table]:
    """Return waveforms and spectra over the condition that was varied.

    `constants` are the torque per ampere by the name of a recording.
    """
    varied = {axis: Column([r.condition(axis) for r in recordings], unit)}
    # Where the constant torque is the axis, its ripple needs another name.
    signal = "ripple" if axis == "torque" else "torque"
    turns = [recording.condition("speed") / (2 * math.pi) for recording in recordings]
    spectra, u, dof = [], [], []
    for recording, ripple, turns_per_s in zip(recordings, ripples, turns, strict=True):
        own, free, by_motion = _spectrum(ripple, recipe, turns_per_s)
        constant = constants[recording.name]
        scale = own.amplitude * (constant.u or 0.0) / constant.value
        total = np.hypot(np.hypot(own.u, by_motion), scale)
        known = 1 / constant.dof if constant.dof else 0.0
        with np.errstate(divide="ignore", invalid="ignore"):  # Welch and Satterthwaite
            scatter = own.u**4 / free
            dof.append(total**4 / (scatter + known * scale**4))
        spectra.append(own)
        u.append(total)
    waveforms = Table(
        (axis, "position"),
        {
            **varied,
            "position": Column(ripples[0].angle, "rad", "of the rotor"),
            signal: Column([ripple.mean for ripple in ripples], "N m"),
        },
        signal,
        "repeatable ripple of the motor torque by rotor position, offset removed",
    )
    orders = Table(
        (axis, "order"),
        {
            **varied,
            "order": Column(spectra[0].order, "1", "cycles a turn"),
            "amplitude": Column([s.amplitude for s in spectra], "N m"),
            "phase": Column(
                [s.phase for s in spectra], "rad", "amplitude*cos(order*angle + phase)"
            ),
            "noise_floor": Column(
                [s.noise_floor for s in spectra],
                "N m",
                "amplitude that scatter between revolutions, of few with the orders around, and "
                "the encoder's steps would show alone",
            ),
            "u": Column(u, "N m", "standard, of the amplitude: noise floor, constant, motion"),
            "dof": dof_column(dof),
            "loop_gain": Column(
                [np.abs(_loop(recipe, spectra[0].order * n)) for n in turns],
                "1",
                "|T| by the recipe's controller and inertia: asked for over amplitude",
            ),
        },
        "amplitude",
        "repeatable ripple by order of rotation; no value where samples lie too far apart, or the "
        "loop does not follow",
    )
    return {f"{kind}_waveforms": waveforms, f"{kind}_spectrum": orders}


def revolutions_table(ripple: Ripple) -> Table:
    """Return the first single revolutions of a ripple (revolutions, positions)."""
    waveforms = ripple.waveforms[:STORED_REVOLUTIONS]
    return Table(
        ("revolution", "position"),
        {
            "revolution": Column(np.arange(len(waveforms)), "1"),
            "position": Column(ripple.angle, "rad", "of the rotor"),
            "torque": Column(waveforms, "N m", "offset removed"),
        },
        "torque",
        "ripple of single revolutions at the slowest motion",
    )


def comparison_table(comparisons: Sequence[RippleComparison]) -> Table:
    """Return how each power-up's ripple differs from the first one's."""

    def column(name: str, unit: str, what: str) -> Column:
        return Column([getattr(found, name) for found in comparisons], unit, what)

    return Table(
        ("power_cycle",),
        {
            "power_cycle": Column(np.arange(1, len(comparisons) + 1), "1"),
            "correlation": column("correlation", "1", "at equal angles"),
            "shift": column("shift", "rad", "that makes the correlation largest"),
            "best_correlation": column("best_correlation", "1", "at that shift"),
            "scale": column("scale", "1", "least-squares factor at that shift"),
        },
        "correlation",
        "ripple after each start of the amplifier against the one before the first restart",
    )
