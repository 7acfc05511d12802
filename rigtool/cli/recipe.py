"""`rigtool recipe`: recipes that come with the program."""

from __future__ import annotations

import functools
import shutil
from pathlib import Path

import click

from rigtool.cli.options import FILE, Command, Output, completed, current_output, example


def _names(path: str) -> list[str]:
    from rigtool.recipe.shipped import shipped_recipes

    return list(shipped_recipes())


@click.command(cls=Command, epilog=example("rigtool recipe briaire-2006 -o rig.toml"))
@click.argument("name", required=False, shell_complete=completed(_names))
@click.option("-o", "--output", type=FILE, metavar="FILE.toml", help="Recipe to write.")
@click.option(
    "--firmware",
    type=FILE,
    metavar="FOLDER",
    help="With own-target: folder to write its firmware in C to.",
)
def command(name: str | None, output: str | None, firmware: str | None) -> None:
    """Copy a recipe that comes with rigtool, to change it.

    Without NAME, lists them. Without -o, prints the recipe. Mappings of imports are among them, as
    import/NAME.
    """
    from rigtool.recipe.shipped import shipped_recipe, shipped_recipes

    to = current_output()
    if firmware is not None:
        _copy_firmware(name, Path(firmware), to)
    if name is None:
        for known in shipped_recipes():
            to.line(known)
        to.document(recipes=list(shipped_recipes()))
    elif output is not None:
        from rigtool.runfile.export import write_new

        text = shipped_recipe(name)
        inputs = [shipped_recipes()[name]]
        write_new(Path(output), to.overwrite, lambda path: path.write_text(text, "utf-8"), inputs)
        to.written(output, f"recipe {name}")
        to.document(output=output, recipe=text)
    elif firmware is None:
        text = shipped_recipe(name)
        to.line(text, nl=False)
        to.document(recipe=text)
    else:
        to.document(output=firmware)


def _copy_firmware(name: str | None, folder: Path, to: Output) -> None:
    """Write the files of the firmware, or none where one of them is there."""
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
        to.written(folder / file.name, "file of the firmware")
