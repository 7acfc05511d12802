"""At rest the smoothed torque spreads what comes later, and a load may come and go unseen; u holds
both."""

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


def read(samples):
    with ThreadPoolExecutor(1) as worker:
        size = samples.shape[1]
        stretch = Stretch("rest", instrument(model=Certain()), 0.0, size, (worker, worker))
        stretch.add(samples)
        (rows,) = stretch.reading()
    return rows


def test_a_load_that_comes_at_the_end_of_a_rest_is_within_the_intervals_before_it():
    size = round(20.0 / INTERVAL)
    contact = np.where(np.arange(size) * INTERVAL < 18.0, 0.0, 0.02)
    rows = read(moved(np.zeros(size), contact))
    rest = (rows.time > 2.0) & (rows.time < 17.9) & (rows.states == State.STILL)
    apart = np.abs(rows.torque - rows.causal)[rest]
    assert rest.sum() > 1000
    assert apart.max() > 4e-3
    assert np.mean(rows.u[rest] > 0.99 * apart / np.sqrt(3)) > 0.95
    assert np.mean(np.abs(rows.torque[rest]) < 1.96 * rows.u[rest]) > 0.95


def test_a_load_that_comes_and_goes_within_a_count_is_within_the_intervals():
    """From 0.25 s after the last edge on, which is what the causal form knows, and to 0.25 s before
    the next one; u is that of a rectangle as wide as friction changes within half a count."""
    time = np.arange(round(8.0 / INTERVAL)) * INTERVAL
    strokes = 0.15 * (1 - np.cos(3 * np.pi * np.minimum(time, 2.0)))
    angle = 0.2 + strokes + 0.1 * np.clip(time - 7.0, 0.0, None)
    samples = moved(angle, np.where((time > 5.0) & (time < 6.0), 1.5e-3, 0.0))
    passed = np.flatnonzero(np.diff(samples[0])) * INTERVAL
    came, goes = passed[passed < 7.0].max(), passed[passed > 7.0].min()
    assert came < 3.0  # no edge shows the load
    rows, plant = read(samples), Model().plant(INTERVAL)
    slope = plant.static / plant.presliding_angle
    slope += plant.housing_friction / plant.housing_presliding_angle
    hides = plant.torque_factor * slope * instrument().count / 2
    touched = (rows.time > 5.05) & (rows.time < 5.95)
    for torque, u, end in (
        (rows.torque, rows.u, goes - 0.27),
        (rows.causal, rows.causal_u, goes - 0.01),
    ):
        unseen = (rows.time > came + 0.27) & (rows.time < end)
        assert u[unseen].min() > 0.999 * hides / np.sqrt(3)
        assert (np.abs(torque[touched] - 1.5e-3) < 1.96 * u[touched]).all()
