"""What the compiled step takes and returns: its state, columns of its arrays."""

from __future__ import annotations

import numpy as np

SLOW_STEP_SAMPLES = 16
"""Samples between updates of slow states: temperatures, friction noise, drift."""

_NUMBERS = (
    *("angle", "speed", "bristle", "current", "ripple", "friction_noise"),
    *("winding_degc", "housing_degc", "grasper_angle", "grasper_speed"),
    *("housing_bristle", "tip_bristle", "drift", "direction"),
    *("stroke_sine", "stroke_cosine", "stroke_load", "contact"),
)
STATE = np.dtype(
    [(name, "f8") for name in _NUMBERS]
    # random numbers of each direction's last stroke: (negative, positive) x (sine, cosine, load)
    + [("drawn", "f8", (2, 3))]
    # set point of the last sample
    + [("setpoint", "f8")]
)

# Columns of the map by rotor angle, and of the map by grasper angle
OFFSET_RIPPLE, GAIN_RIPPLE, SATURATION_RIPPLE, COGGING, VISCOUS_MODULATION = range(5)

# Columns of the contacts at the output, and of each tissue
FORCE_TORQUE, WEIGHT_MOMENT, HAND_ANGLE, HAND_SPEED = range(4)
TISSUE_BEGIN, TISSUE_END, TISSUE_ANGLE, TISSUE_STIFFNESS, TISSUE_DAMPING = range(5)

# Columns of the returned array
(
    ENCODER,
    CURRENT_SETPOINT,
    CURRENT,
    ARM_TORQUE,
    TEMPERATURE,
    POSITION_SETPOINT,
    FEEDFORWARD_CURRENT,
    TABLE_CURRENT,
    SIGNAL_CURRENT,
    REFERENCE_TORQUE,
) = COLUMNS = range(10)
