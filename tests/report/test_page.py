import re
import sys
from html.parser import HTMLParser

import pytest

from rigtool.errors import UsageError
from rigtool.report.build import build_report
from rigtool.report.page import render_page, render_pdf, require_pdf

VOID = {"meta", "img", "br"}


class Checker(HTMLParser):
    """Fails on tags that are not closed in order; collects what could refer outside."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.references: list[str] = []
        self.text: list[str] = []

    def handle_starttag(self, tag, attrs):
        if tag not in VOID:
            self.open.append(tag)
        self.references += [value for name, value in attrs if name in ("src", "href")]

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


def test_page_is_well_formed_and_self_contained(make, open_all, unrendered):
    runs = open_all(make("measure-force", notes=("<b>5 & 6</b>",)), make("calibrate-kt"))
    report = build_report(runs)
    page = render_page(report)
    checker = Checker()
    checker.feed(page)
    assert checker.open == []
    inside = [reference for reference in checker.references if reference.startswith("#")]
    drawn = [reference for reference in checker.references if not reference.startswith("#")]
    assert len(drawn) == len(report.pictures)
    assert all(reference.startswith("data:image/svg+xml,") for reference in drawn)
    assert {f'id="{reference[1:]}"' in page for reference in inside} == {True}
    assert "url(" not in re.sub(r'src="[^"]*"', "", page)
    text = "".join(checker.text)
    assert "<b>5 & 6</b>" in text  # a note is text, whatever it looks like
    for run, origin in zip(sorted(runs, key=lambda r: r.command), report.origins, strict=True):
        assert run.content_sha256 in text
        assert origin.file_sha256 in text
    places = ["Requirements of the recipe", "Table 8", "Fig. 58", "Results of", "<b>5 & 6</b>"]
    assert places == sorted(places, key=text.index)
    assert "Force from motor current: briaire-2006" in text


def test_nothing_of_the_machine_is_in_the_page(make, open_all, tmp_path):
    page = render_page(build_report(open_all(make("calibrate-kt"))))
    assert str(tmp_path) not in page


def test_the_same_runs_give_the_same_bytes_whatever_a_user_has_set_in_matplotlib(make, open_all):
    import matplotlib

    runs = open_all(make("calibrate-kt"))
    first = build_report(runs)
    # Two that the style of the figures sets, and one that it leaves to matplotlib.
    with matplotlib.rc_context({"font.size": 30, "axes.grid": False, "xtick.major.size": 30}):
        second = build_report(runs)
    assert first.pictures == second.pictures
    assert render_page(first) == render_page(second)


def test_the_page_as_pdf_is_the_same_each_time():
    try:
        require_pdf()
    except UsageError:
        pytest.skip("WeasyPrint comes with the extra pdf, Pango with the system")
    page = "<!DOCTYPE html><title>a</title><h1>Force</h1><p>45.80(4) mN m/A"
    first = render_pdf(page)
    assert first.startswith(b"%PDF-")
    assert render_pdf(page) == first


def test_without_the_printer_the_remedy_is_reported(monkeypatch):
    monkeypatch.setitem(sys.modules, "weasyprint", None)
    with pytest.raises(UsageError, match=r"pip install rigtool\[pdf\]"):
        require_pdf()
