"""Speed of learning: one table of twenty turns; implementation B and an instrument, as a whole."""

from __future__ import annotations

import math
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[1]
RECIPE = ROOT / "recipes" / "briaire-2006.toml"
KT = ROOT / "tests" / "fixtures" / "kt.h5"
RIGTOOL = str(Path(sys.executable).with_name("rigtool"))

TURNS, RATE_HZ = 20, 8000


def one_table() -> Callable[[], object]:
    """Return what learns a row from 20 turns at 1 rev/s and 8 kHz."""
    from rigtool.experiments.learning.procedure_design import design_filters
    from rigtool.experiments.learning.turns import cut_turns, learned_row, repeatable_row
    from rigtool.recipe import load_recipe

    learning = design_filters(load_recipe(RECIPE, ["rig.attachment=pulley"])[0]).learning
    speed = 2 * math.pi
    step = np.arange(TURNS * RATE_HZ + 10)
    time_s, angle = step / RATE_HZ, step / RATE_HZ * speed
    noise = np.random.default_rng(1).normal(0, 1e-4, step.size)
    torque = 2e-3 + 1e-3 * np.sin(2 * angle) + noise

    def learn() -> object:
        turns = cut_turns(time_s, angle, torque, TURNS)
        return repeatable_row(learned_row(turns, speed, learning, 4000))

    return learn


INSTRUMENT = ROOT.parent / "shared" / "data" / "mis-tool" / "Tool_4_Maryland_L_4"
"""A measured instrument, where it is there (docs/real-instruments.md)."""


def instrument(folder: Path) -> Callable[[], object]:
    """Return what learns D from half of an instrument's runs by a command; this imports them."""
    mapping, runs = ROOT / "recipes" / "import" / "mis-tool.toml", folder / "instrument"
    line = [RIGTOOL, "import", str(INSTRUMENT), "--map", str(mapping), "-o", str(runs), "-q"]
    subprocess.run(line, check=True, capture_output=True)
    half = [str(path) for path in sorted(runs.glob("?[02468].h5"))]
    output = ["-o", str(folder / "instrument.h5"), "--implementation", "D", "--overwrite", "-q"]
    learn = [RIGTOOL, "ilc-learn", *half, *output]
    return lambda: subprocess.run(learn, check=True, capture_output=True)


def whole_b(folder: Path) -> Callable[[], object]:
    """Return what learns B from its stored run by a command; this makes the run."""
    run, again = folder / "b.h5", folder / "b-again.h5"
    inputs = ["--kt", str(KT), "--implementation", "B", "--overwrite", "-q"]

    def learn(source: Path, output: Path) -> None:
        line = [RIGTOOL, "ilc-learn", str(source), *inputs, "-o", str(output)]
        subprocess.run(line, check=True, capture_output=True)

    learn(RECIPE, run)
    return lambda: learn(run, again)
