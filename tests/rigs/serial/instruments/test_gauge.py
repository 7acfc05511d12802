"""Instruments on a line of their own: read in a thread, asked for what they read and when."""

import time

import numpy as np
import pytest

from rigtool.errors import HardwareError, RecipeError
from rigtool.recipe.serial import MeasuringInstrument
from rigtool.rigs.operator import Operator
from rigtool.rigs.serial.instruments import INSTRUMENT_MODULES, gauge, instrument_module, open_gauge
from rigtool.rigs.serial.line import Line
from rigtool.rigs.serial.ports import find_devices
from tests.rigs.serial.emulators.faults import Fault, serve
from tests.rigs.serial.emulators.instruments import (
    KernEmulator,
    Mark10Emulator,
    MecmesinEmulator,
    NumberLinesEmulator,
    SauterEmulator,
    ScpiEmulator,
)

NOBODY = Operator(say=lambda text: None, present=False)


def opened(driver, port, channel="force", **settings):
    return open_gauge(channel, MeasuringInstrument(driver=driver, port=port, **settings), NOBODY)


def watch(instrument, seconds=0.2, moments=40):
    """Return what it read over the next seconds."""
    start = now(instrument)
    instrument.begin(start)
    time.sleep(seconds)
    return instrument.at(np.linspace(start + 0.12, start + seconds, moments))


def now(instrument):
    return instrument._line.now()


def with_options(device, **options):
    for name, value in options.items():
        setattr(device, name, value)
    return device


DEVICES = {
    "mark10": ("mark10", lambda: Mark10Emulator(lambda: 4.285), "force", 4.285),
    "mark10 pounds": (
        "mark10",
        lambda: Mark10Emulator(lambda: -18.78, unit="lbF", decimals=2),
        "force",
        -83.53760,
    ),
    "mark10 series 4": (
        "mark10",
        lambda: with_options(Mark10Emulator(lambda: 4.285), real_time=False),
        "force",
        4.285,
    ),
    "sauter push": ("sauter", lambda: SauterEmulator(lambda: -11.7, decimals=2), "force", 11.7),
    "sauter pull": ("sauter", lambda: SauterEmulator(lambda: 21.15, decimals=2), "force", -21.15),
    "mecmesin": ("mecmesin", lambda: MecmesinEmulator(lambda: 2.5, unit="ozf"), "force", 0.695035),
    "kern scale": ("kern", lambda: KernEmulator(lambda: 250.0, unit="g"), "force", 2.4516625),
    "kern gauge": ("kern", lambda: KernEmulator(lambda: -3.25), "force", -3.25),
    "multimeter": ("scpi", lambda: ScpiEmulator(lambda: 296.5, unit="K"), "temperature", 23.35),
    "load cell": ("scpi", lambda: ScpiEmulator(lambda: 0.75), "force", 0.75),
    "logger": (
        "number-lines",
        lambda: NumberLinesEmulator(lambda: 77, unit="F"),
        "temperature",
        25,
    ),
    "micrometer": (
        "number-lines",
        lambda: NumberLinesEmulator(lambda: 0.125, unit="mm"),
        "deflection",
        0.125e-3,
    ),
}


@pytest.mark.parametrize("name", DEVICES)
def test_reads_in_the_unit_and_sign_of_the_channel(name):
    driver, make, channel, value = DEVICES[name]
    device = make()
    with serve(device) as server, opened(driver, server.port, channel) as instrument:
        got = watch(instrument)
        facts = instrument.report()
    np.testing.assert_allclose(got, value, rtol=1e-5)
    assert instrument.problem() is None
    assert facts["missing_samples"] == facts["retries"] == 0
    assert facts["readings"] > 2
    assert facts["identity"]
    assert server.error is None


def test_hart_thermometer_is_asked_its_own_way(monkeypatch):
    monkeypatch.setattr("rigtool.rigs.serial.instruments.scpi.ANSWER_TIMEOUT", 0.1)
    device = with_options(ScpiEmulator(lambda: 25.587, unit="C"), hart=True)
    with serve(device) as server, opened("scpi", server.port, "temperature") as thermometer:
        assert watch(thermometer)[-1] == pytest.approx(25.587, rel=1e-9)
        assert thermometer.report()["identity"] == "answers FETC?"


def test_scale_and_offset_of_the_recipe_come_last():
    device = Mark10Emulator(lambda: 2.0)
    with (
        serve(device) as server,
        opened("mark10", server.port, scale=-1.5, offset=0.25) as instrument,
    ):
        assert watch(instrument)[-1] == -2.75


def test_value_follows_the_force_in_time():
    start = time.monotonic()
    device = Mark10Emulator(lambda: 10 * (time.monotonic() - start), decimals=4)
    with serve(device) as server, opened("mark10", server.port) as instrument:
        instrument.begin(now(instrument))
        time.sleep(0.4)
        moments = now(instrument) - np.linspace(0.3, 0.05, 50)
        got = instrument.at(moments)
        late = moments + instrument._line.opened - start - got / 10
    assert late.min() > -1e-4
    assert late.max() < 0.1
    assert np.median(late) < 0.04


def test_series_4_is_asked_for_what_it_displays():
    device = with_options(Mark10Emulator(lambda: 1.0), real_time=False)
    with serve(device) as server, opened("mark10", server.port):
        pass
    assert device.asked[:2] == [b"?C", b"?C"]  # the first may have come damaged
    assert set(device.asked[2:]) == {b"?"}


def test_old_mecmesin_is_set_to_newton(monkeypatch):
    monkeypatch.setattr("rigtool.rigs.serial.instruments.readings.Polled.timeout", 0.1)
    device = with_options(MecmesinEmulator(lambda: 2.5, unit="lbf"), informs=False)
    with serve(device) as server, opened("mecmesin", server.port) as instrument:
        assert "in N" in instrument.report()["identity"]
    assert device.unit == "N"
    assert b"b" in device.asked


def test_nothing_is_zeroed_or_set_where_it_need_not_be():
    for driver, make, channel, _ in DEVICES.values():
        device = make()
        with serve(device) as server, opened(driver, server.port, channel):
            pass
        harmless = {b"?", b"?C", b"9", b"U", b"M", b"SI", b"I4", b"READ?", b"*IDN?", b"FUNC?"}
        assert set(device.asked) <= {*harmless, b"UNIT:TEMP?"}


@pytest.mark.parametrize(
    ("driver", "device", "channel", "message"),
    [
        (
            "mark10",
            with_options(Mark10Emulator(lambda: 1.0), says_unit=False),
            "force",
            "sends no unit: switch it on",
        ),
        ("mark10", Mark10Emulator(lambda: 1.0, unit="lbFin"), "force", "no unit of force"),
        ("mark10", Mark10Emulator(lambda: 9.0, highest=5), "force", "sends 'overload'"),
        (
            "mecmesin",
            with_options(MecmesinEmulator(lambda: 1.0), mode="MaxC"),
            "force",
            "in mode MaxC, and would send peaks",
        ),
        ("mecmesin", with_options(MecmesinEmulator(lambda: 1.0), faulty=True), "force", "no value"),
        ("kern", Mark10Emulator(lambda: 1.0), "force", "no valid reply"),
        (
            "scpi",
            with_options(ScpiEmulator(lambda: 100.0, unit="C"), function='"FRES"'),
            "temperature",
            "measures FRES, not temperature",
        ),
        ("scpi", ScpiEmulator(lambda: 99.0, unit="C", highest=50), "temperature", "overload"),
        (
            "number-lines",
            NumberLinesEmulator(lambda: 1.0, unit="kg"),
            "temperature",
            "no unit of temperature",
        ),
    ],
)
def test_what_is_set_up_wrongly_is_refused_at_the_start(driver, device, channel, message):
    with serve(device) as server, pytest.raises(HardwareError, match=message) as caught:
        opened(driver, server.port, channel).__enter__()
    assert f"serial.{channel} ({driver} on " in str(caught.value)


def test_silent_port_and_unknown_drivers_are_refused(monkeypatch):
    with pytest.raises(RecipeError, match="'abacus' is not known: use one of operator, mark10"):
        opened("abacus", "/dev/null")
    with pytest.raises(RecipeError, match=r"serial.force.port is missing"):
        opened("mark10", None)
    monkeypatch.setattr("rigtool.rigs.serial.instruments.number_lines.GREETING_TIME", 0.1)
    device = with_options(NumberLinesEmulator(lambda: 1.0), period=60.0, greeting=b"HX711 ready\n")
    with serve(device) as server, pytest.raises(HardwareError, match="no whole line within"):
        opened("number-lines", server.port).__enter__()


def test_greeting_and_half_a_line_are_left_out():
    device = NumberLinesEmulator(lambda: 12.5, unit="")
    device.greeting = b"85\r\nHX711 ready\r\nscale 420\r\n"
    with serve(device) as server, opened("number-lines", server.port) as instrument:
        assert (watch(instrument) == 12.5).all()


# -- trouble while it runs


KINDS = ("flip", "lose", "double", "cut")
SURVIVED = {
    "damaged answers": [Fault(kind, at=4 + 4 * n) for n, kind in enumerate(KINDS)],
    "damaged questions": [
        Fault(kind, at=4 + 4 * n, towards="device") for n, kind in enumerate(KINDS)
    ],
    "late, and a moment of silence": [
        Fault("late", at=6),
        Fault("silence", at=12, duration=0.15),
    ],
}


@pytest.mark.parametrize("name", SURVIVED)
@pytest.mark.parametrize("driver", ["mark10", "sauter", "number-lines"])
def test_no_wrong_number_from_a_bad_line(driver, name, monkeypatch):
    make = {
        "mark10": lambda: Mark10Emulator(lambda: 4.285),
        "sauter": lambda: SauterEmulator(lambda: -4.285),
        "number-lines": lambda: NumberLinesEmulator(lambda: 4.285),
    }[driver]
    monkeypatch.setattr("rigtool.rigs.serial.instruments.readings.Polled.timeout", 0.05)
    device = make()
    with serve(device, *SURVIVED[name]) as server, opened(driver, server.port) as instrument:
        got = watch(instrument, 0.45)
        assert instrument.problem() is None
    np.testing.assert_allclose(got, 4.285, rtol=1e-9)
    assert server.error is None


def test_overload_is_reported_and_leaves_a_hole():
    force = [3.0]
    device = Mark10Emulator(lambda: force[0], highest=5)
    with serve(device) as server, opened("mark10", server.port) as instrument:
        assert (watch(instrument) == 3.0).all()
        force[0] = 6.0
        time.sleep(0.1)
        got = watch(instrument)
        problem, facts = instrument.problem(), instrument.report()
    assert np.isnan(got).all()
    assert "40 samples have no reading near them: it last sent: overload" in problem
    assert facts["flags"]["overload"] > 2
    assert facts["missing_samples"] == 40


def test_unstable_readings_are_used_and_counted():
    device = with_options(KernEmulator(lambda: 250.0, unit="g"), moving=True)
    with serve(device) as server, opened("kern", server.port) as instrument:
        np.testing.assert_allclose(watch(instrument), 2.4516625, rtol=1e-9)
        assert instrument.report()["flags"]["unstable"] > 1
        assert instrument.problem() is None


@pytest.mark.parametrize("fault", [Fault("pull", at=20), Fault("silence", at=20)])
@pytest.mark.parametrize("driver", ["mark10", "number-lines"])
def test_instrument_that_is_gone_is_reported(driver, fault, monkeypatch):
    monkeypatch.setattr("rigtool.rigs.serial.instruments.readings.Polled.timeout", 0.03)
    monkeypatch.setattr(gauge, "MAX_SILENCE", 0.2)
    monkeypatch.setattr("rigtool.rigs.serial.instruments.number_lines.NUMBER_TIMEOUT", 0.05)
    kinds = {"mark10": Mark10Emulator, "number-lines": NumberLinesEmulator}
    device = kinds[driver](lambda: 1.0)
    with serve(device, fault) as server, opened(driver, server.port) as instrument:
        deadline = time.monotonic() + 3
        while instrument.problem() is None and time.monotonic() < deadline:
            time.sleep(0.02)
            instrument.at(np.array([now(instrument)]))
        assert f"serial.force ({driver} on " in instrument.problem()
        with pytest.raises(HardwareError, match="on /dev/pts"):
            instrument.begin(now(instrument))


def test_gauge_that_refuses_ends_the_run():
    device = Mark10Emulator(lambda: 1.0)
    with serve(device, Fault("refuse", at=10)) as server, opened("mark10", server.port) as it:
        time.sleep(0.3)
        it.at(np.array([now(it)]))
        assert "the gauge refuses: *11 (not applicable)" in it.problem()


def test_samples_that_the_instrument_knows_nothing_of_are_missing():
    with (
        serve(Mark10Emulator(lambda: 1.0)) as server,
        opened("mark10", server.port) as instrument,
    ):
        future = now(instrument) + np.array([0.0, 100.0])
        np.testing.assert_array_equal(instrument.at(future), [1.0, np.nan])
        assert "1 samples have no reading near them" in instrument.problem()
        assert instrument.at(np.empty(0)).shape == (0,)


# -- who is there


ASKED = {
    "mark10": (Mark10Emulator(lambda: 4.285), "Mark-10 force gauge, answers 4.285 N"),
    "sauter": (SauterEmulator(lambda: 1.5), "Sauter force gauge, answers 101.500"),
    "mecmesin": (MecmesinEmulator(lambda: 2.5), "Mecmesin force gauge, in N"),
    "kern": (KernEmulator(lambda: 2.5), "KERN instrument K123456"),
    "scpi": (ScpiEmulator(lambda: 2.5), "KEITHLEY INSTRUMENTS INC.,MODEL 2110,8004040,1.02"),
}


@pytest.mark.parametrize("name", ASKED)
@pytest.mark.parametrize("asked", ASKED)
def test_probe_knows_its_own_and_no_other(name, asked):
    module = instrument_module(asked)
    with (
        serve(ASKED[name][0]) as server,
        Line(server.port, module.BAUD_RATE, timeout=0.05, retries=0) as line,
    ):
        try:
            identity = module.probe(line)
        except HardwareError:
            identity = None
    assert identity == (ASKED[name][1] if name == asked else None)


def test_devices_are_found_by_asking(monkeypatch):
    listening = "rigtool.rigs.serial.instruments.number_lines.LISTENING_TIME"
    monkeypatch.setattr(listening, 0.05)
    with serve(ScpiEmulator(lambda: 2.5)) as server:
        found = list(find_devices([server.port], ["mark10", "scpi", "number-lines"]))
    assert [(item.driver, item.identity[:8]) for item in found] == [("scpi", "KEITHLEY")]
    with serve(NumberLinesEmulator(lambda: 2.5)) as server:
        found = list(find_devices([server.port], ["number-lines"]))
    assert found[0].identity == "sends numbers by itself, e.g. 2.500 N"
    gauge = MecmesinEmulator(lambda: 1.0)
    with serve(gauge) as server:
        (found,) = find_devices([server.port], ["mecmesin"])
    assert found.driver == "mecmesin"
    assert set(gauge.asked) == {b"U"}


def test_every_module_offers_what_a_gauge_needs():
    for name in INSTRUMENT_MODULES:
        module = instrument_module(name)
        assert module.BAUD_RATE in (9600, 115200)
        assert callable(module.make_reader)
