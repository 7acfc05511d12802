"""Where a load changes, the filter raises its noise, and its deviation counts whole."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from rigtool.experiments.force_sensor.stretch import Stretch
from tests.experiments.deploy.sensors import INTERVAL, Model, instrument, moved

BEGINS = 3.0


@dataclass(frozen=True)
class Whole(Model):
    """Finds no contacts, and takes the filter's deviation for u."""

    limits: ClassVar = np.full((3, 2), np.inf)
    scales: ClassVar = np.tile([1.0, 0.0], (2, 6, 1))


@dataclass(frozen=True)
class Half(Whole):
    scales: ClassVar = np.tile([0.5, 0.0], (2, 6, 1))


def test_both_forms_have_the_whole_deviation_about_a_step_and_the_factor_elsewhere():
    time = np.arange(round(5.0 / INTERVAL)) * INTERVAL
    samples = moved(0.5 * np.sin(3.1 * time), np.where(time < BEGINS, 0.0, 0.04))
    found = []
    for model in (Whole(), Half()):
        with ThreadPoolExecutor(1) as one, ThreadPoolExecutor(1) as other:
            stretch = Stretch("", instrument(model=model), 0.0, len(time), (one, other))
            stretch.add(samples)
            found += stretch.reading()
    whole, half = found
    since = whole.time - BEGINS
    for u, less, before in (
        (whole.u, half.u, -0.02),
        (whole.causal_u, half.causal_u, 0.015),
    ):
        about = (since > before) & (since < 0.05)
        np.testing.assert_array_equal(less[about], u[about])
        quiet = ((since > -1.0) & (since < -0.2)) | (since > 1.0)
        assert np.mean(less[quiet] < u[quiet]) > 0.8
