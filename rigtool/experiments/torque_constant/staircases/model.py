"""Model of a staircase of current against a force gauge: friction, heat in the winding [7.1.1].

With the shaft clamped by an elastic arm, the gauge torque on plateau j is

    torque_j = k i_j (1 - g w_j) (1 + c (T_j - T)) + o - f z_j + d (i_j - i_j-1)        (1)

k is the torque constant at the staircase's mean temperature T, i the measured current, o a
constant. z in -1..1 is the state of the shaft's friction: the arm yields very little, in proportion
to the gauge's torque, so friction does not slide freely but changes over a transition of s N m,
along each swing of the arm (`rigtool.experiments.torque_constant.staircases.swings`). Without z
the slope would be too low by up to a part f/s. Where friction is larger in one direction,
z (1 + A z) takes the place of z, and A too is common to all staircases. d is what a step leaves
behind where the arm has not yet come to rest.
w = integral of i2 R/R20 exp(-t/tau) dt is the heat in the winding (R/R20 for copper), which a
sensor on the housing does not show, and g the relative loss of torque constant by it; T_j is the
housing's temperature with the lag of the winding, tau, and c the relative coefficient of the torque
constant. s and tau are common to all staircases and come from the data; (1) is linear in all other
parameters.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from rigtool.errors import InsufficientDataError
from rigtool.experiments.torque_constant.staircases.plateaus import Plateaus
from rigtool.experiments.torque_constant.staircases.swings import Courses, mean_courses
from rigtool.numerics.arrays import Array
from rigtool.numerics.compiled import compiled

COPPER_COEFFICIENT = 3.93e-3
"""Temperature coefficient of a copper winding's resistance at 20 degC, 1/K (IEC 60028)."""

SAME_TEMPERATURE = 2.0
"""Range of staircases that count as one temperature, K."""

HEATING_TIME = 60.0
"""Time for which a current flows whose heat is stated, s."""


def warming(time_constant: ArrayLike, time: float = HEATING_TIME) -> Array:
    """Return w of (1) over the square of a current that has flown for `time` s, for time constants
    (...,) in s, s."""
    tau = np.asarray(time_constant)
    return np.asarray(-tau * np.expm1(-time / tau))


@dataclass(frozen=True)
class Stairs:
    """Plateaus by staircase, (m, p); shorter staircases end in plateaus without weight."""

    setpoint: Array
    current: Array
    torque: Array
    temperature: Array
    begin: Array
    middle: Array  # of the settled part, of which torque and temperature are the means
    end: Array
    weight: Array  # 1, or 0 where a staircase has ended
    rotor_angle: Array  # (m,)
    position: Array  # of the rotor, (m, p) rad, NaN where unknown
    count: float  # step of its encoder, rad
    courses: Courses
    last_step: Array  # of the set point, (m, p) A
    resolution: float  # of the gauge's readings, N m
    noise: float  # standard deviation of a reading about its plateau, N m


@dataclass(frozen=True)
class Common:
    """Parameters that all staircases share.

    `transition` is s in N m, None without friction; `exponent` that of its law; `lag` that of the
    arm's swings, s, None where friction follows straight steps; `time_constant` is tau, s.
    """

    transition: float | None
    exponent: float
    lag: float | None
    time_constant: float

    def warming(self, time: float = HEATING_TIME) -> float:
        """Return w of (1) over the square of a current that has flown for `time` s, s."""
        return float(warming(self.time_constant, time))


def arrange(plateaus: Plateaus) -> Stairs:
    """Return the plateaus by staircase.

    Raises `InsufficientDataError` where one does not separate friction from slope.
    """
    length = np.bincount(plateaus.staircase)
    first = np.concatenate([[0], np.cumsum(length)[:-1]])
    place = np.minimum(np.arange(length.max())[None, :], length[:, None] - 1) + first[:, None]
    weight = np.where(np.arange(length.max())[None, :] < length[:, None], 1.0, 0.0)
    setpoint = plateaus.current_setpoint[place]
    steps = np.diff(setpoint)
    fewest = np.minimum(np.sum(steps > 0, axis=1), np.sum(steps < 0, axis=1))
    if (worst := int(np.argmin(fewest))) >= 0 and fewest[worst] < 3:
        raise InsufficientDataError(
            f"staircase {worst} has {fewest[worst]} steps in one of its directions, 3 up and 3 "
            "down are needed to separate friction from the torque constant: run it up and down"
        )
    begin, end = plateaus.begin[place], plateaus.end[place]
    torque = plateaus.torque[place]
    return Stairs(
        setpoint=setpoint,
        current=plateaus.current[place] * weight,
        torque=torque * weight,
        temperature=plateaus.temperature[place],
        begin=np.where(weight > 0, begin, end),
        middle=np.where(weight > 0, plateaus.middle[place], end),
        end=end,
        weight=weight,
        rotor_angle=plateaus.rotor_angle[first],
        position=plateaus.position[place],
        count=float(plateaus.count.max()),
        courses=mean_courses(
            setpoint,
            torque,
            plateaus.course[place],
            end - begin,
            mean_of(plateaus.temperature[place], weight),
            _course_noise(plateaus),
        ),
        last_step=np.diff(setpoint, prepend=setpoint[:, :1]) * weight,
        resolution=float(plateaus.resolution.max()),
        noise=float(np.sqrt(np.mean(plateaus.noise**2))),
    )


def _course_noise(plateaus: Plateaus) -> float:
    """Return the standard deviation of noise in one value of a course, N m."""
    averaged = np.maximum(plateaus.readings / plateaus.course.shape[1], 1.0)
    square = np.mean((plateaus.noise**2 + plateaus.resolution**2 / 12) / averaged)
    return float(np.sqrt(square))


def mean_of(values: Array, weight: Array) -> Array:
    """Return the weighted mean of each staircase (m,) of values (m, p)."""
    return np.sum(values * weight, axis=1) / np.sum(weight, axis=1)


def winding(stairs: Stairs, time_constant: float) -> tuple[Array, Array]:
    """Return w of (1), A2 s, and the housing's temperature with the winding's lag, degC, (m, p).

    Both hold for the middle of each plateau's settled part. Between staircases no current flows,
    and the winding approaches the housing. Each begins with both at one temperature, which changes
    until the first middle as fast as in the first half of the staircase.
    """
    since = stairs.middle[:, 0] - stairs.begin[:, 0]
    change = np.diff(stairs.temperature, prepend=stairs.temperature[:, :1])
    half = (change.shape[1] - 1) // 2
    lasted = stairs.middle[:, half] - stairs.middle[:, 0]
    change[:, 0] = np.sum(change[:, 1 : half + 1], axis=1) / lasted * since
    power = stairs.current**2 * (1 + COPPER_COEFFICIENT * (stairs.temperature - 20))
    heat, lag = np.empty((2, *power.shape))
    times = stairs.begin, stairs.middle, stairs.end
    _warm(*times, power, change, float(time_constant), heat, lag)
    return heat, stairs.temperature + lag


def columns_of(
    stairs: Stairs,
    warm: tuple[Array, Array],
    friction: tuple[Array, ...],
    coefficient: float,
    rise: Array,
    *,
    steady: bool = False,
) -> tuple[Array, Array, list[Array], list[Array]]:
    """Return what (1) has columns of for `warm` windings, as `winding` returns them, (m, p) each:
    the warmed current, and the part of the constant that a g of 1 takes; the others of each
    staircase, and those that all share.

    Each has a zero and a state of the friction at its beginning of its own; what a step leaves
    behind and friction, with columns `friction` (m, p), are common to all. Friction may change with
    the temperature, of which each has `rise` (m,) K; `steady` friction does not. What a step leaves
    of ripple that lags is common to all, too, in proportion to that step of the ripple: it would
    pass for friction that grows with the ripple. `coefficient` is c, 1/K.
    """
    heat, warmth = warm
    # The loss of the constant by a kelvin is the same at all temperatures, not its relative loss.
    size = (1 + coefficient * rise)[:, None]
    drift = warmth - mean_of(warmth, stairs.weight)[:, None]
    shared = [stairs.last_step]
    if friction:
        shared += [friction[0], stairs.courses.ripple_steps() * stairs.weight]
        shared += [] if steady else [rise[:, None] * friction[0]]
    current = stairs.current * (1 + coefficient / size * drift)
    return current, heat / size, [stairs.weight, *friction[1:]], shared


@compiled
def _warm(
    begin: Array,
    middle: Array,
    end: Array,
    power: Array,
    change: Array,
    time_constant: float,
    heat: Array,
    lag: Array,
) -> None:
    """Write the `heat` of `winding` and by how much its temperature lags, K, under a power in A2
    and after a change of the housing's temperature from middle to middle, K; all (m, p)."""
    stored, ended = 0.0, begin[0, 0]
    for m in range(len(power)):
        behind, before = 0.0, begin[m, 0]
        for j in range(power.shape[1]):
            stored *= math.exp((ended - begin[m, j]) / time_constant)
            gained, ended = power[m, j] * time_constant, end[m, j]
            kept = math.exp((begin[m, j] - middle[m, j]) / time_constant)
            heat[m, j] = stored * kept + gained * (1.0 - kept)
            kept = math.exp((begin[m, j] - ended) / time_constant)
            stored = stored * kept + gained * (1.0 - kept)
            kept = math.exp((before - middle[m, j]) / time_constant / 2.0)
            behind = behind * kept**2 - change[m, j] * kept
            lag[m, j], before = behind, middle[m, j]
