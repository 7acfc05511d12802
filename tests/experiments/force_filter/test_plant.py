"""The plant's equations against closed forms, an integrator, and their own derivatives."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from rigtool.experiments.force_filter.linear import ROW_LENGTH, backwards, forwards
from rigtool.experiments.force_filter.plant import (
    ANGLE,
    BRISTLE,
    FACTOR_COUNT,
    GRASPER,
    GRASPER_SPEED,
    HOUSING,
    NOISE,
    SPEED,
    STATES,
    TIP,
    TORQUE,
    Plant,
    _bend,
    advance,
    as_record,
)
from tests.experiments.force_filter.plants import PLANT, dahl

EYE = np.eye(STATES)
ALIKE = np.tile((1.0, 0.0), (9, 1))
"""Map of friction that is alike at all angles."""


def flat(matrix):
    """Return a matrix (12, n) as the equations take it, (12 * WIDE,)."""
    rows = np.zeros((STATES, ROW_LENGTH))
    rows[:, : matrix.shape[1]] = matrix
    return rows.ravel()


def step(plant, x, torque=0.0, viscous=0.0, count=1, rows=None):
    record = as_record(plant)[0]
    factors = None if rows is None else np.empty((1, FACTOR_COUNT))
    for _ in range(count):
        advance(x, record, plant.friction_map, torque, viscous, factors, 0, 0.0, 0.0)
        if rows is not None:
            forwards(rows, STATES, factors, 0)
    return x


def test_the_bearings_bristle_has_one_length_at_any_speed():
    for speed in (1e-6, 0.15, 0.3, 3.0):
        x = np.zeros(STATES)
        x[SPEED] = speed
        path = speed * PLANT.sample_time
        assert step(PLANT, x)[BRISTLE] == pytest.approx(dahl(0.0, path, 2e-3), rel=2e-6)


@settings(deadline=None, max_examples=100)
@given(z=st.floats(-1, 1), path=st.floats(-0.1, 0.1), x0=st.floats(1e-3, 0.1))
def test_a_bristle_bends_as_its_differential_equation_says(z, path, x0):
    side = np.sign(path) if path else 1.0
    exact = solve_ivp(
        lambda _, bent: side * (1 - side * bent) / x0, (0, abs(path)), [z], rtol=1e-10, atol=1e-12
    )
    found = _bend(z, path, 1.0, x0, 0.0)[0]
    assert found == pytest.approx(exact.y[0, -1], rel=1e-7, abs=1e-9)
    assert abs(found) <= 1.0
    # the path counts, not in how many steps it is gone
    parts = z
    for _ in range(7):
        parts = _bend(parts, path, 1 / 7, x0, 0.0)[0]
    assert parts == pytest.approx(found, rel=1e-9, abs=1e-12)


def test_a_bristle_that_bends_is_damped():
    """In a short sample, damping d takes static d (change of the bristle) / J off the speed."""

    def after(damping):
        x = np.zeros(STATES)
        x[[SPEED, GRASPER_SPEED]] = 0.05, 0.05 / 0.85
        return step(replace(PLANT, presliding_damping=damping, sample_time=2e-5), x)

    damped, free = after(1e-3), after(0.0)
    slower = PLANT.static * 1e-3 * free[BRISTLE] / PLANT.inertia
    assert free[SPEED] - damped[SPEED] == pytest.approx(slower, rel=0.02)


def test_friction_of_sliding_is_coulombs_and_the_tendon_carries_the_load():
    plant = replace(PLANT, static=PLANT.coulomb, asymmetry=0.0, housing_asymmetry=0.0)
    x = np.zeros(STATES)
    x[[SPEED, GRASPER_SPEED]] = 2.0, 2.0 / 0.85
    x[[BRISTLE, HOUSING, TIP]] = 1.0
    x[TORQUE] = 0.02
    carried = 0.02 + plant.tip_friction
    x[GRASPER] = -carried / plant.stiffness
    load = 0.102 * (np.hypot(carried, 1.8e-3) - 1.8e-3) / 1.18
    needed = plant.coulomb + carried / 1.18 + plant.housing_friction + load
    needed += (5e-5 + plant.housing_viscous) * 2.0
    plant = replace(plant, friction_map=ALIKE)
    step(plant, x, needed, 5e-5, count=400)
    assert x[SPEED] == pytest.approx(2.0, rel=1e-9)
    assert x[GRASPER_SPEED] == pytest.approx(2.0 / 0.85, rel=1e-9)


def test_the_grasper_swings_on_its_tendon_as_an_integrator_says():
    free = replace(
        PLANT, coulomb=0.0, static=0.0, housing_friction=0.0, tip_friction=0.0, load_friction=0.0
    )
    free = replace(
        free, sample_time=5e-6, presliding_damping=0.0, housing_viscous=0.0, friction_map=ALIKE
    )
    k, c, r, g = free.stiffness, free.damping, free.angle_ratio, free.torque_factor

    def swing(_, y):
        twist = k * (y[0] / r - y[2]) + c * (y[1] / r - y[3])
        return y[1], (3e-3 - twist / g) / free.inertia, y[3], (twist - 1e-3) / free.grasper_inertia

    exact = solve_ivp(swing, (0, 0.05), [0, 0, 0.1, 0], rtol=1e-10, atol=1e-12)
    x = np.zeros(STATES)
    x[[GRASPER, TORQUE]] = 0.1, 1e-3
    step(free, x, 3e-3, count=10000)
    found = x[[ANGLE, SPEED, GRASPER, GRASPER_SPEED]]
    np.testing.assert_allclose(found, exact.y[:, -1], rtol=2e-3)


def states(draw_bristle=0.9):
    bristle = st.floats(-draw_bristle, draw_bristle)
    speed = st.floats(0.05, 12).flatmap(lambda v: st.sampled_from([v, -v]))
    small = st.floats(-1e-3, 1e-3)
    return st.tuples(
        st.floats(-3, 3), speed, bristle, bristle, st.floats(-3, 3), speed, bristle,
        small, small, st.floats(-0.1, 0.1), small, st.floats(-0.05, 0.05),
    )  # fmt: skip


@pytest.mark.parametrize("free", [False, True])
@settings(deadline=None, max_examples=60)
@given(x=states())
def test_derivatives_are_those_of_small_differences(free, x):
    plant = replace(PLANT, grasper_inertia=0.0) if free else PLANT
    x = np.array(x)
    if not free:
        x[GRASPER] = x[ANGLE] / 0.85 + x[GRASPER] * 0.05  # the tendon is not stretched by turns
    rows = flat(EYE)
    step(plant, x.copy(), 0.01, 5e-5, count=3, rows=rows)
    rows = rows.reshape(STATES, ROW_LENGTH)[:, :STATES]
    scale = np.array([1e-3, 0.1, 0.1, 0.1, 1e-3, 0.1, 0.1, 1e-3, 1e-3, 0.1, 1e-3, 1e-2])
    for j in range(STATES):
        h = 1e-5 * scale[j] * EYE[j]
        ahead, behind = step(plant, x + h, 0.01, 5e-5, 3), step(plant, x - h, 0.01, 5e-5, 3)
        slope = (ahead - behind) / (2 * h[j])
        # relative to what the state moves by when each other state moves by its scale
        tolerance = 2e-3 * np.abs(rows * scale).max(axis=1) / scale[j]
        assert (np.abs(rows[:, j] - slope) <= tolerance).all(), j


def test_friction_by_load_has_the_slope_of_its_map():
    steep = replace(PLANT, friction_map=PLANT.friction_map * (1.0, 100.0))
    x = np.zeros(STATES)
    x[[ANGLE, SPEED, HOUSING, GRASPER, GRASPER_SPEED, TORQUE]] = 0.5, 2.0, 0.9, 0.37, 2.4, 0.04
    rows = flat(EYE)
    step(steep, x.copy(), rows=rows)
    h = 1e-6 * EYE[GRASPER]
    slope = (step(steep, x + h)[SPEED] - step(steep, x - h)[SPEED]) / 2e-6
    found = rows.reshape(STATES, ROW_LENGTH)[SPEED, GRASPER]
    assert found == pytest.approx(slope, rel=1e-6)
    rows = flat(EYE)
    step(replace(steep, friction_map=ALIKE), x.copy(), rows=rows)
    without = rows.reshape(STATES, ROW_LENGTH)[SPEED, GRASPER]
    assert abs(found - without) > 0.1 * abs(without)  # the slope is a part of it


@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 0.85]), st.integers(1, ROW_LENGTH))
def test_backwards_is_the_transpose_of_forwards(seed, shaft, columns):
    rng = np.random.default_rng(seed)
    factors = rng.normal(size=(2, FACTOR_COUNT))
    factors[:, -1] = shaft
    there, back = rng.normal(size=(2, STATES, ROW_LENGTH))
    forth, other = there.ravel().copy(), back.ravel().copy()
    forwards(forth, columns, factors, 1)
    backwards(other, columns, factors, 1)
    forth, other = forth.reshape(STATES, ROW_LENGTH), other.reshape(STATES, ROW_LENGTH)
    np.testing.assert_array_equal(forth[:, columns:], there[:, columns:])
    np.testing.assert_array_equal(other[:, columns:], back[:, columns:])
    used = slice(columns)
    products = back[:, used].T @ forth[:, used], other[:, used].T @ there[:, used]
    np.testing.assert_allclose(*products, rtol=1e-9, atol=1e-9)


def test_without_an_instrument_torque_acts_on_the_shaft():
    bare = replace(
        PLANT,
        grasper_inertia=0.0,
        angle_ratio=1.0,
        torque_factor=1.0,
        coulomb=0.0,
        static=0.0,
        housing_friction=0.0,
        housing_viscous=0.0,
        tip_friction=0.0,
        load_friction=0.0,
        friction_map=ALIKE,
    )
    x = np.zeros(STATES)
    x[TORQUE] = 4e-3
    step(bare, x, 1e-3, count=800)
    assert x[SPEED] == pytest.approx(-3e-3 / bare.inertia * 0.1, rel=1e-9)
    assert x[GRASPER] == x[ANGLE]


def test_noise_and_loads_stay_from_sample_to_sample():
    x = np.zeros(STATES)
    x[[NOISE, TORQUE]] = 1e-4, 2e-3
    step(PLANT, x, count=5)
    assert (x[NOISE], x[TORQUE]) == (1e-4, 2e-3)
    assert isinstance(PLANT, Plant)
