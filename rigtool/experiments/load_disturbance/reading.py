"""The load on a motor, read from its torque over whole strokes with a learned model.

Every point of a stroke shows a part of a load F r sin(a). What the model leaves of a motion with
the load, less what it leaves of the same motion without,

    e(M) = (torque - expected(M)) - (torque_0 - expected(0))

is small for the load M that hangs there. M is found by least squares over all points where the
rotor slides, with the recording's own friction level of each direction free ('instrument friction
changes in time' [8.2]): rising and falling strokes together determine the load, whatever its
friction. Close to the solution that is a weighted mean over the stroke,

    load = sum over points of weight * torque

so that each cycle, with the load or without, has a reading of its own and their scatter is known.
Beside it stands the reading at one angle of the rising strokes, the thesis's way [8.2], with the
same model.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rigtool.errors import InsufficientDataError
from rigtool.experiments.force_model.learning import LearnedModel
from rigtool.experiments.force_model.model import Prediction, RecordState, functions
from rigtool.experiments.force_model.records import SLIDING_COUNT_RATE, Record, lowpassed_rows
from rigtool.experiments.force_model.sliding_problem import (
    ROWS_PER_INDEPENDENT_ROW,
    measured,
    slopes,
)
from rigtool.experiments.load_disturbance.power_up import Left, another_power_up, ripple_u
from rigtool.numerics.arrays import Array
from rigtool.numerics.steady_mean import steady_mean, steady_us, weights
from rigtool.quantity import STANDARD_GRAVITY, Quantity, combined, error_line

LOAD_STEP = 0.01
"""Change of the load for a derivative, relative, or as part of the largest learned load."""

SMALLEST_STEP = 1e-4
MAX_ITERATIONS = 50
HIGHEST_LOAD, SCANNED_LOADS = 3.0, 41
"""Highest load of the scan, in parts of the largest learned one, and the number of loads."""

CONVERGED_CHANGE = 1e-5
"""Change at which a load is found, in parts of the largest learned one."""

OWN_LEVELS = 3
"""Friction levels that each recording has of its own."""


@dataclass(frozen=True, eq=False)
class LoadedPair:
    """A load beside all recordings of the same motion without it; `arm` m is where it hangs."""

    loaded: Record
    unloaded: tuple[Record, ...]
    arm: float


@dataclass(frozen=True, eq=False)
class LoadReading:
    """A load, N m at 90 degrees, by whole strokes and at one angle.

    `quantity` states it with its budget, of which `scatter_u` is a line. `cycles` (m,) are single
    readings of it, `at_angle` (m,) those at one angle of each rising stroke. `another` is the
    probability of another power-up of the amplifier than the learned one.
    """

    quantity: Quantity
    scatter_u: float
    cycles: Array
    at_angle: Array
    another: float

    @property
    def moment(self) -> float:
        """Value of the load, N m."""
        return self.quantity.value


@dataclass(frozen=True)
class DeadBand:
    """Bounds of a load where the motion stands still, N m at the output.

    `middle` is the mean of lifting and lowering, zero taken off, `half` half their difference:
    friction may hold that much either way.
    """

    middle: float
    half: float


@dataclass(frozen=True, eq=False)
class _Explained:
    """A record as a model explains it under a load: at its rows, what is measured and expected."""

    record: Record
    state: RecordState
    predicted: Prediction
    values: Array

    @staticmethod
    def of(
        model: LearnedModel, record: Record, moment: float = 0.0, arm: float = 0.0
    ) -> _Explained:
        own = replace(record, moment=moment, load_inertia=moment * arm / STANDARD_GRAVITY)
        state = RecordState.of(model.shape, model.known, own)
        values = functions(model.terms, state)
        predicted = Prediction(model.terms, model.coefficient, values, model.shape, state)
        return _Explained(own, state, predicted, values)

    def left(self) -> Array:
        """Return the residual of the model (rows,), N m at the motor."""
        torque = measured(self.record, self.state.known) - self.predicted.along(self.state)
        return self.record.rows(torque)

    def under(self, moment: float, arm: float) -> Array:
        """Return what is expected under another load (rows,), N m at the motor."""
        state = self.state.under(moment, moment * arm / STANDARD_GRAVITY)
        return self.record.rows(self.predicted.along(state))

    def design(self) -> Array:
        """Return derivatives of what is expected by shape and coefficients (p, rows)."""
        by_shape = slopes(self.predicted, self.state)
        return self.record.rows(np.vstack([by_shape, self.values]))


@dataclass(frozen=True, eq=False)
class _Found:
    """A load M, N m; readings of cycles with and without it; the probability `another` of another
    power-up, at which it is uncertain by `ripple_u`."""

    moment: float
    cycles: Array
    zeros: list[Array]
    at_angle: Array
    model_u: float
    misfit_u: float
    another: float
    ripple_u: float


def read_loads(
    model: LearnedModel,
    pairs: Sequence[LoadedPair],
    largest: float,
    angle: float,
    bandwidth_hz: float,
) -> list[LoadReading | InsufficientDataError]:
    """Read the loads of pairs that move alike; the error, where no load explains the torque.

    `largest` N m is that of the learned loads; `angle` rad of the output and the low-pass
    `bandwidth_hz` are those of the readings at one angle. How far strokes deviate from one to the
    next is what all cycles of these pairs show together; those without load, which several pairs
    have in common, count once.
    """
    zeros: dict[int, Left] = {}
    found: list[_Found | InsufficientDataError] = []
    for pair in pairs:
        key = id(pair.unloaded)
        try:
            _require_sliding(pair.loaded)
            if key not in zeros:
                zeros[key] = _zero(model, pair)
            found.append(_find(model, pair, zeros[key], largest, angle, bandwidth_hz))
        except InsufficientDataError as error:
            found.append(error)
    keys = [id(p.unloaded) for p, f in zip(pairs, found, strict=True) if isinstance(f, _Found)]
    series, shares = [], []
    for key, one in zip(keys, (f for f in found if isinstance(f, _Found)), strict=True):
        series += [one.cycles, *one.zeros]
        shares += [1.0, *[1 / keys.count(key)] * len(one.zeros)]
    us = iter(steady_us(series, shares))
    return [_stated(f, us) if isinstance(f, _Found) else f for f in found]


def _stated(found: _Found, us: Iterator[tuple[float, float]]) -> LoadReading:
    """Return a reading with its uncertainty; `us` yields those of cycles and zeros, and dof."""
    scatter_u, scatter_dof = next(us)
    zeros = [next(us) for _ in found.zeros]
    ripple_u = math.sqrt(found.another) * found.ripple_u  # rms over both power-ups
    lines = [
        error_line("scatter", scatter_u, "N m", scatter_dof),
        *(error_line("reading without load", u / len(zeros), "N m", dof) for u, dof in zeros),
        error_line("disturbance as learned", found.model_u, "N m"),
        error_line("what the disturbance leaves", found.misfit_u, "N m"),
        error_line("ripple of another power-up", ripple_u, "N m"),
    ]
    stated = combined(found.moment, "N m", lines)
    return LoadReading(stated, scatter_u, found.cycles, found.at_angle, found.another)


def _require_sliding(record: Record) -> None:
    """Raise `InsufficientDataError` where a load and `OWN_LEVELS` explain any torque."""
    if (rows := int(record.used.sum())) <= 1 + OWN_LEVELS:
        raise InsufficientDataError(
            f"the rotor slides evenly in {rows} rows of a stroke, more than {1 + OWN_LEVELS} are "
            f"needed, each of {SLIDING_COUNT_RATE:g} counts of the encoder a second: move faster"
        )


def _zero(model: LearnedModel, pair: LoadedPair) -> Left:
    """Return what the model leaves without load, at the rows of the pair."""
    count, used = pair.loaded.count, pair.loaded.used
    each = [_Explained.of(model, record) for record in pair.unloaded]
    left = np.mean([_at(one.left(), count) for one in each], axis=0)
    own = _at(_own(each[0].state), count)
    fitted = np.linalg.qr(own[:, used].T)[0]
    scattered = [_scattered(record, pair.loaded, fitted) for record in pair.unloaded]
    return Left(left, _at(each[0].design(), count), own, sum(scattered) / len(scattered) ** 2)


def _scattered(record: Record, at: Record, fitted: Array) -> float:
    """Return the `scatter_of_mean` of a record at the rows of another one."""
    return scatter_of_mean(_at(record.torques, at.count)[:, at.used], fitted)


def _own(state: RecordState) -> Array:
    """Return the friction levels that each recording has of its own (OWN_LEVELS, rows)."""
    d, a = state.housing, state.record.angle / state.known.angle_ratio
    return state.record.rows(np.stack([d, d * np.sin(a), d * np.cos(a)]))


def _at(rows: Array, count: int) -> Array:
    """Return rows (..., r) of a period at as many points as another recording of it has."""
    from scipy.signal import resample

    if rows.shape[-1] == count:
        return rows
    return resample(rows, count, axis=-1)


def _find(
    model: LearnedModel,
    pair: LoadedPair,
    zero: Left,
    largest: float,
    angle: float,
    bandwidth_hz: float,
) -> _Found:
    loaded, used = pair.loaded, pair.loaded.used
    explained = _Explained.of(model, loaded)
    shown = loaded.rows(measured(loaded, model.known)) - zero.rows

    def expected(moment: float) -> Array:
        return explained.under(moment, pair.arm)

    own = _own(explained.state)[:, used]
    moment, weight, left = _solve(shown[used], lambda m: expected(m)[used], own, largest)

    def readings(record: Record) -> Array:
        torques = _at(record.torques, loaded.count)[:, used]
        return (torques - steady_mean(torques)) @ weight

    there = _Explained.of(model, loaded, moment, pair.arm)
    design = there.design()
    by = (design - zero.design)[:, used] @ weight
    step = _step(moment, largest)
    slope = (expected(moment + step) - expected(moment)) / step
    remains = loaded.torques - steady_mean(loaded.torques) + shown - expected(moment)
    point = _crossing(loaded, angle * model.known.angle_ratio, 1)
    narrow = _narrowed(loaded, np.vstack([remains, slope]), bandwidth_hz)
    shown_at = _read(narrow, point)
    rms = float(np.sqrt(np.mean(left**2)))
    independent = max(1.0, used.sum() / ROWS_PER_INDEPENDENT_ROW)
    fitted = np.linalg.qr(np.vstack([slope[used], own]).T)[0]

    # What cycles scatter is in their readings, and is no error of the model; but it hides one of
    # the size of its own chance deviation.
    own_scatter = _scattered(loaded, loaded, fitted)
    of_zeros = [_scattered(record, loaded, fitted) for record in pair.unloaded]
    scattered = own_scatter + sum(of_zeros) / len(of_zeros) ** 2
    hidden = scattered * math.sqrt(2 / independent)
    misfit = math.sqrt(max(rms**2 - scattered, 0.0) + hidden)
    remaining = there.left()[used]
    parts = (
        zero.at(used),
        Left(remaining, design[:, used], np.vstack([slope[used], own]), own_scatter),
    )
    return _Found(
        moment=moment,
        cycles=moment + readings(loaded),
        zeros=[readings(record) for record in pair.unloaded],
        at_angle=moment + shown_at[:-1] / shown_at[-1],
        model_u=math.sqrt(max(0.0, float(by @ model.covariance @ by))),
        misfit_u=misfit * float(np.linalg.norm(weight)) * math.sqrt(used.sum() / independent),
        another=another_power_up(model, parts),
        ripple_u=ripple_u(model, by),
    )


def scatter_of_mean(torques: Array, fitted: Array) -> float:
    """Return the mean variance of the rows of a mean cycle that its cycles (m, rows) show, N m2.

    What they have along the orthonormal columns `fitted` (rows, k) is taken off, as a fit does.
    """
    off = torques - (torques @ fitted) @ fitted.T
    shares = weights(len(off))
    return float(np.mean(np.var(off, axis=0, ddof=1)) * (shares @ shares))


def _step(moment: float, largest: float) -> float:
    return max(LOAD_STEP * abs(moment), SMALLEST_STEP * largest)


def _solve(
    shown: Array, expected: Callable[[float], Array], own: Array, scale: float
) -> tuple[float, Array, Array]:
    """Return the load, N m, the weight of each row in it, and what is left at the rows, N m.

    A load that swings near its resonance fits at several places: all are scanned first.
    """
    basis = np.linalg.qr(own.T)[0]

    def misfit(moment: float) -> float:
        left = shown - expected(moment)
        left = left - basis @ (basis.T @ left)
        return float(left @ left)

    grid = scale * np.linspace(0.0, HIGHEST_LOAD, SCANNED_LOADS)
    moment, spacing = float(min(grid.tolist(), key=misfit)), float(grid[1])
    for _ in range(MAX_ITERATIONS):
        middle, step = expected(moment), _step(moment, scale)
        matrix = np.vstack([(expected(moment + step) - middle) / step, own]).T
        inverse = np.linalg.pinv(matrix)
        difference = shown - middle
        change = float(inverse[0] @ difference)
        if abs(change) <= CONVERGED_CHANGE * scale:
            return moment + change, inverse[0], difference - matrix @ (inverse @ difference)
        moment += min(max(change, -spacing), spacing)
        if moment > HIGHEST_LOAD * scale:
            break
    raise InsufficientDataError(
        f"no load up to {HIGHEST_LOAD:g} times the largest learned one, {scale * 1e3:.4g} mN m, "
        "explains the torque: learn with larger loads, or check that the tables are of this rig"
    )


def dead_band(model: LearnedModel, pair: LoadedPair, angle: float, bandwidth_hz: float) -> DeadBand:
    """Return the dead band of a pair at an output angle, rad."""

    def both(record: Record) -> tuple[float, float]:
        torque = model.known.torque_factor * record.rows(measured(record, model.known))
        rotor = angle * model.known.angle_ratio
        smooth = _narrowed(record, torque, bandwidth_hz)
        rising, falling = (float(_read(smooth, _crossing(record, rotor, s))) for s in (1, -1))
        return (rising + falling) / 2, abs(rising - falling) / 2

    middle, half = both(pair.loaded)
    return DeadBand(middle - float(np.mean([both(r)[0] for r in pair.unloaded])), half)


def _narrowed(record: Record, rows: Array, bandwidth_hz: float) -> Array:
    """Low-pass rows (..., r) once more."""
    return lowpassed_rows(rows, record.interval * record.angle.size / rows.shape[-1], bandwidth_hz)


def _crossing(record: Record, angle: float, direction: int) -> float:
    """Return at which part of the period the rotor passes an angle, rad.

    `direction` is 1 for the rising half, -1 for the falling one.
    """
    count = record.angle.size
    bottom, top = int(np.argmin(record.angle)), int(np.argmax(record.angle))
    first, last = (bottom, top) if direction > 0 else (top, bottom)
    half = np.arange(first, first + (last - first) % count + 1)
    way = np.maximum.accumulate(direction * record.angle[half % count])
    return float(np.interp(direction * angle, way, half.astype(np.float64))) / count


def _read(rows: Array, part: float) -> Array:
    """Read rows (..., r) at a part of the period, between them linearly."""
    count = rows.shape[-1]
    place = part * count
    whole = math.floor(place)
    here, there = rows[..., whole % count], rows[..., (whole + 1) % count]
    return here + (place - whole) * (there - here)
