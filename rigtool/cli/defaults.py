"""Defaults of commands from `rigtool.toml` in the working folder; `DEFAULT_KEYS` lists its keys."""

from __future__ import annotations

from pathlib import Path
from typing import Any

DEFAULTS_FILE = "rigtool.toml"

COMMANDS = (
    *("calibrate-kt", "stribeck", "fft-ripple", "identify-plant"),
    *("ilc-learn", "measure-force", "suspension"),
)
"""Commands that take the defaults: those that measure."""

OUTPUT_KEYS = {"calibrate-kt": "kt", "ilc-learn": "tables"}
"""The key that names the output of a command."""

DEFAULT_KEYS = {
    "recipe": "SOURCE of the commands that measure",
    "kt": "--kt, and the output of calibrate-kt",
    "tables": "--tables of measure-force, and the output of ilc-learn",
    "output": "folder of all other outputs, COMMAND.h5",
}


def stated() -> dict[str, str]:
    """Return what `rigtool.toml` states by its keys; nothing where there is no such file.

    Raises `RecipeError` where it cannot be read, or a key is unknown or no text.
    """
    if not Path(DEFAULTS_FILE).exists():
        return {}
    from rigtool.errors import RecipeError
    from rigtool.recipe.load import parse_toml, read_document

    text = read_document(DEFAULTS_FILE, "file of defaults", "config --help", pipe=False)
    data = parse_toml(text, DEFAULTS_FILE)
    for key, value in data.items():
        if key not in DEFAULT_KEYS:
            raise RecipeError(
                f"{DEFAULTS_FILE}: {key!r} is no default: use one of {', '.join(DEFAULT_KEYS)}"
            )
        if not isinstance(value, str) or not value:
            raise RecipeError(
                f'{DEFAULTS_FILE}: {key}: must be a text, e.g. {key} = "name", got {value!r}'
            )
    return data


def defaults_of(command: str) -> dict[str, Any]:
    """Return the defaults of a command, by its parameters."""
    if command not in COMMANDS:
        return {}
    found: dict[str, Any] = stated()
    given: dict[str, Any] = {name: found[name] for name in ("kt", "tables") if name in found}
    if "recipe" in found:
        given["sources"] = (found["recipe"],)
    written = found.get(OUTPUT_KEYS.get(command, ""))
    if written is None and "output" in found:
        written = str(Path(found["output"]) / f"{command}.h5")
    return given if written is None else {**given, "output": written}
