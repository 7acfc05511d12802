"""`rigtool import`: run files from data that other programs recorded."""

from __future__ import annotations

import click

from rigtool.cli.options import FILE, Command, current_output, example


@click.command(
    "import",
    cls=Command,
    epilog=example(
        "rigtool import run07.csv --map recipes/import/mis-tool.toml -o run07.h5",
        "rigtool import epos-exports/ -o runs/",
    ),
)
@click.argument("sources", nargs=-1, required=True, type=FILE, metavar="SOURCE...")
@click.option(
    "-o",
    "--output",
    required=True,
    type=FILE,
    metavar="RUN.h5|FOLDER",
    help="Run file, or folder for many.",
)
@click.option("--map", "map_path", type=FILE, metavar="MAP.toml", help="Meaning of the columns.")
@click.option("--skip-bad-lines", is_flag=True, help="Leave out bad lines and count them.")
def command(
    sources: tuple[str, ...],
    output: str,
    map_path: str | None,
    skip_bad_lines: bool,
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
    to = current_output()
    done = import_files(
        sources,
        output,
        mapping,
        skip_bad=skip_bad_lines,
        overwrite=to.overwrite,
        map_path=map_path,
    )
    for item in done:
        left_out = f", {item.left_out} bad left out" if item.left_out else ""
        to.written(item.output, f"run of import, {item.samples} samples{left_out}")
    for item in done:
        for note in item.notes:
            to.note(f"Note: {item.output.name}: {note}")
    to.document(
        output=output,
        runs=[
            {
                "output": str(item.output),
                "samples": item.samples,
                "left_out": item.left_out,
                "notes": list(item.notes),
            }
            for item in done
        ],
    )
