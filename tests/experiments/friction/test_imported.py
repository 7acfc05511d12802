"""`stribeck` on imported runs: holds with settling, any motion, linear axes, and public data."""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from rigtool.errors import InsufficientDataError, RunFileError
from rigtool.experiments.friction.imported import _stretches
from rigtool.experiments.friction.procedure import PROCEDURE as STRIBECK
from rigtool.experiments.running.options import CommonOptions
from rigtool.experiments.running.session import run_command
from rigtool.recipe.mapping import load_mapping
from rigtool.runfile import open_run
from rigtool.runfile.importers import import_files
from tests.experiments.imported_runs import crossed, take
from tests.thorough import thorough
from tests.unchanged import require_unchanged

ROOT = Path(__file__).parents[3]
FIXTURES = ROOT / "tests" / "fixtures"
DATA = ROOT / ".." / "shared" / "data"
DRIVE = DATA / "epos-stribeck" / "experiments" / "driveNo1" / "steady_state" / "0.096kg"
TOOL = DATA / "mis-tool" / "Tool_4_Maryland_L_4"
needs_data = pytest.mark.skipif(
    not DATA.is_dir(), reason="the public data sets are not beside the repository"
)

HELD = """mapping = 1
[rig]
name = "held"
[signals]
time = { column = "t", unit = "s" }
speed = { column = "v", unit = "rpm" }
torque = { column = "f", unit = "mN m" }
"""

MOVED = """mapping = 1
[rig]
name = "moved"
[signals]
time = { column = "t", unit = "s" }
position = { column = "x", unit = "rad" }
torque = { column = "f", unit = "N m" }
"""

LINEAR = MOVED.replace("[rig]", '[rig]\naxis = "linear"').replace('"rad"', '"m"')
LINEAR = LINEAR.replace("torque", "force").replace('"N m"', '"N"')


def analyse(sources, output, **inputs):
    return run_command(
        STRIBECK,
        [str(source) for source in sources],
        str(output),
        options=CommonOptions(overwrite=True),
        inputs=inputs,
    )


def friction(speed):
    """Torque against the motion, mN m, at a speed in rad/s."""
    return 2.0 + 0.05 * speed + 1.0 * np.exp(-((speed / 3) ** 2))


def hold(rpm, seed, settling):
    """A hold whose torque and speed start beside their mean and settle exponentially."""
    random = np.random.default_rng(seed)
    time = np.arange(500) * 0.01
    speed = rpm + 0.1 * random.normal(size=500) + settling * 0.2 * rpm * np.exp(-time / 0.2)
    sign = np.sign(rpm)
    torque = sign * friction(abs(rpm) * np.pi / 30) + 0.3 + 0.05 * random.normal(size=500)
    return {"t": time, "v": speed, "f": torque + settling * sign * 5 * np.exp(-time / 0.2)}


SPEEDS = (5, 10, 15, 20, 30, 40, 60, 80, 120, 160, 200)


def holds(settling):
    return {
        f"{'n' if sign < 0 else 'p'}{rpm}": hold(sign * rpm, 2 * rpm + sign, settling)
        for rpm in SPEEDS
        for sign in (1, -1)
    }


def moved(seed=0, sign=1.0):
    """A motion in all directions with known inertia and friction."""
    time = np.arange(0, 20, 1e-3)
    a, b = 2 * np.pi * 0.5, 2 * np.pi * 1.3
    position = 3 * np.sin(a * time + seed) + np.sin(b * time)
    speed = 3 * a * np.cos(a * time + seed) + b * np.cos(b * time)
    acceleration = -3 * a**2 * np.sin(a * time + seed) - b**2 * np.sin(b * time)
    torque = 0.02 * acceleration + 0.1 * speed + 2.0 * np.sign(speed) + 0.5
    return {"t": time, "x": position, "f": sign * torque}


@pytest.mark.parametrize("asked", [True, False])
@pytest.mark.parametrize("ways", [1, 2])
def test_a_staircase_of_speed_in_one_run(tmp_path, asked, ways):
    """By its set point, or by the speed itself; one way gives the curve of one direction."""
    random = np.random.default_rng(1)
    steps = np.repeat([5.0, 10.0, 20.0, 30.0, 40.0, 50.0], 500)
    steps = np.concatenate([steps, -steps])[: ways * len(steps)]
    speed = np.convolve(steps, np.ones(20) / 20, "same")
    torque = np.sign(speed) * (2 + 0.05 * np.abs(speed)) + 0.05 * random.normal(size=len(steps))
    text = HELD.replace('"rpm"', '"rad/s"')
    if asked:
        text += 'speed_setpoint = { column = "w", unit = "rad/s" }\n'
    arrays = {"t": np.arange(len(steps)) * 0.01, "v": speed, "f": torque, "w": steps}
    outcome = analyse(take(tmp_path, text, {"a": arrays}), tmp_path / "f.h5")
    assert outcome.tables["holds"].shape == (6 * ways,)
    for name, expected in (("coulomb_friction", 2e-3), ("viscous_friction", 5e-5)):
        found = outcome.results[f"{name}_positive"]
        assert found.value == pytest.approx(expected, rel=0.02, abs=0)
    assert ("viscous_friction_negative" in outcome.results) == (ways == 2)
    require_unchanged(f"speeds-{asked}-{ways}", outcome)


def test_strokes_at_other_speeds_in_each_direction_give_offset_and_inertia(tmp_path):
    """No speed was held both ways; friction differs by direction, and gravity acts."""
    random = np.random.default_rng(2)
    levels = random.uniform(0.05, 0.5, 30) * np.where(np.arange(30) % 2, 1.0, -1.0)
    speed = np.convolve(np.repeat(levels, 800), np.hanning(200) / np.hanning(200).sum(), "same")
    position = np.cumsum(speed) * 1e-3
    force = 12 * np.gradient(speed, 1e-3) + 150 * speed + 40 * np.abs(speed)
    force += 20 * np.sign(speed) + 5 + random.normal(0, 0.3, len(speed))
    arrays = {"t": np.arange(len(speed)) * 1e-3, "x": position, "f": force}
    outcome = analyse(take(tmp_path, LINEAR, {"a": arrays}), tmp_path / "f.h5")
    assert "holds" in outcome.tables
    for name, expected, within in (
        ("inertia", 12, 0.01),
        ("friction_offset", 5, 0.1),
        ("coulomb_friction", 20, 0.01),
        ("viscous_friction_positive", 190, 0.02),
        ("viscous_friction_negative", 110, 0.02),
    ):
        found = outcome.results[name]
        assert found.value == pytest.approx(expected, rel=within, abs=0), name
        assert abs(found.value - expected) < 3 * found.u, name
    require_unchanged("imported-strokes", outcome)


@pytest.mark.parametrize("settling", [1, *thorough(0)])
def test_holds_in_both_directions_with_settling_left_out(tmp_path, settling):
    outcome = analyse(take(tmp_path, HELD, holds(settling)), tmp_path / "f.h5")
    table = outcome.tables["holds"]
    assert np.count_nonzero(table["speed"] > 0) == np.count_nonzero(table["speed"] < 0) == 11
    expected = np.sign(table["speed"]) * friction(np.abs(table["speed"])) * 1e-3 + 0.3e-3
    np.testing.assert_allclose(table["torque"], expected, rtol=0, atol=0.02e-3)
    assert outcome.results["coulomb_friction"].value == pytest.approx(2e-3, rel=0.02, abs=0)
    assert outcome.results["viscous_friction"].value == pytest.approx(5e-5, rel=0.03, abs=0)
    assert outcome.results["friction_offset"].value == pytest.approx(0.3e-3, rel=0.06, abs=0)
    if settling:
        assert np.all((table["settled"] > 0.4) & (table["settled"] < 2))
        assert any("settling was left out at the start of 22 of 22" in n for n in outcome.notes)
    with open_run(tmp_path / "f.h5") as run:
        assert (run.command, run.rig) == ("stribeck", "held")


@pytest.mark.parametrize(("text", "unit"), [(MOVED, "N m"), (LINEAR, "N")])
def test_any_motion_gives_inertia_and_friction(tmp_path, text, unit):
    paths = take(tmp_path, text, {"a": moved(), "b": moved(1)})
    outcome = analyse(paths, tmp_path / "f.h5")
    require_unchanged(f"imported-motion-{len(unit)}", outcome)
    results = outcome.results
    units = {
        "inertia": ("kg m2", "kg"),
        "viscous_friction": ("N m s/rad", "N s/m"),
        "coulomb_friction": ("N m", "N"),
        "friction_offset": ("N m", "N"),
    }
    for (name, of), value in zip(units.items(), (0.02, 0.1, 2.0, 0.5), strict=True):
        assert results[name].value == pytest.approx(value, rel=0.01, abs=0)
        assert results[name].unit == of[unit == "N"]
        assert results[name].u > 0


def test_a_spring_is_not_taken_for_inertia(tmp_path):
    arrays = moved()
    arrays["x"] = 3 * np.sin(2 * np.pi * 0.5 * arrays["t"])
    speed = np.gradient(arrays["x"], arrays["t"])
    noise = 1e-3 * np.random.default_rng(1).standard_normal(len(speed))
    arrays["f"] = 1.0 * arrays["x"] + 0.1 * speed + 2.0 * np.sign(speed) + noise
    outcome = analyse(take(tmp_path, MOVED, {"a": arrays}), tmp_path / "f.h5")
    assert "inertia" not in outcome.results
    assert any("a spring acts" in note for note in outcome.notes)
    require_unchanged("imported-spring", outcome)
    assert outcome.results["coulomb_friction"].value == pytest.approx(2.0, rel=0.02, abs=0)


def test_runs_that_do_not_go_together(tmp_path):
    signals = moved()
    held = {"t": signals["t"], "x": 3 * signals["t"], "f": np.full(len(signals["t"]), 1.0)}
    paths = take(tmp_path, MOVED, {"moved": signals, "held": held})
    both = analyse(paths, tmp_path / "f.h5")
    assert any("1 of 2 recordings hold constant speeds" in note for note in both.notes)
    with pytest.raises(InsufficientDataError, match=r"one speed, .* does not separate"):
        analyse(paths[1:], tmp_path / "g.h5")


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_set_points_that_hold_speeds_in_one_direction_are_holds(direction):
    time = 0.01 * np.arange(3000)
    held = direction * np.interp(time, [0, 10, 20, 30], [0, 10, 30, 70])
    swung = direction * np.sin(time)
    for setpoint, stretches in ((held, [(0, len(time))]), (swung, [])):
        channels = {"time": time, "position": setpoint, "position_setpoint": setpoint}
        recording = SimpleNamespace(has=channels.__contains__, read=channels.__getitem__)
        assert _stretches(recording) == stretches


def test_wrong_signs_are_reported(tmp_path):
    paths = take(tmp_path, HELD.replace('"mN m" }', '"mN m", sign = -1 }'), holds(0))
    with pytest.raises(InsufficientDataError, match="signs of current and encoder"):
        analyse(paths, tmp_path / "f.h5")


def test_a_position_is_needed(tmp_path):
    text = MOVED.replace('position = { column = "x", unit = "rad" }', "")
    paths = take(tmp_path, text, {"a": moved()})
    with pytest.raises(RunFileError, match="the position is unknown"):
        analyse(paths, tmp_path / "f.h5")


@needs_data
def test_the_drive_of_the_epos_set(tmp_path):
    mapping = load_mapping(ROOT / "recipes" / "import" / "epos-stribeck.toml")
    import_files([str(DRIVE)], str(tmp_path / "runs"), mapping)
    outcome = analyse(sorted((tmp_path / "runs").iterdir()), tmp_path / "f.h5")
    table = outcome.tables["holds"]
    assert np.count_nonzero(table["speed"] > 0) == np.count_nonzero(table["speed"] < 0) == 16
    results = outcome.results
    # Friction falls from the lowest speed to a minimum and rises again, in both directions.
    for sign in ("positive", "negative"):
        static, coulomb = (
            results[f"{name}_{sign}"].value
            for name in ("stribeck_static_friction", "coulomb_friction")
        )
        assert static > 1.1 * coulomb
        assert results[f"viscous_friction_{sign}"].value > 0
    # Without a mapping torque is relative to the rated one, 9.84 mN m, and all else the same.
    import_files([str(DRIVE)], str(tmp_path / "bare"), None)
    bare = analyse(sorted((tmp_path / "bare").iterdir()), tmp_path / "b.h5").results
    for name in ("coulomb_friction", "viscous_friction_negative"):
        assert bare[name].value * 9.84e-3 == pytest.approx(results[name].value, rel=1e-6, abs=0)
    assert (bare["coulomb_friction"].unit, bare["viscous_friction"].unit) == ("1", "s/rad")
    # 0.096 kg on a screw of 2 mm lead: m g lead / (2 pi), were there no friction.
    weight = 0.096 * 9.81 * 2e-3 / (2 * np.pi)
    offset = results["friction_offset"]
    # Its friction differs between the directions, and looks like an offset.
    assert offset.u < abs(offset.value - weight) < results["coulomb_friction_positive"].u
    assert 0 < table["settled"].max() < 0.5 * 63.9


@needs_data
def test_the_tools_of_the_mis_tool_set_move_both_ways(tmp_path):
    mapping = load_mapping(ROOT / "recipes" / "import" / "mis-tool.toml")
    sources = [str(TOOL / f"{frequency}0.TXT.gz") for frequency in range(5)]
    import_files(sources, str(tmp_path / "runs"), mapping)
    outcome = analyse(sorted((tmp_path / "runs").iterdir()), tmp_path / "f.h5")
    coulomb = outcome.results["coulomb_friction"]
    assert coulomb.unit == "A"
    assert coulomb.value > 5 * coulomb.u


def test_holds_in_which_the_shaft_starts_and_stops_are_left_out_as_at_the_bench(tmp_path):
    """Torque that makes a shaft of this inertia stop and start; unknown without the inertia."""
    random, steps = np.random.default_rng(2), (1.0, 5.0, 10.0, 20.0, 40.0, 80.0)
    arrays = {"t": np.arange(len(steps) * 2000) * 1e-3, "v": np.repeat(steps, 2000)}
    arrays["f"] = 2 + 0.05 * arrays["v"] + 0.05 * random.normal(size=len(arrays["t"]))
    slow = arrays["v"] == 1.0
    arrays["f"] += slow * np.sign(np.sin(2 * np.pi * 40 * arrays["t"]))
    text = HELD.replace('"rpm"', '"rad/s"')
    known = text.replace('"held"', '"held"\ninertia = 2e-6')
    cases = (("a", text, "inertia or torque is not known"), ("b", known, "starts and stops"))
    for name, mapping, said in cases:
        (tmp_path / name).mkdir()
        outcome = analyse(take(tmp_path / name, mapping, {"a": arrays}), tmp_path / "f.h5")
        assert any(said in note for note in outcome.notes), "\n".join(outcome.notes)
    assert outcome.tables["holds"].shape == (5,)


CROSSED = """mapping = 1
[rig]
name = "the bench"
encoder_counts = 4000
inertia = 1.503e-5
[signals]
time = { column = "time [s]", unit = "s" }
current = { column = "current_setpoint [A]", unit = "A" }
encoder = { column = "encoder [count]", unit = "count" }
"""
ASKED = 'position_setpoint = { column = "position_setpoint [rad]", unit = "rad" }\n'


@pytest.mark.parametrize(("text", "within"), [(CROSSED + ASKED, 1e-3), (CROSSED, 1.0)])
def test_holds_of_the_bench_are_the_same_as_an_import(tmp_path, text, within):
    """By the set point to the digits of a CSV, without it within u."""
    stored = json.loads((FIXTURES / "references.json").read_text())["friction"]
    paths = crossed(tmp_path, FIXTURES / "friction.h5", ["holds"], text)
    with open_run(FIXTURES / "kt.h5") as kt:
        found = analyse(paths, tmp_path / "friction.h5", kt=kt).results
    for name in ("coulomb_friction", "viscous_friction"):
        assert abs(found[name].value - stored[name]["value"]) < within * stored[name]["u"]
        assert found[name].u == pytest.approx(stored[name]["u"], rel=0.1, abs=0)
    assert abs(found["friction_offset"].value - stored["friction_offset"]["value"]) < (
        3 * found["friction_offset"].u
    )
