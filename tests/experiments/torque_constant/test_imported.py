"""`calibrate-kt` on imported runs, and its result as --kt of another command."""

import json
import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from rigtool.errors import RunFileError
from rigtool.experiments.running.options import CommonOptions
from rigtool.experiments.running.session import run_command
from rigtool.experiments.torque_constant import imported
from rigtool.experiments.torque_constant.current_points import Course
from rigtool.experiments.torque_constant.imported import _median_duration, _plateaus, _results
from rigtool.experiments.torque_constant.procedure import PROCEDURE
from rigtool.experiments.torque_per_ampere import torque_per_ampere
from rigtool.recipe.commands import CalibrateKt
from rigtool.runfile import open_run
from tests.experiments.imported_runs import crossed, take
from tests.experiments.torque_constant.test_current_levels import draw
from tests.unchanged import require_unchanged

TEXT = """mapping = 1
[rig]
name = "bench of others"
arm_length = 0.5
reference_relative_u = 0.002
[signals]
time = { column = "t", unit = "s" }
current = { column = "i", unit = "A" }
temperature = { column = "degc", unit = "degC" }
force = { column = "f", unit = "N" }
"""


FIXTURES = Path(__file__).parents[2] / "fixtures"


def calibrate(paths, output):
    options = CommonOptions(overwrite=True)
    return run_command(PROCEDURE, paths, str(output), options=options, inputs={})


def test_a_force_on_an_arm_gives_a_constant_for_other_commands(tmp_path):
    (constant, change), recorded = draw("staircase", 5)
    arrays = {"t": recorded.time, "i": recorded.current, "f": recorded.torque / 0.5}
    paths = take(tmp_path, TEXT, {"a": {**arrays, "degc": recorded.temperature}})
    outcome = calibrate(paths, tmp_path / "kt.h5")
    found = outcome.results["torque_constant"]
    assert abs(found.value - constant) < 2.5 * found.u
    coefficient = outcome.results["torque_constant_temperature_coefficient"]
    assert abs(coefficient.value - change) < 2.5 * coefficient.u
    assert outcome.results["torque_constant_mean"].u > 0.002 * constant
    assert outcome.results["hysteresis_torque"].value > 0
    assert outcome.tables["calibration_points"].shape == (15,)
    require_unchanged("imported-kt-arm", outcome)
    with open_run(tmp_path / "kt.h5") as run:
        mean = torque_per_ampere(run)
    assert mean.value == outcome.results["torque_constant_mean"].value


def test_the_time_of_a_plateau_is_that_of_most():
    setpoint = np.repeat([0.0, 1.0, 2.0, 1.0], [5, 3, 3, 4])
    assert _median_duration(0.5 * np.arange(15), setpoint) == pytest.approx(3.5 * 0.5)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("offset", [0.01, -0.01])
def test_currents_below_zero_are_turned_over(monkeypatch, sign, offset):
    """So that a staircase rises first, whatever the sign of its current."""
    level = np.repeat([0.0, 1.0, 2.0, 1.0, 0.0], 50)
    signals = {"current_setpoint": sign * level, "force": sign * 0.1 * level}
    recording = SimpleNamespace(
        has=signals.__contains__,
        read=signals.__getitem__,
        conditions={"arm_length": 0.5},
        condition=lambda name: 0.5,
    )
    given = {}
    monkeypatch.setattr(imported, "plateaus_of_set_point", lambda **kwargs: given.update(kwargs))
    course = Course(0.1 * np.arange(250), sign * level + offset, sign * 0.05 * level)
    _plateaus(recording, course, by_setpoint=True)
    np.testing.assert_array_equal(given["current_setpoint"], level)
    np.testing.assert_allclose(given["force"], 0.1 * level)
    np.testing.assert_allclose(given["current"], level + sign * offset)
    assert given["arm_length"] == 0.5
    # the part of a plateau that settles is that of the bench
    bench = CalibrateKt()
    expected = bench.settle_time / bench.step_time * 5.0
    assert given["settle_time"] == pytest.approx(expected)


def test_results_have_the_lines_of_fit_curvature_and_sensor():
    fit = SimpleNamespace(
        constant=0.05,
        constant_u=1e-4,
        dof=9.0,
        curvature_u=3e-3,
        reference=(0.051, 2e-4),
        coefficient=(-1e-3, 2e-4),
        hysteresis=(4e-3, 1e-4),
    )
    found = _results(fit, 2e-3, np.array([20.0, 24.0, 30.0]))
    for name, value, u in (
        ("torque_constant_mean", 0.05, 1e-4),
        ("torque_constant", 0.051, 2e-4),
    ):
        expected = math.hypot(u, value * 3e-3, value * 2e-3)
        assert (found[name].value, found[name].u) == pytest.approx((value, expected), rel=1e-9)
        assert found[name].dof == pytest.approx(9 * (expected / u) ** 4, rel=1e-9)
    # over half the range of temperatures
    error = found["torque_constant_constant_error"]
    assert (error.value, error.u, error.dof) == pytest.approx((5e-3, 1e-3, 9), rel=1e-9)
    change = found["torque_constant_temperature_coefficient"]
    assert (change.value, change.u, change.dof) == (-1e-3, 2e-4, 9)
    assert (found["hysteresis_torque"].value, found["hysteresis_torque"].u) == (4e-3, 1e-4)
    fit.reference = fit.coefficient = fit.hysteresis = None
    assert list(_results(fit, 2e-3, np.full(3, 25.0))) == ["torque_constant_mean"]


def test_a_run_without_a_sensor_is_refused(tmp_path):
    _, recorded = draw("staircase", 5)
    text = "\n".join(
        line for line in TEXT.splitlines() if "force" not in line and "degC" not in line
    )
    paths = take(tmp_path, text, {"a": {"t": recorded.time, "i": recorded.current}})
    with pytest.raises(RunFileError, match="no torque of a sensor"):
        calibrate(paths, tmp_path / "kt.h5")
    assert not (tmp_path / "kt.h5").exists()


CROSSED = """mapping = 1
[rig]
name = "the bench"
arm_length = 0.54
reference_relative_u = 5e-4
[signals]
time = { column = "time [s]", unit = "s" }
current = { column = "current [A]", unit = "A" }
force = { column = "force [N]", unit = "N" }
temperature = { column = "temperature [degC]", unit = "degC" }
"""
ANGLE = 'rotor_angle = { column = "rotor_angle [rad]", unit = "rad" }\n'


def test_a_run_of_the_bench_gives_the_same_without_its_set_point(tmp_path):
    """Its settling is another part of each plateau; the rest is one analysis."""
    stored = json.loads((FIXTURES / "references.json").read_text())["kt"]
    (path,) = crossed(tmp_path, FIXTURES / "kt.h5", ["staircase"], CROSSED + ANGLE)
    found = calibrate([path], tmp_path / "kt.h5").results
    for name in ("torque_constant", "torque_constant_mean"):
        assert found[name].value == pytest.approx(stored[name]["value"], rel=2e-4, abs=0)
        assert found[name].u < 1.5 * stored[name]["u"]
    (gauge,) = (one for one in found["torque_constant_mean"].budget if "gauge cal" in one.name)
    assert gauge.u == 5e-4
    name = "torque_constant_temperature_coefficient"
    assert abs(found[name].value - stored[name]["value"]) < 2 * stored[name]["u"]
    assert found[name].u < 1.5 * stored[name]["u"]
    assert not any(name.startswith("amplifier") for name in found)


def test_a_single_staircase_has_usual_sizes_for_what_it_does_not_show(tmp_path):
    _, recorded = draw("staircase", 5)
    arrays = {"t": recorded.time, "i": recorded.current, "f": recorded.torque / 0.5}
    paths = take(tmp_path, TEXT, {"a": {**arrays, "degc": recorded.temperature}})
    notes = " ".join(calibrate(paths, tmp_path / "kt.h5").notes)
    assert "1 staircase does not show heat" in notes


def test_repeated_staircases_of_a_turning_shaft_are_not_those_of_a_bench(tmp_path):
    _, recorded = draw("staircase", 5)
    arrays = {"t": recorded.time, "i": recorded.current, "f": recorded.torque / 0.5}
    arrays |= {"degc": recorded.temperature, "v": np.full(len(recorded.time), 30.0)}
    again = arrays | {"f": arrays["f"] + np.random.default_rng(6).normal(0, 1e-5, len(arrays["f"]))}
    text = TEXT + 'speed = { column = "v", unit = "rad/s" }\n'
    paths = take(tmp_path, text, {"a": arrays, "b": again})
    outcome = calibrate(paths, tmp_path / "kt.h5")
    assert "the shaft turns" in " ".join(outcome.notes)
    assert "calibration_points" in outcome.tables
    require_unchanged("imported-kt-turning", outcome)


@pytest.mark.parametrize("sign", [1, -1])
def test_staircases_without_temperature_state_none(tmp_path, sign):
    """Of either sign; a set point that does not move is left aside."""
    current = np.repeat([0, 1, 2, 3, 4, 3, 2, 1, 0], 40) * sign
    files = {}
    for name, seed in (("a", 1), ("b", 2)):
        random = np.random.default_rng(seed)
        force = current * 0.1 + random.normal(0, 4e-4, len(current))
        read = current + random.normal(0, 2e-3, len(current))
        files[name] = {"t": np.arange(len(current)) * 0.05, "i": read, "f": force, "s": 0 * read}
    text = "\n".join(line for line in TEXT.splitlines() if "degC" not in line)
    text += '\ncurrent_setpoint = { column = "s", unit = "A" }\n'
    outcome = calibrate(take(tmp_path, text, files), tmp_path / "kt.h5")
    found = outcome.results["torque_constant_mean"]
    assert abs(found.value - 0.05) < 2.5 * found.u
    assert found.u < 0.02 * found.value
    assert set(outcome.tables) == {"hysteresis"}
    require_unchanged(f"imported-kt-{sign}", outcome)
    notes = " ".join(outcome.notes)
    assert "temperature was not recorded" in notes
    assert "by their set point: the current set point is 0 A throughout" in notes
