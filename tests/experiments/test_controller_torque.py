"""The controller's part of the current, and the names of recordings in errors."""

import numpy as np
import pytest
from scipy.signal import lfilter

from rigtool.control.position_loop import position_loop
from rigtool.errors import InsufficientDataError
from rigtool.experiments.controller_torque import (
    LOOP_CHANNELS,
    SIGNAL,
    TABLE,
    controller_torque,
    encoder_shaking,
    loop_blocks,
    loop_signals,
    naming,
    require_stable_loop,
    require_unlimited,
)
from rigtool.experiments.procedure import channels
from rigtool.recipe import load_recipe
from rigtool.runfile import RecordingSpec, RunWriter
from tests.experiments.virtual_runs import RECIPE

ASKED, MODELLED, LEARNED = 0.5, 0.125, 0.25


def recorded(path, learned=TABLE, asked=ASKED, samples=1000):
    """Record constant currents, A, with the rotor at its set point; return what is read of it."""
    recipe, text = load_recipe(RECIPE, ())
    names = [learned if name == TABLE else name for name in LOOP_CHANNELS]
    angle = np.linspace(0, 2 * np.pi, samples)
    block = {
        "time": np.arange(samples) * 1e-3,
        "current_setpoint": np.full(samples, asked),
        "feedforward_current": np.full(samples, MODELLED),
        learned: np.full(samples, LEARNED),
        "position_setpoint": angle,
        "encoder": angle * recipe.rig.encoder_counts / (2 * np.pi),
    }
    specs = [RecordingSpec("one", channels(*names))]
    with RunWriter(
        path, command="ilc-learn", recipe=recipe, recipe_text=text, recordings=specs
    ) as writer:
        writer.append("one", block)
        recording = writer.recorded().recording("one")
        found = (
            controller_torque(recording, 2.0),
            loop_signals(recording, recipe),
            list(loop_blocks(recording, recipe)),
        )
        writer.finish({}, {})
    return found


@pytest.mark.parametrize("learned", [TABLE, SIGNAL])
def test_it_is_what_nothing_else_asks_for(tmp_path, learned):
    torque, signals, blocks = recorded(tmp_path / "run.h5", learned)
    own = ASKED - MODELLED - LEARNED
    np.testing.assert_allclose(torque, 2.0 * own, rtol=1e-12, atol=0)
    np.testing.assert_allclose(signals.controller, own, rtol=1e-12, atol=0)
    np.testing.assert_allclose(signals.learned, LEARNED, rtol=1e-12, atol=0)
    np.testing.assert_allclose(signals.rotor, signals.setpoint, rtol=0, atol=1e-6)
    together = np.concatenate([block.controller for block in blocks])
    np.testing.assert_array_equal(together, signals.controller)


def test_a_loop_that_saturates_is_refused(tmp_path):
    limit = load_recipe(RECIPE, ())[0].rig.current_limit
    with pytest.raises(InsufficientDataError, match="reaches the limit"):
        recorded(tmp_path / "run.h5", asked=limit)


def test_a_loop_that_shakes_to_the_limit_is_not_advised_to_carry_less():
    recipe, _ = load_recipe(RECIPE)
    limit = recipe.rig.current_limit
    require_unlimited(0.99 * limit, recipe, "turn more slowly", 0.0)
    with pytest.raises(
        InsufficientDataError, match=r"limit of 10.0 A.*: turn more slowly, or raise"
    ):
        require_unlimited(limit, recipe, "turn more slowly", 0.3 * limit)
    with pytest.raises(InsufficientDataError, match="so the loop shakes"):
        require_unlimited(limit, recipe, "turn more slowly", 0.06)


@pytest.mark.parametrize(
    ("settings", "stable"),
    [
        ((), True),
        (("rig.controller.crossover_hz=2",), False),
        (("rig.controller.crossover_hz=2", "rig.controller.integrator_hz=0.6"), True),
        (("rig.sample_time=1e-3", "rig.controller.crossover_hz=200"), False),
        (("rig.sample_time=1e-3", "rig.controller.crossover_hz=90"), True),
    ],
)
def test_a_loop_that_friction_alone_holds_is_refused(settings, stable):
    """An integrator above the crossover; a crossover near the rate. The remedies are stable."""
    recipe, _ = load_recipe(RECIPE, settings)
    if stable:
        require_stable_loop(recipe)
        return
    with pytest.raises(InsufficientDataError, match=r"unstable.*crossover_hz is .*integrator_hz"):
        require_stable_loop(recipe)


def test_an_error_names_its_recording():
    class Named:
        name = "load_003"

    with (
        pytest.raises(InsufficientDataError, match=r"^recording load_003: too few$"),
        naming(Named()),
    ):
        raise InsufficientDataError("too few")


@pytest.mark.parametrize("edges", [3.3, 17.7, 71.3, 1513.7])
def test_a_shaft_shakes_by_the_steps_of_its_encoder(edges):
    """At so many edges a second: a loop that follows steps in time; many edges are white noise."""
    recipe, _ = load_recipe(RECIPE, ())
    step, interval = 2 * np.pi / recipe.rig.encoder_counts, recipe.rig.sample_time
    loop = position_loop(**recipe.rig.loop_design).complementary_sensitivity
    angle = edges * interval * np.arange(int(10 / interval))
    steps = np.floor(angle) - angle
    if edges > 1000:
        steps = np.random.default_rng(1).uniform(size=angle.size)
    padded = np.pad(loop.num, (len(loop.den) - len(loop.num), 0))
    followed = lfilter(padded, loop.den, steps)[angle.size // 2 :]
    shaking = np.std(np.diff(followed)) / interval / edges
    found = encoder_shaking(recipe, np.array([edges * step, -edges * step]))
    np.testing.assert_allclose(found, shaking, rtol=0.07)
