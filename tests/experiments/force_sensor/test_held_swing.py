"""A rotor that is held shows nothing of a load that swings; u holds that it may go on to."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from rigtool.experiments.deploy.force_sensor import sensor_header
from rigtool.experiments.force_filter.motion_states import State
from rigtool.experiments.force_sensor import sensor
from rigtool.experiments.force_sensor.stretch import Stretch
from tests.experiments.deploy.sensors import INTERVAL, compiled, expected, instrument, moved
from tests.experiments.force_sensor.test_rest_between_forms import Certain

TIME = np.arange(round(6.0 / INTERVAL)) * INTERVAL
STROKES = np.abs(1.6 * np.minimum(TIME, 3.6) % 2 - 1) - 0.5
AMPLITUDE = 2.5e-3


@pytest.fixture(scope="module")
def samples():
    """Return strokes that end in a rest, with a force that swings, or did, and without one."""
    swing = AMPLITUDE * np.sin(2 * np.pi * 5 * TIME)
    loads = {"goes on": swing, "ended": np.where(TIME < 3.6, swing, 0.0), "none": 0.0 * TIME}
    return {name: moved(STROKES, load) for name, load in loads.items()}


def both_forms(samples):
    """Return time, torque, u and where the rotor stands still, smoothed and causal."""
    own = instrument(model=Certain())
    with ThreadPoolExecutor(1) as worker:
        reader = Stretch("swing", own, 0.0, len(TIME), (worker, worker))
        reader.add(samples)
        (rows,) = reader.reading()
    for torque, u, states in (
        (rows.torque, rows.u, rows.states),
        (rows.causal, rows.causal_u, rows.causal_states),
    ):
        yield rows.time, torque, u, (states == State.STILL) & (np.abs(rows.time - 4.7) < 1.1)


def test_at_rest_u_holds_the_swing_of_before_in_both_forms(samples):
    for name in ("goes on", "ended"):
        for (time, torque, u, still), (*_, without, rests) in zip(
            both_forms(samples[name]), both_forms(samples["none"]), strict=True
        ):
            assert still.sum() > 100
            assert u[still].min() > 0.7 * AMPLITUDE / np.sqrt(2)
            # later a load may hide within the count whether one swung or not
            begins = without[rests & (time < 4.0)]
            assert begins.max() < 0.3 * AMPLITUDE
            if name == "goes on":
                truth = AMPLITUDE * np.sin(2 * np.pi * 5 * time)
                assert np.mean(np.abs(torque - truth)[still] < 1.96 * u[still]) > 0.9
                assert np.mean(np.abs(torque - truth)[still] < 1.96 * begins.max()) < 0.7


def test_the_filter_may_take_a_part_of_a_swing_in_both_forms(monkeypatch):
    """5 % of its amplitude, a rectangle from 0 on; of 5 Hz a mean over 0.1 s leaves 0.91 of v."""
    swing = moved(STROKES, AMPLITUDE * np.sin(2 * np.pi * 5 * TIME))
    counted = [*both_forms(swing)]
    monkeypatch.setattr(sensor, "TAKEN_VARIANCE", 0.0)
    for (time, _, u, _), (*_, without, _) in zip(counted, both_forms(swing), strict=True):
        more = (u**2 - without**2)[np.abs(time - 3.0) < 0.5]
        assert np.median(more) == pytest.approx(
            0.05**2 / 3 * 0.91 * AMPLITUDE**2 / 2, rel=0.2, abs=0
        )


def test_no_more_than_friction_changes_by_within_a_count():
    strong = moved(STROKES, np.where(TIME < 3.6, 20e-3 * np.sin(2 * np.pi * 5 * TIME), 0.0))
    own = instrument(model=Certain())
    found = expected(own, strong)
    still = (found[:, 4] == State.STILL) & (np.arange(len(found)) > 5000)
    assert still.sum() > 500
    assert found[still, 1].max() < 1.5 * np.sqrt(own.held_variance)


@pytest.mark.compiles
def test_the_sensor_in_c_holds_it_as_well(samples, tmp_path):
    own = instrument()
    found = compiled(tmp_path, sensor_header(own, 1.96, ("rig",)), "-O2").add(samples["goes on"])
    wanted = expected(own, samples["goes on"])
    assert np.count_nonzero(wanted[4000:, 4] == State.STILL) > 1000
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-9 * own.reach.torque)
