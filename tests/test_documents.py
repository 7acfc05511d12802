"""ARCHITECTURE.md and CONTRIBUTING.md, held against the tree."""

import ast
import importlib
import re
from pathlib import Path

import pytest

from tests.house import MODULES, PACKAGE
from tests.test_house import FLOORS

ROOT = PACKAGE.parent
DOCUMENTS = ("ARCHITECTURE.md", "CONTRIBUTING.md")
NAMED = re.compile(r"`((?:rigtool|tests|docs|recipes)/[^`:]*)(?::([\w.]+))?`")
"""A path in backticks, perhaps with a name in that file."""

ROW = re.compile(r"^\| `rigtool/([^`]+?)/?` \|", re.MULTILINE)


def text_of(document):
    return (ROOT / document).read_text(encoding="utf-8")


def defined(tree):
    """Return the names that a module or class defines, those of classes with their members."""
    names = set()
    for node in tree.body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.add(node.name)
        if isinstance(node, ast.ClassDef):
            names |= {f"{node.name}.{name}" for name in defined(node)}
        if isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            names |= {target.id for target in targets if isinstance(target, ast.Name)}
    return names


@pytest.mark.parametrize("document", DOCUMENTS)
def test_what_is_named_exists(document):
    found = NAMED.findall(text_of(document))
    assert len(found) >= 30
    for place, name in found:
        path = ROOT / place
        assert path.is_dir() if place.endswith("/") else path.is_file(), place
        if name:
            assert name in defined(ast.parse(path.read_text(encoding="utf-8"))), f"{place}:{name}"


def test_the_floors_are_those_of_the_house():
    named = [row.removesuffix(".py") for row in ROW.findall(text_of("ARCHITECTURE.md"))]
    assert tuple(named) == FLOORS


def test_every_room_has_a_row():
    rooms = {path.parent.relative_to(PACKAGE).as_posix() for path in MODULES} - {"."}
    rows = ROW.findall(text_of("CONTRIBUTING.md"))
    assert len(rows) == len(set(rows))
    assert set(rows) == rooms


def test_a_row_begins_in_its_own_room():
    rows = re.findall(
        r"^\| `(rigtool/[^`]+)` \|.*\| `([^`]+)` \|$", text_of("CONTRIBUTING.md"), re.M
    )
    assert len(rows) >= 30
    for room, begin in rows:
        assert (ROOT / begin).parent == ROOT / room, begin


def test_architecture_fits_a_page():
    assert len(text_of("ARCHITECTURE.md").splitlines()) <= 90


@pytest.fixture
def generated(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "docs" / "_ext")
    return importlib.import_module("generated")


def test_pages_of_commands_keep_lists_and_options(generated):
    page = generated.command_page("ilc-learn")
    assert "```text\nA         turns at one speed" in page
    assert "`--validate` records" in page


def test_pages_of_modules_are_text_with_equations_as_code(generated):
    page = generated.room_page(PACKAGE / "experiments" / "learning")
    assert "Iterative learning of a feed-forward table.\n" in page
    assert "```text\nf(k+1) = Q (f(k) + p L q(k))\n```" in page
    assert r"\[Fig. 44, 45\]" in page


def test_links_lead_somewhere():
    for document in DOCUMENTS:
        for target in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", text_of(document)):
            assert Path(ROOT / target).exists(), f"{document}: {target}"


def test_the_style_of_the_site_is_there_and_named():
    conf = (ROOT / "docs" / "conf.py").read_text("utf-8")
    (names,) = re.findall(r"html_css_files = (\[.*\])", conf)
    there = {path.name for path in (ROOT / "docs" / "_static").iterdir()}
    assert set(ast.literal_eval(names)) == there
