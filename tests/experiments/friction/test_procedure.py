"""stribeck on the virtual rig, from recipe to friction and back from the file."""

import json

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import signal

from rigtool.control.position_loop import position_loop
from rigtool.errors import InsufficientDataError, RunFileError
from rigtool.experiments.controller_torque import encoder_shaking
from rigtool.experiments.friction import holds
from rigtool.experiments.friction import procedure as stribeck
from rigtool.experiments.friction.procedure import PROCEDURE as STRIBECK
from rigtool.experiments.friction.procedure_analysis import (
    _find_holds,
    fit_holds,
)
from rigtool.experiments.friction.results import Scale
from rigtool.experiments.running.options import CommonOptions
from rigtool.experiments.running.session import run_command
from rigtool.quantity import Quantity
from rigtool.recipe import load_recipe, override_recipe
from rigtool.recipe.commands import Stribeck
from rigtool.runfile import Recording, RecordingSpec, RunWriter, open_run
from tests.experiments.virtual_runs import RECIPE, run
from tests.thorough import first_of
from tests.unchanged import require_unchanged

SHORT = (
    "stribeck.hold_speeds=[0.6, 1, 2, 5, 10, 20, 30]",
    "stribeck.sweep_time=30",
    "stribeck.record_every=16",
)


@pytest.fixture(scope="module")
def measured(folder, kt):
    path = folder / "friction.h5"
    return path, run(STRIBECK, RECIPE, path, *SHORT, seed=1, kt=kt)


def test_no_other_number_has_changed(measured):
    require_unchanged("friction", measured[1])


def extract(source, target, *names, overrides=()):
    """Write a run with some of another one's recordings, as other people's files may be."""
    with open_run(source) as whole:
        parts = [whole.recording(name) for name in names]
        specs = [
            RecordingSpec(
                part.name,
                part.channels,
                {
                    name: (quantity.value, quantity.unit)
                    for name, quantity in part.conditions.items()
                },
            )
            for part in parts
        ]
        recipe = override_recipe(whole.recipe, overrides)
        with RunWriter(target, command="stribeck", recipe=recipe, recordings=specs) as writer:
            for part in parts:
                block = {channel.name: part.read(channel.name) for channel in part.channels}
                writer.append(part.name, block)
            writer.finish({}, {})
    return target


@pytest.mark.parametrize("seed", first_of([1, 2]))
def test_thesis_values_for_several_seeds(folder, kt, measured, seed):
    """[7.1.2, 7.2.1, 7.2.2]"""
    path = folder / f"seed{seed}.h5"
    outcome = measured[1] if seed == 1 else run(STRIBECK, RECIPE, path, *SHORT, seed=seed, kt=kt)
    results = outcome.results
    assert_allclose(results["coulomb_friction"].value, 2.3e-3, rtol=0.05)
    assert_allclose(results["viscous_friction"].value, 5.33e-5, rtol=0.05)
    assert_allclose(results["breakaway_torque_min"].value, 2.4e-3, atol=0.5e-3, rtol=0)
    assert_allclose(results["breakaway_torque_max"].value, 5e-3, atol=0.5e-3, rtol=0)
    assert_allclose(results["radial_load_breakaway"].value, 1.05e-3, rtol=0.1)
    radial = results["radial_load_friction"]
    assert_allclose(radial.value, 1.05e-3, rtol=0, atol=3 * radial.u)
    assert radial.u < 0.03e-3
    assert_allclose(
        results["radial_friction_coefficient"].value,
        results["radial_load_friction"].value / 22,
        rtol=1e-12,
    )
    for name, true in (("coulomb_friction", 2.3e-3), ("viscous_friction", 5.33e-5)):
        assert abs(results[name].value - true) < 4 * results[name].u
        both = [results[f"{name}_{direction}"].value for direction in ("positive", "negative")]
        assert_allclose(np.mean(both), results[name].value, rtol=1e-9)


def test_compensation_makes_the_torque_speed_curve_flat(measured):
    """[Fig. 30, 32, 34]"""
    tables = measured[1].tables
    curves = [tables[name] for name in ("torque_speed", "torque_speed_coulomb")]
    flat = tables["torque_speed_viscous"]
    fast = np.abs(flat["speed"]) > 5
    sign = np.sign(flat["speed"])
    bare = (sign * curves[0]["torque"])[fast]
    coulomb = (sign * curves[1]["torque"])[fast]
    # friction is 2.3 + 0.0533 v mN m: each compensation takes its part away
    assert_allclose(bare.mean() - coulomb.mean(), 2.3e-3, rtol=0.05)
    slope = np.polyfit(np.abs(flat["speed"][fast]), coulomb, 1)[0]
    assert_allclose(slope, 5.33e-5, rtol=0.2)
    assert np.abs(flat["torque"][fast]).mean() < 0.1 * bare.mean()
    assert measured[1].results["compensated_torque_rms"].value < 0.1 * 2.3e-3


def test_friction_model_runs_through_the_holds(measured):
    tables = measured[1].tables
    model, holds = tables["friction_model"], tables["holds"]
    fitted = np.interp(holds["speed"], model["speed"], model["torque"])
    known = np.abs(holds["speed"]) >= np.abs(model["speed"]).min()
    assert_allclose(fitted[known], holds["torque"][known], atol=0.1e-3)


def test_breakaway_tables_go_around_the_turn(measured):
    table = measured[1].tables["breakaway"]
    assert_allclose(np.diff(table["position"]), 2 * np.pi / 24, atol=0.02)
    for name in ("positive", "negative", "loaded_positive", "loaded_negative"):
        assert np.isfinite(table[name]).all()
    ramp = measured[1].tables["breakaway_ramp"]
    assert len(ramp["time"]) <= 2000
    highest = measured[1].results["breakaway_torque_max"].value
    assert_allclose(np.abs(ramp["torque"][-1]), highest, atol=0.15e-3)


def test_offset_and_asymmetry_are_told_apart(folder, kt):
    outcome = run(
        STRIBECK,
        RECIPE,
        folder / "asymmetric.h5",
        *SHORT,
        "virtual.motor.friction_asymmetry=0.1",
        "virtual.amplifier.offset=-0.02",
        kt=kt,
    )
    results = outcome.results
    assert_allclose(results["friction_asymmetry"].value, 0.1, atol=0.03)
    assert_allclose(results["friction_offset"].value, 0.02 * 45.4e-3, rtol=0.1)
    assert_allclose(results["coulomb_friction_positive"].value, 2.3e-3 * 1.1, rtol=0.05)
    assert_allclose(results["coulomb_friction_negative"].value, 2.3e-3 * 0.9, rtol=0.05)


def test_stribeck_model_where_the_data_carry_it(folder, kt):
    outcome = run(
        STRIBECK, RECIPE, folder / "vs.h5", *SHORT, "virtual.motor.stribeck_velocity=2", kt=kt
    )
    results = outcome.results
    assert_allclose(results["stribeck_velocity"].value, 2.0, rtol=0.1)
    assert_allclose(results["stribeck_static_friction"].value, 4e-3, rtol=0.05)
    assert_allclose(results["coulomb_friction"].value, 2.3e-3, rtol=0.05)


def test_no_stribeck_effect_is_said_so(measured):
    assert "stribeck_velocity" not in measured[1].results
    assert any("do not resolve a Stribeck effect" in note for note in measured[1].notes)
    # static friction is then what breaks the shaft away
    assert_allclose(measured[1].results["static_friction"].value, 3.7e-3, rtol=0.1)


def test_an_amplifier_that_fails_at_low_current_is_refused(folder, kt):
    """[Appendix C]"""
    path = folder / "idm640.h5"
    with pytest.raises(InsufficientDataError, match="not linear at low current"):
        run(
            STRIBECK,
            RECIPE,
            path,
            *SHORT,
            "virtual.amplifier.distortion=0.02",
            "virtual.amplifier.distortion_period=0.1",
            kt=kt,
        )
    assert not path.exists()


def test_analysis_of_the_file_gives_the_same(measured, kt, folder):
    path, outcome = measured
    again = run(STRIBECK, path, folder / "again.h5", kt=kt)
    assert again.results == outcome.results
    assert again.notes == outcome.notes


def test_parts_of_a_run_give_what_they_carry(measured, kt, folder):
    path, outcome = measured
    holds = run(STRIBECK, extract(path, folder / "h.h5", "holds"), folder / "h_out.h5", kt=kt)
    assert holds.results["coulomb_friction"].value == outcome.results["coulomb_friction"].value
    assert "static_friction" not in holds.results
    assert any("breakaway_loaded" in note for note in holds.notes)
    sweep = run(STRIBECK, extract(path, folder / "s.h5", "sweep"), folder / "s_out.h5", kt=kt)
    assert_allclose(sweep.results["coulomb_friction"].value, 2.3e-3, rtol=0.1)
    assert_allclose(sweep.results["viscous_friction"].value, 5.33e-5, rtol=0.15)
    ramps = run(STRIBECK, extract(path, folder / "b.h5", "breakaway"), folder / "b_out.h5", kt=kt)
    assert set(ramps.results) == {
        "static_friction",
        "breakaway_torque_min",
        "breakaway_torque_max",
    }
    lacking = "holds, sweep, sweep_coulomb, sweep_viscous, breakaway_loaded, holds_loaded"
    assert f"not recorded, so without results: {lacking}" in ramps.notes


def test_ramps_that_break_nothing_away_are_shown_and_noted(measured, kt, folder):
    far = ("stribeck.breakaway_angle=3",)
    part = extract(measured[0], folder / "stuck.h5", "sweep", "breakaway", overrides=far)
    found = run(STRIBECK, part, folder / "stuck_out.h5", kt=kt)
    assert "coulomb_friction" in found.results
    assert not {"static_friction", "breakaway_torque_max"} & set(found.results)
    assert any(note.startswith("'breakaway' is without results: ") for note in found.notes)
    assert_allclose(found.tables["breakaway_ramp"]["torque"][0], 0, atol=0.5e-3)


def test_sources_are_pooled(measured, kt, folder):
    path, outcome = measured
    first = extract(path, folder / "p1.h5", "holds", "breakaway")
    second = extract(path, folder / "p2.h5", "sweep", "breakaway_loaded")
    with open_run(kt) as opened:
        pooled = run_command(
            STRIBECK,
            [str(first), str(second)],
            str(folder / "pooled.h5"),
            options=CommonOptions(),
            inputs={"kt": opened},
        )
    for name in ("coulomb_friction", "friction_offset", "radial_load_breakaway"):
        assert pooled.results[name] == outcome.results[name]


def test_a_run_without_any_of_it_is_refused(measured, kt, folder):
    again = folder / "bare.h5"
    run(STRIBECK, measured[0], again, kt=kt)
    with pytest.raises(RunFileError, match="no recording 'holds'"):
        run(STRIBECK, again, folder / "none.h5", kt=kt)


def test_a_saturated_current_is_named_with_its_cause(measured, kt):
    with open_run(measured[0]) as stored, open_run(kt) as constant:
        largest = np.abs(stored.recording("holds").read("current_setpoint")).max()
        recipe = override_recipe(stored.recipe, [f"rig.current_limit={largest}"])
        with pytest.raises(InsufficientDataError, match=r"holds: .* reaches the limit"):
            stribeck.analyse([stored], recipe, kt=constant)


def test_holds_are_whole_turns_and_long_enough():
    settings = Stribeck(hold_speeds=(0.5, 2.0, 30.0), hold_revolutions=2, hold_time=5.0)
    profile = stribeck.hold_profile(settings, -1.0)
    times, speeds = np.array(profile.times), np.array(profile.speeds)
    constant = (np.diff(speeds) == 0) & (speeds[1:] != 0)
    length = np.diff(times)[constant] - stribeck.SETTLE_TIME
    turns = length * np.abs(speeds[1:][constant]) / (2 * np.pi)
    assert_allclose(turns, np.round(turns), atol=1e-9)
    assert np.all(turns >= 2)
    assert np.all(length >= 5.0)
    assert np.all(speeds <= 0)
    assert (speeds[0], speeds[-1]) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("hold_speeds", "held"), [((0.4, 0.6, 1, 2, 3, 5, 8), (1, 2, 3, 5)), ((0.3, 0.6, 0.9), (0.9,))]
)
def test_hung_weights_end_where_they_began(hold_speeds, held):
    settings = Stribeck(hold_speeds=hold_speeds, hold_revolutions=3)
    profile = stribeck.loaded_profile(settings)
    assert np.unique(np.abs(profile.speeds)).tolist() == [0.0, *held]
    time = np.linspace(0, profile.duration, 4001)
    position = profile.setpoint(time)[0]
    # three turns, and a second of settling
    assert np.abs(position).max() < 3 * 2 * np.pi + 1.2 * max(held)
    assert abs(position[-1]) < 0.2 * max(held)


def test_sweep_begins_at_standstill_and_runs_from_end_to_end():
    profile = stribeck.sweep_profile(Stribeck(speed_max=20.0, sweep_time=40.0))
    _, speed, _ = profile.setpoint(np.array([0.0, 1.0, 21.0, 41.0, 42.0]))
    assert_allclose(speed, [0.0, -20.0, 0.0, 20.0, 0.0], atol=1e-12)


def between_set_points(path, kt, lacking):
    """Return friction from a stored run whose rig read these currents between its set points, A."""
    with open_run(path) as stored, open_run(kt) as constant:
        names = ("speed", "lacking_current", "u")
        found = [dict(zip(names, (*item, 1e-6), strict=True)) for item in lacking]
        stored.provenance["line"] = json.dumps({"between_set_points": found})
        return stribeck.analyse([stored], stored.recipe, kt=constant)


def test_what_samples_lack_is_in_the_uncertainty_of_friction_or_refuses_it(measured, kt):
    path, plain = measured
    speeds, (start, slope) = np.array([0.6, 1, 2, 5, 10, 20, 30]), (1e-3, 5e-5)
    outcome = between_set_points(path, kt, zip(speeds, start + slope * speeds, strict=True))
    for name, lacking in (("coulomb_friction", start), ("viscous_friction", slope)):
        before, after = plain.results[name], outcome.results[name]
        assert after.value == before.value
        expected = np.hypot(before.u, 0.0454 * lacking)
        assert after.u == pytest.approx(expected, rel=1e-6, abs=0)
        assert after.u > 1.2 * before.u
    assert any("which is in the uncertainty of friction" in note for note in outcome.notes)
    with pytest.raises(
        InsufficientDataError, match=r"most at 30(\.\d)? rad/s .* 10 % of the torque"
    ):
        between_set_points(path, kt, [(30.0, 0.02)])


def speed_by_steps(recipe, error):
    """Return the standard deviation of speed by an error of the encoder, rad (n,), by scipy."""
    loop = position_loop(**recipe.rig.loop_design).complementary_sensitivity
    delays = np.zeros(loop.relative_degree)
    angle = signal.lfilter(np.concatenate([delays, loop.num]), loop.den, error)
    return np.std(np.diff(angle)[1000:] / recipe.rig.sample_time)


def test_how_far_the_steps_of_the_encoder_shake_the_shaft():
    """Against noise of a step, evenly distributed, and against the steps of a slow turn."""
    recipe = load_recipe(RECIPE, ["rig.encoder_counts=2000"])[0]
    step = 2 * np.pi / 2000
    noise = (np.random.default_rng(1).random(100_000) - 0.5) * step
    found = encoder_shaking(recipe, np.array([-20.0]))
    assert found == pytest.approx(speed_by_steps(recipe, noise) / 20, rel=0.03)
    angle = 0.3 * recipe.rig.sample_time * np.arange(100_000)
    found = encoder_shaking(recipe, np.array([0.3]))
    steps = np.floor(angle / step) * step - angle
    assert found == pytest.approx(speed_by_steps(recipe, steps) / 0.3, rel=0.03)


def test_samples_that_do_not_show_the_shaking_take_what_the_steps_make(measured, monkeypatch):
    recipe = load_recipe(RECIPE, ["rig.encoder_counts=2000"])[0]
    monkeypatch.setattr(holds, "_shaking", lambda *_: 0.0)
    with open_run(measured[0]) as stored:
        found = _find_holds(
            stored.recording("holds"), recipe, Scale(Quantity(0.045, "N m/A", 1e-5))
        )
    assert_allclose(found.shaking, encoder_shaking(recipe, found.speed))


def test_holds_take_one_read_of_each_signal(measured, monkeypatch):
    """Of a thousand small files, opening and unpacking is most of the time."""
    seen, read = [], Recording.read_stored
    monkeypatch.setattr(
        Recording, "read_stored", lambda self, *part: seen.append(part[0]) or read(self, *part)
    )
    with open_run(measured[0]) as stored:
        recording = stored.recording("holds")
        _find_holds(recording, stored.recipe, Scale(Quantity(0.045, "N m/A", 1e-5)))
    assert len(seen) == len(set(seen)) >= 5


def test_a_note_states_why_holds_are_left_out():
    """Slow ones by the encoder's steps, one by what else shakes it; not known without the steps."""
    speed = np.outer([1, -1], [0.2, 0.3, 0.6, *np.geomspace(1, 30, 12)]).ravel()
    shaking = 0.1 / np.abs(speed)
    shaking[np.isclose(np.abs(speed), 0.6)] = 0.9
    torque, some = 2e-3 * np.sign(speed) + 5e-5 * speed, np.ones(len(speed))
    every = holds.Holds(speed, torque, 1e-5 * some, 9 * some, some, shaking, *[0 * some] * 3)
    _, kept, notes = fit_holds([every], 0.09 / np.abs(speed))
    assert np.abs(kept.speed).min() == 1
    assert len(notes) == 2
    assert "at 0.6 rad/s" in notes[0]
    assert "starts and stops" in notes[0]
    assert "at 0.2, 0.3 rad/s" in notes[1]
    assert "encoder's steps" in notes[1]
    (unknown,) = fit_holds([every])[2]
    assert "at 0.2, 0.3, 0.6 rad/s" in unknown
    slow = every[np.abs(speed) < 1.5]
    with pytest.raises(InsufficientDataError, match=r"starts and stops.*encoder's steps.*separate"):
        fit_holds([slow], 0.09 / np.abs(slow.speed))


def test_an_amplifier_that_is_a_little_off_is_in_the_uncertainty(folder, kt, measured):
    """6 mA, a tenth of what friction takes: less than is refused."""
    bent = ("virtual.amplifier.distortion=0.006", "virtual.amplifier.distortion_period=0.1")
    outcome = run(STRIBECK, RECIPE, folder / "bent.h5", *SHORT, *bent, kt=kt)
    shown = []
    for name, true in (("coulomb_friction", 2.3e-3), ("viscous_friction", 5.33e-5)):
        found = outcome.results[name]
        lines = {line.name: line.contribution for line in found.budget}
        assert lines["amplifier at low current"] > 0.01 * true
        shown.append(lines["amplifier at low current"])
        assert abs(found.value - true) < 3 * found.u
        sound = {line.name: line.contribution for line in measured[1].results[name].budget}
        assert sound.get("amplifier at low current", 0.0) < lines["amplifier at low current"] / 3
    # errors of this size at each speed of its own make such a slope
    assert shown[1] == pytest.approx(shown[0] / np.std(np.abs(outcome.tables["holds"]["speed"])))
