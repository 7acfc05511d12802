"""Motions of `ilc-learn` other than moves on a limited angle [7.2.4]."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from rigtool.recipe.base import Section

Positive = Annotated[float, Field(gt=0)]


class Turning(Section):
    """Whole turns of the bare motor: implementations A and B [7.2.4.2]."""

    speeds_rev_per_s: tuple[Positive, ...] = Field(
        (1, 2, 3, 4, 5), min_length=1, description="both directions; A learns at the lowest"
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
        lowest = min(self.speeds_rev_per_s)
        if max(self.low_speeds_rev_per_s, default=0) >= lowest:
            raise ValueError(
                f"low_speeds_rev_per_s holds {max(self.low_speeds_rev_per_s)}, all of them must be "
                f"below the lowest of speeds_rev_per_s, {lowest}"
            )
        every = (*self.low_speeds_rev_per_s, *self.speeds_rev_per_s)
        if len(set(every)) < len(every):
            raise ValueError("a speed is listed twice in speeds_rev_per_s and low_speeds_rev_per_s")
        return self


class Trajectory(Section):
    """The repeated move of standard learning, which learns by time [7.2.4.1]."""

    speed_rev_per_s: float = Field(1.0, gt=0, description="of the output, about, rev/s")
    angle: float = Field(180.0, gt=0, description="of the move at the output, deg")
    turn_angle: float = Field(40.0, gt=0, description="used to reverse at each end, deg")
    moves: int = Field(10, ge=3, description="to and fro, averaged in each run")

    @model_validator(mode="after")
    def _turn_fits(self) -> Trajectory:
        if 2 * self.turn_angle >= self.angle:
            raise ValueError(
                f"turn_angle {self.turn_angle} deg at both ends leaves nothing of the angle "
                f"{self.angle} deg: lower it"
            )
        return self
