"""Text of others in each language: what it would do there, it does not."""

import csv
import io
import shutil
import subprocess

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rigtool import escapes
from rigtool.experiments.deploy.c_header import comment

HOSTILE = "N m] */ int evil = 1; /* [\n=1+1|<script>`x`[a](b)\x1b[2J\a\u202eabc\\input{x}$%&"


@given(st.text())
def test_a_terminal_gets_no_control_character(text):
    shown = escapes.terminal(text)
    controls = {chr(c) for c in (*range(0x20), *range(0x7F, 0xA0))} - {"\n", "\t"}
    assert not controls & set(shown)
    assert not set("\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069\u200e\u200f") & set(
        shown
    )


@given(st.text(alphabet="*/ \\\n?a"))
def test_no_text_ends_a_comment_of_c(text):
    safe = escapes.c_comment(text)
    assert "*/" not in safe
    assert "\n" not in safe
    assert "??" not in safe
    assert comment([text]).count("*/") == 1


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
def test_hostile_lines_compile_as_a_comment(tmp_path):
    source = tmp_path / "x.c"
    source.write_text(comment([HOSTILE]) + f"\n/* {escapes.c_comment(HOSTILE)} */\n")
    done = subprocess.run(
        ["cc", "-E", "-P", str(source)], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == ""


@pytest.mark.parametrize("text", ["=1+1", "+A1", "-A1", "@SUM(A1)", "\t=1", "\n=1", "＝1"])
def test_no_text_is_a_formula(text):
    stream = io.StringIO()
    csv.writer(stream).writerow([escapes.csv_text(text), escapes.csv_text("N m")])
    stream.seek(0)
    assert next(csv.reader(stream)) == [f"'{text}", "N m"]


@given(st.text())
def test_markdown_has_no_html_link_or_cell(text):
    safe = escapes.markdown(text)
    assert "<" not in safe
    assert "](" not in safe
    assert len(safe.splitlines()) < 2
    assert safe.replace(r"\\", "").replace(r"\|", "").count("|") == 0


@given(st.text())
def test_latex_has_no_command_of_the_text(text):
    safe = escapes.latex(f"x{text}")
    for known in (r"\textbackslash{}", r"\textasciitilde{}", r"\textasciicircum{}"):
        safe = safe.replace(known, "")
    for character in "%&#_${}":
        safe = safe.replace(f"\\{character}", "")
    assert not set("\\%&#_${}~^\n") & set(safe)


def test_a_label_and_a_figure():
    assert escapes.latex_label("a}b\\c d-1") == "a-b-c-d-1"
    assert escapes.figure("$x_{") == r"\$x_{"
