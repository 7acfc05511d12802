"""The exported force sensor in the loop of the emulated target, sample by sample at 8 kHz."""

import shutil

import numpy as np
import pytest

from rigtool.experiments.deploy.force_sensor import sensor_header
from rigtool.rigs.serial.emulators.server import serve
from rigtool.rigs.serial.emulators.target import TargetEmulator
from tests.experiments.deploy.sensors import REACH, compiled, expected, instrument
from tests.rigs.serial.target.test_driver import TRIANGLE, as_stored, blocks_of, target_rig, virtual

NEEDED = ("encoder", "current_setpoint", "temperature")


class SensingTarget(TargetEmulator):
    """A target whose firmware has the sensor: it reads each sample of the loop, before the link."""

    def __init__(self, recipe, sensor):
        super().__init__(recipe)
        self.sensor, self.readings = sensor, []

    def _advance(self):
        before = self._log.recorded
        super()._advance()
        if self._log.recorded > before:
            block = as_stored({name: self._block[name] for name in NEEDED})
            for sample in np.stack([block[name] for name in NEEDED]).astype(float).T:
                self.readings.extend(self.sensor.add(sample[:, None]))


@pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler cc")
def test_the_target_reads_what_the_host_reads_from_its_samples(tmp_path):
    own = instrument()
    sensor = compiled(tmp_path, sensor_header(own, 1.96, ["emulated"]))
    target = SensingTarget(virtual(), sensor)
    with serve(target) as server, target_rig(server.port) as rig:
        got = blocks_of(rig, TRIANGLE)
    assert server.error is None
    samples = np.stack([as_stored(got)[name].astype(float) for name in NEEDED])
    wanted = expected(own, samples)
    assert len(wanted) > 500
    assert np.isfinite(wanted[:, 0]).mean() > 0.5
    np.testing.assert_allclose(np.array(target.readings), wanted, rtol=0, atol=1e-9 * REACH.torque)
