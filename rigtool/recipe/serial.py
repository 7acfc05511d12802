"""A rig on a serial line: which drive, on which port, and what it must never exceed.

Limits have no defaults: only the person at the bench knows what the rig withstands.
"""

from typing import ClassVar, Literal, Self

from pydantic import Field, model_validator

from rigtool.recipe.base import Section


class Limits(Section):
    """What the drive must never exceed: checked before a motion, set in the drive, watched."""

    current: float = Field(gt=0, description="of the motor, either sign, A")
    speed: float = Field(gt=0, description="of the motor shaft, either sign, rad/s")
    position: tuple[float, float] = Field(
        description="lowest and highest of the motor shaft, on the drive's own zero, rad"
    )
    temperature_degc: float = Field(description="of the motor, where it is measured, degC")
    duration: float = Field(gt=0, description="of one motion, s")
    following_error: float = Field(
        2.0, gt=0, description="distance of the shaft from its set point, watched by the host, rad"
    )

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if not self.position[0] < self.position[1]:
            raise ValueError(f"position must be [lowest, highest], got {list(self.position)}")
        return self


class MeasuringInstrument(Section):
    """An instrument beside the drive, or the operator who reads one."""

    LARGEST_COUNT: ClassVar[int] = 2**31

    driver: str = Field(
        description='protocol, e.g. "mark10", "scpi", "number-lines"; "operator" asks who is there'
    )
    port: str | None = Field(
        None,
        description='its own serial port, or "visa:RESOURCE" for GPIB, USB and networks; none for '
        "the operator",
    )
    baud_rate: int | None = Field(None, gt=0, description="bit/s; none for the protocol's usual")
    frame: str = Field(
        "8N1", pattern="^[78][NEO][12]$", description="data bits, parity, stop bits of a character"
    )
    scale: float = Field(
        1.0,
        ge=-1e9,
        le=1e9,
        description="factor on what it reads; negative where its sign is the other way",
    )
    offset: float = Field(0.0, description="added to what it reads, in the unit of the channel")


class Serial(Section):
    """The drive of a rig, or a target that runs the loop, at the end of a serial line."""

    LARGEST_COUNT: ClassVar[int] = 2**31

    driver: str = Field(
        description='"target", "odrive", "moteus", "maxon", "cia402", "simplefoc", "vesc", or one '
        'that another package adds; "replay" plays back a file of --spy'
    )
    port: str = Field(
        min_length=1,
        description='"/dev/ttyACM0", "COM5", any URL of pyserial; "can:INTERFACE:CHANNEL?..." for '
        'a CAN bus; for "replay" a file of --spy',
    )
    baud_rate: int | None = Field(None, gt=0, description="bit/s; none for the driver's usual")
    node: int = Field(0, ge=0, description="axis or address of the drive on this line")
    eds: str | None = Field(None, description="file of its maker that describes a CANopen drive")
    speed_unit_rpm: float | None = Field(
        None,
        gt=0,
        le=1e5,
        description="unit of speed of a CANopen drive that does not state it (60A9), rpm",
    )
    drive_torque_constant: float | None = Field(
        None,
        description="of an ODrive on a CAN bus, as set in the drive, negative where its direction "
        "is -1, N m/A",
    )
    limits: Limits
    watchdog: float = Field(
        0.25, gt=0, le=10, description="the drive stops by itself after silence this long, s"
    )
    log: Literal["memory", "stream"] = Field(
        "memory", description="a target keeps its log until the run is over, or sends it meanwhile"
    )
    position_gain: float = Field(
        10.0, gt=0, le=1e4, description="of the host, where a drive takes speeds only, (rad/s)/rad"
    )
    force: MeasuringInstrument | None = Field(None, description="force gauge at the end of the arm")
    temperature: MeasuringInstrument | None = Field(None, description="thermometer on the motor")
    deflection: MeasuringInstrument | None = Field(
        None, description="micrometer at the motor on its leaf springs"
    )
    emergency_stop: bool = Field(
        False,
        description="is wired, tried and within reach: a drive without watchdog needs one "
        "(maxon, SimpleFOC)",
    )
    operator: bool = Field(
        True, description="somebody is there to hang loads, clamp, heat and switch off"
    )

    @property
    def instruments(self) -> dict[str, MeasuringInstrument]:
        """The instruments beside the drive, by their channels."""
        given = {name: getattr(self, name) for name in ("force", "temperature", "deflection")}
        return {name: settings for name, settings in given.items() if settings is not None}
