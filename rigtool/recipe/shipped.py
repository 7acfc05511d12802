"""Recipes that come with rigtool: beside the package in a checkout, else where pip put them."""

from __future__ import annotations

import re
from importlib.metadata import PackageNotFoundError, distribution
from itertools import takewhile
from pathlib import Path

from rigtool.errors import UsageError, did_you_mean

FOLDER = "share/rigtool/recipes"
"""Folder of the recipes in a wheel, below the data folder of the environment."""


def shipped_recipes() -> dict[str, Path]:
    """Return the path of each recipe by its name: the file's path without its suffix."""
    checkout = Path(__file__).parents[2]
    if (checkout / "pyproject.toml").exists():
        beside = checkout / "recipes"
        return {
            path.relative_to(beside).with_suffix("").as_posix(): path
            for path in sorted(beside.rglob("*.toml"))
        }
    try:
        files = distribution("rigtool").files or []
    except PackageNotFoundError:
        return {}
    found = {}
    for file in files:
        _, folder, name = file.as_posix().partition(f"{FOLDER}/")
        if folder and name.endswith(".toml"):
            found[name.removesuffix(".toml")] = Path(str(file.locate()))
    return dict(sorted(found.items()))


def recipe_title(path: Path) -> str:
    """Return what a recipe describes: its first comment, as far as the first stop."""
    lines = takewhile(lambda line: line.startswith("#"), path.read_text("utf-8").splitlines())
    return re.split(r"(?<![A-Z])[.,:;] ", " ".join(line.strip("# ") for line in lines))[0].rstrip(
        "."
    )


def shipped_recipe(name: str) -> str:
    """Return the text of a recipe; `UsageError` for one that does not come with rigtool."""
    known = shipped_recipes()
    if name not in known:
        remedy = did_you_mean(name, known, "choose one of them")
        raise UsageError(f"no recipe {name} comes with rigtool, only {', '.join(known)}; {remedy}")
    return known[name].read_text(encoding="utf-8")


WITH_FIRMWARE = "own-target"
"""The recipe to which a target's firmware belongs."""


def shipped_firmware() -> list[Path]:
    """Return the files of the firmware in C, which lie in the package."""
    folder = Path(__file__).parents[1] / "rigs" / "serial" / "target" / "firmware"
    return sorted(path for path in folder.iterdir() if path.suffix in (".c", ".h"))
