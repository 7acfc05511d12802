"""Friction that bends over the swing shows at sums and differences of the excited lines."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from rigtool.control.plant_models import PlantModel
from rigtool.experiments.plant.curvature import SlopeRise, excited_speed, slope_rise
from rigtool.experiments.plant.fit import PlantFit
from rigtool.experiments.plant.frequency_response import Experiment

SAMPLE_TIME, PERIODS, SAMPLES = 1e-3, 4, 500
LINES = np.array([2, 3, 4, 5, 7, 9, 12, 16, 21, 28, 37, 49])
FIT = PlantFit(
    PlantModel(2e-5, 1e-4), 1e-4, 1e-8, 0.0, SAMPLE_TIME, np.ones(12, dtype=bool), 1.0, 1.0
)

TWO_MASSES = replace(FIT, model=PlantModel(2e-5, 1e-4, 0.85, 40.0, 0.4))
MANY = np.maximum(np.fft.rfftfreq(SAMPLES, SAMPLE_TIME), 1e-3)


def experiment(direction, seed, friction, *, turned=False, noise=2e-6):
    """Return a shaft at 4 rad/s whose speed swings by 1.3 rad/s, rms, against `friction(|v|)`.

    It begins 9 rad from the encoder's zero, on the side of the `seed`.
    With `turned` the excitation of every second period has the other sign.
    """
    rng = np.random.default_rng(seed)
    line = np.arange(1, SAMPLES // 2)
    omega = 2 * np.pi * line / (SAMPLES * SAMPLE_TIME)
    speeds = np.zeros(len(line), dtype=complex)
    speeds[LINES - 1] = np.exp(2j * np.pi * rng.random(len(LINES)))
    speeds *= 1.3 / np.sqrt(np.sum(np.abs(speeds) ** 2) / 2)

    def wave(amplitudes):
        return np.fft.irfft(np.concatenate([[0], amplitudes, [0]]) * SAMPLES / 2, SAMPLES)

    output, plain, speed = (
        wave(part)
        for part in (
            speeds / (1j * omega),
            speeds / (1j * omega) / FIT.response(omega / (2 * np.pi)),
            speeds,
        )
    )
    signs = np.array([1, -1] * (PERIODS // 2) if turned else [1] * PERIODS)[:, None]
    torque = signs * plain + direction * friction(4 + direction * signs * speed)
    torque = torque + noise * rng.standard_normal(torque.shape)
    turning = direction * 4 * SAMPLE_TIME * np.arange(PERIODS * SAMPLES).reshape(PERIODS, -1)
    turning = turning + 9 * (-1) ** (seed // 2)
    made = Experiment(signs * plain, torque, signs * output, turning + signs * output)
    return made, signs[0] * speed


def rise_of(experiments, fit=FIT):
    speeds = [excited_speed(one, LINES, SAMPLE_TIME) for one in experiments]
    return slope_rise(experiments, speeds, LINES, fit)


def experiments(friction, **how):
    return [experiment(1 - 2 * (n % 2), n, friction, **how)[0] for n in range(8)]


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("bend", [4e-6, -4e-6])
def test_the_rise_of_the_slope_is_that_of_friction(bend, turned):
    found = rise_of(experiments(lambda v: bend * (v - 4) ** 2, turned=turned))
    assert found.value == pytest.approx(2 * bend * 1.3, abs=3 * found.u)
    assert found.u < 0.1 * abs(found.value)
    assert found.count == 8
    assert found.shown == (found.value if bend > 0 else 0.0)


def test_friction_that_does_not_bend_shows_no_rise():
    shown = [
        rise_of(
            [
                experiment(1 - 2 * (n % 2), 100 * trial + n, lambda v: 2e-3 + 3e-5 * v)[0]
                for n in range(6)
            ]
        ).shown
        for trial in range(40)
    ]
    # one-sided 5 % of 40: at most six by the binomial law, p = 0.01
    assert sum(own > 0 for own in shown) <= 6


def test_the_stribeck_effect_at_the_slow_end_is_seen():
    found = rise_of(experiments(lambda v: 1e-3 * np.exp(-((v / 1.5) ** 2))))
    assert found.shown > 5 * found.u


def with_a_second_mass(seed, growth):
    """Return a shaft with a second mass; friction grows by `growth` of the torque's size that the
    second mass asks for, about the friction of its tip."""
    made, speed = experiment(1 - 2 * (seed % 2), seed, lambda v: 2e-3 + 3e-5 * v)
    s = 2j * np.pi * np.fft.rfftfreq(SAMPLES, SAMPLE_TIME)[LINES]
    carried = np.zeros(SAMPLES // 2 + 1, dtype=complex)
    carried[LINES] = np.fft.rfft(speed)[LINES] / s * TWO_MASSES.model.carried(s)
    torque = np.fft.irfft(carried, SAMPLES)
    direction = np.sign(made.angle[0, -1] - made.angle[0, 0])
    tip = direction * torque.std() / 2
    more = direction * growth * np.hypot(torque + tip, tip)
    needed = np.fft.rfft(made.output) * (1 / TWO_MASSES.response(MANY) - 1 / FIT.response(MANY))
    asked = made.input + np.fft.irfft(needed, SAMPLES) + more
    return replace(made, input=asked)


def test_friction_that_grows_with_the_torque_on_a_second_mass_is_no_bend():
    rises = [
        rise_of([with_a_second_mass(10 * trial + n, 0.15) for n in range(6)], TWO_MASSES)
        for trial in range(20)
    ]
    # one-sided 5 % of 20: at most four by the binomial law, p = 0.003
    assert sum(rise.shown > 0 for rise in rises) <= 4
    assert abs(np.mean([rise.value / rise.u for rise in rises])) < 1.0


@pytest.mark.parametrize("pull", [1.0, 1.8, 2.0, 3.0, -3.0])
def test_what_scatter_explains_is_not_shown(pull):
    rise = SlopeRise(pull * 1e-5, 1e-5, 6)
    assert (rise.shown > 0) == (stats.t(5).sf(pull) < 0.05)


def test_the_swing_is_the_excited_speed_of_each_period():
    made, speed = experiment(-1, 3, lambda v: 0 * v, turned=True)
    signs = np.array([1, -1] * (PERIODS // 2))[:, None]
    np.testing.assert_allclose(excited_speed(made, LINES, SAMPLE_TIME), signs * speed, atol=1e-9)


def test_periods_may_have_phases_of_their_own():
    """As strokes with an instrument have them: their squares would cancel in the mean period."""
    several = []
    for first in range(0, 64, 8):
        periods = [
            experiment(1 - 2 * (first // 8 % 2), first + n, lambda v: 4e-6 * (v - 4) ** 2)[0]
            for n in range(8)
        ]
        several.append(
            Experiment(
                *(
                    np.concatenate([getattr(period, name)[:1] for period in periods])
                    for name in ("reference", "input", "output", "angle")
                )
            )
        )
    found = rise_of(several)
    assert found.value == pytest.approx(2 * 4e-6 * 1.3, rel=0.05)
