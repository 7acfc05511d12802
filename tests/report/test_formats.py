import csv
import io
from dataclasses import replace

import pytest

from rigtool.report.formats import (
    Cell,
    ReportColumn,
    ReportTable,
    csv_table,
    latex_table,
    markdown_table,
    terminal_table,
)

TABLE = ReportTable(
    "table-8-run",
    "Table 8. A title & more",
    (
        ReportColumn("name", "Name", numeric=False),
        ReportColumn("mean", "Mean", "mN m", "N m", uncertain=True),
        ReportColumn("error", "Error", "%", "%"),
    ),
    (
        (Cell("a_b | c", "a_b | c"), Cell("1.37(10)", 1.37e-3, 1e-4), Cell("-14.6", -14.6)),
        (Cell("long name", "long name"), Cell("–", None), Cell("+8", float("nan"))),
    ),
)


def test_markdown():
    assert markdown_table(TABLE) == (
        "**Table 8. A title & more**\n\n"
        "| Name | Mean [mN m] | Error [%] |\n"
        "| :--- | ---: | ---: |\n"
        "| a_b \\| c | 1.37(10) | -14.6 |\n"
        "| long name | – | +8 |\n"
    )


def test_csv_has_si_numbers_and_uncertainties():
    rows = list(csv.reader(io.StringIO(csv_table(TABLE))))
    assert rows[0] == ["name", "mean [N m]", "mean_u [N m]", "error [%]"]
    assert rows[1] == ["a_b | c", "0.00137", "0.0001", "-14.6"]
    assert rows[2] == ["long name", "", "", ""]


def test_latex_escapes_what_tex_would_misread():
    text = latex_table(TABLE)
    assert r"Table 8. A title \& more" in text
    assert r"a\_b | c & 1.37(10) & $-14.6$ \\" in text
    assert r"long name & -- & $+8$ \\" in text
    assert r" & [mN m] & [\%] \\" in text
    assert r"\begin{tabular}{lrr}" in text
    assert text.count("{") - text.count("}") == 0


def test_terminal_is_aligned():
    title, empty, heads, units, rule, *rows = terminal_table(TABLE).splitlines()
    assert title == "Table 8. A title & more"
    assert empty == ""
    assert {len(heads), len(rule), *map(len, rows)} == {len(rule)}
    assert heads.split() == ["Name", "Mean", "Error"]
    assert units.split() == ["[mN", "m]", "[%]"]
    assert rows[0].startswith("a_b | c  ")


def test_a_note_stands_below():
    noted = replace(TABLE, note="zero: 5 % off")
    assert markdown_table(noted).endswith("|\n\nzero: 5 % off\n")
    assert terminal_table(noted).endswith("\nzero: 5 % off\n")
    assert r"\par zero: 5 \% off" in latex_table(noted)
    assert csv_table(noted) == csv_table(TABLE)


@pytest.mark.parametrize("render", [markdown_table, csv_table, latex_table, terminal_table])
def test_each_ends_with_one_newline(render):
    assert render(TABLE).endswith("\n")
    assert not render(TABLE).endswith("\n\n")
