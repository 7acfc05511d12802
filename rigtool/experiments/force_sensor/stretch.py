"""A stretch of samples without a gap: the torque on the output at each step, block by block.

The causal torque is a Kalman filter's, the smoothed one that of its equations backwards (A. E.
Bryson, M. Frazier 1963; `force_filter`), both behind a low-pass (Butterworth, second order). Memory
holds what was read, a few numbers a step, and no samples.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from concurrent.futures import Executor, Future
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rigtool.experiments.controller_torque import NO_ANSWER, LoopAnswer
from rigtool.experiments.force_filter.estimate import PIECE_STEPS, Filter
from rigtool.experiments.force_filter.highest import highest
from rigtool.experiments.force_filter.motion_states import LARGEST_LEARNED_RATIO, Moments, State
from rigtool.experiments.force_filter.smoothed import ONSET_TIME, Smoother, without_delay
from rigtool.experiments.force_model.contacts import Contact, contacts, trial
from rigtool.experiments.force_model.intervals import uncertainty_of_kinds
from rigtool.experiments.force_sensor.commanded_inertia import CommandedTurns
from rigtool.experiments.force_sensor.power_up.power_up import PowerUp
from rigtool.experiments.force_sensor.response import Spectra
from rigtool.experiments.force_sensor.results_over_time import TorqueRows, steps_of_a_row
from rigtool.experiments.force_sensor.sensor import Sensed, Sensor, SensorProperties
from rigtool.experiments.force_sensor.signal_faults import SignalFault, SignalWatch
from rigtool.experiments.force_sensor.unknown_friction import Passes
from rigtool.experiments.force_sensor.unknown_inertia import Turns
from rigtool.numerics.arrays import Array, Mask
from rigtool.numerics.lowpass import delayed, lowpass
from rigtool.numerics.memory import give_back

SHORTEST_STRETCH = 2.0
"""Stretch without gaps that is analysed, s: the filter has to settle."""

ESTIMATED_TYPES = {
    "torque": np.float64,
    "u": np.float32,
    "states": np.int8,
    "kinds": np.int8,
    "holding": np.int8,
    "held": np.bool_,
    "causal": np.float64,
    "causal_u": np.float64,
    "causal_states": np.int8,
    "causal_kinds": np.int8,
    "reference": np.float64,
    "angle": np.float32,
    "passed": np.float64,
    "less": np.float32,
    "untouched": np.float32,
    "untouched_u": np.float32,
    "doubt": np.float32,
    "unfollowed": np.float32,
    "grown": np.float32,
    "unbent": np.float32,
    "swing": np.float32,
    "setpoint": np.float64,
    "opened": np.bool_,
}
"""At each step, but for the causal torque, its u and state and the angle that was passed, which are
kept at the table's rows. What is in single precision is known to 1e-7 of itself, the angle, of
which only the place in a turn is kept, to 1e-6 rad: both move u by less than 1e-6 of it."""


LATE_BLOCKS = 3
"""Blocks that a worker may be behind: smoothing takes many at once, now and then."""


def shortest_stretch(corner_hz: float) -> float:
    """Return the shortest stretch without gaps that is analysed, s: the filter settles, and its
    low-pass does."""
    return max(SHORTEST_STRETCH, 2.01 / corner_hz)


class Stretch:
    """Samples without a gap: causal at once, smoothed as soon as enough has followed.

    The first of `workers` smooths, the second runs the filter that contacts are found with, while
    the next samples are read; each does one block at a time, in order. `seconds` have a torque once
    the stretch is over, which has `size` samples at most. Of what only the table's rows show, only
    rows are kept: an hour has 3.6 million steps. `known` is what the stretch `before` leaves to the
    one behind a gap, once it is over.
    """

    def __init__(
        self,
        name: str,
        instrument: SensorProperties,
        began: float,
        size: int,
        workers: tuple[Executor, Executor],
        *,
        commanded: bool = False,
        loop: LoopAnswer = NO_ANSWER,
        before: tuple[SignalWatch, PowerUp] | tuple[None, None] = (None, None),
    ) -> None:
        step_time = instrument.grid.step_time
        self._name, self._instrument, self._workers = name, instrument, workers
        self._began = began - instrument.interval / 2
        self._every = steps_of_a_row(step_time, instrument.corner_hz)
        watch, power_up = before
        self._sensor = Sensor(instrument, before=power_up)
        self.watch = SignalWatch(instrument, commanded=commanded, loop=loop, before=watch)
        self._again = instrument.again()
        self._smoother = Smoother(instrument.model.uncertainty, step_time)
        self._untouched: Filter | None = None
        if np.isfinite(instrument.model.limits).any():
            self._untouched = instrument.filter(instrument.model.untouched)
        self._later: deque[Future[None]] = deque()
        self._tested: deque[Future[None]] = deque()
        self._judge = instrument.judge(causal=False)
        self._waiting: list[Moments] = []  # of which some, in front, give states alone
        self._in_front = 0
        self._room = math.ceil(size * instrument.interval / step_time) + 1
        self._found: dict[str, NDArray[Any]] = {}
        self._filled: dict[str, int] = dict.fromkeys(ESTIMATED_TYPES, 0)
        self._steps = self._limited = self._samples = 0
        self.seconds = 0.0

    @property
    def known(self) -> tuple[SignalWatch, PowerUp]:
        """What the stretch behind a gap takes over."""
        return self.watch, self._sensor.power_up

    def add(self, samples: Array, setpoint: Array | None = None, *, last: bool = False) -> None:
        """Read samples (c, n): encoder, current, temperature, and the reference where it is. The
        set point (n,), rad, is only compared with the encoder."""
        samples = self.watch.add(samples, setpoint)
        if setpoint is not None:
            self._keep_setpoint(setpoint)
        sensed = self._sensor.add(samples, last=last)
        self._limited += int(np.count_nonzero(self._instrument.limited(samples[1])))
        self._settle(LATE_BLOCKS)
        estimate = sensed.estimate
        rows = slice(-self._steps % self._every, None, self._every)
        self._steps += len(sensed.states)
        angle = estimate.low + self._instrument.count / 2
        self._keep("angle", np.remainder(angle, 2 * math.pi))
        self._keep("passed", angle[rows])
        self._keep("less", sensed.less)
        self._keep("causal", sensed.torque[rows])
        self._keep("causal_u", sensed.u[rows])
        self._keep("unfollowed", sensed.unfollowed[rows])
        self._keep("grown", sensed.grown[rows])
        self._keep("unbent", sensed.unbent[rows])
        self._keep("swing", sensed.swing[rows])
        self._keep("opened", estimate.opened)
        self._keep("causal_states", sensed.states[rows])
        for reference in sensed.others:
            self._keep("reference", reference)
        smoothing, testing = self._workers
        self._later.append(smoothing.submit(self._smooth, sensed, last))
        if self._untouched is not None:
            self._tested.append(testing.submit(self._test, self._untouched, sensed))

    def _keep(self, name: str, values: NDArray[Any]) -> None:
        """Keep values behind those that were kept, in memory of the whole stretch's size that is
        used as it fills: pieces would lie between what is freed meanwhile."""
        if name not in self._found:
            self._found[name] = np.empty(self._room, dtype=ESTIMATED_TYPES[name])
        first = self._filled[name]
        self._filled[name] = first + len(values)
        self._found[name][first : first + len(values)] = values

    def _keep_setpoint(self, setpoint: Array) -> None:
        """Keep those of the rows: which of its samples a row has is the same for all, almost."""
        row = self._every * self._instrument.grid.step_time / self._instrument.interval
        first, last = (math.ceil(n / row) for n in (self._samples, self._samples + len(setpoint)))
        places = (row * np.arange(first, last)).astype(int) - self._samples
        self._samples += len(setpoint)
        self._keep("setpoint", setpoint[places])

    def _settle(self, left: int = 0) -> None:
        """Wait for what is done beside, until only the last blocks are `left` to each worker."""
        for tasks in (self._later, self._tested):
            while len(tasks) > left:
                tasks.popleft().result()

    def _test(self, untouched: Filter, sensed: Sensed) -> None:
        """Keep what the tests for contacts look at."""
        other = untouched.add(sensed.signals, less=sensed.less)
        self._keep("causal_kinds", sensed.kinds)
        self._keep("doubt", sensed.doubt)
        self._keep("untouched", other.torque)
        self._keep("untouched_u", other.deviation)

    def _smooth(self, sensed: Sensed, last: bool) -> None:
        """Smooth the steps that wait the longest."""
        self._waiting.append(sensed.moments)
        kept = self._again.add(sensed.signals, sensed.estimate, less=sensed.less, last=last)
        self._judged(*self._smoother.add(kept))
        if last:
            self._judged(*self._smoother.finish())

    def _judged(self, torque: Array, deviation: Array) -> None:
        """Keep smoothed steps, and give them their states."""
        if not len(torque):
            return
        judge, first, waiting = self._judge, self._in_front, Moments.joined(*self._waiting)
        end = first + len(torque)
        part = waiting.part(0, end + judge.span)
        own = part.torque.copy()
        own[first:end] = torque
        self._keep("torque", torque)
        self._keep("u", deviation)
        for name, values in judge.judged(replace(part, torque=own))._asdict().items():
            self._keep(name, values[first:end])
        self._in_front = min(end, judge.span)
        self._waiting = [waiting.part(end - self._in_front)]

    def reading(self) -> list[TorqueRows]:
        """Return the rows of what was read, once the stretch is over; nothing where it is too
        short."""
        referred = "reference" in self._found
        self.add(np.empty((4 if referred else 3, 0)), last=True)
        self._settle()
        step_time, every = self._instrument.grid.step_time, self._every
        if (self._steps + 2) * step_time < shortest_stretch(self._instrument.corner_hz):
            return []
        give_back()
        self.seconds = self._steps * step_time
        contacts = self._contacts()
        give_back()
        time: Any = self._began + step_time * np.arange(1.0, self._steps + 1, every)
        torque, u, ripple, doubts = self._whole()
        give_back()
        rate, corner_hz = 1 / step_time, self._instrument.corner_hz
        reference, judged = None, np.empty(0, dtype=np.bool_)
        if referred and np.isfinite(found := self._taken("reference")).any():
            reference, judged = filled(found, round(rate / corner_hz))
        torque, rows = held_lowpass(rate, torque, corner_hz), slice(None, None, every)
        faults = self.watch.faults()
        states, causal_states = self._states(torque, faults)
        inside = states != State.OUTSIDE
        sliding = np.isin(states[rows], (State.AGAINST, State.WITH))
        passed = self._taken("passed")
        at = step_time * every, passed, sliding, self._instrument.reach.angle
        output = passed / self._instrument.model.learned.known.angle_ratio
        turns, commanded = self._turns(output, inside[rows], torque[rows], u)

        def judged_rows(values: Array) -> Array:
            return np.where(judged[rows], values[rows], np.nan)  # the steps' memory goes

        referred_rows: list[Array | None] = [None, None]
        if reference is not None:
            filters = held_lowpass, delayed
            referred_rows = [judged_rows(f(rate, reference, corner_hz)) for f in filters]
        give_back()
        return [
            TorqueRows(
                self._name,
                step_time * every,
                time,
                torque[rows].copy(),
                u,
                states[rows].astype(np.int32),
                self._taken("causal"),
                self._taken("causal_u"),
                causal_states.astype(np.int32),
                referred_rows[0],
                self._limited,
                referred_rows[1],
                contacts,
                every,
                response=None
                if reference is None
                else Spectra.of(torque, reference, inside & judged, rate),
                faults=faults,
                passes=tuple(Passes.of(*at, t, u) for t in (torque[rows], torque[rows] + ripple)),
                turns=turns,
                commanded=commanded,
                doubts=doubts,
            )
        ]

    def _states(
        self, torque: Array, faults: Sequence[SignalFault]
    ) -> tuple[NDArray[np.int8], NDArray[np.int8]]:
        """Return the states of the steps (m,), smoothed, and the causal ones of the rows: without a
        value beyond the learned torques, N m, and about faults."""
        states, causal = self._taken("states"), self._taken("causal_states")
        outside = np.abs(torque) > LARGEST_LEARNED_RATIO * self._instrument.reach.torque
        states[outside] = State.OUTSIDE
        for fault in faults:
            since = self._instrument.grid.step_time * np.arange(1.0, self._steps + 1)
            states[fault.within(since, causal=False)] = State.OUTSIDE
            causal[fault.within(since[:: self._every], causal=True)] = State.OUTSIDE
        return states, causal

    def _turns(
        self, output: Array, known: Mask, torque: Array, u: Array
    ) -> tuple[Turns, CommandedTurns]:
        """Return the turns of the rows: angle of the output (m,) rad, where the torque is `known`,
        torque and u; those of the set point instead, where all of it is known."""
        step_time, rows = self._instrument.grid.step_time * self._every, (known, torque, u)
        wanted = self._taken("setpoint") if "setpoint" in self._found else np.empty(0)
        if not len(wanted) or not np.isfinite(wanted).all():
            return Turns.of(step_time, output, *rows), CommandedTurns()
        wanted = np.pad(wanted[: len(output)], (0, max(0, len(output) - len(wanted))), mode="edge")
        ratio = self._instrument.model.learned.known.angle_ratio
        return Turns(), CommandedTurns.of(step_time, wanted / ratio, *rows)

    def _taken(self, name: str) -> Any:
        """Return what was kept as one, and keep it no longer."""
        return self._found.pop(name)[: self._filled[name]]

    def _contacts(self) -> tuple[Contact, ...]:
        """Return the contacts, in steps."""
        if self._untouched is None:
            return ()
        torque, deviation = self._taken("untouched"), self._taken("untouched_u")
        kinds, doubt = self._taken("causal_kinds"), self._taken("doubt")
        tested = trial(torque, deviation, kinds, self._instrument.grid.step_time, doubt)
        return tuple(contacts(tested, self._instrument.model.limits))

    def _whole(self) -> tuple[Array, Array, Array, Array]:
        """Return the torque (m,) less what this power-up's ripple adds; u and that ripple of its
        rows, N m, and what of their u^2 is by that ripple, N2 m2."""
        instrument, every = self._instrument, self._every
        torque, angle, less = (self._taken(name) for name in ("torque", "angle", "less"))
        factor = instrument.plant.torque_factor
        again, added, variances = self._sensor.power_up.again(), [], []
        for first in range(0, len(torque), PIECE_STEPS):
            part = slice(first, first + PIECE_STEPS)
            ripple, variance, _ = again(angle[part].astype(np.float64), torque[part])
            torque[part] -= ripple - factor * less[part]
            rows = slice(-first % every, None, every)
            added.append(ripple[rows].copy())  # the steps' memory goes
            variances.append(variance[rows].copy())
        corner_hz, step_time = instrument.corner_hz, instrument.grid.step_time
        deviation = without_delay(self._taken("u"), corner_hz, step_time)
        ahead = weight_ahead(1 / step_time, len(deviation), corner_hz)
        ahead *= self._sensor.last_deviation
        deviation[-len(ahead) :] = np.hypot(deviation[-len(ahead) :], ahead)
        kinds = self._taken("kinds")[::every]
        unfollowed = self._sensor.power_up.counted * self._taken("unfollowed")
        grown = 1 + 2 * self._taken("grown").astype(float)
        variance = np.concatenate(variances) * grown + unfollowed
        swing, held = self._taken("swing"), self._taken("held")[::every]
        doubts = variance.copy()
        variance += instrument.added_variances(kinds, swing)
        holding, unbent = self._taken("holding")[::every], self._taken("unbent")
        least = instrument.least_variances(holding, kinds, unbent, swing, held)
        # at rest what comes later may have come at once: between both forms, a rectangle
        apart = torque[::every] - self._found["causal"][: self._filled["causal"]]
        least = np.maximum(least, np.where(kinds == State.STILL, apart**2 / 3, 0.0))
        deviation = deviation[::every].astype(float)
        opened = highest(self._taken("opened"), 0, round(ONSET_TIME / step_time))[::every]
        own = deviation, torque[::every], kinds, variance, opened, least
        u = uncertainty_of_kinds(instrument.model.scales[0], *own)
        return torque, u, np.concatenate(added), doubts


def filled(reference: Array, reach: int) -> tuple[Array, Mask]:
    """Return a reference (n,) with what is NaN in it interpolated, and where it is known for all of
    `reach` steps on both sides, which is what a low-pass takes in (n,)."""
    known = np.isfinite(reference)
    if known.all():
        return reference, known
    place = np.arange(len(reference))
    whole: Array = np.interp(place, place[known], reference[known])
    return whole, ~highest(~known, reach, reach)


def held_lowpass(rate: float, values: Array, corner_hz: float) -> Array:
    """Filter a torque (n,) of a rate, Hz, without phase shift, as if it stayed at its ends' values:
    that is what a random walk is expected to do."""
    length = round(rate / corner_hz)
    found: Array = lowpass(rate, np.pad(values, length, mode="edge"), corner_hz)
    return found[length:-length]


def weight_ahead(rate: float, size: int, corner_hz: float) -> Array:
    """Return how much of `held_lowpass` of `size` values is the last one held, at the last (n,)."""
    length = min(size, round(rate / corner_hz))
    return held_lowpass(rate, np.repeat([0.0, 1.0], 4 * length), corner_hz)[3 * length : 4 * length]
