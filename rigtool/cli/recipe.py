"""`rigtool recipe`: recipes that come with the program."""

from __future__ import annotations

import click

from rigtool.cli.options import debug_option, example, overwrite_option


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
    from rigtool.recipe.shipped import copy_recipe, shipped_recipe, shipped_recipes

    if name is None:
        for known in shipped_recipes():
            click.echo(known)
    elif output is None:
        click.echo(shipped_recipe(name), nl=False)
    else:
        copy_recipe(name, output, overwrite=overwrite)
        click.echo(f"Written: {output}", err=True)
