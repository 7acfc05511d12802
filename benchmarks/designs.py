"""Ways to use each command on drawn rigs, and what its results would be without any error."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
from drawn_rigs import (
    Draw,
    Settings,
    also,
    coulomb,
    far,
    grid,
    many_orders,
    moving,
    moving_excited,
    moving_far,
    near,
    turning_far,
    wrong,
)

from rigtool.control.plant_models import PlantModel
from rigtool.control.position_loop import position_loop
from rigtool.experiments.force.procedure import PROCEDURE as MEASURE_FORCE
from rigtool.experiments.friction.procedure import PROCEDURE as STRIBECK
from rigtool.experiments.learning.procedure import PROCEDURE as ILC_LEARN
from rigtool.experiments.outcome import Outcome
from rigtool.experiments.plant.procedure import PROCEDURE as IDENTIFY_PLANT
from rigtool.experiments.plant.procedure_excitation import (
    excitations,
    excited_lines,
    multisine,
    period_samples,
)
from rigtool.experiments.procedure import Procedure
from rigtool.experiments.ripple.procedure import ACCELERATION, SETTLE_TIME
from rigtool.experiments.ripple.procedure import PROCEDURE as FFT_RIPPLE
from rigtool.experiments.torque_constant.procedure import PROCEDURE as CALIBRATE_KT
from rigtool.experiments.torque_constant.staircases.model import HEATING_TIME
from rigtool.quantity import Quantity
from rigtool.recipe import Recipe
from rigtool.rigs.motion import Triangle
from rigtool.rigs.virtual.maps import rotor_map

Compared = Iterator[tuple[str, Quantity, float]]
"""A result's name, the result, and what it would be without any error."""


@dataclass(frozen=True)
class Step:
    """A command with its settings, and the steps that its inputs come from, by option."""

    procedure: Procedure
    settings: Settings = field(default_factory=dict)
    inputs: Mapping[str, Step] = field(default_factory=dict)


@dataclass(frozen=True)
class Design:
    """One way to use a command: how its rigs are drawn, what is run, what is compared."""

    name: str
    draw: Draw
    step: Step
    compare: Callable[[Outcome, Recipe], Compared]

    @property
    def learns(self) -> Step | None:
        """The step of implementation D among its steps; designs that share one share their rigs."""
        return learning_of(self.step)

    @property
    def rigs(self) -> int:
        """Rigs that 20 minutes on two cores allow; known loads take a minute to learn and read."""
        return 24 if self.learns is None else 12


def learning_of(step: Step) -> Step | None:
    """Return a step, or one that it rests on, if it is implementation D."""
    if step.settings.get("ilc_learn.implementation") == "D":
        return step
    found = map(learning_of, step.inputs.values())
    return next((one for one in found if one is not None), None)


def by_name(truth: Callable[[Recipe], dict[str, float]]) -> Callable[[Outcome, Recipe], Compared]:
    """Compare the results that have an uncertainty with their truth by name."""

    def compare(outcome: Outcome, recipe: Recipe) -> Compared:
        for name, true in truth(recipe).items():
            if name in outcome.results:
                yield name, outcome.results[name], true

    return compare


# -- calibrate-kt


def true_constants(recipe: Recipe) -> dict[str, float]:
    """Return the results of calibrate-kt for this rig without any error."""
    assert recipe.virtual is not None
    virtual, settings = recipe.virtual, recipe.calibrate_kt
    at_20 = virtual.motor.torque_constant
    slope = virtual.motor.torque_constant_temperature_coefficient
    low, high = settings.reference_range_degc
    mean = 1 + slope * ((low + high) / 2 - 20)
    errors = [mean / (1 + slope * (end - 20)) - 1 for end in (low, high)]
    table = rotor_map(virtual, virtual.amplifier, virtual.power_cycle)[:-1]
    heat, middle = virtual.thermal, float(np.mean(settings.temperatures_degc)) - 20
    # The slope of i + i (g + s i) is 1 + g + s top from zero to the top, of true current.
    top = virtual.amplifier.offset + virtual.amplifier.gain * settings.current_max
    return {
        "torque_constant": at_20,
        "torque_constant_temperature_coefficient": slope,
        "torque_constant_mean": at_20 * mean,
        "torque_constant_constant_error": max(map(abs, errors)),
        "torque_constant_ripple": float(np.std(table[:, 1] + top * table[:, 2])),
        "amplifier_gain": virtual.amplifier.gain,
        "amplifier_offset": virtual.amplifier.offset,
        "winding_heat_loss": -slope
        / (1 + slope * middle)
        * heat.winding_resistance
        * heat.winding_to_housing
        * -math.expm1(-HEATING_TIME / (heat.winding_to_housing * heat.winding_capacity)),
    }


KT = Step(CALIBRATE_KT)


def calibrate_kt() -> Iterator[Design]:
    """Yield the designs of calibrate-kt: grids of angles and temperatures, then hard rigs."""
    some = grid(8, 20, 35, 50)
    gimbal = {
        "rig.torque_constant": 0.3,
        "virtual.motor.torque_constant": 0.3,
        "virtual.motor.coulomb_friction": 12e-3,
        "virtual.motor.static_friction": 20e-3,
        "calibrate_kt.current_max": 1.0,
    }
    draws: dict[str, Draw] = {
        "8 x 7": near,
        "4 x 3": also(many_orders, grid(4, 20, 30, 40)),
        "3 x 2": also(near, grid(3, 20, 50)),
        "2 x 7": also(many_orders, grid(2, 20, 25, 30, 35, 40, 45, 50)),
        "6 x 4": also(near, grid(6, 20, 30, 40, 50)),
        "1 A": also(near, some | {"calibrate_kt.current_max": 1.0}),
        "friction x 4": also(near, some | coulomb(4)),
        "friction x 8": also(near, some | coulomb(8)),
        "gimbal motor": also(near, some | gimbal),
        "soft contacts": also(near, some | {"virtual.motor.presliding_angle": 50e-3}),
        "gauge 0.01 N": also(near, some | {"virtual.sensors.force_resolution": 0.01}),
        "gauge 0.1 N": also(near, some | {"virtual.sensors.force_resolution": 0.1}),
        "far": far,
    }
    for name, draw in draws.items():
        yield Design(f"calibrate-kt, {name}", draw, KT, by_name(true_constants))


# -- the motor as it turns


def true_friction(recipe: Recipe) -> dict[str, float]:
    """Return the results of stribeck for this rig without any error."""
    assert recipe.virtual is not None
    motor, force = recipe.virtual.motor, recipe.stribeck.radial_force
    return {
        "coulomb_friction": motor.coulomb_friction,
        "viscous_friction": motor.viscous_friction,
        "viscous_friction_positive": motor.viscous_friction,
        "viscous_friction_negative": motor.viscous_friction,
        "stribeck_velocity": motor.stribeck_velocity,
        "stribeck_static_friction": motor.static_friction,
        "radial_load_friction": motor.radial_friction * force,
    }


def true_plant(recipe: Recipe) -> dict[str, float]:
    """Return the results of identify-plant for this rig without any error."""
    assert recipe.virtual is not None
    motor, tool, rig = recipe.virtual.motor, recipe.virtual.instrument, recipe.rig.instrument
    if recipe.rig.attachment == "pulley":
        return {"inertia": motor.inertia, "viscous_friction": motor.viscous_friction}
    near_side = motor.inertia + tool.wheel_inertia
    behind = tool.grasper_inertia / (rig.angle_ratio * rig.torque_factor)
    antiresonance = math.sqrt(tool.stiffness / tool.grasper_inertia) / (2 * math.pi)
    damping = tool.damping / (2 * math.sqrt(tool.stiffness * tool.grasper_inertia))
    share = near_side / (near_side + behind)
    plant = PlantModel(near_side + behind, 0.0, share, antiresonance, damping)
    # What the motor feels: friction that grows with the tendon's torque adds to that torque.
    behind *= 1 + tool.load_friction * growth(recipe, plant)
    return {
        "inertia": near_side + behind,
        "inertia_motor_side": near_side,
        "viscous_friction": motor.viscous_friction * (1 + _modulation(recipe))
        + tool.viscous_friction,
        "antiresonance_frequency": antiresonance,
        "resonance_frequency": antiresonance * math.sqrt(1 + behind / near_side),
    }


def _modulation(recipe: Recipe) -> float:
    """Return the mean of the modulation of viscous friction over the angles that strokes cover with
    whole periods: those in their middle."""
    assert recipe.virtual is not None
    (first, *_), settings = excitations(recipe), recipe.identify_plant
    motion = Triangle.of_output(
        settings.angle, settings.turn_angle, recipe.rig.angle_ratio, first.speed, 1
    )
    straight = motion.stroke_time - 2 * motion.turn_time - settings.settle_time
    period = period_samples(recipe) * recipe.rig.sample_time
    reach = first.speed * period * max(1, math.floor(straight / period)) / 2
    angle = (motion.low + motion.high) / 2 + np.linspace(-reach, reach, 1001)
    table = rotor_map(recipe.virtual, recipe.virtual.amplifier, 0)[:, 4]
    turn = np.linspace(0, 2 * np.pi, len(table))
    return float(np.interp(angle, turn, table, period=2 * np.pi).mean())


def growth(recipe: Recipe, plant: PlantModel) -> float:
    """Return the mean slope of hypot(T, onset) over the tendon's torque T at the grasper, which
    the excitation swings about the friction of the tip (J. J. Bussgang, MIT RLE Tech. Rep. 216,
    1952: what a linear response shows of a nonlinear one).

    The excitation suits the nominal inertia; how far the shaft swings, the true `plant` decides.
    """
    assert recipe.virtual is not None
    tool, (first, *_) = recipe.virtual.instrument, excitations(recipe)
    lines, count = excited_lines(recipe), period_samples(recipe)
    frequency = lines / (count * recipe.rig.sample_time)
    torque = np.fft.rfft(multisine(recipe, first))[lines] * 2 / count
    loop = position_loop(**recipe.rig.loop_design)
    controller = loop.complementary_sensitivity.response(frequency)
    controller /= loop.process_sensitivity.response(frequency)
    response = plant.response(frequency, recipe.rig.sample_time)
    angle = torque * response / (1 + controller * response) / recipe.rig.angle_ratio
    ratio = frequency / plant.antiresonance_hz
    lag = 2j * plant.damping * ratio
    follows = (1 + lag) / (1 - ratio**2 + lag)
    swing = tool.grasper_inertia * (2 * np.pi * frequency) ** 2 * np.abs(angle * follows)
    normal = np.linspace(-5, 5, 2001)
    tendon = tool.tip_friction + np.sqrt(np.sum(swing**2) / 2) * normal
    slope = tendon / np.hypot(tendon, tool.load_friction_onset)
    return float(np.average(slope, weights=np.exp(-(normal**2) / 2)))


def compare_ripple(outcome: Outcome, recipe: Recipe) -> Compared:
    """Compare the amplitudes of orders 1 to 6, at the slowest speed and at each torque."""
    assert recipe.virtual is not None
    speed = min(recipe.fft_ripple.speeds)
    slow = 2 * math.pi * recipe.fft_ripple.slow_speed_rev_per_s
    winding = Winding(recipe)
    conditions = [("speed", 0, speed, 0.0, recipe.virtual.thermal.ambient_degc)]
    for number, torque in enumerate(sorted(recipe.fft_ripple.torques)):
        before = slow / ACCELERATION + SETTLE_TIME
        lead = before + 0.6 * 2 * math.pi / slow  # turns are cut at the encoder's zero
        turns = recipe.fft_ripple.revolutions * 2 * math.pi / slow
        degc = winding.after(torque, lead, turns)
        winding.after(torque, 0.0, before + 1.1 * 2 * math.pi / slow - lead + slow / ACCELERATION)
        conditions.append(("torque", number, slow, torque, degc))
    for kind, row, turning, torque, degc in conditions:
        table = outcome.tables[f"{kind}_spectrum"].columns
        true = true_orders(recipe, turning, torque, degc)
        name = "at the slowest speed" if kind == "speed" else f"at torque {row + 1}"
        for order in range(1, 7):
            if (amplitude := table["amplitude"].values[row, order - 1]) > 5 * table[
                "noise_floor"
            ].values[row, order - 1]:
                u, dof = (float(table[n].values[row, order - 1]) for n in ("u", "dof"))
                found = Quantity(float(amplitude), "N m", u, dof if math.isfinite(dof) else None)
                yield f"amplitude {name}", found, true[order]


class Winding:
    """Mean temperature of the winding over each of several constant torques in a row."""

    def __init__(self, recipe: Recipe) -> None:
        assert recipe.virtual is not None
        self._virtual = recipe.virtual
        self._winding = self._housing = recipe.virtual.thermal.ambient_degc

    def after(self, torque: float, lead: float, duration: float) -> float:
        """Return the mean temperature, degC, over this time, s, under this torque, N m, which has
        acted for the time `lead`, s, before."""
        heat, motor, sum_, steps = self._virtual.thermal, self._virtual.motor, 0.0, 2000
        step = (lead + duration) / steps
        counted = range(round(steps * lead / (lead + duration)), steps)
        for number in range(steps):
            constant = motor.torque_constant * (
                1 + motor.torque_constant_temperature_coefficient * (self._winding - 20)
            )
            current = (torque + motor.coulomb_friction) / constant
            resistance = heat.winding_resistance * (1 + 0.00393 * (self._winding - 20))
            flow = (self._winding - self._housing) / heat.winding_to_housing
            loss = (self._housing - heat.ambient_degc) / heat.housing_to_ambient
            self._winding += step * (resistance * current**2 - flow) / heat.winding_capacity
            self._housing += step * (flow - loss) / heat.housing_capacity
            sum_ += self._winding * (number in counted)
        return sum_ / len(counted)


def dry_friction(recipe: Recipe, speed: float) -> float:
    """Return the friction, N m, of a motor that turns evenly forwards, without the viscous one."""
    assert recipe.virtual is not None
    motor = recipe.virtual.motor
    stribeck = math.exp(-((speed / motor.stribeck_velocity) ** 2))
    level = motor.coulomb_friction + (motor.static_friction - motor.coulomb_friction) * stribeck
    return level * (1 + motor.friction_asymmetry)


def true_orders(recipe: Recipe, speed: float, load: float, degc: float) -> np.ndarray:
    """Return the amplitudes of orders 0, 1, 2... of the torque ripple, N m."""
    assert recipe.virtual is not None
    virtual = recipe.virtual
    motor, slope = virtual.motor, virtual.motor.torque_constant_temperature_coefficient
    constant = motor.torque_constant * (1 + slope * (degc - 20))
    table = rotor_map(virtual, virtual.amplifier, virtual.power_cycle)[:-1]
    offset, gain, saturation, cogging, modulation = table.T
    viscous = motor.viscous_friction * speed
    # Torque at the shaft over one turn: what the motor has to hold, at constant speed.
    held = (load + dry_friction(recipe, speed) + viscous * (1 + modulation) - cogging) / constant
    order = np.arange(len(table) // 2 + 1)
    lag = 1 + 1j * order * speed / (2 * math.pi * virtual.amplifier.ripple_corner_hz)
    current = held.copy()
    for _ in range(20):  # ripple grows with the current that it is part of
        added = offset + current * (gain + abs(current) * saturation)
        current = held - np.fft.irfft(np.fft.rfft(added) / lag)
    amplitudes: np.ndarray = constant * np.abs(np.fft.rfft(current)) * 2 / len(table)
    return amplitudes


PULLEY: Settings = {"rig.attachment": "pulley"}


def turning() -> Iterator[Design]:
    """Yield the designs of commands that turn the bare motor, and of the plant."""
    for name, draw in (("near", moving), ("far", moving_far)):
        yield Design(
            f"stribeck, {name}",
            draw,
            Step(STRIBECK, inputs={"kt": KT}),
            by_name(true_friction),
        )
        yield Design(
            f"fft-ripple, {name}",
            turning_far if name == "far" else draw,
            Step(FFT_RIPPLE, inputs={"kt": KT}),
            compare_ripple,
        )
        yield Design(
            f"identify-plant, pulley, {name}",
            draw,
            Step(IDENTIFY_PLANT, PULLEY, {"kt": KT}),
            by_name(true_plant),
        )
    soft: Settings = {"virtual.motor.presliding_angle": 10e-3}
    yield Design(
        "stribeck, soft contacts",
        also(moving, soft),
        Step(STRIBECK, inputs={"kt": KT}),
        by_name(true_friction),
    )
    yield Design(
        "identify-plant, instrument",
        moving_excited,
        Step(IDENTIFY_PLANT, inputs={"kt": KT}),
        by_name(true_plant),
    )
    yield Design(
        "identify-plant, 2 periods",
        moving_excited,
        Step(IDENTIFY_PLANT, PULLEY | {"identify_plant.periods": 2}, {"kt": KT}),
        by_name(true_plant),
    )


# -- learned tables and forces

LEARN = {
    "ilc_learn.implementation": "D",
    "ilc_learn.speeds_rev_per_s": [0.2, 1, 3],
    "ilc_learn.moves": 8,
    "ilc_learn.loads.speeds_rev_per_s": [0.2, 1],
    "ilc_learn.loads.cycles": 12,
}


def true_instrument(recipe: Recipe) -> dict[str, float]:
    """Return the results of implementation D for this rig without any error."""
    assert recipe.virtual is not None
    tool = recipe.virtual.instrument
    return {
        "tendon_stiffness": tool.stiffness,
        "tendon_damping": tool.damping,
        "tip_friction": tool.tip_friction,
    }


def compare_loads(outcome: Outcome, recipe: Recipe) -> Compared:
    """Compare each row of Table 8 or 9 with the torque of its load."""
    columns = outcome.tables["loads"].columns
    names = ("applied_force", "applied_torque", "mean_torque", "mean_torque_u", "mean_torque_dof")
    for force, applied, mean, u, dof in zip(*(columns[n].values[1:] for n in names), strict=True):
        if math.isfinite(mean):
            known = float(dof) if math.isfinite(dof) else None
            yield (
                f"load of {force:g} N",
                Quantity(float(mean), "N m", float(u), known),
                float(applied),
            )


def loaded() -> Iterator[Design]:
    """Yield the designs of ilc-learn and measure-force."""
    learned = Step(ILC_LEARN, LEARN, {"kt": KT})
    yield Design("ilc-learn, D", moving, learned, by_name(true_instrument))
    plain = {k: v for k, v in LEARN.items() if "loads" not in k} | {"ilc_learn.implementation": "C"}
    bare = Step(ILC_LEARN, plain | PULLEY, {"kt": KT})
    yield Design(
        "measure-force, pulley",
        moving,
        Step(MEASURE_FORCE, PULLEY | {"measure_force.cycles": 20}, {"kt": KT, "tables": bare}),
        compare_loads,
    )
    for correction, cycles in (("load", 20), ("full", 20), ("full", 5)):
        settings = {"measure_force.correction": correction, "measure_force.cycles": cycles}
        yield Design(
            f"measure-force, --correction {correction}, {cycles} cycles",
            moving,
            Step(MEASURE_FORCE, settings, {"kt": KT, "tables": learned}),
            compare_loads,
        )


def compare_errors(outcome: Outcome, recipe: Recipe) -> Compared:
    """Compare the errors of Table 8 or 9 with none: what both torques have in common cancels."""
    columns = outcome.tables["loads"].columns
    names = ("applied_force", "error_torque", "error_torque_u", "error_torque_dof")
    for force, error, u, dof in zip(*(columns[n].values[1:] for n in names), strict=True):
        if math.isfinite(error):
            known = float(dof) if math.isfinite(dof) else None
            yield f"error at {force:g} N", Quantity(float(error), "N m", float(u), known), 0.0


def compare_torques(outcome: Outcome, recipe: Recipe) -> Compared:
    """Compare each row of Table 8 with the torque that acts, and its error with none."""
    assert recipe.virtual is not None
    wrong = recipe.virtual.misstated
    scale = (1 + wrong.weights) * (1 + wrong.grasper_length)
    for name, mean, applied in compare_loads(outcome, recipe):
        yield name, mean, applied * scale
    yield from compare_errors(outcome, recipe)


def true_on_a_wrong_bench(recipe: Recipe) -> dict[str, float]:
    """Return the constants of this rig for an ampere that is one."""
    every = true_constants(recipe)
    names = ("torque_constant", "torque_constant_temperature_coefficient", "torque_constant_mean")
    return {name: every[name] for name in names}


def wrong_bench() -> Iterator[Design]:
    """Yield designs in which the bench is wrong in all that the recipe has a line for."""
    small = grid(8, 20, 35, 50)
    yield Design(
        "calibrate-kt, wrong bench", also(wrong, small), KT, by_name(true_on_a_wrong_bench)
    )
    plain = {k: v for k, v in LEARN.items() if "loads" not in k} | {"ilc_learn.implementation": "C"}
    bare = Step(ILC_LEARN, plain | PULLEY, {"kt": KT})
    settings = PULLEY | {"measure_force.cycles": 20}
    step = Step(MEASURE_FORCE, settings, {"kt": KT, "tables": bare})
    yield Design("measure-force, pulley, wrong bench", wrong, step, compare_errors)
    learned = Step(ILC_LEARN, LEARN, {"kt": KT})
    yield Design("ilc-learn, D, wrong bench", wrong, learned, by_name(true_instrument))
    for correction in ("load", "full"):
        settings = {"measure_force.correction": correction, "measure_force.cycles": 20}
        step = Step(MEASURE_FORCE, settings, {"kt": KT, "tables": learned})
        name = f"measure-force, --correction {correction}, wrong bench"
        yield Design(name, wrong, step, compare_torques)


DESIGNS = (*calibrate_kt(), *turning(), *loaded(), *wrong_bench())
"""A function a command or two, joined here."""


def group(number: int) -> list[int]:
    """Return the designs that are tried on one rig: this one, and those that share its loads."""
    learns = DESIGNS[number].learns
    if learns is None:
        return [number]
    return [n for n, design in enumerate(DESIGNS) if design.learns is learns]
