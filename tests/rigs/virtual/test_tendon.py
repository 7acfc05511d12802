"""The tendon over one step: its poles, and its twist under a load, are those of the equations."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm

from rigtool.recipe import load_recipe
from rigtool.rigs import Task
from rigtool.rigs.motion import CurrentSteps
from rigtool.rigs.virtual import VirtualRig
from rigtool.rigs.virtual.tendon import step_terms

RECIPE = "recipes/briaire-2006.toml"
FREE = (
    *(f"virtual.motor.{name}=0" for name in ("coulomb_friction", "static_friction")),
    *(f"virtual.motor.{name}=0" for name in ("viscous_friction", "friction_noise")),
    *(f"virtual.instrument.{name}=0" for name in ("friction", "tip_friction", "load_friction")),
    *(f"virtual.instrument.{name}=0" for name in ("viscous_friction", "stroke_noise", "drift")),
    *(f"virtual.amplifier.{name}=[]" for name in ("offset_ripple", "gain_ripple")),
    "virtual.amplifier.saturation_ripple=[]",
    "virtual.amplifier.offset=0",
    "virtual.motor.cogging=[]",
    "virtual.eccentricity.offset=0",
    "rig.encoder_counts=4000000000",
)


@given(
    st.floats(0.01, 5.0),
    st.floats(0.0, 5e-3),
    st.floats(1e5, 2e6),
    st.sampled_from([125e-6, 1e-3]),
)
def test_the_step_has_the_poles_and_the_rest_of_the_equation(stiffness, damping, mobility, step):
    if mobility * stiffness * step**2 > 4:
        return
    by_angle, by_speed, by_drive = step_terms(stiffness, damping, mobility, step)
    exact = expm(step * np.array([[0, 1], [-mobility * stiffness, -mobility * damping]]))
    pull, drag = step * mobility * by_angle, step * mobility * by_speed
    ours = np.array([[1 - step * pull, step * (1 - drag)], [-pull, 1 - drag]])
    assert np.trace(ours) == pytest.approx(np.trace(exact), rel=0, abs=1e-9)
    assert np.linalg.det(ours) == pytest.approx(np.linalg.det(exact), rel=0, abs=1e-9)
    # At rest the torque that drives is carried in full: k e = a/mu.
    carried = by_angle / stiffness + by_drive * mobility
    assert carried == pytest.approx(1.0, rel=1e-9, abs=0)


@pytest.mark.parametrize("sample_time", [125e-6, 1e-3])
def test_the_rig_rings_as_its_recipe_says(sample_time):
    recipe, _ = load_recipe(RECIPE, (*FREE, f"rig.sample_time={sample_time}"))
    rig = VirtualRig(recipe, 0.045, "test")
    got = np.concatenate(
        [block["encoder"] for block in rig.perform(Task(CurrentSteps((0.2, 0.0), 0.03)))]
    )
    free = got[round(0.032 / sample_time) :]
    tool, scale = recipe.virtual.instrument, recipe.rig.instrument
    inertia = recipe.virtual.motor.inertia + tool.wheel_inertia
    mobility = 1 / (scale.angle_ratio * scale.torque_factor * inertia) + 1 / tool.grasper_inertia
    root = np.roots([1, mobility * tool.damping, mobility * tool.stiffness])[0]
    time = np.arange(len(free)) * sample_time
    ringing = np.exp(root * time)
    terms = np.column_stack([np.ones(len(free)), time, ringing.real, ringing.imag])
    found = np.linalg.lstsq(terms, free, rcond=None)[0]
    assert np.hypot(*found[2:]) > 1e4  # counts
    np.testing.assert_allclose(free, terms @ found, rtol=0, atol=2.0)
