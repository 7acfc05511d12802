"""The house as docs and newcomers know it: imports point down, commands start light."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "rigtool"
FLOORS = (
    "cli",
    "report",
    "procedures",
    "rigs",
    "runfile",
    "analysis",
    "recipe",
    "quantity",
    "errors",
)
MODULES = sorted(path for path in PACKAGE.rglob("*.py") if path.parent != PACKAGE)


def imported(tree):
    """Yield the modules that a syntax tree imports, wherever in it."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "imports are absolute here"
            yield node.module


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_imports_point_down(path):
    own = FLOORS.index(path.relative_to(PACKAGE).parts[0])
    for name in imported(ast.parse(path.read_text())):
        parts = name.split(".")
        if parts[0] == "rigtool" and len(parts) > 1:
            assert FLOORS.index(parts[1]) >= own, f"{path.name} imports {name} from above"


def test_analysis_knows_no_file_no_recipe_no_command_line():
    for path in (PACKAGE / "analysis").glob("*.py"):
        for name in imported(ast.parse(path.read_text())):
            assert name.split(".")[0] not in ("click", "h5py", "json", "pathlib"), path.name
            assert not name.startswith(("rigtool.recipe", "rigtool.runfile")), path.name


def test_analyses_and_procedures_never_see_the_virtual_rigs_parameters():
    for folder in ("analysis", "procedures", "report"):
        for path in (PACKAGE / folder).rglob("*.py"):
            text = path.read_text()
            assert "recipe.virtual" not in text or path.name == "session.py", path.name
            assert "rigs.virtual" not in text, path.name


def test_commands_import_what_is_heavy_only_when_called():
    code = """
import click, sys
from rigtool.cli import rigtool
for name in rigtool.list_commands(None):
    assert rigtool.get_command(None, name) is not None
heavy = {"numpy", "scipy", "h5py", "matplotlib", "numba", "pandas", "pydantic", "GTC"}
print(sorted(heavy & set(sys.modules)))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
