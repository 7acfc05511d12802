"""`rigtool verify`: the hashes of a run and of everything it was made from."""

from __future__ import annotations

import click

from rigtool.cli.options import FILE_ARGUMENT, command_with, current_output


@command_with("rigtool verify force.h5", "rigtool verify kt.h5 tables.h5")
@click.argument("paths", nargs=-1, required=True, type=FILE_ARGUMENT, metavar="RUN.h5...")
def command(paths: tuple[str, ...]) -> None:
    """Check run files and everything they were made from.

    Compares every hash, those of samples included, back to the raw runs, and shows which link is
    broken. Inputs are sought at their old path, then beside the file made from them. Exit code 3
    if anything is broken.
    """
    from rigtool.errors import RunFileError
    from rigtool.runfile.verification import verify

    to, broken, links = current_output(), [], []
    for path in paths:
        for link in verify(path):
            state = "BROKEN" if link.problem else "ok"
            text = link.problem or link.remark or link.command
            to.line(f"{'  ' * link.depth}{link.path}: {state}: {text}")
            links.append(
                {"path": str(link.path), "depth": link.depth, "state": state, "text": text}
            )
            if link.problem:
                broken.append(str(link.path))
    to.document(links=links)
    if broken:
        raise RunFileError(
            f"broken: {', '.join(dict.fromkeys(broken))}; make the runs that depend on it again"
        )
