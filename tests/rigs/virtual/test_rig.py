"""The virtual rig against closed forms, scipy's integrator and python-control."""

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from rigtool.control.lookup_table import LookupTable
from rigtool.control.position_loop import controller_sections
from rigtool.errors import RecipeError
from rigtool.quantity import STANDARD_GRAVITY
from rigtool.recipe import load_recipe, parse_recipe
from rigtool.rigs import Feedforward, Load, Task, open_rig
from rigtool.rigs.motion import CurrentRamp, CurrentSteps, SpeedProfile, Triangle
from rigtool.rigs.virtual.maps import MAP_SIZE, rotor_map
from tests.other_tools import control
from tests.rigs.performed import perform

RECIPE = Path(__file__).parents[3] / "recipes" / "briaire-2006.toml"

# An ideal motor: what is not under test is switched off.
IDEAL = [
    "rig.attachment=pulley",
    "virtual.motor.cogging=[]",
    "virtual.motor.viscous_modulation=[]",
    "virtual.motor.coulomb_friction=0",
    "virtual.motor.static_friction=0",
    "virtual.motor.friction_asymmetry=0",
    "virtual.motor.viscous_friction=0",
    "virtual.motor.friction_noise=0",
    "virtual.motor.torque_constant_temperature_coefficient=0",
    "virtual.amplifier.offset=0",
    "virtual.amplifier.offset_ripple=[]",
    "virtual.amplifier.gain_ripple=[]",
    "virtual.amplifier.saturation_ripple=[]",
    "virtual.sensors.current_noise=0",
    "virtual.sensors.force_noise=0",
    "virtual.sensors.temperature_noise=0",
    "virtual.sensors.force_gain=1",
    "virtual.sensors.force_resolution=0",
    "virtual.eccentricity.offset=0",
    "virtual.instrument.drift=0",
    "virtual.instrument.stroke_noise=0",
    "virtual.instrument.load_stroke_noise=0",
]
KT = 0.0458
FINE = "rig.encoder_counts=4000000000"
STEPS = pytest.mark.parametrize("sample_time", [125e-6, 1e-3])


def rig_with(*overrides, stream="test"):
    recipe, _ = load_recipe(RECIPE, [*IDEAL, *overrides])
    return open_rig(recipe, KT, stream), recipe


def test_free_rotor_accelerates_as_newton_says():
    rig, recipe = rig_with()
    got = perform(rig, Task(CurrentSteps((0.01,), 0.5)))
    acceleration = KT * 0.01 / recipe.virtual.motor.inertia
    angle = got["encoder"][-1] * 2 * np.pi / 4000
    # half a count, and the lag of the current loop
    assert angle == pytest.approx(acceleration * 0.5**2 / 2, rel=2e-3)


def test_clamped_arm_swings_as_an_integrator_says():
    rig, recipe = rig_with()
    rig.clamp(0.3)
    got = perform(rig, Task(CurrentSteps((1.0,), 0.8), load=Load(clamped=True)))
    arm, motor = recipe.virtual.arm, recipe.virtual.motor
    inertia = arm.inertia + motor.inertia
    lag = 1 / (2 * np.pi * recipe.virtual.amplifier.bandwidth_hz)

    def swing(time, state):
        angle, speed = state
        torque = KT * (1 - np.exp(-time / lag))
        return speed, (torque - arm.stiffness * angle - arm.damping * speed) / inertia

    time = np.arange(len(got["force"])) * recipe.rig.sample_time
    exact = solve_ivp(swing, (0, time[-1]), (0, 0), t_eval=time, rtol=1e-9, atol=1e-12)
    force = (arm.stiffness * exact.y[0] + arm.damping * exact.y[1]) / recipe.rig.arm.length
    np.testing.assert_allclose(got["force"], force, rtol=0, atol=0.01 * force.max())
    assert got["force"][-1] == pytest.approx(KT / recipe.rig.arm.length, rel=1e-3)


@STEPS
def test_closed_loop_follows_the_linear_model(sample_time):
    # The step response without Coulomb friction, against python-control on the same loop.
    rig, recipe = rig_with(
        f"rig.sample_time={sample_time}", "virtual.motor.viscous_friction=1e-3", FINE
    )
    step, r, motor = 0.01, recipe.rig, recipe.virtual.motor
    got = perform(rig, Task(SpeedProfile((0, 1e-3, 0.3), (0, step / 0.2, step / 0.2))))
    lag = 1 / (2 * np.pi * recipe.virtual.amplifier.bandwidth_hz)
    plant = control.tf([1], [lag, 1]) * control.tf([1], [motor.inertia, 1e-3, 0])
    loop = control.sample_system(plant, sample_time, "zoh")
    for section in controller_sections(**r.loop_design):
        loop = loop * control.tf(list(section[:3]), list(section[3:]), sample_time)
    setpoint, measured = got["position_setpoint"], got["encoder"] * 2 * np.pi / 4e9
    time = np.arange(len(measured)) * sample_time
    closed = control.feedback(loop, 1)
    expected = control.forced_response(closed, T=time, inputs=setpoint).outputs
    np.testing.assert_allclose(measured, expected, rtol=0, atol=1e-4 * np.ptp(measured))


def test_constant_speed_needs_coulomb_and_viscous_torque():
    rig, _ = rig_with(
        "virtual.motor.coulomb_friction=2.3e-3",
        "virtual.motor.static_friction=4e-3",
        "virtual.motor.viscous_friction=5.33e-5",
    )
    for speed in (5.0, -20.0):
        got = perform(rig, Task(SpeedProfile((0, 0.2, 2.0), (0, speed, speed)), record_every=80))
        torque = KT * got["current_setpoint"][len(got["time"]) // 2 :].mean()
        assert torque == pytest.approx(np.sign(speed) * 2.3e-3 + 5.33e-5 * speed, rel=2e-3)


@STEPS
@pytest.mark.parametrize("viscous", [5.33e-5, 5e-3])
def test_inertia_and_viscous_friction_are_those_of_the_recipe(sample_time, viscous):
    rig, recipe = rig_with(
        f"rig.sample_time={sample_time}", f"virtual.motor.viscous_friction={viscous}", FINE
    )
    got = perform(rig, Task(CurrentSteps((1.0, 0.0), 0.25)))
    angle = got["encoder"] * 2 * np.pi / 4e9
    free = np.diff(angle[len(angle) // 2 + 10 :]) / sample_time
    decay = -np.log(free[1:] @ free[:-1] / (free[:-1] @ free[:-1])) / sample_time
    # What the torque has done: it turned the rotor against its friction, and the rest is momentum.
    last = free[-1] * (1 - np.tanh(decay * sample_time / 2))  # at the end of its step
    inertia = KT * 0.25 / (decay * (angle[-1] - angle[0]) + last)
    assert inertia == pytest.approx(recipe.virtual.motor.inertia, rel=1e-4)
    assert decay * inertia == pytest.approx(viscous, rel=1e-4)


@STEPS
def test_the_clamped_arm_dies_out_as_its_damper_says(sample_time):
    rig, recipe = rig_with(f"rig.sample_time={sample_time}", FINE)
    rig.clamp(0.0)
    got = perform(rig, Task(CurrentSteps((1.0, 0.0), 0.02), load=Load(clamped=True)))
    force = got["force"][round(0.022 / sample_time) :]
    past = np.stack([force[1:-1], force[:-2]], axis=1)
    rest = np.linalg.lstsq(past, force[2:], rcond=None)[0]
    inertia = recipe.virtual.arm.inertia + recipe.virtual.motor.inertia
    damping = -np.log(-rest[1]) / sample_time * inertia
    assert damping == pytest.approx(recipe.virtual.arm.damping, rel=2e-4)


@pytest.mark.parametrize(("radial", "expected"), [(0.0, 4e-3), (22.0, 4e-3 + 22 * 4.77e-5)])
def test_breakaway_comes_at_static_friction(radial, expected):
    rig, _ = rig_with("virtual.motor.coulomb_friction=2.3e-3", "virtual.motor.static_friction=4e-3")
    ramp = CurrentRamp(1e-3 / KT, 12e-3 / KT)
    task = Task(ramp, load=Load(radial_force=radial), record_every=8, stop_angle=0.02)
    got = perform(rig, task)
    torque = KT * got["current_setpoint"]
    assert torque[-1] == pytest.approx(expected, rel=0.03)
    # Before that the shaft creeps by no more than the bristles allow.
    creep = got["encoder"][torque < 0.9 * expected] * 2 * np.pi / 4000
    assert np.ptp(creep) < 0.015


def test_winding_settles_at_the_temperature_of_its_losses():
    rig, recipe = rig_with(
        "virtual.thermal.winding_capacity=0.5", "virtual.thermal.housing_capacity=2.0"
    )
    rig.clamp(0.0)
    task = Task(CurrentSteps((2.0,), 40.0), load=Load(clamped=True), record_every=64)
    got = perform(rig, task)
    t = recipe.virtual.thermal
    # Balance of heat with the resistance of warm copper (0.393 %/K), solved for the winding.
    path = t.winding_to_housing + t.housing_to_ambient
    cold = t.winding_resistance * 2.0**2
    slope = 0.00393
    winding = (t.ambient_degc + path * cold * (1 - 20 * slope)) / (1 - path * cold * slope)
    loss = cold * (1 + slope * (winding - 20))
    assert got["temperature"][-1] == pytest.approx(
        t.ambient_degc + loss * t.housing_to_ambient, abs=0.02
    )


def test_loaded_grasper_swings_at_its_resonance():
    rig, recipe = rig_with(
        "rig.attachment=instrument",
        "virtual.instrument.friction=0",
        "virtual.instrument.tip_friction=0",
        "virtual.instrument.load_friction=0",
        "virtual.instrument.viscous_friction=0",
        "virtual.instrument.damping=2e-4",
        "rig.encoder_counts=4000000",
        "rig.controller.crossover_hz=150",  # so stiff that the motor stands still
        "rig.controller.lowpass_hz=1500",
    )
    force = 5.0
    # Stop abruptly near the lower end and let it swing: gravity there adds to the stiffness.
    stop = SpeedProfile((0, 0.5, 0.501, 3.5), (0.0, 0.2, 0.0, 0.0))
    got = perform(rig, Task(stop, Feedforward(), Load(force=force), record_every=8))
    swing = got["current_setpoint"][got["time"] - got["time"][0] > 0.6]
    swing = swing - swing[-500:].mean()
    crossings = np.flatnonzero(np.diff(np.sign(swing[: len(swing) // 2])))
    frequency = (len(crossings) - 1) / 2 / (np.ptp(crossings) * 1e-3)
    inertia = recipe.virtual.instrument.grasper_inertia + force / STANDARD_GRAVITY * 0.02**2
    stiffness = recipe.virtual.instrument.stiffness + force * 0.02  # cos of a small angle
    assert frequency == pytest.approx(np.sqrt(stiffness / inertia) / 2 / np.pi, rel=0.03)


def test_eccentric_pulleys_give_the_torque_of_appendix_j():
    recipe, _ = load_recipe(
        RECIPE, ["virtual.motor.cogging=[]", "virtual.amplifier.offset_ripple=[]"]
    )
    virtual = recipe.virtual
    torque = rotor_map(virtual, virtual.amplifier, 0)[:, 3]
    # thesis, Appendix J: 26.1 uN m, twice a turn
    assert np.abs(torque).max() == pytest.approx(26.1e-6, rel=1e-3)
    assert np.argmax(np.abs(np.fft.rfft(torque[:MAP_SIZE]))) == 2


def test_same_seed_same_signals_another_seed_others():
    def run(seed, stream="test"):
        recipe, _ = load_recipe(RECIPE, [f"virtual.seed={seed}"])
        rig = open_rig(recipe, KT, stream)
        motion = Triangle(0, 2.67, 5.0, 0.3, 1)
        return perform(rig, Task(motion, record_every=16))

    first, again, other, elsewhere = run(3), run(3), run(4), run(3, "other")
    for name, values in first.items():
        np.testing.assert_array_equal(values, again[name])
    assert not np.array_equal(first["current_setpoint"], other["current_setpoint"])
    assert not np.array_equal(first["current"], elsewhere["current"])


def test_power_cycle_changes_the_ripple_and_nothing_else():
    recipe, _ = load_recipe(RECIPE)
    virtual = recipe.virtual
    before, again, after = (rotor_map(virtual, virtual.amplifier, k) for k in (0, 0, 1))
    np.testing.assert_array_equal(before, again)
    assert not np.allclose(before[:, 0], after[:, 0], rtol=0.05, atol=0)
    np.testing.assert_array_equal(before[:, 3:], after[:, 3:])


def test_recording_fewer_samples_gives_their_means():
    whole, _ = rig_with()
    fewer, _ = rig_with()
    motion = SpeedProfile((0, 0.5, 1.0), (0, 10, 10))
    fine, coarse = perform(whole, Task(motion)), perform(fewer, Task(motion, record_every=8))
    for name in ("time", "encoder", "position_setpoint", "current_setpoint", "current"):
        means = fine[name].reshape(-1, 8).mean(axis=1)
        np.testing.assert_allclose(coarse[name], means, rtol=1e-9, atol=1e-12, err_msg=name)
    assert np.all(np.mod(fine["encoder"], 1) == 0)


@pytest.mark.parametrize("period", [None, 2 * np.pi])
def test_set_points_in_the_simulation_are_those_for_arrays_of_times(period):
    rng = np.random.default_rng(20061)
    angles, low = np.linspace(0.0, 2 * np.pi, 50, endpoint=False), np.array([0.0, 1.0, 2.0])
    speeds = np.array([-6.0, -2.0, 2.0, 4.0])
    table = LookupTable(angles, speeds, rng.normal(size=(4, 50)) * 1e-3, low, low * low / 4, period)
    signal = rng.normal(size=777) * 1e-3
    feedforward = Feedforward(1.5e-5, 2e-3, 5e-5, table, signal)
    rig, recipe = rig_with()
    for motion in (
        SpeedProfile((0, 0.4, 2.0, 2.5), (0, -5, -1, 3)),
        Triangle(-1.0, 9.0, 5.0, 0.3, 2),
    ):
        origin = rig.position if motion.start is None else motion.start
        got = perform(rig, Task(motion, feedforward))
        time = (np.arange(len(got["time"])) + 0.5) * recipe.rig.sample_time
        position, speed, acceleration = motion.setpoint(time)
        position = position + origin
        expected = {
            "position_setpoint": position,
            "feedforward_current": feedforward.model_torque(speed, acceleration) / KT,
            "table_current": table.evaluate(position, speed) / KT,
            "signal_current": np.resize(signal, len(time)) / KT,
        }
        for name, values in expected.items():
            np.testing.assert_allclose(got[name], values, rtol=0, atol=1e-12, err_msg=name)


def test_a_virtual_rig_needs_its_parameters():
    recipe = parse_recipe("recipe = 1\n[rig]\nname = 'x'\n")
    with pytest.raises(RecipeError, match=r"no table \[virtual\]"):
        open_rig(recipe, KT, "test")


def test_a_motion_that_is_broken_off_leaves_the_rig_at_rest():
    """A controller that swings at its limit of current must not go on under the next motion."""
    rig = rig_with("rig.attachment=instrument")[0]
    task = Task(Triangle(0.0, 2.0, 8.0, 0.3, 10), load=Load(force=3.0))
    blocks = rig.perform(task)
    next(blocks)
    blocks.close()
    here = rig.position
    still = perform(rig, Task(CurrentSteps((0.0,), 0.5)))
    turn = 2 * np.pi / 4000
    np.testing.assert_allclose(still["encoder"] * turn, here, atol=3 * turn)
    assert np.abs(perform(rig, Task(SpeedProfile((0.0, 0.5), (0.0, 0.0))))["current"]).max() < 0.1
