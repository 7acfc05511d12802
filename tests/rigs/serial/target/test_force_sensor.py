"""The exported force sensor in the loop of the target in C, sample by sample at 8 kHz."""

import os
import shutil
import subprocess
import tty

import numpy as np
import pytest

from rigtool.experiments.deploy.force_sensor import sensor_header
from rigtool.rigs.serial.emulators.server import serve
from tests.experiments.deploy.sensors import REACH, expected, instrument
from tests.rigs.performed import perform
from tests.rigs.serial.emulators.firmware import Bare, Firmware, build, library, pointer
from tests.rigs.serial.target.test_driver import TRIANGLE, as_stored, target_rig, virtual
from tests.rigs.serial.target.test_firmware import PROFILES, STRICTER

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler cc")

ROUNDING = 1e-6 * REACH.torque
"""The host receives currents as 4-byte floats."""


@pytest.fixture
def header(tmp_path):
    """Export the sensor that the target in C is built with."""
    (tmp_path / "sensor.h").write_text(sensor_header(instrument(), 1.96, ["test"]))
    return tmp_path


def require_those_of_the_host(readings, got):
    """Compare readings of the loop with those that the host computes from the samples it got."""
    names = ("encoder", "current_setpoint", "temperature")
    wanted = expected(
        instrument(), np.stack([as_stored(got)[name].astype(float) for name in names])
    )
    assert len(wanted) > 500
    assert np.isfinite(wanted[:, 0]).mean() > 0.5
    np.testing.assert_array_equal(readings[:, 4], wanted[:, 4])
    np.testing.assert_allclose(readings, wanted, rtol=0, atol=ROUNDING)


def test_the_target_reads_what_the_host_reads_from_its_samples(header, monkeypatch):
    """On the motor of the virtual rig, with its friction and ripple."""
    monkeypatch.setattr(Bare, "c", library(header, *STRICTER, "-DWITH_SENSOR"))
    with serve(Firmware(virtual())) as server, target_rig(server.port) as rig:
        got = perform(rig, TRIANGLE)
    assert server.error is None
    readings = np.empty((20000, 5))
    require_those_of_the_host(readings[: Bare.c.firmware_readings(pointer(readings))], got)


@pytest.mark.real_time
def test_over_a_pseudo_terminal_under_the_sanitizers(header):
    """As a program of its own."""
    flags = ("-DFIRMWARE_MAIN", "-DWITH_SENSOR", "-D_POSIX_C_SOURCE=200809L", "-g")
    program = build(header, "target", *flags, "-fsanitize=address,undefined")
    master, slave = os.openpty()
    tty.setraw(slave)
    with subprocess.Popen(
        [program, str(master)], pass_fds=[master], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as process:
        os.close(master)
        more = ("rig.attachment=pulley", "serial.watchdog=5")
        with target_rig(os.ttyname(slave), *more, "serial.log=stream") as rig:
            got = perform(rig, PROFILES[1])
            angle = got["encoder"] * 2 * np.pi / 4000
            assert np.abs(angle - got["position_setpoint"]).max() < 0.05
        os.close(slave)
        out, err = process.communicate(timeout=60)
    assert (process.returncode, err) == (0, b"")
    require_those_of_the_host(np.frombuffer(out).reshape(-1, 5), got)
