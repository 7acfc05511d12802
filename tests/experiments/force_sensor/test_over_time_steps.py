"""Rows, notes, blocks and spectra of a torque over time, against what their texts state."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from rigtool.errors import InsufficientDataError
from rigtool.experiments.force_filter.motion_states import KIND_COUNT, Reach, State
from rigtool.experiments.force_model.steps import Holder
from rigtool.experiments.force_sensor.power_up.ripple_rows import least_row_time
from rigtool.experiments.force_sensor.procedure_reading import _interval, unbroken_blocks
from rigtool.experiments.force_sensor.response import (
    MAX_AMPLITUDE_U,
    RIGHT_AMPLITUDE,
    Spectra,
    amplitude_bandwidth,
)
from rigtool.experiments.force_sensor.results_over_time import (
    TorqueRows,
    over_time_tables,
    steps_of_a_row,
)
from rigtool.experiments.force_sensor.results_recordings import Recorded, _contact_notes, _notes
from rigtool.experiments.force_sensor.signal_faults import SignalFault
from tests.experiments.deploy.sensors import instrument

STEP = 5e-3


def rows(count=60, seed=0, **more):
    rng = np.random.default_rng(seed)
    states = rng.choice([State.OUTSIDE, State.AGAINST, State.REVERSED, State.STILL], count)
    own = {
        "torque": 1e-2 * rng.standard_normal(count),
        "u": 1e-3 * rng.uniform(0.5, 2, count),
        "states": states.astype(np.int32),
        "causal": 1e-2 * rng.standard_normal(count),
        "causal_u": 1e-3 * rng.uniform(0.5, 2, count),
        "causal_states": rng.permutation(states).astype(np.int32),
    }
    return TorqueRows("a", STEP, 3.0 + STEP * np.arange(count), **{**own, **more})


# -- rows


@pytest.mark.parametrize("bands", [False, True])
def test_a_dead_band_is_a_rectangle_of_its_whole_width(bands):
    own = rows(dead_bands=bands)
    hidden = bands & ((own.states == State.REVERSED) | (own.states == State.STILL))
    assert own.hidden.tolist() == hidden.tolist()
    assert_allclose(own.half, np.where(hidden, math.sqrt(3), 1.96) * own.u)


def test_other_uncertainties_add_in_quadrature():
    own, by, share = rows(), 0.7e-3, 0.2
    found = own.widened(by, share)
    assert_allclose(found.u**2, own.u**2 + by**2 + (share * own.torque) ** 2)
    assert_allclose(found.causal_u**2, own.causal_u**2 + by**2 + (share * own.causal) ** 2)
    assert found.torque is own.torque


def test_stretches_are_one_behind_the_other():
    reference = np.arange(60.0)
    parts = [
        rows(seed=n, limited=3 + n, reference=reference + n, causal_reference=reference - n)
        for n in range(3)
    ]
    found = TorqueRows.joined(parts)
    assert found.limited == 12
    for name in ("time", "torque", "u", "states", "causal_u", "reference", "causal_reference"):
        expected = np.concatenate([getattr(part, name) for part in parts])
        np.testing.assert_array_equal(getattr(found, name), expected)
    assert TorqueRows.joined(parts[:1]) is parts[0]


@given(st.floats(1e-4, 5e-3), st.floats(0.5, 60.0))
def test_three_periods_of_the_corner_have_twenty_rows_or_every_step(step, corner):
    found, rows = steps_of_a_row(step, corner), 20 / 3 * corner
    assert found == 1 or found * step * rows <= 1 + 1e-5
    assert (found + 1) * step * rows > 1 - 1e-5


def test_results_are_of_rows_with_a_value_and_of_the_time_that_was_read():
    parts = [rows(seed=1), rows(count=40, seed=2)]
    results, tables = over_time_tables(parts, 0.05, 10.0, 0.02, numbers=[0, 4], lost=0.1)
    torque, u, states, causal_states = (
        np.concatenate([getattr(part, name) for part in parts])
        for name in ("torque", "u", "states", "causal_states")
    )
    known = states != State.OUTSIDE
    assert results["valid_share"].value == pytest.approx(known.mean() * 0.5 / 0.6)
    peak = max(np.flatnonzero(known), key=lambda k: abs(torque[k]) - 1.96 * u[k])
    assert results["peak_torque"].value == torque[peak]
    assert results["peak_torque"].u is None  # rows between have no value
    mean = results["mean_torque"]
    assert (mean.value, mean.u) == pytest.approx((torque[known].mean(), u[known].mean()))
    table = tables["force"]
    assert table["recording"].tolist() == [0] * 60 + [4] * 40
    assert table["row"].tolist() == list(range(100))
    assert_allclose(table["force"][known], torque[known] / 0.02)
    assert np.isnan(table["force"][~known]).all()
    assert_allclose(table["u"][known], u[known])
    so_far = causal_states != State.OUTSIDE
    causal = np.concatenate([part.causal for part in parts])
    assert_allclose(table["causal_torque"], np.where(so_far, causal, np.nan))
    assert "force" not in over_time_tables(parts, 0.05, 10.0)[1]["force"].columns
    plain = over_time_tables(parts, 0.05, 10.0)[1]["force"]["recording"]
    assert plain.tolist() == [0] * 60 + [1] * 40


def test_the_causal_form_is_judged_by_its_own_reference_and_interval():
    rng = np.random.default_rng(4)
    reference, late = 1e-2 * rng.standard_normal((2, 400))
    own = rows(400, seed=3, reference=reference, causal_reference=late)
    none = rows(50, seed=5)
    results, tables = over_time_tables([own, none], 0.05, 10.0)
    for prefix, torque, acted, u, states in (
        ("", own.torque, reference, own.u, own.states),
        ("causal_", own.causal, late, own.causal_u, own.causal_states),
    ):
        known = states != State.OUTSIDE
        moving = known & (states != State.STILL)
        error = torque - acted
        for name, among in (("rmse", known), ("rmse_moving", moving)):
            rms = np.sqrt(np.mean(error[among] ** 2))
            assert results[prefix + name].value == pytest.approx(rms)
        covered = np.mean(np.abs(error[known]) <= 1.96 * u[known])
        assert results[f"{prefix}coverage_95"].value == pytest.approx(covered)
        cells = tables["force_accuracy"]
        total = cells[f"{prefix}share"].sum()
        assert total == pytest.approx(1.0)
        square = np.nansum(cells[f"{prefix}share"] * cells[f"{prefix}rmse"] ** 2)
        assert math.sqrt(square) == pytest.approx(results[f"{prefix}rmse"].value)
    assert np.isnan(tables["force"]["reference"][400:]).all()
    assert_allclose(tables["force"]["reference"][:400], reference)


# -- notes


def test_thresholds_of_contacts_are_noted_in_millinewton_metres():
    limits = np.array([[4.2e-3, 9.0], [np.inf, np.inf], [0.11e-3, 3.0]])
    (note,) = _contact_notes(limits)
    assert "4.2 mN m in steady motion, 0.11 mN m at rest:" in note
    assert "within 60 ms" in note
    assert "contacts that come more slowly are not looked for after reversals: " in note
    (note,) = _contact_notes(np.full((3, 2), 3e-3))
    assert "more slowly" not in note
    (note,) = _contact_notes(np.full((3, 2), np.inf))
    assert "not looked for" in note


def test_notes_state_what_was_learned_and_what_has_no_value():
    reach = Reach((0.1, 2.9), 12.0, 0.0456, (20, 40))
    factors = np.stack([np.linspace(1, 1.5, KIND_COUNT), np.linspace(0, 0.05, KIND_COUNT)], axis=1)
    fault = SignalFault(0.0, 1.0, "the encoder leaps", True)
    parts = [rows(limited=2), rows(limited=5, faults=(fault, SignalFault(1.0, 2.0, "", True)))]
    given = [Recorded("a", (parts[0],), 2, 1.25), Recorded("b", (parts[1],), 1, 0.5)]
    known = np.array([True, True, True, False])
    notes = _notes(given, known, reach, factors)
    assert "up to 45.6 mN m, from 0.1 to 2.9 rad of the motor, up to 12 rad/s" in notes[0]
    assert "after a reversal 1.30 and 3.0 %" in notes[1]
    assert "creeping 1.50 and 5.0 %" in notes[1]
    assert "no value in 25 % of the time" in notes[2]
    assert "current at its limit" in notes[2]
    assert "1.75 s have no value" in notes[3]
    assert "(gaps between samples: 3)" in notes[3]
    assert notes[4].startswith("samples with a current at its limit: 7;")
    assert notes[5:] == ["recording b: the encoder leaps"]
    calm = [Recorded("a", (rows(),), 0, 0.0)]
    assert len(_notes(calm, np.ones(4, dtype=bool), reach, factors)) == 2


@pytest.mark.parametrize(("share", "noted"), [(0.4, False), (0.6, True)])
def test_a_ripple_in_doubt_is_noted_where_it_makes_most_of_u(share, noted):
    reach, factors = Reach((0.1, 2.9), 12.0, 0.0456, (20, 40)), np.ones((KIND_COUNT, 2))
    known, sliding = np.ones(99, dtype=bool), np.full(60, State.AGAINST)
    parts = [
        rows(60, u=np.full(60, 1e-3), doubts=np.full(60, share * 1.4e-6), states=sliding),
        rows(30, u=np.full(30, 2e-3), doubts=np.full(30, share * 3.2e-6), states=sliding[:30]),
        rows(9, u=np.full(9, 1.0), doubts=np.ones(9), states=np.full(9, State.OUTSIDE)),
    ]
    notes = _notes([Recorded("a", tuple(parts), 0, 0.0)], known, reach, factors)[2:]
    assert len(notes) == noted
    if noted:  # mean squares of u are (60 * 1 + 30 * 4) / 90 = 2 mN2 m2, of the doubt 0.6 of it
        assert "in doubt: 1.1 mN m of the 1.4 mN m of u" in notes[0]
        assert "ripple of orders above 14" in notes[0]


# -- blocks


class Stored:
    """A recording in blocks."""

    name = "stored"

    def __init__(self, channels, lengths):
        self.channels, self.lengths = channels, lengths

    def has(self, name):
        return name in self.channels

    def read(self, name, first=0, last=None):
        return self.channels[name][first:last]

    def blocks(self, *names, finite, size):
        first = 0
        for length in self.lengths:
            yield [self.channels[name][first : first + length] for name in names]
            first += length


def stored(seed, size=30_000, interval=1e-3, referred=True):
    rng = np.random.default_rng(seed)
    time = interval * np.arange(size)
    for at in rng.integers(0, size, 5):
        time[at:] += rng.choice([0.4, 0.6, 30.0]) * interval
    names = ("encoder", "current_setpoint", "temperature", *(["reference_torque"] * referred))
    channels = {"time": time, **{name: rng.standard_normal(size) for name in names}}
    channels["encoder"][[*rng.integers(0, size, 4), 9000, 9006, 9020]] = np.nan
    channels["current_setpoint"][[700, size // 2, size // 2 + 1]] = np.nan
    if referred:
        channels["reference_torque"][::7] = np.nan
    cuts = np.sort(rng.integers(0, size, 6))
    return Stored(channels, np.diff([0, *cuts, size]).tolist())


@pytest.mark.parametrize("referred", [False, True])
@pytest.mark.parametrize("seed", range(5))
def test_blocks_hold_all_that_has_no_gap_and_is_long_enough(seed, referred):
    """A stretch ends at half a sample more and at NaN in what the torque is read from; one that
    lies between two gaps within a block and is too short for a row of ripple is left out."""
    own = instrument(interval=1e-3, loop_time=1e-3)
    recording = stored(seed, referred=referred)
    channels = np.array([*recording.channels.values()])
    good = np.isfinite(channels[:4]).all(axis=0)
    held = np.isfinite(channels[1]) & ~good & np.append(False, good[:-1])
    good |= held  # one sample: that is the time for which a current holds
    step = np.diff(channels[0])
    stretches, now = [], []
    for k in range(channels.shape[1]):
        if now and (not good[k] or abs(step[k - 1] - 1e-3) > 0.5e-3):
            stretches.append(now)
            now = []
        if good[k]:
            now.append(k)
    stretches.append(now)
    shortest = least_row_time(own.grid.step_time) / 1e-3
    edges = np.cumsum(recording.lengths)
    found, current = [], None
    for block, begins in unbroken_blocks(recording, own, holder := Holder(1e-3)):
        assert block.shape[0] == channels.shape[0]
        assert block.shape[1] <= 8192 * own.grid.step_time / 1e-3 + 1
        if begins:
            current = []
            found.append(current)
        current.extend(block[0].tolist())
    found = [part for part in found if part]
    kept = [part for part in stretches if part]
    long = [part for part in kept if len(part) >= shortest]
    whole = [channels[0, part].tolist() for part in long]
    assert holder.count == held.sum() == 2
    assert [part for part in found if len(part) >= shortest] == whole
    for part in found:  # what is short and yielded nevertheless touches the end of a block
        if len(part) < shortest:
            last = np.searchsorted(channels[0], part[-1]) + 1
            first = np.searchsorted(channels[0], part[0])
            assert last in edges or first in edges or any(first < e < last for e in edges)


@pytest.mark.parametrize("at", [1, 4999, 5000, 5001, 12000])
def test_a_time_that_falls_back_is_named_by_its_sample(at):
    recording = stored(1, size=20_000)
    time = recording.channels["time"] = 1e-3 * np.arange(20_000)
    time[at:] -= 1e-3
    recording.lengths = [5000, 1, 4999, 10_000]
    with pytest.raises(InsufficientDataError, match=f"does not rise at sample {at} "):
        list(unbroken_blocks(recording, instrument(interval=1e-3, loop_time=1e-3), Holder(1e-3)))


@pytest.mark.parametrize("cuts", [[], range(1, 400), [37, 40, 300]])
def test_a_current_that_is_missing_holds_for_a_step(cuts):
    """Both signals are those of the last sample that has both; as long in any blocks."""
    rng = np.random.default_rng(5)
    given, holder = rng.standard_normal((2, 400)), Holder(125e-6)
    given[:, :3] = given[0, 20] = given[1, 39:47] = given[0, 100:120] = given[1, -4:] = np.nan
    found = np.hstack([holder.add(part.copy()) for part in np.split(given, cuts, axis=1)])
    wanted = given.copy()
    for first, last in ((20, 21), (39, 47), (100, 108), (396, 400)):
        wanted[:, first:last] = given[:, first - 1 : first]
    np.testing.assert_array_equal(found, wanted)
    assert holder.count == 21


@pytest.mark.parametrize(
    ("measured", "expected"),
    [(1.0000005e-3, 1e-3), (1.00001e-3, 1.00001e-3), (125.00003e-6, 125e-6), (60e-6, 60e-6)],
)
def test_an_interval_within_a_millionth_is_a_multiple_of_the_loops(measured, expected):
    recipe = SimpleNamespace(rig=SimpleNamespace(sample_time=125e-6))
    recording = Stored({"time": 7.0 + measured * np.arange(9000)}, [])
    assert _interval(recording, recipe) == pytest.approx(expected, rel=1e-9)


# -- spectra


def test_spectra_are_sums_over_halfway_segments_of_a_second():
    rng, rate = np.random.default_rng(9), 500.0
    torque, reference = rng.standard_normal((2, 2700)) + 5
    valid = np.ones(2700, dtype=bool)
    valid[1300] = False
    found = Spectra.of(torque, reference, valid, rate)
    window = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(500) / 499)
    expected, count = np.zeros((3, 101), dtype=complex), 0
    for first in range(0, 2201, 250):
        part = slice(first, first + 500)
        if not valid[part].all():
            continue
        count += 1
        for k in range(101):
            turn = np.exp(-2j * np.pi * k * np.arange(500) / 500)
            read, acted = (
                np.sum(window * (s[part] - s[part].mean()) * turn) for s in (torque, reference)
            )
            expected[:, k] += abs(acted) ** 2, abs(read) ** 2, np.conj(acted) * read
    assert found.count == count == 7
    assert_allclose(found.frequency, np.arange(101.0))
    assert_allclose(found.of_reference, expected[0].real, rtol=1e-6, atol=1e-9)
    assert_allclose(found.of_torque, expected[1].real, rtol=1e-6, atol=1e-9)
    assert_allclose(found.cross, expected[2], rtol=1e-6, atol=1e-6)


def known_amplitude(ratio, coherence, count=40):
    """Return sums with these amplitudes and coherences."""
    of_torque = ratio**2 / coherence
    frequency = np.arange(float(len(ratio)))
    return Spectra(frequency, np.ones(len(ratio)), of_torque, ratio * np.exp(0.3j), count)


def test_the_bandwidth_is_where_the_amplitude_crosses_between_two_frequencies():
    ratio = np.array([0.5, 1.0, 1.01, 0.99, 0.97, 0.91, 1.0, 0.99])
    coherence = np.full(8, 0.995)
    u = 0.97 * math.sqrt((1 - 0.995) / (2 * 19 * 0.995))
    value, found_u = amplitude_bandwidth([known_amplitude(ratio, coherence)])
    assert u < MAX_AMPLITUDE_U
    assert value == pytest.approx(4 + (0.97 - RIGHT_AMPLITUDE) / 0.06)
    assert found_u == pytest.approx(math.hypot(u / 0.06, 1 / math.sqrt(12)))
    value, found_u = amplitude_bandwidth([known_amplitude(ratio[:5], coherence[:5])])
    assert (value, found_u) == pytest.approx((4.0, 1 / math.sqrt(12)))
    coherence[5] = 0.5  # the frequency with the low amplitude is not known
    assert amplitude_bandwidth([known_amplitude(ratio, coherence)])[0] == 7.0
    wrong = np.append([1.0, 0.94], ratio[2:])
    assert math.isnan(amplitude_bandwidth([known_amplitude(wrong, np.full(8, 0.995))])[0])
