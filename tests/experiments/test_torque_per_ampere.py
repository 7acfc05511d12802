"""The conversion from set point to torque."""

import pytest

from rigtool.errors import RunFileError
from rigtool.experiments.torque_per_ampere import torque_per_ampere, with_constant
from rigtool.quantity import Quantity
from rigtool.runfile import RunWriter, open_run


def calibration(path, command="calibrate-kt", **more):
    results = {
        **more,
        "torque_constant_mean": Quantity(0.0454, "N m/A", 0.0454 * 3e-4, 12.0),
        "amplifier_gain": Quantity(1.02, "1", 1.02 * 4e-4),
    }
    with RunWriter(path, command=command, recipe=None, recipe_text=None) as writer:
        writer.finish(results, {})
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


def test_an_unknown_temperature_is_in_the_uncertainty_of_the_mean(tmp_path):
    """A rectangular distribution of this half-width (GUM 4.3.7) beside what was known before."""
    error = Quantity(9e-3, "1", 1e-4)
    with calibration(tmp_path / "kt.h5", torque_constant_constant_error=error) as kt:
        found = torque_per_ampere(kt)
    assert found.value == pytest.approx(0.0454 * 1.02, rel=1e-12)
    assert (found.u / found.value) ** 2 == pytest.approx(5e-4**2 + 9e-3**2 / 3, rel=1e-9)
    # Welch-Satterthwaite: a part of 3e-4 with 12 degrees of freedom among many
    assert found.dof == pytest.approx(12 * (found.u / found.value / 3e-4) ** 4, rel=1e-9)


def test_what_is_proportional_to_the_constant_shares_its_uncertainty():
    constant = Quantity(0.05, "N m/A", 0.05 * 4e-3)
    found = with_constant(Quantity(2.0, "N m", 2.0 * 3e-3, 10.0), constant)
    assert (found.value, found.unit) == (2.0, "N m")
    assert found.u == pytest.approx(2.0 * 5e-3, rel=1e-12)
    assert found.dof == pytest.approx(10 * (5 / 3) ** 4, rel=1e-12)
    bare = Quantity(2.0, "N m", reason="not repeated")
    assert with_constant(bare, constant) is bare


def test_only_a_calibration_has_a_constant(tmp_path):
    with (
        calibration(tmp_path / "other.h5", "stribeck") as run,
        pytest.raises(RunFileError, match="calibrate-kt"),
    ):
        torque_per_ampere(run)
