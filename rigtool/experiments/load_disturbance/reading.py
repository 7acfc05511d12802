"""The load on a motor, read from its torque over whole strokes with a learned disturbance.

Every point of a stroke shows a part of a load F r sin(a). The load is the one whose expected torque
(`model`) fits the straight part of the strokes best, with the recording's own friction level free:
rising and falling strokes together determine the load, whatever its friction. Close to the solution
that is a weighted mean over the stroke,

    load = sum over points of weight * torque

so that each cycle, with the load or without, has a reading of its own and their scatter is known.
For pair the reading at one angle of the rising strokes is kept, the thesis's way [8.2], with
the same disturbance taken off.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from rigtool.errors import InsufficientDataError
from rigtool.experiments.load_disturbance.cycles import LoadedCycles
from rigtool.experiments.load_disturbance.model import Disturbance, LoadedPair
from rigtool.numerics.arrays import Array
from rigtool.numerics.steady_mean import steady_u

STEP = 0.01
"""Change of the load for a derivative, relative, or as part of the largest learned load."""

SMALLEST_STEP = 1e-4
ROUNDS = 50
HIGHEST_LOAD, SCANNED_LOADS = 3.0, 41
"""Highest load of the scan, in parts of the largest learned one, and the number of loads."""

CONVERGED = 1e-5
"""Change at which a load is found, in parts of the largest learned one."""


@dataclass(frozen=True, eq=False)
class LoadReading:
    """A load, N m at 90 degrees, by whole strokes and at one angle.

    `moment` and its standard uncertainty `u` with `dof`; `components` of u by source. `cycles` (m,)
    are single readings of it, `at_angle` (m,) those at
    one angle of each rising stroke. `rms` is what the model leaves.
    """

    moment: float
    u: float
    dof: float
    components: dict[str, float]
    cycles: Array
    at_angle: Array
    rms: float


@dataclass(frozen=True)
class DeadBand:
    """Bounds of a load where the motion stands still, N m at the output.

    `middle` is the mean of lifting and lowering, zero taken off, `half` half their difference:
    friction may hold that much either way.
    """

    middle: float
    half: float


def read_load(disturbance: Disturbance, pair: LoadedPair, angle: float) -> LoadReading:
    """Read the load of a pair; `angle` rad of the output is that of the single readings.

    Raises `InsufficientDataError` where no load explains the torque.
    """
    moment, weight, left = _solve(disturbance, pair)
    loaded = pair.loaded
    over_period = np.zeros(len(loaded.setpoint))
    over_period[pair.rows] = weight
    over_period = loaded.lowpass(over_period)  # acts on torques that are not low-passed
    cycles = moment + (loaded.torque - loaded.mean) @ over_period
    scatter_u, scatter_dof = steady_u(cycles)
    zeros = [steady_u(each.torque @ over_period) for each in pair.unloaded]
    zero_u = math.hypot(*(u for u, _ in zeros)) / len(zeros)
    rows = pair.rows
    by = disturbance.sensitivity(pair, moment)[:, rows] @ weight
    rms = float(np.sqrt(np.mean(left**2)))
    components = {
        "scatter": scatter_u,
        "zero": zero_u,
        "disturbance": math.sqrt(max(0.0, float(by @ disturbance.covariance @ by))),
        "misfit": rms * float(np.linalg.norm(weight)) * math.sqrt(len(rows) / pair.independent),
    }
    u = math.hypot(*components.values())
    zero_dof = sum(dof for _, dof in zeros)
    return LoadReading(
        moment=moment,
        u=u,
        dof=u**4 / (scatter_u**4 / scatter_dof + zero_u**4 / zero_dof),
        components=components,
        cycles=cycles,
        at_angle=_at_angle(disturbance, pair, moment, angle),
        rms=rms,
    )


def _solve(disturbance: Disturbance, pair: LoadedPair) -> tuple[float, Array, Array]:
    """Return the load, N m, the weight of each row in it, and what is left at the rows, N m.

    A load that swings near its resonance fits at several places: all are scanned first.
    """
    rows, scale = pair.rows, disturbance.torque
    own = pair.nuisance[:, rows]
    basis = np.linalg.qr(own.T)[0]

    expectation = disturbance.expectation(pair)

    def expected(moment: float) -> Array:
        found: Array = expectation(moment)[rows]
        return found

    def misfit(moment: float) -> float:
        left = pair.torque[rows] - expected(moment)
        left = left - basis @ (basis.T @ left)
        return float(left @ left)

    grid = scale * np.linspace(0.0, HIGHEST_LOAD, SCANNED_LOADS)
    moment, spacing = float(min(grid.tolist(), key=misfit)), float(grid[1])
    for _ in range(ROUNDS):
        middle = expected(moment)
        step = max(STEP * abs(moment), SMALLEST_STEP * scale)
        matrix = np.vstack([(expected(moment + step) - middle) / step, own]).T
        inverse = np.linalg.pinv(matrix)
        difference = pair.torque[rows] - middle
        change = float(inverse[0] @ difference)
        if abs(change) <= CONVERGED * scale:
            return moment + change, inverse[0], difference - matrix @ (inverse @ difference)
        moment += min(max(change, -spacing), spacing)
        if moment > HIGHEST_LOAD * scale:
            break
    raise InsufficientDataError(
        f"no load up to {HIGHEST_LOAD:g} times the largest learned one, {scale * 1e3:.4g} mN m, "
        "explains the torque: learn with larger loads, or check that the tables are of this rig"
    )


def _at_angle(disturbance: Disturbance, pair: LoadedPair, moment: float, angle: float) -> Array:
    """Return the load that each rising stroke shows at one angle (cycles,), N m."""
    loaded, unloaded = pair.loaded, pair.unloaded[0]
    rotor = angle * loaded.transmission.angle_ratio
    here, there = loaded.crossing(rotor, 1), unloaded.crossing(rotor, 1)
    zero = unloaded.lowpass(pair.unloaded_torque)
    shown = loaded.at(loaded.lowpass(loaded.torque), here) - unloaded.at(zero, there)
    step = max(STEP * abs(moment), SMALLEST_STEP * disturbance.torque)
    expected = disturbance.expected(pair, moment)
    slope = (disturbance.expected(pair, moment + step) - expected) / step
    # The model compares equal times; the thesis's reading compares equal angles.
    moved = loaded.at(zero, here) - unloaded.at(zero, there)
    found: Array = moment + (shown - loaded.at(expected, here) - moved) / loaded.at(slope, here)
    return found


def dead_band(pair: LoadedPair, angle: float) -> DeadBand:
    """Return the dead band of a pair at an output angle, rad."""
    loaded, unloaded = pair.loaded, pair.unloaded[0]
    rotor = angle * loaded.transmission.angle_ratio

    def both(cycles: LoadedCycles, torque: Array) -> tuple[float, float]:
        smooth = cycles.lowpass(torque)
        rising, falling = (
            float(cycles.at(smooth, cycles.crossing(rotor, side))) for side in (1, -1)
        )
        return (rising + falling) / 2, abs(rising - falling) / 2

    middle, half = both(loaded, loaded.mean)
    return DeadBand(middle - both(unloaded, pair.unloaded_torque)[0], half)
