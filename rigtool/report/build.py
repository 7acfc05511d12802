"""From run files to the contents of a report: warnings, tables, figures, origins."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

from rigtool.errors import RunFileError, UsageError
from rigtool.inputs import reading
from rigtool.report.figures import Picture, draw_figures
from rigtool.report.figures.plots import HEADLINE, other_unit_drawn
from rigtool.report.formats import ReportTable
from rigtool.report.published import is_of_thesis
from rigtool.report.requirements import requirements_table
from rigtool.report.tables import attachment_of, budget_tables, force_tables, results_table
from rigtool.report.units import other_unit
from rigtool.runfile import Run
from rigtool.runfile.opened import guard
from rigtool.runfile.provenance import file_sha256

COMMAND_ORDER = (
    "calibrate-kt",
    "stribeck",
    "fft-ripple",
    "identify-plant",
    "ilc-learn",
    "measure-force",
)
"""Commands in the order in which a report shows their runs."""

RUN_SUBJECTS = {
    "calibrate-kt": "torque constant",
    "stribeck": "friction",
    "fft-ripple": "torque ripple",
    "identify-plant": "plant",
    "ilc-learn": "learned disturbance",
    "ilc-check": "check of a learned table",
    "suspension": "suspension",
    "import": "imported recordings",
}
"""Subject of the runs of each command."""


@dataclass(frozen=True)
class Origin:
    """One run file of a report, and where it comes from."""

    label: str
    file: str
    command: str
    rig: str
    attachment: str
    virtual: bool
    seed: str
    date: str
    version: str
    recipe_sha256: str
    content_sha256: str
    file_sha256: str
    inputs: tuple[str, ...]


@dataclass(frozen=True)
class Report:
    """The contents of a report, made before anything is written.

    `requirements` are those of the recipes, with verdicts; `warnings` concern runs that do not
    belong together; `remarks` are the notes of each run, by its label. `force_tables` are Tables 8
    and 9, `budgets` those of the headline results, `results` all results of
    each run; `compared` where published values are beside them.
    """

    title: str
    rigs: tuple[str, ...]
    dates: tuple[str, ...]
    compared: bool
    requirements: ReportTable | None
    warnings: tuple[str, ...]
    remarks: tuple[tuple[str, tuple[str, ...]], ...]
    force_tables: tuple[ReportTable, ...]
    budgets: tuple[ReportTable, ...]
    results: tuple[ReportTable, ...]
    pictures: tuple[Picture, ...]
    origins: tuple[Origin, ...]

    @property
    def virtual(self) -> str:
        """Whether simulated rigs were recorded: all of the runs, or how many; else nothing."""
        count = sum(origin.virtual for origin in self.origins)
        everything = "on a virtual rig,"
        return everything if count == len(self.origins) else f"{count} {everything}" * (count > 0)

    @property
    def headline(self) -> tuple[Picture, ...]:
        """Figures that open the report."""
        return tuple(picture for picture in self.pictures if picture.number == HEADLINE)

    @property
    def figures(self) -> tuple[Picture, ...]:
        """All other figures."""
        return tuple(picture for picture in self.pictures if picture.number != HEADLINE)


def build_report(runs: Sequence[Run]) -> Report:
    """Make a report of any mix of runs; their order does not matter.

    Raises `UsageError` for a file given twice and `RunFileError` for a run with incomplete tables.
    """
    labelled = _labels(runs)
    tables: list[ReportTable] = []
    for label, run in labelled:
        if run.command == "measure-force" and (found := other_unit(run, *run.tables)) is not None:
            raise RunFileError(f"{run.path}: {found}: measure again, or leave this run out")
        with guard(run.path, "a table of loads"):
            tables += force_tables(run, label)
    origins = tuple(_origin(label, run) for label, run in labelled)
    rigs = tuple(sorted({origin.rig for origin in origins if origin.rig}))
    return Report(
        title=_title([run.command for _, run in labelled], rigs),
        rigs=rigs,
        dates=tuple(sorted({origin.date[:10] for origin in origins})),
        compared=any(is_of_thesis(run.rig) for _, run in labelled),
        requirements=requirements_table(labelled),
        warnings=tuple(_warnings(labelled)),
        remarks=tuple((label, run.notes) for label, run in labelled if run.notes),
        force_tables=tuple(sorted(tables, key=lambda table: table.title)),
        budgets=tuple(table for label, run in labelled for table in budget_tables(run, label)),
        results=tuple(results_table(run, label) for label, run in labelled if run.results),
        pictures=tuple(draw_figures(labelled)),
        origins=origins,
    )


def _title(commands: Sequence[str], rigs: Sequence[str]) -> str:
    """Return the subject of the runs: force from motor current, or its parts."""
    if "measure-force" in commands:
        subject = "Force from motor current"
    else:
        named = dict.fromkeys(RUN_SUBJECTS.get(command, command) for command in commands)
        *first, last = named or ["nothing"]
        subject = f"{', '.join(first)} and {last}" if first else last
        subject = subject[0].upper() + subject[1:]
    return f"{subject}: {', '.join(rigs)}" if rigs else subject


def _labels(runs: Sequence[Run]) -> list[tuple[str, Run]]:
    """Sort runs by command and name; label each by the stem of its file.

    Equal stems from different folders are numbered.
    """
    files = set()
    for run in runs:
        with reading(run.path, RunFileError):
            found = run.path.stat()  # a file may have several names
        if (found.st_dev, found.st_ino) in files:
            raise UsageError(f"{run.path}: is given twice: give each run file once")
        files.add((found.st_dev, found.st_ino))

    def key(run: Run) -> tuple[int, str, str, str]:
        place = (
            COMMAND_ORDER.index(run.command) if run.command in COMMAND_ORDER else len(COMMAND_ORDER)
        )
        return place, run.command, run.path.stem, run.content_sha256

    # A stem that a file has stays its label; the label names files, which differ in more than case.
    stems = {run.path.stem.casefold() for run in runs}
    labelled: dict[str, tuple[str, Run]] = {}
    for run in sorted(runs, key=key):
        label, count = run.path.stem, 1
        while label.casefold() in labelled or (count > 1 and label.casefold() in stems):
            count += 1
            label = f"{run.path.stem}-{count}"
        labelled[label.casefold()] = label, run
    return list(labelled.values())


def _warnings(labelled: Sequence[tuple[str, Run]]) -> list[str]:
    """Return warnings on runs that do not belong together, and on runs without results."""
    found = []
    rigs = sorted({run.rig or "unknown" for _, run in labelled})
    if len(rigs) > 1:
        found.append(f"These runs come from {len(rigs)} rigs: {', '.join(rigs)}.")
    for label, run in labelled:
        if (other := other_unit_drawn(run)) is not None:
            found.append(f"{label}: {other}: figures of such tables are left out.")
    shown: dict[str, dict[str, str]] = {}
    for label, run in labelled:
        shown.setdefault(run.command, {})[label] = run.content_sha256
    for label, run in labelled:
        for used in run.provenance["inputs"]:
            there = shown.get(used["command"], {})
            analysed_again = used["command"] == run.command
            if there and not analysed_again and used["content_sha256"] not in there.values():
                found.append(
                    f"{label}: was made with {used['command']} run {used['content_sha256'][:12]}, "
                    f"which is not the one shown here ({', '.join(there)})."
                )
        if not run.results and not run.tables:
            found.append(f"{label}: holds signals but no results; analyse it to see them here.")
    return found


def _origin(label: str, run: Run) -> Origin:
    origin = run.provenance
    resolved = origin["recipe_resolved"]
    return Origin(
        label=label,
        file=run.path.name,
        command=run.command,
        rig=run.rig or "",
        attachment=attachment_of(run) or "",
        virtual=run.recipe is not None and run.recipe.rig.source == "virtual",
        seed=origin["seed"] or "",
        date=origin["date"],
        version=f"{origin['program']} {origin['version']}",
        recipe_sha256="" if resolved is None else _sha256(resolved),
        content_sha256=run.content_sha256,
        file_sha256=file_sha256(run.path),
        inputs=tuple(f"{i['command']} {i['content_sha256'][:12]}" for i in origin["inputs"]),
    )


@lru_cache(maxsize=8)
def _sha256(resolved: str) -> str:
    canonical = json.dumps(json.loads(resolved), sort_keys=True)
    return hashlib.sha256(canonical.encode()).hexdigest()
