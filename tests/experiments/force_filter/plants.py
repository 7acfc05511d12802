"""A plant for the tests of this room: of the size of a small motor with an instrument."""

import math

import numpy as np

from rigtool.experiments.force_filter.kalman import Uncertainty
from rigtool.experiments.force_filter.plant import Plant

TURN = np.linspace(0, 2 * np.pi, 721)

PLANT = Plant(
    sample_time=125e-6,
    inertia=2e-5,
    coulomb=2e-3,
    static=3e-3,
    stribeck_velocity=0.3,
    asymmetry=0.02,
    presliding_angle=2e-3,
    presliding_damping=5e-4,
    angle_ratio=0.85,
    torque_factor=1.18,
    stiffness=0.2,
    damping=8e-4,
    grasper_inertia=2e-6,
    housing_friction=9e-3,
    housing_asymmetry=0.03,
    housing_viscous=4e-5,
    housing_presliding_angle=8e-3,
    tip_friction=1e-3,
    tip_presliding_angle=5e-3,
    load_friction=0.102,
    load_friction_onset=1.8e-3,
    friction_map=np.stack([1 + 0.1 * np.cos(TURN), 0.03 * np.sin(TURN)], axis=1),
)

UNCERTAINTY = Uncertainty(
    stroke=0.3e-3, load_stroke=0.01, friction_noise=0.1e-3, friction_noise_time=0.15
)


def dahl(deflection, path, presliding_angle):
    """Return a bristle's deflection after a path in one direction, exactly."""
    side = math.copysign(1.0, path)
    return side - (side - deflection) * math.exp(-abs(path) / presliding_angle)
