"""The worked examples of docs/extending.md, put into a copy of the package and run."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
BLOCK = re.compile(r"^```(?P<language>\w+)\n(?P<text>.*?)^```$", re.MULTILINE | re.DOTALL)
LISTS = {
    "Driver": ("rigtool/recipe/serial.py", "Driver = Literal[", ""),
    "MODULES": ("rigtool/rigs/serial/drivers.py", "MODULES = {\n", ""),
    "COMMANDS": ("rigtool/cli/__init__.py", "COMMANDS = {\n", ""),
    "IMPORTERS": (
        "rigtool/runfile/importers/__init__.py",
        "IMPORTERS = {",
        "from rigtool.runfile.importers import logger\n",
    ),
}
"""Where a line goes: the file, what it follows, and the import that it needs."""


@pytest.fixture(scope="module")
def copy(tmp_path_factory):
    """Return a copy of the package with all examples in it, and the lines to type."""
    root = tmp_path_factory.mktemp("extended")
    for folder in ("rigtool", "recipes"):
        shutil.copytree(ROOT / folder, root / folder, ignore=shutil.ignore_patterns("__pycache__"))
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
    file, behind, needed = LISTS[name]
    path = root / file
    source = path.read_text()
    assert source.count(behind) == 1
    future = "from __future__ import annotations\n"
    source = source.replace(behind, f"{behind}{text}").replace(future, f"{future}{needed}", 1)
    path.write_text(source)


def run(root, *arguments):
    return subprocess.run(
        [sys.executable, "-W", "error", *arguments], cwd=root, capture_output=True, text=True
    )


def test_the_lines_run(copy):
    root, lines = copy
    assert len(lines) >= 3
    for line in lines:
        name, *arguments = line.split()
        assert name == "rigtool"
        done = run(root, "-m", "rigtool", *arguments)
        assert done.returncode == 0, (line, done.stderr)
        assert done.stdout or "-o" in arguments, line


def test_the_example_says_what_it_measured(copy):
    found = run(copy[0], "-m", "rigtool", "heating", "kt.h5", "--resistance", "0.8").stdout
    assert re.match(r"staircase +\d+\.\d+ W", found), found
    refused = run(copy[0], "-m", "rigtool", "heating", "kt.h5", "--resistance", "0")
    assert refused.returncode == 4
    assert "must be above 0" in refused.stderr


def test_the_importer_names_the_bad_line(copy):
    root, _ = copy
    bad = (root / "run07.log").read_text().replace("i_ma=121", "i_ma=oops")
    (root / "bad.log").write_text(bad)
    refused = run(root, "-m", "rigtool", "import", "bad.log", "-o", "bad.h5")
    assert refused.returncode == 3
    assert "line 3" in refused.stderr


def test_their_own_tests_pass(copy):
    done = run(copy[0], "-m", "pytest", "-q", "-p", "no:cacheprovider", "tests")
    assert done.returncode == 0, done.stdout


def test_they_are_in_the_house_style(copy):
    files = [str(p) for p in copy[0].rglob("*.py") if not (ROOT / p.relative_to(copy[0])).exists()]
    assert len(files) >= 4
    for tool in (["check"], ["format", "--check"]):
        done = run(copy[0], "-m", "ruff", *tool, "--no-cache", *files)
        assert done.returncode == 0, done.stdout + done.stderr
