"""The conversion from set point to torque."""

import pytest

from rigtool.errors import RunFileError
from rigtool.experiments.torque_per_ampere import torque_per_ampere
from rigtool.quantity import Quantity
from rigtool.runfile import RunWriter, open_run


def calibration(path, command="calibrate-kt"):
    results = {
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


def test_only_a_calibration_tells(tmp_path):
    with (
        calibration(tmp_path / "other.h5", "stribeck") as run,
        pytest.raises(RunFileError, match="calibrate-kt"),
    ):
        torque_per_ampere(run)
