"""The folder of a report, which appears complete or not at all."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

from rigtool.errors import UsageError, refusal
from rigtool.inputs import PathName
from rigtool.report.build import Report
from rigtool.report.formats import csv_table, latex_table, markdown_table, terminal_table
from rigtool.report.page import render_page, render_pdf
from rigtool.runfile.outputs import own_folder, require_place

REPORT_ENTRIES = frozenset({"index.html", "report.pdf", "tables.txt", "tables", "figures"})
"""Entries of a report's folder; a folder with any other entry is never replaced."""


def terminal_text(report: Report) -> str:
    """Return Tables 8 and 9 as text, separated by an empty line."""
    return "\n".join(terminal_table(table) for table in report.force_tables)


def require_free(
    output: PathName,
    *,
    overwrite: bool,
    inputs: Iterable[PathName] = (),
) -> Path:
    """Return the folder to write as an absolute path.

    Raises `UsageError` where it cannot be written, exists without `overwrite`, holds one of the
    `inputs`, or something that no report wrote.
    """
    try:
        target = Path(output).absolute()
    except OSError as error:
        raise UsageError(f"{output}: the working folder is gone: {refusal(error)}") from None
    require_place(output, target)
    if not target.exists() and not target.is_symlink():
        return target
    if target.is_symlink() or not target.is_dir():
        raise UsageError(f"{output}: is no folder: give the report a name of its own")
    if not overwrite:
        raise UsageError(f"{output}: exists already: give another name, or --overwrite")
    for name in inputs:
        if Path(os.path.realpath(name)).is_relative_to(os.path.realpath(target)):
            raise UsageError(f"{output}: holds {name}, an input of this report: give another name")
    foreign = sorted(entry.name for entry in target.iterdir() if entry.name not in REPORT_ENTRIES)
    if foreign:
        raise UsageError(
            f"{output}: holds {foreign[0]!r}, which is no part of a report, and would be lost: "
            "give another name, or move it away"
        )
    return target


def write_report(report: Report, output: PathName, *, overwrite: bool, pdf: bool = False) -> None:
    """Write all files beside the folder, then put them in its place in one step.

    Raises `UsageError` as `require_free`, `RigtoolError` where the disk refuses.
    """
    target = require_free(output, overwrite=overwrite)
    with own_folder(target.parent) as scratch:
        new = scratch / "new"
        for name, data in _contents(report, pdf).items():
            path = new / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)
        _swap(new, target, scratch / "old")


def _contents(report: Report, pdf: bool) -> dict[str, bytes]:
    """Return every file of the report by its path within the folder."""
    texts = {"index.html": render_page(report), "tables.txt": terminal_text(report)}
    required = () if report.requirements is None else (report.requirements,)
    for table in (*required, *report.force_tables, *report.budgets, *report.results):
        texts[f"tables/{table.name}.md"] = markdown_table(table)
        texts[f"tables/{table.name}.csv"] = csv_table(table)
        texts[f"tables/{table.name}.tex"] = latex_table(table)
    for picture in report.pictures:
        texts[f"figures/{picture.name}.svg"] = picture.svg
    contents = {name: text.encode() for name, text in texts.items()}
    if pdf:
        contents["report.pdf"] = render_pdf(texts["index.html"])
    for picture in report.pictures:
        contents[f"figures/{picture.name}.png"] = picture.png
    return contents


def _swap(new: Path, target: Path, old: Path) -> None:
    """Replace `target` by `new`; if that fails, the old folder stays or is put back."""
    if not target.exists():
        new.rename(target)
        return
    target.rename(old)
    try:
        new.rename(target)
    except OSError:
        old.rename(target)
        raise
