"""What is attacked: run files, recipes and commands, with what each of them says undisturbed."""

from __future__ import annotations

import functools
import importlib
import pkgutil
import random
import shutil
import time
from dataclasses import dataclass
from pathlib import Path

import pytest

import rigtool
from rigtool import cli
from tests.attack.trial import content, run

ROOT = Path(__file__).parents[2]
RECIPE = ROOT / "recipes" / "briaire-2006.toml"
STORED = ("kt", "friction", "ripple", "plant", "tables", "force", "turning")
RECIPES = sorted((ROOT / "recipes").glob("*.toml"))
KT, TABLES = (ROOT / "tests" / "fixtures" / f"{name}.h5" for name in ("kt", "tables"))

MEASURING = {
    "calibrate-kt": ("calibrate_kt.temperatures_degc=[20, 50]", "calibrate_kt.rotor_positions=2"),
    "stribeck": (
        "stribeck.hold_speeds=[5, 12, 30]",
        "stribeck.hold_revolutions=1",
        "stribeck.hold_time=0.1",
        "stribeck.sweep_time=3",
        "stribeck.breakaway_positions=3",
        "stribeck.radial_force=0",
    ),
    "fft-ripple": (
        "fft_ripple.speeds=[15, 30]",
        "fft_ripple.revolutions=4",
        "fft_ripple.torques=[]",
    ),
    "identify-plant": (
        "rig.attachment=pulley",
        "identify_plant.speeds=[12]",
        "identify_plant.realisations=2",
        "identify_plant.periods=4",
    ),
    "ilc-learn": (
        "ilc_learn.moves=4",
        "ilc_learn.speeds_rev_per_s=[3, 6]",
        "ilc_learn.low_speeds_rev_per_s=[]",
    ),
    "measure-force": (
        "measure_force.forces=[0.25]",
        "measure_force.cycles=3",
        "measure_force.extra_cycles=1",
        "measure_force.speed_rev_per_s=0.4",
    ),
    "suspension": (),
}
"""Commands that record, each in short."""

NEEDS = {
    "calibrate-kt": (),
    "suspension": (),
    "measure-force": ("--kt", KT, "--tables", TABLES),
}
"""Inputs by command; the others need the calibration."""

ANALYSES = {
    "kt": "calibrate-kt",
    "friction": "stribeck",
    "ripple": "fft-ripple",
    "plant": "identify-plant",
    "tables": "ilc-learn",
    "force": "measure-force",
    "turning": "ilc-learn",
}
"""The command that analyses a stored run of the fixtures."""


def inputs(command: str) -> tuple[object, ...]:
    """Return the options of a command that name its inputs."""
    return NEEDS.get(command, ("--kt", KT))


def measuring(command: str, output: Path, recipe: Path = RECIPE) -> list[object]:
    """Return the line of a command that measures in short."""
    sets = [word for value in MEASURING[command] for word in ("--set", value)]
    line = [command, recipe, *inputs(command), *sets, "-q", "--overwrite"]
    return [*line, "-o", output]


def warm() -> None:
    """Import all modules of the package, so that forks have them."""
    for module in pkgutil.walk_packages(rigtool.__path__, "rigtool."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)


@dataclass
class Bench:
    """A folder to work in, luck, and what commands say undisturbed."""

    folder: Path
    luck: random.Random

    def file(self, name: str) -> Path:
        """Return a fresh name in a folder without anything else."""
        place = self.folder / "now"
        shutil.rmtree(place, ignore_errors=True)
        place.mkdir()
        return place / name

    @functools.cached_property
    def stored(self) -> dict[str, Path]:
        """The run files of the fixtures."""
        return {name: ROOT / "tests" / "fixtures" / f"{name}.h5" for name in STORED}

    def expected(self, command: str) -> tuple[str, float]:
        """Return the content of an undisturbed run of a command, and how long it takes, s."""
        return _undisturbed(self.folder, command)


@functools.cache
def _undisturbed(folder: Path, command: str) -> tuple[str, float]:
    whole = folder / f"{command}.whole.h5"
    with pytest.raises(SystemExit, match="0"):  # here, so that forks have all that it imports
        cli.main([str(word) for word in measuring(command, whole)])
    begin = time.perf_counter()
    trial = run(measuring(command, whole))
    duration = time.perf_counter() - begin
    assert trial.code == 0, trial.err
    found = content(whole)
    assert found is not None
    return found, duration


@functools.cache
def said(words: tuple[object, ...]) -> tuple[int, str]:
    """Return exit code and output of a command line on good files."""
    trial = run(words)
    return trial.code, trial.out
