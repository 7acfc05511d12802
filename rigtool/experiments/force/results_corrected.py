"""Table 8 with the disturbance of the load taken off: `measure-force --correction load|full`.

`load` takes friction that grows with load off the thesis's reading, at one angle of the rising
strokes, and puts back what the tendon's stretch takes off; ripple that grows with the current
remains, and is part of its uncertainty. `full` reads the load from whole strokes, lifting and
lowering, with the model learned at known loads (`experiments.load_disturbance.reading`). Both take
the torque constant at the motor's own temperature. A load outside the learned range has no value;
near standstill every load has a dead band instead of a value.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rigtool.errors import InsufficientDataError
from rigtool.experiments.force.results import (
    LOAD_COLUMNS,
    ONE_ANGLE,
    LoadReadings,
    LoadRow,
    loads_table,
    row_results,
)
from rigtool.experiments.force_model.records import Record
from rigtool.experiments.load_disturbance.reading import (
    LoadedPair,
    LoadReading,
    dead_band,
    read_loads,
)
from rigtool.experiments.load_disturbance.results_known_loads import reference_lines
from rigtool.experiments.load_disturbance.stored import Disturbance, disturbance_from, rising_load
from rigtool.experiments.outcome import Outcome
from rigtool.numerics.arrays import Array
from rigtool.numerics.steady_mean import steady_mean
from rigtool.quantity import Component, Quantity, combined, error_line, inherited
from rigtool.recipe import Recipe
from rigtool.runfile import Recording, Run

LARGEST_LOAD_RATIO = 1.05
"""Loads up to this many times the largest learned one are still read."""

LOAD_FRICTION = "friction that grows with load"
CORRECTED = f"--correction load: {LOAD_FRICTION} and the tendon's stretch are corrected"
LIKELY = 0.5
"""Probability of another power-up of the amplifier from which on a note names it."""

SPEED_SLACK = 1.01
MAX_ITERATIONS = 50


# -- load


def without_load_friction(
    loads: Sequence[LoadReadings], recipe: Recipe, tables: Run, constant: Quantity
) -> tuple[list[LoadReadings], Array]:
    """Return readings without friction that grows with load and without the tendon's stretch, and
    the u that this adds, N m (loads,).

    `loads` begin with the one without load. Solves x + friction(x) = reading - zero for what a load
    adds to the tendon, and takes the stretch off x. u includes that of both. What remains is ripple
    and the error of scale between `constant` and the learned loads: it counts where the calibration
    states no ripple at one angle, which has a line of its own, as has each cause of the error. The
    u of a load beyond the learned ones is NaN.
    """
    stated = any(line.name == ONE_ANGLE for line in constant.budget)
    disturbance = corrects(tables, recipe)
    zero = float(steady_mean(loads[0].values))
    found, us = [loads[0]], [0.0]
    for load in loads[1:]:
        shown = load.values - zero
        shift = shown.copy()
        for _ in range(MAX_ITERATIONS):
            rising = rising_load(tables, recipe, disturbance.model, shift)
            shift = shown - rising.friction
        torque = rising.torque
        inside = float(torque.mean()) <= LARGEST_LOAD_RATIO * disturbance.torque
        u = math.hypot(rising.u.mean(), 0.0 if stated else rising.remains.mean())
        us.append(u if inside else math.nan)
        found.append(replace(load, values=zero + torque))
    return found, np.array(us)


def load_outcome(
    base: Outcome, found: Sequence[LoadRow], added_u: Array, thesis: Sequence[LoadRow]
) -> Outcome:
    """Return the outcome `base` of readings `without_load_friction` with the u that it adds.

    `found` are the rows of these readings, `thesis` those of the readings before the correction.
    Raises `InsufficientDataError` where all loads are beyond the learned ones.
    """
    if np.isnan(added_u[1:]).all():
        raise InsufficientDataError(
            "all loads are beyond those that friction was learned with: learn with larger loads in "
            "[ilc_learn.loads]"
        )
    rows = [
        row.blank()
        if math.isnan(u)
        else replace(row, mean=_also(row.mean, error_line(LOAD_FRICTION, u, "N m")))
        for row, u in zip(found, added_u.tolist(), strict=True)
    ]
    described = {
        "mean_torque_u": "standard uncertainty: as for --correction none, and the friction's"
    }
    return _with_rows(
        base,
        rows,
        thesis,
        described,
        "torque read while rising, less friction by load, and without stretch; NaN: not learned",
        (CORRECTED, *base.notes),
    )


def _also(quantity: Quantity, *lines: Component) -> Quantity:
    return combined(quantity.value, quantity.unit, [*quantity.budget, *lines])


def _with_rows(
    base: Outcome,
    rows: Sequence[LoadRow],
    thesis: Sequence[LoadRow],
    described: Mapping[str, str],
    about: str,
    notes: tuple[str, ...],
) -> Outcome:
    """Return an outcome with corrected rows, and those of the thesis under a name of their own."""
    units = LOAD_COLUMNS | (WHOLE_COLUMNS if isinstance(rows[-1], WholeRow) else {})
    columns = {name: (unit, described.get(name, text)) for name, (unit, text) in units.items()}
    outside = sum(math.isnan(row.mean.value) for row in rows)
    count = Quantity(float(outside), "1", reason="a count")
    return Outcome(
        {**base.results, **row_results(rows), "loads_outside": count},
        {
            **base.tables,
            "loads": loads_table(rows, columns, about),
            "loads_uncorrected": loads_table(
                thesis, LOAD_COLUMNS, "the same loads, --correction none"
            ),
        },
        notes,
    )


# -- full


@dataclass(frozen=True)
class WholeRow(LoadRow):
    """A load read from whole strokes, as `WHOLE_COLUMNS` describes what it adds to `LoadRow`."""

    dead_band_middle: float = math.nan
    dead_band: float = math.nan
    angle_mean_torque: float = math.nan
    angle_std_torque: float = math.nan
    angle_error_percent: float = math.nan


WHOLE_COLUMNS = {
    "dead_band_middle": ("N m", "mean of lifting and lowering at the angle, as read, less zero"),
    "dead_band": ("N m", "half of lifting less lowering: what friction may hold at a standstill"),
    "angle_mean_torque": ("N m", "mean of readings at the angle, rising, with the same correction"),
    "angle_std_torque": ("N m", "S of these"),
    "angle_error_percent": ("%", "their error, of the applied torque"),
}

WHOLE_TEXTS = {
    "mean_torque": "load at the angle of the reading, from whole strokes up and down",
    "mean_torque_u": "standard uncertainty: scatter, zero, disturbance, misfit, ripple of another "
    "power-up, temperature, samples of current, weights and length of the learned loads",
    "std_torque": "S of single cycles",
    "cycles": "cycles read",
}


def full_outcome(
    base: Outcome,
    loads: Sequence[LoadReadings],
    again: Sequence[Record],
    thesis: Sequence[LoadRow],
    recipe: Recipe,
    tables: Run,
    drift: Drift,
    sampled_u: float,
) -> Outcome:
    """Return the outcome with its loads read from whole strokes.

    `base` and the rows `thesis` are those of the thesis's way, from the same `loads`; `again` are
    the strokes without load after all loads. `drift` is that of the motor's temperature since
    learning, `sampled_u` N m, at the output, the standard uncertainty by how the rig takes its
    samples of current. Where the motion is slower than any
    that was learned, loads have a dead band and no value. Raises `InsufficientDataError` where no
    load can be read though the motion was learned.
    """
    disturbance = corrects(tables, recipe)
    slow = slower_than_learned(disturbance, recipe)
    zero = (*(_whole(load) for load in loads if load.force == 0), *again)
    settings, arm = recipe.measure_force, recipe.rig.load_arm
    angle, model = math.radians(settings.measure_angle), disturbance.model
    pairs = [LoadedPair(_whole(load), zero, arm) for load in loads[1:]]
    read: Sequence[LoadReading | InsufficientDataError]
    if slow:
        read = [InsufficientDataError(slow)] * len(pairs)
    else:
        read = read_loads(model, pairs, disturbance.torque, angle, settings.lowpass_hz)
    rows: list[LoadRow] = [WholeRow(**vars(row)) for row in thesis[:1]]
    reasons = []
    for load, row, pair, reading in zip(loads[1:], thesis[1:], pairs, read, strict=True):
        band = dead_band(model, pair, angle, settings.lowpass_hz)
        blank = WholeRow(**vars(row.blank()), dead_band_middle=band.middle, dead_band=band.half)
        reason = _outside(disturbance, reading)
        if reason or isinstance(reading, InsufficientDataError):  # costs its own row only
            rows.append(blank)
            reasons.append(reason if slow else f"{load.name}: {reason}")
            continue
        sine = math.sin(angle)
        mean = _whole_quantity(reading, sine, drift.u, sampled_u)
        known = reference_lines(recipe, load.force, mean.value)
        rows.append(_row(blank, reading, sine, _also(mean, *known)))
    if len(reasons) == len(pairs) and not slow:
        raise InsufficientDataError(f"no load can be read: {reasons[0]}")
    counted = "one recording" if len(zero) == 1 else f"{len(zero)} recordings"
    notes = (
        f"--correction full: loads read from whole strokes with the disturbance of "
        f"{tables.path.name} taken off; the zero is from {counted}",
        *(f"no value: {reason}" for reason in dict.fromkeys(reasons)),
        *_power_up_notes(read),
        drift.remark,
        *base.notes,
    )
    about = (
        "torque of each load with the disturbance taken off; the first has none. NaN: outside what "
        "was learned"
    )
    return _with_rows(base, rows, thesis, WHOLE_TEXTS, about, notes)


def _power_up_notes(read: Sequence[LoadReading | InsufficientDataError]) -> Iterator[str]:
    """Say where the ripple is another one than while loads were learned."""
    if any(isinstance(one, LoadReading) and one.another > LIKELY for one in read):
        yield (
            "the amplifier's ripple differs from that while loads were learned, as after switching "
            "it off and on: what of it grows with the current is in u; learn and measure without "
            "switching it off"
        )


def _whole(load: LoadReadings) -> Record:
    assert load.whole is not None
    return load.whole


def _outside(disturbance: Disturbance, reading: LoadReading | InsufficientDataError) -> str:
    """Return the reason why a reading has no value, empty where it has one."""
    if isinstance(reading, InsufficientDataError):
        return str(reading)
    if reading.moment <= LARGEST_LOAD_RATIO * disturbance.torque:
        return ""
    return (
        f"the load is {reading.moment * 1e3:.4g} mN m, learned were loads up to "
        f"{disturbance.torque * 1e3:.4g} mN m: learn with larger loads in [ilc_learn.loads]"
    )


def _whole_quantity(
    reading: LoadReading, sine: float, drift_u: float, sampled_u: float
) -> Quantity:
    """Return the torque of a load read from whole strokes, at an angle of this sine."""
    mean = sine * reading.moment
    lines = [
        *inherited(reading.quantity, sine, ""),
        error_line("temperature since learning", abs(drift_u * mean), "N m"),
        error_line("samples of current", sampled_u, "N m"),
    ]
    return combined(mean, "N m", lines)


def _row(blank: WholeRow, reading: LoadReading, sine: float, mean: Quantity) -> WholeRow:
    """Return the row of a load that was read, at an angle of this sine."""
    applied, count = blank.applied.value, len(reading.cycles)
    scatter = sine * float(reading.cycles.std(ddof=1))
    at_angle = sine * reading.at_angle
    own = sine * reading.scatter_u
    return replace(
        blank,
        mean=mean,
        std_torque=scatter,
        std_torque_u=scatter / math.sqrt(2 * (count - 1)),
        cycles=float(count),
        effective_cycles=(scatter / own) ** 2 if own else math.nan,
        angle_mean_torque=float(at_angle.mean()),
        angle_std_torque=float(at_angle.std(ddof=1)),
        angle_error_percent=100 * (float(at_angle.mean()) / applied - 1),
    )


@dataclass(frozen=True)
class Drift:
    """Change of the motor's temperature since learning: the relative u that it brings, a remark."""

    u: float
    remark: str


def temperature_drift(unloaded: Sequence[Recording], kt: Run, tables: Run) -> Drift:
    """Return the drift from the learned loads to recordings without load."""
    now = float(np.mean([np.mean(recording.read("temperature")) for recording in unloaded]))
    warmer = now - tables.result("learned_temperature", "degC").value
    name = "torque_constant_temperature_coefficient"
    text = f"the motor is {warmer:+.2g} K from where loads were learned"
    if name not in kt.results:
        return Drift(
            0.0,
            f"{text}; {kt.path.name} states no temperature coefficient, so nothing is corrected "
            "for it",
        )
    slope = kt.result(name, "1/K")
    percent = 100 * warmer * slope.value
    return Drift(
        abs(warmer) * (slope.u or 0.0), f"{text}; its constant is corrected by {percent:+.2g} %"
    )


# -- what both need


def corrects(tables: Run, recipe: Recipe) -> Disturbance:
    """Return the disturbance that tables hold for the motion of `measure_force`.

    Raises `RunFileError` where they hold none, `InsufficientDataError` where the motion is faster
    than any that was learned, or too slow for `load`.
    """
    disturbance = disturbance_from(tables, recipe)
    speed = recipe.measure_force.speed_rev_per_s
    fastest = disturbance.speeds[-1] / (2 * math.pi * recipe.rig.angle_ratio)
    slow = slower_than_learned(disturbance, recipe)
    if slow and recipe.measure_force.correction == "load":
        raise InsufficientDataError(slow)
    if speed > fastest * SPEED_SLACK:
        raise InsufficientDataError(
            f"measure_force moves at {speed:.3g} rev/s, loads were learned up to {fastest:.3g} "
            "rev/s: move slower, or learn with a higher speed in [ilc_learn.loads]"
        )
    return disturbance


def slower_than_learned(disturbance: Disturbance, recipe: Recipe) -> str:
    """Return the reason why a motion is too slow for a value, empty where it is not."""
    speed = recipe.measure_force.speed_rev_per_s
    slowest = disturbance.speeds[0] / (2 * math.pi * recipe.rig.angle_ratio)
    if speed * SPEED_SLACK >= slowest:
        return ""
    return (
        f"measure_force moves at {speed:.3g} rev/s, loads were learned from {slowest:.3g} rev/s "
        "on: closer to standstill friction may hold any part of the load within its dead band; "
        "move faster, or learn with a lower speed in [ilc_learn.loads]"
    )
