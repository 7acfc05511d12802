"""Quantities as people read them."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rigtool.quantity import Quantity, format_number, format_quantity


@pytest.mark.parametrize(
    ("value", "u", "expected"),
    [
        # JCGM 100:2008, 7.2.2: a mass of 100.02147 g with u = 0.35 mg
        (100.02147, 0.00035, "100.02147(35)"),
        # CODATA 2018: the Newtonian constant of gravitation, and the molar gas-phase fine structure
        (6.67430, 0.00015, "6.67430(15)"),
        (137.035999084, 0.000000021, "137.035999084(21)"),
        (45.8, 0.04, "45.800(40)"),
        (45.8, 0.0996, "45.80(10)"),
        (12345.0, 210.0, "12340(210)"),
        (0.0, 0.5, "0.00(50)"),
    ],
)
def test_short_form_of_the_gum(value, u, expected):
    assert format_number(value, u) == expected


def test_display_units_are_those_of_the_bench():
    assert format_quantity(Quantity(0.0458, "N m/A", 0.00004)) == "45.800(40) mN m/A"
    assert format_quantity(Quantity(-0.00116, "1/K", 0.00002)) == "-0.1160(20) %/K"
    assert format_quantity(Quantity(math.pi / 6, "rad", math.pi / 180)) == "30.0(10) deg"
    assert format_quantity(Quantity(9.5e-6, "A", 4.5e-6)) == "9.5(45) µA"
    assert format_quantity(Quantity(-0.0012, "A", 0.0001)) == "-1.20(10) mA"
    assert format_quantity(Quantity(1.2, "A", 0.1)) == "1.20(10) A"


def test_a_value_without_uncertainty_needs_a_reason():
    with pytest.raises(ValueError, match="reason for having none"):
        Quantity(1.0, "m")
    with pytest.raises(ValueError, match="must not be negative"):
        Quantity(1.0, "m", -0.1)


@given(
    value=st.floats(-1e5, 1e5),
    relative=st.floats(1e-6, 10),
)
def test_the_short_form_keeps_the_value_within_its_uncertainty(value, relative):
    u = max(abs(value), 1e-30) * relative
    text = format_number(value, u)
    number, _, rest = text.partition("(")
    exponent = int(rest.partition("e")[2] or 0)
    shown = float(number) * 10.0**exponent
    assert math.isclose(shown, value, rel_tol=0, abs_tol=0.051 * u)
