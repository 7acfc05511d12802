"""Every example in a command's help does what it says, in a folder that has what it names."""

import shutil
from contextlib import contextmanager
from glob import glob
from pathlib import Path

import click
import numpy as np
import pytest

import rigtool.cli as cli
from rigtool.rigs.serial.emulators.server import serve
from rigtool.rigs.serial.moteus.table import MoteusTable
from tests.attack.bench import MEASURING
from tests.cli.called import exit_code
from tests.cli.test_run_commands import interrupted
from tests.experiments.deploy.test_stored_sensor import learned_run
from tests.experiments.imported_runs import SLOW, slow_turn, take
from tests.experiments.torque_constant.test_current_levels import draw
from tests.experiments.torque_constant.test_imported import TEXT as STAIRCASE
from tests.fixtures.make import SHORT
from tests.rigs.serial.emulators import moteus
from tests.runfile.importers.test_epos import write as write_epos

ROOT = Path(__file__).parents[2]
FIXTURES = ROOT / "tests" / "fixtures"
RECIPE = "rig.toml"


SHORTER = {**MEASURING, "ilc-learn": SHORT["tables"]}
"""Settings that shorten an example on a recipe; a stored table is checked at its own speeds."""


def lines_of_the_readme():
    """Return the lines that tests/test_pages.py runs, in a folder of their own."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    lines = text.partition("R=recipes/briaire-2006.toml; mkdir -p build\n")[2].splitlines()
    return {" ".join(line.split()).replace("$R", RECIPE).replace("build/", "") for line in lines}


def examples():
    """Yield the examples, but those that run as lines of the README."""
    elsewhere = lines_of_the_readme()
    for name in cli.COMMANDS:
        command = cli.rigtool.get_command(click.Context(cli.rigtool), name)
        for line in (command.epilog or "").replace(" \\\n   ", "").splitlines():
            if line.strip().startswith("rigtool ") and line.strip() not in elsewhere:
                yield line.strip()


@pytest.fixture
def bench(tmp_path, monkeypatch):
    """Return a folder with the recipes, the stored runs and what else the examples name."""
    shutil.copytree(ROOT / "recipes", tmp_path / "recipes")
    shutil.copy(ROOT / "recipes" / "briaire-2006.toml", tmp_path / RECIPE)
    for path in FIXTURES.glob("*.h5"):
        shutil.copy(path, tmp_path)
    shutil.copy(tmp_path / "kt.h5", tmp_path / "kt-again.h5")
    monkeypatch.chdir(tmp_path)
    # A drive's table of 128 codes is stored in an eighth of the requests.
    monkeypatch.setattr(MoteusTable, "size", 128)
    monkeypatch.setattr(moteus, "CODES", 128)
    return tmp_path


def prepare(bench, line):
    """Make what an example reads beside the stored runs."""
    if "imported/comp_0.h5" in line:
        files = {"off_0": slow_turn(0, 0.0), "on_0": slow_turn(1, 0.8)}
        off, on = take(bench, SLOW, files)
        (bench / "imported").mkdir()
        shutil.copy(off, bench / "imported" / "nocomp_0.h5")
        shutil.copy(on, bench / "imported" / "comp_0.h5")
    elif "calibrate-kt imported/" in line:
        _, recorded = draw("staircase", 5)
        arrays = {"t": recorded.time, "i": recorded.current, "f": recorded.torque / 0.5}
        take(bench, STAIRCASE, {"a": {**arrays, "degc": recorded.temperature}})
        (bench / "runs").rename(bench / "imported")
    elif "loaded.h5" in line:
        shutil.copy(bench / "friction.h5", bench / "loaded.h5")
        with pytest.raises(SystemExit):
            cli.main(["stribeck", "friction.h5", "--kt", "kt.h5", "-o", "bare.h5", "-q"])
    elif "stribeck imported/" in line:
        hold(bench, (-20, -10, -5, 5, 10, 20))
    elif "--against bare.h5" in line:
        pair(bench)
    elif "run07.csv" in line:
        rows = np.column_stack([np.arange(50) / 1000, *np.arange(450.0).reshape(9, 50)])
        np.savetxt(bench / "run07.csv", rows, delimiter=",")
    elif "epos-exports/" in line:
        (bench / "epos-exports").mkdir()
        write_epos(bench / "epos-exports" / "10.csv")
    elif "tables-loads.h5" in line:
        learned_run(bench / "tables-loads.h5")
    elif "batch lines.txt" in line:
        (bench / "lines.txt").write_text("info kt.h5 -q\ninfo force.h5 -q\n")
    elif "kt.h5.part" in line:
        (bench / "kt.h5").unlink()
        interrupted(bench / "kt.h5")


def hold(bench, speeds):
    """Import runs at constant speeds against 2 mN m of Coulomb friction."""
    text = """mapping = 1
[rig]
name = "held"
[signals]
time = { column = "t", unit = "s" }
speed = { column = "v", unit = "rad/s" }
torque = { column = "m", unit = "N m" }
"""
    random, time = np.random.default_rng(1), np.arange(0, 4, 0.01)
    files = {}
    for speed in speeds:
        torque = 2e-3 * np.sign(speed) + 5e-5 * speed + random.normal(0, 1e-5, len(time))
        files[f"at{speed}"] = {"t": time, "v": np.full(len(time), float(speed)), "m": torque}
    take(bench, text, files)
    (bench / "runs").rename(bench / "imported")


def pair(bench):
    """Import two runs of one motion, the second with twice the inertia."""
    text = """mapping = 1
[rig]
name = "pair"
[signals]
time = { column = "t", unit = "s" }
position = { column = "p", unit = "rad" }
torque = { column = "m", unit = "N m" }
"""
    random, time = np.random.default_rng(1), np.arange(0, 20, 0.002)
    phase = np.outer([0.5, 1.3, 2.1], 2 * np.pi * time)
    rate = 2 * np.pi * np.array([[0.5], [1.3], [2.1]])
    angle, speed, acceleration = np.sin(phase), rate * np.cos(phase), -(rate**2) * np.sin(phase)
    files = {}
    for name, inertia in (("bare", 2e-5), ("loaded", 4e-5)):
        torque = inertia * acceleration.sum(0) + 2e-3 * np.sign(speed.sum(0))
        noisy = torque + random.normal(0, 1e-5, len(time))
        files[name] = {"t": time, "p": angle.sum(0), "m": noisy}
    for path in take(bench, text, files):
        shutil.copy(path, bench / Path(path).name)


MOTEUS = """
[serial]
driver = "moteus"
port = "PORT"
[serial.limits]
current = 10
speed = 60
position = [-1e4, 1e4]
temperature_degc = 90
duration = 600
"""


@contextmanager
def drive(bench, line):
    """Serve the drive that an example's recipe names."""
    if "moteus.toml" not in line:
        yield
        return
    text = (bench / "recipes" / "briaire-2006.toml").read_text()
    with serve(moteus.MoteusEmulator()) as server:
        on_line = text.replace('source = "virtual"', 'source = "serial"')
        (bench / "moteus.toml").write_text(on_line + MOTEUS.replace("PORT", server.port))
        yield


@pytest.mark.parametrize("line", list(examples()))
def test_the_example_runs(bench, line, capsys, monkeypatch):
    # Tests of the report draw its figures.
    drawn = "rigtool.report.figures.style.render_figure"
    monkeypatch.setattr(drawn, lambda figure: ("<svg/>", b"\x89PNG"))
    # Whatever is connected to this computer is asked nothing.
    monkeypatch.setattr("serial.tools.list_ports.comports", list)
    prepare(bench, line)
    with drive(bench, line):
        run_example(bench, line, capsys)


def run_example(bench, line, capsys):
    _, name, *words = line.split()
    arguments = [found for word in words for found in (sorted(glob(word)) or [word])]
    if RECIPE in arguments:
        for setting in SHORTER.get(name, ()):
            arguments += ["--set", setting]
    if "-o" in arguments and "--overwrite" not in arguments:
        output = bench / arguments[arguments.index("-o") + 1]
        if output.is_file():
            output.unlink()
    assert exit_code(name, *arguments) == 0, capsys.readouterr().err
    if "-o" in arguments:
        assert (bench / arguments[arguments.index("-o") + 1]).exists()
