"""What two common ways to compensate ripple leave, beside implementation B, on the same signals.

- `bins`: what small drives do when they calibrate anticogging. The shaft turns slowly in both
  directions, the torque is averaged in 1024 bins of the turn over both directions, so that friction
  cancels, and the map is fed forward at any speed.
- `harmonics`: one map of the orders 1 to 50, by least squares to all speeds and directions at once,
  fed forward at any speed.

Neither knows friction, which would decide the comparison alone: they are given, for nothing, the
mean torque of each speed and direction that they are judged on. B gets no such gift.

All learn from the first half of the turns at the learned speeds and are judged on the second half,
and on turns at speeds half way between. What is left is the torque of the mean turn that would have
to be fed forward still, within the band of Q, rms over the turn.

    python benchmarks/baselines.py RUN.h5 [--kt KT.h5]     a run of B with --validate
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rigtool.control.lookup_table import LookupTable
from rigtool.experiments.learning.implementations import bare_motor
from rigtool.experiments.learning.procedure_design import design_filters
from rigtool.experiments.learning.rows import Row
from rigtool.experiments.learning.turns import TURN, repeatable_row, turn_angles
from rigtool.experiments.torque_per_ampere import torque_per_ampere
from rigtool.runfile import Run, open_run

Array = NDArray[np.float64]

BINS = 1024
ORDERS = 50


def bin_average(forwards: Row, backwards: Row) -> Array:
    """Return the map (n,) of both directions at one speed, averaged in bins of the turn."""
    both = (forwards.mean + backwards.mean) / 2
    places = np.arange(both.size) * BINS // both.size
    averaged = np.bincount(places, both, BINS) / np.maximum(np.bincount(places, minlength=BINS), 1)
    centres = (np.arange(BINS) + 0.5) / BINS
    angles = np.arange(both.size) / both.size
    found: Array = np.interp(angles, centres, averaged, period=1.0)
    return found - found.mean()


def harmonic_map(rows: Sequence[Row]) -> Array:
    """Return the map (n,) of low orders that fits all rows best; a mean of their orders is it."""
    orders = np.mean([np.fft.rfft(row.mean) for row in rows], axis=0)
    orders[0] = 0.0
    orders[ORDERS + 1 :] = 0.0
    found: Array = np.fft.irfft(orders, rows[0].mean.size)
    return found


def table_of(rows: Sequence[Row]) -> LookupTable:
    """Return B's table of these rows."""
    ordered = sorted((repeatable_row(row) for row in rows), key=lambda row: row.speed)
    lowest = min(abs(row.speed) for row in ordered)
    return LookupTable(
        turn_angles(ordered[0].mean.size),
        np.array([row.speed for row in ordered]),
        np.stack([row.mean for row in ordered]),
        np.array([0.0, lowest]),
        np.array([0.0, 1.0]),
        period=TURN,
    )


def left_over(run: Run, kt: Run) -> dict[str, dict[float, float]]:
    """Return what each way leaves by speed, N m rms: `nothing`, `bins`, `harmonics`, `B`."""
    recipe = run.recipe
    assert recipe is not None
    learning, constant = design_filters(recipe).learning, torque_per_ampere(kt).value
    counts = recipe.rig.encoder_counts

    def rows(kind: str) -> list[Row]:
        items = (bare_motor.turned(r, recipe, constant) for r in run.recordings_of(kind))
        return [bare_motor.learned_by(item, learning, counts) for item in items]

    taught, judged = [], []
    for row in rows("learn"):
        half = len(row.moves) // 2
        taught.append(Row(row.speed, row.moves[:half]))
        judged.append(Row(row.speed, row.moves[half:]))
    lowest = min(abs(row.speed) for row in taught)
    judged += [row for row in rows("off") if abs(row.speed) > lowest]
    slow = {row.speed > 0: row for row in taught if abs(row.speed) == lowest}
    maps = {"bins": bin_average(slow[True], slow[False]), "harmonics": harmonic_map(taught)}
    table, position = table_of(taught), turn_angles(counts)
    found: dict[str, dict[float, float]] = {name: {} for name in ("nothing", *maps, "B")}
    for row in judged:
        ripple = row.mean - row.mean.mean()
        found["nothing"][row.speed] = _rms(ripple)
        for name, map_ in maps.items():
            found[name][row.speed] = _rms(ripple - map_)
        fed = table.evaluate(position, np.full(counts, row.speed))
        found["B"][row.speed] = _rms(row.mean - fed)
    return found


def over_all(by_speed: dict[float, float]) -> float:
    """Return the rms over all speeds."""
    return _rms(np.array(list(by_speed.values())))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def report(found: dict[str, dict[float, float]]) -> str:
    """Return a table: a line for each speed, a column for each way, mN m rms."""
    names = list(found)
    lines = ["rev/s".rjust(8) + "".join(name.rjust(12) for name in names)]
    for speed in sorted(found["B"]):
        values = "".join(f"{found[name][speed] * 1e3:12.3f}" for name in names)
        lines.append(f"{speed / TURN:8.2f}{values}")
    totals = [over_all(found[name]) for name in names]
    lines.append("all".rjust(8) + "".join(f"{total * 1e3:12.3f}" for total in totals))
    lines.append("B/this".rjust(8) + "".join(f"{totals[-1] / total:12.3f}" for total in totals))
    return "\n".join(lines)


def main(arguments: Sequence[str]) -> None:
    if not arguments:
        sys.exit((__doc__ or "").strip())
    kt = Path(__file__).parents[1] / "tests" / "fixtures" / "kt.h5"
    paths = [argument for argument in arguments if argument != "--kt"]
    if "--kt" in arguments:
        kt = Path(paths.pop(arguments.index("--kt")))
    with open_run(kt) as constant:
        for path in paths:
            with open_run(path) as run:
                print(f"{path}: left, mN m rms\n{report(left_over(run, constant))}")


if __name__ == "__main__":
    main(sys.argv[1:])
