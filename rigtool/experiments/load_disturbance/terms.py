"""The disturbance that a load adds to the motor's torque, as a few smooth functions [8.2, 9].

Each is written at the output, N m, for the state with the load and for the one without; a model
adds up their differences, each times a coefficient:

    friction by load        d (sqrt(s^2 + o^2) - o), for onsets o on a ladder: friction that is in
                            proportion to the torque s carried, and less where pre-tension hides it
    ... and by angle        the same, times cos and sin of orders of the grasper's angle
    viscous friction        speed of the rotor
    friction by angle       d cos, d sin of orders of the grasper's angle: what was learned without
                            load lies elsewhere when the tendon is stretched
    ripple                  cos, sin of orders of the rotor's angle: as before, for the rotor
    ripple by current       torque constant times i, and i |i|, times the same orders, in either
                            direction by itself (it lags), for each speed by itself

d is the direction of friction, i the current. Each coefficient is held near zero by a spread, what
it may be before anything is known: relative to friction, ripple and load of the rig at hand.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from rigtool.experiments.load_disturbance.cycles import LoadedCycles
from rigtool.numerics.arrays import Array

ROTOR_ORDERS = (1, 2, 3, 4)
LOAD_FRICTION_ORDERS = (1, 2)
FRICTION_ORDERS = (1, 2, 3)

ONSETS = (1 / 128, 1 / 32, 1 / 8, 1 / 2)
"""Onsets of load friction, in parts of the largest torque: any rounding at small loads is a sum of
these, and all of them run on in proportion beyond the largest."""

LOAD_FRICTION_SPREAD = 0.3
"""Spread of friction by load, per torque carried; a tenth of it for orders of the angle."""

GAIN_SPREAD = 0.02
"""Relative spread of the torque per ampere: torque factor, arm and constant together."""

RIPPLE_SPREAD = 0.01
"""Spread of each order of the ripple, relative to the torque."""

FRICTION_SPREAD = 0.3
"""Spread of each order of friction by angle, relative to the friction."""


class Kind(IntEnum):
    """Kinds of terms, by what they depend on; the numbers are those in run files."""

    LOAD_FRICTION = 1
    VISCOUS = 2
    ANGLE_FRICTION = 3
    RIPPLE = 4
    GAIN = 5
    QUADRATIC_GAIN = 6


@dataclass(frozen=True)
class Term:
    """One function of the sum.

    `order` of the angle (0 for none), `quarter` 0 for its cosine, 1 for its sine; `onset` N m of
    load friction; `sided` where it changes sign with the direction of turning; `speed` rad/s of the
    motor for which it holds, 0 for all; `spread` what its coefficient may be.
    """

    kind: Kind
    spread: float
    order: int = 0
    quarter: int = 0
    onset: float = 0.0
    sided: bool = False
    speed: float = 0.0


@dataclass(frozen=True)
class Sizes:
    """Of a rig: largest load and friction and ripple without load, N m at the output, the largest
    current, A, and the highest rotor speed, rad/s."""

    load: float
    friction: float
    ripple: float
    current: float
    speed: float


@dataclass(frozen=True, eq=False)
class State:
    """Along some points (n,): direction, rotor angle rad and speed rad/s, current A, torque that
    the tendon carries N m, grasper angle rad; `turning` is the sign of the rotor's speed."""

    direction: Array
    turning: Array
    angle: Array
    rotor_speed: Array
    current: Array
    carried: Array
    grasper: Array
    torque_per_ampere: float

    @staticmethod
    def of(cycles: LoadedCycles, carried: Array, grasper: Array) -> State:
        """Return the state along a cycle, with what its tendon does."""
        return State(
            cycles.direction,
            cycles.turning,
            cycles.angle,
            cycles.rotor_speed,
            cycles.current,
            carried,
            grasper,
            cycles.torque_per_ampere,
        )


def terms(sizes: Sizes, speeds: Sequence[float]) -> tuple[Term, ...]:
    """Return the terms for a rig of these sizes, learned at these motor speeds, rad/s."""
    onsets = [part * sizes.load for part in ONSETS]
    listed = [Term(Kind.LOAD_FRICTION, LOAD_FRICTION_SPREAD, onset=onset) for onset in onsets]
    listed += [
        Term(Kind.LOAD_FRICTION, LOAD_FRICTION_SPREAD / 10, order, quarter, onset=onsets[1])
        for order, quarter in _waves(LOAD_FRICTION_ORDERS)
    ]
    listed.append(Term(Kind.VISCOUS, FRICTION_SPREAD * sizes.friction / sizes.speed))
    listed += [
        Term(Kind.ANGLE_FRICTION, FRICTION_SPREAD * sizes.friction, order, quarter)
        for order, quarter in _waves(FRICTION_ORDERS)
    ]
    listed += [
        Term(Kind.RIPPLE, sizes.ripple, order, quarter) for order, quarter in _waves(ROTOR_ORDERS)
    ]
    gains = ((Kind.GAIN, 1.0), (Kind.QUADRATIC_GAIN, 1 / sizes.current))
    for kind, per_current in gains:
        spread = GAIN_SPREAD if kind is Kind.GAIN else RIPPLE_SPREAD * per_current
        listed.append(Term(kind, spread))
        listed += [
            Term(kind, RIPPLE_SPREAD * per_current, order, quarter, sided=sided, speed=speed)
            for speed in speeds
            for order, quarter in _waves(ROTOR_ORDERS)
            for sided in (False, True)
        ]
    return tuple(listed)


def depends_on_load(term: Term) -> bool:
    """Return whether a term depends on the tendon; all others follow from the motor's signals."""
    return term.kind in (Kind.LOAD_FRICTION, Kind.ANGLE_FRICTION)


def functions(listed: Sequence[Term], state: State, speed: float) -> Array:
    """Return the terms (t, n) along a state, N m for a coefficient of 1, at a motor speed, rad/s.

    Between the learned speeds what holds for one speed is weighted linearly by the logarithm.
    """
    learned = sorted({term.speed for term in listed if term.speed})
    share = dict(zip(learned, _shares(learned, speed), strict=True)) | {0.0: 1.0}
    values = np.zeros((len(listed), len(state.angle)))
    for row, term in zip(values, listed, strict=True):
        if share[term.speed]:
            row[:] = share[term.speed] * _function(term, state)
    return values


def _function(term: Term, state: State) -> Array:
    if term.kind is Kind.VISCOUS:
        return state.rotor_speed
    if depends_on_load(term):
        value = _wave(term, state.grasper) * state.direction
        if term.kind is Kind.LOAD_FRICTION:
            value *= np.hypot(state.carried, term.onset) - term.onset
        return value
    value = _wave(term, state.angle)
    if term.kind is not Kind.RIPPLE:
        value *= state.torque_per_ampere * state.current
    if term.kind is Kind.QUADRATIC_GAIN:
        value *= np.abs(state.current)
    if term.sided:
        value *= state.turning
    return value


def _wave(term: Term, angle: Array) -> Array:
    wave: Array = (np.sin if term.quarter else np.cos)(term.order * angle)
    return wave


def _waves(orders: Sequence[int]) -> list[tuple[int, int]]:
    return [(order, quarter) for order in orders for quarter in (0, 1)]


def _shares(learned: Sequence[float], speed: float) -> Array:
    """Return the weight of each learned speed, they add up to 1."""
    if not learned:
        return np.zeros(0)
    shares: Array = np.array(
        [np.interp(np.log(speed), np.log(learned), row) for row in np.eye(len(learned))]
    )
    return shares
