"""From any motion of a rig to its inertia and friction, by way of text and a mapping."""

import signal

import numpy as np
import pytest

import rigtool.cli as cli
from rigtool.experiments.procedure import channels
from rigtool.recipe import load_recipe
from rigtool.rigs import Task, open_rig
from rigtool.rigs.motion import SpeedProfile
from rigtool.runfile import RecordingSpec, RunWriter, open_run
from tests.experiments.virtual_runs import RECIPE
from tests.thorough import first_of

# The motor of 45.8 mN m/A at 20 degC, -0.116 %/K, in a room of 27 degC [7.1.1]
MAPPING = """mapping = 1
[rig]
name = "bare motor"
encoder_counts = 4000
torque_constant = 45.43e-3
torque_constant_u = 0.1e-3
[signals]
time = { column = "time [s]", unit = "s" }
encoder = { column = "encoder [count]", unit = "count" }
current = { column = "current [A]", unit = "A" }
"""


def profile(seed, top=25.0, seconds=40.0):
    """Speeds of eight frequencies from 0.2 to 3 Hz, from standstill to standstill."""
    random = np.random.default_rng(seed)
    time = np.arange(0, seconds, 0.005)
    frequencies = np.geomspace(0.2, 3.0, 8) * random.uniform(0.9, 1.1, 8)
    speed = np.sin(np.outer(time, 2 * np.pi * frequencies) + random.uniform(0, 6, 8)).sum(axis=1)
    speed *= top / np.max(np.abs(speed)) * np.clip(np.minimum(time, time[-1] - time), 0, 1)
    return SpeedProfile(tuple(time), tuple(speed))


def recorded(path, seed):
    """Move the bare motor and record it; return what the recipe says of it."""
    recipe, text = load_recipe(RECIPE, ["rig.attachment=pulley", f"virtual.seed={seed}"])
    names = channels("time", "encoder", "current")
    rig = open_rig(recipe, 0.0454, "stribeck")
    with RunWriter(
        path,
        command="move",
        recipe=recipe,
        recipe_text=text,
        recordings=[RecordingSpec("motion", names)],
    ) as out:
        for block in rig.perform(Task(profile(seed), record_every=8)):
            out.append("motion", {channel.name: block[channel.name] for channel in names})
        out.finish({}, {})
    return recipe.virtual.motor


def rigtool(*arguments):
    before = signal.getsignal(signal.SIGTERM)
    try:
        with pytest.raises(SystemExit) as end:
            cli.main([str(argument) for argument in arguments])
    finally:
        signal.signal(signal.SIGTERM, before)
    assert end.value.code == 0


@pytest.mark.parametrize("seed", first_of([1, 2, 3]))
def test_the_bare_motor_from_text(tmp_path, seed):
    motor = recorded(tmp_path / "moved.h5", seed)
    (tmp_path / "map.toml").write_text(MAPPING)
    rigtool("export", tmp_path / "moved.h5", "-o", tmp_path / "moved.csv")
    source, run = tmp_path / "moved.csv", tmp_path / "run.h5"
    rigtool("import", source, "--map", tmp_path / "map.toml", "-o", run)
    rigtool("stribeck", run, "-o", tmp_path / "friction.h5", "-q")
    with open_run(tmp_path / "friction.h5") as found:
        results, notes = found.results, found.notes
    for name, expected, unit in (
        ("inertia", motor.inertia, "kg m2"),
        ("viscous_friction", motor.viscous_friction, "N m s/rad"),
        ("coulomb_friction", motor.coulomb_friction, "N m"),
    ):
        result = results[name]
        assert result.unit == unit
        assert abs(result.value - expected) < 2 * result.u, (name, result, expected)
        # Its ripple is a third of its friction: uncertainties are large, but show something.
        assert result.u < 0.7 * expected
    assert any("samples left out: below 1 % of the highest speed" in note for note in notes)
