"""A motor with pre-sliding friction, a tendon and a grasper: the balance of its torques.

At the motor's shaft, with rotor angle b and the output's angle a,

    kT i = J b'' + s / n + sum over terms of coefficient * function

    s = k (b / r - a) + c (b' / r - a'),   Jg a'' = s - t z_t - M(t)

with torque factor n and angle ratio r, where M is the unknown torque on the output. Each function
is known from the motion, the current and a few lengths and times (`Shape`). Each coefficient is
linear and has a prior standard deviation, its spread (`Term`). A term is an order of the rotor's or
the output's angle times the quantity that it modulates:

    OFFSET            1                            constant current of the amplifier
    INERTIA           b''                          error of the stated inertia
    VISCOUS           b' cos, b' sin               drag, and drag by rotor angle
    COGGING           cos, sin                     torque by rotor angle, at once
    DISTINCT_COGGING  cos, sin                     the same, of orders that stand out
    RIPPLE            lag(cos), lag(sin)           ripple of the amplifier, which lags
    GAIN_RIPPLE       lag(kT i cos), ..            ripple in proportion to the current
    SQUARE_RIPPLE     lag(kT i |i| cos), ..        and to its square
    BEARING           z_b (1 + A z_b)              friction of the short bristle
    STRIBECK          z_b (1 + A z_b) e^-(b'/v)^2  its rise at low speed
    BEARING_DAMPING   b' while z_b changes         damping of pre-sliding
    HOUSING           z_h (1 + A z_h)              friction of the long bristle; and by the output's
                                                   angle z_h cos, z_h sin
    LOAD_FRICTION     z_h (sqrt(s^2 + o^2) - o)/n  friction that grows with the torque carried, less
                                                   where pre-tension o hides it; and the same times
                                                   cos, sin of the output angle
    CARRIED           s / n                        error of the torque factor
    DELAY             kT di/dt                     delay of the current behind its set point

Bristles z follow P. R. Dahl, AIAA J. 14(12) 1675-1682, 1976; two of them in series of lengths are
the smallest model of the Generalised Maxwell-Slip family (F. Al-Bender, V. Lampaert, J. Swevers,
Chaos 14(2) 446-460, 2004). A is the asymmetry of all friction: that of one bristle alone would not
show in sliding. Unknown parameters are learned from known loads: `learning`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from functools import cached_property

import numpy as np

from rigtool.experiments.force_model.paths import bristle, lagged, tendon
from rigtool.experiments.force_model.records import Record
from rigtool.numerics.arrays import Array


class Kind(IntEnum):
    """The function of a term; the numbers are those in run files."""

    OFFSET = 1
    INERTIA = 2
    VISCOUS = 3
    COGGING = 4
    RIPPLE = 5
    GAIN_RIPPLE = 6
    SQUARE_RIPPLE = 7
    BEARING = 8
    STRIBECK = 9
    BEARING_DAMPING = 10
    HOUSING = 11
    LOAD_FRICTION = 13
    CARRIED = 14
    DELAY = 15
    DISTINCT_COGGING = 16


@dataclass(frozen=True)
class Term:
    """One function: `order` of the angle (0 for none), `quarter` 0 for its cosine, 1 for its sine,
    `spread` the prior standard deviation of its coefficient."""

    kind: Kind
    spread: float
    order: int = 0
    quarter: int = 0


@dataclass(frozen=True)
class Shape:
    """The parameters that enter other than linearly.

    Lengths of the bristles of bearing and housing, rad of the motor, and of the tip, rad of the
    output; `stribeck_speed` rad/s; `ripple_time` s of the lag; tendon `stiffness` N m/rad and
    `damping` N m s/rad, `tip_friction` N m, the `grasper_inertia` kg m2 of the bare output;
    `load_onset` N m, the torque in the tendon from which on friction grows with it; and the
    `direction_ratio` of friction in the positive direction to that in the negative one.
    """

    bearing_length: float
    housing_length: float
    tip_length: float
    stribeck_speed: float
    ripple_time: float
    stiffness: float
    damping: float
    tip_friction: float
    grasper_inertia: float
    load_onset: float
    direction_ratio: float = 1.0

    @property
    def asymmetry(self) -> float:
        """A: friction is (1 +- A) times its mean."""
        return (self.direction_ratio - 1.0) / (self.direction_ratio + 1.0)

    def friction(self, bristle: Array) -> Array:
        """Return friction over its mean along a bristle's deflection z (n,): z (1 + A z)."""
        return bristle * (1.0 + self.asymmetry * bristle)


@dataclass(frozen=True)
class Known:
    """Known properties of the rig: `angle_ratio` motor angle per output angle, `torque_factor`
    output torque per motor torque, `inertia` kg m2 on the shaft, and the `offset` A that the
    amplifier adds to its set point."""

    angle_ratio: float
    torque_factor: float
    inertia: float
    offset: float = 0.0


_OF_TENDON = ("stiffness", "damping", "grasper_inertia", "tip_friction", "tip_length")
"""Parameters of a shape on which the tendon depends."""

_LAGGING = (Kind.RIPPLE, Kind.GAIN_RIPPLE, Kind.SQUARE_RIPPLE)
FIXED = (
    Kind.OFFSET,
    Kind.INERTIA,
    Kind.VISCOUS,
    Kind.COGGING,
    Kind.DELAY,
    Kind.DISTINCT_COGGING,
)
"""Kinds that lag, and those that no shape changes."""


def functions(terms: Sequence[Term], state: RecordState) -> Array:
    """Return the terms (t, n) along a state's record, N m for a coefficient of 1."""
    values = np.stack([state.function(term) for term in terms])
    lagging = [number for number, term in enumerate(terms) if term.kind in _LAGGING]
    record, time = state.record, state.shape.ripple_time
    values[lagging] = lagged(values[lagging], record.interval, time, record.periodic)
    return values


class Prediction:
    """The motor's torque along a record for given coefficients, at shapes near one."""

    def __init__(
        self,
        terms: Sequence[Term],
        coefficient: Array,
        values: Array,
        shape: Shape,
        state: RecordState,
    ) -> None:
        """`values` (t, n) are the `functions` of the terms for this shape, `state` its state."""
        self._shape, self._state = shape, state
        fixed = [n for n, term in enumerate(terms) if term.kind in FIXED]
        lagging = [n for n, term in enumerate(terms) if term.kind in _LAGGING]
        self._fixed = coefficient[fixed] @ values[fixed]
        self._lagged = coefficient[lagging] @ values[lagging]
        self._raw = np.zeros_like(self._fixed)
        for number in lagging:
            self._raw += coefficient[number] * state.function(terms[number])
        rest = [n for n in range(len(terms)) if n not in {*fixed, *lagging}]
        self._rest = [(terms[n], coefficient[n], values[n]) for n in rest]

    def torque(self, shape: Shape) -> Array:
        """Return the torque (n,), N m, less that of the known inertia."""
        return self.along(self._state.at(shape))

    def along(self, state: RecordState) -> Array:
        """Return the same in another state of the record, of another shape or another load."""
        record, shape = self._state.record, state.shape
        whole = self._fixed + state.carried / state.known.torque_factor
        if shape.ripple_time == self._shape.ripple_time:
            whole += self._lagged
        else:
            time = shape.ripple_time
            whole += lagged(self._raw[None], record.interval, time, record.periodic)[0]
        same = state.output is self._state.output
        same = same and shape.direction_ratio == self._shape.direction_ratio
        for term, coefficient, value in self._rest:
            still = same and term.kind in (Kind.HOUSING, Kind.CARRIED)
            whole += coefficient * (value if still else state.function(term))
        return whole


@dataclass(frozen=True, eq=False)
class RecordState:
    """State along a record for a shape: bristles, torque carried N m, angle of the output rad."""

    record: Record
    shape: Shape
    known: Known
    bearing: Array
    housing: Array
    carried: Array
    output: Array

    def at(self, shape: Shape) -> RecordState:
        """Return the state for another shape with the same bristles of the rotor."""
        if all(getattr(shape, name) == getattr(self.shape, name) for name in _OF_TENDON):
            return replace(self, shape=shape)
        return replace(self, shape=shape).under(self.record.moment, self.record.load_inertia)

    @staticmethod
    def of(shape: Shape, known: Known, record: Record) -> RecordState:
        """Return the state along a record."""
        bearing = bristle(record.angle, shape.bearing_length, record.periodic)
        housing = bristle(record.angle, shape.housing_length, record.periodic)
        none = np.empty(0)
        state = RecordState(record, shape, known, bearing, housing, none, none)
        return state.under(record.moment, record.load_inertia)

    def under(self, moment: float, load_inertia: float) -> RecordState:
        """Return the state of the same motion under another load, N m at 90 degrees and kg m2."""
        record, shape = self.record, self.shape
        carried, output = tendon(
            record.angle / self.known.angle_ratio,
            record.interval,
            shape.stiffness,
            shape.damping,
            load_inertia + shape.grasper_inertia,
            shape.tip_friction,
            shape.tip_length,
            moment,
            record.periodic,
        )
        return replace(self, carried=carried, output=output)

    @cached_property
    def _turns(self) -> list[Array]:
        return [np.exp(1j * self.output)]

    def _wave(self, term: Term) -> Array:
        """Return the term's order of the output's angle (n,), from products of lower orders."""
        turns = self._turns
        while len(turns) < term.order:
            turns.append(turns[-1] * turns[0])
        turn = turns[term.order - 1]
        return turn.imag if term.quarter else turn.real

    def function(self, term: Term) -> Array:
        """Return a term along the record (n,), ripple before its lag."""
        record, kind = self.record, term.kind
        if kind is Kind.OFFSET:
            return np.ones(record.angle.size)
        if kind is Kind.INERTIA:
            return record.acceleration
        if kind is Kind.BEARING:
            return self.shape.friction(self.bearing)
        if kind is Kind.STRIBECK:
            rise = np.exp(-((record.speed / self.shape.stribeck_speed) ** 2))
            return self.shape.friction(self.bearing) * rise
        if kind is Kind.BEARING_DAMPING:
            speed, z = record.speed, self.bearing
            return (speed - np.abs(speed) * z) / self.shape.bearing_length
        if kind is Kind.CARRIED:
            return self.carried / self.known.torque_factor
        if kind is Kind.DELAY:
            return record.torque_constant * record.current_rate
        if kind is Kind.HOUSING and not term.order:
            return self.shape.friction(self.housing)
        if kind in (Kind.HOUSING, Kind.LOAD_FRICTION):
            value = self._wave(term) * self.housing if term.order else self.housing.copy()
            if kind is Kind.LOAD_FRICTION:
                onset = self.shape.load_onset
                value *= (np.hypot(self.carried, onset) - onset) / self.known.torque_factor
            return value
        value = np.ones(record.angle.size)
        if term.order:
            value = record.wave(term.order, term.quarter)
        if kind is Kind.VISCOUS:
            return value * record.speed
        if kind in (Kind.GAIN_RIPPLE, Kind.SQUARE_RIPPLE):
            value = value * record.torque_constant * record.current
            if kind is Kind.SQUARE_RIPPLE:
                value *= np.abs(record.current)
        return value


def wave(term: Term, angle: Array) -> Array:
    """Return the term's order of an angle (n,), 1 for none."""
    if term.order == 0:
        return np.ones(angle.size)
    return (np.sin if term.quarter else np.cos)(term.order * angle)


@dataclass(frozen=True)
class Sizes:
    """Sizes of a rig: friction and ripple, N m at the motor, largest load, N m at the output,
    largest current, A, and speed, rad/s."""

    friction: float
    ripple: float
    load: float
    current: float
    speed: float


ROTOR_ORDERS = range(1, 15)
"""Orders of the rotor's angle: once and twice those of a motor with up to seven pole pairs."""

HOUSING_ORDERS, LOAD_FRICTION_ORDERS = range(1, 7), range(1, 3)

OFFSET_SPREAD = 0.01
"""Prior of a constant torque besides the amplifier's offset, in parts of the friction."""

INERTIA_SPREAD, WAVE_SPREAD, DAMPING_TIME = 0.1, 0.3, 1e-3
"""Relative priors: the stated inertia; friction's waves by the angle, in parts of the friction; and
the time, s, that damps pre-sliding."""

LOAD_FRICTION_SPREAD = 0.3
GAIN_SPREAD = 0.02
RIPPLE_SPREAD = 0.01
"""Relative priors: friction per torque; torque per ampere and ratio; an order of the ripple."""


DELAY_SPREAD = 0.3e-3
"""Prior of the current's delay, s: that of a loop of 500 Hz."""


def terms_for(sizes: Sizes, known: Known) -> tuple[Term, ...]:
    """Return the terms for a rig of these sizes."""
    listed = [
        Term(Kind.OFFSET, OFFSET_SPREAD * sizes.friction),
        Term(Kind.INERTIA, INERTIA_SPREAD * known.inertia),
        Term(Kind.VISCOUS, sizes.friction / sizes.speed),
        Term(Kind.BEARING, sizes.friction),
        Term(Kind.STRIBECK, sizes.friction),
        Term(Kind.BEARING_DAMPING, DAMPING_TIME * sizes.friction),
        Term(Kind.HOUSING, sizes.friction),
        Term(Kind.LOAD_FRICTION, LOAD_FRICTION_SPREAD),
        Term(Kind.CARRIED, GAIN_SPREAD),
        Term(Kind.DELAY, DELAY_SPREAD),
        Term(Kind.SQUARE_RIPPLE, RIPPLE_SPREAD / sizes.current),
    ]
    listed += _waves(Kind.VISCOUS, WAVE_SPREAD * sizes.friction / sizes.speed, range(1, 3))
    listed += _waves(Kind.COGGING, sizes.ripple, ROTOR_ORDERS, 1.0)
    listed += _waves(Kind.RIPPLE, sizes.ripple, ROTOR_ORDERS, 0.5)
    listed += _waves(Kind.GAIN_RIPPLE, RIPPLE_SPREAD, ROTOR_ORDERS)
    listed += _waves(Kind.SQUARE_RIPPLE, RIPPLE_SPREAD / sizes.current, ROTOR_ORDERS)
    listed += _waves(Kind.HOUSING, WAVE_SPREAD * sizes.friction, HOUSING_ORDERS, 0.5)
    listed += _waves(Kind.LOAD_FRICTION, LOAD_FRICTION_SPREAD / 10, LOAD_FRICTION_ORDERS)
    return tuple(listed)


def _waves(kind: Kind, spread: float, orders: Sequence[int], fade: float = 0.0) -> list[Term]:
    """Return cosine and sine of orders; their spread falls as order^-fade."""
    return [
        Term(kind, spread * order**-fade, order, quarter) for order in orders for quarter in (0, 1)
    ]
