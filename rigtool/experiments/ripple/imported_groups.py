"""Turns of imported runs in groups: repeats under the same conditions and speed."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from rigtool.errors import naming
from rigtool.experiments.imported import moves, place, position_of
from rigtool.experiments.ripple.imported_turns import (
    CELLS_AN_ORDER,
    Turns,
    fill,
    find_turns,
    refined_speed,
)
from rigtool.experiments.ripple.orders import (
    HIGHEST_ORDER,
    SIGNIFICANT_RATIO,
    WAVEFORM_CELLS,
    Sampling,
    Spectrum,
)
from rigtool.experiments.torque_per_ampere import Effort, effort_of
from rigtool.numerics.arrays import Array, Mask
from rigtool.recipe.mapping import CONSTANT_SPEED, RIG_CONDITIONS
from rigtool.runfile import Recording, Run

GROUP_SPEED_TOLERANCE = 0.1
"""Runs whose speeds differ by less than this part count as one speed."""

EFFORT_SIGNALS = ("torque", "current", "current_setpoint", "relative_torque")
"""Signals of a rotary motor's effort."""

SAME_SETPOINT = 1e-3
"""Relative difference up to which two speeds that were asked for count as one."""

MOST_ORDERS = 1000
"""Highest order that imported runs are examined for, where they carry so many."""

SAMPLES_A_CELL = 2
"""Mean number of samples in a cell of the turn at least, where there are more than usual."""


@dataclass(frozen=True, eq=False)
class RepeatedRuns:
    """Runs under the same conditions and speed, as repeats of each other.

    Rows of `torque` and `deviation` (rows, positions) hold `turns` in all and resolve `orders`;
    `sampling`, `alias` and `leak` are those of `Turns`. Without `moved` the motion was stated, not
    measured.
    """

    conditions: Mapping[str, float]
    speed: float
    runs: int
    torque: Array
    deviation: Array
    orders: int
    turns: float
    sampling: Sampling
    alias: Array
    leak: Array
    moved: bool = True
    setpoint: float | None = None
    spectra: dict[str, Spectrum] = field(default_factory=dict)

    def label(self) -> str:
        """Return its conditions and speed as text."""
        parts = [f"{name} {value:g}" for name, value in self.conditions.items()]
        return ", ".join([*parts, f"{self.speed:.3g} rad/s"])

    @property
    def u(self) -> Array:
        """Standard uncertainty (orders,) of the amplitudes of torque: scatter, and what a higher
        order may add that the samples do not separate, at most all (GUM 4.3.7)."""
        spectrum = self.spectra["torque"]
        count = len(spectrum.order)
        by_alias = self.leak[:count] * spectrum.amplitude / math.sqrt(3)
        return np.hypot(spectrum.u, by_alias)

    @property
    def dof(self) -> Array:
        """Degrees of freedom (orders,) of `u`, by Welch and Satterthwaite (GUM G.4.1): two for each
        repeated turn; infinite for what a higher order adds, and where nothing was repeated."""
        scatter, repeats = self.spectra["torque"].u, 2 * (len(self.torque) - 1)
        with np.errstate(divide="ignore", invalid="ignore"):
            found: Array = self.u**4 / (scatter**4 / (repeats or math.inf))
        return found

    def clear(self) -> Mask:
        """Return the orders (m,) that stand out; of noise alone, one would on average, by
        chance."""
        spectrum = self.spectra["torque"]
        level = max(SIGNIFICANT_RATIO, math.sqrt(math.log(len(spectrum.order))))
        return spectrum.amplitude > level * spectrum.noise_floor


def cells_for(recordings: Sequence[Recording]) -> int:
    """Return in how many cells to divide the turn: as many as all recordings fill, for orders from
    `HIGHEST_ORDER` to `MOST_ORDERS`. A shaft that sticks and jumps fills few."""
    angles = [position_of(recording) / (2 * math.pi) for recording in recordings]
    filled = [len(angle) / max(abs(angle[-1] - angle[0]), 1.0) for angle in angles]
    orders = min(int(min(filled) / SAMPLES_A_CELL) // CELLS_AN_ORDER, MOST_ORDERS)
    if orders <= HIGHEST_ORDER:
        return WAVEFORM_CELLS
    positions = CELLS_AN_ORDER * orders
    for angle in angles:
        passed = np.unique(np.floor(np.mod(angle, 1.0) * positions))
        gap = np.diff(passed, append=passed[0] + positions).max() - 1
        if 2 * gap * orders > positions:
            return WAVEFORM_CELLS
    return positions


def ripple_effort(recording: Recording, kt: Run | None) -> Effort:
    """Return the motor's effort, or its speed where nothing else was recorded."""
    if not recording.has("speed") or any(map(recording.has, EFFORT_SIGNALS)):
        return effort_of(recording, kt)
    return Effort(recording.read("speed"), "rad/s", "speed", 0.0, "speed as in the file")


def turns_of(recording: Recording, kt: Run | None, positions: int = WAVEFORM_CELLS) -> Turns:
    """Return the turns of a recording in cells of the turn, with the motor's effort as torque.

    Where the motion is not recorded but its speed stated, that is refined by the torque's orders.
    Raises `InsufficientDataError` that names the file.
    """
    time, effort = recording.read("time"), ripple_effort(recording, kt).values
    angle = position_of(recording) / (2 * math.pi)
    if not moves(recording):
        speed = recording.condition(CONSTANT_SPEED) / (2 * math.pi)
        angle = (time - time[0]) * refined_speed(time, effort, speed)
    with naming(place(recording)):
        return find_turns(time, angle, effort, positions)


def groups_of(recordings: Sequence[Recording], turns: Sequence[Turns]) -> list[RepeatedRuns]:
    """Return the recordings in groups of the same conditions and speed."""
    found: list[tuple[dict[str, float], list[Turns], Recording]] = []
    for recording, here in zip(recordings, turns, strict=True):
        stated = {*RIG_CONDITIONS, CONSTANT_SPEED}
        conditions = {n: q.value for n, q in recording.conditions.items() if n not in stated}
        for others, members, _ in found:
            same_speed = abs(here.speed - members[0].speed) < GROUP_SPEED_TOLERANCE * abs(
                members[0].speed
            )
            if others == conditions and same_speed:
                members.append(here)
                break
        else:
            found.append((conditions, [here], recording))
    groups = []
    for conditions, members, first in found:
        torque, gap = fill(np.concatenate([member.torque for member in members]))
        deviation, _ = fill(np.concatenate([member.deviation for member in members]))
        speed = float(np.mean([member.speed for member in members]))
        orders = min(member.orders for member in members)
        if gap > 0:
            orders = min(orders, int(1 / (2 * gap)))
        count = sum(len(member.torque) * member.turns_a_row for member in members)
        groups.append(
            RepeatedRuns(
                conditions,
                speed,
                len(members),
                torque,
                deviation,
                orders,
                count,
                Sampling(float(np.mean([member.step for member in members]))),
                members[0].alias[:orders],
                np.mean([member.leak[:orders] for member in members], axis=0),
                moves(first),
                _setpoint(first),
            )
        )
    return groups


def _setpoint(recording: Recording) -> float | None:
    """Return the speed that was asked for, rad/s, None where it is unknown or changes."""
    if not recording.has("speed_setpoint"):
        return None
    asked = recording.read("speed_setpoint")
    middle = float(np.median(asked))
    same = np.mean(np.abs(asked - middle) <= SAME_SETPOINT * abs(middle))
    return middle if same > 0.5 else None
