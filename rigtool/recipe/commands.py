"""Settings of each command: motions, loads, speeds, durations, with their defaults."""

from typing import Any, Literal, Self

from pydantic import Field, model_validator

from rigtool.recipe.base import Positive, Section


def averaged(samples: int) -> Any:
    """Return the field of a default of `record_every`, for loops of 8 kHz."""
    return Field(
        samples,
        ge=1,
        description="samples averaged into a recorded one; the default is for 8 kHz, and other "
        "loops average for as long",
    )


def require_different_speeds(speeds: tuple[float, ...], low_speeds: tuple[float, ...]) -> None:
    """Raise ValueError for a speed listed twice, or a low speed above the lowest learned one."""
    every = (*low_speeds, *speeds)
    if len(set(every)) < len(every):
        raise ValueError("a speed is listed twice in speeds_rev_per_s and low_speeds_rev_per_s")
    if max(low_speeds, default=0) > min(speeds):
        raise ValueError(
            f"low_speeds_rev_per_s holds {max(low_speeds)}, all of them must be below the lowest "
            f"of speeds_rev_per_s, {min(speeds)}"
        )


def require_straight_part(name: str, end: float, angle: float) -> None:
    """Raise ValueError where the two ends, deg, of a move take all of its angle, deg."""
    if 2 * end >= angle:
        raise ValueError(
            f"{name} {end} deg at both ends leaves nothing of the angle {angle} deg: lower it"
        )


class CalibrateKt(Section):
    """Staircases of current against a force gauge, at several temperatures [7.1.1]."""

    temperatures_degc: tuple[float, ...] = Field(
        (20, 25, 30, 35, 40, 45, 50), min_length=2, description="of the motor, degC"
    )
    rotor_positions: int = Field(
        8, ge=1, description="angles of the arm around the turn, others at each temperature"
    )
    current_max: float = Field(4.0, gt=0, description="top of the staircase, A")
    steps: int = Field(16, ge=3, description="from zero to the top")
    staircases: int = Field(2, ge=1, description="up and down, in a row at each clamping")
    step_time: float = Field(0.4, gt=0, description="each step lasts, s")
    settle_time: float = Field(0.15, ge=0, description="left out of each step, s")
    reference_range_degc: tuple[float, float] = Field(
        (20, 35), description="range over which one constant value is judged, degC"
    )
    record_every: int = averaged(32)


class Stribeck(Section):
    """Sweep, holds and breakaway ramps [7.1.2, 7.2.1, 7.2.2]."""

    speed_max: float = Field(30.0, gt=0, description="of the sweep, rad/s")
    sweep_time: float = Field(60.0, gt=0, description="from one end to the other, s")
    hold_speeds: tuple[Positive, ...] = Field(
        (0.4, 0.45, 0.5, 0.55, 0.6, 0.75, 1, 2, 3, 5, 8, 12, 16, 20, 25, 30),
        min_length=3,
        description="rad/s",
    )
    hold_revolutions: int = Field(2, ge=1, description="whole turns at each speed, at least")
    hold_time: float = Field(5.0, gt=0, description="at each speed, at least, s")
    breakaway_positions: int = Field(24, ge=3, description="rotor angles of the ramps")
    breakaway_rate: float = Field(1e-3, gt=0, description="slope of the ramp, N m/s")
    breakaway_limit: float = Field(12e-3, gt=0, description="highest torque of the ramp, N m")
    breakaway_angle: float = Field(0.02, gt=0, description="motion that counts as breakaway, rad")
    radial_force: float = Field(22.0, ge=0, description="load of the second series, N")
    record_every: int = averaged(8)


class FftRipple(Section):
    """Constant speeds, constant torques and power cycles [7.1.3]."""

    speeds: tuple[Positive, ...] = Field(
        (3, 6, 9, 12, 15, 18, 21, 24, 27, 30), min_length=1, description="rad/s"
    )
    revolutions: int = Field(20, ge=2, description="whole turns averaged")
    torques: tuple[Positive, ...] = Field(
        (14e-3, 37e-3, 160e-3), description="constant torque on the shaft, N m"
    )
    slow_speed_rev_per_s: float = Field(
        0.2, gt=0, description="for the torques and the power cycles, rev/s"
    )
    power_cycles: int = Field(2, ge=0, description="start-ups of the amplifier compared")
    record_every: int = averaged(4)


class IdentifyPlant(Section):
    """Frequency response of the plant by a multisine, while the shaft moves [7.2.3, Fig. 35]."""

    speeds: tuple[Positive, ...] = Field(
        (10, 15), min_length=1, description="while turning freely, both directions, rad/s"
    )
    stroke_speeds: tuple[Positive, ...] = Field(
        (4.4,), min_length=1, description="the same on a limited angle (instrument), about, rad/s"
    )
    realisations: int = Field(3, ge=1, description="sets of random phases at each speed")
    periods: int = Field(16, ge=2, description="of the multisine, in each direction and set")
    period: float = Field(0.25, gt=0, description="of the multisine, s")
    settle_time: float = Field(0.1, ge=0, description="left out after each change of speed, s")
    lines: int = Field(40, ge=8, description="frequencies, evenly in logarithm, at most")
    frequency_min: float = Field(4.0, gt=0, description="lowest excited frequency, Hz")
    frequency_max: float = Field(250.0, gt=0, description="highest excited frequency, Hz")
    swing: float = Field(
        0.7, gt=0, lt=1, description="peak of the excited speed, relative to the shaft's speed"
    )
    current_share: float = Field(
        0.5, gt=0, lt=1, description="of the current limit that the excitation may use"
    )
    angle: float = Field(180.0, gt=0, description="of a stroke at the output, deg (instrument)")
    turn_angle: float = Field(20.0, gt=0, description="used to reverse at each end, deg")

    @model_validator(mode="after")
    def _frequencies_fit_period(self) -> Self:
        if self.frequency_min * self.period < 1 - 1e-9:
            raise ValueError(
                f"frequency_min {self.frequency_min} Hz has less than one cycle in the period of "
                f"{self.period} s: raise either"
            )
        if self.frequency_max <= self.frequency_min:
            raise ValueError(
                f"frequency_max {self.frequency_max} Hz must be above frequency_min "
                f"{self.frequency_min} Hz"
            )
        require_straight_part("turn_angle", self.turn_angle, self.angle)
        return self


class LearnLoads(Section):
    """Known loads that implementation D learns from, lifted and lowered as measure_force does."""

    forces: tuple[Positive, ...] = Field(
        (0.03, 0.12, 0.5, 1.5, 3.0),
        min_length=2,
        description="hung on in turn, N; the largest one bounds what can be measured",
    )
    speeds_rev_per_s: tuple[Positive, ...] = Field(
        (0.2, 0.5, 1, 2), min_length=1, description="of the output, rev/s"
    )
    cycles: int = Field(
        30,
        ge=5,
        description="rising and falling, for each load and speed; 3 whole ones between those that "
        "run in and out show how strokes scatter",
    )
    record_every: int = averaged(16)

    @model_validator(mode="after")
    def _loads_and_speeds_differ(self) -> Self:
        for name, values in (("forces", self.forces), ("speeds_rev_per_s", self.speeds_rev_per_s)):
            if len(set(values)) < len(values):
                raise ValueError(f"{name} lists a value twice: each is learned once")
        return self


class Turning(Section):
    """Whole turns of the bare motor: implementations A and B [7.2.4.2]."""

    speeds_rev_per_s: tuple[Positive, ...] = Field(
        (1, 2, 3, 4, 5), min_length=1, description="both directions, rev/s; A learns at the lowest"
    )
    low_speeds_rev_per_s: tuple[Positive, ...] = Field(
        (0.05, 0.1, 0.2, 0.5), description="for the amplitude tables below the lowest speed, rev/s"
    )
    revolutions: int = Field(20, ge=3, description="averaged at each speed")
    low_speed_revolutions: int = Field(3, ge=3, description="the same for the low speeds")
    sweep_time: float = Field(60.0, gt=0, description="from one end of the speeds to the other, s")
    record_every: int = averaged(4)

    @model_validator(mode="after")
    def _speeds_differ(self) -> Self:
        require_different_speeds(self.speeds_rev_per_s, self.low_speeds_rev_per_s)
        return self


class Trajectory(Section):
    """The repeated move of standard learning, which learns by time [7.2.4.1]."""

    speed_rev_per_s: float = Field(1.0, gt=0, description="of the output, about, rev/s")
    angle: float = Field(180.0, gt=0, description="of the move at the output, deg")
    turn_angle: float = Field(40.0, gt=0, description="used to reverse at each end, deg")
    moves: int = Field(10, ge=3, description="to and fro, averaged in each run")

    @model_validator(mode="after")
    def _turn_fits(self) -> Self:
        require_straight_part("turn_angle", self.turn_angle, self.angle)
        return self


class IlcLearn(Section):
    """Learning by position and speed; speeds, moves and angles are those of C [7.2.4]."""

    implementation: Literal["A", "B", "C", "D", "standard"] = Field(
        "C", description="way to learn, by the thesis's letter"
    )
    speeds_rev_per_s: tuple[Positive, ...] = Field(
        (0.2, 1, 2, 3, 4, 5), min_length=1, description="learned in both directions, rev/s"
    )
    low_speeds_rev_per_s: tuple[Positive, ...] = Field(
        (0.05, 0.1), description="for the amplitude table below the lowest speed, rev/s"
    )
    moves: int = Field(20, ge=2, description="averaged in each direction")
    low_speed_moves: int = Field(2, ge=1, description="the same for the low speeds")
    angle: float = Field(180.0, gt=0, description="of the move at the output, deg")
    end_angle: float = Field(45.0, gt=0, description="left out at each end, deg")
    turn_angle: float = Field(20.0, gt=0, description="used to reverse at each end, deg")
    robustness_hz: float = Field(100.0, gt=0, description="cut-off of the Q filter, Hz")
    robustness_order: int = Field(4, ge=1, le=10, description="of the Butterworth in Q")
    learning_factor: float = Field(1.0, gt=0, lt=2, description="p in f + p L q")
    iterations: int | None = Field(
        None, ge=1, description="learning runs at most; without it A and standard ten, others one"
    )
    validation: bool = Field(
        False, description="also sweep, and turn at speeds that were not learned, table off and on"
    )
    learning_filter: Literal["zpetc", "frf"] = Field(
        "zpetc", description="L: zero-phase inverse of the model, or inverse of the measured FRF"
    )
    cancel_radius: float = Field(
        0.999, gt=0, lt=1, description="zeros of T outside are not cancelled by ZPETC"
    )
    turning: Turning = Turning()
    trajectory: Trajectory = Trajectory()
    loads: LearnLoads = LearnLoads()

    @model_validator(mode="after")
    def _turn_fits_end(self) -> Self:
        if self.turn_angle >= self.end_angle:
            raise ValueError(
                f"turn_angle {self.turn_angle} deg must be below end_angle {self.end_angle} deg: "
                "the reversal has to end before the part that is used begins"
            )
        require_straight_part("end_angle", self.end_angle, self.angle)
        return self

    @model_validator(mode="after")
    def _speeds_differ(self) -> Self:
        require_different_speeds(self.speeds_rev_per_s, self.low_speeds_rev_per_s)
        return self


class ForceMotion(Section):
    """How measure-force moves while it reads a force over time; angles are those of the output."""

    kind: Literal["strokes", "sine", "hold", "path"] = Field(
        "strokes", description="strokes of measure_force; sine over its angle; or a path's file"
    )
    frequency_hz: float = Field(0.3, gt=0, le=100, description="of the sine, Hz")
    file: str | None = Field(
        None,
        description="of the path: CSV with the columns time_s and angle_deg, of the output; a "
        "relative name begins at the working folder",
    )
    time_max: float = Field(3600.0, gt=0, le=3600, description="longest recording, s")
    bandwidth_hz: float = Field(
        10.0, gt=0, le=50, description="up to which amplitudes are right within 5 %, Hz"
    )
    record_every: int = Field(1, ge=1, description="samples averaged into a recorded one")

    @property
    def corner_hz(self) -> float:
        """Corner of the low-pass on the torque, Hz: at the bandwidth a low-pass without phase shift
        has a gain of 0.988, a causal one 0.994, and the filter before them 0.97 or more."""
        return 3 * self.bandwidth_hz

    @model_validator(mode="after")
    def _path_has_its_file(self) -> Self:
        if (self.kind == "path") != (self.file is not None):
            raise ValueError(
                'kind = "path" needs file, a CSV of time_s and angle_deg; other kinds have none'
            )
        return self


class MeasureForce(Section):
    """Known loads on the output, force read from current [8.1, 8.2]."""

    forces: tuple[Positive, ...] = Field(
        (0.06, 0.25, 1.0, 2.0, 2.5), min_length=1, description="hung on in turn, N"
    )
    cycles: int = Field(40, ge=3, description="rising and falling, for each load")
    speed_rev_per_s: float = Field(0.2, gt=0, description="of the output, rev/s")
    angle: float = Field(180.0, gt=0, description="of the move at the output, deg")
    turn_angle: float = Field(20.0, gt=0, description="used to reverse at each end, deg")
    measure_angle: float = Field(90.0, gt=0, description="output angle of the reading, deg")
    lowpass_hz: float = Field(5.0, gt=0, description="zero-phase low-pass on all signals, Hz")
    correction: Literal["none", "load", "full"] = Field(
        "none",
        description="none as the thesis; load: friction that grows with load; full: also "
        "compliance, ripple by current, temperature (tables of implementation D)",
    )
    zero: bool = Field(
        True, description="take the mean reading without load off the others, as a gauge is zeroed"
    )
    hysteresis_force: float = Field(
        3.0, gt=0, description="load for lifting against lowering, N (instrument)"
    )
    shift_force: float = Field(
        5.0, gt=0, description="load for the position of the peak, N (instrument)"
    )
    extra_cycles: int = Field(5, ge=1, description="for these two loads")
    record_every: int = averaged(16)
    motion: ForceMotion = ForceMotion()

    @model_validator(mode="after")
    def _whole_cycles_show_scatter(self) -> Self:
        if self.correction == "full" and self.cycles < 5:
            raise ValueError(
                f'{self.cycles} cycles are too few for correction = "full", which needs 3 whole '
                "ones between those that run in and out: raise cycles to 5 or more"
            )
        return self

    @model_validator(mode="after")
    def _reads_within_the_stroke(self) -> Self:
        require_straight_part("turn_angle", self.turn_angle, self.angle)
        low, high = self.turn_angle, self.angle - self.turn_angle
        if not low <= self.measure_angle <= high:
            raise ValueError(
                f"measure_angle {self.measure_angle:g} deg is not between {low:g} and {high:g} "
                "deg, where a stroke has a constant speed: choose an angle there, in degrees"
            )
        return self


class Suspension(Section):
    """Known forces pull at the motor, a micrometer reads how far its leaf springs give [App. E]."""

    forces: tuple[Positive, ...] = Field(
        (2, 4, 6, 8, 10, 12, 14, 16, 18, 20), min_length=4, description="in turn, N"
    )
    speeds_rev_per_s: tuple[Positive, ...] = Field(
        (0.2, 5), min_length=1, description="at which torques of the pulleys are stated, rev/s"
    )


class Requirements(Section):
    """What the measurements have to reach; a report states for each whether the runs show it."""

    force_error: float | None = Field(
        None, gt=0, le=1, description="largest relative error of a known load"
    )
    force_resolution: float | None = Field(
        None, gt=0, description="smallest force that one reading distinguishes from none, N"
    )
    force_bandwidth_hz: float | None = Field(
        None, gt=0, description="bandwidth of the force, at least, Hz"
    )
    residual_torque: float | None = Field(
        None, gt=0, description="remaining disturbance with the learned table, rms, N m"
    )
