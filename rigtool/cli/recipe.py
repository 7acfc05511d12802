"""`rigtool recipe`: recipes that come with the program."""

from __future__ import annotations

from pathlib import Path

import click

from rigtool.cli.options import debug_option, echo, example, overwrite_option


@click.command(epilog=example("rigtool recipe briaire-2006 -o rig.toml"))
@click.argument("name", required=False)
@click.option("-o", "--output", metavar="FILE.toml", help="Recipe to write.")
@overwrite_option
@debug_option
def command(name: str | None, output: str | None, overwrite: bool) -> None:
    """Copy a recipe that comes with rigtool, to change it.

    Without NAME, lists them. Without -o, prints the recipe. Mappings of imports are among them, as
    import/NAME.
    """
    from rigtool.recipe.shipped import shipped_recipe, shipped_recipes

    if name is None:
        for known in shipped_recipes():
            echo(known)
    elif output is None:
        echo(shipped_recipe(name), nl=False)
    else:
        from rigtool.runfile.export import write_new

        text = shipped_recipe(name)
        inputs = [shipped_recipes()[name]]
        write_new(Path(output), overwrite, lambda path: path.write_text(text, "utf-8"), inputs)
        echo(f"Written: {output}", err=True)
