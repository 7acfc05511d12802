"""What a calibration states in words, and what its amplifier's results are uncertain by."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from rigtool.experiments.torque_constant.results import (
    FAR_OFF,
    _extrapolation,
    _notes,
    _results,
    _tables,
)
from rigtool.quantity import CURRENT_READING, Quantity, combined, error_line

LOSS = combined(
    2e-4, "1/A2", [error_line("scatter", 1e-5, "1/A2", 5.0), error_line("path", 2e-5, "1/A2")]
)
"""A loss by heat with a line that has degrees of freedom and one that has none."""


def calibration(**changes):
    made = {
        "mean": Quantity(0.045, "N m/A", 1e-5),
        "components": {"arm length": 1e-3, "scatter": 0.0, "ripple": 2.34e-3, "gauge": 1e-18},
        "slopes": SimpleNamespace(heating=0.0123, time_constant=29.04),
        "coefficient": Quantity(-1e-3, "1/K", 1e-5),
        "temperature": np.array([25.0, 48.0]),
        "rotor_angles": 8,
    }
    return SimpleNamespace(**(made | changes))


def notes(nominal=0.045, range_degc=(25.0, 35.0), known=True, **changes):
    return _notes(calibration(**changes), nominal, range_degc, temperature_known=known)


def test_the_largest_part_of_the_uncertainty_comes_first():
    budget, heat, *_ = notes()
    assert budget == "standard uncertainty of torque_constant_mean: ripple 0.23 %, arm length 0.1 %"
    assert "by 1.2 % within the staircases (time constant 29 s)" in heat


@pytest.mark.parametrize("part", [FAR_OFF, 1 / FAR_OFF])
@pytest.mark.parametrize(("beyond", "said"), [(1.01, True), (0.99, False)])
def test_a_constant_far_from_the_data_sheet_is_noted(part, beyond, said):
    nominal = 0.045 / (part * beyond if part > 1 else part / beyond)
    found = notes(nominal)
    assert found[0].startswith("the measured constant is ") == said
    if said:
        assert f"is {0.045 / nominal:.3g} times the data sheet's" in found[0]
    assert "data sheet" not in " ".join(notes(None))


@pytest.mark.parametrize(
    ("range_degc", "listed"),
    [
        ((23.1, 49.9), "20"),
        ((22.9, 50.0), "20, 22.9"),
        ((20.0, 50.1), "20, 50.1"),
        ((30.0, 35.0), "20"),
    ],
)
def test_temperatures_beyond_those_measured_by_two_kelvin_are_extrapolated(range_degc, listed):
    (note,) = _extrapolation(calibration(), range_degc)
    assert note == f"extrapolated to {listed} degC from 25 to 48 degC along the line"
    warm = calibration(temperature=np.array([21.9, 48.0]))
    assert _extrapolation(warm, (30.0, 35.0)) == []


def test_few_angles_and_unknown_temperatures_are_noted():
    for angles, words in ((0, "unknown angles"), (1, "one rotor angle"), (2, "2 rotor angles")):
        assert notes(rotor_angles=angles)[-1].startswith(f"measured at {words}: ")
    assert "measured at" not in " ".join(notes(rotor_angles=3))
    assert "the temperature was not recorded" in " ".join(notes(known=False))
    one = notes(coefficient=None)
    assert "all staircases are within 2 K of 25 degC" in " ".join(one)


def test_each_result_has_a_budget_of_its_own():
    linearity = SimpleNamespace(
        gain=1.02, gain_u=1e-4, offset=-2e-3, offset_u=3e-4, dof=15,
        deviation=4e-3, deviation_u=5e-4, deviation_dof=40,
    )  # fmt: skip
    slopes = SimpleNamespace(
        hysteresis=4e-3, hysteresis_u=1e-5, hysteresis_dof=7,
        lasting_heating=LOSS, level=np.array([0.0, 2.0, 4.0]),
    )  # fmt: skip
    found = calibration(
        linearity=linearity,
        slopes=slopes,
        components={"arm length": 3e-3, "gauge calibration": 4e-3, "model of friction": 4.8e-4},
        torque_constant=None,
        constant_error=None,
        ripple=None,
        first_ripple=None,
    )
    results = _results(found, 2e-3)
    assert "torque_constant" not in results
    for name, value, u, dof in (
        ("amplifier_gain", 1.02, 1e-4, 15),
        ("amplifier_offset", -2e-3, 3e-4, 15),
        ("amplifier_linearity", 4e-3, 5e-4, 40),
    ):
        own = results[name]
        whole = math.hypot(u, 2e-3 * value)  # a reading that is off scales all currents
        assert (own.value, own.u) == pytest.approx((value, whole), rel=1e-9)
        assert own.dof == pytest.approx(dof * (whole / u) ** 4, rel=1e-9)
        (reading,) = (line for line in own.budget if line.name == CURRENT_READING)
        assert (reading.value, reading.u, reading.sensitivity) == (1.0, 2e-3, value)
    hysteresis = results["hysteresis_torque"]
    assert hysteresis.u == pytest.approx(math.hypot(1e-5, 4e-3 * 5e-3), rel=1e-9)
    assert {line.value for line in hysteresis.budget if line.unit == "1"} == {1.0}
    assert hysteresis.dof == pytest.approx(7 * (hysteresis.u / 1e-5) ** 4, rel=1e-9)
    heat = results["winding_heat_loss"]
    # what 4.8e-4 of the slope at 4 A would be as a loss
    assert (heat.value, heat.u) == pytest.approx((2e-4, math.hypot(1e-5, 2e-5, 3e-5)), rel=1e-9)
    assert heat.dof == pytest.approx(5 * 14**2, rel=1e-9)
    slopes.hysteresis_dof = 0
    assert _results(found, 2e-3)["hysteresis_torque"].u is None


@pytest.mark.parametrize("dof", [0, 1])
def test_two_staircases_show_the_scatter_of_their_hysteresis_and_one_none(dof):
    slopes = SimpleNamespace(
        hysteresis=4e-3, hysteresis_u=1e-5, hysteresis_dof=dof,
        lasting_heating=LOSS, level=np.array([0.0, 2.0, 4.0]),
    )  # fmt: skip
    linearity = SimpleNamespace(
        gain=1.0, gain_u=1e-4, offset=0.0, offset_u=1e-4, dof=9,
        deviation=1e-3, deviation_u=1e-4, deviation_dof=9,
    )  # fmt: skip
    found = calibration(
        linearity=linearity, slopes=slopes, components={}, torque_constant=None,
        constant_error=None, ripple=None, first_ripple=None,
    )  # fmt: skip
    own = _results(found, 0.0)["hysteresis_torque"]
    assert (own.u, own.dof) == ((1e-5, 1) if dof else (None, None))
    assert (own.reason is None) == (dof == 1)


def test_tables_hold_the_constant_the_amplifier_and_the_friction():
    rng = np.random.default_rng(1)
    linearity = SimpleNamespace(
        current_setpoint=rng.random(4), current=rng.random(4), deviations=rng.random(4)
    )
    slopes = SimpleNamespace(level=rng.random(5), rising=rng.random(5), falling=rng.random(5))
    values = {name: rng.random(3) for name in ("temperature", "value", "u", "dof")}
    found = _tables(calibration(linearity=linearity, slopes=slopes, **values))
    constant, linear, friction = (
        found[name] for name in ("torque_constant", "linearity", "hysteresis")
    )
    for table, name, column in (
        (constant, "temperature", values["temperature"]),
        (constant, "torque_constant", values["value"]),
        (constant, "u", values["u"]),
        (constant, "dof", values["dof"]),
        (linear, "current_setpoint", linearity.current_setpoint),
        (linear, "current", linearity.current),
        (linear, "deviation", linearity.deviations),
        (friction, "current", slopes.level),
        (friction, "rising", slopes.rising),
        (friction, "falling", slopes.falling),
    ):
        np.testing.assert_array_equal(table[name], column, err_msg=name)
    units = [table.columns[table.signal].unit for table in (constant, linear, friction)]
    assert units == ["N m/A", "A", "N m"]
