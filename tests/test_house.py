"""The house, held against the tree itself: floors, rooms, purity, circles, mirroring tests."""

import ast
import subprocess
import sys
from functools import cache

import pytest

from tests.house import MODULES, NUMERICS, PACKAGE, TESTS, parsed, place

FLOORS = (
    "cli",
    "api",
    "report",
    "experiments",
    "rigs",
    "runfile",
    "control",
    "numerics",
    "recipe",
    "plugins",
    "quantity",
    "signals",
    "inputs",
    "errors",
    "escapes",
    "interrupts",
)
"""From the top; a module imports from its own floor and from those below."""

MOST_ENTRIES = 20
"""Of a folder, `__init__.py` not counted."""

OF_FILES = ("click", "h5py", "pathlib", "rigtool.recipe", "rigtool.runfile", "rigtool.rigs")

FOLDERS = sorted({path.parent for path in MODULES})


@cache
def imported(path):
    """Return the modules and names that a file imports, wherever in it."""
    names = set()
    for node in ast.walk(parsed(path)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "imports are absolute here"
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


@cache
def module_file(name):
    """Return the file that an imported name is from, None for one of another package."""
    parts = name.split(".")
    while parts and parts[0] == "rigtool":
        path = PACKAGE.joinpath(*parts[1:])
        if path.with_suffix(".py").is_file():
            return path.with_suffix(".py")
        if (path / "__init__.py").is_file():
            return path / "__init__.py"
        parts.pop()
    return None


def test_imports_point_down():
    for path in MODULES:
        own = path.relative_to(PACKAGE).parts[0].removesuffix(".py")
        if own in ("__init__", "__main__"):
            continue
        for name in imported(path):
            parts = name.split(".")
            if parts[0] == "rigtool" and parts[1] in FLOORS:
                above = FLOORS.index(parts[1]) < FLOORS.index(own)
                assert not above, f"{place(path)}: {name} is above {own}"


def test_every_floor_is_named():
    entries = {path.stem for path in PACKAGE.iterdir() if path.suffix == ".py" or path.is_dir()}
    assert entries - {"__init__", "__main__", "__pycache__"} == set(FLOORS)


def test_numerics_know_no_file_no_recipe_no_rig_no_command_line():
    assert NUMERICS
    for path in NUMERICS:
        for name in imported(path):
            assert not name.startswith(OF_FILES), f"{place(path)}: {name}: numerics take arrays"


def entry(folder, path):
    """Return the file or folder in `folder` that a path is or lies in, None where it is outside."""
    if not path.is_relative_to(folder):
        return None
    return path.relative_to(folder).parts[0]


@pytest.mark.parametrize("folder", FOLDERS, ids=place)
def test_no_circles(folder):
    arrows = {}
    for path in MODULES:
        if path.is_relative_to(folder) and path != folder / "__init__.py":
            own = entry(folder, path)
            files = (module_file(name) for name in imported(path))
            others = {entry(folder, file) for file in files if file is not None}
            arrows.setdefault(own, set()).update(others - {own, None, "__init__.py"})
    while leaves := [own for own, others in arrows.items() if not others & arrows.keys()]:
        for leaf in leaves:
            del arrows[leaf]
    assert not arrows, f"these import each other: {arrows}"


@pytest.mark.parametrize("folder", FOLDERS, ids=place)
def test_no_room_is_crowded(folder):
    entries = {entry(folder, path) for path in MODULES if path.is_relative_to(folder)}
    assert len(entries - {"__init__.py"}) <= MOST_ENTRIES, sorted(entries)


def test_nothing_but_the_session_sees_the_virtual_rigs_parameters():
    for path in MODULES:
        if place(path).split("/")[0] in ("experiments", "report", "control", "numerics"):
            text = path.read_text(encoding="utf-8")
            assert (
                "recipe.virtual" not in text or place(path) == "experiments/running/session.py"
            ), path
            assert "rigs.virtual" not in text, path


WITHOUT_ROOM = ("attack", "fixtures", "emulators", "thesis")
"""Folders of tests that mirror no room."""


def test_tests_mirror_the_rooms():
    """A folder of tests is named as the room that it tests, and every room has tests."""
    tested = {path.parent.relative_to(TESTS) for path in TESTS.rglob("test_*.py")}
    rooms = {folder.relative_to(PACKAGE) for folder in FOLDERS}
    assert {one.as_posix() for one in tested - rooms if one.name not in WITHOUT_ROOM} == set()
    bare = {one.as_posix() for one in rooms - tested if one.name not in WITHOUT_ROOM}
    assert bare == set()


def test_commands_import_what_is_heavy_only_when_called():
    code = """
import click, sys
from rigtool.cli import rigtool
for name in rigtool.list_commands(None):
    assert rigtool.get_command(None, name) is not None
heavy = {"numpy", "scipy", "h5py", "matplotlib", "numba", "pandas", "pydantic"}
print(sorted(heavy & set(sys.modules)))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_a_table_that_has_u_has_degrees_of_freedom():
    """But for uncertainties of a posterior distribution, which have none."""
    of_posteriors = ("force_model/", "force_sensor/", "load_disturbance/")
    without = [
        f"{place(path)}:{node.lineno}"
        for path in MODULES
        if not any(room in place(path) for room in of_posteriors)
        for node in ast.walk(parsed(path))
        if isinstance(node, ast.Dict)
        for names in [[key.value for key in node.keys if isinstance(key, ast.Constant)]]
        for columns in [[v for v in node.values if "Column(" in ast.unparse(v)]]
        if columns and any(str(name).split("_")[-1] == "u" for name in names)
        if "dof" not in names
    ]
    assert without == []
