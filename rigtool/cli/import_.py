"""`rigtool import`: run files from data that other programs recorded."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from rigtool.cli.options import FILE_ARGUMENT, command_with, current_output, output_option

if TYPE_CHECKING:
    from rigtool.runfile.importers import Import

FILES_NAMED = 5
"""Most files left out that a note names."""


@command_with(
    "rigtool import run07.csv --map recipes/import/mis-tool.toml -o run07.h5",
    "rigtool import epos-exports/ -o runs/",
    "rigtool import run07.csv --preview",
)
@click.argument("sources", nargs=-1, required=True, type=FILE_ARGUMENT, metavar="SOURCE...")
@output_option("RUN.h5|FOLDER", "Run file, or folder for many.")
@click.option(
    "--map", "map_path", type=FILE_ARGUMENT, metavar="MAP.toml", help="Meaning of the columns."
)
@click.option("--preview", is_flag=True, help="Show SOURCE as it would be read; write nothing.")
@click.option("--skip-bad-lines", is_flag=True, help="Leave out bad lines and count them.")
@click.option("--skip-bad-files", is_flag=True, help="Leave out bad files and name them.")
def command(
    sources: tuple[str, ...],
    output: str | None,
    map_path: str | None,
    preview: bool,
    skip_bad_lines: bool,
    skip_bad_files: bool,
) -> None:
    """Make run files from data that other programs recorded.

    SOURCE is delimited text (also .gz), MATLAB .mat, NumPy .npy or .npz, or a folder of such files.
    Several files become run files of their names in the folder OUTPUT. Recorder exports of EPOS
    Studio are recognised; for other files --map states the meaning of the columns. A bad file ends
    with exit code 3: the message names its lines, and nothing is written.
    """
    from rigtool.recipe.mapping import load_mapping
    from rigtool.runfile.importers import import_files
    from rigtool.runfile.importers.preview import preview as show

    mapping = None if map_path is None else load_mapping(map_path)
    to = current_output()
    if preview:
        lines = list(show(sources, None if mapping is None else mapping[0], skip_bad_lines))
        to.document(preview=lines)
        for line in lines:
            to.line(line)
        return
    if output is None:
        raise click.UsageError(
            "Missing option '-o' / '--output': a run file, or a folder for many."
        )
    found = import_files(
        sources,
        output,
        mapping,
        skip_bad=skip_bad_lines,
        skip_bad_files=skip_bad_files,
        overwrite=to.overwrite,
        map_path=map_path,
    )
    for item in found.done:
        left_out = f", {item.left_out} bad ones left out" if item.left_out else ""
        to.written(item.output, f"run of import, {item.samples} samples{left_out}")
    notes = _notes(found)
    for line in notes:
        to.note(f"Note: {line}")
    runs_written = [
        {"output": str(one.output), "samples": one.samples, "left_out": one.left_out}
        for one in found.done
    ]
    to.document(output=output, runs=runs_written, notes=notes)


def _notes(found: Import) -> list[str]:
    """Return what was left out, and the notes of runs, each with the runs that it is about."""
    from rigtool.runfile.importers import first_of

    notes = [f"left out: {first_of(error)}" for error in found.bad.values()]
    if others := found.of_other_names:
        names = ", ".join(path.name for path in others[:FILES_NAMED])
        more = f" and {len(others) - FILES_NAMED} more" if len(others) > FILES_NAMED else ""
        files = "1 file" if len(others) == 1 else f"{len(others)} files"
        notes.append(f"the mapping is not for {files}: {names}{more}")
    by_note: dict[str, list[str]] = {}
    for item in found.done:
        for note in item.notes:
            by_note.setdefault(note, []).append(item.output.name)
    for note, runs in by_note.items():
        more = f" and {len(runs) - 1} more" if len(runs) > 1 else ""
        notes.append(f"{runs[0]}{more}: {note}")
    return notes
