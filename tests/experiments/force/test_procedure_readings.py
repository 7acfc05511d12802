"""Signals that are filtered block by block, beside all of them at once."""

from types import SimpleNamespace

import numpy as np
import pytest

from rigtool.errors import InsufficientDataError
from rigtool.experiments.force import procedure_readings
from rigtool.numerics.lowpass import kept_factor, lowpass
from rigtool.recipe import load_recipe
from tests.experiments.virtual_runs import RECIPE

RATE, NAMES = 4000.0, ("encoder", "controller", "learned", "modelled")


@pytest.fixture
def signals(monkeypatch):
    time = np.arange(9000) / RATE
    made = {name: np.sin(2 * np.pi * (n + 1) * time) for n, name in enumerate(NAMES)}
    recording = SimpleNamespace(
        size=time.size, read=lambda name, start, stop: time[start:stop], name="load_000"
    )

    def filtered(late=0.0, at=5000):
        moved = time - np.where(np.arange(time.size) >= at, late, 0.0)
        blocks = [
            SimpleNamespace(time=part, setpoint=2 * part, **dict(zip(NAMES, own, strict=True)))
            for part, *own in zip(
                *(np.split(one, [1, 4000, at, 8000]) for one in (moved, *made.values())),
                strict=True,
            )
        ]
        monkeypatch.setattr(procedure_readings, "loop_blocks", lambda *_: iter(blocks))
        return procedure_readings._filtered(recording, load_recipe(RECIPE, ())[0])

    return filtered


def test_blocks_are_thinned_and_low_passed_as_the_whole(signals):
    found, rate, _ = signals()
    corner = load_recipe(RECIPE, ())[0].measure_force.lowpass_hz
    factor = kept_factor(RATE, corner)
    assert rate == pytest.approx(RATE / factor)
    assert factor > 1
    # a sine far below the corner stays as it was, at the middle of what is averaged
    middle = (np.arange(found.shape[1]) * factor + (factor - 1) / 2) / RATE
    inside = slice(found.shape[1] // 4, -found.shape[1] // 4)
    for n, own in enumerate(found):
        expected = lowpass(rate, np.sin(2 * np.pi * (n + 1) * middle), corner)
        assert np.abs(own - expected)[inside].max() < 0.02


def test_the_rotor_s_ways_are_summed_over_blocks(signals):
    """The encoder, two and a quarter cycles of a sine, against a set point that rises."""
    _, _, ways = signals()
    np.testing.assert_allclose(ways, [5, 4], rtol=0.01)


def test_time_rises_from_block_to_block(signals):
    signals(late=0.9 / RATE)
    with pytest.raises(InsufficientDataError, match="5000"):
        signals(late=1.1 / RATE)
