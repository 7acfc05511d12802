"""Ripple of the virtual rig, from recipe to spectra and back from the file."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from rigtool.errors import InsufficientDataError, RunFileError, UsageError
from rigtool.experiments.ripple import procedure as fft_ripple
from rigtool.experiments.ripple.procedure import PROCEDURE as FFT_RIPPLE
from rigtool.experiments.ripple.procedure import _friction_changes
from rigtool.experiments.ripple.procedure_steady import collected, steady_samples
from rigtool.experiments.ripple.results import steps_note
from rigtool.experiments.ripple.shared_scatter import shared_floor
from rigtool.experiments.ripple.varying_speed import friction_changes
from rigtool.quantity import Quantity
from rigtool.recipe import load_recipe, override_recipe
from rigtool.runfile import Column, RunWriter, Table, open_run
from tests.experiments.virtual_runs import (
    QUIET,
    RECIPE,
    TORQUE_CONSTANT,
    run,
    write_results,
)
from tests.unchanged import require_unchanged

SHORT = (
    "fft_ripple.speeds=[3, 30]",
    "fft_ripple.revolutions=4",
    "fft_ripple.torques=[14e-3, 160e-3]",
    "fft_ripple.slow_speed_rev_per_s=0.5",
)


@pytest.fixture(scope="module")
def measured(folder, kt):
    path = folder / "ripple.h5"
    return path, run(FFT_RIPPLE, RECIPE, path, *SHORT, kt=kt)


def test_no_other_number_has_changed(measured):
    require_unchanged("ripple", measured[1])


def test_the_second_order_is_strongest_slowly_and_the_first_fast(measured):
    """[7.1.3, Fig. 28]"""
    results = measured[1].results
    assert results["strongest_order_lowest_speed"].value == 2
    assert results["strongest_order_highest_speed"].value == 1
    assert results["repeatable_rms"].value > 3 * results["non_repeatable_rms"].value
    assert not any("varies the speed" in note for note in measured[1].notes)


def test_the_spectrum_states_u_and_its_degrees_of_freedom(measured):
    """By the scatter of the coefficients of single revolutions, each part by itself, and of the
    orders around."""
    tables = measured[1].tables
    spectrum, single = tables["power_spectrum"], tables["revolutions"]["torque"]
    orders = np.fft.rfft(single, axis=1)[:, 1:101] * 2 / single.shape[1]
    parts = np.concatenate([orders.real, orders.imag]).reshape(2, len(single), -1)
    u = np.sqrt(parts.var(axis=1, ddof=1).mean(axis=0) / len(single))
    freedom = 2 * (len(single) - 1)
    floor, freedom = shared_floor(np.arange(1.0, 101), math.sqrt(2) * u, freedom)
    u, freedom = floor[:12] / math.sqrt(2), freedom[:12]
    stated, dof = spectrum["u"][0, :12], spectrum["dof"][0, :12]
    assert (stated >= 0.95 * u).all()
    # by Welch and Satterthwaite, the rest being known: dof = freedom (stated/u)^4
    np.testing.assert_allclose(stated * (freedom / dof) ** 0.25, u, rtol=0.05, atol=0)


def test_cogging_is_found_with_amplitude_and_phase(folder, kt):
    """The controller asks for the opposite of the cogging torque, within the band of T."""
    cogging = "virtual.motor.cogging=[{ order = 3, amplitude = 0.5e-3, phase = 0.6 }]"
    outcome = run(
        FFT_RIPPLE,
        RECIPE,
        folder / "cogging.h5",
        *SHORT,
        *QUIET,
        cogging,
        "fft_ripple.record_every=1",
        kt=kt,
    )
    found = outcome.tables["speed_spectrum"]
    assert found["amplitude"][0, 2] == pytest.approx(0.5e-3, rel=0.02, abs=0)
    error = np.angle(np.exp(1j * (found["phase"][0, 2] - 0.6 - np.pi)))
    assert error == pytest.approx(0, abs=0.03)
    assert np.delete(found["amplitude"][0, :12], 2).max() < 0.02e-3
    assert outcome.results["strongest_order_lowest_speed"].value == 3


def test_averaging_into_few_samples_costs_no_amplitude(folder, kt):
    """Of 131 samples a turn, each a mean of 128, order 40 would keep 62 %; orders above 52 none."""
    cogging = "virtual.motor.cogging=[{ order = 40, amplitude = 0.5e-3, phase = 0.6 }]"
    alone = ("fft_ripple.speeds=[3]", "fft_ripple.torques=[]", "fft_ripple.power_cycles=0")
    sets = (*SHORT, *QUIET, cogging, *alone)
    fine, coarse = (
        run(FFT_RIPPLE, RECIPE, folder / "few.h5", *sets, f"fft_ripple.record_every={every}", kt=kt)
        for every in (4, 128)
    )
    expected = fine.tables["speed_spectrum"]["amplitude"][0, 39]
    found = coarse.tables["speed_spectrum"]["amplitude"][0]
    assert found[39] == pytest.approx(expected, rel=0.02, abs=0)
    assert np.isfinite(found[:52]).all()
    assert np.isnan(found[52:]).all()
    said = "at 3 rad/s there are 131 samples a turn: orders above 52 are not resolved"
    assert said in coarse.notes
    assert not any("at 3 rad/s" in note for note in fine.notes)


def test_speeds_at_which_the_loop_follows_an_alias_of_the_encoder_are_noted():
    """Nearly three counts or two and a half from one sample of the loop to the next."""
    recipe, _ = load_recipe(RECIPE, ())
    speeds = [2 * math.pi * x * 8000 / 4000 for x in (0.25, 2.5005, 2.52, 3.001)]
    recordings = [SimpleNamespace(condition=lambda name, v=v: v) for v in speeds]
    (note,) = steps_note(recordings, recipe)
    assert note.startswith("at 31.4, 37.7 rad/s the encoder makes 2.501, 3.001 counts")
    assert steps_note(recordings[::2], recipe) == []


def test_ripple_grows_with_constant_torque(measured):
    """[Fig. 25]"""
    waveforms = measured[1].tables["torque_waveforms"]
    np.testing.assert_allclose(waveforms["torque"], [14e-3, 160e-3], rtol=1e-12, atol=0)
    rms = np.sqrt(np.mean(waveforms["ripple"] ** 2, axis=1))
    assert rms[1] > 1.2 * rms[0]
    np.testing.assert_allclose(waveforms["ripple"].mean(axis=1), 0, rtol=0, atol=1e-12)


def test_a_power_cycle_changes_the_ripple_and_nothing_else_does(folder, kt, measured):
    results = measured[1].results
    table = measured[1].tables["power_waveforms"]
    assert table["power_cycle"].tolist() == [0, 1]
    expected = np.corrcoef(*table["torque"])[0, 1]
    # Noise, which is left out of the comparison, lowers that of the whole waveforms.
    assert expected < results["power_cycle_correlation"].value < expected + 0.1
    assert results["power_cycle_correlation"].value < 0.95
    assert not any("nothing to compare" in note for note in measured[1].notes)
    # A ripple that start-ups do not touch is the same ripple.
    cogging = "virtual.motor.cogging=[{ order = 2, amplitude = 0.5e-3, phase = 0.6 }]"
    same = run(FFT_RIPPLE, RECIPE, folder / "same.h5", *SHORT, *QUIET, cogging, kt=kt)
    assert same.results["power_cycle_correlation"].value == pytest.approx(1, rel=0, abs=2e-3)
    assert same.results["power_cycle_shift"].value == pytest.approx(0, rel=0, abs=0.01)


def test_psd_shows_the_orders_at_their_frequencies(measured):
    psd = measured[1].tables["speed_psd"]
    frequency = psd["frequency"]
    fast = frequency[np.argmax(psd["psd"][1])]
    assert fast == pytest.approx(30 / (2 * np.pi), rel=0, abs=frequency[1])
    with open_run(measured[0]) as stored:
        time = next(iter(stored.recordings.values())).read("time")
    assert frequency[-1] == pytest.approx(0.5 / np.mean(np.diff(time)), rel=1e-6)


def test_the_stored_signals_give_the_same_again(measured, folder, kt):
    path, outcome = measured
    again = run(FFT_RIPPLE, path, folder / "again.h5", kt=kt)
    assert again.results == outcome.results
    with open_run(path) as stored:
        assert stored.recipe.rig.attachment == "pulley"  # measured on the bare motor


def test_without_power_cycles_nothing_is_compared(folder, kt):
    outcome = run(
        FFT_RIPPLE,
        RECIPE,
        folder / "once.h5",
        *SHORT,
        "fft_ripple.power_cycles=0",
        "fft_ripple.torques=[]",
        kt=kt,
    )
    assert not any("power" in name or "torque" in name for name in outcome.tables)
    assert not any(name.startswith("power") for name in outcome.results)
    assert any("nothing to compare" in note for note in outcome.notes)


def test_too_short_a_recording_is_refused(measured, kt):
    with open_run(measured[0]) as stored, open_run(kt) as constant:
        recipe = override_recipe(stored.recipe, ["fft_ripple.revolutions=9"])
        with pytest.raises(InsufficientDataError, match=r"speed_000: 4 whole revol.* 9 are"):
            fft_ripple.analyse([stored], recipe, kt=constant)


@pytest.mark.parametrize(
    ("name", "times", "cause"),
    [
        ("torque_001", 3.0, "lower fft_ripple.torques, or raise rig.current_limit"),
        ("speed_001", 3.0, "turn more slowly, or raise rig.current_limit"),
        ("speed_001", 5.0, "the loop shakes"),
    ],
)
def test_a_saturated_current_is_named_with_its_cause(measured, monkeypatch, name, times, cause):
    """A current that once reaches so many times its mean, which is that of turning."""
    with open_run(measured[0]) as stored:
        recording = stored.recording(name)
        steady = steady_samples(recording)
        mean = recording.read("current_setpoint", steady.start, steady.stop).mean()
        recipe = override_recipe(stored.recipe, [f"rig.current_limit={times * mean}"])
        whole = type(recording).blocks

        def blocks(*asked, **samples):
            for time, encoder, current in whole(*asked, **samples):
                current[0] = times * mean
                yield time, encoder, current

        monkeypatch.setattr(type(recording), "blocks", blocks)
        with pytest.raises(InsufficientDataError, match=rf"{name}: .*{cause}"):
            collected(recording, steady, recipe, None)


def test_heat_that_no_motor_survives_is_refused(measured, kt, monkeypatch):
    monkeypatch.setattr(fft_ripple, "LARGEST_FALL", 1e-6)
    with (
        open_run(measured[0]) as stored,
        open_run(kt) as constant,
        pytest.raises(InsufficientDataError, match="would lower the torque constant by"),
    ):
        fft_ripple.analyse([stored], stored.recipe, kt=constant)


def test_inputs_that_do_not_fit_are_refused(measured, kt):
    with open_run(measured[0]) as stored, open_run(kt) as constant:
        with pytest.raises(UsageError, match="takes one"):
            fft_ripple.analyse([stored, stored], stored.recipe, kt=constant)
        with pytest.raises(RunFileError, match="no recording speed_000"):
            fft_ripple.analyse([constant], stored.recipe, kt=constant)
        with pytest.raises(RunFileError, match="calibrate-kt"):
            fft_ripple.analyse([stored], stored.recipe, kt=stored)


def test_how_a_run_was_recorded_cannot_be_changed_afterwards(measured, folder, kt):
    """Samples are means of as many as were averaged: another number would misjudge them."""
    with pytest.raises(UsageError, match="record_every=1: a stored run stays as it was recorded"):
        run(FFT_RIPPLE, measured[0], folder / "no.h5", "fft_ripple.record_every=1", kt=kt)
    assert not (folder / "no.h5").exists()


def test_heat_of_the_winding_and_the_loop_are_taken_off_the_amplitudes(folder):
    """The heat of 160 mN m costs 3 % of k here, and at 30 rad/s the loop asks for 1.3 times it.

    The inertia is as the recipe states it, and no friction changes with the speed: both would be
    part of the amplitude, 1.3 and 0.7 %.
    """
    slope = -4e-3
    kt = write_results(
        folder / "slope.h5",
        "calibrate-kt",
        torque_constant=(TORQUE_CONSTANT, "N m/A", 1e-3 * TORQUE_CONSTANT),
        torque_constant_temperature_coefficient=(slope, "1/K", 1e-4),
        torque_constant_mean=(TORQUE_CONSTANT * (1 + 7.5 * slope), "N m/A"),
        amplifier_gain=(1.0, "1"),
    )
    sets = (
        "virtual.motor.cogging=[{ order = 4, amplitude = 1e-3 }]",
        f"virtual.motor.torque_constant_temperature_coefficient={slope}",
        "virtual.amplifier.bandwidth_hz=20000",  # the torque that is asked for acts without a lag
        "virtual.motor.inertia=1.5028e-5",
        "virtual.motor.viscous_friction=0",
        "virtual.thermal.winding_capacity=15",
        "virtual.thermal.winding_to_housing=1.5",
        "fft_ripple.torques=[0.16]",
        "fft_ripple.power_cycles=0",
        "fft_ripple.revolutions=10",
    )
    outcome = run(FFT_RIPPLE, RECIPE, folder / "heat.h5", *SHORT, *QUIET, *sets, kt=kt)
    for kind, row in (("torque", 0), ("speed", 1)):
        table = outcome.tables[f"{kind}_spectrum"]
        assert table["amplitude"][row, 3] == pytest.approx(1e-3, rel=0.004, abs=0), kind
    assert outcome.tables["speed_spectrum"]["loop_gain"][1, 3] > 1.1
    assert any("torque_000: the current that holds" in note for note in outcome.notes)
    rms = outcome.results["repeatable_rms"]
    parts = {line.name: line.contribution / rms.value for line in rms.budget}
    degc = 27.0  # of the motor, which turning hardly heats
    factor = 1 + slope * (degc - 20)
    assert parts["torque constant at 20 degC"] == pytest.approx(1e-3, rel=1e-6, abs=0)
    slope_part = 1e-4 * (degc - 20) / factor
    assert parts["temperature coefficient"] == pytest.approx(slope_part, rel=0.03, abs=0)
    assert {"scatter", "heat of the winding"} <= set(parts)


def test_recordings_hold_their_turns_at_constant_speed():
    """And one more, as turns are cut at the encoder's zero."""
    settings = (
        "fft_ripple.speeds=[3, 30]",
        "fft_ripple.torques=[0.01, 0.05]",
        "fft_ripple.power_cycles=2",
        "fft_ripple.slow_speed_rev_per_s=0.5",
        "fft_ripple.revolutions=20",
    )
    specs = {spec.name: spec for spec in fft_ripple.recordings(load_recipe(RECIPE, settings)[0])}
    slow = math.pi
    expected = {
        "speed_000": {"speed": 3.0},
        "speed_001": {"speed": 30.0},
        "torque_000": {"speed": slow, "torque": 0.01},
        "torque_001": {"speed": slow, "torque": 0.05},
        "power_cycle_000": {"speed": slow, "power_cycle": 0.0},
        "power_cycle_001": {"speed": slow, "power_cycle": 1.0},
    }
    assert list(specs) == list(expected)
    for name, given in expected.items():
        found = {key: value for key, (value, _) in specs[name].conditions.items()}
        begin, end = found.pop("steady_from"), found.pop("steady_until")
        assert found == pytest.approx(given)
        run_up = given["speed"] / fft_ripple.ACCELERATION
        assert begin == pytest.approx(run_up + fft_ripple.SETTLE_TIME)
        assert 21 < (end - begin) * given["speed"] / (2 * math.pi) < 21.5


def test_a_soft_loop_makes_no_orders_of_strong_ripple(folder, kt):
    """Cogging of orders 9 and 13 varies the speed: orders 4 and 22 of the controller's torque."""
    cogging = "{ order = 9, amplitude = 1.2e-3 }, { order = 13, amplitude = 1e-3 }"
    outcome = run(
        FFT_RIPPLE,
        RECIPE,
        folder / "soft.h5",
        *SHORT,
        *QUIET,
        f"virtual.motor.cogging=[{cogging}]",
        "rig.controller.crossover_hz=20",
        "fft_ripple.speeds=[6]",
        "fft_ripple.torques=[]",
        "fft_ripple.power_cycles=0",
        kt=kt,
    )
    found = outcome.tables["speed_spectrum"]["amplitude"][0]
    assert found[[8, 12]] == pytest.approx([1.2e-3, 1e-3], rel=0.02, abs=0)
    assert np.delete(found[:22], [8, 12]).max() < 0.01e-3
    assert any(
        "ripple varies the speed" in note and "speed_000 by" in note for note in outcome.notes
    )


def test_friction_that_changes_with_the_speed_is_part_of_u(folder, kt):
    """Viscous friction of 1 mN m s, where a speed varies by some per cent, without a note."""
    outcome = run(
        FFT_RIPPLE,
        RECIPE,
        folder / "viscous.h5",
        *SHORT,
        *QUIET,
        "virtual.motor.cogging=[{ order = 12, amplitude = 0.3e-3 }]",
        "virtual.motor.viscous_friction=1e-3",
        "virtual.motor.inertia=1.5028e-5",
        "rig.controller.crossover_hz=20",
        "fft_ripple.speeds=[3, 6, 12]",
        "fft_ripple.torques=[]",
        "fft_ripple.power_cycles=0",
        kt=kt,
    )
    table = outcome.tables["speed_spectrum"]
    away = abs(table["amplitude"][1, 11] - 0.3e-3)
    assert away > 5 * table["noise_floor"][1, 11]
    assert away < 2 * table["u"][1, 11]
    assert not any("varies the speed" in note for note in outcome.notes)


def test_an_amplifier_off_its_line_is_part_of_u_and_noted(measured, folder):
    levels = np.linspace(0.0, 4.0, 11)
    columns = {
        "current_setpoint": Column(levels, "A"),
        "deviation": Column(2e-3 * np.cos(2.2 * np.arange(levels.size)), "A"),
    }
    results = {
        "torque_constant_mean": Quantity(TORQUE_CONSTANT, "N m/A", 0.0),
        "amplifier_linearity": Quantity(2e-3, "A", 1e-5),
    }
    table = Table(("current_setpoint",), columns, "deviation", "DC linearity")
    path = folder / "bent.h5"
    with RunWriter(path, command="calibrate-kt") as writer:
        writer.finish(results, {"linearity": table})
    with open_run(measured[0]) as stored, open_run(path) as constant:
        outcome = fft_ripple.analyse([stored], stored.recipe, kt=constant)
    plain = measured[1].tables["power_spectrum"]["u"][0, :6]
    more = outcome.tables["power_spectrum"]["u"][0, :6] - plain
    assert (more > 0.05 * 2e-3 * TORQUE_CONSTANT).all()
    assert any("the amplifier is not linear" in note for note in outcome.notes)
    assert not any("the amplifier is not linear" in note for note in measured[1].notes)


def test_friction_is_the_mean_torque_without_the_constant_one():
    """Of one speed that without a constant torque counts, whichever comes first."""

    def turning(speed, **torque):
        conditions = {"speed": speed, **torque}
        return SimpleNamespace(conditions=conditions, condition=conditions.__getitem__)

    recorded = [turning(2.0), turning(4.0), turning(1.0, torque=0.1), turning(1.0), turning(8.0)]
    for last in (recorded[:4], recorded):
        means = [3e-3, 5e-3, 0.104, 2e-3, 6e-3][: len(last)]
        even = [0.9] * len(last)
        changes = _friction_changes(last, means, even)
        alone = _friction_changes(last[:2] + last[3:], means[:2] + means[3:], even[1:])
        assert changes[:2] + changes[3:] == alone
        every = np.array([[1.0, 2.0, 4.0, 8.0], [2e-3, 3e-3, 5e-3, 6e-3]])
        assert changes[2] == changes[3] == friction_changes(*every[:, : len(alone)], 0.9)[0]
        assert changes[0] == pytest.approx(1e-3 * 2.0)
    only = _friction_changes(recorded[2:3] + recorded[:1], [0.104, 3e-3], [0.9, 0.9])
    assert only[0] == pytest.approx(4e-3 / math.sqrt(3))


def test_the_slowest_place_of_the_recordings_at_the_slowest_speed_counts():
    conditions = [{"speed": v} for v in (1.0, 2.0, 4.0, 1.0)]
    recorded = [SimpleNamespace(conditions=c, condition=c.__getitem__) for c in conditions]
    means = [3.02e-3, 3e-3, 3.1e-3, 3.02e-3]
    alike, slower, other = (
        _friction_changes(recorded, means, lowest)[0]
        for lowest in ([0.9, 0.9, 0.9, 0.9], [0.9, 0.9, 0.9, 0.4], [0.9, 0.4, 0.9, 0.9])
    )
    assert slower > 1.5 * alike
    assert other == alike
