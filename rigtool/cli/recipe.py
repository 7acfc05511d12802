"""`rigtool recipe`: recipes that come with the program."""

from __future__ import annotations

from pathlib import Path

import click

from rigtool.cli.options import FILE, Command, completed, current_output, example


def _names(path: str) -> list[str]:
    from rigtool.recipe.shipped import shipped_recipes

    return list(shipped_recipes())


@click.command(cls=Command, epilog=example("rigtool recipe briaire-2006 -o rig.toml"))
@click.argument("name", required=False, shell_complete=completed(_names))
@click.option("-o", "--output", type=FILE, metavar="FILE.toml", help="Recipe to write.")
def command(name: str | None, output: str | None) -> None:
    """Copy a recipe that comes with rigtool, to change it.

    Without NAME, lists them. Without -o, prints the recipe. Mappings of imports are among them, as
    import/NAME.
    """
    from rigtool.recipe.shipped import shipped_recipe, shipped_recipes

    to = current_output()
    if name is None:
        for known in shipped_recipes():
            to.line(known)
        to.document(recipes=list(shipped_recipes()))
    elif output is None:
        text = shipped_recipe(name)
        to.line(text, nl=False)
        to.document(recipe=text)
    else:
        from rigtool.runfile.export import write_new

        text = shipped_recipe(name)
        inputs = [shipped_recipes()[name]]
        write_new(Path(output), to.overwrite, lambda path: path.write_text(text, "utf-8"), inputs)
        to.written(output, f"recipe {name}")
        to.document(output=output, recipe=text)
