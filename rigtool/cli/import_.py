"""`rigtool import`: other people's measurements into run files."""

from __future__ import annotations

import click

from rigtool.cli.options import debug_option, example, overwrite_option, quiet_option


@click.command(
    "import",
    epilog=example(
        "rigtool import run07.csv --map recipes/import/mis-tool.toml -o run07.h5",
        "rigtool import epos-exports/ -o runs/",
    ),
)
@click.argument("sources", nargs=-1, required=True, metavar="SOURCE...")
@click.option(
    "-o", "--output", required=True, metavar="RUN.h5|FOLDER", help="Run file, or folder for many."
)
@click.option("--map", "map_path", metavar="MAP.toml", help="What the columns mean.")
@click.option("--skip-bad-lines", is_flag=True, help="Leave bad lines out, and count them.")
@overwrite_option
@quiet_option
@debug_option
def command(
    sources: tuple[str, ...],
    output: str,
    map_path: str | None,
    skip_bad_lines: bool,
    overwrite: bool,
    quiet: bool,
) -> None:
    """Make run files of measured data from other rigs.

    SOURCE is delimited text (also .gz), MATLAB .mat, NumPy .npy or .npz; or a folder of them, or
    several: each becomes a run file of its name in the folder OUTPUT. Recorder exports of EPOS
    Studio are recognised by themselves; for others --map says what the columns mean. A bad file
    ends with exit code 3, its line is named, and nothing is written.
    """
    from rigtool.recipe.mapping import load_mapping
    from rigtool.runfile.importers import import_files

    mapping = None if map_path is None else load_mapping(map_path)
    done = import_files(sources, output, mapping, skip_bad=skip_bad_lines, overwrite=overwrite)
    for item in done:
        left_out = f", {item.left_out} bad left out" if item.left_out else ""
        click.echo(f"{item.output}: {item.samples} samples{left_out}")
    if quiet:
        return
    for item in done:
        for note in item.notes:
            click.echo(f"Note: {item.output.name}: {note}", err=True)
