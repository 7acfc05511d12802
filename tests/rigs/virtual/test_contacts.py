"""What touches the virtual rig: weights, forces and tissue as mechanics says; drawn by seed."""

import itertools
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rigtool.quantity import STANDARD_GRAVITY
from rigtool.recipe import load_recipe
from rigtool.recipe.virtual import Mass, Pulse, Ramp, Sine, Tissue
from rigtool.rigs import Feedforward, Load, Task, open_rig
from rigtool.rigs.motion import CurrentSteps, SpeedProfile, Triangle
from rigtool.rigs.virtual import contacts
from rigtool.signals import CHANNELS
from tests.rigs.performed import perform

RECIPE = Path(__file__).parents[3] / "recipes" / "briaire-2006.toml"
KT, RADIUS, RATIO = 0.0454, 0.020, 0.85
MOTION = Triangle(0.0, 2.67, 2.0, 0.3, 1)
STEADY = (  # nothing is drawn that depends on the length of a block
    "virtual.motor.friction_noise=0",
    "virtual.instrument.drift=0",
    "virtual.instrument.stroke_noise=0",
    "virtual.instrument.load_stroke_noise=0",
)
FREE = (  # nothing but inertia
    "rig.attachment=pulley",
    "virtual.motor.friction_noise=0",
    "virtual.motor.coulomb_friction=0",
    "virtual.motor.static_friction=0",
    "virtual.motor.viscous_friction=0",
    "virtual.motor.cogging=[]",
    "virtual.eccentricity.offset=0",
    "virtual.amplifier.offset=0",
    "virtual.amplifier.offset_ripple=[]",
)


def rig_with(*touching, overrides=()):
    recipe, _ = load_recipe(RECIPE, overrides)
    virtual = recipe.virtual.model_copy(update={"contact": touching})
    return open_rig(recipe.model_copy(update={"virtual": virtual}), KT, "test"), recipe


def held(rig, angle, duration, every=8):
    """Move to an angle of the output, then hold it for a time that is open to contacts."""
    rig.move_by(angle * RATIO - rig.position)
    return perform(rig, Task(SpeedProfile((0, duration), (0, 0)), record_every=every, touched=True))


def test_a_mass_at_rest_pulls_with_its_weight():
    rig, _ = rig_with(Mass(kind="mass", at=(0.5,), force=1.5))
    got = held(rig, math.pi / 2, 6.0)
    # the grasper yields by M / k; the sine is taken where it comes to rest
    torque = got["reference_torque"]
    yielded = torque[-1] / 0.2
    expected = 1.5 * RADIUS * np.sin(math.pi / 2 - yielded)
    assert torque[-1] == pytest.approx(expected, rel=0.01)
    np.testing.assert_allclose(torque[-1000:], torque[-1], rtol=1e-4)
    np.testing.assert_array_equal(torque[got["time"] - got["time"][0] < 0.49], 0.0)


def test_reference_torque_of_a_load_holds_newtons_law_for_the_mass():
    # The load alone: weight at the angle, and what it takes to accelerate the mass. Over a whole
    # cycle at rest at both ends the work that it receives is that of gravity, which is none.
    rig, recipe = rig_with()
    motion = Triangle(0.3, 2.4, 3.0, 0.5, 1)
    task = Task(motion, Feedforward(recipe.rig.nominal_inertia), Load(force=2.0), touched=True)
    got = perform(rig, task)
    arm = 2.0 * RADIUS
    assert np.abs(got["reference_torque"]).max() > 1.02 * arm  # its inertia adds to the weight
    weight = arm * np.sin(got["encoder"] * 2 * np.pi / 4000 / RATIO)
    mean = got["reference_torque"].mean()
    assert mean == pytest.approx(weight.mean(), rel=0.1)


def test_the_pulley_accelerates_a_mass_on_its_cord():
    hung = Mass(kind="mass", at=(0.0,), force=3.0, rise_time=0.0)
    rig, recipe = rig_with(hung, overrides=FREE)
    got = perform(rig, Task(CurrentSteps((0.0,), 0.2), touched=True))
    # Atwood's machine: of the weight's torque the cord passes on what turns the rotor.
    own, hanging = recipe.virtual.motor.inertia, 3.0 / STANDARD_GRAVITY * 0.014**2
    cord = 3.0 * 0.014 * own / (own + hanging)
    np.testing.assert_allclose(got["reference_torque"], cord, rtol=1e-9)
    fallen = -got["encoder"][-1] * 2 * np.pi / 4000
    assert fallen == pytest.approx(cord / own * 0.2**2 / 2, rel=2e-3)
    # the same weight as the recipe's load
    other, _ = rig_with(overrides=FREE)
    load = perform(other, Task(CurrentSteps((0.0,), 0.2), load=Load(force=3.0), touched=True))
    np.testing.assert_allclose(load["reference_torque"], got["reference_torque"], rtol=1e-9)


def test_a_sine_has_its_amplitude_and_frequency():
    rig, _ = rig_with(Sine(kind="sine", at=(1.0,), duration=2.0, force=0.8, frequency_hz=10.0))
    got = held(rig, 1.0, 4.0, every=1)
    time, torque = got["time"] - got["time"][0], got["reference_torque"]
    on = (time > 0.99995) & (time < 3.0)
    expected = 0.8 * RADIUS * np.sin(2 * np.pi * 10.0 * (time[on] + 62.5e-6 - 1.0))
    np.testing.assert_allclose(torque[on], expected, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(torque[~on], 0.0)


def test_pulse_and_ramp_have_their_shapes():
    rig, _ = rig_with(
        Pulse(kind="pulse", at=(0.5,), duration=1.0, force=1.0, rise_time=0.1),
        Ramp(kind="ramp", at=(2.0,), duration=0.5, force=-2.0),
    )
    got = held(rig, 1.0, 3.0, every=1)
    time = got["time"] - got["time"][0] + 62.5e-6
    corners = [0.5, 0.6, 1.4, 1.5, 2.0, 2.4999]
    torque = np.interp(corners, time, got["reference_torque"])
    expected = RADIUS * np.array([0.0, 1.0, 1.0, 0.0, 0.0, -2.0])
    np.testing.assert_allclose(torque, expected, rtol=0, atol=3e-4 * 2 * RADIUS)
    assert got["reference_torque"].sum() * 125e-6 == pytest.approx(RADIUS * (0.9 - 0.5), rel=1e-3)


def test_tissue_pushes_as_its_spring_and_never_pulls():
    tissue = Tissue(kind="tissue", at=(0.0,), angle_deg=60.0, stiffness=0.05, damping=1e-4)
    rig, _ = rig_with(tissue, overrides=("virtual.instrument.stiffness=20",))
    motion = Triangle(0.5, 2.0, 1.0, 0.3, 1)
    got = perform(rig, Task(motion, Feedforward(2e-5), touched=True))
    angle = (got["encoder"] + 0.5) * 2 * np.pi / 4000 / RATIO
    speed = motion.setpoint(got["time"] - got["time"][0])[1] / RATIO
    depth = angle - math.radians(60.0)
    torque = got["reference_torque"]
    depth -= torque / 20  # by which the tendon stretches
    deep = depth > 0.02
    expected = 0.05 * depth[deep] + 1e-4 * speed[deep]
    np.testing.assert_allclose(torque[deep], expected, rtol=0, atol=1.5e-4)
    np.testing.assert_array_equal(torque[depth < -0.02], 0.0)
    assert torque.min() >= 0.0


def test_stiff_tissue_is_stable():
    tissue = Tissue(kind="tissue", at=(0.0,), angle_deg=60.0, stiffness=1e4, damping=5.0)
    rig, _ = rig_with(tissue)
    got = held(rig, math.radians(90.0), 2.0)
    # the tendon stretches by 30 deg: the rig pushes with its stiffness, less the tip's friction
    expected = 0.2 * math.radians(30.0)
    assert got["reference_torque"][-500:] == pytest.approx(expected, abs=1.5e-3)


def test_contacts_go_on_over_blocks_and_averages():
    sine = Sine(kind="sine", at=(0.2,), duration=4.5, force=1.0, frequency_hz=3.0)
    tissue = Tissue(kind="tissue", rate_per_min=60, duration=(0.2, 1.0), angle_deg=30, stiffness=1)
    fine, coarse = (rig_with(sine, tissue, overrides=STEADY)[0] for _ in range(2))
    whole = perform(fine, Task(MOTION, touched=True))  # in blocks of 16384 samples
    means = perform(coarse, Task(MOTION, record_every=40, touched=True))  # of other lengths
    count = len(means["time"])
    for name in ("reference_torque", "encoder", "current_setpoint"):
        expected = whole[name][: 40 * count].reshape(-1, 40).mean(axis=1)
        np.testing.assert_allclose(means[name], expected, rtol=1e-9, atol=1e-12, err_msg=name)


def test_what_touches_shifts_no_other_draw():
    pulse = Pulse(kind="pulse", at=(1.0,), duration=0.5, force=1.0)
    drawn = Pulse(kind="pulse", rate_per_min=5, duration=(0.2, 0.5), force=(0.1, 2.0))
    untouched, touched, more = (rig_with(*one)[0] for one in ((), (pulse,), (pulse, drawn)))
    before = perform(untouched, Task(MOTION))
    closed = perform(touched, Task(MOTION))
    opened = perform(more, Task(MOTION, touched=True))
    for name, values in before.items():
        np.testing.assert_array_equal(values, closed[name], err_msg=name)
    assert "reference_torque" not in before
    first = opened["time"] - opened["time"][0] < 0.1
    for name, values in before.items():  # until something does
        np.testing.assert_array_equal(values[first], opened[name][first], err_msg=name)
    assert CHANNELS["reference_torque"][0] == "N m"


@pytest.mark.compiles
def test_nothing_touching_is_the_same_to_the_last_digit():
    task = Task(MOTION, Feedforward(1.8e-5), Load(force=1.0), record_every=4)
    plain = perform(rig_with()[0], task)
    touched = perform(rig_with()[0], Task(task.motion, task.feedforward, task.load, 4, None, True))
    for name, values in plain.items():
        np.testing.assert_array_equal(values, touched[name], err_msg=name)


@settings(deadline=None, max_examples=30)
@given(
    seed=st.integers(0, 2**32 - 1),
    rate=st.floats(1, 200),
    shortest=st.floats(0.1, 1.0),
    longer=st.floats(0.0, 3.0),
)
def test_drawn_contacts_keep_to_their_ranges(seed, rate, shortest, longer):
    lasting = (shortest, shortest + longer)
    pulse = Pulse(
        kind="pulse", rate_per_min=rate, duration=lasting, force=(-0.5, 2.0), rise_time=0.02
    )
    mass = Mass(kind="mass", at=(1.0,), force=(0.1, 1.0))
    drawn = contacts.draw((pulse, mass), 60.0, [seed])
    assert drawn == contacts.draw((pulse, mass), 60.0, [seed])
    assert drawn[:-1] == contacts.draw((pulse,), 60.0, [seed])
    *pulses, hung = drawn
    assert (hung.begin, hung.end) == (1.0, math.inf)
    for touch in pulses:
        assert 0.0 <= touch.begin < 60.0
        assert lasting[0] - 1e-9 <= touch.end - touch.begin <= lasting[1] + 1e-9
        assert -0.5 <= touch.size <= 2.0
    for before, after in itertools.pairwise(pulses):
        assert after.begin >= before.end


def test_rate_of_drawn_contacts():
    pulse = Pulse(kind="pulse", rate_per_min=12, duration=0.2, force=1.0)
    drawn = contacts.draw((pulse,), 36000.0, [5])
    gaps = np.diff([0.0, *(touch.begin for touch in drawn)])[1:] - 0.2
    # exponential: mean and standard deviation are 5 s; 4 standard errors of 6900 gaps
    assert gaps.mean() == pytest.approx(5.0, abs=0.25)
    assert gaps.std() == pytest.approx(5.0, abs=0.35)
