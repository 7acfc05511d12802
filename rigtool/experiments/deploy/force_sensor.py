"""The causal estimate of torque over time as a C header: the template `force_sensor.h` with data.

The template holds all of the algorithm; only numbers go into it, and a comment on their origin.
Its equations are those of `force_filter.plant`, `kalman` and `passed`, its states those of
`force_filter.motion_states`; the covariance is U diag(d) U' (G. J. Bierman, Factorization
Methods for Discrete Sequential Estimation, 1977), which 4-byte numbers carry.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from importlib.resources import files

import numpy as np
from numpy.typing import NDArray

from rigtool.experiments.deploy.c_header import comment
from rigtool.experiments.force_filter import (
    creeping,
    kalman,
    lost_counts,
    motion_states,
    passed,
    rests,
    swinging,
)
from rigtool.experiments.force_filter.estimate import idle_steps
from rigtool.experiments.force_model.drawn_ripple import learned_ripple
from rigtool.experiments.force_model.drive import VISCOUS
from rigtool.experiments.force_model.intervals import SHOWN_FACTOR
from rigtool.experiments.force_model.steps import LONGEST_EXACT, NO_CURRENT, held_samples
from rigtool.experiments.force_sensor.power_up import (
    lasting_contact,
    mixed_ripple,
    ripple_rows,
    shown_ripple,
)
from rigtool.experiments.force_sensor.sensor import AT_THE_LIMIT, SensorProperties
from rigtool.numerics.arrays import Array

Number = float | int | str | Array | NDArray[np.int64]

DIGITS = 12
"""Digits of the maps' numbers; all other numbers are exact."""

INT32 = 2**31 - 1
"""Largest count of an encoder in the header."""


def sensor_header(
    instrument: SensorProperties, coverage_factor: float, origin: Sequence[str]
) -> str:
    """Return the text of the header for samples every `instrument.interval` s.

    `coverage_factor` is that of the interval, and `origin` are the lines about where the numbers
    come from. Raises `ValueError` for samples further apart than those of the equations, for an
    output without inertia, and numbers that are not finite.
    """
    model, plant = instrument.model, instrument.plant
    if not instrument.grid.immediate:
        raise ValueError(
            f"angles between the samples of a loop of {1 / instrument.interval:.4g} Hz come from "
            f"later ones, above {1 / LONGEST_EXACT:.0f} Hz they do not"
        )
    if plant.grasper_inertia <= 0:
        raise ValueError(
            f"inertia of the output {plant.grasper_inertia:g} kg m2: the equations in C need one"
        )
    numbers = {
        **_drive(instrument),
        **_filter(instrument),
        **_ripple(instrument),
        **_states(instrument),
        **_reading(instrument, coverage_factor),
    }
    for name, value in numbers.items():
        if not isinstance(value, str) and not np.isfinite(value).all():
            raise ValueError(f"{name} is {value}")
    rotor_map = model.drive.rotor_map.copy()
    rotor_map[:, VISCOUS] += plant.housing_viscous  # of the same speed
    data = [
        "".join(f"#define RS_{name} {value}\n" for name, value in _steps(instrument).items()),
        _struct(numbers),
        _map("rotor_map[RS_ROTOR_CELLS + 1][RS_COLUMNS]", rotor_map),
        _map("housing_map[RS_HOUSING_CELLS + 1][2]", plant.friction_map),
    ]
    template = files("rigtool.experiments.deploy").joinpath("force_sensor.h").read_text("utf-8")
    # The comment comes last: its text is others', and no marker in it counts.
    return template.replace("@DATA@", "\n".join(data), 1).replace("@HEAD@", comment(origin), 1)


def _steps(instrument: SensorProperties) -> dict[str, int]:
    """Return the numbers of samples, steps and cells."""
    grid, model = instrument.grid, instrument.model
    step_time = grid.step_time
    return {
        "AVERAGED": grid.averaged,
        "DIVIDED": grid.divided,
        "STEP_SAMPLES": grid.step_samples,
        "STILL_STEPS": _within(motion_states.STILL_TIME, step_time),
        "UNSEEN_STEPS": instrument.judge(causal=True).unseen,
        "LIMIT_STEPS": _within(motion_states.LIMIT_TIME, step_time),
        "SPEED_STEPS": _within(motion_states.SPEED_TIME, step_time) - 1,
        "IDLE_STEPS": idle_steps(step_time),
        "HELD": held_samples(instrument.interval),
        "LEAP": int(min(instrument.counts().largest_step, INT32 // 4)),
        "COUNTING_SAMPLES": int(lost_counts.COUNTING_TIME / instrument.interval),
        "RESTED_STEPS": creeping.steps_of(creeping.RESTED_TIME, step_time),
        "SWUNG_STEPS": creeping.steps_of(creeping.LASTING_TIME, step_time),
        "BUSY_STEPS": int(kalman.lasting_steps(model.uncertainty.busy_time, step_time)),
        "REST_STEPS": int(rests.rest_steps(step_time)),
        "ROW_STEPS": ripple_rows.row_steps(step_time),
        **dict(zip(("DRAW_FACTOR", "DRAW_ADDED", "DRAW_MODULUS"), ripple_rows.DRAW, strict=True)),
        "HELD_STEPS": ripple_rows.held_steps(step_time),
        "LATE_ROWS": ripple_rows.late_rows(step_time),
        "SPREAD_STEPS": ripple_rows.SPREAD_STEPS,
        "ROTOR_CELLS": len(model.drive.rotor_map) - 1,
        "HOUSING_CELLS": len(instrument.plant.friction_map) - 1,
    }


def _within(span: float, step_time: float) -> int:
    """Return the number of steps in a span of time, s, that ends with a step, included."""
    return 2 * max(1, round(span / step_time / 2)) + 1


def _drive(instrument: SensorProperties) -> dict[str, Number]:
    grid, model, plant = instrument.grid, instrument.model, instrument.plant
    constant, slope = instrument.torque_constant
    turn = round(2 * math.pi / instrument.count)
    equations = {
        name: getattr(plant, name)
        for name in plant.__dataclass_fields__
        if name not in ("static", "housing_viscous", "friction_map")
    }
    return {
        **equations,
        "static_friction": plant.static,
        "step_time": grid.step_time,
        "count": instrument.count,
        "turn": turn,
        "output_turn": f"{round(2**64 / (turn * plant.angle_ratio)) % 2**64}u",
        "constant": constant,
        "constant_slope": slope,
        "offset_current": model.drive.offset,
        "ripple_kept": math.exp(-grid.sample_time / model.drive.ripple_time),
        "delay_kept": model.drive.delay_kept(grid.sample_time),
    }


def _filter(instrument: SensorProperties) -> dict[str, Number]:
    own, span = instrument.model.uncertainty, instrument.grid.step_time
    moving = (
        *(own.angle_rate, own.speed_rate, own.bristle_rate, own.slip_rate),
        *(own.grasper_rate, own.speed_rate, own.slip_rate),
    )
    same = (
        *("stroke", "load_stroke", "friction_noise", "undecided", "edge"),
        *("torque_start", "bristle_start", "speed_start"),
    )
    return {
        **{name: getattr(own, name) for name in same},
        "noise_kept": math.exp(-span / own.friction_noise_time),
        "quiet_walk": own.torque_rate**2 * span,
        "slow_walk": own.slow_torque_rate**2 * span,
        "step_walk": own.step_torque_rate**2 * span,
        "walk": np.square(moving) * span,
        "short_kept": math.exp(-span / kalman.SHORT),
        "long_kept": math.exp(-span / kalman.LONG),
        "busy_kept": math.exp(-span / kalman.BUSY_MEMORY),
        "most_busy": kalman.MOST_BUSY,
        "busy_steps": own.busy_time / span,
        "busy_whole": 1 - kalman.ROUNDING,
        "step_threshold": kalman.STEP_THRESHOLD,
        "slow_threshold": kalman.SLOW_THRESHOLD,
        "least_variance": kalman.LEAST_VARIANCE,
    }


def _ripple(instrument: SensorProperties) -> dict[str, Number]:
    model, step_time = instrument.model, instrument.grid.step_time
    learned, lag_time = learned_ripple(model), model.learned.shape.ripple_time
    uncertainty = model.uncertainty
    plant = model.plant(step_time)
    size = plant.torque_factor * (uncertainty.stroke + uncertainty.friction_noise)
    row_time = ripple_rows.row_steps(step_time) * step_time
    both = np.stack([mixed_ripple.CHANGED**2 * learned.drawn, learned.drawn])
    return {
        "wave_kept": math.exp(-step_time / lag_time),
        "wave_order": learned.orders,
        "wave_lag": lag_time,
        "wave_unfollowed": plant.torque_factor**2 * learned.unfollowed,
        "wave_growth": learned.growth,
        "wave_held": shown_ripple.LARGEST_SHOWN,
        "wave_shown": 1 - math.exp(-step_time / shown_ripple.SHOWN_TIME),
        "wave_slow": shown_ripple.HELD_LENGTHS * plant.presliding_angle / step_time,
        "wave_turn": step_time / shown_ripple.turned_inertia(plant),
        "wave_mean": np.stack([0 * learned.coefficient, -learned.coefficient]),
        "wave_variance": both,
        "wave_square": plant.torque_factor**2 * learned.drawn.sum(),
        "wave_doubt": both * (mixed_ripple.TURNS * row_time / ripple_rows.FORGOTTEN),
        "row_noise": (ripple_rows.NOISE * size) ** 2,
        "row_walk": (np.array(ripple_rows.WALKS) * size) ** 2 * row_time,
        "row_reversal": (ripple_rows.AFTER_REVERSAL * size) ** 2 * row_time / ripple_rows.ROW_TIME,
        "row_contact": (ripple_rows.CONTACT * size) ** 2,
        "row_untouched": size**2,
        "row_kept": math.exp(-row_time / ripple_rows.MEMORY),
        "row_begins": ripple_rows.BEGINS * row_time,
        "row_ends": ripple_rows.ENDS * row_time,
        "row_changes": ripple_rows.CHANGES * row_time,
        "row_least": ripple_rows.MIN_UNTOUCHED_PROBABILITY,
        "row_evidence": mixed_ripple.ROW_EVIDENCE,
        "row_certain": mixed_ripple.MAX_LOG_RATIO,
        "row_largest": ripple_rows.LARGEST_RIPPLE_RATIO**2,
        "row_recognised": ripple_rows.RECOGNISED,
        "row_lasts": lasting_contact.LASTS,
        "row_lasting": (lasting_contact.LASTING * size) ** 2,
        "row_drift": (lasting_contact.DRIFT * size) ** 2 * row_time,
        "row_least_lasts": lasting_contact.LEAST_LASTS,
        "row_same": mixed_ripple.SAME,
        "row_beforehand": mixed_ripple.BEFOREHAND,
        "row_hangs": lasting_contact.HANGS,
        "row_hanging": (np.array(lasting_contact.HANGING) * size) ** 2,
    }


def _states(instrument: SensorProperties) -> dict[str, Number]:
    reach, count = instrument.reach, instrument.count
    low, high = reach.angle
    margin = motion_states.BEYOND_ANGLE * (high - low)
    cold, warm = np.clip(reach.temperature_degc, -1e4, 1e4)
    return {
        "sliding": motion_states.SLIDING_DEFLECTION,
        "speed_limit": motion_states.FASTEST_LEARNED_RATIO * reach.speed,
        "slow": reach.slow,
        "crawling": instrument.judge(causal=True).crawling,
        "torque_limit": motion_states.LARGEST_LEARNED_RATIO * reach.torque,
        "current_limit": AT_THE_LIMIT * instrument.current_limit,
        "largest_current": instrument.current_limit,
        "cold": cold,
        "warm": warm,
        "farthest": instrument.farthest_degc,
        "lowest": max(math.ceil((low - margin) / count), -INT32),
        "highest": min(math.floor((high + margin) / count), INT32),
    }


def _reading(instrument: SensorProperties, coverage_factor: float) -> dict[str, Number]:
    step_time = instrument.grid.step_time
    grows, falls = swinging.factors(step_time)
    return {
        "low_pass": passed.section(instrument.corner_hz, step_time),
        "settled": passed.settled(passed.section(instrument.corner_hz, step_time)),
        "scales": instrument.model.scales[1],
        "coverage": coverage_factor,
        "shown_variance": SHOWN_FACTOR**2,
        "no_current": NO_CURRENT,
        "open_variances": instrument.open_variances[1:3],
        "held_variance": instrument.held_variance,
        "rest_variance": instrument.model.rest_variance,
        "creep_more": creeping.MORE,
        "creep_variance": instrument.creeping_torque**2 / 3,
        "level_kept": math.exp(-step_time / swinging.LEVEL_TIME),
        "swing_grows": grows,
        "swing_falls": falls,
        "least_swing": instrument.least_swing,
        "swing_taken": swinging.TAKEN_VARIANCE,
    }


def _struct(numbers: Mapping[str, Number]) -> str:
    lines = (f"    .{name} = {_literal(value)},\n" for name, value in numbers.items())
    return "static const struct rs_model rs_model = {\n" + "".join(lines) + "};\n"


def _literal(value: Number) -> str:
    if isinstance(value, np.ndarray):
        return "{" + ", ".join(_literal(part) for part in value) + "}"
    if isinstance(value, str):
        return value
    return str(value) if isinstance(value, int | np.integer) else repr(float(value))


def _map(declaration: str, values: Array) -> str:
    rows = [", ".join(f"{v:.{DIGITS}g}" for v in np.atleast_1d(row)) for row in values]
    whole = "".join(f"    {{{row}}},\n" if values.ndim > 1 else f"    {row},\n" for row in rows)
    return f"static const rs_real rs_{declaration} = {{\n{whole}}};\n"
