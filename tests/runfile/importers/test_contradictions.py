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
gear_ratio = 35
arm_length = 0.2
[signals]
time = { column = 1, unit = "s" }
current = { column = 2, unit = "A" }
"""


def signals(counts=4096, constant=0.05, noise=0.0, friction=0.0):
    time = np.linspace(0, 8 * np.pi, 2000)
    position, current = 3 * np.sin(time), friction * np.sign(np.cos(time)) - np.sin(time)
    torque = constant * current + noise * np.random.default_rng(1).normal(size=2000)
    encoder = position * counts / (2 * np.pi)
    return {
        "time": time,
        "position": position,
        "encoder": encoder,
        "current": current,
        "torque": torque,
    }


def stepped(zero):
    asked = np.repeat([0.0, 1, 2, 1, 0], 400)
    noise = np.random.default_rng(3).normal(0, 1e-3, 2000)
    return {"time": np.arange(2000.0), "current": asked + zero + noise, "current_setpoint": asked}


wrong = signals()["position"] / 35
wrong[700] = -1


@pytest.mark.parametrize(
    ("found", "messages"),
    [
        (signals(), []),
        (signals(counts=1024), ["0.25 times as far as position"]),
        (signals(constant=-0.05), ["torque changes by -0.05 N m for each ampere"]),
        (signals(constant=5.0, counts=-4096), ["encoder moves -1", "changes by 5 N m"]),
        (signals(noise=1.0), []),
        (signals() | {"output_position": signals()["position"] / 35}, []),
        (signals() | {"output_position": signals()["position"] / -35}, ["motor moves -35 times"]),
        (signals() | {"output_position": signals()["position"] / 50}, ["gear_ratio is 35"]),
        (signals() | {"force": signals()["torque"] / 0.2}, []),
        (signals() | {"force": signals()["torque"] / 200}, ["changes by 200 N m for each newton"]),
        (signals() | {"current_setpoint": -signals()["current"]}, ["current changes -1 times"]),
        (signals() | {"output_position": wrong}, ["motor moves", "output_position jumps 2 times"]),
        (signals(friction=0.1), []),
        (
            {"time": signals()["time"], "encoder": signals(counts=1024)["encoder"]}
            | {"position_setpoint": signals()["position"]},
            ["position changes 0.25 times as much as position_setpoint"],
        ),
        (stepped(0.0), []),
        (stepped(0.05), ["current is 0.05 A where its set point is 0"]),
        (signals(friction=-0.1), ["current is larger backwards than forwards, by about 0.19"]),
    ],
)
def test_what_signals_contradict(found, messages):
    notes = contradictions(found, parse_mapping(TEXT))
    assert len(notes) == len(messages)
    for note, message in zip(notes, messages, strict=True):
        assert message in note
