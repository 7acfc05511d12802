"""Remaining torque at any speed, table off and on: steady moves, a sweep [Fig. 46-48, 52, 54]."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from rigtool.experiments.learning.rows import Row
from rigtool.experiments.outcome import Outcome
from rigtool.numerics.arrays import Array
from rigtool.numerics.jackknife import standard_uncertainty
from rigtool.quantity import Quantity, scattered
from rigtool.runfile import Column, Table, dof_column

FALSE_ALARM_PROBABILITY = 0.01
"""Probability that noise alone makes a table look worse than no table at any of the speeds."""

SPEED_BIN = 0.25 * 2 * math.pi
"""Width of the bins of speed of a sweep, rad/s."""

DRAWN_SAMPLES = 12000
"""Samples of a sweep that are kept for its figure, about."""


def midpoints(speeds: Sequence[float]) -> tuple[float, ...]:
    """Return the speeds half way between neighbouring ones."""
    return tuple((low + high) / 2 for low, high in pairwise(sorted(speeds)))


@dataclass(frozen=True, eq=False)
class Steady:
    """Controller torque at one speed and direction, table off (`before`) and on (`after`).

    `kind` of the speed is `learned`, `tuned` (amplitude and phase) or `between` such speeds.
    """

    before: Row
    after: Row
    kind: str = "between"


def steady_outcome(found: Sequence[Steady]) -> Outcome:
    """Report the remainder by speed, and whether it exceeds that without the table anywhere."""
    if not found:
        return Outcome({})
    ordered = sorted(found, key=lambda item: item.after.speed)
    off = [_rms(item.before) for item in ordered]
    on = [_rms(item.after) for item in ordered]
    limits = [_limit(item, len(ordered)) for item in ordered]
    worse = [
        b[0] - a[0] > limit * math.hypot(a[1], b[1])
        for a, b, limit in zip(off, on, limits, strict=True)
    ]
    peaks = [_peak(item.after) for item in ordered]
    numbers = {
        "off_peak": ([np.abs(item.before.mean).max() for item in ordered], "table off"),
        "off_rms": ([value for value, _ in off], "table off"),
        "off_rms_u": ([u for _, u in off], "standard uncertainty"),
        "on_peak": ([value for value, _ in peaks], "table on"),
        "on_peak_u": ([u for _, u in peaks], "standard uncertainty"),
        "on_rms": ([value for value, _ in on], "table on"),
        "on_rms_u": ([u for _, u in on], "standard uncertainty"),
        "non_repeatable_rms": (
            [item.after.non_repeatable_rms for item in ordered],
            "scatter of a single cycle: no table can remove it",
        ),
    }
    speed = np.array([item.after.speed for item in ordered])
    flags = {
        "learned": ([item.kind == "learned" for item in ordered], "1 where learned there"),
        "between": ([item.kind == "between" for item in ordered], "1 where nothing was learned"),
        "worse": (worse, "1 where more remains than with the table off, beyond chance"),
    }
    table = Table(
        ("speed",),
        {
            "speed": Column(speed, "rad/s", "of the motor shaft"),
            **{k: Column(v, "N m", text) for k, (v, text) in numbers.items()},
            "off_dof": dof_column([item.before.dof for item in ordered]),
            "on_dof": dof_column([item.after.dof for item in ordered]),
            **{k: Column(v, "1", text) for k, (v, text) in flags.items()},
        },
        "on_peak",
        "controller torque at constant speed, mean of the cycles, within the band of Q",
    )
    return Outcome(_steady_results(ordered, peaks), {"validation": table}, _verdict(speed, worse))


def _steady_results(
    found: Sequence[Steady], peaks: Sequence[tuple[float, float]]
) -> dict[str, Quantity]:
    results = {}
    for kind in ("learned", "tuned", "between"):
        chosen = [
            (*peak, len(item.after.moves) - 1)
            for item, peak in zip(found, peaks, strict=True)
            if item.kind == kind
        ]
        if chosen:
            value, u, dof = max(chosen)
            results[f"validation_peak_{kind}"] = scattered(
                value, "N m", u, dof, "scatter over the moves"
            )
    return results


def _limit(item: Steady, speeds: int) -> float:
    """Return Student's t that chance exceeds at one of all speeds by `FALSE_ALARM_PROBABILITY`."""
    from scipy.special import stdtrit

    freedom = min(len(item.before.moves), len(item.after.moves)) - 1
    return float(stdtrit(freedom, 1 - FALSE_ALARM_PROBABILITY / speeds))


def _verdict(speed: Array, worse: Sequence[bool]) -> tuple[str, ...]:
    bad = speed[np.array(worse)] / (2 * math.pi)
    if not bad.size:
        return (
            f"at none of {len(speed)} speeds does more remain than with the table off, beyond "
            "chance",
        )
    listed = ", ".join(f"{value:.3g}" for value in bad)
    return (f"more remains than with the table off at {listed} rev/s of the motor",)


def _rms(row: Row) -> tuple[float, float]:
    """Return the rms of a row's mean, and its standard uncertainty by the jackknife."""
    without = (row.moves.sum(axis=0) - row.moves) / (len(row.moves) - 1)
    u = standard_uncertainty(np.sqrt(np.mean(without**2, axis=1)))
    return float(np.sqrt(np.mean(row.mean**2))), u


def _peak(row: Row) -> tuple[float, float]:
    """Return the peak of a row's mean, and the standard uncertainty of the mean there."""
    where = int(np.argmax(np.abs(row.mean)))
    return float(abs(row.mean[where])), float(row.u[where])


# -- the sweep


@dataclass(frozen=True, eq=False)
class Sweep:
    """A sweep of speed, table off and on: signals (n,) on one time, s, rad/s and N m.

    `torque` is the controller's by variant, within the band of Q: `off`, `plain` (without
    amplitude and phase tables), `on`; `table` is the torque that the table added when `on`.
    """

    time: Array
    speed: Array
    torque: dict[str, Array]
    table: Array

    def outcome(self) -> Outcome:
        """Report the remainder over the whole sweep, by speed, and along it."""
        by_speed = self._by_speed()
        tables = {"sweep_by_speed": by_speed, "sweep": self._signals()}
        return Outcome(self._results(by_speed), tables)

    def _results(self, by_speed: Table) -> dict[str, Quantity]:
        """Return the rms over the whole sweep, and the level: each speed counts by its ratio.

        The level is the geometric mean of the rms in all bins: where few bins are large, it shows
        what remains in all others.
        """
        reason = "one sweep; contains the non-repeatable part"
        results = {}
        for variant, torque in self.torque.items():
            rms = float(np.sqrt(np.mean(torque**2)))
            level = float(np.exp(np.mean(np.log(by_speed[f"{variant}_rms"]))))
            results[f"sweep_rms_{variant}"] = Quantity(rms, "N m", reason=reason)
            results[f"sweep_level_{variant}"] = Quantity(level, "N m", reason=reason)
        return results

    def _by_speed(self) -> Table:
        # Bins in which the sweep spends no time are left out.
        bins, of = np.unique(np.round(self.speed / SPEED_BIN), return_inverse=True)
        count = np.bincount(of)
        columns = {}
        for variant, torque in self.torque.items():
            rms = np.sqrt(np.bincount(of, torque**2) / count)
            peak = np.zeros(len(bins))
            np.maximum.at(peak, of, np.abs(torque))
            columns[f"{variant}_rms"] = Column(rms, "N m", _VARIANTS[variant])
            columns[f"{variant}_peak"] = Column(peak, "N m", _VARIANTS[variant])
        return Table(
            ("speed",),
            {"speed": Column(bins * SPEED_BIN, "rad/s", "middle of the bin"), **columns},
            "on_rms",
            "controller torque while the speed sweeps, within the band of Q, single pass",
        )

    def _signals(self) -> Table:
        every = max(1, len(self.time) // DRAWN_SAMPLES)
        axis = Column((self.time - self.time[0])[::every], "s")
        return Table(
            ("time",),
            {
                "time": axis,
                "speed": Column(self.speed[::every], "rad/s", "set point of the motor shaft"),
                **{
                    variant: Column(torque[::every], "N m", _VARIANTS[variant])
                    for variant, torque in self.torque.items()
                },
                "table": Column(self.table[::every], "N m", "torque of the table when it was on"),
            },
            "on",
            "controller torque while the speed sweeps from end to end, within the band of Q",
        )


_VARIANTS = {
    "off": "controller, table off",
    "plain": "controller, without amplitude and phase tables",
    "on": "controller, table on",
}
