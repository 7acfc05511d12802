"""Ripple of a motor whose current shakes about its mean."""

from types import SimpleNamespace

import numpy as np
import pytest

from rigtool.experiments.ripple.orders import HIGHEST_ORDER, cell_centres
from rigtool.experiments.ripple.procedure_shaking import shaken_note, shaken_orders, uneven_note
from rigtool.experiments.ripple.procedure_steady import collected
from rigtool.recipe import load_recipe
from tests.experiments.ripple.fine import FINE
from tests.experiments.virtual_runs import RECIPE

ANGLE = cell_centres(500)


def shaking(square, shaken):
    return SimpleNamespace(square=square, shaken=shaken, sampling=FINE)


def test_u_has_the_ripple_of_the_largest_torque_as_far_as_the_current_shakes():
    """Ripple s i |i|: with a standard deviation of 0.5 A about 1 A it is a quarter larger."""
    found = [shaking(0.06, 0.05), shaking(1.25, 0.25)]
    held = [0.1 + 1e-3 * np.cos(ANGLE)[None], 1 + 4e-3 * np.cos(3 * ANGLE + 1)[None]]
    small, large = shaken_orders(found, held)
    assert large[2] == pytest.approx(4e-3 * (0.25 / 1.25) / np.sqrt(3), rel=1e-3)
    assert small[2] == pytest.approx(4e-3 * (0.05 / 1.25) / np.sqrt(3), rel=1e-3)
    np.testing.assert_allclose([small[0], large[0]], 0, rtol=0, atol=1e-12)
    assert small.size == HIGHEST_ORDER


def test_recordings_whose_current_shakes_are_named():
    names = [SimpleNamespace(name=name) for name in ("torque_000", "torque_001")]
    steady, shaken = shaking(1.04, 0.04), shaking(1.26, 0.26)
    (note,) = shaken_note(names, [steady, shaken])
    assert "torque_001 by 26 % or more" in note
    assert "torque_000" not in note
    assert shaken_note(names[:1], [steady, shaken]) == []  # others, at power cycles, follow


@pytest.mark.parametrize("sign", [1, -1])
def test_how_much_shaking_adds_to_the_square(tmp_path, sign):
    """A current of 1 A that is 0.4 A larger and smaller in turn: 1.16 A2, of which 0.16 shakes."""
    recipe, _ = load_recipe(RECIPE, ("rig.encoder_counts=4000", "fft_ripple.revolutions=2"))
    count = 20000
    time = np.arange(count) * 5e-4
    signals = {
        "time": time,
        "encoder": sign * np.floor(time * 0.31 * 4000),
        "current_setpoint": sign * (1 + 0.4 * (-1.0) ** np.arange(count)),
    }

    def read(name, start=0, stop=count):
        return signals[name][start:stop]

    recording = SimpleNamespace(
        name="torque_000",
        conditions={"torque": 0.1},
        read=read,
        blocks=lambda *names, start, stop: [[read(name, start, stop) for name in names]],
    )
    found = collected(recording, range(count), recipe, None)
    assert found.square == pytest.approx(1.16, rel=1e-9)
    assert found.shaken == pytest.approx(0.16, rel=1e-9)


def test_an_encoder_whose_steps_shake_the_loop_is_noted():
    """Edges that come more slowly than the loop follows; at 9 rad/s they come faster."""
    recipe, _ = load_recipe(RECIPE, ("rig.encoder_counts=200",))
    recordings = [SimpleNamespace(condition=lambda name, v=v: v) for v in (3.0, 1.0, 9.0, 3.0)]
    (note,) = uneven_note(recordings, recipe)
    assert note.startswith("at 1, 3 rad/s the steps of the encoder, 200 a turn,")
    fine, _ = load_recipe(RECIPE, ())
    assert uneven_note(recordings, fine) == []
