"""What a mapping states and the data contradict: rates, signs, counts, constants, a gear.

Signals that state one motion or one torque twice, each in its own way, are on a straight line of
slope 1; what a mapping states wrongly (a unit, a sign, a ratio) makes another slope of it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rigtool.errors import RunFileError
from rigtool.recipe import mapping as mappings
from rigtool.runfile.importers.counters import POSITIONS
from rigtool.runfile.importers.raw import Array
from rigtool.runfile.schema import TIME

WAY_PIECES = 100
"""Of a recording over which ways by position and by speed are compared."""

MIN_CORRELATION = 0.9
"""Correlation of these ways from which on their ratio has a meaning."""

OTHER_MOTION = 1.5
"""Ratio of position and speed that no sensor's error explains."""

OTHER_CONSTANT = 1.3
"""Ratio of torque constants that temperature, friction and a data sheet do not explain."""

OTHER_GEAR = 1.05
"""Ratio of gear ratios that play and a compliant output do not explain."""

EFFORT_ORDER = ("current", "torque", "force", "relative_torque")
"""Signals that overcome the friction of the motor, in the order in which one is taken."""

JUMP_RATIO, JUMP_PART, MIN_AROUND = 10.0, 0.05, 10
"""A jump of position: in speeds of the samples around it, in parts of the range; and how few
samples show none."""

NO_SETPOINT, MAX_ZERO = 1e-3, 5e-3
"""Set points of no current, and the largest current there, relative to the largest set point."""

BLOCKS, SLOW, FEWEST_BLOCKS, CERTAIN = 400, 0.1, 10, 5.0
"""Parts of a recording by which the sign of the effort is judged, the part of the farthest way that
counts as motion, the fewest parts in a direction, and the multiple of u that is certain."""


def require_same_motion(
    path: Path, signals: Mapping[str, Array], rig: mappings.ImportedRig
) -> None:
    """Raise `RunFileError` where a speed is not the derivative of its position.

    Over `WAY_PIECES` of the recording, the way by position x and the way by speed w have the slope
    sum(x w) / sum(w^2); where they have no straight line in common nothing is concluded.
    """
    positions = {**signals, **({} if "position" in signals else _by_encoder(signals, rig))}
    for name, of in (("position", "speed"), ("position_setpoint", "speed_setpoint")):
        if name not in positions or of not in signals:
            continue
        moved, expected = _ways(signals[TIME], positions[name], signals[of])
        alike = float(moved @ expected)
        squares = float(expected @ expected)
        if squares == 0 or alike**2 < MIN_CORRELATION**2 * squares * float(moved @ moved):
            continue
        ratio = alike / squares
        if not 1 / OTHER_MOTION < ratio < OTHER_MOTION:
            shown = name if name in signals else "encoder, by encoder_counts,"
            raise RunFileError(
                f"{path}: {shown} moves {ratio:.3g} times as far as {of} states: correct the "
                "sampling rate, the time, or a unit, scale, sign or counts_per_turn in the mapping"
            )


def _by_encoder(signals: Mapping[str, Array], rig: mappings.ImportedRig) -> dict[str, Array]:
    """Return the position that encoder counts state, where they are known."""
    if "encoder" not in signals or rig.encoder_counts is None:
        return {}
    turn = 2 * math.pi if rig.axis == "rotary" else 1.0
    return {"position": signals["encoder"] * (turn / rig.encoder_counts)}


def _ways(time: Array, position: Array, speed: Array) -> tuple[Array, Array]:
    """Return the ways (pieces,) by position and by speed."""
    way = np.diff(time) * (speed[1:] + speed[:-1]) / 2
    ends = np.unique(np.linspace(0, len(time) - 1, WAY_PIECES + 1).round().astype(int))
    return np.diff(position[ends]), np.diff(np.concatenate([[0.0], np.cumsum(way)])[ends])


@dataclass(frozen=True, eq=False)
class _Pair:
    """Two signals (n,) whose slope is `stated` within a factor; else `text` with that slope."""

    values: Array
    over: Array
    text: str
    stated: float = 1.0
    within: float = OTHER_MOTION

    def contradiction(self) -> str | None:
        found = slope(self.values, self.over)
        if found is None or 1 / self.within < found / self.stated < self.within:
            return None
        return self.text.format(found)


def contradictions(signals: Mapping[str, Array], mapping: mappings.Mapping) -> list[str]:
    """Return notes on what the mapping states and the signals contradict."""
    pairs = [*_motions(signals, mapping.rig), *_torques(signals, mapping.rig)]
    notes = [pair.contradiction() for pair in pairs]
    found = (*notes, *_jumps(signals), _zero(signals), _sign_of_work(signals, mapping.rig))
    return [note for note in found if note is not None]


def _jumps(signals: Mapping[str, Array]) -> Iterator[str]:
    """Yield notes on positions that jump between two samples, as nothing that has mass does.

    A jump is a speed `JUMP_RATIO` times as high as those two and three samples before and after it,
    over `JUMP_PART` of the range.
    """
    for name in POSITIONS:
        if name not in signals or len(signals[name]) < 2 * MIN_AROUND:
            continue
        steps = np.diff(signals[name])
        speed = np.abs(steps / np.diff(signals[TIME]))
        far = [np.roll(speed, shift) for shift in (-3, -2, 2, 3)]
        jump = speed > JUMP_RATIO * np.max(far, axis=0)
        jump &= np.abs(steps) > JUMP_PART * float(np.ptp(signals[name]))
        at = np.flatnonzero(jump)
        if at.size:
            yield (
                f"{name} jumps {at.size} times, first by {steps[at[0]]:.4g} at "
                f"{signals[TIME][at[0] + 1]:.6g} s: state wraps_at for a counter that begins "
                "again, or take out samples that are wrong"
            )


def _zero(signals: Mapping[str, Array]) -> str | None:
    """Return a note on a current that is not 0 where its set point is.

    Without a set point nothing shows it: friction and a constant torque take its place.
    """
    if "current" not in signals or "current_setpoint" not in signals:
        return None
    top = float(np.abs(signals["current_setpoint"]).max())
    off = signals["current"][np.abs(signals["current_setpoint"]) <= NO_SETPOINT * top]
    if off.size < MIN_AROUND or abs(shown := float(np.median(off))) <= MAX_ZERO * top:
        return None
    return (
        f"current is {shown:.3g} A where its set point is 0: see to the zero of its reading, and "
        "state offset in the mapping"
    )


def _motions(signals: Mapping[str, Array], rig: mappings.ImportedRig) -> Iterator[_Pair]:
    """Yield the signals that state one motion, or one current, twice."""
    counted = _by_encoder(signals, rig)
    if counted and "position" in signals:
        yield _Pair(
            counted["position"],
            signals["position"],
            "encoder moves {:.3g} times as far as position with encoder_counts = "
            f"{rig.encoder_counts}: correct that, a sign, or counts_per_turn",
        )
    moved = {**counted, **signals}
    for name in ("position", "speed", "current", "output_position"):
        if name in moved and f"{name}_setpoint" in signals:
            yield _Pair(
                moved[name],
                signals[f"{name}_setpoint"],
                f"{name} changes {{:.3g}} times as much as {name}_setpoint: see to a unit, a scale "
                "or a sign of one of them",
            )
    position = signals.get("position", counted.get("position"))
    if rig.gear_ratio is not None and position is not None and "output_position" in signals:
        yield _Pair(
            position,
            signals["output_position"],
            "the motor moves {:.4g} times as far as output_position, gear_ratio is "
            f"{rig.gear_ratio:.4g}: correct that, a sign, or counts_per_turn",
            rig.gear_ratio,
            OTHER_GEAR,
        )


def _torques(signals: Mapping[str, Array], rig: mappings.ImportedRig) -> Iterator[_Pair]:
    """Yield the signals that state one torque twice."""
    current = signals.get("current", signals.get("current_setpoint"))
    for name in ("torque", "reference_torque"):
        if name in signals and current is not None and rig.torque_constant is not None:
            yield _Pair(
                signals[name],
                current,
                f"{name} changes by {{:.3g}} N m for each ampere, torque_constant is "
                f"{rig.torque_constant:.3g} N m/A: see to a unit, a sign, a gear between them, or "
                "rms current",
                rig.torque_constant,
                OTHER_CONSTANT,
            )
        if name in signals and "force" in signals and rig.arm_length is not None:
            yield _Pair(
                signals[name],
                signals["force"],
                f"{name} changes by {{:.3g}} N m for each newton, arm_length is "
                f"{rig.arm_length:.3g} m: see to a unit, a sign, or the arm",
                rig.arm_length,
                OTHER_CONSTANT,
            )


def _sign_of_work(signals: Mapping[str, Array], rig: mappings.ImportedRig) -> str | None:
    """Return a note where the effort is larger backwards than forwards: friction would drive.

    Least squares of effort = c sign(v) + J a + constant on means over `BLOCKS` of the recording;
    those that move less than `SLOW` of the farthest are left out.
    """
    effort = next((name for name in EFFORT_ORDER if name in signals), None)
    positions = {**_by_encoder(signals, rig), **signals}
    if effort is None or "position" not in positions or len(signals[TIME]) < 2 * BLOCKS:
        return None
    edges = np.linspace(0, len(signals[TIME]) - 1, BLOCKS + 1).round().astype(int)
    moved = np.diff(positions["position"][edges])
    sums = np.concatenate([[0.0], np.cumsum(signals[effort])])
    means = np.diff(sums[edges]) / np.diff(edges)
    used = np.abs(moved) > SLOW * float(np.abs(moved).max())
    if min(np.count_nonzero(moved[used] > 0), np.count_nonzero(moved[used] < 0)) < FEWEST_BLOCKS:
        return None
    design = np.column_stack([np.sign(moved), np.gradient(moved), np.ones(BLOCKS)])[used]
    found = np.linalg.lstsq(design, means[used])[0]
    rms = float(np.std(means[used] - design @ found))
    u = rms * math.sqrt(float(np.linalg.pinv(design.T @ design)[0, 0]))
    if found[0] >= -CERTAIN * u:
        return None
    return (
        f"{effort} is larger backwards than forwards, by about {-2 * found[0]:.2g}, as if "
        f"friction drove the motor: see to the sign of {effort}, or of the position"
    )


def slope(values: Array, over: Array) -> float | None:
    """Return the slope of values (n,) over others; None where they are on no straight line."""
    y, x = values - values.mean(), over - over.mean()
    alike, power = float(y @ x), float(x @ x)
    if power == 0 or alike**2 < MIN_CORRELATION**2 * power * float(y @ y):
        return None
    return alike / power
