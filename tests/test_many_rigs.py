"""The Makefile for many rigs names every step; the Snakefile has the same ones."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[1] / "recipes" / "many-rigs"
STEPS = ("calibrate-kt", "stribeck", "ilc-learn", "measure-force", "report")


@pytest.mark.skipif(shutil.which("make") is None, reason="needs make")
def test_make_runs_every_step_of_every_rig_once(tmp_path):
    (tmp_path / "rigs").mkdir()
    for name in ("left", "right"):
        (tmp_path / "rigs" / f"{name}.toml").write_text("recipe = 1\n")
    done = subprocess.run(
        ["make", "-n", "-j2", "-f", FOLDER / "Makefile"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
    )
    for rig in ("left", "right"):
        for step in STEPS:
            assert len(re.findall(rf"rigtool {step} [^\n]*/?{rig}", done.stdout)) == 1, (rig, step)


def test_the_snakefile_has_the_same_steps():
    text = (FOLDER / "Snakefile").read_text()
    assert re.findall(r"rigtool ([\w-]+)", text) == list(STEPS)
