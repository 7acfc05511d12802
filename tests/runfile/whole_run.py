"""A run with everything a run file can hold, written once."""

from pathlib import Path

import numpy as np

from rigtool.quantity import Component, Quantity
from rigtool.recipe import load_recipe
from rigtool.runfile import Channel, Column, RecordingSpec, RunWriter, Table, open_run
from rigtool.runfile.provenance import Source

RECIPE = Path(__file__).parents[2] / "recipes" / "briaire-2006.toml"
SIZE = 20_000  # two whole chunks and a part of one

SPECS = (
    RecordingSpec(
        "sweep",
        (
            Channel("time", "s", "f8", "bench clock"),
            Channel("current", "A", "f4", "as the amplifier measures it"),
            Channel("encoder", "count", "i4", "quad counts"),
            Channel("limit_switch", "1", "u1", "closed or not"),
        ),
        {"speed": (3.0, "rad/s"), "moves": (20.0, "1")},
    ),
    RecordingSpec(
        "holds", (Channel("time", "s", "f8", "bench clock"), Channel("torque", "N m", "f8", "x"))
    ),
)
RESULTS = {
    "torque_constant": Quantity(
        0.0458,
        "N m/A",
        4e-5,
        12.0,
        budget=(
            Component("arm length", 0.54, "m", 0.2e-3, None, 0.0848),
            Component("scatter", 0.0, "N m/A", 3.6e-5, 9.0),
        ),
    ),
    "arm_length": Quantity(0.54, "m", reason="from the drawing"),
    "not_found": Quantity(float("nan"), "1", reason="the sweep was too short"),
}
TABLES = {
    "friction_model": Table(
        ("speed", "position"),
        {
            "speed": Column(np.array([1.0, 2.0]), "rad/s", "of the shaft"),
            "position": Column(np.linspace(0, 6, 50), "rad"),
            "torque": Column(np.arange(100.0).reshape(2, 50) * 1e-3, "N m", "friction"),
            "u": Column(np.full((2, 50), 1e-5), "N m"),
            "count": Column(np.array([3, 4]), "1"),
        },
        "torque",
        "friction by speed and position",
    ),
    "breakaway": Table(
        ("position",),
        {
            "position": Column(np.array([0.0, 1.0, 2.0]), "rad"),
            "positive": Column(np.array([2.4e-3, np.nan, 5e-3]), "N m"),
        },
        "positive",
        "",
    ),
}
SOURCE = Source("other.csv", "0" * 64, "mapping = 1\n")
NOTES = ("the second position did not move", "unit of ångström: Å")


def samples(size: int = SIZE) -> dict[str, dict[str, np.ndarray]]:
    """Samples of both recordings, the same at each call."""
    random = np.random.default_rng(7)
    time = np.arange(size) / 1000
    return {
        "sweep": {
            "time": time,
            "current": random.normal(size=size).astype("f4"),
            "encoder": np.arange(size, dtype="i4") - 500,
            "limit_switch": (np.arange(size) % 2).astype("u1"),
        },
        "holds": {"time": time, "torque": random.normal(size=size) * 1e-3},
    }


def write(path: Path, *, size: int = SIZE, inputs: tuple[Path, ...] = (), **options) -> Path:
    """Write the run with everything to `path`."""
    recipe, text = load_recipe(RECIPE)
    runs = [open_run(item) for item in inputs]
    arguments = {"command": "stribeck", "recipe": recipe, "recipe_text": text, "seed": 1}
    arguments |= {"recordings": SPECS, "inputs": runs, "argv": ["rigtool", "stribeck"]}
    with RunWriter(path, **(arguments | options)) as writer:
        if "recordings" not in options:
            for name, block in samples(size).items():
                writer.append(name, block)
        writer.note_line('{"retries": 0}')
        writer.finish(RESULTS, TABLES, NOTES)
    for run in runs:
        run.close()
    return path
