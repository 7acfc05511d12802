"""What instruments send, and what is made of it: vectors of the manuals, and damaged lines."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rigtool.errors import HardwareError
from rigtool.rigs.serial.instruments import kern, mark10, mecmesin, number_lines, sauter, scpi
from rigtool.rigs.serial.instruments.gauge import latest, spikes
from rigtool.rigs.serial.instruments.readings import (
    NO_VALUE,
    OVERLOAD,
    UNDERRANGE,
    UNSTABLE,
    Form,
    Reading,
    number,
    to_si,
)
from rigtool.rigs.serial.line import DamagedReply

PARSERS = {
    "mark10": lambda line, form: mark10.parse(line, "force", form),
    "sauter": lambda line, form: Reading(sauter.parse(line)),
    "mecmesin": lambda line, form: mecmesin.parse(line, "lbf", "force", form),
    "kern": lambda line, form: kern.parse(line, "force", form),
    "number-lines": lambda line, form: number_lines.parse(line, "force", form),
    "scpi": lambda line, form: scpi.parse(line, "temperature", "C", form),
}


def parsed(name, line):
    return PARSERS[name](line, Form())


@pytest.mark.parametrize(
    ("name", "line", "value"),
    [
        ("mark10", b"4.285 N", 4.285),  # compression
        ("mark10", b"-18.78 lbF", -83.5376),  # tension
        ("mark10", b"1.000 kgF", 9.80665),
        ("mark10", b"100 gF", 0.980665),
        ("mark10", b"16.0 ozF", 4.4482216),
        ("sauter", b"1021.15", -21.15),  # pull
        ("sauter", b"0011.70", 11.70),  # push
        ("mecmesin", b"2.50", 11.120554),
        ("mecmesin", b"-2.50 lbf", -11.120554),
        ("kern", b"S S     100.00 g", 0.980665),
        ("kern", b"S S      -0.50 N", -0.5),
        ("number-lines", b"12.5", 12.5),
        ("number-lines", b"-1.25e-1", -0.125),
        ("number-lines", b"12.5 kgf", 122.583125),
        ("number-lines", b"250 mN", 0.25),
        ("scpi", b"+2.34500000E+01", 23.45),
        ("scpi", b"t: 25.587 C", 25.587),
        ("scpi", b"t: 77.0 F", 25.0),
        ("scpi", b"t: 298.15 K", 25.0),
    ],
)
def test_vectors(name, line, value):
    reading = parsed(name, line)
    assert reading.value == pytest.approx(value, rel=1e-6)
    assert reading.flag == ""


@pytest.mark.parametrize(
    ("name", "line", "flag"),
    [
        ("kern", b"S +", OVERLOAD),
        ("kern", b"S -", UNDERRANGE),
        ("mark10", b"OVER", OVERLOAD),
        ("mecmesin", b"xxxx", NO_VALUE),
        ("number-lines", b"nan", NO_VALUE),
        ("number-lines", b"OL", OVERLOAD),
        ("scpi", b"+9.90000000E+37", OVERLOAD),
        ("scpi", b"+9.90000000E+20OADC,+0001SECS", OVERLOAD),
        ("scpi", b"-9.90000000E+37", UNDERRANGE),
        ("scpi", b"+9.91000000E+37", NO_VALUE),
    ],
)
def test_what_is_no_value_is_distinguished_from_what_is_damaged(name, line, flag):
    reading = parsed(name, line)
    assert reading.flag == flag
    assert math.isnan(reading.value)


def test_unstable_reading_is_flagged_and_has_its_value():
    assert parsed("kern", b"S D     129.07 g") == Reading(
        pytest.approx(1.26574, rel=1e-4), UNSTABLE
    )


@pytest.mark.parametrize(
    ("name", "line", "message"),
    [
        ("mark10", b"*11", "not applicable"),
        ("mark10", b"*22", "value too large"),
        ("mark10", b"4.285", "sends no unit: switch it on"),
        ("mark10", b"4.285 lbFin", "'lbFin', which is no unit of force"),
        ("scpi", b"t: 100.02 O", "no unit of temperature"),
    ],
)
def test_what_cannot_be_used_is_refused_with_the_reason(name, line, message):
    with pytest.raises(HardwareError, match=message) as caught:
        parsed(name, line)
    assert not isinstance(caught.value, DamagedReply)


def test_units_are_those_of_nist_sp_811():
    assert to_si(1, "lbf", "force") == 4.4482216152605
    assert to_si(1, "ozF", "force") == pytest.approx(0.2780138509537812, rel=1e-15)
    assert to_si(1, "kgf", "force") == 9.80665
    assert to_si(212, "F", "temperature") == pytest.approx(100, abs=1e-12)
    assert to_si(-40, "FAR", "temperature") == pytest.approx(-40, abs=1e-12)
    assert to_si(0, "K", "temperature") == -273.15
    assert to_si(25.4, "mm", "deflection") == pytest.approx(0.0254, rel=1e-9)
    with pytest.raises(HardwareError, match="no unit of temperature"):
        to_si(1, "N", "temperature")


LINES = {
    "mark10": (b"-18.78 lbF", b"18.79 lbF", 2),
    "sauter": (b"1021.15", b"0021.16", 2),
    "mecmesin": (b"12.34 lbf", b"-2.34 lbf", 2),
    "kern": (b"S S     100.00 g", b"S D      99.98 g", 2),
    "scpi": (b"t: 25.587 C", b"t: 25.601 C", 3),
}


@given(
    name=st.sampled_from(sorted(PARSERS)),
    line=st.one_of(
        st.binary(max_size=30),
        st.text(alphabet="0123456789+-.eE SDItNgklbf:*xX", max_size=20).map(str.encode),
    ),
)
def test_no_line_brings_a_parser_down(name, line):
    try:
        reading = parsed(name, line)
    except HardwareError:
        return
    assert math.isfinite(reading.value) or reading.flag in (OVERLOAD, UNDERRANGE, NO_VALUE)


@given(name=st.sampled_from(["kern", "mark10", "mecmesin", "sauter"]), cut=st.data())
def test_line_that_was_cut_or_lost_its_point_is_never_a_reading(name, cut):
    whole, _, decimals = LINES[name]
    form = Form()
    PARSERS[name](whole, form)
    place = whole.index(b".")
    damaged = cut.draw(
        st.sampled_from(
            [
                whole[:place] + whole[place + 1 :],
                whole[: place + 1] + whole[place + 2 :],
                whole[: place + decimals + 1] + b"7" + whole[place + decimals + 1 :],
                whole[:place] + b"." + whole[place:],
            ]
        )
    )
    with pytest.raises(DamagedReply):
        PARSERS[name](damaged, form)


@given(
    name=st.sampled_from(sorted(LINES)),
    place=st.integers(0, 20),
    value=st.integers(0, 255),
)
def test_a_wrong_character_is_found_unless_it_is_another_digit_or_sign(name, place, value):
    whole, _, _ = LINES[name]
    place %= len(whole)
    damaged = whole[:place] + bytes([value]) + whole[place + 1 :]
    form = Form()
    right = PARSERS[name](whole, form)
    try:
        got = PARSERS[name](damaged, form)
    except HardwareError:
        return
    same = bytes([value]).lower() == whole[place : place + 1].lower()
    # The end of a line in place of the first character: a good line without its sign.
    ends = place == 0 and value in b"\r\n"
    assert got == right or same or ends or chr(value) in "0123456789+-SD eE", damaged


@given(st.floats(-1e6, 1e6), st.integers(0, 6))
def test_numbers_come_back_as_they_were_written(value, decimals):
    assert number(f"{value:.{decimals}f}") == float(f"{value:.{decimals}f}")


@pytest.mark.parametrize("text", ["", "1_000", "٣", "0x10", "1e", "--1", "1.2.3", " 1", "infinity"])
def test_only_plain_decimal_numbers_are_numbers(text):
    with pytest.raises(DamagedReply):
        number(text)


# -- between readings


def test_a_reading_holds_until_the_next_and_not_for_long():
    times = np.array([0.0, 0.1, 0.2, 1.0, 1.1])
    values = np.array([0.0, 1.0, math.nan, 4.0, 5.0])
    moments = np.array([-0.1, 0.0, 0.05, 0.15, 0.25, 0.9, 1.05, 1.6, 1.7])
    found = latest(times, values, moments, 0.5)
    np.testing.assert_array_equal(found, [np.nan, 0, 0, 1, np.nan, np.nan, 4, 5, np.nan])
    assert np.isnan(latest(np.empty(0), np.empty(0), times, 0.5)).all()


@given(st.lists(st.floats(0.01, 0.4), min_size=2, max_size=30))
def test_no_value_is_known_before_it_was_read(gaps):
    times = np.cumsum(gaps)
    moments = np.linspace(times[0], times[-1], 50)
    read_at = latest(times, times, moments, 0.5)
    assert (read_at <= moments).all()
    assert (moments - read_at <= 0.4).all()


@given(st.integers(1, 98), st.sampled_from([-10.0, 9.0, 1.0]), st.integers(0, 100))
def test_a_digit_that_was_damaged_stands_alone(place, wrong, seed):
    values = 5 + 0.01 * np.random.default_rng(seed).standard_normal(100)
    values[place] += wrong
    assert np.flatnonzero(spikes(values)).tolist() == [place]


def test_steps_triangles_and_what_hardly_changes_are_no_spikes():
    noise = 0.01 * np.random.default_rng(1).standard_normal(200)
    assert not spikes(np.repeat(np.arange(20.0), 10) + noise).any()
    assert not spikes(np.abs(np.linspace(-5, 5, 200)) + noise).any()
    still = np.full(100, 3.0)
    still[40] = 3.1
    assert not spikes(still).any()
    assert np.flatnonzero(spikes(still, resolution=0.004)).tolist() == [40]
    assert np.flatnonzero(spikes(still, finest=0.004)).tolist() == [40]
    assert not spikes(still[20:50], finest=0.004).any()  # too few to say that it hardly changes
    assert not spikes(np.array([1.0, 2.0])).any()
