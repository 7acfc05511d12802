"""Torque on the output by a filter over angle, speed, bristles and torque, causal.

    prediction   x- = f(x),  P- = Phi P Phi' + Q,  Phi the derivative of f in closed form
    update       the angle lies within its count: `interval`, with s^2 = P-[0, 0] plus the variance
                 of an edge.
                 K = P-[:, 0] / s^2, x = x- + K s d, P = P- - K K' s^2 (1 - rho)
                 After an update, the normal distribution reaches beyond the count again, and the
                 same count would be used twice. Where the count stays the same, d is therefore less
                 by the shift, and rho is divided by the variance ratio, that truncating the state
                 after the last update once more would give.
    torque       random walk with three levels. A contact is no steady drift; with one level for
                 all, the filter would assign a load step to the bristles. Leaky sums of the
                 corrections d over SHORT and LONG show a step and a slow change: where one exceeds
                 its threshold, its level holds for `busy_time`. A count that passes while the motor
                 has no current is a slow change, too: the torque moves the rotor then. A force that
                 swings goes on to change where the sums do not show it. If each `busy_time` of
                 change is followed by another one with a probability p, changes last for
                 busy_time / (1 - p) in the mean: so long the level of a slow change holds, with p
                 the part of the time, of memory BUSY_MEMORY, in which the noise was raised.
    reversal     where the housing's bristle crosses -1/2 in the direction of motion, a new stroke
                 begins: its deviations return to their prior.

Bristles as states give friction after a reversal and at rest from the path since sliding, so that
the dead band is what a count leaves open instead of the whole friction. R. E. Kalman 1960; adaptive
noise after R. K. Mehra, IEEE Trans. Autom. Control 15(2) 175-184, 1970.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rigtool.experiments.force_filter import passed
from rigtool.experiments.force_filter.interval import truncated
from rigtool.experiments.force_filter.joint_covariance import (
    JOINT_LENGTH,
    at,
    propagate,
    remove,
    renew,
)
from rigtool.experiments.force_filter.linear import ROW_LENGTH
from rigtool.experiments.force_filter.plant import (
    ANGLE,
    BRISTLE,
    COSINE,
    FACTOR_COUNT,
    GRASPER,
    GRASPER_SPEED,
    HOUSING,
    LOAD,
    NOISE,
    SINE,
    SPEED,
    STATES,
    TIP,
    TORQUE,
    Plant,
    Record,
    advance,
)
from rigtool.experiments.force_filter.rests import limits_rest
from rigtool.numerics.arrays import Array, Mask
from rigtool.numerics.compiled import compiled, compiled_allocating

SHORT, LONG = 6e-3, 0.1
"""Memories of the leaky sums of corrections, s."""

BUSY_MEMORY, MOST_BUSY = 0.5, 0.9
"""Memory of the part of the time in which the noise is raised, s, and the largest part."""

STEP_THRESHOLD, SLOW_THRESHOLD = 4e-3, 10e-3
"""Sums (standard deviations times s) from which on a step, or a slow change, is under way."""

FOLLOWED = (ANGLE, SPEED, HOUSING, SINE, COSINE, TORQUE)
"""States through which the torque follows an unknown drive torque: `power_up`."""

FIRST_GAIN = 3
OUTPUTS = FIRST_GAIN + len(FOLLOWED)
"""Columns of the outputs: the first gain, and how many there are."""

ROUNDING = 1e-3
"""Part of a step by which a time may be longer than whole steps: rounding does not decide."""

LEAST_VARIANCE = 1e-3
"""Smallest variance of the angle after an update, relative to before: it stays positive."""

STATE = np.dtype(
    [
        ("mean", "f8", (STATES,)),
        # of the states and of q, in rows of ROW_LENGTH columns; and q, see `passed`
        ("covariance", "f8", (passed.JOINT_STATES, ROW_LENGTH)),
        ("passed", "f8", (passed.LOW_PASS_ORDER,)),
        ("direction", "f8"),
        # of a step and of a slow change: leaky sum of corrections, steps left at its level
        ("step_sum", "f8"),
        ("step_left", "f8"),
        ("slow_sum", "f8"),
        ("slow_left", "f8"),
        ("busy", "f8"),  # part of the time in which the level is raised
        ("low", "f8"),  # of the count that the angle is in
        # steps since the angle was beyond this count and the next one, and the last one
        ("rested_up", "f8"),
        ("rested_down", "f8"),
        # what the last update left of the angle; of variance 0, none yet
        ("angle", "f8"),
        ("variance", "f8"),
    ]
)


@dataclass(frozen=True)
class Uncertainty:
    """Standard deviations of the errors of the equations of `Plant`, SI.

    `stroke` [N m] and `load_stroke` (relative) are drawn at each reversal; `friction_noise` [N m]
    has the memory `friction_noise_time` [s]. What ends in `_rate` is a random walk per square root
    of a second; on angles, speeds and bristles it is small and keeps the covariance positive.
    `edge` is that of the encoder's edges, in counts. `undecided` is the multiple of its standard
    deviation by which the speed must differ from zero until its direction is certain. With
    `repeats` of 1 each step uses a count in full, and not only what it adds. `torque_start` [N m],
    `bristle_start` and `speed_start` [rad/s] are the uncertainty at the beginning.
    """

    stroke: float
    load_stroke: float
    friction_noise: float
    friction_noise_time: float
    torque_rate: float = 2.5e-3
    slow_torque_rate: float = 20e-3
    step_torque_rate: float = 250e-3
    busy_time: float = 0.06
    angle_rate: float = 1e-4
    speed_rate: float = 1.0
    bristle_rate: float = 0.2
    slip_rate: float = 0.1
    grasper_rate: float = 1e-3
    torque_start: float = 20e-3
    bristle_start: float = 0.6
    speed_start: float = 0.05
    undecided: float = 0.5
    edge: float = 0.05
    repeats: float = 0.0


def begin(
    plant: Plant, uncertainty: Uncertainty, low: float, width: float, low_pass: Array
) -> NDArray[np.void]:
    """Return the filter's state before its first step, (1,); the shaft rests between two edges, and
    the torque has been behind the `low_pass` (3, 3) all the time."""
    state = np.zeros(1, dtype=STATE)
    state["mean"][0, ANGLE] = low + width / 2
    state["mean"][0, GRASPER] = (low + width / 2) / plant.angle_ratio
    state["direction"] = 1.0
    u = uncertainty
    deviations = np.zeros(STATES)
    deviations[[ANGLE, SPEED, GRASPER_SPEED]] = width / 2, u.speed_start, u.speed_start
    deviations[[BRISTLE, HOUSING, TIP]] = u.bristle_start
    deviations[GRASPER] = u.torque_start / plant.stiffness
    deviations[[SINE, COSINE, LOAD, NOISE]] = u.stroke, u.stroke, u.load_stroke, u.friction_noise
    deviations[TORQUE] = u.torque_start
    covariance = np.diag(deviations**2)
    # a tendon is stretched by what acts on the output: almost, as the tip's friction holds it
    stretch = -0.999 * deviations[GRASPER] * deviations[TORQUE]
    covariance[GRASPER, TORQUE] = covariance[TORQUE, GRASPER] = stretch
    joint = np.vstack([np.eye(STATES), np.outer(passed.settled(low_pass), np.eye(STATES)[TORQUE])])
    state["covariance"][0, :, : passed.JOINT_STATES] = joint @ covariance @ joint.T
    state["low"] = low
    return state


@compiled
def lasting_steps(time: float, span: float) -> float:
    """Return the number of steps of `span` s that a `time` lasts, s."""
    return math.ceil(time / span - ROUNDING)


@compiled
def _level(s: Record) -> float:
    """Return the level of the torque's noise: 0 quiet, 1 a slow change, 2 a step."""
    return 2.0 if s.step_left > 0.0 else 1.0 if s.slow_left > 0.0 else 0.0


@compiled
def _predict(
    s: Record,
    p: Record,
    u: Record,
    friction_map: Array,
    torque: Array,
    viscous: Array,
    k: int,
    low_pass: Array,
    rows: Array,
    turned: Array,
    factors: Array,
    kept: float,
    least: float,
    limits: bool,
) -> bool:
    """Advance mean and covariance by step k; whether a stroke began.

    The torque's noise has the level `least`, at least; `kept` of the friction's noise remains.
    `limits` states that a rest has lasted, or ends.
    """
    x, samples = s.mean, torque.shape[1]
    span = samples * p.sample_time
    passed.predict(s.passed, rows, low_pass, x[TORQUE])
    spread = u.undecided * math.sqrt(rows[at(SPEED, SPEED)])
    outer = u.undecided * math.sqrt(rows[at(GRASPER_SPEED, GRASPER_SPEED)])
    for i in range(samples):
        advance(x, p, friction_map, torque[k, i], viscous[k, i], factors, i, spread, outer)
    x[NOISE] *= kept
    propagate(rows, turned, factors, samples, kept)
    rows[at(NOISE, NOISE)] += u.friction_noise**2 * (1.0 - kept * kept)
    level = max(least, _level(s))
    walk = u.torque_rate
    if level > 1.0:
        walk = u.step_torque_rate
    elif level > 0.0:
        walk = u.slow_torque_rate
    s.step_left -= 1.0
    s.slow_left -= 1.0
    rows[at(TORQUE, TORQUE)] += walk * walk * span
    rows[at(ANGLE, ANGLE)] += u.angle_rate**2 * span
    rows[at(SPEED, SPEED)] += u.speed_rate**2 * span
    rows[at(GRASPER_SPEED, GRASPER_SPEED)] += u.speed_rate**2 * span
    rows[at(GRASPER, GRASPER)] += u.grasper_rate**2 * span
    rows[at(BRISTLE, BRISTLE)] += u.bristle_rate**2 * span
    rows[at(HOUSING, HOUSING)] += u.slip_rate**2 * span
    rows[at(TIP, TIP)] += u.slip_rate**2 * span
    turned_back = x[HOUSING] * s.direction < -0.5
    if turned_back:
        s.direction = -s.direction
    if turned_back or limits:
        for i in (SINE, COSINE, LOAD):
            x[i] = 0.0
            renew(rows, i, u.load_stroke if i == LOAD else u.stroke)
        return True
    return False


@compiled
def _shown(
    s: Record, u: Record, angle: float, variance: float, low: float, width: float
) -> tuple[float, float]:
    """Return what a count adds about an angle: the shift, rad, and the part of the variance that
    remains."""
    deviation = math.sqrt(variance)
    mean, left = truncated((low - angle) / deviation, (low + width - angle) / deviation)
    shift, left = mean * deviation, max(left, LEAST_VARIANCE)
    if low == s.low and s.variance > 0.0 and u.repeats < 0.5:
        before = math.sqrt(s.variance)
        mean, known = truncated((low - s.angle) / before, (low + width - s.angle) / before)
        fresh = shift - mean * before
        shift = fresh if fresh * shift > 0.0 else 0.0
        left = min(left / max(known, LEAST_VARIANCE), 1.0)
    return shift, left


@compiled
def _update(
    s: Record,
    u: Record,
    rows: Array,
    low: float,
    width: float,
    span: float,
    memory: tuple[float, float, float],
    idle: bool,
    gain: Array,
) -> tuple[float, float, float]:
    """Take in that the angle lies in a count; return correction, weight and prior variance.

    `idle` states that the motor has had no current. `gain` (ROW_LENGTH,) receives the gain of
    states and q; of the sums of corrections, and of the busy part, `memory` remains.
    """
    x = s.mean
    variance = rows[at(ANGLE, ANGLE)] + (u.edge * width) ** 2
    shift, left = _shown(s, u, x[ANGLE], variance, low, width)
    weight, mean = 1.0 - left, shift / math.sqrt(variance)
    for i in range(ROW_LENGTH):
        gain[i] = rows[at(ANGLE, i)] / variance
    for i in range(STATES):
        x[i] += gain[i] * shift
    for i in range(passed.LOW_PASS_ORDER):
        s.passed[i] += gain[STATES + i] * shift
    remove(rows, gain, math.sqrt(variance * max(weight, 0.0)))
    for i in (BRISTLE, HOUSING, TIP):
        x[i] = min(max(x[i], -1.0), 1.0)
    s.step_sum = memory[0] * s.step_sum + mean * span
    s.slow_sum = memory[1] * s.slow_sum + mean * span
    s.busy = memory[2] * s.busy + (1.0 - memory[2]) * (1.0 if _level(s) > 0.0 else 0.0)
    if abs(s.step_sum) > STEP_THRESHOLD:
        s.step_left = lasting_steps(u.busy_time, span)
    if abs(s.slow_sum) > SLOW_THRESHOLD:
        time = u.busy_time / (1.0 - min(s.busy, MOST_BUSY))
        s.slow_left = max(s.slow_left, lasting_steps(time, span))
    if low != s.low and idle:
        s.slow_left = max(s.slow_left, lasting_steps(u.busy_time, span))
    s.low, s.angle = low, x[ANGLE]
    s.variance = rows[at(ANGLE, ANGLE)] + (u.edge * width) ** 2
    return shift / variance, weight, variance


@compiled_allocating
def run(
    state: NDArray[np.void],
    plant: NDArray[np.void],
    uncertainty: NDArray[np.void],
    friction_map: Array,
    torque: Array,
    viscous: Array,
    low: Array,
    width: float,
    idle: Mask,
    low_pass: Array,
    least: Array,
    means: Array,
    outputs: Array,
    steps: tuple[Array, ...],
) -> None:
    """Filter m steps; `torque`, `viscous` (m, samples a step), `low` (m,) of the angle after each,
    `idle` (m,) whether the motor has had no current.

    `least` (m,) are the lowest levels of the torque's noise. `means` (m, 12) receive the states
    after each step, `outputs` (m, 9) the torque behind `low_pass` (3, 3), its deviation, the
    level of noise that the next step has by itself, and what a radian of the angle before the
    update changes the states `FOLLOWED` by; `steps` what `smoother.room` makes room for, nothing
    where that is no step: one machine code for both.
    """
    s, p, u = state[0], plant[0], uncertainty[0]
    samples = torque.shape[1]
    rows, turned = np.zeros(JOINT_LENGTH), np.zeros(STATES * ROW_LENGTH)
    gain, shared, factors = (
        np.empty(ROW_LENGTH),
        np.empty(STATES),
        np.empty((samples, FACTOR_COUNT)),
    )
    span = samples * p.sample_time
    memory = math.exp(-span / SHORT), math.exp(-span / LONG), math.exp(-span / BUSY_MEMORY)
    kept = math.exp(-span / u.friction_noise_time)
    for i in range(passed.JOINT_STATES):
        for j in range(ROW_LENGTH):
            rows[at(i, j)] = s.covariance[i, j]
    derivative, fresh, correction, weight, variance, gains, torque_row, passed_row = steps
    for k in range(torque.shape[0]):
        began = _predict(
            s,
            p,
            u,
            friction_map,
            torque,
            viscous,
            k,
            low_pass,
            rows,
            turned,
            factors,
            kept,
            least[k],
            limits_rest(s, low[k] - s.low, width, span),
        )
        moved, informed, before = _update(s, u, rows, low[k], width, span, memory, idle[k], gain)
        for i in range(STATES):
            means[k, i] = s.mean[i]
        mean, spread = passed.output(s.mean, s.passed, rows, low_pass, shared)
        outputs[k, 0], outputs[k, 1] = mean, math.sqrt(max(spread, 0.0))
        outputs[k, 2] = _level(s)
        for i in range(len(FOLLOWED)):
            outputs[k, FIRST_GAIN + i] = informed * gain[FOLLOWED[i]]
        if fresh.shape[0] > 0:
            for i in range(samples):
                for j in range(FACTOR_COUNT):
                    derivative[k * samples + i, j] = factors[i, j]
            fresh[k] = began
            correction[k], weight[k], variance[k] = moved, informed, before
            for i in range(STATES):
                gains[k, i], torque_row[k, i] = gain[i], rows[at(TORQUE, i)]
                passed_row[k, i] = shared[i]
    for i in range(passed.JOINT_STATES):
        for j in range(ROW_LENGTH):
            s.covariance[i, j] = rows[at(i, j)]
