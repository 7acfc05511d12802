"""Instruments by PyVISA, PyVISA-sim in place of a VISA library."""

import sys
import time

import pytest

from rigtool.errors import HardwareError, UsageError
from rigtool.recipe.serial import MeasuringInstrument
from rigtool.rigs.operator import Operator
from rigtool.rigs.serial.instruments import open_gauge, scpi
from rigtool.rigs.serial.line import Line, LineTimeout
from rigtool.rigs.serial.ports import find_devices

METERS = """spec: "1.1"
devices:
  meter:
    eom:
      GPIB INSTR: {q: "\\n", r: "\\n"}
      USB INSTR: {q: "\\n", r: "\\n"}
    dialogues:
      - {q: "*IDN?", r: "HEWLETT-PACKARD,34401A,0,11-5-2"}
      - {q: "READ?", r: "+7.50000000E-01"}
      - {q: "*CLS"}
  picoammeter:
    eom:
      GPIB INSTR: {q: "\\n", r: "\\n"}
    dialogues:
      - {q: "*IDN?", r: "KEITHLEY INSTRUMENTS INC.,MODEL 6517B,1,A02"}
      - {q: "READ?", r: "+2.34E+01NADC,+0001SECS"}
resources:
  GPIB0::22::INSTR: {device: meter}
  USB0::0x0957::0x0607::MY1::INSTR: {device: meter}
  GPIB0::9::INSTR: {device: picoammeter}
"""
USB = "USB0::0x0957::0x0607::MY1::INSTR"


@pytest.fixture
def backend(tmp_path):
    path = tmp_path / "meters.yaml"
    path.write_text(METERS)
    return f"?backend={path}@sim"


@pytest.mark.parametrize("resource", ["GPIB0::22::INSTR", USB])
def test_instrument_is_read_as_on_a_serial_line(backend, resource):
    with Line(f"visa:{resource}{backend}") as line:
        reader = scpi.Scpi(line, "force")
        assert reader.connect() == "HEWLETT-PACKARD,34401A,0,11-5-2"
        assert reader.read().value == 0.75


def test_instrument_is_not_read_without_a_question(backend):
    with Line(f"visa:GPIB0::22::INSTR{backend}") as line:
        reads = []
        line._port._resource.read_raw = lambda: reads.append(1)
        line.write(b"*CLS\n")
        with pytest.raises(LineTimeout):
            line.read_until(b"\n", 0.05)
    assert reads == []


def test_instrument_is_found_and_asked_for_nothing_else(backend):
    (found,) = find_devices([f"visa:GPIB0::9::INSTR{backend}"])
    assert (found.driver, found.identity[:8]) == ("scpi", "KEITHLEY")


def test_reading_with_status_unit_and_time_is_understood(backend):
    with Line(f"visa:GPIB0::9::INSTR{backend}") as line:
        reader = scpi.Scpi(line, "force")
        reader.connect()
        assert reader.read().value == 23.4


@pytest.mark.real_time
def test_gauge_of_a_recipe_is_at_gpib(backend):
    settings = MeasuringInstrument(
        driver="scpi", port=f"visa:GPIB0::22::INSTR{backend}", scale=10.0
    )
    operator = Operator(say=lambda text: None, present=False)
    begin = time.monotonic()
    with open_gauge("force", settings, operator) as gauge:
        assert "34401A" in str(gauge.report())
        while gauge.report()["readings"] < 3 and time.monotonic() - begin < 60:
            time.sleep(0.01)
    assert gauge.report()["readings"] >= 3


@pytest.mark.parametrize("port", ["nonsense{}", "{}", "GPIB0::22::INSTR?backend=@nothing"])
def test_what_is_no_instrument_is_refused(backend, port):
    with pytest.raises(HardwareError, match="cannot be opened"):
        Line(f"visa:{port.format(backend)}")


def test_missing_extra_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyvisa", None)
    with pytest.raises(UsageError, match=r"pip install rigtool\[visa\]"):
        Line("visa:GPIB0::22::INSTR")
