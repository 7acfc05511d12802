"""A drive whose tendon, friction and ripple are known gives them back, and its loads."""

import math

import numpy as np
import pytest

from rigtool.errors import InsufficientDataError
from rigtool.experiments.load_disturbance.fit import fit_disturbance, refit_disturbance
from rigtool.experiments.load_disturbance.model import Disturbance, LoadedPair
from rigtool.experiments.load_disturbance.reading import dead_band, read_load
from rigtool.experiments.load_disturbance.tendon import Tendon
from tests.experiments.load_disturbance.known_drive import CONSTANT, DRIVE, TENDON, TURN, cycles

SPEEDS = (0.5, 1.5)
LOADS = (0.002, 0.01, 0.03, 0.06)
SCATTER = 0.1e-3


@pytest.fixture(scope="module")
def unloaded():
    return {speed: [cycles(0.0, speed, scatter=SCATTER, seed=90)] for speed in SPEEDS}


def compared(unloaded, loads, **changes):
    pairs = [(speed, load) for speed in SPEEDS for load in loads]
    found = []
    for number, (speed, load) in enumerate(pairs):
        loaded = cycles(load, speed, scatter=SCATTER, seed=number, **changes)
        found.append(LoadedPair.of(loaded, unloaded[speed], TURN))
    return found, [load for _, load in pairs]


@pytest.fixture(scope="module")
def known(unloaded):
    return compared(unloaded, LOADS)


@pytest.fixture(scope="module")
def learned(known):
    return fit_disturbance(*known)


def test_the_tendon_comes_back(learned):
    u = np.sqrt(np.diag(learned.covariance)[:3])
    assert learned.tendon.stiffness == pytest.approx(TENDON.stiffness, abs=3 * u[0])
    assert learned.tendon.stiffness == pytest.approx(TENDON.stiffness, rel=0.02)
    assert learned.tendon.tip_friction == pytest.approx(TENDON.tip_friction, abs=0.6e-3)


@pytest.mark.parametrize("load", [0.005, 0.02, 0.05])
def test_loads_between_the_learned_ones_are_read(learned, unloaded, load):
    for pair in compared(unloaded, [load])[0]:
        found = read_load(learned, pair, math.pi / 2)
        assert found.moment == pytest.approx(load, abs=max(0.005 * load, 3 * found.u))
        assert found.at_angle.mean() == pytest.approx(load, rel=0.03, abs=0.1e-3)
        assert found.cycles.std(ddof=1) == pytest.approx(SCATTER, rel=1)


def test_the_dead_band_is_half_of_what_lifting_and_lowering_differ_by(unloaded):
    found = dead_band(compared(unloaded, [0.05])[0][0], math.pi / 2)
    # 10 mN m without load, a tenth of the load beyond the onset, the joint's own
    assert found.half == pytest.approx(10e-3 + 0.1 * 48e-3 + 0.8e-3, rel=0.1)
    assert found.middle == pytest.approx(0.05, rel=0.05)


def test_a_friction_level_that_drifts_moves_no_reading(learned, unloaded):
    still, drifted = (compared(unloaded, [0.02], drift=drift)[0][0] for drift in (0.0, 1e-3))
    first, second = (read_load(learned, each, math.pi / 2).moment for each in (still, drifted))
    assert second == pytest.approx(first, rel=3e-3)


def test_a_load_left_out_of_the_learning_is_read(learned, known):
    pairs, moments = known
    without = [i for i, moment in enumerate(moments) if moment != 0.03]
    less = refit_disturbance(learned, [pairs[i] for i in without], [moments[i] for i in without])
    left = moments.index(0.03)
    assert read_load(less, pairs[left], math.pi / 2).moment == pytest.approx(0.03, rel=0.01)


@pytest.mark.parametrize("load", [0.001, 0.01, 0.03, 0.04, 0.05, 0.06])
def test_a_load_that_swings_near_its_resonance_is_found(load):
    """At 50 mN m a search from the mean torque alone ends at 14 mN m, which fits less well."""
    soft = Tendon(0.1, 4e-4, 0.0)
    drive = {"friction": 0.0, "ripple": 0.0, "tendon": soft, "scatter": 0.02e-3}
    pair = LoadedPair.of(cycles(load, 1.8, **drive), [cycles(0.0, 1.8, **drive)], TURN)
    plain = Disturbance((), soft, np.zeros(0), np.zeros((3, 3)), 0.06, (pair.loaded.speed,))
    found = read_load(plain, pair, math.pi / 2)
    assert found.moment == pytest.approx(load, rel=0.03, abs=0.05e-3)


def test_a_load_far_beyond_the_learned_ones_is_refused(learned, unloaded):
    pair = compared(unloaded, [0.25], tendon=Tendon(50.0, 1e-2, 0.0))[0][0]
    with pytest.raises(
        InsufficientDataError, match="no load up to 3 times the largest learned one, 60 mN m"
    ):
        read_load(learned, pair, math.pi / 2)


def test_the_sum_of_components_is_u(learned, known):
    found = read_load(learned, known[0][2], math.pi / 2)
    assert found.u == pytest.approx(math.hypot(*found.components.values()), rel=1e-9, abs=0)
    assert set(found.components) == {"scatter", "zero", "disturbance", "misfit"}


def test_torque_is_that_of_the_motor_less_its_own_inertia():
    held = cycles(0.0, 1.5, friction=0.0, ripple=0.0, tendon=Tendon(0.25, 1e-3, 0.0))
    middle = held.crossing(math.pi / 2 * DRIVE.angle_ratio, 1)
    assert held.at(held.mean, middle) == pytest.approx(10e-3, rel=0.05)
    assert held.torque_per_ampere == pytest.approx(DRIVE.torque_factor * CONSTANT, rel=1e-9, abs=0)
