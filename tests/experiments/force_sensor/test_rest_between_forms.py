"""At rest the smoothed torque spreads what comes later; u holds that it may have come at once."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from rigtool.experiments.force_filter.motion_states import State
from rigtool.experiments.force_sensor.stretch import Stretch
from tests.experiments.deploy.sensors import INTERVAL, Model, instrument, moved


@dataclass(frozen=True)
class Certain(Model):
    """Finds no contacts, and takes a fifth of the filter's deviation for u."""

    limits: ClassVar = np.full((3, 2), np.inf)
    scales: ClassVar = np.tile([0.2, 0.0], (2, 6, 1))


def test_a_load_that_comes_at_the_end_of_a_rest_is_within_the_intervals_before_it():
    size = round(20.0 / INTERVAL)
    contact = np.where(np.arange(size) * INTERVAL < 18.0, 0.0, 0.02)
    samples = moved(np.zeros(size), contact)
    with ThreadPoolExecutor(1) as worker:
        stretch = Stretch("rest", instrument(model=Certain()), 0.0, size, (worker, worker))
        stretch.add(samples)
        (rows,) = stretch.reading()
    rest = (rows.time > 2.0) & (rows.time < 17.9) & (rows.states == State.STILL)
    apart = np.abs(rows.torque - rows.causal)[rest]
    assert rest.sum() > 1000
    assert apart.max() > 4e-3
    assert np.mean(rows.u[rest] > 0.99 * apart / np.sqrt(3)) > 0.95
    assert np.mean(np.abs(rows.torque[rest]) < 1.96 * rows.u[rest]) > 0.95
