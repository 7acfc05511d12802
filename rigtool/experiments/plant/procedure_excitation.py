"""Excitation of the plant: a multisine on top of motion at constant speed, both directions.

While the shaft moves without stopping, Coulomb friction is a constant and the plant is linear. The
bare pulley turns freely: the periods of an experiment cover whole turns, and begin at as many
equally spaced angles, so that ripple of any order that is not a multiple of their number drops out.
The instrument has a limited angle: it moves to and fro, and of each pair of cycles the second has
the reversed excitation of the first, so that any function of the position drops out. Each pair has
phases of its own, so that what is left of it averages.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from rigtool.control.position_loop import position_loop
from rigtool.errors import RecipeError
from rigtool.experiments.plant.fit import MIN_LINES
from rigtool.experiments.plant.multisine import (
    LineNumbers,
    periodic,
    quasi_log_lines,
    random_phases,
)
from rigtool.numerics.arrays import Array, ComplexArray
from rigtool.recipe import Recipe
from rigtool.rigs import Feedforward, Task
from rigtool.rigs.motion import SpeedProfile, Triangle

RUN_UP = 0.5
"""Time from standstill to the speed of an experiment, s."""


@dataclass(frozen=True)
class Excitation:
    """One speed of the shaft, rad/s, and one set of phases: experiments in both directions."""

    speed: float
    number: int


def period_samples(recipe: Recipe) -> int:
    """Return the number of samples of the loop in a period of the multisine."""
    return round(recipe.identify_plant.period / recipe.rig.sample_time)


def excited_lines(recipe: Recipe) -> LineNumbers:
    """Return the excited lines of the period; `RecipeError` where they do not fit."""
    settings, rig = recipe.identify_plant, recipe.rig
    period = period_samples(recipe) * rig.sample_time
    low, high = round(settings.frequency_min * period), round(settings.frequency_max * period)
    if high >= period_samples(recipe) / 2:
        raise RecipeError(
            f"identify_plant.frequency_max {settings.frequency_max} Hz must lie below half the "
            f"sampling rate, {0.5 / rig.sample_time:.4g} Hz"
        )
    lines = quasi_log_lines(max(low, 1), max(high, 2), settings.lines)
    if len(lines) < MIN_LINES:
        raise RecipeError(
            f"identify_plant.frequency_min {settings.frequency_min} Hz to frequency_max "
            f"{settings.frequency_max} Hz hold {len(lines)} lines of a period of {period:.4g} s, "
            f"{MIN_LINES} are needed: raise frequency_max, identify_plant.lines or the period"
        )
    return lines


def excitations(recipe: Recipe) -> list[Excitation]:
    """Return the experiments, with speeds that suit the period."""
    free = recipe.rig.attachment == "pulley"
    settings = recipe.identify_plant
    wished = settings.speeds if free else settings.stroke_speeds
    speeds = [_turning(recipe, speed) if free else _strokes(recipe, speed) for speed in wished]
    return [
        Excitation(speed, place * settings.realisations + number)
        for place, speed in enumerate(speeds)
        for number in range(settings.realisations)
    ]


def tasks(recipe: Recipe, excitation: Excitation) -> Iterator[Task]:
    """Return the tasks of an excitation: each direction, or each pair of cycles of strokes."""
    if recipe.rig.attachment == "pulley":
        settings = recipe.identify_plant
        periods = settings.periods * period_samples(recipe) * recipe.rig.sample_time
        duration = settings.settle_time + periods
        times = (0.0, RUN_UP, RUN_UP + duration, 2 * RUN_UP + duration)
        for number, sign in enumerate((1.0, -1.0)):
            speeds = (0.0, sign * excitation.speed, sign * excitation.speed, 0.0)
            signal = multisine(recipe, excitation, number)
            yield Task(SpeedProfile(times, speeds), Feedforward(signal=signal))
        return
    motion = _triangle(recipe, excitation.speed)
    strokes = round(motion.stroke_time / (period_samples(recipe) * recipe.rig.sample_time))
    pair = replace(motion, cycles=2)
    for number in range(0, motion.cycles, 2):
        there, back = (
            np.tile(multisine(recipe, excitation, number + way), strokes) for way in (0, 1)
        )
        signal = np.concatenate([there, back, -there, -back])
        yield Task(pair, Feedforward(signal=signal))


def multisine(recipe: Recipe, excitation: Excitation, number: int = 0) -> Array:
    """Return a period of the torque, N m, that swings the shaft's speed at all lines alike.

    `number` is that of the phases within the excitation. A function of the position turns each
    line onto the others by these phases: what it leaves in the response is then independent, too,
    and shows as scatter between the experiments.
    Its level is the largest that neither stops the shaft nor exceeds the share of the current
    limit, by the response of the loop with the nominal inertia.
    """
    settings, rig = recipe.identify_plant, recipe.rig
    lines, count = excited_lines(recipe), period_samples(recipe)
    loop = position_loop(**rig.loop_design)
    frequency = lines / (count * rig.sample_time)
    seed = [excitation.number, number] if number else [excitation.number]
    speed = random_phases(lines, count, np.random.default_rng(seed))
    torque = speed / (2j * np.pi * frequency * loop.process_sensitivity.response(frequency))
    asked = torque * loop.sensitivity.response(frequency)

    def peak(amplitude: ComplexArray) -> float:
        return float(np.abs(periodic(lines, amplitude, count)).max())

    level = min(
        settings.swing * excitation.speed / peak(speed),
        settings.current_share * rig.current_limit * rig.torque_constant / peak(asked),
    )
    return level * periodic(lines, torque, count)


def _turning(recipe: Recipe, wished: float) -> float:
    """Return the closest speed at which the periods begin at equally spaced angles of the turn."""
    periods = recipe.identify_plant.periods
    duration = periods * period_samples(recipe) * recipe.rig.sample_time
    turns = wished * duration / (2 * math.pi)
    fitting = [n for n in range(1, math.ceil(turns) + periods + 1) if math.gcd(n, periods) == 1]
    return min(fitting, key=lambda n: abs(n - turns)) * 2 * math.pi / duration


def _strokes(recipe: Recipe, wished: float) -> float:
    """Return the closest speed at which a stroke lasts a whole number of periods."""
    settings = recipe.identify_plant
    period = period_samples(recipe) * recipe.rig.sample_time
    motion = _triangle(recipe, wished)
    count = max(1, round(motion.stroke_time / period))
    speed = wished * motion.stroke_time / (count * period)
    motion = _triangle(recipe, speed)
    if _periods_of_stroke(recipe, motion) < 1:
        straight = settings.settle_time + period
        raise RecipeError(
            f"identify_plant.stroke_speeds {wished} rad/s: constant speed must last at least "
            f"{straight:.4g} s (settle_time and a period) in each stroke: lower the speed, or "
            "the period"
        )
    return speed


def _periods_of_stroke(recipe: Recipe, motion: Triangle) -> int:
    """Return the whole periods at constant speed within one stroke."""
    straight = motion.stroke_time - 2 * motion.turn_time - recipe.identify_plant.settle_time
    return max(0, math.floor(straight / (period_samples(recipe) * recipe.rig.sample_time)))


def _triangle(recipe: Recipe, speed: float) -> Triangle:
    settings, ratio = recipe.identify_plant, recipe.rig.angle_ratio
    motion = Triangle.of_output(settings.angle, settings.turn_angle, ratio, speed, 1)
    each = max(1, _periods_of_stroke(recipe, motion))
    # An even number of cycles, for the excitation and its reverse
    return replace(motion, cycles=2 * math.ceil(settings.periods / each / 2))
