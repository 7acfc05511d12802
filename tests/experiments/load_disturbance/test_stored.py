"""What a rising reading holds besides a load, from stored tables, by the tendon's equations."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from rigtool.experiments.load_disturbance.sliding import disturbance, grid_of
from rigtool.experiments.load_disturbance.stored import (
    DISTURBANCE,
    LOAD_FRICTION,
    grid_tables,
    rising_load,
)
from rigtool.quantity import STANDARD_GRAVITY
from rigtool.recipe import load_recipe
from tests.experiments.load_disturbance.known_drive import CONSTANT, KNOWN
from tests.experiments.load_disturbance.test_sliding import SHAPE, model_of
from tests.experiments.virtual_runs import RECIPE

MOMENTS = np.array([0.01, 0.03, 0.05])
ANGLE = math.radians(80)
FRICTION, GAIN = 0.1, 2e-3


@pytest.fixture(scope="module")
def rig():
    recipe, _ = load_recipe(RECIPE, ("measure_force.measure_angle=80",))
    assert recipe.rig.angle_ratio == KNOWN.angle_ratio
    speed = 2 * math.pi * recipe.measure_force.speed_rev_per_s * KNOWN.angle_ratio
    model = model_of([GAIN, 0, FRICTION, 0], replace(SHAPE, tip_friction=0.8e-3))
    angles, loads = np.linspace(0.2, 2.9, 61), np.r_[0:0.006:13j, 0.01:0.06:11j]
    grid = grid_of(model, [speed, 2 * speed], angles, loads, CONSTANT)
    stored = grid_tables(grid, recipe)
    return recipe, model, speed, stored


def shown_by(moment, rig, model):
    """Return what loads add to the tendon at an even speed: its stretch turns them back, and they
    speed up while it shortens. Derivatives along a way are those of the round before."""
    recipe, shape = rig[0], model.shape
    angle = ANGLE + np.linspace(-0.5, 0.5, 2001)
    time = angle / (2 * math.pi * recipe.measure_force.speed_rev_per_s)
    inertia = moment[:, None] * recipe.rig.load_arm / STANDARD_GRAVITY + shape.grasper_inertia
    stretch = np.zeros((len(moment), len(angle)))
    for _ in range(4):
        rate = np.gradient(stretch, time, axis=1)
        swung = inertia * np.gradient(rate, time, axis=1)
        for _ in range(100):
            added = moment[:, None] * np.sin(angle - stretch) - swung
            stretch = (added + shape.tip_friction - shape.damping * rate) / shape.stiffness
    return added[:, len(angle) // 2]


def rising(rig, model, added):
    recipe, _, _, stored = rig
    tables = SimpleNamespace(table=lambda name, *axes, **units: stored[name])
    return rising_load(tables, recipe, model, added)


def test_a_load_comes_back_with_its_friction_and_what_remains(rig):
    _, model, speed, _ = rig
    added = shown_by(MOMENTS, rig, model)
    found = rising(rig, model, added)
    np.testing.assert_allclose(found.torque, MOMENTS * math.sin(ANGLE), rtol=1e-5)
    tip, onset = model.shape.tip_friction, model.shape.load_onset
    grown = np.hypot(added + tip, onset) - np.hypot(tip, onset)
    np.testing.assert_allclose(found.friction, FRICTION * grown, rtol=0.01, atol=2e-6)
    late = 3 * speed * model.shape.ripple_time
    wave = math.sin(3 * KNOWN.angle_ratio * ANGLE) / (1 + late**2)  # mean of both directions
    np.testing.assert_allclose(found.remains, GAIN * wave * added, rtol=0.02)


def test_u_is_that_of_friction_and_of_the_stretch(rig):
    _, model, speed, _ = rig
    added = shown_by(MOMENTS, rig, model)
    found = rising(rig, model, added)
    step = 1e-4
    softer, stiffer = (
        rising(rig, replace(model, shape=replace(SHAPE, stiffness=own)), added).torque
        for own in SHAPE.stiffness * np.exp([-step, step])
    )
    by_stiffness = (stiffer - softer) / (2 * step)
    names = ("tip_length", "stribeck_speed", "ripple_time", "stiffness")
    relative = math.sqrt(np.diag(model.covariance)[names.index("stiffness")])
    (_, up), (_, down) = (
        disturbance(model, np.array([ANGLE]), added + 0.8e-3, way * speed, CONSTANT)
        for way in (1, -1)
    )
    by = (up - down)[:, 0] / 2
    friction = np.einsum("pl,pq,ql->l", by, model.covariance, by)
    expected = np.sqrt(friction + (by_stiffness * relative) ** 2)
    np.testing.assert_allclose(found.u, expected, rtol=0.02)


def test_tables_hold_both_directions_and_friction_of_one(rig):
    recipe, _, speed, stored = rig
    whole, friction = stored[DISTURBANCE], stored[LOAD_FRICTION]
    np.testing.assert_allclose(whole["speed"], speed * np.array([-2, -1, 1, 2]), rtol=1e-12)
    np.testing.assert_allclose(friction["speed"], speed * np.array([1, 2]), rtol=1e-12)
    assert whole["position"][-1] == pytest.approx(2.9 * recipe.rig.angle_ratio)
    half = (whole["torque"][2:] - whole["torque"][1::-1]) / 2
    np.testing.assert_allclose(friction["torque"], half, rtol=1e-12)
