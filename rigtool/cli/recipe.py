"""`rigtool recipe`: recipes that come with the program."""

from __future__ import annotations

import functools
import shutil
from pathlib import Path
from typing import Any

import click

from rigtool.cli.options import FILE_ARGUMENT, command_with, completed, current_output
from rigtool.cli.output import Output


def _names(path: str) -> list[str]:
    from rigtool.recipe.shipped import shipped_recipes

    return list(shipped_recipes())


@command_with("rigtool recipe briaire-2006 -o rig.toml")
@click.argument("name", required=False, shell_complete=completed(_names))
@click.option("-o", "--output", type=FILE_ARGUMENT, metavar="FILE.toml", help="Recipe to write.")
@click.option(
    "--firmware",
    type=FILE_ARGUMENT,
    metavar="FOLDER",
    help="With own-target: folder to write its firmware in C to.",
)
def command(name: str | None, output: str | None, firmware: str | None) -> None:
    """Copy a recipe that comes with rigtool, to change it.

    Without NAME, lists them, each with what it describes. Without -o, prints the recipe. Mappings
    of imports are among them, as import/NAME.
    """
    from rigtool.errors import UsageError
    from rigtool.recipe.shipped import recipe_title, shipped_recipe, shipped_recipes
    from rigtool.runfile.outputs import replacing, require_output

    to, known = current_output(), shipped_recipes()
    found: dict[str, Any] = {}
    text = None if name is None else shipped_recipe(name)
    if output is not None:
        if name is None:
            raise UsageError(f"-o {output}: give the NAME of the recipe to write there")
        copy = require_output(output, overwrite=to.overwrite, inputs=[known[name]])
    if firmware is not None:
        found["firmware"] = _copy_firmware(name, Path(firmware), to)
    if text is None:
        for each, path in known.items():
            to.line(f"{each:{max(map(len, known))}}  {recipe_title(path)}")
        found["recipes"] = list(known)
    else:
        found["recipe"] = text
        if output is not None:
            with replacing(copy) as new:
                new.write_text(text, "utf-8")
            to.written(output, f"recipe {name}")
        elif firmware is None:
            to.line(text, nl=False)
    to.document(output=output, **found)


def _copy_firmware(name: str | None, folder: Path, to: Output) -> list[str]:
    """Write the files of the firmware, or none where one is there; return their names."""
    from rigtool.errors import UsageError
    from rigtool.recipe.shipped import WITH_FIRMWARE, shipped_firmware
    from rigtool.runfile.export import require_output, write_new

    if name != WITH_FIRMWARE:
        raise UsageError(
            f"--firmware {folder}: only the recipe {WITH_FIRMWARE} has firmware: rigtool recipe "
            f"{WITH_FIRMWARE} --firmware {folder}"
        )
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"--firmware {folder}: cannot be made: {error.strerror}") from None
    files = shipped_firmware()
    for file in files:
        require_output(folder / file.name, overwrite=to.overwrite, inputs=[file])
    for file in files:
        write_new(folder / file.name, True, functools.partial(shutil.copyfile, file))
        to.written(folder / file.name, "firmware of a target, in C")
    return [str(folder / file.name) for file in files]
