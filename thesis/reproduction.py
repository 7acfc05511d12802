"""The page that compares rigtool with the thesis, figure by figure: `make thesis`.

    python -m thesis.reproduction RUN.h5... --to FOLDER [--html PAGE] [--against docs]

`reproduction.toml` lists the rows of the page; it names a run by the stem of its file. In the
folder it writes reproduction.md and reproduction/ with the pictures and numbers.json, and one HTML
file. `--against` compares the numbers with those of another folder, the committed ones.
"""

from __future__ import annotations

import argparse
import json
import shlex
import shutil
import sys
import tomllib
from base64 import b64encode
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rigtool.errors import RigtoolError, UsageError
from rigtool.quantity import Quantity, display_unit, format_number
from rigtool.report.figures import PLOTS, style
from rigtool.report.page import render_template
from thesis import turns
from thesis.values import Runs, evaluate, low_current_refusal, published_entry

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from rigtool.runfile import Run

FOLDER = Path(__file__).parent

SAME_DIFFERENCE, SAME_SCATTER, SAME_PART_OF_U = 1e-3, 0.05, 0.5
"""Differences of numbers that count as the same: relative, relative where the scatter is not known,
and in standard uncertainties. Another computer rounds in another way, from which a motion draws
other noise: a table that differed by 1e-18 N m changed sweeps by 0.9 %, and residuals by 0.35 u."""

SCATTERED = ("one sweep", "the curve's own uncertainty")
"""How the reasons of numbers begin that scatter by an unknown amount."""

LARGEST_SVG = 150_000
"""Bytes above which a picture is written as PNG."""

NO_BREAK_SPACE = "\N{NO-BREAK SPACE}"

DRAWN_FROM_SIGNALS = {
    43: turns.draw_before_learning,
    45: turns.draw_after_learning,
    68: turns.draw_faulty_amplifier,
}
"""Figures drawn from signals, which need the calibration."""

THESIS_UNITS = {
    "mA": 1e3,
    "mN": 1e3,
    "mm": 1e3,
    "kN/m": 1e-3,
    "µN m": 1e6,
    "nN m": 1e9,
    "deg/s": 57.29577951308232,
    "rev/s": 0.15915494309189535,
    "%": 1e2,
    "kg m2": 1.0,
}
"""Factors from SI to units in which the thesis states some numbers."""


@dataclass(frozen=True)
class ComparedNumber:
    """A number beside that of the thesis, as text; `holds` is None where there is no criterion."""

    name: str
    published: str
    section: str
    ours: str
    unit: str
    tolerance: str
    holds: bool | None
    met: bool = True

    @property
    def verdict(self) -> str:
        """The last cell of the row; both rigs may miss a requirement."""
        if self.holds is None:
            return "–"
        if not self.met:
            return "not met by either rig" if self.holds else "met, unlike the thesis"
        return "yes" if self.holds else "NO"


@dataclass(frozen=True)
class PageRow:
    """One row of the page; `picture` is a file name and its bytes, None for a table."""

    name: str
    heading: str
    lines: tuple[str, ...]
    picture: tuple[str, bytes] | None
    text: tuple[tuple[str, ...], ...]
    numbers: tuple[ComparedNumber, ...]
    remarks: tuple[str, ...]

    @property
    def data_uri(self) -> str:
        """The picture as a data URI."""
        if self.picture is None:
            return ""
        name, data = self.picture
        kind = "svg+xml" if name.endswith(".svg") else "png"
        return f"data:image/{kind};base64,{b64encode(data).decode()}"


@cache
def reference_rows() -> tuple[dict[str, Any], ...]:
    """Return the rows of `reproduction.toml`, with a number for each load of Tables 8 and 9."""
    text = FOLDER.joinpath("reproduction.toml").read_text("utf-8")
    return tuple(
        row | {"numbers": [n for number in row["numbers"] for n in _by_load(number)]}
        for row in tomllib.loads(text)["rows"]
    )


def _by_load(number: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield a number for each load of Table 8 or 9, any other number as it is."""
    path = number.get("published", "")
    if not path.startswith("tables."):
        yield number
        return
    table = published_entry(path.rsplit(".", 1)[0])
    for index, load in enumerate(table["applied_torque"]):
        force = 1e3 * table["applied_force"][index]
        yield number | {
            "name": f"{number['name']} at {force:.0f} mN, {1e3 * load:.3g} mN m",
            "value": number["value"].format(load=index + 1),
            "u": number["u"].format(load=index + 1) if "u" in number else None,
            "index": index,
        }


def row_name(row: Mapping[str, Any]) -> str:
    """Return the name of a row: `figure-20`, `table-8`."""
    return f"figure-{row['figure']}" if "figure" in row else f"table-{row['table']}"


def published_of(number: Mapping[str, Any]) -> tuple[float | None, str]:
    """Return the published value of a number, SI, and its section; None where only words exist."""
    path = number.get("published")
    if path is None:
        return number.get("limit"), ""
    entry = published_entry(path)
    if "index" in number:
        value = float(entry[number["index"]])
        percent = 0.01 if path.endswith("_percent") else 1.0
        return percent * value, published_entry(path.rsplit(".", 1)[0])["section"]
    return float(entry["value"]), entry["section"]


def holds(number: Mapping[str, Any], value: float) -> bool | None:
    """Return whether a value, SI, meets the criterion of its row; None without a criterion.

    For a requirement that the thesis's rig does not meet, True means: not met here either.
    """
    published, _ = published_of(number)
    if published is None:
        return None
    if "rule" in number:
        inside = value < published if number["rule"] == "below" else value > published
        return inside is number.get("met", True)
    return abs(value - published) <= _allowed(number, published)


def _allowed(number: Mapping[str, Any], published: float) -> float:
    if "within" in number:
        return float(number["within"]) * (0.01 if number.get("unit") == "%" else 1.0)
    return float(number["tolerance"] * abs(published))


# -- making the rows


def make_rows(runs: Runs) -> tuple[list[PageRow], dict[str, Any]]:
    """Return all rows of the page, and the numbers that the tests compare.

    Raises `UsageError` where a run is missing.
    """
    missing = {row["run"] for row in reference_rows()} - set(runs)
    if missing:
        raise UsageError(f"no run file {', '.join(sorted(missing))}: `make thesis` makes them all")
    shown, stored = [], {}
    for row in reference_rows():
        made, numbers = make_row(row, runs)
        shown.append(made)
        stored[made.name] = {
            "command": made.lines[0],
            "picture": None if made.picture is None else made.picture[0],
            "numbers": numbers,
        }
    return shown, stored


def make_row(row: Mapping[str, Any], runs: Runs) -> tuple[PageRow, dict[str, Any]]:
    """Return one row, and its numbers by name: `value`, `u`, `unit` (SI), `reason` without u."""
    run, numbers, stored = runs[row["run"]], [], {}
    for number in row["numbers"]:
        found = evaluate(number["value"], runs, number.get("run", row["run"]))
        if found.unit == "%":
            found = replace(found, value=found.value / 100, unit="1")
        if number.get("u") is not None:
            found = replace(found, u=evaluate(number["u"], runs, row["run"]).value, reason=None)
        numbers.append(_compared(number, found))
        stored[number["name"]] = {
            "value": found.value,
            "u": found.u,
            "unit": found.unit,
            "reason": found.reason,
        }
    heading, picture = title(row), None
    if "figure" in row:
        picture = _picture(row["figure"], run, runs["kt"])
    remarks = [row["differs"]] if "differs" in row else []
    if row.get("refusal"):
        remarks.insert(0, f"stribeck reports: “{low_current_refusal(runs, row['run'])}”")
    text: tuple[tuple[str, ...], ...] = ()
    if "text" in row:
        entry = published_entry(row["text"])
        text = (tuple(entry["head"]), *(tuple(cells) for cells in entry["rows"]))
    used = [run, *(runs[name] for name in row.get("also", ()))]
    lines = (*(command_line(one) for one in used), *row.get("lines", ()))
    name = row_name(row)
    return PageRow(name, heading, lines, picture, text, tuple(numbers), tuple(remarks)), stored


def command_line(run: Run) -> str:
    """Return the command line that made a run, without folders."""
    words = [word for word in run.provenance["argv"] if word != "--overwrite"]
    return shlex.join(Path(word).name if word.endswith(".h5") else word for word in words)


def title(row: Mapping[str, Any]) -> str:
    """Return the heading of a row: its own, or that of the report's figure."""
    if "table" in row:
        return f"Table {row['table']}. {row['title']}"
    return f"Fig. {row['figure']}. {row.get('title') or PLOTS[row['figure']].title}"


def _picture(number: int, run: Run, kt: Run) -> tuple[str, bytes]:
    with style.styled():
        svg, png = style.render_figure(_draw(number, run, kt))
    if len(svg.encode()) > LARGEST_SVG:
        return f"figure-{number}.png", png
    return f"figure-{number}.svg", svg.encode()


def _draw(number: int, run: Run, kt: Run) -> Figure:
    if number in DRAWN_FROM_SIGNALS:
        return DRAWN_FROM_SIGNALS[number](run, kt)
    if not PLOTS[number].fits(run):
        raise UsageError(
            f"{run.path}: lacks the tables of Fig. {number}: give the run that it needs"
        )
    return PLOTS[number].draw(run)


def _compared(number: Mapping[str, Any], found: Quantity) -> ComparedNumber:
    published, section = published_of(number)
    factor, unit = display_unit(found.unit)
    if "unit" in number:
        factor, unit = THESIS_UNITS[number["unit"]], number["unit"]
    u = None if found.u is None else found.u * factor
    said = number.get("says")
    stated = "–" if published is None else f"{published * factor:.4g}".replace("e-0", "e-")
    tolerance = "–" if published is None else _tolerance(number, factor, stated)
    return ComparedNumber(
        name=number["name"],
        published=f"“{said}”" if said else stated,
        section=section,
        ours=format_number(found.value * factor, u),
        unit="" if unit == "1" else unit.replace(" ", NO_BREAK_SPACE),
        tolerance=tolerance,
        holds=holds(number, found.value),
        met=number.get("met", True),
    )


def _tolerance(number: Mapping[str, Any], factor: float, stated: str) -> str:
    if "rule" in number:
        return f"{number['rule']}{NO_BREAK_SPACE}{stated}"
    if "within" in number:
        return f"±{_allowed(number, 0.0) * factor:.3g}"
    return f"±{100 * number['tolerance']:.3g}{NO_BREAK_SPACE}%" if number["tolerance"] else "equal"


# -- the page

INTRODUCTION = (
    "Every figure with data in chapters 7 and 8 and in the appendices of E. Briaire, Friction "
    "measurement and compensation on a laparoscopic instrument of a medical robot, TU Eindhoven, "
    "2006, and its Tables 5 to 9, reproduced on the virtual rig by make thesis, with the same axes "
    "and units. Each row shows its command, the value of the thesis, the value that rigtool finds, "
    "with its standard uncertainty in brackets, the tolerance, and whether the value is within it. "
    "Quotation marks: words of the thesis, where it gives no number. A dash: the thesis states "
    "nothing. A number without brackets has no uncertainty of its own: it is a setting, or the "
    "rms, peak or span of a curve."
)

NOTES_LINK = "Assumptions where the thesis is silent: [notes](thesis-notes.md)."


def page_text(shown: Sequence[PageRow]) -> str:
    """Return the page as Markdown; its pictures are in `reproduction/`."""
    parts = ["# The thesis, figure by figure", INTRODUCTION, _summary(shown), NOTES_LINK]
    for row in shown:
        parts += [f"## {row.heading}", "```sh\n" + "\n".join(row.lines) + "\n```"]
        if row.picture is not None:
            parts.append(f"![{row.heading}](reproduction/{row.picture[0]})")
        if row.text:
            parts.append(_markdown_table(row.text))
        parts.append(_markdown_table([TABLE_HEAD, *_number_cells(row)]))
        parts += row.remarks
    return "\n\n".join(parts) + "\n"


TABLE_HEAD = ("", "thesis", "section", "rigtool", "unit", "tolerance", "holds")


def _number_cells(row: PageRow) -> list[tuple[str, ...]]:
    return [
        (n.name, n.published, n.section, n.ours, n.unit, n.tolerance, n.verdict)
        for n in row.numbers
    ]


def _markdown_table(lines: Sequence[Sequence[str]]) -> str:
    head, *body = [[cell.replace("|", "\\|") for cell in line] for line in lines]
    return "\n".join(
        "| " + " | ".join(cells) + " |" for cells in (head, ["---"] * len(head), *body)
    )


def _summary(shown: Sequence[PageRow]) -> str:
    judged = [n for row in shown for n in row.numbers if n.holds is not None]
    good = sum(bool(number.holds) for number in judged)
    missed = sum(not number.met for number in judged)
    return (
        f"{len(shown)} rows, {len(judged)} numbers with a criterion: {good} agree, among them "
        f"{missed} requirements that the thesis's rig does not meet either."
    )


def html(shown: Sequence[PageRow]) -> str:
    """Return the page as one HTML file with all pictures in it."""
    return render_template(
        FOLDER.joinpath("reproduction.html").read_text("utf-8"),
        rows=shown,
        head=TABLE_HEAD,
        cells=_number_cells,
        introduction=INTRODUCTION,
        summary=_summary(shown),
    )


def write(
    shown: Sequence[PageRow], stored: Mapping[str, Any], docs: Path, page: Path | None
) -> None:
    """Write the Markdown page with its folder into `docs`, and the HTML file."""
    folder = docs / "reproduction"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    for row in shown:
        if row.picture is not None:
            (folder / row.picture[0]).write_bytes(row.picture[1])
    text = json.dumps(stored, indent=1, ensure_ascii=False)
    (folder / "numbers.json").write_text(text + "\n", "utf-8")
    (docs / "reproduction.md").write_text(page_text(shown), "utf-8")
    if page is not None:
        page.write_text(html(shown), "utf-8")


def main(arguments: Sequence[str] | None = None) -> int:
    """Make the page of run files; exit code 1 where a number is outside its tolerance."""
    from rigtool.runfile import open_run

    parser = argparse.ArgumentParser(description="The thesis, figure by figure.")
    parser.add_argument("runs", nargs="+", type=Path, metavar="RUN.h5")
    parser.add_argument("--to", type=Path, required=True, help="folder to write")
    parser.add_argument("--against", type=Path, help="folder whose numbers these must be")
    parser.add_argument("--html", type=Path, help="the same as one HTML file")
    given = parser.parse_args(arguments)
    try:
        with ExitStack() as stack:
            runs = {path.stem: stack.enter_context(open_run(path)) for path in given.runs}
            shown, stored = make_rows(runs)
    except RigtoolError as error:
        print(f"Error: {error}", file=sys.stderr)
        return error.exit_code
    write(shown, stored, given.to, given.html)
    wrong = [
        f"outside its tolerance: {row.name}: {n.name}"
        for row in shown
        for n in row.numbers
        if n.holds is False
    ]
    if given.against is not None:
        text = (given.against / "reproduction" / "numbers.json").read_text("utf-8")
        wrong += changed(stored, json.loads(text))
    print(_summary(shown))
    for line in wrong:
        print(line, file=sys.stderr)
    return 1 if wrong else 0


def changed(stored: Mapping[str, Any], committed: Mapping[str, Any]) -> list[str]:
    """Return a line for each number that is not the committed one.

    Numbers are equal within `SAME_DIFFERENCE`, `SAME_SCATTER` or `SAME_PART_OF_U`.
    """
    lines = []
    for row in sorted(stored.keys() | committed.keys()):
        ours, theirs = (one.get(row, {}).get("numbers", {}) for one in (stored, committed))
        for name in [*theirs, *(name for name in ours if name not in theirs)]:
            here, there = ours.get(name), theirs.get(name)
            if here is None or there is None:
                where = "is not committed" if there is None else "is committed, but not made"
                lines.append(f"{row}: {name}: {where}: make pages")
                continue
            scattered = (there["reason"] or "").startswith(SCATTERED)
            relative = SAME_SCATTER if scattered else SAME_DIFFERENCE
            tolerance = max(relative * abs(there["value"]), SAME_PART_OF_U * (there["u"] or 0.0))
            if not abs(here["value"] - there["value"]) <= tolerance:
                lines.append(
                    f"{row}: {name}: is {here['value']:.6g}, committed is {there['value']:.6g} "
                    f"(SI), more than {tolerance:.2g} apart: find the cause, or make pages"
                )
    return lines


if __name__ == "__main__":
    sys.exit(main())
