"""What a procedure states of its recordings, against what was recorded."""

from pathlib import Path

import numpy as np
import pytest

from rigtool.experiments.force import procedure as measure_force
from rigtool.experiments.friction import procedure as stribeck
from rigtool.experiments.learning import procedure as ilc_learn
from rigtool.experiments.plant import procedure as identify_plant
from rigtool.experiments.ripple import procedure as fft_ripple
from rigtool.experiments.torque_constant import procedure as calibrate_kt
from rigtool.runfile import open_run

FIXTURES = Path(__file__).parents[1] / "fixtures"


@pytest.mark.parametrize(
    ("procedure", "name"),
    [
        (calibrate_kt, "kt"),
        (stribeck, "friction"),
        (fft_ripple, "ripple"),
        (identify_plant, "plant"),
        (ilc_learn, "tables"),
        (ilc_learn, "turning"),
        (measure_force, "force"),
    ],
)
def test_samples_are_as_far_apart_as_stated(procedure, name):
    """By it a chunk of about a second is found, and what a killed run loses."""
    with open_run(FIXTURES / f"{name}.h5") as run:
        recipe = run.recipe
        for spec in procedure.recordings(recipe):
            step = float(np.median(np.diff(run.recording(spec.name).read("time"))))
            assert step / recipe.rig.sample_time == pytest.approx(spec.record_every, rel=1e-6)
