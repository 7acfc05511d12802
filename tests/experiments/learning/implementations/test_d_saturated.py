"""Known loads that take more current than there is: what is measured, and learned, without them."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from rigtool.errors import InsufficientDataError
from rigtool.experiments.learning.implementations.c_limited_angle import LimitedAngle
from rigtool.experiments.learning.implementations.d_known_loads import KnownLoads
from rigtool.experiments.learning.implementations.d_saturated import (
    driven,
    left_out_notes,
    unsaturated,
)
from rigtool.recipe import load_recipe
from rigtool.rigs import Feedforward, Load, Task, open_rig
from rigtool.rigs.motion import Triangle
from tests.experiments.virtual_runs import RECIPE

SETTINGS = (
    "ilc_learn.loads.forces=[0.5, 1.5, 3]",
    "ilc_learn.loads.speeds_rev_per_s=[0.5, 1, 2]",
    "ilc_learn.loads.cycles=5",
)
RIG = load_recipe(RECIPE, SETTINGS)[0]
LIMIT = RIG.rig.current_limit


class Bench:
    """A rig whose loop saturates where `limited(force, rev/s)` is true; it records what is asked
    of it, and which motions were ended."""

    position = 0.0

    def __init__(self, limited):
        self._limited, self.ended = limited, []
        self.recorded = {}

    def move_by(self, angle):
        assert angle == 0.0

    def perform(self, task):
        speed = getattr(task.motion, "speed", math.nan) / (2 * math.pi * RIG.rig.angle_ratio)
        current = np.full(10, LIMIT if self._limited(task.load.force, speed) else 0.1)
        signals = {"current_setpoint": current, "time": np.arange(10.0)}
        try:
            while True:
                yield (
                    signals
                    | dict.fromkeys(
                        ("feedforward_current", "table_current", "encoder", "position_setpoint"),
                        current,
                    )
                    | {"temperature": current}
                )
                if current[0] < LIMIT:
                    return
        finally:
            self.ended.append((task.load.force, round(speed, 6)))

    def channel_names(self, name):
        return next(tuple(c.name for c in s.channels) for s in PLAN if s.name == name)

    def append(self, name, block):
        self.recorded[name] = block


PLAN = KnownLoads.recordings(RIG)


@pytest.fixture
def measured(monkeypatch):
    monkeypatch.setattr(LimitedAngle, "measure", lambda *given, **inputs: None)

    def measure(limited):
        bench = Bench(limited)
        KnownLoads.measure(bench, RIG, bench)
        return bench

    return measure


def test_a_load_too_heavy_at_a_speed_is_not_lifted_faster_and_neither_are_heavier_ones(measured):
    bench = measured(lambda force, speed: force >= 1.5 and speed > 0.9)
    names = [name for name in bench.recorded if name.startswith("known")]
    # At 1 rev/s 1.5 N ends its recording, 3 N is not hung on; at 2 rev/s neither is.
    assert names == [
        *(f"known_000_{n:03d}" for n in range(5)),
        *(f"known_001_{n:03d}" for n in (0, 1, 2, 4)),
        *(f"known_002_{n:03d}" for n in (0, 1, 4)),
    ]
    assert bench.ended.index((1.5, 1.0)) < bench.ended.index((0.0, 2.0))
    assert [f"check_{n:03d}" in bench.recorded for n in range(3)] == [True] * 3


def test_a_check_whose_load_is_too_heavy_is_left_out(measured):
    bench = measured(lambda force, speed: force == 3 and math.isnan(speed))
    assert bench.recorded["check_002"]["current_setpoint"].max() == LIMIT
    assert "known_002_003" in bench.recorded


@pytest.mark.parametrize(
    ("limited", "where"),
    [
        (lambda force, speed: force == 0 and speed > 1.9, "known_002_000"),
        (lambda force, speed: force > 1, "known_000_002"),
    ],
)
def test_without_two_loads_or_where_the_bare_rig_saturates_nothing_is_learned(
    measured, limited, where
):
    with pytest.raises(InsufficientDataError, match=f"recording {where}: .*saturates"):
        measured(limited)


def recording(name, force, largest, speed=1.0):
    conditions = {"force": force, "speed": 2 * math.pi * speed * RIG.rig.angle_ratio}
    signals = {"time": np.arange(4.0), "feedforward_current": np.zeros(4)}
    signals["current_setpoint"] = np.array([0.0, -largest, 0.5, 0.4])
    return SimpleNamespace(name=name, condition=conditions.get, read=signals.get)


def test_stored_loads_at_the_limit_are_left_out_and_named():
    made = [
        recording("a", 0.0, 1.0),
        recording("b", 0.5, 2.0),
        recording("c", 3.0, 3.0),
        recording("d", 3.0, LIMIT, 2.0),
    ]
    kept = unsaturated(made, RIG, 2)
    assert [r.name for r in kept] == ["a", "b", "c"]
    shape = SimpleNamespace(stiffness=0.3, grasper_inertia=0.0)
    (note,) = left_out_notes(made, kept, shape, RIG)
    assert note.startswith("d: 3 N at 2 rev/s took the current to its limit of 10 A")
    assert "the load swings at 7.88 Hz, where the controller's phase lags" in note
    assert not list(left_out_notes(made, made, shape, RIG))
    with pytest.raises(InsufficientDataError, match=r"recording d: .*the controller saturates"):
        unsaturated([made[0], made[1], made[3]], RIG, 2)
    assert [r.name for r in unsaturated([made[0], made[3]], RIG)] == ["a"]
    with pytest.raises(InsufficientDataError, match="recording a: "):
        unsaturated([recording("a", 0.0, LIMIT)], RIG)


@pytest.mark.parametrize(
    ("hertz", "integrator_hz"), [(5.2, 1), (7.9, 2), (10.0, None), (0.1, None)]
)
def test_the_integrator_that_is_named_is_the_first_with_which_the_controller_leads(
    hertz, integrator_hz
):
    text = driven(RIG, hertz)
    assert text.endswith(f"integrator_hz={integrator_hz} it leads" if integrator_hz else "")
    assert bool(text) == bool(integrator_hz)


def test_a_heavy_load_swings_less_with_the_integrator_that_is_named():
    """A loop that is driven to its limit by a load of 3 N, and the same with the setting."""
    swings = (
        "rig.current_limit=6",
        "virtual.instrument.stiffness=0.3",
        "virtual.instrument.damping=5e-4",
        "virtual.instrument.friction=4e-3",
        "virtual.motor.coulomb_friction=1e-3",
        "virtual.motor.static_friction=1.5e-3",
    )

    def peak(*sets):
        recipe = load_recipe(RECIPE, (*swings, *sets))[0]
        motion = Triangle.of_output(180.0, 20.0, 0.85, 2 * math.pi * 2 * 0.85, 20)
        fed = Feedforward(inertia=recipe.rig.nominal_inertia)
        blocks = open_rig(recipe, 0.045, "swings").perform(Task(motion, fed, Load(force=3.0)))
        return max(float(np.abs(block["current_setpoint"]).max()) for block in blocks)

    assert peak() > 5.99
    assert peak("rig.controller.integrator_hz=2") < 4.0
