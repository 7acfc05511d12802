"""Ripple that an amplifier draws anew at each power-up, learned while the rotor slides.

Of a torque M on the output the filter finds, at the torque factor n,

    M^ = M + n sum of beta_j lag(w_j) + e,    w_j cosine and sine of orders of the rotor's angle

with beta what the amplifier's ripple is off from the learned one, c. Either the power-up is another
one: c + beta has amplitudes A with other phases,

    beta ~ N(-c, A^2 / 2),    A^2 = |c|^2 + variance of c, of each order,

or the ripple is near the learned one, beta ~ N(0, `CHANGED`^2 A^2 / 2), or it is the learned one.

Along a part of a turn the low orders look like the housing's friction, so that c may be far smaller
than the ripple is. A weak force that repeats with the angle looks like ripple, too. Once an order
of c + beta is more than `LARGEST_RIPPLE_RATIO` times A it is none, and what is known of it begins
anew.

Under the first two a Kalman filter reads M^ row by row. Where nothing touches, M is what strokes
deviate by: about zero, and drawn anew by a reversal. So the mean of the ripple along the part of a
turn that a motion uses shows, too. Where something touches, M^ is a random walk that may leap, and
shows no ripple. Contacts begin and end at a rate, and a row counts by the probability that nothing
touches (probabilistic data association: Y. Bar-Shalom, E. Tse, Automatica 11(5) 451-460, 1975), so
that a weak contact is not taken for ripple. A contact that grows slowly, or begins while the ripple
is not yet known, is recognised late, by its end at the latest: what the rows just before it added
is then taken back. The likelihoods weigh the hypotheses, by less than their ratio: the errors of
rows that follow one another are alike. The learned ripple itself needs no filter: its likelihood
over that of one near it is the density of beta = 0, over what it was before any row (J. M. Dickey,
Ann. Math. Stat. 42(1) 204-223, 1971). Given is
the mean of the mixture, and its variance (Y. Bar-Shalom, X. R. Li, T. Kirubarajan, Estimation with
Applications to Tracking and Navigation, 2001, section 11.6.2, static multiple models).

A weak contact may also act all the time, or a load hang (`lasting_contact`), under each of the two.

The strongest orders that were learned are followed. The other ones, and what of the ripple grows
with the current, are in the variance alone (`drawn_ripple`). One misalignment has the same phases
at all currents, so that what is not known of a ripple grows as the ripple does. In the rows w_j
therefore grows with the current i, of which friction changes the sign with the direction. Without
it, a load that hangs, less a ripple that lags, would explain what is odd in the direction:

    w_j (1 + lag(g' kT i + h' kT i |i|)),   g', h' by order.

With the share r by which it has grown, and the variance V of what is followed, the covariance of
both errors is r V:

    variance = V (1 + 2 r) + variance of what is not followed,   r^2 = (kT i)^2 A(i)^2 / A^2.

What is known of the ripple is taken off the drive torque of the filter, as its friction depends on
the torque: renewed every `HELD_TIME`, and what the filter's torque then lacks follows from the same
response as for a wave (`shown_ripple`). Rows see the torque as if nothing had been taken off.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from rigtool.experiments.force_filter import passed
from rigtool.experiments.force_filter.motion_states import SLIDING_DEFLECTION
from rigtool.experiments.force_filter.plant import GRASPER, HOUSING, SPEED, TORQUE, Record
from rigtool.experiments.force_model.drawn_ripple import learned_ripple
from rigtool.experiments.force_model.force_model import ForceModel
from rigtool.experiments.force_sensor.power_up import shown_ripple
from rigtool.experiments.force_sensor.power_up.lasting_contact import HANGING, HANGS, LASTING, LASTS
from rigtool.experiments.force_sensor.power_up.mixed_ripple import (
    CHANGED,
    FILTERS,
    PARAMETERS,
    PARTS,
    STATE,
    WAVE_COUNT,
    mix,
)
from rigtool.experiments.force_sensor.power_up.ripple_rows import (
    CONTACT,
    SPREAD_STEPS,
    held_steps,
    late_rows,
    read_row,
    renew_unfollowed,
    row_steps,
)
from rigtool.experiments.force_sensor.power_up.shown_ripple import show
from rigtool.numerics.arrays import Array, Mask
from rigtool.numerics.compiled import compiled, compiled_allocating

OF_THE_FILTER = (
    *("waves", "held_steps", "seen", "angle", "speed", "housing", "sine", "cosine"),
    *("row", "filled", "slid", "passed", "level", "shift", "shifts", "lasting", "lastings"),
    "current",
)
"""What of the state a filter that begins anew has not seen."""


class PowerUp:
    """Follows the ripple of a recording, until `behind_gap` without one; steps are added as they
    come. Rows of a rotor that moves slower than `slow` rad/s, and creeps, show none.

    `add` and `again` give what ripple adds to the torque on the output after each of m steps, its
    variance, N m and N2 m2, and what it takes off the drive torque, N m, not low-passed.
    """

    def __init__(
        self, model: ForceModel, step_time: float, corner_hz: float, slow: float = 0.0
    ) -> None:
        self._slow = slow
        learned, lag_time = learned_ripple(model), model.learned.shape.ripple_time
        size = model.uncertainty.stroke + model.uncertainty.friction_noise
        plant = model.plant(step_time)
        factor = plant.torque_factor
        inertia = shown_ripple.turned_inertia(plant)
        steps = row_steps(step_time)
        lag = 1 - math.exp(-step_time / lag_time)
        time, late = steps * step_time, late_rows(step_time)
        housing = plant.housing_friction, plant.housing_presliding_angle
        slow = shown_ripple.HELD_LENGTHS * plant.presliding_angle / step_time
        shown = 1 - math.exp(-step_time / shown_ripple.SHOWN_TIME)
        self._held_steps = held_steps(step_time)
        numbers = lag, factor, steps, time, factor * size, late, step_time, inertia
        load = plant.load_friction, plant.load_friction_onset
        square = learned.drawn.sum()
        others = self._held_steps, lag_time, square, learned.orders, learned.unfollowed
        hanging = (np.array(HANGING) * factor * size) ** 2
        self._parameters = np.array(
            [(*numbers, *housing, slow, shown, *load, *others, hanging, learned.growth)],
            dtype=PARAMETERS,
        )
        self._state = np.zeros(1, dtype=STATE)
        state = self._state[0]
        state["length"] = steps
        state["expected"][1] = -learned.coefficient
        state["drawn"] = CHANGED**2 * learned.drawn, learned.drawn
        state["mean"][:, :WAVE_COUNT] = np.tile(state["expected"], (2, 1))
        variances = np.zeros((FILTERS, PARTS))
        variances[:, :WAVE_COUNT] = np.tile(state["drawn"], (2, 1))
        state["covariance"] = [np.diag(one) for one in variances]
        state["means"] = state["mean"][:, None]
        state["covariances"] = state["covariance"][:, None]
        self._begin()
        mix(state)
        renew_unfollowed(state, self._parameters[0], 0.0)
        self._low_pass = passed.section(corner_hz, step_time)

    def behind_gap(self) -> PowerUp:
        """Return it for samples behind a gap: what is known of the ripple holds until the power is
        cut."""
        self._begin()
        return self

    def _begin(self) -> None:
        """Know nothing of what acts, of strokes, and of where the filter has got to."""
        state, own = self._state[0], self._parameters[0]
        for name in OF_THE_FILTER:
            state[name] = 0.0
        state["direction"] = 1.0
        place, variances = np.arange(WAVE_COUNT, PARTS), np.zeros((FILTERS, PARTS - WAVE_COUNT))
        variances[:, 0], variances[2:, 1:] = own["size"] ** 2, own["hanging"]
        state["mean"][:, place] = state["means"][..., place] = 0.0
        for name in ("covariance", "covariances"):
            state[name][..., place, :] = state[name][..., place] = 0.0
        state["covariance"][:, place, place] = variances
        state["covariances"][:, :, place, place] = variances[:, None]
        for name in ("lasting", "lastings"):
            state[name][..., 1] = (LASTING * own["size"]) ** 2
        state["lasts"], state["hangs"] = LASTS, HANGS
        state["level_variance"] = (CONTACT * own["size"]) ** 2

    @property
    def probability(self) -> float:
        """That the power-up is another than that of the learning."""
        return self._state["weights"][0, 1]

    @property
    def counted(self) -> float:
        """What of the variance of another power-up counts, 0 to 1."""
        return self._state["counts"][0, 1]

    @property
    def steps_ahead(self) -> int:
        """Number of steps until what is taken off the drive torque is renewed, one at least."""
        return self._held_steps - int(self._state["held_steps"][0])

    def ahead(self, angle: Array) -> Array:
        """Return what the filter has to take off the drive torque in each of the next m steps,
        `steps_ahead` at most, whose angles (m,) rad are the rotor's: (m,) N m."""
        taken = np.empty(len(angle))
        _ahead(self._state, self._parameters, angle, taken)
        return taken

    def add(
        self, angle: Array, states: Array, gains: Array, drive: Array, taken: Array
    ) -> tuple[Array, ...]:
        """Return them from these steps and those before, torque behind the low-pass (m,) less what
        `taken` left of it; the variance (m,) N2 m2 that ripple which is not followed has if the
        power-up is another one; and by what part ripple has grown with the current (m,).

        `angle` (m,) rad is the rotor's, `states` (m, 12) those of the causal filter, `gains` (m, 6)
        its `Estimate.gains`, `drive` (m, 2) the motor's torque N m and its current A; `taken` (m,)
        N m was taken off the filter's drive torque.
        """
        speed = states[:, SPEED]
        sliding = states[:, HOUSING] * np.sign(speed) >= SLIDING_DEFLECTION
        sliding &= np.abs(speed) >= self._slow
        moving = states[:, [GRASPER, SPEED, HOUSING]]
        follows = np.column_stack([gains, moving])
        driven = np.ascontiguousarray(np.column_stack([drive, taken]))
        return self._followed(self._state, angle, states[:, TORQUE], sliding, follows, driven)

    def again(self) -> Callable[[Array, Array], tuple[Array, ...]]:
        """Return what gives them from all that was added, at its steps again, piece by piece: (m,)
        not low-passed, the variance that of the followed orders alone.

        It takes the angles (m,) rad as before, and the torque (m,) N m of the whole recording.
        """
        state = self._state.copy()
        state["waves"] = 0.0
        none = np.zeros(0, np.bool_), np.zeros((0, 0)), np.zeros((0, 3))

        def piece(angle: Array, torque: Array) -> tuple[Array, ...]:
            return self._followed(state, angle, torque, *none)[:3]

        return piece

    def _followed(
        self,
        state: NDArray[np.void],
        angle: Array,
        torque: Array,
        sliding: Mask,
        follows: Array,
        drive: Array,
    ) -> tuple[Array, ...]:
        found = np.empty((5, len(angle)))
        signals = angle, np.ascontiguousarray(torque), sliding, follows, drive
        _follow(state, self._parameters, self._low_pass, *signals, found)
        return tuple(found)


@compiled
def _turn(waves: Array, p: Record, angle: float) -> None:
    """Advance the waves by a step that ends at an angle, rad."""
    sine, cosine = math.sin(angle), math.cos(angle)
    high, wide, order = 0.0, 1.0, 0  # of an order, each from the one before
    for j in range(0, WAVE_COUNT, 2):
        while order < p.orders[j // 2]:
            high, wide = high * cosine + wide * sine, wide * cosine - high * sine
            order += 1
        waves[j] += p.lag * (wide - waves[j])
        waves[j + 1] += p.lag * (high - waves[j + 1])


@compiled_allocating
def _ahead(
    state: NDArray[np.void], parameters: NDArray[np.void], angle: Array, taken: Array
) -> None:
    """Write `PowerUp.ahead` into `taken` (m,): by the waves before each step."""
    s, waves = state[0], state[0].waves.copy()
    for k in range(angle.shape[0]):
        taken[k] = 0.0
        for j in range(WAVE_COUNT):
            taken[k] += s.held[j] * waves[j]
        _turn(waves, parameters[0], angle[k])


@compiled
def _follow(
    state: NDArray[np.void],
    parameters: NDArray[np.void],
    low_pass: Array,
    angle: Array,
    torque: Array,
    sliding: Mask,
    follows: Array,
    drive: Array,
    found: Array,
) -> None:
    """Advance by m steps; `found` (5, m) receives ripple, variance, drive torque, the variance of
    what is not followed at another power-up, and by what part ripple has grown.

    Where `sliding` is given, it learns, and ripple passes the low-pass.
    """
    s, p = state[0], parameters[0]
    waves = s.waves
    for k in range(angle.shape[0]):
        _turn(waves, p, angle[k])
        if sliding.shape[0]:
            waves[WAVE_COUNT] = drive[k, 2]
            show(s, p, follows[k], torque[k])
            s.current[0] += p.lag * (drive[k, 0] - s.current[0])
            s.current[1] += p.lag * (drive[k, 0] * abs(drive[k, 1]) - s.current[1])
            for j in range(WAVE_COUNT):
                growth = p.growth[j // 2]
                grown = 1.0 + growth[0] * s.current[0] + growth[1] * s.current[1]
                s.row[j] += p.factor * grown * s.seen[j] / s.length
            s.row[WAVE_COUNT] += (torque[k] + p.factor * s.seen[WAVE_COUNT]) / s.length
            s.row[WAVE_COUNT + 1] += math.cos(follows[k, 6]) / s.length
            s.row[WAVE_COUNT + 2] += math.sin(follows[k, 6]) / s.length
            s.row[WAVE_COUNT + 3] += 1.0 / s.length
            s.slid += 1.0 if sliding[k] else 0.0
            s.filled += 1.0
            if s.filled >= s.length:
                read_row(s, p)
                renew_unfollowed(s, p, follows[k, 7])
        shown = s.seen if sliding.shape[0] else waves
        mean, less = 0.0, 0.0
        for i in range(WAVE_COUNT):
            mean += p.factor * shown[i] * s.known[i]
            less += waves[i] * s.known[i]
        if sliding.shape[0] == 0 or s.filled % SPREAD_STEPS == 0:
            s.spread = 0.0
            for i in range(WAVE_COUNT):
                total = 0.5 * s.doubt[i, i] * shown[i]
                for j in range(i):
                    total += s.doubt[i, j] * shown[j]
                s.spread += 2.0 * p.factor**2 * shown[i] * total
        unfollowed = grown = 0.0
        if drive.shape[0]:
            size, u = abs(drive[k, 1]), s.unfollowed
            growing = u[1] + size * (u[2] + size * u[3])
            growing *= drive[k, 0] ** 2
            unfollowed = p.factor**2 * (u[0] + growing)
            grown = math.sqrt(growing / p.square) if p.square > 0.0 else 0.0
        found[0, k], found[1, k] = mean, s.spread * (1.0 + 2.0 * grown) + s.counts[1] * unfollowed
        found[2, k], found[3, k], found[4, k] = less, unfollowed, grown
        if sliding.shape[0]:
            left, (first, second) = mean - p.factor * s.seen[WAVE_COUNT], s.passed
            found[0, k] = low_pass[2, 0] * first + low_pass[2, 1] * second
            found[0, k] += low_pass[2, 2] * left
            for i in range(2):
                s.passed[i] = low_pass[i, 0] * first + low_pass[i, 1] * second
                s.passed[i] += low_pass[i, 2] * left
            s.held_steps += 1.0
            if s.held_steps >= p.held:
                s.held_steps = 0.0
                for j in range(WAVE_COUNT if s.other != 0.0 else 0):  # before a row, nothing
                    s.held[j] = s.known[j]
