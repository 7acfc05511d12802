"""The conversion from set point to torque."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import truncnorm

from rigtool.errors import RunFileError
from rigtool.experiments.torque_per_ampere import (
    END_SAMPLES,
    effort_of,
    mean_constant,
    mean_temperature,
    torque_per_ampere,
    torque_per_ampere_at,
    warmed,
    with_constant,
)
from rigtool.quantity import Quantity, combined, error_line
from rigtool.runfile import Channel, RecordingSpec, RunWriter, open_run
from rigtool.runfile.schema import CHUNK


def calibration(path, command="calibrate-kt", **more):
    results = {
        "torque_constant_mean": Quantity(0.0454, "N m/A", 0.0454 * 3e-4, 12.0),
        "amplifier_gain": Quantity(1.02, "1", 1.02 * 4e-4),
        **more,
    }
    with RunWriter(path, command=command) as writer:
        writer.finish({name: r for name, r in results.items() if r is not None}, {})
    return open_run(path)


def test_an_amplifier_that_delivers_more_makes_more_torque(tmp_path):
    with calibration(tmp_path / "kt.h5") as kt:
        found = torque_per_ampere(kt)
    assert found.value == pytest.approx(0.0454 * 1.02, rel=1e-12)
    assert found.u == pytest.approx(found.value * 5e-4, rel=1e-12)  # 3-4-5
    assert found.unit == "N m/A"


def test_a_measured_current_does_not_pass_the_amplifier(tmp_path):
    with calibration(tmp_path / "kt.h5") as kt:
        found = torque_per_ampere(kt, of_measured_current=True)
    assert (found.value, found.dof) == (0.0454, 12.0)
    assert found.u == pytest.approx(0.0454 * 3e-4, rel=1e-12)


def test_without_an_amplifier_the_constant_is_all(tmp_path):
    with calibration(tmp_path / "kt.h5", amplifier_gain=None) as kt:
        found = torque_per_ampere(kt)
    assert found.value == 0.0454
    assert found.u == pytest.approx(0.0454 * 3e-4, rel=1e-12)


def test_an_unknown_temperature_is_in_the_uncertainty_of_the_mean(tmp_path):
    """A rectangular distribution of this half-width (GUM 4.3.7) beside what was known before."""
    error = Quantity(9e-3, "1", 1e-4)
    with calibration(tmp_path / "kt.h5", torque_constant_constant_error=error) as kt:
        found = torque_per_ampere(kt)
    assert found.value == pytest.approx(0.0454 * 1.02, rel=1e-12)
    assert (found.u / found.value) ** 2 == pytest.approx(5e-4**2 + 9e-3**2 / 3, rel=1e-9)
    # Welch-Satterthwaite: a part of 3e-4 with 12 degrees of freedom among many
    assert found.dof == pytest.approx(12 * (found.u / found.value / 3e-4) ** 4, rel=1e-9)


@pytest.mark.parametrize(("degc", "away"), [(45.0, 0.0204), (27.0, None), (5.0, 0.0264)])
def test_a_motor_outside_the_range_of_the_mean_is_in_u_and_in_a_note(tmp_path, degc, away):
    slope = -1.16e-3
    mean = Quantity(0.0458 * (1 + 7.5 * slope), "N m/A", 1e-5, 12.0)
    results = {
        "torque_constant": Quantity(0.0458, "N m/A", 1e-5),
        "torque_constant_temperature_coefficient": Quantity(slope, "1/K", 1e-6),
        "torque_constant_mean": mean,
        "torque_constant_constant_error": Quantity(0.0088, "1", 1e-5),
        "amplifier_gain": Quantity(1.0, "1", 0.0),
    }
    time = np.arange(5000) / 100
    channels = (Channel("time", "s", "f8", ""), Channel("temperature", "degC", "f4", ""))
    spec = RecordingSpec("holds", channels)
    with RunWriter(tmp_path / "run.h5", command="stribeck", recordings=[spec]) as writer:
        # at the end only: the motor warmed up
        warm = np.linspace(27.5, degc, 5000)
        warm[:10] = np.nan  # as before the first reading of a thermometer
        warm[10:20] = 1e29  # a thermometer's own mark of an open sensor
        writer.append("holds", {"time": time, "temperature": warm})
        writer.finish({}, {})
    with open_run(tmp_path / "run.h5") as run, calibration(tmp_path / "kt.h5", **results) as kt:
        recorded = [run.recording("holds")]
        found, note = mean_constant(kt, recorded)
        assert mean_temperature(recorded) == pytest.approx((27.5 + degc) / 2, abs=0.1)
        assert found == torque_per_ampere(kt, recorded)
        usual = torque_per_ampere(kt)
    assert found.value == usual.value
    if away is None:
        assert found.u == usual.u
        assert "degC" not in note
    else:
        assert found.u == pytest.approx(found.value * away / np.sqrt(3), rel=0.01)
        assert f"had {degc:.3g} degC" in note
        assert f"too {'high' if degc > 27 else 'low'}" in note
        assert f"let the motor {'cool' if degc > 27 else 'warm up'}" in note


def test_what_is_proportional_to_the_constant_shares_its_uncertainty():
    constant = Quantity(0.05, "N m/A", 0.05 * 4e-3)
    found = with_constant(Quantity(2.0, "N m", 2.0 * 3e-3, 10.0), constant)
    assert (found.value, found.unit) == (2.0, "N m")
    assert found.u == pytest.approx(2.0 * 5e-3, rel=1e-12)
    assert found.dof == pytest.approx(10 * (5 / 3) ** 4, rel=1e-12)
    bare = Quantity(2.0, "N m", reason="not repeated")
    assert with_constant(bare, constant) is bare


def test_at_a_temperature_it_is_the_line_with_the_budget_of_its_derivatives(tmp_path):
    given = {"constant": (0.0458, 2e-5), "slope": (-1.2e-3, 4e-5), "gain": (1.25, 3e-4)}
    results = {
        "torque_constant": Quantity(0.0458, "N m/A", 2e-5),
        "torque_constant_temperature_coefficient": Quantity(-1.2e-3, "1/K", 4e-5),
        "amplifier_gain": Quantity(1.25, "1", 3e-4),
    }

    def line(constant, slope, gain):
        return constant * (1 + slope * (45.0 - 20.0)) * gain

    values = {name: value for name, (value, _) in given.items()}
    moved = [
        line(**values | {name: value + u}) - line(**values) for name, (value, u) in given.items()
    ]
    with calibration(tmp_path / "kt.h5", **results) as kt:
        found = torque_per_ampere_at(kt, 45.0)
    assert found.value == pytest.approx(line(**values), rel=1e-12)
    assert [each.contribution for each in found.budget] == pytest.approx(np.abs(moved), rel=1e-6)
    with calibration(tmp_path / "one.h5") as kt:  # without a slope
        assert torque_per_ampere_at(kt, 45.0) == torque_per_ampere(kt)


def test_currents_warm_the_winding_by_a_part_that_is_unknown(tmp_path):
    constant = combined(0.045, "N m/A", [error_line("torque constant", 9e-6, "N m/A")])
    loss = Quantity(1e-3, "1/A2", 1e-4)
    with calibration(tmp_path / "kt.h5", winding_heat_loss=loss) as kt:
        found = warmed(constant, kt, 0.8, least=0.5)
    # From 0.4 to 0.8 A2 of 1e-3/A2: 0.6 in the middle, evenly distributed
    assert found.value == pytest.approx(0.045 * (1 - 0.6e-3), rel=1e-12)
    own, heat = (line.contribution for line in found.budget)
    assert own == pytest.approx(9e-6 * (1 - 0.6e-3), rel=1e-12)
    assert heat == pytest.approx(0.045 * np.hypot(0.2e-3 / np.sqrt(3), 0.6 * 1e-4), rel=1e-12)
    with calibration(tmp_path / "cold.h5") as kt:
        assert warmed(constant, kt, 0.8) is constant


@pytest.mark.parametrize("ratio", [-12.0, -1.5, 0.0, 0.8, 3.0])
def test_of_a_loss_that_noise_hides_the_positive_part_counts(tmp_path, ratio):
    constant = combined(0.045, "N m/A", [error_line("torque constant", 9e-6, "N m/A")])
    loss = Quantity(ratio * 2e-4, "1/A2", 2e-4)
    with calibration(tmp_path / "kt.h5", winding_heat_loss=loss) as kt:
        found = warmed(constant, kt, 0.8, least=1.0)
    part = truncnorm(-max(ratio, -8.0), np.inf, max(ratio, -8.0), 1.0)
    assert 1 - found.value / 0.045 == pytest.approx(0.8 * 2e-4 * part.mean(), rel=1e-6)
    assert found.budget[1].contribution == pytest.approx(0.045 * 0.8 * 2e-4 * part.std(), rel=1e-6)
    certain = Quantity(-1e-4, "1/A2", 0.0)
    with calibration(tmp_path / "no.h5", winding_heat_loss=certain) as kt:
        assert warmed(constant, kt, 0.8).value == constant.value


class Imported:
    """Signals of two samples and conditions, as a recording has them."""

    path, name, size = "a.h5", "imported", 2

    def __init__(self, *signals, **conditions):
        self.signals = {name: np.array([1.0, 2.0]) * (n + 1) for n, name in enumerate(signals)}
        self.conditions = conditions

    def has(self, name):
        return name in self.signals

    def read(self, name):
        return self.signals[name]

    def condition(self, name):
        return self.conditions[name]


@pytest.mark.parametrize(
    ("signals", "conditions", "unit", "name", "first", "relative_u"),
    [
        (("torque", "current"), {}, "N m", "torque", 1.0, None),
        (("force", "current"), {"linear_axis": 1.0}, "N", "force", 1.0, None),
        (("relative_torque",), {}, "1", "relative_torque", 1.0, 0.0),
        (("relative_torque", "current"), {}, "A", "current", 2.0, 0.0),
        (("current_setpoint",), {}, "A", "current", 1.0, 0.0),
        (("current_setpoint", "current"), {}, "A", "current", 2.0, 0.0),
        (("current",), {"torque_constant": 0.05}, "N m", "torque", 0.05, None),
        (
            ("current",),
            {"torque_constant": 0.05, "torque_constant_u": 1e-3},
            *("N m", "torque", 0.05, 0.02),
        ),
        (("current",), {"torque_constant": 0.05, "linear_axis": 1.0}, "A", "current", 1.0, 0.0),
    ],
)
def test_an_effort_is_torque_where_a_constant_is_known(
    signals, conditions, unit, name, first, relative_u
):
    found = effort_of(Imported(*signals, **conditions), None)
    assert (found.unit, found.name) == (unit, name)
    np.testing.assert_allclose(found.values, [first, 2 * first], rtol=1e-12)
    assert found.relative_u == (None if relative_u is None else pytest.approx(relative_u))


def test_a_constant_that_is_given_counts_before_the_torque_of_a_drive(tmp_path):
    with calibration(tmp_path / "kt.h5") as kt:
        measured = effort_of(Imported("torque", "current"), kt)
        asked = effort_of(Imported("torque", "current_setpoint"), kt)
        alone = effort_of(Imported("torque"), kt)
    assert measured.values[0] == pytest.approx(2 * 0.0454, rel=1e-12)
    assert measured.relative_u == pytest.approx(3e-4, rel=1e-9)
    assert asked.values[0] == pytest.approx(2 * 0.0454 * 1.02, rel=1e-12)
    assert asked.relative_u == pytest.approx(5e-4, rel=1e-9)
    assert alone.values[0] == 1.0


def test_a_recording_without_a_thermometer_has_no_temperature():
    assert np.isnan(mean_temperature([Imported("current")]))


def test_only_a_calibration_has_a_constant(tmp_path):
    with (
        calibration(tmp_path / "other.h5", "stribeck") as run,
        pytest.raises(RunFileError, match="calibrate-kt"),
    ):
        torque_per_ampere(run)


@pytest.mark.parametrize("size", [600, CHUNK, CHUNK + 1, 3 * CHUNK])
def test_ends_are_the_first_and_the_last_samples_of_any_recording(size):
    degc = np.arange(float(size))

    def blocks(name, *, start, stop, finite):
        return [(part,) for part in np.array_split(degc[start:stop], 3)]

    recording = SimpleNamespace(size=size, has=lambda name: True, blocks=blocks)
    count = min(size, END_SAMPLES)
    expected = degc[:count].mean(), degc[-count:].mean()
    assert mean_temperature([recording]) == pytest.approx(np.mean(expected))
