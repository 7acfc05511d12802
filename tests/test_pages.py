"""README.md and the pages for beginners: every command line runs as written, in its order.

The lines go through a shell, which expands them; a stand-in for `rigtool` notes what it was called
with. rigtool then runs each call, with settings of `make fixtures` added where it measures, so that
minutes become seconds.
"""

import json
import os
import re
import shlex
import shutil
import signal
import socket
import subprocess
import sys
from glob import glob
from pathlib import Path

import numpy as np
import pytest

import rigtool
from rigtool.cli import main
from rigtool.cli.batch import read_lines
from rigtool.report.figures import style
from tests.attack.bench import MEASURING
from tests.experiments.learned_loads import LINE, RIG, learned_loads
from tests.fixtures.make import SHORT

ROOT = Path(__file__).parents[1]
BLOCK = re.compile(r"^```sh\n(.*?)^```$", re.MULTILINE | re.DOTALL)

SHORTER = {
    "calibrate-kt": MEASURING["calibrate-kt"],
    "stribeck": MEASURING["stribeck"],
    "fft-ripple": SHORT["ripple"],
    "identify-plant": SHORT["plant"][1:],
    "ilc-learn": MEASURING["ilc-learn"],
    "ilc-learn --implementation A": SHORT["turning"][:-1],
    "ilc-learn --implementation B": SHORT["turning"][:-1],
    "measure-force": MEASURING["measure-force"],
    "measure-force --correction full": (*SHORT["force"], *RIG),
    "measure-force --record": RIG,
}
"""Settings by command, with the option that decides what it measures."""

CALLED = """#!{python}
import json, sys
with open({log!r}, "a") as log:
    log.write(json.dumps(sys.argv[1:]) + "\\n")
"""


def blocks(page):
    return BLOCK.findall((ROOT / page).read_text(encoding="utf-8"))


def section(page, heading):
    """Return the blocks under one heading of a page."""
    text = (ROOT / page).read_text(encoding="utf-8").partition(f"\n## {heading}\n")[2]
    assert text, f"{page} has no section {heading!r}"
    return BLOCK.findall(text.partition("\n## ")[0])


def calls(lines, folder):
    """Run lines in a shell; return the arguments of each call of rigtool."""
    programs, log = folder / "programs", folder / "calls"
    programs.mkdir()
    log.touch()
    (programs / "rigtool").write_text(CALLED.format(python=sys.executable, log=str(log)))
    (programs / "rigtool").chmod(0o755)
    path = f"{programs}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        ["bash", "-euc", lines],
        cwd=folder,
        env={**os.environ, "PATH": path},
        capture_output=True,
        text=True,
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", ""), lines
    return [json.loads(line) for line in log.read_text().splitlines()]


def run(arguments, capsys, shorter=SHORTER):
    """Call rigtool as the line does; return its output."""
    name, *words = [found for word in arguments for found in (sorted(glob(word)) or [word])]
    measures = any(word.endswith(".toml") for word in words[:1])
    chosen = [key for key in shorter if set(key.split()) <= set(arguments)] if measures else []
    settings = shorter[max(chosen, key=len)] if chosen else ()
    if "--record" in words:
        words[words.index("--record") + 1] = "3"
    before = signal.getsignal(signal.SIGTERM)
    try:
        with pytest.raises(SystemExit) as caught:
            main([name, *words, *(part for one in settings for part in ("--set", one))])
    finally:
        signal.signal(signal.SIGTERM, before)
    found = capsys.readouterr()
    assert caught.value.code == 0, (arguments, found.err)
    return found


def run_all(lines, folder, capsys, shorter=SHORTER):
    """Run every line; return the output by what was typed after `rigtool`."""
    return {" ".join(one): run(one, capsys, shorter) for one in calls(lines, folder)}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    shutil.copytree(ROOT / "recipes", tmp_path / "recipes")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def one_of_each(monkeypatch):
    """Draw figures to the end, but only the first of those with the same axes."""
    draw, drawn = style.render_figure, {}

    def render(figure):
        axes = tuple((one.get_xlabel(), one.get_ylabel(), one.get_title()) for one in figure.axes)
        if axes not in drawn:
            drawn[axes] = draw(figure)
        return drawn[axes]

    monkeypatch.setattr(style, "render_figure", render)


def test_the_chain_of_the_readme_runs(folder, capsys, one_of_each):
    chain = blocks("README.md")[1]
    printed = run_all(chain, folder, capsys)
    assert len(printed) == 8
    assert (folder / "build" / "report" / "index.html").is_file()
    figures = folder / "build" / "report" / "figures"
    drawn = {path.stem: path.read_bytes() for path in figures.glob("*.png")}
    assert len(drawn) >= 20
    for name, png in drawn.items():
        assert png.startswith(b"\x89PNG")
        svg = (figures / f"{name}.svg").read_text(encoding="utf-8")
        assert svg.startswith("<?xml")
        assert len(svg) < 300_000
    text = printed["report build/*.h5 -o build/report"].out
    assert "Table 8" in text
    assert "Table 9" in text


def test_what_the_readme_learns_and_corrects_beyond_the_chain_runs(
    folder, capsys, tmp_path_factory
):
    chain, *others = blocks("README.md")[1:]
    build = folder / "build"
    build.mkdir()
    for name in ("kt", "friction"):
        shutil.copy(ROOT / "tests" / "fixtures" / f"{name}.h5", build)
    d, *measured, a, b = calls("\n".join([chain.splitlines()[0], *others]), folder)
    assert len(measured) == 2
    # One run of this line makes the tables of all tests that need known loads.
    assert " ".join(d) == LINE.format(recipe=a[1], kt="build/kt.h5", tables="build/tables-loads.h5")
    learned_loads(tmp_path_factory, build / "tables-loads.h5")
    for line in (a, b, *measured):
        run(line, capsys)


def test_every_target_of_make_in_the_readme_exists():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    targets = re.findall(r"^\.PHONY: (.*)$", (ROOT / "Makefile").read_text(), re.MULTILINE)[0]
    named = set(re.findall(r"`?make ([a-z-]+)", text))
    assert len(named) >= 6
    assert named <= set(targets.split())


def test_the_exit_codes_of_the_readme_are_those_of_the_help(capsys):
    with pytest.raises(SystemExit):
        main(["--help"])
    shown = " ".join(capsys.readouterr().out.split())
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    shown = shown.partition("Exit codes: ")[2].partition("Options:")[0]
    assert re.findall(r"^\| (\d+) \|", text, re.MULTILINE) == re.findall(r"(\d+) [a-z]", shown)


def test_the_start_page_runs(folder, capsys, monkeypatch):
    # The chain of the README draws the figures of its report.
    drawn = "rigtool.report.figures.style.render_figure"
    monkeypatch.setattr(drawn, lambda figure: ("<svg/>", b"\x89PNG"))
    lines = "\n".join(
        block
        for name in (
            "Measure",
            "Change something",
            "Defaults for a folder",
            "Draw one thing",
        )
        for block in section("docs/start.md", name)
    )
    printed = run_all(lines, folder, capsys)
    assert len(printed) == 16
    assert (folder / "shift.png").is_file()
    assert "torque_constant " in printed["calibrate-kt rig.toml -o kt.h5"].out
    assert json.loads(printed["info kt.h5 --json"].out)
    assert printed["diff kt.h5 again.h5"].err == "no difference\n"
    assert (folder / "report" / "index.html").is_file()


def test_the_start_page_reads_an_unknown_force(folder, capsys, monkeypatch, tmp_path_factory):
    drawn = "rigtool.report.figures.style.render_figure"
    monkeypatch.setattr(drawn, lambda figure: ("<svg/>", b"\x89PNG"))
    shutil.copy("recipes/briaire-2006.toml", "rig.toml")
    shutil.copy(ROOT / "tests" / "fixtures" / "kt.h5", folder)
    (lines,) = section("docs/start.md", "Read an unknown force")
    learn, read, report = calls(lines, folder)
    assert " ".join(learn) == LINE.format(recipe="rig.toml", kt="kt.h5", tables="loads.h5")
    learned_loads(tmp_path_factory, folder / "loads.h5")
    run(read, capsys)
    with rigtool.open(folder / "unknown.h5") as unknown:
        assert np.isfinite(unknown.results["coverage_95"].value)
    run(report, capsys)
    assert (folder / "report-unknown" / "index.html").is_file()


def test_the_lines_that_the_start_page_batches_are_commands(folder):
    batches = calls("\n".join(section("docs/start.md", "Many small runs")), folder)
    assert batches == [["batch", "lines.txt", "-j", "2"]]
    assert [line.words[-1] for line in read_lines("lines.txt")] == ["1", "2", "3"]


def test_the_start_page_analyses_a_table_of_numbers(folder, capsys):
    (folder / "recorded").mkdir()
    random, time = np.random.default_rng(1), np.arange(0, 4000, 10.0)
    for rpm in (-400, -200, -100, 100, 200, 400):
        current = (2e-3 * np.sign(rpm) + 5e-5 * rpm * np.pi / 30) / 0.0458
        rows = (time, np.full(len(time), rpm), current + random.normal(0, 2e-4, len(time)))
        np.savetxt(
            folder / "recorded" / f"at{rpm}.csv",
            np.column_stack(rows),
            delimiter=",",
            header="t,n,i",
            comments="",
        )
    (lines,) = section("docs/start.md", "Analyse your own data")
    printed = run_all(lines, folder, capsys)
    assert len(printed) == 3
    with rigtool.open(folder / "friction.h5") as friction:
        coulomb = friction.results["coulomb_friction"]
        assert coulomb.value == pytest.approx(2e-3, abs=3 * coulomb.u)
        assert coulomb.u < 1e-4
    assert (folder / "report-friction" / "index.html").is_file()


@pytest.mark.real_time
def test_the_start_page_installs(tmp_path):
    checkout = tmp_path / "checkout"
    for name in ("rigtool", "recipes", "README.md", "LICENSE", "pyproject.toml", "setup.py"):
        copy = shutil.copytree if (ROOT / name).is_dir() else shutil.copy
        checkout.mkdir(exist_ok=True)
        copy(ROOT / name, checkout / name)
    (lines,) = section("docs/start.md", "Install")
    # Dependencies, setuptools and pip are those of the tests: nothing is downloaded or unpacked.
    python = shlex.quote(sys.executable)
    for typed, instead in (
        ("-m venv", "-m venv --without-pip"),
        (".venv/bin/pip", f"{python} -m pip --python .venv"),
        ("install .", "install -q --no-deps --no-build-isolation ."),
    ):
        assert typed in lines
        lines = lines.replace(typed, instead)
    site = Path(np.__file__).parents[1]
    done = subprocess.run(
        ["bash", "-euc", f"PATH={Path(sys.executable).parent}:$PATH\n{lines}command -v rigtool"],
        cwd=checkout,
        env={
            **os.environ,
            "PYTHONPATH": str(site),
            "PIP_DISABLE_PIP_VERSION_CHECK": "1",
            "PIP_NO_COMPILE": "1",  # of what is installed, one program is started once
        },
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    version, program = done.stdout.splitlines()[-2:]
    assert rigtool.__version__ in version
    assert program == str(checkout / ".venv" / "bin" / "rigtool")


@pytest.mark.real_time
def test_the_session_without_hardware_runs(folder, capsys, monkeypatch):
    """The emulator is a process of its own; consent is typed at a terminal."""
    emulator, lines = section("docs/bench.md", "A first session without hardware")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = str(free.getsockname()[1])
    assert "7077" in emulator
    assert "7077" in lines
    environment = {
        **os.environ,
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
    }
    master, terminal = os.openpty()
    with os.fdopen(terminal) as keyboard:
        monkeypatch.setattr(sys, "stdin", keyboard)
        server = subprocess.Popen(
            ["bash", "-euc", f"exec {emulator.replace('7077', port)}"],
            cwd=folder,
            env=environment,
            stdout=subprocess.PIPE,
            text=True,
        )
        try:
            assert server.stdout.readline() == f"socket://127.0.0.1:{port}\n"
            os.write(master, b"y\n")
            printed = run_all(lines.replace("7077", port), folder, capsys, {})
        finally:
            server.terminate()
            server.wait()
            server.stdout.close()
            os.close(master)
    assert "target: rigtool target emulator" in printed[f"devices socket://127.0.0.1:{port}"].out
    assert printed["diff kt.h5 direct.h5"].err == "no difference\n"
