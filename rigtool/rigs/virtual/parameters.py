"""The rig's parameters as the compiled step takes them, under a load; the rig as it is."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from rigtool.quantity import STANDARD_GRAVITY
from rigtool.recipe.base import Section
from rigtool.recipe.rig import RigDescription
from rigtool.recipe.virtual import Hand, Virtual
from rigtool.rigs.base import Load
from rigtool.rigs.virtual import layout
from rigtool.rigs.virtual.tendon import step_terms


def true_rig(stated: RigDescription, virtual: Virtual) -> RigDescription:
    """Return the rig as it is, where the recipe states it wrongly."""
    wrong, arm, instrument = virtual.misstated, stated.arm, stated.instrument
    ratio = 1 + wrong.angle_ratio
    true_instrument = {
        "angle_ratio": instrument.angle_ratio * ratio,
        "torque_factor": instrument.torque_factor / ratio,
        "grasper_length": instrument.grasper_length * (1 + wrong.grasper_length),
    }
    true_rig = {
        "pulley_radius": stated.pulley_radius * (1 + wrong.pulley_radius),
        "arm": arm.model_copy(update={"length": arm.length * (1 + wrong.arm_length)}),
        "instrument": instrument.model_copy(update=true_instrument),
    }
    return stated.model_copy(update=true_rig)


def parameters(
    rig: RigDescription,
    v: Virtual,
    load: Load,
    *,
    assumed_torque_constant: float,
    clamp_angle: float,
    hand: Hand | None,
) -> NDArray[np.void]:
    """Return the record (1,) of the parameters of a task under this load, in SI.

    `rig` is as it is, `clamp_angle` where the rotor is clamped, `hand` what holds the output.
    """
    motor, amplifier, thermal, own = v.motor, v.amplifier, v.thermal, v.instrument
    dt, tick = rig.sample_time, rig.sample_time * layout.SLOW_STEP_SAMPLES
    instrument = rig.attachment == "instrument"
    force = load.force * (1 + v.misstated.weights)
    mass = force / STANDARD_GRAVITY
    hanging = 0.0 if instrument else force * rig.pulley_radius
    inertia = motor.inertia + (v.arm.inertia if load.clamped else 0.0)
    if instrument:
        inertia += own.wheel_inertia
    else:
        inertia += mass * rig.pulley_radius**2
    grasper_inertia = own.grasper_inertia + mass * rig.instrument.grasper_length**2
    mobility = 1 / (rig.instrument.angle_ratio * rig.instrument.torque_factor * inertia)
    tendon_angle, tendon_speed, tendon_share = step_terms(
        own.stiffness, own.damping, mobility + 1 / grasper_inertia, dt
    )
    lag = 2 * math.pi * amplifier.bandwidth_hz * dt
    noise_decay = math.exp(-tick / motor.friction_noise_time)
    drift_decay = math.exp(-tick / own.drift_time)
    radial = motor.radial_friction * load.radial_force * (1 + v.misstated.weights)
    values = {
        "dt": dt,
        "encoder_counts": rig.encoder_counts,
        "assumed_torque_constant": assumed_torque_constant,
        "current_limit": rig.current_limit,
        "inertia": inertia,
        "torque_constant": motor.torque_constant,
        "torque_constant_coefficient": motor.torque_constant_temperature_coefficient,
        "coulomb": motor.coulomb_friction + radial,
        "static": motor.static_friction + radial,
        "viscous": motor.viscous_friction,
        "asymmetry": motor.friction_asymmetry,
        **_named(motor, "stribeck_velocity", "presliding_angle", "presliding_damping"),
        "noise_decay": noise_decay,
        "noise_gain": motor.friction_noise * math.sqrt(1 - noise_decay**2),
        **_named(amplifier, "gain", "offset", "distortion", "distortion_period"),
        "current_step": -math.expm1(-lag),
        "current_kept": -math.expm1(-lag) / lag,
        "ripple_step": 1 - math.exp(-2 * math.pi * amplifier.ripple_corner_hz * dt),
        "resistance": thermal.winding_resistance,
        **_named(thermal, "winding_to_housing", "winding_capacity", "ambient_degc"),
        **_named(thermal, "housing_to_ambient", "housing_capacity"),
        "load_torque": load.torque + hanging,
        "clamped": load.clamped,
        "clamp_angle": clamp_angle,
        "arm_stiffness": v.arm.stiffness,
        "arm_damping": v.arm.damping,
        "instrument": instrument,
        **_named(rig.instrument, "angle_ratio", "torque_factor"),
        "tendon_angle": tendon_angle,
        "tendon_speed": tendon_speed,
        "tendon_share": tendon_share,
        "grasper_inertia": grasper_inertia,
        "load_moment": force * rig.instrument.grasper_length,
        "housing_friction": own.friction,
        "housing_asymmetry": own.friction_asymmetry,
        "housing_viscous": own.viscous_friction,
        "housing_presliding_angle": own.presliding_angle,
        **_named(own, "stiffness", "damping", "tip_friction", "tip_presliding_angle"),
        **_named(own, "load_friction", "load_friction_onset"),
        **_named(own, "stroke_noise", "stroke_payback", "load_stroke_noise"),
        "drift_decay": drift_decay,
        "drift_gain": own.drift * math.sqrt(1 - drift_decay**2),
        "load_inertia": mass * rig.load_arm**2,
        "inertia_per_weight": rig.load_arm / STANDARD_GRAVITY,
        "grip_stiffness": 0.0 if hand is None else hand.stiffness,
        "grip_damping": 0.0 if hand is None else hand.damping,
    }
    return np.array([tuple(values.values())], dtype=[(name, "f8") for name in values])


def _named(section: Section, *names: str) -> dict[str, float]:
    """Return values of a table of the recipe that have the same names in the compiled step."""
    return {name: getattr(section, name) for name in names}
