"""Model of a staircase of current against a force gauge: friction, heat in the winding [7.1.1].

With the shaft clamped by an elastic arm, the gauge torque on plateau j is

    torque_j = k i_j (1 - g w_j) (1 + c (T_j - T)) + o - f z_j                         (1)

k is the torque constant at the staircase's mean temperature T, i the measured current, o a
constant. z in -1..1 is the state of the shaft's friction: the arm yields very little, in proportion
to the gauge's torque, so friction does not slide freely but follows dz = (+-1 - z) dx / s while
current rises or falls (Dahl 1968). x is the travel as a torque: that of the gauge, or k i where the
arm swings so much that friction hardly holds it back; s is the transition in N m. Without z the
slope would be too low by up to a part f/s.
w = integral of i2 R/R20 exp(-t/tau) dt is the heat in the winding (R/R20 for copper), which a
sensor on the housing does not show, and g the relative loss of torque constant by it; T_j is the
housing's temperature with the lag of the winding, tau, and c the relative coefficient of the torque
constant. s and tau are common to all staircases and come from the data; (1) is linear in all other
parameters.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np

from rigtool.errors import InsufficientDataError
from rigtool.experiments.torque_constant.staircase import Plateaus
from rigtool.numerics.arrays import Array
from rigtool.numerics.minimum import minimum

SHORTEST_TIME_CONSTANT, LONGEST_TIME_CONSTANT = 2.0, 300.0
"""Range in which the winding's thermal time constant tau is searched, s."""

COPPER = 3.93e-3
"""Temperature coefficient of a copper winding's resistance at 20 degC, 1/K (IEC 60028)."""

FITTED_STAIRCASES = 96
"""Largest number of staircases, spread over all, from which s and tau are found."""

FRICTION_SIGNIFICANCE = 1e-3
"""Probability below which friction shows in the data."""


@dataclass(frozen=True)
class Stairs:
    """Plateaus by staircase, (m, p); shorter staircases end in plateaus without weight."""

    setpoint: Array
    current: Array
    torque: Array
    temperature: Array
    begin: Array
    end: Array
    weight: Array  # 1, or 0 where a staircase has ended
    travel: Array  # (m, p - 1) x of (1) between plateaus, N m
    rotor_angle: Array  # (m,)

    @property
    def swinging(self) -> Array:
        """Travel of an arm that swings from step to step, k |di|, (m, p - 1) N m."""
        slope = np.ptp(self.torque) / np.ptp(self.current)
        swing: Array = slope * np.abs(np.diff(self.setpoint, axis=1))
        return swing


@dataclass(frozen=True)
class Common:
    """Parameters that all staircases share: s in N m (None without friction), tau in s; misfit."""

    transition: float | None
    time_constant: float
    square_misfit: float
    dof: int


def arrange(plateaus: Plateaus) -> Stairs:
    """Return the plateaus by staircase.

    Raises `InsufficientDataError` where one does not separate friction from slope.
    """
    length = np.bincount(plateaus.staircase)
    first = np.concatenate([[0], np.cumsum(length)[:-1]])
    place = np.minimum(np.arange(length.max())[None, :], length[:, None] - 1) + first[:, None]
    weight = np.where(np.arange(length.max())[None, :] < length[:, None], 1.0, 0.0)
    setpoint = plateaus.current_setpoint[place]
    steps = np.diff(setpoint, axis=1)
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
        end=end,
        weight=weight,
        travel=np.maximum(np.sign(steps) * np.diff(torque, axis=1), 0.0),
        rotor_angle=plateaus.rotor_angle[first],
    )


def mean_of(values: Array, weight: Array) -> Array:
    """Return the weighted mean of each staircase (m,) of values (m, p)."""
    mean: Array = np.sum(values * weight, axis=1) / np.sum(weight, axis=1)
    return mean


def winding(stairs: Stairs, time_constant: float) -> tuple[Array, Array]:
    """Return w of (1), A2 s, and the housing's temperature with the winding's lag, degC, (m, p).

    Both hold for the middle of each plateau. Between staircases no current flows, and the winding
    approaches the housing.
    """
    decay = np.exp(-(stairs.end - stairs.begin) / time_constant)
    idle = np.ones(decay.shape)
    idle[:, 1:] = np.exp(-(stairs.begin[:, 1:] - stairs.end[:, :-1]) / time_constant)
    change = np.diff(stairs.temperature, axis=1, prepend=stairs.temperature[:, :1])
    power = stairs.current**2 * (1 + COPPER * (stairs.temperature - 20))
    before, after = np.empty(decay.shape), np.empty(decay.shape)
    lag = np.empty(decay.shape)
    stored, behind = np.zeros(len(decay)), np.zeros(len(decay))
    for j in range(decay.shape[1]):
        before[:, j] = stored * idle[:, j]
        gained = power[:, j] * time_constant * (1 - decay[:, j])
        stored = before[:, j] * decay[:, j] + gained
        after[:, j] = stored
        behind = behind * idle[:, j] * decay[:, j] - change[:, j] * np.sqrt(decay[:, j])
        lag[:, j] = behind
    # Heat left over from the staircase before
    ended = stairs.end[:-1, -1]
    fades = np.exp(-(ended - stairs.begin[:-1, 0]) / time_constant)
    pauses = np.exp(-(stairs.begin[1:, 0] - ended) / time_constant)
    left = [0.0]
    for held, fade, pause in zip(after[:-1, -1], fades, pauses, strict=True):
        left.append(float((held + left[-1] * fade) * pause))
    middle = (stairs.begin + stairs.end) / 2 - stairs.begin[:, :1]
    heat = (before + after) / 2 + np.array(left)[:, None] * np.exp(-middle / time_constant)
    return heat, stairs.temperature + lag


def friction_state(setpoint: Array, travel: Array, transition: float) -> tuple[Array, Array]:
    """Return a and b (m, p) of the friction's state z = a + b z0 along staircases.

    `setpoint` (m, p) gives the directions; `travel` (m, p - 1) and `transition` are in N m.
    """
    end = np.sign(np.diff(setpoint, axis=1))
    decay = np.exp(-travel / transition)
    a, b = np.zeros(setpoint.shape), np.ones(setpoint.shape)
    for j in range(travel.shape[1]):
        a[:, j + 1] = end[:, j] + (a[:, j] - end[:, j]) * decay[:, j]
        b[:, j + 1] = b[:, j] * decay[:, j]
    return a, b


def design_matrix(stairs: Stairs, transition: float | None, current: Array) -> Array:
    """Return the columns of (1) for staircases (m, p): (m, p, 2) without friction, or (m, p, 4)."""
    return np.stack([current, stairs.weight, *friction_columns(stairs, transition)], axis=2)


def friction_columns(stairs: Stairs, transition: float | None) -> tuple[Array, ...]:
    """Return the columns of (1) for friction, two of (m, p), or none."""
    if transition is None:
        return ()
    a, b = friction_state(stairs.setpoint, stairs.travel, transition)
    return -a * stairs.weight, -b * stairs.weight


def fit_common(stairs: Stairs, coefficient: float) -> Common:
    """Return s and tau by variable projection; `coefficient` is c of (1), 1/K.

    Of more than `FITTED_STAIRCASES` staircases, that many are used, spread evenly over all.

    An additional column i |i| absorbs the amplifier's ripple at one rotor angle, which would
    otherwise look like heat. Raises `InsufficientDataError` where the plateaus leave no degrees of
    freedom.
    """
    every = -(-len(stairs.setpoint) // FITTED_STAIRCASES)
    taken = Stairs(**{name: values[::every] for name, values in vars(stairs).items()})
    count = len(taken.setpoint)
    dof = int(taken.weight.sum()) - 6 * count
    if dof < 1:
        raise InsufficientDataError(
            f"{int(taken.weight.sum())} plateaus in {count} staircases leave no degree of "
            "freedom to the fit: use more steps"
        )

    # A search moves one of s and tau: the columns of the other are kept.
    friction = lru_cache(maxsize=1)(partial(friction_columns, taken))

    @lru_cache(maxsize=1)
    def currents(time_constant: float) -> tuple[Array, Array, Array]:
        # Heat remains from the staircase before, so the heat of all of them counts.
        heat, warmth = (values[::every] for values in winding(stairs, time_constant))
        drift = warmth - mean_of(warmth, taken.weight)[:, None]
        current = taken.current * (1 + coefficient * drift)
        return current, current * heat, current * np.abs(current)

    def misfit(transition: float | None, time_constant: float) -> float:
        current, *other = currents(time_constant)
        columns = [current, taken.weight, *friction(transition), *other]
        q, _ = np.linalg.qr(np.stack(columns, axis=2))
        fitted = np.einsum("mpc,mc->mp", q, np.einsum("mpc,mp->mc", q, taken.torque))
        return float(np.sum((taken.torque - fitted) ** 2))

    span = float(np.ptp(stairs.torque[0]))
    step = span * float(np.median(np.abs(np.diff(stairs.setpoint[0])))) / np.ptp(stairs.setpoint[0])
    tau = 30.0
    for _ in range(2):
        s = minimum(partial(misfit, time_constant=tau), step / 4, 3 * span)
        tau = minimum(partial(misfit, s), SHORTEST_TIME_CONSTANT, LONGEST_TIME_CONSTANT)
    with_friction, without = misfit(s, tau), misfit(None, tau)
    # F test of the friction columns, two a staircase
    from scipy.special import fdtrc

    extra = 2 * count
    ratio = (without - with_friction) / extra / max(with_friction / dof, 1e-300)
    shows = fdtrc(extra, dof, max(ratio, 0.0)) < FRICTION_SIGNIFICANCE
    return Common(s if shows else None, tau, with_friction, dof)
