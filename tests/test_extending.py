"""The worked examples of docs/extending.md: put into a copy of rigtool, or installed, and run."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import rigtool

ROOT = Path(__file__).parents[1]
BLOCK = re.compile(r"^```(?P<language>\w+)\n(?P<text>.*?)^```$", re.MULTILINE | re.DOTALL)
INTO = {"COMMANDS": ("rigtool/cli/__init__.py", "COMMANDS = {\n")}
"""Where a line goes: the file, and what it follows."""


@pytest.fixture(scope="module")
def copy(tmp_path_factory):
    """Return a folder with a copy of rigtool, all examples in it, and the lines to type."""
    root = tmp_path_factory.mktemp("extended")
    for folder in ("rigtool", "recipes"):  # with what is compiled already
        shutil.copytree(ROOT / folder, root / folder)
    shutil.copy(ROOT / "pyproject.toml", root)
    shutil.copy(ROOT / "tests" / "fixtures" / "kt.h5", root)
    lines = []
    for block in BLOCK.finditer((ROOT / "docs" / "extending.md").read_text()):
        first, _, rest = block["text"].partition("\n")
        if block["language"] == "sh":
            lines += block["text"].splitlines()
        elif first.startswith("# into "):
            insert(root, first.removeprefix("# into "), rest)
        else:
            path = root / first.removeprefix("# ")
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(rest)
    return root, lines


def insert(root, name, text):
    file, behind = INTO[name]
    source = (root / file).read_text()
    assert source.count(behind) == 1
    (root / file).write_text(source.replace(behind, f"{behind}{text}"))


@pytest.fixture(scope="module")
def installed(copy):
    """Install the packages, and return what the lines between printed, by line."""
    root, lines = copy
    packages = [word for line in lines if line.startswith("pip ") for word in line.split()[2:]]
    options = ("--no-deps", "--no-build-isolation", "--disable-pip-version-check")
    install = ("-m", "pip", "install", "-q", *options, "--target", "site", *packages)
    done = run(root, "-W", "default", *install)  # the warnings are pip's own
    assert done.returncode == 0, done.stderr
    assert all(line.startswith(("pip install ", "rigtool ")) for line in lines)
    bad = (root / "run07.log").read_text().replace("i_ma=121", "i_ma=oops")
    (root / "bad.log").write_text(bad)
    typed = [line for line in lines if line.startswith("rigtool ")]
    return root, dict(zip([*typed, *OTHERS], rigtool_lines(root, [*typed, *OTHERS]), strict=True))


OTHERS = (
    "rigtool --help",
    "rigtool devices loop:// --driver nobody",
    "rigtool heating kt.h5 --resistance 0",
    "rigtool import bad.log -o bad.h5",
)
"""Lines beside those of the page."""

LINES = """
import contextlib, io, json, sys
from rigtool.cli import main
done = []
for line in json.loads(sys.argv[1]):
    out, err = io.StringIO(), io.StringIO()
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            main(line.split()[1:])
    except SystemExit as end:
        done.append((end.code, out.getvalue(), err.getvalue()))
print(json.dumps(done))
"""


def rigtool_lines(root, lines):
    """Run lines in one process that finds what is installed; return code, output and errors."""
    done = run(root, "-c", LINES, json.dumps(lines))
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def run(root, *arguments):
    return subprocess.run(
        [sys.executable, "-W", "error", *arguments],
        cwd=root,
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": "site"},
    )


def test_the_lines_run(installed):
    _, printed = installed
    assert len(printed) >= 4 + len(OTHERS)
    for line, (code, out, err) in printed.items():
        if line not in OTHERS:
            assert code == 0, (line, err)
            assert out or "-o" in line, line


def test_what_is_installed_is_listed_in_the_help(installed):
    _, text, _ = installed[1]["rigtool --help"]
    assert "rms" in text
    assert "Show the effective value of each signal. [rigtool-rms]" in text


def test_an_installed_command_shows_what_it_measured(installed):
    root, printed = installed
    with rigtool.open(root / "kt.h5") as kt:
        force = kt.recordings["staircase"].read("force")
    rms = float(np.sqrt(np.mean(force**2)))
    assert f"staircase  force  {rms:.4g} N\n" in printed["rigtool rms kt.h5"][1]


def test_an_installed_driver_is_among_those_that_are_asked(installed):
    code, _, err = installed[1]["rigtool devices loop:// --driver nobody"]
    assert code == 2
    assert ", acme," in err


def test_an_installed_importer_reads_its_format(installed):
    root, _ = installed
    with rigtool.open(root / "run07.h5") as run07:
        recording = run07.recordings["imported"]
        np.testing.assert_allclose(recording.read("time"), [0, 5e-4, 1e-3], rtol=1e-12)
        np.testing.assert_allclose(recording.read("current"), [0.118, 0.121, 0.119], rtol=1e-12)


def test_the_example_says_what_it_measured(installed):
    _, found, _ = installed[1]["rigtool heating kt.h5 --resistance 0.8"]
    assert re.match(r"staircase +\d+\.\d+ W", found), found
    code, _, err = installed[1]["rigtool heating kt.h5 --resistance 0"]
    assert code == 4
    assert "must be above 0" in err


def test_the_importer_names_the_bad_line(installed):
    code, _, err = installed[1]["rigtool import bad.log -o bad.h5"]
    assert code == 3
    assert "line 3" in err


def test_their_own_tests_pass(installed):
    root, _ = installed
    folders = ["tests", *(str(path) for path in root.glob("rigtool-*/tests"))]
    done = run(root, "-m", "pytest", "-q", "-p", "no:cacheprovider", *folders)
    assert done.returncode == 0, done.stdout


def test_they_are_in_the_house_style(copy):
    pytest.importorskip("ruff", reason="style is not among what the tests need")
    root, _ = copy
    files = [path.relative_to(root) for path in root.rglob("*.py")]
    files = [str(path) for path in files if not (ROOT / path).exists() and path.parts[0] != "site"]
    assert len(files) >= 4
    for tool in (["check"], ["format", "--check"]):
        done = run(root, "-m", "ruff", *tool, "--no-cache", *files)
        assert done.returncode == 0, done.stdout + done.stderr
