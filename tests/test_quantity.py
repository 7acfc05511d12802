"""Quantities as people read them."""

import math
from dataclasses import replace

import GTC
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rigtool.errors import InsufficientDataError
from rigtool.quantity import (
    Component,
    Quantity,
    combined,
    customary,
    difference,
    error_line,
    format_number,
    format_quantity,
    inherited,
    input_line,
    scaled,
    scattered,
    without,
)


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
        (0.045, 1e-320, "0.045"),  # finer than the value's own digits, as zero is
        (0.0, 5e-324, "0"),
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
    assert format_quantity(Quantity(0.0125, "1", 0.0003), "torque_constant_ripple") == "1.250(30) %"
    assert format_quantity(Quantity(0.0125, "1", 0.0003), "table_scale") == "0.01250(30)"
    # 20 log10(5), 8.686 dB a relative change of one
    assert format_quantity(Quantity(5.0, "1", 0.05), "gain_margin") == "13.979(87) dB"


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


def test_the_end_gauge_of_the_gum():
    """JCGM 100:2008, H.1: contributions in nm, u(l) = 32 nm, 16 degrees of freedom (16.7)."""
    lines = [
        error_line("standard", 25.0, "nm", 18),
        error_line("comparison", 9.7, "nm", 25.6),
        Component("expansion coefficients", 0.0, "1/K", 0.58e-6, 50, sensitivity=-5e6),
        error_line("temperatures", 16.6, "nm", 2),
        error_line("temperature of the bed", 0.0, "nm"),
    ]
    found = combined(50000838.0, "nm", lines)
    assert found.u == pytest.approx(31.7, abs=0.1)
    assert found.dof == pytest.approx(16.7, abs=0.1)
    assert [line.name for line in found.budget] == [line.name for line in lines[:-1]]
    assert found.budget[2].contribution == pytest.approx(2.9, rel=1e-12)
    assert combined(1.0, "m", []).u == 0


numbers = st.floats(-10, 10).filter(lambda x: abs(x) > 0.1)
inputs = st.tuples(numbers, st.floats(1e-3, 1), st.none() | st.floats(1, 100), numbers, numbers)


@given(st.lists(inputs, min_size=1, max_size=5))
def test_sums_and_differences_are_those_of_gtc(drawn):
    """f = sum a x and g = sum b x of the same inputs x, against GTC's own propagation."""
    quantities = [Quantity(x, "m", u, dof) for x, u, dof, _, _ in drawn]
    x = [GTC.ureal(q.value, q.u, q.dof or math.inf) for q in quantities]

    def line(which):
        value = sum(row[which] * q.value for row, q in zip(drawn, quantities, strict=True))
        lines = [
            input_line(str(n), q, row[which])
            for n, (row, q) in enumerate(zip(drawn, quantities, strict=True))
        ]
        return combined(value, "m", lines), sum(
            row[which] * i for row, i in zip(drawn, x, strict=True)
        )

    (f, f_gtc), (g, g_gtc) = line(3), line(4)
    for found, expected in ((f, f_gtc), (difference(f, g), f_gtc - g_gtc)):
        assert found.value == pytest.approx(GTC.value(expected), rel=1e-9, abs=1e-9)
        u = GTC.uncertainty(expected)
        assert found.u == pytest.approx(u, rel=1e-9, abs=1e-12)
        if u > 1e-9:
            dof = GTC.dof(expected)
            assert (found.dof or math.inf) == pytest.approx(dof, rel=1e-6)


def test_a_difference_keeps_each_line_of_a_name_that_only_one_budget_has_twice():
    zeros = [error_line("zero", u, "m", 4.0) for u in (0.3, 0.4)]
    shared = input_line("scale", Quantity(1.0, "1", 0.1), 2.0)
    first = combined(2.0, "m", [*zeros, shared])
    second = combined(1.5, "m", [replace(shared, sensitivity=1.5)])
    for found in (difference(first, second), difference(second, first)):
        assert abs(found.value) == 0.5
        assert found.u == pytest.approx(math.hypot(0.3, 0.4, 0.05), rel=1e-9)


def test_lines_follow_their_quantity():
    constant = Quantity(2.0, "N m/A", 0.1, 7.0)
    known = combined(
        2.0, "N m/A", [input_line("k", constant, 1.0), error_line("z", 0.3, "N m/A", 5)]
    )
    assert inherited(constant, 3.0, "k") == [Component("k", 2.0, "N m/A", 0.1, 7.0, 3.0)]
    assert [line.contribution for line in inherited(known, -2.0, "k")] == [0.2, 0.6]
    doubled = scaled(known, -2.0, "N m")
    assert (doubled.value, doubled.dof) == (-4.0, known.dof)
    assert doubled.u == pytest.approx(2 * known.u, rel=1e-12)
    assert math.hypot(*(line.contribution for line in doubled.budget)) == pytest.approx(doubled.u)
    assert without(known, "k").u == pytest.approx(0.3, rel=1e-12)
    assert without(known, "k").dof == pytest.approx(5.0, rel=1e-12)
    assert without(known, "none of it") is known


def test_an_error_is_zero_on_average_and_a_number_of_infinite_dof_has_none():
    line = error_line("scatter", 0.2, "N m", math.inf)
    assert line == Component("scatter", 0.0, "N m", 0.2, None, 1.0)
    single = scattered(3.0, "N m", 0.2, 7.0)
    assert (single.value, single.u, single.dof) == (3.0, 0.2, 7.0)
    assert single.budget == (Component("scatter", 0.0, "N m", 0.2, 7.0, 1.0),)


@pytest.mark.parametrize(
    ("name", "quantity", "expected"),
    [
        ("gain_margin", Quantity(2.0, "1", 0.02), (6.0206, 0.0869, "dB")),
        ("reduction", Quantity(0.93, "1", 0.01), (93.0, 1.0, "%")),
        ("reduction", Quantity(0.93, "N m", 0.01), (930.0, 10.0, "mN m")),
        ("coherence_min", Quantity(0.93, "1", 0.01), (0.93, 0.01, "1")),
        ("offset", Quantity(0.05, "A", 1e-3), (50.0, 1.0, "mA")),
        ("offset", Quantity(0.2, "A", 1e-3), (0.2, 1e-3, "A")),
        ("delay", Quantity(-2e-5, "s", 1e-6), (-20.0, 1.0, "µs")),
        ("angle", Quantity(math.pi, "rad", 0.0), (180.0, 0.0, "deg")),
    ],
)
def test_a_result_is_shown_in_its_customary_unit(name, quantity, expected):
    shown = customary(name, quantity)
    assert (shown.value, shown.u) == (
        pytest.approx(expected[0], rel=1e-4),
        pytest.approx(expected[1], rel=1e-3),
    )
    assert shown.unit == expected[2]


def test_an_uncertainty_that_is_no_number_is_no_result():
    with pytest.raises(InsufficientDataError, match="rigtool plot"):
        combined(1.0, "Hz", [Component("scatter", 1.0, "Hz", math.nan)])
