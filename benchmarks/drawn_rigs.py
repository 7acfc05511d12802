"""Virtual rigs drawn anew, as settings for `--set`: near the thesis's and far from it.

Errors of arm and gauge are drawn from the standard uncertainty that the recipe states; all else
from wide ranges. Nothing here is known to a command but what the recipe's rig section says.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from rigtool.numerics.angle_effects import HIGHEST_ORDER, LOWEST_ORDER

Settings = dict[str, object]
Draw = Callable[[np.random.Generator], Settings]
"""Settings of one rig."""

STEADY_COUNTS = 5000
"""Counts of an encoder a turn from which its steps make the current shake by little."""


def spread(rng: np.random.Generator, low: float, high: float) -> float:
    """Return a number drawn evenly on a logarithmic scale."""
    return float(np.exp(rng.uniform(math.log(low), math.log(high))))


def near(rng: np.random.Generator) -> Settings:
    """Draw a rig like the thesis's: its parameters vary by a half or so."""
    motor, amplifier = "virtual.motor.", "virtual.amplifier."
    coulomb = spread(rng, 1.2e-3, 4.5e-3)
    # Errors of arm and gauge, as large as the recipe states, both scale the force that is read.
    gauge = 1 + 3e-4 * rng.standard_normal() + 0.2e-3 / 0.540 * rng.standard_normal()
    return {
        motor + "torque_constant": spread(rng, 0.03, 0.07),
        motor + "torque_constant_temperature_coefficient": rng.uniform(-2e-3, -0.8e-3),
        motor + "coulomb_friction": coulomb,
        motor + "static_friction": coulomb * rng.uniform(1.0, 2.0),
        motor + "presliding_angle": spread(rng, 0.7e-3, 3e-3),
        motor + "friction_noise": spread(rng, 0.03e-3, 0.3e-3),
        amplifier + "gain": rng.uniform(0.97, 1.03),
        amplifier + "offset": 1e-3 * rng.standard_normal(),
        amplifier + "gain_ripple": ripple(rng, 0.0035),
        amplifier + "saturation_ripple": ripple(rng, 0.0015),
        "virtual.arm.stiffness": spread(rng, 8.0, 30.0),
        "virtual.sensors.force_noise": spread(rng, 2e-4, 2e-3),
        "virtual.sensors.force_gain": gauge,
        "virtual.thermal.winding_to_housing": rng.uniform(0.5, 1.2),
        motor + "friction_asymmetry": rng.uniform(-0.15, 0.15),
    }


def ripple(rng: np.random.Generator, amplitude: float) -> str:
    """Draw which orders the amplifier's ripple has, as a list of TOML."""
    orders = rng.choice(np.arange(1, 7), size=rng.integers(1, 5), replace=False)
    rows = (f"{{order={order}, amplitude={spread(rng, 0.3, 2) * amplitude}}}" for order in orders)
    return f"[{', '.join(rows)}]"


def many_orders(rng: np.random.Generator) -> Settings:
    """Draw a rig like the thesis's whose amplifier has all orders up to one of 4 to 12.

    That is what `rigtool.numerics.angle_effects` assumes of orders that no angle shows; where all
    rigs end at order six, none has what eight angles hide.
    """
    drawn, highest = near(rng), int(rng.integers(LOWEST_ORDER, HIGHEST_ORDER + 1))

    def orders(amplitude: float) -> str:
        sizes = rng.rayleigh(spread(rng, 0.3, 2) * amplitude / math.sqrt(highest), highest)
        rows = (f"{{order={k}, amplitude={size}}}" for k, size in enumerate(sizes, 1))
        return f"[{', '.join(rows)}]"

    amplifier = "virtual.amplifier."
    return drawn | {
        amplifier + "gain_ripple": orders(0.0035),
        amplifier + "saturation_ripple": orders(0.0015),
    }


def far(rng: np.random.Generator) -> Settings:
    """Draw a rig far from the thesis's, and a grid of angles and temperatures."""
    constant = spread(rng, 0.01, 0.3)
    friction = spread(rng, 0.2, 8.0) * 2.3e-3 * math.sqrt(constant / 0.045)
    noise = spread(rng, 0.3, 10.0)
    temperatures = np.linspace(20.0, rng.uniform(35.0, 50.0), rng.integers(2, 8))
    return near(rng) | {
        "calibrate_kt.rotor_positions": int(rng.integers(2, 9)),
        "calibrate_kt.temperatures_degc": temperatures.round(1).tolist(),
        "rig.torque_constant": constant,
        "virtual.motor.torque_constant": constant,
        "virtual.motor.coulomb_friction": friction,
        "virtual.motor.static_friction": friction * rng.uniform(1.0, 2.0),
        "virtual.motor.presliding_angle": spread(rng, 0.5e-3, 20e-3),
        "virtual.motor.friction_noise": noise * 0.03e-3,
        "virtual.sensors.force_noise": noise * 2e-4,
        "virtual.sensors.force_resolution": spread(rng, 1e-3, 0.1),
        "rig.encoder_counts": int(spread(rng, 1000, 20000)) // 4 * 4,
        "rig.sample_time": float(rng.choice([125e-6, 250e-6, 500e-6, 1e-3])),
    }


def moving(rng: np.random.Generator) -> Settings:
    """Draw a rig like the thesis's that moves: inertia, friction by speed, ripple, instrument."""
    motor, tool = "virtual.motor.", "virtual.instrument."
    drawn = near(rng)
    return drawn | {
        # The data sheet's, as another motor's calibration is refused.
        "rig.torque_constant": drawn[motor + "torque_constant"],
        "calibrate_kt.temperatures_degc": [20, 35, 50],
        motor + "inertia": 1.51e-5 * rng.uniform(0.9, 1.1),
        motor + "stribeck_velocity": spread(rng, 0.2, 0.5),
        motor + "viscous_friction": spread(rng, 2e-5, 1e-4),
        motor + "viscous_modulation": f"[{{order=1, amplitude={rng.uniform(0, 0.6)}}}]",
        motor + "friction_noise_time": spread(rng, 0.05, 1.0),
        motor + "radial_friction": spread(rng, 2e-5, 8e-5),
        "virtual.amplifier.offset_ripple": ripple(rng, 8e-3),
        "virtual.thermal.ambient_degc": rng.uniform(21, 33),
        tool + "stiffness": spread(rng, 0.12, 0.4),
        tool + "damping": spread(rng, 4e-4, 1.2e-3),
        tool + "wheel_inertia": 3e-6 * rng.uniform(0.9, 1.1),
        tool + "grasper_inertia": spread(rng, 1e-6, 4e-6),
        tool + "friction": spread(rng, 5e-3, 15e-3),
        tool + "viscous_friction": spread(rng, 2e-5, 1e-4),
        tool + "tip_friction": spread(rng, 0.5e-3, 2e-3),
        tool + "load_friction": rng.uniform(0.03, 0.2),
        tool + "stroke_noise": spread(rng, 0.15e-3, 0.6e-3),
        tool + "stroke_payback": rng.uniform(0, 0.95),
    }


def moving_excited(rng: np.random.Generator) -> Settings:
    """Draw the same with another number of excited lines, and thus other phases, for each rig:
    errors by what an instrument distorts, or by what few periods leave of the run-up, are those of
    the phases, of one sign for all rigs."""
    return moving(rng) | {"identify_plant.lines": int(rng.integers(30, 50))}


def moving_far(rng: np.random.Generator) -> Settings:
    """Draw a rig far from the thesis's that moves: another motor, encoder, rate of samples."""
    constant = spread(rng, 0.01, 0.3)
    inertia = 1.51e-5 * (constant / 0.045) ** 1.5 * spread(rng, 0.5, 2)
    friction = spread(rng, 0.2, 8.0) * 2.3e-3 * math.sqrt(constant / 0.045)
    torques = [round(share * constant, 5) for share in (0.3, 0.8, 3.5)]
    return moving(rng) | {
        "rig.torque_constant": constant,
        "rig.inertia.rotor": inertia,
        "rig.inertia.encoder": 0.0,
        "rig.inertia.pulley": 0.0,
        "rig.encoder_counts": int(spread(rng, 1000, 20000)) // 4 * 4,
        "rig.sample_time": float(rng.choice([125e-6, 250e-6, 500e-6, 1e-3])),
        "fft_ripple.torques": torques,
        "virtual.motor.torque_constant": constant * rng.uniform(0.95, 1.05),
        "virtual.motor.inertia": inertia * rng.uniform(0.9, 1.1),
        "virtual.motor.coulomb_friction": friction,
        "virtual.motor.static_friction": friction * rng.uniform(1.0, 2.0),
        "virtual.motor.viscous_friction": friction * spread(rng, 0.01, 0.04),
        "virtual.motor.presliding_angle": spread(rng, 0.5e-3, 15e-3),
        "virtual.motor.friction_noise": friction * spread(rng, 0.01, 0.1),
        "stribeck.breakaway_limit": 6 * friction + 22 * 8e-5,
        "stribeck.breakaway_rate": (6 * friction + 22 * 8e-5) / 12,
    }


def turning_far(rng: np.random.Generator) -> Settings:
    """Draw a rig as `moving_far`; a coarse encoder only where ripple does not grow with i |i|.

    The steps of a coarse encoder make the current shake: the mean of i |i| is then more than the
    square of the mean, and the true ripple more than that of a steady current.
    """
    drawn = moving_far(rng)
    if int(str(drawn["rig.encoder_counts"])) < STEADY_COUNTS:
        drawn["virtual.amplifier.saturation_ripple"] = "[]"
    return drawn


def wrong(rng: np.random.Generator) -> Settings:
    """Draw a rig whose bench is wrong wherever it can be, as far as the recipe states."""
    drawn = moving(rng)
    length, linearity, degc, reading = 2e-3, 2e-3, 1.0, 3e-3
    weights, radius, grasper, ratio = 2e-3, 0.05e-3, 0.1e-3, 5e-3
    span = 4.0 * float(str(drawn["virtual.motor.torque_constant"])) / 0.540
    normal = rng.standard_normal
    return drawn | {
        "rig.arm.length_u": length,
        "rig.arm.gauge_linearity": linearity,
        "rig.thermometer_u": degc,
        "rig.current_reading_relative_u": reading,
        "rig.weights_relative_u": weights,
        "rig.pulley_radius_u": radius,
        "rig.instrument.grasper_length_u": grasper,
        "rig.instrument.angle_ratio_relative_u": ratio,
        "virtual.misstated.arm_length": length / 0.540 * normal(),
        "virtual.misstated.weights": weights * normal(),
        "virtual.misstated.pulley_radius": radius / 0.014 * normal(),
        "virtual.misstated.grasper_length": grasper / 0.020 * normal(),
        "virtual.misstated.angle_ratio": ratio * normal(),
        "virtual.sensors.force_gain": 1 + 3e-4 * normal(),
        "virtual.sensors.force_linearity": rng.uniform(-1, 1) * linearity / span,
        "virtual.sensors.force_resolution": spread(rng, 1e-4, 5e-3),
        "virtual.sensors.current_gain": 1 + reading * normal(),
        "virtual.sensors.temperature_offset": degc * normal(),
    }


def also(draw: Draw, settings: Settings) -> Draw:
    """Return a way to draw with some settings fixed."""
    return lambda rng: draw(rng) | settings


def grid(positions: int, *temperatures: float) -> Settings:
    """Return the settings of a grid of angles and temperatures."""
    return {
        "calibrate_kt.rotor_positions": positions,
        "calibrate_kt.temperatures_degc": list(temperatures),
    }


def coulomb(factor: float) -> Settings:
    """Return the settings of a rig with that many times the thesis's friction."""
    return {
        "virtual.motor.coulomb_friction": factor * 2.3e-3,
        "virtual.motor.static_friction": factor * 4.0e-3,
    }
