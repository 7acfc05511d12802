"""`rigtool import`: run files from data that other programs recorded."""

from __future__ import annotations

import click

from rigtool.cli.options import debug_option, echo, example, overwrite_option, quiet_option


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
@click.option("--map", "map_path", metavar="MAP.toml", help="Meaning of the columns.")
@click.option("--skip-bad-lines", is_flag=True, help="Leave out bad lines and count them.")
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
    """Make run files from data that other programs recorded.

    SOURCE is delimited text (also .gz), MATLAB .mat, NumPy .npy or .npz, or a folder of such files.
    Several files become run files of their names in the folder OUTPUT. Recorder exports of EPOS
    Studio are recognised; for other files --map states the meaning of the columns. A bad file ends
    with exit code 3: the message names its lines, and nothing is written.
    """
    from rigtool.recipe.mapping import load_mapping
    from rigtool.runfile.importers import import_files

    mapping = None if map_path is None else load_mapping(map_path)
    done = import_files(
        sources,
        output,
        mapping,
        skip_bad=skip_bad_lines,
        overwrite=overwrite,
        map_path=map_path,
    )
    for item in done:
        left_out = f", {item.left_out} bad left out" if item.left_out else ""
        echo(f"{item.output}: {item.samples} samples{left_out}")
    if quiet:
        return
    for item in done:
        for note in item.notes:
            echo(f"Note: {item.output.name}: {note}", err=True)
