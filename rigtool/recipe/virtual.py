"""Physical parameters of the virtual rig: values that are not known at a real bench.

Only `rigtool.rigs.virtual` reads these. Angles in rad, torques in N m at the shaft named, SI
throughout; temperatures in degC.
"""

from typing import Annotated, ClassVar, Literal, Self

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from rigtool.recipe.base import Positive, Section

MAX_ORDER = 200
"""Highest order of rotation that a recipe may name."""


class Order(Section):
    """One order of rotation: amplitude * cos(order * angle + phase)."""

    order: int = Field(ge=1, le=MAX_ORDER, description="cycles a turn")
    amplitude: float = Field(ge=0, le=100, description="in the unit of what it modulates")
    phase: float = Field(0.0, description="rad")


class DrawnOrder(Section):
    """One order whose phase and amplitude each power-up draws anew."""

    order: int = Field(ge=1, le=MAX_ORDER, description="cycles a turn")
    amplitude: float = Field(ge=0, le=100, description="typical, in the unit of what it modulates")


class Motor(Section):
    """Motor with its bearings; friction is a pre-sliding (bristle) model of Stribeck type."""

    torque_constant: float = Field(gt=0, description="at 20 degC, N m/A")
    torque_constant_temperature_coefficient: float = Field(description="relative, 1/K")
    inertia: float = Field(gt=0, description="on the shaft with pulley, kg m2")
    coulomb_friction: float = Field(ge=0, description="N m")
    static_friction: float = Field(ge=0, description="N m")
    stribeck_velocity: float = Field(gt=0, description="rad/s")
    viscous_friction: float = Field(ge=0, description="N m s/rad")
    viscous_modulation: tuple[Order, ...] = Field((), description="relative, by rotor angle")
    friction_asymmetry: float = Field(0.0, description="relative, positive direction higher")
    radial_friction: float = Field(0.0, ge=0, description="friction per radial force, N m/N")
    presliding_angle: float = Field(gt=0, description="deflection of the bristles, rad")
    presliding_damping: float = Field(0.0, ge=0, description="s, relative to bristle stiffness")
    friction_noise: float = Field(0.0, ge=0, description="std of random friction, N m")
    friction_noise_time: float = Field(0.15, gt=0, description="its correlation time, s")
    cogging: tuple[Order, ...] = Field((), description="N m")


class Thermal(Section):
    """Two thermal masses: winding and housing; the torque constant follows the winding."""

    ambient_degc: float = Field(22.0, description="of the room, degC")
    winding_resistance: float = Field(gt=0, description="ohm at 20 degC")
    winding_to_housing: float = Field(gt=0, description="K/W")
    winding_capacity: float = Field(gt=0, description="J/K")
    housing_to_ambient: float = Field(gt=0, description="K/W")
    housing_capacity: float = Field(gt=0, description="J/K")


class Amplifier(Section):
    """Current amplifier with what its start-up calibration leaves behind [7.1.3, App. F]."""

    gain: float = Field(1.0, ge=1e-3, le=1e3, description="current delivered per current asked for")
    offset: float = Field(0.0, description="A")
    bandwidth_hz: float = Field(1500.0, gt=0, description="of the current loop, Hz")
    offset_ripple: tuple[DrawnOrder, ...] = Field((), description="A, whatever the current")
    gain_ripple: tuple[DrawnOrder, ...] = Field((), description="relative to the current")
    saturation_ripple: tuple[DrawnOrder, ...] = Field((), description="relative, 1/A")
    amplitude_spread: float = Field(0.0, ge=0, le=1, description="relative, between power-ups")
    ripple_corner_hz: float = Field(gt=0, description="lag with which the ripple acts, Hz")
    distortion: float = Field(0.0, ge=0, description="fault at low current, A (App. C)")
    distortion_period: float = Field(0.02, gt=0, description="its period in current, A")


class Sensors(Section):
    """Noise and error of what is read."""

    current_noise: float = Field(0.0, ge=0, description="std a sample, A")
    force_noise: float = Field(0.0, ge=0, description="std a sample, N")
    force_gain: float = Field(1.0, ge=1e-3, le=1e3, description="gauge reading per newton")
    force_linearity: float = Field(
        0.0, ge=-1, le=1, description="change of that gain with the force, 1/N"
    )
    force_resolution: float = Field(1e-3, ge=0, description="N")
    current_gain: float = Field(1.0, ge=0.1, le=10, description="current reading per ampere")
    temperature_noise: float = Field(0.0, ge=0, description="std a sample, K")
    temperature_offset: float = Field(0.0, description="of the thermometer, K")
    micrometer_error: float = Field(0.0, ge=0, description="std of a reading, m")


Relative = Annotated[float, Field(gt=-0.5, le=0.5)]


class Misstated(Section):
    """By how much the truth differs from what [rig] and the plan state, relative to that."""

    arm_length: Relative = Field(0.0, description="of rig.arm.length")
    pulley_radius: Relative = Field(0.0, description="of rig.pulley_radius")
    grasper_length: Relative = Field(0.0, description="of rig.instrument.grasper_length")
    angle_ratio: Relative = Field(
        0.0, description="of rig.instrument.angle_ratio; its torque_factor by the inverse"
    )
    weights: Relative = Field(0.0, description="of all forces that are hung or pulled with")


class Arm(Section):
    """The arm that presses on the force gauge."""

    inertia: float = Field(gt=0, description="kg m2")
    stiffness: float = Field(gt=0, description="arm bending and gauge, N m/rad")
    damping: float = Field(ge=0, description="N m s/rad")


class Eccentricity(Section):
    """Eccentric pulleys against the leaf springs [App. E, J]."""

    spring_constant: float = Field(14.5e3, ge=0, description="of the leaf springs, N/m")
    offset: float = Field(60e-6, ge=0, description="both eccentricities together, m")


class VirtualInstrument(Section):
    """Tendon and grasper: second mass on a spring, with friction on both sides of it [8]."""

    stiffness: float = Field(gt=0, description="at the grasper, N m/rad")
    damping: float = Field(ge=0, description="at the grasper, N m s/rad")
    wheel_inertia: float = Field(ge=0, description="seen from the motor shaft, kg m2")
    grasper_inertia: float = Field(gt=0, description="about the grasper's axis, kg m2")
    friction: float = Field(ge=0, description="of housing and shaft at the motor shaft, N m")
    friction_orders: tuple[Order, ...] = Field(
        (), description="its dependence on the grasper angle, relative"
    )
    friction_asymmetry: float = Field(0.0, description="relative, positive direction higher")
    viscous_friction: float = Field(0.0, ge=0, description="at the motor shaft, N m s/rad")
    presliding_angle: float = Field(gt=0, description="at the motor shaft, rad")
    tip_friction: float = Field(ge=0, description="at the grasper, N m")
    tip_presliding_angle: float = Field(gt=0, description="at the grasper, rad")
    load_friction: float = Field(ge=0, le=10, description="friction per torque carried")
    load_friction_onset: float = Field(
        gt=0, description="torque below which pre-tension hides the load friction, N m"
    )
    stroke_noise: float = Field(ge=0, description="std of friction from stroke to stroke, N m")
    stroke_payback: float = Field(
        ge=0, le=1, description="part of a stroke's deviation that the next one returns"
    )
    load_stroke_noise: float = Field(ge=0, description="std of the load friction, relative")
    drift: float = Field(ge=0, description="std of slow friction drift, N m")
    drift_time: float = Field(gt=0, description="its correlation time, s")


def _pair(value: object) -> object:
    """Take one number as a range without width."""
    return (value, value) if isinstance(value, int | float) else value


def _ascending(ends: tuple[float, float]) -> tuple[float, float]:
    if ends[0] > ends[1]:
        raise ValueError(f"runs from {ends[0]:g} down to {ends[1]:g}: swap the two ends")
    return ends


_Between = (BeforeValidator(_pair), AfterValidator(_ascending))
HighestForce = Annotated[float, Field(ge=-1000, le=1000)]
Newtons = Annotated[tuple[HighestForce, HighestForce], *_Between]
Frequency = Annotated[float, Field(gt=0, le=1000)]
Hertz = Annotated[tuple[Frequency, Frequency], *_Between]
PositiveRange = Annotated[tuple[Positive, Positive], *_Between]


class VirtualContact(Section):
    """When something touches the output: at given times, or drawn from the seed.

    Times count from the start of each motion that is open to contacts. A number, or the two ends
    of a range from which each contact draws its own value. Forces act at the end of the grasper,
    or at the radius of the pulley; positive ones resist positive motion.
    """

    at: tuple[Annotated[float, Field(ge=0)], ...] = Field((), description="s after the start")
    rate_per_min: float | None = Field(
        None, gt=0, le=600, description="drawn instead of `at`: contacts a minute without contact"
    )
    duration: PositiveRange | None = Field(
        None, description="s; until the motion ends where not given"
    )

    @model_validator(mode="after")
    def _has_its_times(self) -> Self:
        if bool(self.at) == (self.rate_per_min is not None):
            raise ValueError("needs either `at`, the times, or `rate_per_min`, to draw them")
        if self.rate_per_min is not None and self.duration is None:
            raise ValueError("a contact that is drawn with `rate_per_min` needs a `duration`")
        return self


class Eased(VirtualContact):
    """A contact that comes and goes within a time of its own."""

    rise_time: float = Field(0.05, ge=0, description="to the full force, and from it, s")

    @model_validator(mode="after")
    def _reaches_full_force(self) -> Self:
        if self.duration is not None and self.duration[0] < 2 * self.rise_time:
            raise ValueError(
                f"duration {self.duration[0]:g} s is shorter than twice the rise_time of "
                f"{self.rise_time:g} s, so that the force would not be reached"
            )
        return self


class Pulse(Eased):
    """A force that rises linearly, stays, and falls linearly."""

    kind: Literal["pulse"]
    force: Newtons = Field(description="N")


class Mass(Eased):
    """A mass that is hung on, at the speed of the output, and taken off."""

    kind: Literal["mass"]
    force: Annotated[
        tuple[Annotated[float, Field(gt=0, le=1000)], Annotated[float, Field(gt=0, le=1000)]],
        *_Between,
    ] = Field(description="weight, N")


class Sine(VirtualContact):
    """A force that swings around zero, beginning there."""

    kind: Literal["sine"]
    force: Newtons = Field(description="amplitude, N")
    frequency_hz: Hertz = Field(description="Hz")


class Ramp(VirtualContact):
    """A force that rises linearly from zero, and lets go at once."""

    kind: Literal["ramp"]
    force: Newtons = Field(description="at the end, N")
    duration: PositiveRange = Field(description="of the rise, s")


class Tissue(VirtualContact):
    """Spring and damper from an angle of the output on; tissue pushes, and never pulls."""

    kind: Literal["tissue"]
    angle_deg: float = Field(ge=-3600, le=3600, description="of the output, where it begins, deg")
    stiffness: PositiveRange = Field(description="at the output, N m/rad")
    damping: float = Field(0.0, ge=0, le=10, description="at the output, N m s/rad")


AnyContact = Annotated[Pulse | Mass | Sine | Ramp | Tissue, Field(discriminator="kind")]


class Hand(Section):
    """A hand, or another controller, that moves the rig while it is observed: drawn free motion.

    Each stretch of time has its pace, or is a pause; the direction changes as a sum of sines does.
    """

    moves: Literal["motor", "output"] = Field(
        "motor",
        description="motor: another controller moves it and makes its current; output: a hand "
        "moves the output, which is a force there, and the motor has no current",
    )
    angle_deg: tuple[float, float] = Field((0.0, 180.0), description="range at the output, deg")
    speed_rev_per_s: PositiveRange = Field(
        (0.3, 2.0), description="each stretch draws its highest, of the motor, rev/s"
    )
    stretch: Annotated[
        tuple[Annotated[float, Field(ge=0.01)], Annotated[float, Field(ge=0.01)]], *_Between
    ] = Field((1.0, 8.0), description="how long a pace lasts, s")
    pause_share: float = Field(0.3, ge=0, lt=1, description="part of the stretches that rest")
    stiffness: float = Field(2.0, gt=0, le=1000, description="of the hand's grip, N m/rad")
    damping: float = Field(0.02, ge=0, le=10, description="of the hand's grip, N m s/rad")

    @model_validator(mode="after")
    def _has_room(self) -> Self:
        low, high = self.angle_deg
        if not high - low >= 1.0:
            raise ValueError(
                f"angle_deg leaves {high - low:g} deg to move in, at least 1 is needed"
            )
        return self


class Virtual(Section):
    """The simulated rig."""

    LARGEST_COUNT: ClassVar[int] = 2**62

    seed: int = Field(1, ge=0, description="of everything random")
    power_cycle: int = Field(0, ge=0, description="which start-up of the amplifier this is")
    motor: Motor
    thermal: Thermal
    amplifier: Amplifier
    sensors: Sensors = Sensors()
    misstated: Misstated = Misstated()
    arm: Arm
    eccentricity: Eccentricity = Eccentricity()
    instrument: VirtualInstrument
    contact: tuple[AnyContact, ...] = ()
    hand: Hand = Hand()
