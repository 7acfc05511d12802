"""The look at the loop: distances that the controller's torque explains or not."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import sosfreqz

from rigtool.control.position_loop import controller_sections
from rigtool.errors import InsufficientDataError
from rigtool.experiments.controller_torque import (
    UNEXPLAINED_DISTANCE,
    require_tracking,
    smallest_gain,
)
from rigtool.recipe import load_recipe

RECIPE = load_recipe(Path(__file__).parents[2] / "recipes" / "briaire-2006.toml", ())[0]


def look(controller=0.5, distance=0.0):
    require_tracking(RECIPE, largest_controller=controller, distance=distance)


@given(st.floats(0, 9), st.floats(0.5, 50))
def test_whatever_a_sine_makes_the_controller_ask_for_is_believed(amplitude, frequency):
    """A sine of the distance asks for |C| times itself: no torque, no distance."""
    rig = RECIPE.rig
    sections = controller_sections(**rig.loop_design)
    gain = abs(sosfreqz(sections, [frequency], fs=1 / rig.sample_time)[1][0])
    distance = amplitude * rig.torque_constant / gain
    look(controller=amplitude, distance=distance)
    with pytest.raises(InsufficientDataError, match="rad off its set point"):
        look(controller=0.0, distance=distance + UNEXPLAINED_DISTANCE * 1.001)


def test_the_gain_grows_with_the_square_of_the_crossover():
    faster = load_recipe(
        Path(__file__).parents[2] / "recipes" / "briaire-2006.toml",
        ("rig.controller.crossover_hz=100", "rig.controller.integrator_hz=8"),
    )[0]
    ratio = smallest_gain(faster) / smallest_gain(RECIPE)
    assert ratio == pytest.approx(4, rel=0.1)
    assert np.isfinite(ratio)
