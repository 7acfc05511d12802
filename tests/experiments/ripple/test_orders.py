"""Ripple by order: closed forms, scipy, and properties."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal
from scipy.stats import sem

from rigtool.errors import InsufficientDataError
from rigtool.experiments.ripple.orders import (
    Ripple,
    Sampling,
    Spectrum,
    cell_centres,
    cells_for,
    coefficients,
    compare,
    match_orders,
    neighbours_floor,
    remove_offset,
    spectrum,
)
from rigtool.experiments.ripple.revolutions import Revolutions
from rigtool.numerics.jackknife import jackknife
from rigtool.numerics.welch import Welch
from tests.experiments.ripple.fine import FINE

COUNTS = 4000
ORDERS = {1: (0.4e-3, 0.7), 2: (0.9e-3, -2.0), 7: (0.1e-3, 3.0)}


def ripple_at(turns, orders=None):
    angle = 2 * np.pi * turns
    return sum(a * np.cos(k * angle + phase) for k, (a, phase) in (orders or ORDERS).items())


def turning(rev_per_s, revolutions=21.2, rate=2000.0, wobble=0.0, noise=0.0, start=0.37):
    """Return time, encoder in turns, and torque of a rotor that turns almost steadily."""
    time = np.arange(int(revolutions / abs(rev_per_s) * rate)) / rate
    turns = start + rev_per_s * time + wobble * np.sin(2 * np.pi * 0.9 * time)
    rng = np.random.default_rng(4)
    torque = 3e-3 + ripple_at(turns) + noise * rng.normal(size=len(time))
    return time, np.floor(turns * COUNTS) / COUNTS, torque


def lay_over(time, turns, torque, revolutions, positions):
    collected = Revolutions(positions, forward=bool(turns[-1] > turns[0]))
    collected.add(time, turns, torque)
    return collected.waveforms(revolutions)


def test_the_rms_of_orders_has_what_the_u_of_each_changes():
    amplitude, floor = np.array([3e-3, 1e-3, 4e-4]), np.array([2e-4, 3e-4, 1e-4])
    own = Spectrum(np.arange(1.0, 4), amplitude, np.zeros(3), floor)
    rms, u = own.rms()
    assert rms == pytest.approx(math.sqrt(np.sum(amplitude**2) / 2))
    changes = []
    for number, by in enumerate(own.u):
        changed = amplitude.copy()
        changed[number] += 1e-4 * by
        other = Spectrum(own.order, changed, own.phase, floor).rms()[0]
        changes.append((other - rms) / 1e-4)
    assert u == pytest.approx(np.linalg.norm(changes), rel=1e-3)
    assert Spectrum(own.order, 0 * amplitude, own.phase, floor).rms() == (0.0, 0.0)


def test_orders_are_there_up_to_the_highest_that_samples_resolve():
    sampling = Sampling(0.05)
    assert sampling.highest_order == 8.0
    assert Sampling(0.05, fastest=2.0).highest_order == 4.0  # twice as far apart in places
    found = coefficients(np.random.default_rng(2).standard_normal((3, 64)), 20, sampling)
    np.testing.assert_array_equal(found != 0, np.tile(np.arange(1, 21) <= 8, (3, 1)))


@settings(max_examples=60, deadline=None)
@given(
    samples=st.floats(20.0, 300.0).filter(lambda n: abs(n - round(n)) > 0.02),
    part=st.floats(0.05, 0.99),
    averaged=st.integers(1, 8),
    phase=st.floats(-3.0, 3.0),
)
def test_amplitudes_are_those_of_what_was_sampled(samples, part, averaged, phase):
    """Few samples a period, each a mean of several: what that takes away is given back."""
    order = max(1, int(part * samples / 2.5))
    fine = np.arange(int(41.3 * samples) * averaged) / (samples * averaged)
    wave = {order: (0.6e-3, phase)}
    turns, torque = (
        values.reshape(-1, averaged).mean(axis=1) for values in (fine, ripple_at(fine, wave))
    )
    waveforms = lay_over(turns, turns, torque, 40, 500)
    found = spectrum(remove_offset(waveforms, Sampling(1 / samples, averaged)), 120)
    # Straight lines also make images beside the sampling frequency; over many turns, whose samples
    # lie elsewhere each time, they average out.
    assert found.amplitude[order - 1] == pytest.approx(0.6e-3, rel=0.03, abs=0)
    error = np.angle(np.exp(1j * (found.phase[order - 1] - phase)))
    assert error == pytest.approx(0, abs=0.03)
    assert np.isnan(found.amplitude[int(samples / 2.5) + 1 :]).all()
    assert np.isfinite(found.amplitude[: int(samples / 2.5)]).all()


@pytest.mark.parametrize("counts", [200, 720, 1000, 1024, 2012, 2048, 2500, 4000, 4096, 131072])
def test_steps_of_the_encoder_are_no_orders_of_the_spectrum(counts):
    """A sawtooth of the encoder's counts has its multiples; in the cells they are aliases."""
    cells = cells_for(counts)
    assert 400 <= cells <= 600
    angle = (np.arange(cells * 64.0) + 0.5) / (cells * 64)
    harmonics = [np.cos(2 * np.pi * m * counts * angle + m) / m for m in range(1, 6)]
    means = np.sum(harmonics, axis=0).reshape(cells, 64).mean(axis=1)
    assert np.abs(np.fft.rfft(means)[1:101]).max() * 2 / cells < 1e-9


def test_cells_are_as_usual_where_nothing_helps():
    assert cells_for(40) == 500  # the counts are orders of the spectrum themselves
    assert cells_for(4 * 2503) == 2503


def test_fewer_samples_a_turn_than_the_first_order_needs():
    ripple = Ripple(np.stack([ripple_at(np.arange(50) / 50)] * 3), Sampling(1 / 2.4))
    with pytest.raises(InsufficientDataError, match=r"2\.4 samples a turn are too few, 2\.5 are"):
        spectrum(ripple, 4)


def test_a_ripple_in_few_samples_is_the_same_ripple():
    """Order 30 in 100.3 samples a turn would be 0.74 of itself."""

    def sampled(samples):
        turns = np.arange(int(41.3 * samples)) / samples
        waveforms = lay_over(turns, turns, ripple_at(turns, {30: (0.6e-3, 0.4)}), 40, 500)
        return remove_offset(waveforms, Sampling(1 / samples))

    found = compare(sampled(3000.7), sampled(100.3), 40)
    assert found.scale == pytest.approx(1, rel=0.01, abs=0)
    assert found.correlation == pytest.approx(1, rel=0, abs=1e-3)


@pytest.mark.parametrize("rev_per_s", [0.2, 1.7, 4.8, -0.6, -4.8])
def test_orders_are_found_at_any_speed_and_in_both_directions(rev_per_s):
    waveforms = lay_over(*turning(rev_per_s, wobble=0.02), 20, 500)
    found = spectrum(remove_offset(waveforms, FINE), 50)
    for order, (amplitude, phase) in ORDERS.items():
        # The encoder's count is 1.6 mrad, seven times that at order 7; a sample at 4.8 rev/s is
        # 1 % of a period of order 7.
        assert found.amplitude[order - 1] == pytest.approx(amplitude, rel=5e-3, abs=0)
        error = np.angle(np.exp(1j * (found.phase[order - 1] - phase)))
        assert error == pytest.approx(0, abs=2e-3 * order)
    others = np.delete(found.amplitude, np.array(list(ORDERS)) - 1)
    assert others.max() < 2e-6
    assert found.strongest() == 2


def test_waveform_is_the_ripple_at_its_positions():
    found = remove_offset(lay_over(*turning(0.5), 10, 400), FINE)
    expected = ripple_at(found.angle / (2 * np.pi))
    np.testing.assert_allclose(found.mean, expected, rtol=0, atol=1.2e-5)
    assert found.waveforms.shape == (10, 400)
    assert found.angle[0] == pytest.approx(np.pi / 400, rel=1e-12, abs=0)


def test_what_repeats_and_what_does_not():
    """White noise averaged over a cell of c samples keeps 1/sqrt(c) of it."""
    noise, rev_per_s, positions = 2e-3, 0.2, 100
    waveforms = lay_over(*turning(rev_per_s, noise=noise), 20, positions)
    rms = remove_offset(waveforms, FINE).rms()
    samples = 2000 / rev_per_s / positions
    assert rms.non_repeatable == pytest.approx(noise / np.sqrt(samples), rel=0.1, abs=0)
    power = sum(a**2 / 2 for a, _ in ORDERS.values())
    assert rms.repeatable == pytest.approx(np.sqrt(power), rel=0.02, abs=0)
    assert abs(rms.repeatable - np.sqrt(power)) < 4 * rms.repeatable_u
    assert rms.dof == 19
    assert rms.non_repeatable_u == pytest.approx(
        rms.non_repeatable / np.sqrt(2 * 20 * positions), rel=0.8, abs=0
    )


def test_noise_alone_has_no_repeatable_part_and_no_strongest_order():
    waveforms = np.random.default_rng(1).normal(size=(20, 256))
    noise = remove_offset(waveforms, FINE)
    assert noise.rms().repeatable < 0.1
    found = spectrum(noise, 40)
    # Amplitude of an average of 20 revolutions of 256 samples: 2/sqrt(20*256), rms
    expected = 2 / np.sqrt(20 * 256)
    assert np.sqrt(np.mean(found.noise_floor**2)) == pytest.approx(expected, rel=0.1, abs=0)
    assert np.sqrt(np.mean(found.amplitude**2)) == pytest.approx(expected, rel=0.25, abs=0)
    with pytest.raises(InsufficientDataError, match="no order exceeds its noise floor"):
        spectrum(remove_offset(waveforms[:3], FINE), 4).strongest()


def test_the_strongest_order_is_one_that_noise_does_not_explain():
    amplitude, floor = np.array([0.6, 0.2, np.nan, 0.9]), np.array([0.05, 0.01, np.nan, 0.5])
    found = Spectrum(np.arange(1.0, 5), amplitude, np.zeros(4), floor)
    assert found.strongest() == 1
    with pytest.raises(InsufficientDataError, match="order 2 comes nearest, at 1 times its own:"):
        Spectrum(np.arange(1.0, 5), amplitude, np.zeros(4), floor * 20).strongest()
    for nothing in (np.zeros(4), np.full(4, np.nan)):
        with pytest.raises(InsufficientDataError, match="no order has an amplitude"):
            Spectrum(np.arange(1.0, 5), nothing, np.zeros(4), 0 * nothing).strongest()


def test_two_revolutions_do_not_show_the_scatter_of_their_scatter():
    waveforms = np.random.default_rng(1).normal(size=(2, 64))
    assert remove_offset(waveforms, FINE).rms().non_repeatable_u is None
    with pytest.raises(InsufficientDataError, match="1 revolution"):
        Ripple(waveforms[:1], FINE).rms()


@settings(max_examples=50, deadline=None)
@given(shift=st.floats(-3.0, 3.0), scale=st.floats(0.2, 5), seed=st.integers(0, 100))
def test_a_turned_and_scaled_ripple_is_recognised(shift, scale, seed):
    rng = np.random.default_rng(seed)
    orders = {k: (rng.uniform(0.5, 1), rng.uniform(-3, 3)) for k in (1, 2, 3)}
    turns = (np.arange(360) + 0.5) / 360
    reference, other = (
        Ripple(np.stack([wave, wave]), FINE)
        for wave in (
            ripple_at(turns, orders),
            scale * ripple_at(turns - shift / (2 * np.pi), orders),
        )
    )
    found = compare(reference, other, 50)
    assert found.shift == pytest.approx(shift, rel=0, abs=1e-3)
    assert found.best_correlation == pytest.approx(1, rel=0, abs=1e-4)
    assert found.scale == pytest.approx(scale, rel=1e-3, abs=0)
    expected = np.corrcoef(reference.mean, other.mean)[0, 1]
    # The ripple of a cell is taken as its mean, 6e-5 from its centre at order 3.
    assert found.correlation == pytest.approx(expected, rel=0, abs=5e-4)
    assert found.shift_u == pytest.approx(0, abs=1e-9)


def test_uncertainty_of_a_comparison_is_its_scatter():
    rng = np.random.default_rng(8)
    turns = (np.arange(200) + 0.5) / 200

    def noisy(shift):
        return Ripple(ripple_at(turns - shift) + rng.normal(0, 1e-3, (20, 200)), FINE)

    found = [compare(noisy(0), noisy(0.1), 50) for _ in range(60)]
    for name, u in (("shift", "shift_u"), ("correlation", "correlation_u")):
        scatter = np.std([getattr(item, name) for item in found], ddof=1)
        stated = np.mean([getattr(item, u) for item in found])
        assert stated == pytest.approx(scatter, rel=0.35, abs=0)
    assert np.mean([item.shift for item in found]) == pytest.approx(0.2 * np.pi, rel=0.01, abs=0)
    assert found[0].dof == 19


def test_a_shift_that_scatters_widely_has_the_jackknife_written_out():
    angle, spread = cell_centres(500), 0.72
    reference = Ripple(np.tile(1e-3 * np.cos(angle), (3, 1)), FINE)
    other = Ripple(1e-3 * np.cos(angle - 3.0 - np.array([[-spread], [0.0], [spread]])), FINE)
    found = compare(reference, other, 4)
    # two of them together are shifted by their mean: by half the spread, one way or the other, or 0
    assert abs(found.shift) == pytest.approx(3.0, rel=0, abs=0.01)
    assert found.shift_u == pytest.approx(math.sqrt(2 / 3 * 2) * spread / 2, rel=0.01, abs=0)


def test_noise_cannot_be_compared():
    turns = (np.arange(200) + 0.5) / 200
    ripple = Ripple(np.stack([ripple_at(turns)] * 3), FINE)
    for nothing in (np.zeros((3, 200)), np.random.default_rng(6).normal(size=(3, 200))):
        with pytest.raises(InsufficientDataError, match="other ripple is all noise"):
            compare(ripple, Ripple(nothing, FINE), 4)
        with pytest.raises(InsufficientDataError, match="reference ripple is all noise"):
            compare(Ripple(nothing, FINE), ripple, 4)


def test_psd_has_the_power_of_the_signal():
    time = np.arange(20000) / 2000
    tone = 3e-3 + 1e-3 * np.cos(2 * np.pi * 40 * time)
    collected = Welch(2000)
    collected.add(tone)
    found = collected.spectrum(1 / 2000)
    power = np.sum(found.psd) * found.frequency[1]
    assert power == pytest.approx(0.5e-6, rel=1e-3, abs=0)
    assert found.frequency[np.argmax(found.psd)] == 40
    window = signal.get_window("hann", 2000)
    _, expected = signal.welch(tone - tone.mean(), 2000, window, 2000)
    np.testing.assert_allclose(found.psd[1:], expected[1:], rtol=1e-6, atol=1e-20)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda t, a, q: (t, a * 0.5, q), r"9 whole revolutions.* 20 are needed"),
        (lambda t, a, q: (t[::-1], a, q), "does not rise"),
        (lambda t, a, q: (t, np.zeros(len(t)), q), "0 whole revolutions"),
    ],
)
def test_bad_recordings_are_refused(spoil, message):
    with pytest.raises(InsufficientDataError, match=message):
        lay_over(*spoil(*turning(2.0)), 20, 100)


def test_orders_beyond_the_positions_are_refused():
    with pytest.raises(ValueError, match="1 to 24"):
        spectrum(Ripple(np.zeros((2, 50)), FINE), 25)


def test_rms_is_that_of_the_jackknife_over_revolutions():
    rng = np.random.default_rng(3)
    waveforms = (
        np.sin(np.arange(60) / 5) + rng.normal(0, 0.4, (9, 60)) * rng.uniform(0.5, 2, 9)[:, None]
    )

    def repeatable(keep):
        used = waveforms[keep]
        noise = used.var(axis=0, ddof=1).mean() / len(used)
        return np.sqrt(np.mean(used.mean(axis=0) ** 2) - noise)

    found = Ripple(waveforms, FINE).rms()
    value, u = jackknife(9, repeatable)
    assert found.repeatable == pytest.approx(value, rel=1e-12, abs=0)
    assert found.repeatable_u == pytest.approx(u, rel=1e-9, abs=0)
    # power of each revolution beside the mean of all, and the standard error of that
    powers = np.mean((waveforms - waveforms.mean(axis=0)) ** 2, axis=1) * 9 / 8
    assert found.non_repeatable == pytest.approx(np.sqrt(powers.mean()), rel=1e-9)
    expected = sem(powers) / (2 * found.non_repeatable)
    assert found.non_repeatable_u == pytest.approx(expected, rel=1e-9)
    assert Ripple(np.ones((5, 8)), FINE).rms().non_repeatable == 0


def in_blocks(arrays, sizes):
    start = 0
    for size in sizes:
        yield [array[start : start + size] for array in arrays]
        start += size
    yield [array[start:] for array in arrays]


@settings(max_examples=30, deadline=None)
@given(
    sizes=st.lists(st.integers(0, 900), max_size=30),
    rev_per_s=st.sampled_from([-3.1, -0.4, 0.4, 3.1]),
)
def test_blocks_of_any_size_give_the_waveforms_of_the_whole(sizes, rev_per_s):
    signals = turning(rev_per_s, revolutions=8.3, wobble=0.03, noise=1e-3)
    collected = Revolutions(50, forward=rev_per_s > 0)
    for block in in_blocks(signals, sizes):
        collected.add(*block)
    np.testing.assert_allclose(
        collected.waveforms(6), lay_over(*signals, 6, 50), rtol=1e-9, atol=1e-12
    )
    whole = abs(signals[1][-1] - signals[1][0]) / (len(signals[1]) - 1)
    assert collected.step == pytest.approx(whole, rel=1e-3, abs=0)


def test_a_clock_that_stands_between_two_blocks_is_refused():
    time, turns, torque = turning(2.0)
    collected = Revolutions(50, forward=True)
    collected.add(time[:100], turns[:100], torque[:100])
    with pytest.raises(InsufficientDataError, match="time does not rise at sample 100"):
        collected.add(time[99:], turns[99:], torque[99:])


@settings(max_examples=20, deadline=None)
@given(sizes=st.lists(st.integers(0, 900), max_size=20), segment=st.sampled_from([64, 129]))
def test_psd_by_blocks_is_scipys_of_the_whole(sizes, segment):
    noise = np.random.default_rng(2).normal(3, 1, 9000)
    collected = Welch(segment)
    for (block,) in in_blocks([noise], sizes):
        collected.add(block)
    found = collected.spectrum(1 / 500)
    frequency, psd = signal.welch(noise, 500, nperseg=segment, detrend="constant")
    np.testing.assert_allclose(found.frequency, frequency, rtol=1e-12, atol=0)
    np.testing.assert_allclose(found.psd, psd, rtol=1e-9, atol=1e-12 * psd.max())


def test_a_psd_without_a_whole_segment_is_refused():
    collected = Welch(64)
    collected.add(np.ones(63))
    with pytest.raises(InsufficientDataError, match="63 samples are too few, 64 are needed"):
        collected.spectrum(1.0)


def test_an_encoder_that_leaps_fills_no_memory():
    collected, time = Revolutions(50, forward=True), np.arange(100.0)
    turns = np.where(time < 50, 0.01 * time, 1e24)
    with pytest.raises(InsufficientDataError, match=r"1e\+24 times in 99 samples.*encoder leaps"):
        collected.add(time, turns, np.ones(100))


@pytest.mark.parametrize("count", [1, 2, 7, 40])
def test_the_floor_beside_an_order_is_that_of_the_ten_on_either_side(count):
    amplitude = np.random.default_rng(count).rayleigh(size=count)
    found = neighbours_floor(amplitude)
    for k in range(count):
        beside = [amplitude[j] for j in range(count) if j != k and abs(j - k) <= 10]
        expected = np.median(beside) / np.sqrt(np.log(2)) if beside else 0.0
        assert found[k] == pytest.approx(expected, rel=1e-12)


def test_the_best_correlation_is_that_of_the_summit_between_points():
    """Of one order alone, sixteen points a period: half a point aside, they lack 2 %."""
    for points in (0.0, 0.25, 0.5):
        turned = np.array([np.exp(-2j * np.pi * points / 16)])
        _, shift, best, scale = match_orders(np.ones(1, complex), turned)
        assert shift == pytest.approx(2 * np.pi * points / 16, abs=1e-3)
        assert best == pytest.approx(1, abs=1e-3)
        assert scale == pytest.approx(1, abs=1e-3)
