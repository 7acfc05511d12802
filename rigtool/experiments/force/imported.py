"""`measure-force` on imported runs: torque at the load from the motor's current and encoder.

A load model that `ilc-learn --implementation D` learned on the same rig turns effort and motion
into torque. Where the runs hold a sensor's `reference_torque`, it judges the result and is used for
nothing else: errors by kind of stroke, and a Table 8 at one position of the closing strokes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rigtool.errors import InsufficientDataError, UsageError
from rigtool.experiments.force.imported_strokes import read_strokes, scatter_results, stroke_loads
from rigtool.experiments.force_filter.accuracy import accuracy
from rigtool.experiments.force_filter.motion_states import State
from rigtool.experiments.force_sensor.results_over_time import TorqueRows, over_time_tables
from rigtool.experiments.imported_load.basis import LoadSignals
from rigtool.experiments.imported_load.imported_signals import REFERENCE_CHANNEL, read_all
from rigtool.experiments.imported_load.learning import levels_of
from rigtool.experiments.imported_load.loop import DOUBTED, REFUSED
from rigtool.experiments.imported_load.model import LoadModel, TorqueEstimate, pace_of
from rigtool.experiments.imported_load.region import reached
from rigtool.experiments.imported_load.stored import load_model_from
from rigtool.experiments.outcome import Outcome
from rigtool.quantity import Quantity
from rigtool.runfile import Column, Run, Table
from rigtool.runfile.schema import IMPORTED

MOST_BEYOND = 0.25
"""Part of the way beyond the learned stroke from which on the encoder was zeroed elsewhere."""

END_SHARE = 1e-3
"""Part of the samples at either end of the way that do not show how far strokes go."""

LEAST_BEYOND = 0.005
"""Part of the way by which strokes leave the learned one, from which on they are longer, or the
encoder was zeroed elsewhere: what is below is the encoder's noise."""

LEAST_NOISIER = 1.1
"""Factor by noise that was not learned, on u, from which on a note states it."""

OTHER_SENSOR = 1.5
"""Ratio of the sensor's torque and the measured one from which on no error of either explains it:
a unit, a sign, or a gear between the sensor and where that of learning was."""

FAST_SPEED = 0.25
"""Strokes count as moving fast from this speed of the output on, rad/s, as by O'Neill et al., IEEE
RA-L 3(4) 3027-3034, 2018."""


@dataclass(frozen=True, eq=False)
class Measured:
    """One run: its signals and the model's estimate from them."""

    signals: LoadSignals
    estimate: TorqueEstimate


def analyse_imported(runs: Sequence[Run], *, tables: Run, kt: Run | None = None) -> Outcome:
    """Measure torque, and compare it with the sensor where there is one.

    Raises `UsageError` for tables of another rig, `InsufficientDataError` for those of another
    mounting and where all is outside what was learned.
    """
    model, unit = load_model_from(tables)
    _require_learned_here(runs, tables)
    read = read_all(runs, kt, model.bandwidth_hz, unit)
    measured = [Measured(one, model.read(one)) for one in read]
    _require_stroke(measured, model, tables)
    notes = [*_require_inside(measured, model), *_also_learned(runs, tables)]
    measured, remarks = of_this_zero(measured, model)
    notes += remarks
    measured, remarks = _of_this_mounting(measured, model, tables)
    rows = [_reading(item) for item in measured]
    results, found = over_time_tables(rows, model.scales.torque, model.bandwidth_hz)
    found["force"] = _with_motion(found["force"], measured, model.direction)
    results |= _own_results(TorqueRows.joined(rows), model)
    notes += remarks
    if all(item.signals.reference is not None for item in measured):
        more, judged_tables, remarks = _judged(measured, model)
        results |= more
        found |= judged_tables
        notes += remarks
    else:
        notes.append(f"not every run holds {REFERENCE_CHANNEL}: the torque is not judged")
    return Outcome(results, found, tuple(notes))


def _require_stroke(measured: Sequence[Measured], model: LoadModel, tables: Run) -> None:
    """Raise `InsufficientDataError` where much of the way is beyond the learned stroke."""
    paths = [item.signals.path for item in measured]
    place = np.concatenate([model.place(path)[path.regular] for path in paths])
    beyond = float(np.mean(~reached(place)))
    if beyond > MOST_BEYOND:
        low, high = model.scales.low, model.scales.high
        raise InsufficientDataError(
            f"{100 * beyond:.0f} % of the way is beyond the stroke that {tables.path} was learned "
            f"on, {low:.4g} to {high:.4g} rad of the motor: the encoder was zeroed elsewhere, or "
            "the tables are of another instrument or mounting; learn tables from runs of this one"
        )


def of_this_zero(
    measured: Sequence[Measured], model: LoadModel
) -> tuple[list[Measured], list[str]]:
    """Return the estimates with u widened where strokes leave the learned one, and a note.

    They are longer, or the encoder was zeroed elsewhere, by as much as they leave it. In the second
    case the torque is that at positions moved back: the difference is added to u as a standard
    uncertainty, the largest of a run where one of the two has no value.
    """
    paths = [item.signals.path for item in measured]
    place = np.concatenate([model.place(path)[path.regular] for path in paths])
    lowest, highest = np.quantile(place, [END_SHARE, 1 - END_SHARE])
    back = max(-lowest, 0.0) if -lowest > highest - 1 else -max(highest - 1, 0.0)
    if abs(back) <= LEAST_BEYOND:
        return list(measured), []
    back *= model.scales.high - model.scales.low
    found = []
    for item in measured:
        moved = model.read(replace(item.signals, path=item.signals.path.moved(back)))
        apart = np.abs(moved.moving - item.estimate.moving)
        largest = float(np.max(apart, where=np.isfinite(apart), initial=0.0))
        doubt = np.nan_to_num(apart, nan=largest)
        found.append(Measured(item.signals, item.estimate.widened(doubt=doubt)))
    return found, [
        f"strokes leave the learned one by {abs(back):.3g} rad of the motor: they are longer, or "
        "the encoder was zeroed elsewhere; u holds what that changes"
    ]


def _of_this_mounting(
    measured: Sequence[Measured], model: LoadModel, tables: Run
) -> tuple[list[Measured], list[str]]:
    """Return the estimates with u widened where strokes to and fro disagree, and notes.

    Raises `InsufficientDataError` where strokes disagree more than in any learned recording, or all
    runs together in one sense, and no load that changes explains it.
    """
    loop = model.loop
    offsets, shapes, changing = np.array([_loop_parts(item, model) for item in measured]).T
    known = np.isfinite(offsets)
    if not known.any():
        return list(measured), [
            "no run has strokes in both directions at the same places: whether the tables are of "
            "this mounting cannot be checked"
        ]
    misfits = np.maximum(np.abs(offsets), shapes)
    shown = changing[known]
    typical = float(np.median(misfits[known] / shown))
    together = abs(float(np.mean(offsets[known] / shown)))
    runs = int(known.sum())
    doubted, refused = (
        (loop.limit(level, runs), loop.limit_of_mean(level, runs)) for level in (DOUBTED, REFUSED)
    )
    for found, most, whose in ((typical, refused[0], ""), (together, refused[1], " in one sense")):
        if found > most:
            raise InsufficientDataError(
                f"strokes to and fro disagree {found:.1f} times as much{whose} as in the runs that "
                f"{tables.path} was learned from, {most:.1f} times at most is by chance: these "
                "runs are of another instrument or mounting, or of loads, speeds, signs or units "
                "unlike the learned ones: learn tables from runs of this mounting, under three "
                "loads or more (two with --prior, where there is no third)"
            )
    factors = np.where(np.nan_to_num(misfits) > loop.limit(DOUBTED), misfits, 1.0)
    if (usual := float(np.median(misfits[known]))) > doubted[0]:
        factors = np.maximum(factors, usual)
    if (mean := abs(float(np.mean(offsets[known])))) > doubted[1]:
        factors = np.maximum(factors, math.hypot(1, mean))
    wider = [
        item if factor == 1 else Measured(item.signals, item.estimate.widened(factor))
        for item, factor in zip(measured, factors.tolist(), strict=True)
    ]
    notes = [
        f"strokes to and fro disagree {typical:.2g} times as much as in the runs that were learned "
        f"from, {together:.2g} times in one sense; tables of another mounting are refused beyond "
        f"{refused[0]:.2g} and {refused[1]:.2g} times"
    ]
    if (many := int(np.count_nonzero(factors > 1))) > 0:
        notes.append(
            f"u of {many} runs is wider, up to {factors.max():.2g} times: their strokes disagree "
            "more, or their load changes in time"
        )
    return wider, notes


def _loop_parts(item: Measured, model: LoadModel) -> tuple[float, float, float]:
    path, estimate = item.signals.path, item.estimate
    offset, shape, changing = model.loop.parts(model.place(path), path.speed > 0, estimate.compared)
    return offset / estimate.noisier, shape / estimate.noisier, changing


def _require_learned_here(runs: Sequence[Run], tables: Run) -> None:
    if tables.rig != runs[0].rig:
        raise UsageError(
            f"{tables.path}: was learned on {tables.rig or 'an unknown rig'}, the runs are of "
            f"{runs[0].rig or 'an unknown rig'}: learn tables from runs of this rig"
        )


def _also_learned(runs: Sequence[Run], tables: Run) -> list[str]:
    inputs = {item["content_sha256"] for item in tables.provenance["inputs"]}
    both = [run.path.name for run in runs if run.content_sha256 in inputs]
    if not both:
        return []
    return [
        f"the tables were learned from {len(both)} of these runs ({both[0]}, ...): errors there "
        "show less than those of runs that were kept from learning"
    ]


def _require_inside(measured: Sequence[Measured], model: LoadModel) -> list[str]:
    """Return notes on samples without an estimate; raise where no sample has one."""
    states = np.concatenate([item.estimate.states for item in measured])
    wild = np.concatenate([~item.signals.path.regular for item in measured])
    inside = np.isin(states, (State.AGAINST, State.WITH))
    hidden = np.isin(states, (State.REVERSED, State.STILL))
    if not inside.any():
        raise InsufficientDataError(
            f"all {len(states)} samples are outside the position, speed and load of the tables "
            f"(learned up to {model.scales.torque * 1e3:.3g} mN m), or at rest: learn from runs "
            "that cover these, or correct a unit or a sign of position or effort in the mapping "
            "that differs from that of the learned runs"
        )
    notes = [
        f"{int(np.sum(states == State.OUTSIDE))} of {len(states)} samples are outside what was "
        "learned and have no value",
        f"{int(np.sum(hidden))} samples are near standstill (below "
        f"{model.scales.standstill:.3g} rad/s) or after a reversal: the torque is the middle of a "
        "dead band there",
    ]
    elsewhere = sum(model.elsewhere(item.signals.path) for item in measured)
    if elsewhere and (factor := max(side.elsewhere for side in model.sides)) > 1:
        notes.append(
            f"strokes of {elsewhere} runs are at places of which none was learned: u is wider, up "
            f"to {factor:.2g} times, as strokes show that were left out of learning"
        )
    changes = [
        change for item in measured if (change := model.paces.change(pace_of(item.signals.path)))
    ]
    if changes and (factor := max(s.at_other_speeds(max(changes)) for s in model.sides)) > 1:
        notes.append(
            f"strokes of {len(changes)} runs have speeds of which none was learned: u is wider, up "
            f"to {factor:.2g} times, as leaving out the first and the last learned speed shows"
        )
    noisier = [item.estimate.noisier for item in measured]
    if max(noisier) > LEAST_NOISIER:
        count = sum(one > LEAST_NOISIER for one in noisier)
        notes.append(
            f"u of {count} runs is wider, up to {max(noisier):.2g} times: their effort has more "
            "noise or coarser steps than where it was learned, or passed a low-pass that was not "
            "there"
        )
    if wild.any():
        where = [item for item in measured if (~item.signals.path.regular).any()]
        notes.append(
            f"{int(np.sum(wild))} samples of {len(where)} runs belong to a transient, such as "
            "homing, are in a gap or before the first reversal behind it, or have an effort that "
            "is at its limit or does not change, and have no value"
        )
    return notes


def _own_results(whole: TorqueRows, model: LoadModel) -> dict[str, Quantity]:
    """Return the results that need no sensor."""
    moving = (whole.states == State.AGAINST) | (whole.states == State.WITH)
    found = {
        "bandwidth": Quantity(model.bandwidth_hz, "Hz", reason="of all signals, as learned"),
        "torque_u_median": Quantity(
            float(np.median(whole.u[moving])), "N m", reason="itself an uncertainty: of one sample"
        ),
    }
    if whole.hidden.any():
        width = float(np.median(2 * whole.half[whole.hidden]))
        reason = "the median width, near standstill and after reversals"
        found["dead_band"] = Quantity(width, "N m", reason=reason)
    return found


def _reading(item: Measured) -> TorqueRows:
    """Return a run as force over time has it."""
    time, estimate = item.signals.path.time, item.estimate
    return TorqueRows(
        name=IMPORTED,
        step_time=float(time[-1] - time[0]) / max(len(time) - 1, 1),
        time=time,
        torque=np.nan_to_num(estimate.torque),  # no value: the state is that of none
        u=np.nan_to_num(estimate.u),
        states=estimate.states,
        reference=item.signals.reference,
        dead_bands=True,
    )


def _with_motion(table: Table, measured: Sequence[Measured], direction: int) -> Table:
    """Return the table with what the torque was read from."""
    signals = [item.signals for item in measured]
    position = np.concatenate([one.path.position for one in signals])
    speed = direction * np.concatenate([one.output_speed for one in signals])
    effort = np.concatenate([one.effort for one in signals])
    columns = dict(table.columns) | {
        "position": Column(position, "rad", "motor"),
        "speed": Column(speed, "rad/s", "of the output, positive against the load"),
        "effort": Column(effort, signals[0].effort_unit, "of the motor"),
    }
    return replace(
        table,
        columns=columns,
        description="torque at the load over time, in the sensor's sign, low-passed as all signals",
    )


def _judged(
    measured: Sequence[Measured], model: LoadModel
) -> tuple[dict[str, Quantity], dict[str, Table], list[str]]:
    """Return results, tables and notes of the comparison with the sensor: of strokes."""
    fast = [model.direction * m.signals.output_speed / FAST_SPEED for m in measured]
    pairs = [(m.signals, m.estimate.moving, f > 1) for m, f in zip(measured, fast, strict=True)]
    strokes = read_strokes(pairs)
    results, notes = scatter_results(strokes)
    torque, sensor = (
        np.concatenate(parts)
        for parts in zip(*((m.estimate.moving, m.signals.sensor) for m in measured), strict=True)
    )
    error, speed = torque - sensor, np.concatenate(fast)
    ratio = float(np.nansum(torque * sensor) / np.nansum(torque**2))
    if not 1 / OTHER_SENSOR < ratio < OTHER_SENSOR:
        notes.append(
            f"{REFERENCE_CHANNEL} is {ratio:.3g} times the measured torque: see to its sign, its "
            "unit and its place, which may differ from those of the learned runs; what it judges "
            "here is no error of the torque"
        )
    reason = (
        f"itself a measure of uncertainty; NaN: no such stroke is faster than {FAST_SPEED:g} rad/s"
    )
    for name, own in (("closing", speed > 1), ("opening", speed < -1)):
        rms = accuracy(error, np.isfinite(error), own).rmse
        results[f"rmse_{name}"] = Quantity(rms, "N m", reason=reason)
    table = stroke_loads(strokes, levels_of([item.signals for item in measured]))
    if table is None:
        notes.append(
            f"no closing stroke passes the middle of the stroke faster than {FAST_SPEED:g} rad/s: "
            "there is no table of loads"
        )
    return results, {} if table is None else {"loads": table}, notes
