"""Properties of the rig known at the bench: parts, data sheets, gains, geometry.

An analysis may use all of them. `rigtool.recipe.virtual` holds the parameters that only the virtual
rig knows; no analysis reads those.
"""

import math
from typing import ClassVar, Literal, Self

from pydantic import Field, model_validator

from rigtool.recipe.base import Section

Attachment = Literal["pulley", "instrument"]


class Inertia(Section):
    """Moments of inertia of the parts, from data sheets and dimensions, kg m2 [7.2.3]."""

    rotor: float = Field(1.01e-5, gt=0, description="rotor of the motor, kg m2")
    encoder: float = Field(1.7e-7, ge=0, description="encoder disc, kg m2")
    pulley: float = Field(4.758e-6, ge=0, description="pulley on the motor shaft, kg m2")
    instrument_wheel: float = Field(
        0.0, ge=0, description="instrument's wheel seen from the motor shaft, kg m2"
    )

    def total(self, attachment: Attachment) -> float:
        """Return the inertia on the motor shaft with this attachment, kg m2."""
        wheel = self.instrument_wheel if attachment == "instrument" else 0.0
        return self.rotor + self.encoder + self.pulley + wheel


class Controller(Section):
    """Position controller by loop shaping: gain, lead, integrator and second-order low-pass.

    C(s) = k (s + wi)/s (s/wz + 1)/(s/wp + 1) / (s2/wl2 + 2 zl s/wl + 1), with |C P| = 1 at the
    crossover for the nominal inertia; wz = wc/lead_ratio, wp = wc lead_ratio.
    """

    crossover_hz: float = Field(50.0, gt=0, description="crossover of the open loop, Hz")
    lead_ratio: float = Field(
        3.0, gt=1, le=100, description="zero and pole of the lead around crossover"
    )
    integrator_hz: float = Field(4.0, ge=0, description="zero of the integrator, Hz; 0 for none")
    lowpass_hz: float = Field(400.0, gt=0, description="second-order low-pass, Hz")
    lowpass_damping: float = Field(
        0.7, ge=0.01, le=100, description="damping ratio of the low-pass"
    )


class Instrument(Section):
    """Geometry of the instrument as the thesis uses it [8.1]."""

    angle_ratio: float = Field(0.85, ge=1e-4, le=1e4, description="motor angle per grasper angle")
    torque_factor: float = Field(
        1.18,
        ge=1e-4,
        le=1e4,
        description="grasper torque per motor torque, as the thesis multiplies",
    )
    grasper_length: float = Field(0.020, gt=0, description="axis to where the load hangs, m")
    angle_ratio_relative_u: float = Field(
        0.0, ge=0, le=1, description="relative uncertainty of angle_ratio and torque_factor"
    )
    grasper_length_u: float = Field(0.0, ge=0, description="standard uncertainty of the length, m")


class ForceArm(Section):
    """Arm and force gauge with which the torque constant is calibrated [7.1.1]."""

    length: float = Field(0.540, gt=0, description="arm from shaft to gauge, m")
    length_u: float = Field(0.2e-3, ge=0, description="standard uncertainty of the length, m")
    gauge_relative_u: float = Field(
        3e-4, ge=0, le=1, description="relative standard uncertainty of the gauge's calibration"
    )
    gauge_resolution: float = Field(
        0.0, ge=0, description="step of its readings, N; a coarser one that they show counts"
    )
    gauge_linearity: float = Field(
        0.0, ge=0, le=1, description="largest deviation from a straight line, of the highest force"
    )


class MotorSuspension(Section):
    """Leaf springs that carry the motor, and eccentric pulleys [App. E, J]."""

    elasticity: float = Field(2.1e11, gt=0, description="modulus of the leaf springs, Pa")
    elasticity_relative_u: float = Field(0.02, ge=0, le=1, description="its relative uncertainty")
    length: float = Field(gt=0, description="of a leaf spring between its clamps, m")
    width: float = Field(gt=0, description="of a leaf spring, m")
    thickness: float = Field(gt=0, description="of a leaf spring, m")
    dimension_u: float = Field(1e-4, ge=0, description="standard uncertainty of these two, m")
    thickness_u: float = Field(1e-5, ge=0, description="standard uncertainty of the thickness, m")
    mass: float = Field(gt=0, description="of the motor and what moves with it, kg")
    pretension: float = Field(gt=0, description="with which the springs pull, N")
    motor_eccentricity: float = Field(ge=0, description="of the pulley on the motor, m")
    tool_eccentricity: float = Field(ge=0, description="of the pulley on the instrument, m")


MAX_VIRTUAL_SAMPLE_TIME = 0.01
"""Longest period of the virtual loop, s."""


class RigDescription(Section):
    """The rig as its owner describes it."""

    LARGEST_COUNT: ClassVar[int] = 2**32

    name: str = Field(min_length=1, description="which rig this is; tables belong to one rig")
    source: Literal["virtual", "serial"] = Field(
        "virtual", description="where signals come from: equations of [virtual], line of [serial]"
    )
    attachment: Attachment = Field(
        "instrument", description="what the motor drives: its bare pulley, or the instrument"
    )
    sample_time: float = Field(125e-6, gt=0, le=0.1, description="of the control loop, s")
    encoder_counts: int = Field(4000, ge=16, description="quad counts a turn")
    torque_constant: float = Field(0.045, gt=0, description="of the data sheet, N m/A")
    current_limit: float = Field(10.0, gt=0, description="of the amplifier, A")
    pulley_radius: float = Field(0.014, gt=0, description="effective, where a load hangs, m")
    pulley_radius_u: float = Field(0.0, ge=0, description="its standard uncertainty, m")
    weights_relative_u: float = Field(
        0.0, ge=0, le=1, description="relative standard uncertainty common to all applied forces"
    )
    thermometer_u: float = Field(
        0.0, ge=0, description="standard uncertainty common to all readings, K"
    )
    current_reading_relative_u: float = Field(
        0.0, ge=0, le=1, description="relative standard uncertainty of the gain of the reading"
    )
    inertia: Inertia = Inertia()
    controller: Controller = Controller()
    instrument: Instrument = Instrument()
    arm: ForceArm = ForceArm()
    suspension: MotorSuspension | None = None

    @model_validator(mode="after")
    def _loop_is_fast_enough(self) -> Self:
        if self.source == "virtual" and self.sample_time > MAX_VIRTUAL_SAMPLE_TIME:
            raise ValueError(
                f"sample_time of a virtual rig is at most {MAX_VIRTUAL_SAMPLE_TIME} s, got "
                f"{self.sample_time}: only slow lines need longer"
            )
        return self

    @property
    def nominal_inertia(self) -> float:
        """Moment of inertia on the motor shaft, from the parts, kg m2."""
        return self.inertia.total(self.attachment)

    @property
    def loop_design(self) -> dict[str, float]:
        """Controller, nominal inertia and sample time: what `control.position_loop` takes."""
        own = {"inertia": self.nominal_inertia, "sample_time": self.sample_time}
        return {**self.controller.model_dump(), **own}

    @property
    def count_angle(self) -> float:
        """Angle of the motor from one count of the encoder to the next, rad."""
        return 2 * math.pi / self.encoder_counts

    def motor_speed(self, rev_per_s: float) -> float:
        """Return the motor's speed, rad/s, for one of the output, rev/s."""
        return 2 * math.pi * rev_per_s * self.angle_ratio

    @property
    def angle_ratio(self) -> float:
        """Motor angle per output angle: 1 for the bare pulley."""
        return self.instrument.angle_ratio if self.attachment == "instrument" else 1.0

    @property
    def torque_factor(self) -> float:
        """Output torque per motor torque: 1 for the bare pulley."""
        return self.instrument.torque_factor if self.attachment == "instrument" else 1.0

    @property
    def load_arm(self) -> float:
        """Length at which a hanging load acts, m: grasper or pulley."""
        if self.attachment == "instrument":
            return self.instrument.grasper_length
        return self.pulley_radius

    @property
    def load_arm_u(self) -> float:
        """Standard uncertainty of that length, m."""
        if self.attachment == "instrument":
            return self.instrument.grasper_length_u
        return self.pulley_radius_u

    @property
    def loads_relative_u(self) -> float:
        """Relative standard uncertainty common to the torques of all hanging loads."""
        return math.hypot(self.weights_relative_u, self.load_arm_u / self.load_arm)

    @property
    def angle_ratio_relative_u(self) -> float:
        """Relative standard uncertainty of angle ratio and torque factor."""
        return self.instrument.angle_ratio_relative_u if self.attachment == "instrument" else 0.0
