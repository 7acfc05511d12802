"""What can be simulated is simulated without growing; what cannot is refused with the bound."""

import numpy as np
import pytest

from rigtool.errors import RecipeError
from rigtool.recipe import load_recipe
from rigtool.rigs import Task
from rigtool.rigs.motion import CurrentSteps
from rigtool.rigs.virtual import VirtualRig

RECIPE = "recipes/briaire-2006.toml"
FREE = ("virtual.instrument.tip_friction=0", "virtual.instrument.load_friction=0")
TENDON = "virtual.instrument.stiffness"


def rig_with(*overrides):
    return VirtualRig(load_recipe(RECIPE, overrides)[0], 0.045, "test")


def kicked(rig):
    """Return the encoder over half a second in which the tendon is free to ring."""
    task = Task(CurrentSteps((0.0, 0.5, 0.0, 0.0), 0.125))
    return np.concatenate([block["encoder"] for block in rig.perform(task)])


def bound(*overrides):
    with pytest.raises(RecipeError, match="beyond what can be simulated") as caught:
        rig_with(*overrides, f"{TENDON}=1e6")
    return float(str(caught.value).split("inertias, ")[1].split(" N m/rad")[0])


def test_the_bound_is_where_samples_still_show_the_oscillation():
    highest = bound(*FREE)
    assert 300 < highest < 600
    assert np.abs(kicked(rig_with(*FREE, f"{TENDON}={0.98 * highest}"))).max() < 1e5


@pytest.mark.parametrize(
    ("override", "what"),
    [
        ("virtual.arm.stiffness=1e7", "virtual.arm.stiffness 1e\\+07 N m/rad"),
        ("virtual.thermal.winding_capacity=1e-4", "thermal resistances and capacities"),
    ],
)
def test_other_values_that_cannot_be_simulated_are_refused(override, what):
    with pytest.raises(RecipeError, match=what):
        rig_with(override)


def test_a_slower_loop_has_a_lower_bound():
    assert bound("rig.sample_time=250e-6") < 0.3 * bound()
