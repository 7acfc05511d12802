"""`rigtool recipe`: recipes that come with the program."""

from __future__ import annotations

import functools
import shutil
from pathlib import Path

import click

from rigtool.cli.options import debug_option, echo, example, overwrite_option


@click.command(epilog=example("rigtool recipe briaire-2006 -o rig.toml"))
@click.argument("name", required=False)
@click.option("-o", "--output", metavar="FILE.toml", help="Recipe to write.")
@click.option(
    "--firmware", metavar="FOLDER", help="With own-target: folder to write its firmware in C to."
)
@overwrite_option
@debug_option
def command(name: str | None, output: str | None, firmware: str | None, overwrite: bool) -> None:
    """Copy a recipe that comes with rigtool, to change it.

    Without NAME, lists them. Without -o, prints the recipe. Mappings of imports are among them, as
    import/NAME.
    """
    from rigtool.recipe.shipped import shipped_recipe, shipped_recipes

    if firmware is not None:
        _copy_firmware(name, Path(firmware), overwrite)
    if name is None:
        for known in shipped_recipes():
            echo(known)
    elif output is not None:
        from rigtool.runfile.export import write_new

        text = shipped_recipe(name)
        inputs = [shipped_recipes()[name]]
        write_new(Path(output), overwrite, lambda path: path.write_text(text, "utf-8"), inputs)
        echo(f"Written: {output}", err=True)
    elif firmware is None:
        echo(shipped_recipe(name), nl=False)


def _copy_firmware(name: str | None, folder: Path, overwrite: bool) -> None:
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
        require_output(folder / file.name, overwrite=overwrite, inputs=[file])
    for file in files:
        write_new(folder / file.name, True, functools.partial(shutil.copyfile, file))
        echo(f"Written: {folder / file.name}", err=True)
