"""The sensor: torque on the output from recorded samples, block by block as they come.

    torque constant k(T) = k_0 + k_1 T at the temperature T of each sample

and then `estimate.Filter`. Nothing that it gives depends on how samples are divided into blocks,
nor on what comes later than the sample that ends a step: live and from a file the numbers are the
same.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rigtool.experiments.force_filter.creeping import Creeping
from rigtool.experiments.force_filter.estimate import Estimate, Filter, Signals
from rigtool.experiments.force_filter.kalman import Uncertainty
from rigtool.experiments.force_filter.lost_counts import Counts
from rigtool.experiments.force_filter.motion_states import (
    KIND_COUNT,
    Holding,
    Judge,
    Judged,
    Moments,
    Reach,
    State,
    States,
)
from rigtool.experiments.force_filter.plant import HOUSING, SPEED, Plant
from rigtool.experiments.force_filter.smoothed import Again
from rigtool.experiments.force_filter.swinging import LEAST_SWING, TAKEN_VARIANCE, Swinging
from rigtool.experiments.force_model.force_model import ForceModel
from rigtool.experiments.force_model.intervals import uncertainty_of_kinds
from rigtool.experiments.force_model.steps import CONTEXT_SAMPLES, FilterSteps, Sampler, Stepper
from rigtool.experiments.force_sensor.power_up.power_up import PowerUp
from rigtool.numerics.arrays import Array, Mask

AT_THE_LIMIT = 0.999


@dataclass(frozen=True, eq=False)
class SensorProperties:
    """Properties that a sensor needs besides signals.

    `interval` s is from one recorded sample to the next, `loop_time` s from one of the loop to the
    next, `count` rad that of the encoder, `torque_constant` N m/A at 0 degC and its change per
    kelvin, `current_limit` in A; `corner_hz` is that of the low-pass.
    """

    model: ForceModel
    reach: Reach
    interval: float
    loop_time: float
    count: float
    torque_constant: tuple[float, float]
    current_limit: float
    corner_hz: float

    @property
    def grid(self) -> FilterSteps:
        """Samples and steps of the filter."""
        return FilterSteps.of(self.interval, self.loop_time)

    @cached_property
    def plant(self) -> Plant:
        """The filter's equations, at its sample time."""
        return self.model.plant(self.grid.sample_time)

    @cached_property
    def open_variances(self) -> Array:
        """Variance of the torque that friction leaves open, N2 m2, (4, kinds), by `Judged.holding`
        and the kind of motion: that of a rectangle.

        Without a current, it is as wide as friction where the rotor rests, which may hold either
        way, and after a reversal as what friction changes by within a count, about rest. What
        changes by friction in the time of a rest changes by half of it in half the time, in which a
        rotor that crawls after a reversal passes one count. The motor of a loop takes up what it
        sees: where its rotor rests, a load hides as far as friction changes within a count.
        """
        plant = self.plant
        bearings, housing = plant.static, plant.housing_friction
        slope = bearings / plant.presliding_angle
        if housing > 0:
            slope += housing / plant.housing_presliding_angle
        widths, rests = np.zeros((4, KIND_COUNT)), plant.coulomb + housing
        widths[1:3, State.STILL] = rests
        widths[1, State.REVERSED] = widths[3, State.STILL] = min(slope * self.count / 2, rests)
        widths[2, State.REVERSED] = max(widths[1, State.REVERSED], rests / 2)
        return (plant.torque_factor * widths) ** 2 / 3

    @cached_property
    def creeping_torque(self) -> float:
        """Friction that a bent bristle carries while the rotor creeps, N m on the output."""
        return self.plant.torque_factor * (self.plant.static + self.plant.housing_friction)

    def least_variances(
        self, holding: Holding, kinds: States, unbent: Array, swing: Array, held: Mask
    ) -> Array:
        """Return the least variance of the torque (m,) N2 m2: `open_variances`, that of a rectangle
        as wide as the friction that bristles lack which are `unbent` (m,) while the rotor creeps
        (`creeping`), and that of a `swing` (m,) N2 m2, up to `held_variance`, where friction holds
        the rotor."""
        lacking = (self.creeping_torque * unbent) ** 2 / 3
        hidden = np.where(held, np.minimum(swing, self.held_variance), 0.0)
        return np.maximum(np.maximum(self.open_variances[holding, kinds], lacking), hidden)

    def added_variances(self, kinds: States, swing: Array) -> Array:
        """Return the variance (m,) N2 m2 that is added to all else: by a `swing` (m,) N2 m2, and at
        rest by the asymmetry of friction."""
        return TAKEN_VARIANCE * swing + self.model.rest_variance * (kinds == State.STILL)

    def counts(self, lost: float = 0.0) -> Counts:
        """Return what puts leaping counts back, in samples of which `lost` are off already."""
        return Counts(self.count, self.reach.speed, self.interval, lost)

    @property
    def farthest_degc(self) -> float:
        """Temperature, to either side of 0 degC, beyond which a sample's is an error: a range of
        the learned ones further."""
        cold, warm = np.clip(self.reach.temperature_degc, -1e4, 1e4)
        return float(max(abs(cold), abs(warm)) + warm - cold)

    @cached_property
    def held_variance(self) -> float:
        """Variance of a load that shows nowhere, N2 m2: what friction changes by within a count, a
        rectangle."""
        return float(self.open_variances[3, State.STILL])

    @cached_property
    def least_swing(self) -> float:
        """Variance of a torque that does not swing, N2 m2: `swinging`."""
        factor, u = self.plant.torque_factor, self.model.uncertainty
        return (LEAST_SWING * factor * (u.stroke + u.friction_noise)) ** 2

    def limited(self, current: Array) -> Mask:
        """Return where a current (n,) A is at its limit."""
        return np.abs(current) >= AT_THE_LIMIT * self.current_limit

    def filter(self, uncertainty: Uncertainty) -> Filter:
        """Return the filter for samples that begin without a gap."""
        return Filter(self.plant, uncertainty, self.grid.step_samples, self.corner_hz)

    def again(self) -> Again:
        """Return the filter whose steps are smoothed, for the same samples."""
        u = self.model.uncertainty
        return Again(self.plant, u, self.grid.step_samples, self.corner_hz)

    def judge(self, *, causal: bool) -> Judge:
        """Return the judge of states."""
        return Judge(self.reach, self.count, self.grid.step_time, causal)


@dataclass(frozen=True, eq=False)
class Sensed:
    """The causal estimate after each of m steps; `others`, (m,) each, are channels that ride along.

    `torque` (m,) N m is that behind the low-pass, less the ripple that this power-up of the
    amplifier adds, `u` its standard uncertainty.

    `signals` are what the filter took, for another one; `less` (m,) N m is what that ripple takes
    off the drive torque, `doubt` (m,) N m its standard deviation on the output, and `unfollowed`
    (m,) N2 m2 the variance of what is not followed if the power-up is another one; `grown` (m,) is
    by what part ripple has grown with the current; `kinds` (m,) those of errors, `Judged.kinds`;
    `unbent` (m,) is what bristles lack of being bent where the rotor creeps; `swing` (m,) N2 m2 is
    how far the torque swings.
    """

    estimate: Estimate
    torque: Array
    u: Array
    moments: Moments
    states: States
    kinds: States
    others: list[Array]
    signals: Signals
    less: Array
    doubt: Array
    unfollowed: Array
    grown: Array
    unbent: Array
    swing: Array


class Sensor:
    """Takes samples without a gap; a gap begins another one, which knows the ripple of `before`. As
    about a current at its limit, the torque has no value until the filter has found the motion.

    Without `context` each sample must be a count of the encoder, and an estimate waits for the
    sample that ends its step alone.
    """

    def __init__(
        self,
        instrument: SensorProperties,
        *,
        context: bool = True,
        before: PowerUp | None = None,
    ) -> None:
        grid, model = instrument.grid, instrument.model
        self._instrument = instrument
        self._sampler = Sampler(
            grid, instrument.count, model.drive, CONTEXT_SAMPLES if context else 0
        )
        self._stepper = Stepper(grid.step_samples)
        self._filter = instrument.filter(model.uncertainty)
        self.power_up = (
            PowerUp(model, grid.step_time, instrument.corner_hz, instrument.reach.slow)
            if before is None
            else before.behind_gap()
        )
        self._judge = instrument.judge(causal=True)
        self._before: Moments | None = None
        length = instrument.plant.housing_presliding_angle
        self._creeping = Creeping(instrument.count, length, grid.step_time)
        self._swinging = Swinging(instrument.least_swing, grid.step_time)

    def add(self, samples: Array, *, last: bool = False) -> Sensed:
        """Return what these samples (c, n) complete; after the `last` ones nothing waits.

        Rows: encoder in counts, current A, temperature degC, and others that ride along.
        """
        encoder, current, warm, *others = samples
        constant, slope = self._instrument.torque_constant
        limited, most = self._instrument.limited(current), self._instrument.current_limit
        farthest = self._instrument.farthest_degc
        degc = np.clip(warm, -farthest, farthest)
        known = encoder, np.clip(current, -most, most), constant + slope * degc
        every = *known, warm, limited.astype(np.float64), *others
        signals, riding = self._sampler.add(every, last=last)
        amperes, torque_constant, *found = self._stepper.add(riding)
        drive = np.column_stack([torque_constant * amperes, amperes])
        estimate, (ripple, variance, less, unfollowed, grown) = self._filtered(signals, drive)
        torque = estimate.passed - ripple
        if self._before is None:
            found[1][:1] = 1.0
        moments = Moments(
            estimate.low,
            estimate.states[:, SPEED].copy(),  # they wait: the other states' memory goes
            estimate.states[:, HOUSING].copy(),
            torque,
            found[0],
            found[1],
            estimate.idle,
        )
        states, kinds, holding, held = self._states(moments)
        unbent = self._creeping.add(estimate.low, moments.housing, states == State.STILL)
        swing = self._swinging.add(torque, states)
        least = self._instrument.least_variances(holding, kinds, unbent, swing, held)
        wider = variance + self._instrument.added_variances(kinds, swing)
        scales = self._instrument.model.scales[1]
        deviation, opened = estimate.deviation, estimate.opened
        u = uncertainty_of_kinds(scales, deviation, torque, kinds, wider, opened, least)
        doubt = np.sqrt(variance)
        own = estimate, torque, u, moments, states, kinds, found[2:], signals, less, doubt
        return Sensed(*own, unfollowed, grown, unbent, swing)

    def _filtered(self, signals: Signals, drive: Array) -> tuple[Estimate, Array]:
        """Return the estimate after the steps that these samples complete, with what is known of
        the ripple taken off the drive torque, and `PowerUp.add` (5, m)."""
        estimates, ripples, first = [], [], 0
        while True:
            piece, signals = self._filter.pieces(signals, self.power_up.steps_ahead)
            angle = self._filter.ends(piece)
            taken = self.power_up.ahead(angle)
            estimate = self._filter.add(piece, less=taken)
            driven = drive[first : first + len(angle)]
            own = angle, estimate.states, estimate.gains, driven, taken
            ripples.append(np.stack(self.power_up.add(*own)))
            estimates.append(estimate)
            first += len(angle)
            if not signals.low.size:
                return Estimate.joined(estimates), np.hstack(ripples)

    @property
    def last_deviation(self) -> float:
        """Standard deviation of the torque after the last step, before the low-pass, N m."""
        return self._filter.last_deviation

    def _states(self, moments: Moments) -> Judged:
        """Return what is judged of these steps, that follows from the steps before them, too."""
        if not len(moments.low):
            none = np.empty(0, dtype=np.int32)
            return Judged(none, none, none.astype(np.int8), none.astype(np.bool_))
        before = self._before
        whole = moments if before is None else Moments.joined(before, moments)
        self._before = whole.part(-self._judge.span)
        first = len(whole.low) - len(moments.low)
        return Judged._make(values[first:] for values in self._judge.judged(whole))
