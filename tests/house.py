"""The rooms of the package, by place and name alone: what several tests of the house ask."""

import ast
from functools import cache
from pathlib import Path

TESTS = Path(__file__).parent
PACKAGE = TESTS.parent / "rigtool"
MODULES = sorted(PACKAGE.rglob("*.py"))

AT_THE_RIG = ("procedure", "results", "imported", "stored")
"""First words of files in a room of experiments that may know recipes, rigs and run files."""

WITHOUT_NUMERICS = ("experiments/learning/implementations", "experiments/running")
"""Rooms in which every file is a procedure."""


def place(path):
    """Return where a path stands in the package, as text."""
    return path.relative_to(PACKAGE).as_posix()


@cache
def parsed(path):
    """Return the syntax of a file."""
    return ast.parse(path.read_text(encoding="utf-8"))


def is_pure(path):
    """Return whether a file holds pure numerics."""
    folder, name = place(path.parent), path.name
    if folder in WITHOUT_NUMERICS or name == "__init__.py":
        return False
    if folder in ("numerics", "control"):
        return True
    room = folder.startswith("experiments/")
    return room and not name.removesuffix(".py").startswith(AT_THE_RIG)


NUMERICS = [path for path in MODULES if is_pure(path)]
