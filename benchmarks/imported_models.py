"""The force model's functions on imported runs of known loads, beside the splines that they have.

    .venv/bin/python benchmarks/imported_models.py LEARN.h5 ... --judge JUDGE.h5 ...

The first runs are learned, the others judged where the splines give a value. The functions are
those of `rigtool.experiments.force_model.model`, without lags, which nothing shows at 5 Hz; then
more and more of them. Lengths of both bristles, Stribeck speed and stiffness of the tendon are
searched for. The stretch in judged runs is taken from the sensor, which favours these models.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import minimize

from rigtool.experiments.force.imported import FAST_SPEED
from rigtool.experiments.force_model.paths import bristle
from rigtool.experiments.imported_load.basis import LoadSignals, Scales, find_scales
from rigtool.experiments.imported_load.imported_signals import read_all
from rigtool.experiments.imported_load.learning import learn_load_model
from rigtool.runfile import open_run

TURN = 2 * math.pi
RIDGE = 1e-4
SEARCHED = 60
"""Fits for each model."""


@dataclass(frozen=True)
class Functions:
    """Orders along the angle: of friction, of friction by load, of the gain, of torque; `place`: of
    half the stroke instead of the output's turn. `square`: friction and gain by the load squared.
    """

    friction: int = 6
    load_friction: int = 2
    gain: int = 0
    torque: int = 0
    place: bool = False
    square: bool = False

    def design(
        self, signals: LoadSignals, scales: Scales, logs: np.ndarray, ratio: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the functions (n, k) at the rows of a path, and the power (k,) of the torque."""
        path, (bearing, housing, stribeck, stiffness) = signals.path, np.exp(logs)
        angle, speed, size = path.fine_position, path.fine_speed, len(path.fine_position)
        short, long = bristle(angle, bearing, False), bristle(angle, housing, False)
        torque = np.interp(np.arange(size), np.arange(size)[path.rows], signals.sensor)
        output = angle / ratio - torque / stiffness
        if self.place:
            output = (angle - scales.low) / (scales.high - scales.low) * math.pi
        ones, rate = np.ones(size), speed / scales.speed

        def waves(of: np.ndarray, orders: int, by: np.ndarray) -> list[np.ndarray]:
            return [by * f(n * of) for n in range(1, orders + 1) for f in (np.cos, np.sin)]

        alone = [ones, np.gradient(rate, 1 / path.rate), rate, long, long**2, short]
        alone += [short * np.exp(-((speed / stribeck) ** 2))]
        alone += waves(angle, 12, ones) + waves(angle, 2, rate)
        alone += waves(output, self.friction, long) + waves(output, self.torque, ones)
        by_load = [ones, long, *waves(output, self.load_friction, long)]
        by_load += waves(output, self.gain, ones)
        squared = [ones, long] if self.square else []
        power = np.repeat([0, 1, 2], [len(alone), len(by_load), len(squared)])
        return path.thin(np.array(alone + by_load + squared)).T, power


MODELS = {
    "force model": Functions(),
    "gain and load friction by 4 orders": Functions(gain=4, load_friction=4),
    "all by 16 orders of the stroke": Functions(16, 6, 6, 16, place=True),
    "and the load squared": Functions(16, 6, 6, 16, place=True, square=True),
}


def main() -> None:
    """Learn each model from the first runs, and print its errors on the others."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("learn", nargs="+")
    parser.add_argument("--judge", nargs="+", required=True)
    parser.add_argument("--ratio", type=float, default=35.0, help="motor angle per output angle")
    parser.add_argument("--bandwidth", type=float, default=5.0)
    arguments = parser.parse_args()
    learn, judge = (
        read_all([open_run(path) for path in paths], None, arguments.bandwidth)
        for paths in (arguments.learn, arguments.judge)
    )
    model = learn_load_model(learn, turn=TURN).model
    found = [model.estimate(one.effort, one.path) for one in judge]
    rows = [np.flatnonzero(f.inside) for f in found]
    speed = np.concatenate(
        [model.direction * one.output_speed[own] for one, own in zip(judge, rows, strict=True)]
    )

    def show(name: str, torque: Sequence[np.ndarray]) -> None:
        parts = [t - one.sensor[own] for t, one, own in zip(torque, judge, rows, strict=True)]
        error = 1e3 * np.concatenate(parts)
        cells = (error[speed > FAST_SPEED], error[speed < -FAST_SPEED], error)
        print(f"{name:40}", *(f"{math.sqrt(np.mean(cell**2)):8.2f}" for cell in cells), flush=True)

    print(f"{'rms error, mN m':40} {'closing':>8} {'opening':>8} {'moving':>8}")
    show("splines", [f.torque[own] for f, own in zip(found, rows, strict=True)])
    for name, functions in MODELS.items():
        show(name, read(functions, learn, judge, rows, arguments.ratio))


def read(
    functions: Functions,
    learn: Sequence[LoadSignals],
    judge: Sequence[LoadSignals],
    rows: Sequence[np.ndarray],
    ratio: float,
) -> list[np.ndarray]:
    """Return the torque at rows of the judged runs, N m, as learned from the others."""
    scales = find_scales([one.path for one in learn], [one.sensor for one in learn], TURN)

    def fit(logs: np.ndarray) -> tuple[float, np.ndarray]:
        parts, efforts = [], []
        for one in learn:
            moving = one.path.regular & (np.abs(one.path.speed) >= scales.standstill)
            columns, power = functions.design(one, scales, logs, ratio)
            torque = one.sensor[moving, None] / scales.torque
            parts.append(columns[moving] * torque**power)
            efforts.append(one.effort[moving])
        matrix, effort = np.vstack(parts), np.concatenate(efforts)
        size = np.sqrt(np.mean(matrix**2, axis=0)) + 1e-12
        matrix /= size
        normal = matrix.T @ matrix + RIDGE * len(effort) * np.eye(len(size))
        weights = np.linalg.solve(normal, matrix.T @ effort)
        return float(np.sqrt(np.mean((effort - matrix @ weights) ** 2))), weights / size

    def cost(logs: np.ndarray) -> float:
        return 1e3 * fit(logs)[0]

    way, middle = scales.high - scales.low, scales.speed / 5
    starts = [np.log([way / 100, way / n, middle, k]) for n in (60, 20) for k in (5.0, 100.0)]
    best = min(starts, key=lambda logs: fit(logs)[0])
    around = np.vstack([best, best + 0.7 * np.eye(4)])
    options: Any = {"maxfev": SEARCHED, "initial_simplex": around}
    logs = minimize(cost, best, method="Nelder-Mead", options=options).x
    weights, found = fit(logs)[1], []
    for one, own in zip(judge, rows, strict=True):
        columns, power = functions.design(one, scales, logs, ratio)
        offset, gain, square = (columns[own][:, power == n] @ weights[power == n] for n in range(3))
        torque = 0.5 * np.sign(np.mean(one.sensor)) * np.ones(len(own))
        for _ in range(30):  # Newton's way to the torque
            left = offset + (gain + square * torque) * torque - one.effort[own]
            torque = np.clip(torque - left / (gain + 2 * square * torque), -1.5, 1.5)
        found.append(scales.torque * torque)
    return found


if __name__ == "__main__":
    main()
