"""Motions of `ilc-learn` other than moves on a limited angle [7.2.4]."""

from __future__ import annotations

from pydantic import Field, model_validator

from rigtool.recipe.base import Positive, Section


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
    record_every: int = Field(4, ge=1, description="samples averaged into a recorded one")

    @model_validator(mode="after")
    def _speeds_differ(self) -> Turning:
        require_different_speeds(self.speeds_rev_per_s, self.low_speeds_rev_per_s)
        return self


class Trajectory(Section):
    """The repeated move of standard learning, which learns by time [7.2.4.1]."""

    speed_rev_per_s: float = Field(1.0, gt=0, description="of the output, about, rev/s")
    angle: float = Field(180.0, gt=0, description="of the move at the output, deg")
    turn_angle: float = Field(40.0, gt=0, description="used to reverse at each end, deg")
    moves: int = Field(10, ge=3, description="to and fro, averaged in each run")

    @model_validator(mode="after")
    def _turn_fits(self) -> Trajectory:
        require_straight_part("turn_angle", self.turn_angle, self.angle)
        return self
