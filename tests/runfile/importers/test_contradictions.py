"""What a mapping states and the data contradict is said at import."""

import numpy as np
import pytest

from rigtool.recipe.mapping import parse_mapping
from rigtool.runfile.importers.contradictions import contradictions

TEXT = """mapping = 1
[rig]
name = "bench"
encoder_counts = 4096
torque_constant = 0.05
[signals]
time = { column = 1, unit = "s" }
current = { column = 2, unit = "A" }
"""


def signals(counts=4096, constant=0.05, noise=0.0):
    time = np.linspace(0, 10, 500)
    position, current = 3 * np.sin(time), np.cos(time)
    torque = constant * current + noise * np.random.default_rng(1).normal(size=500)
    encoder = position * counts / (2 * np.pi)
    return {
        "time": time,
        "position": position,
        "encoder": encoder,
        "current": current,
        "torque": torque,
    }


@pytest.mark.parametrize(
    ("found", "messages"),
    [
        (signals(), []),
        (signals(counts=1024), ["0.25 times as far as position"]),
        (signals(constant=-0.05), ["torque changes by -0.05 N m for each ampere"]),
        (signals(constant=5.0, counts=-4096), ["encoder moves -1", "changes by 5 N m"]),
        (signals(noise=1.0), []),
    ],
)
def test_counts_and_torque_constant(found, messages):
    notes = contradictions(found, parse_mapping(TEXT))
    assert len(notes) == len(messages)
    for note, message in zip(notes, messages, strict=True):
        assert message in note
