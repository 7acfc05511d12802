"""`rigtool import`: run files from data that other programs recorded."""

from __future__ import annotations

import click

from rigtool.cli.options import debug_option, echo, example, overwrite_option, quiet_option


@click.command(
    "import",
    epilog=example(
        "rigtool import run07.csv --map recipes/import/mis-tool.toml -o run07.h5",
        "rigtool import epos-exports/ -o runs/",
        "rigtool import run07.csv --preview",
    ),
)
@click.argument("sources", nargs=-1, required=True, metavar="SOURCE...")
@click.option("-o", "--output", metavar="RUN.h5|FOLDER", help="Run file, or folder for many.")
@click.option("--map", "map_path", metavar="MAP.toml", help="Meaning of the columns.")
@click.option("--preview", is_flag=True, help="Show SOURCE as it would be read; write nothing.")
@click.option("--skip-bad-lines", is_flag=True, help="Leave out bad lines and count them.")
@click.option("--skip-bad-files", is_flag=True, help="Leave out bad files and name them.")
@overwrite_option
@quiet_option
@debug_option
def command(
    sources: tuple[str, ...],
    output: str | None,
    map_path: str | None,
    preview: bool,
    skip_bad_lines: bool,
    skip_bad_files: bool,
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
    from rigtool.runfile.importers import first_of, import_files
    from rigtool.runfile.importers.preview import preview as show

    mapping = None if map_path is None else load_mapping(map_path)
    if preview:
        for line in show(sources, None if mapping is None else mapping[0], skip_bad_lines):
            echo(line)
        return
    if output is None:
        raise click.UsageError("--output: is missing: give a run file, or a folder for many")
    found = import_files(
        sources,
        output,
        mapping,
        skip_bad=skip_bad_lines,
        skip_bad_files=skip_bad_files,
        overwrite=overwrite,
        map_path=map_path,
    )
    for item in found.done:
        left_out = f", {item.left_out} bad left out" if item.left_out else ""
        echo(f"{item.output}: {item.samples} samples{left_out}")
    if quiet:
        return
    for error in found.bad.values():
        echo(f"Note: left out: {first_of(error)}", err=True)
    if others := found.of_other_names:
        names = ", ".join(path.name for path in others[:LISTED])
        more = f" and {len(others) - LISTED} more" if len(others) > LISTED else ""
        echo(f"Note: the mapping is not for {len(others)} files: {names}{more}", err=True)
    by_note: dict[str, list[str]] = {}
    for item in found.done:
        for note in item.notes:
            by_note.setdefault(note, []).append(item.output.name)
    for note, runs in by_note.items():
        more = f" and {len(runs) - 1} more" if len(runs) > 1 else ""
        echo(f"Note: {runs[0]}{more}: {note}", err=True)


LISTED = 5
"""Most files left out that a note names."""
