"""What is published: versions, the description, both distributions, the hooks before a commit."""

import re
import runpy
import subprocess
import tomllib
from importlib import metadata
from pathlib import Path

import pytest
import yaml
from packaging.specifiers import SpecifierSet

import release_check
import rigtool

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def yaml_of(name):
    return yaml.safe_load((ROOT / name).read_text(encoding="utf-8"))


def test_one_version():
    assert list(release_check.versions()) == []
    assert rigtool.__version__ == PROJECT["version"]


def test_another_version_is_found(monkeypatch):
    monkeypatch.setattr(release_check, "project", lambda: {"version": "9.9"})
    assert len(list(release_check.versions())) == 2


def test_a_release_needs_a_date_and_an_address(monkeypatch):
    files = {
        "CHANGELOG.md": "## 1.0 (not released)\n",
        "CITATION.cff": "\ndate-released: 2026-01-02\n",
    }
    monkeypatch.setattr(release_check, "read", files.__getitem__)
    monkeypatch.setattr(release_check, "project", dict)
    assert list(release_check.dated()) == [
        "CHANGELOG.md: 'not released' must be a date, YYYY-MM-DD"
    ]
    files["CHANGELOG.md"] = "## 1.0 (2026-01-02)\n"
    assert list(release_check.dated()) == []
    assert len(list(release_check.address())) == 1


def test_the_citation_names_rigtool_and_the_thesis():
    citation = yaml_of("CITATION.cff")
    assert citation["cff-version"] == "1.2.0"
    assert citation["license"] == PROJECT["license"]
    assert citation["authors"] == PROJECT["authors"] == [{"name": "rigtool developers"}]
    (thesis,) = citation["references"]
    assert (thesis["type"], thesis["year"]) == ("thesis", 2006)
    assert thesis["authors"] == [{"family-names": "Briaire", "given-names": "Emile"}]


def test_the_hooks_are_the_checks_of_make_test():
    (repository,) = yaml_of(".pre-commit-config.yaml")["repos"]
    entries = {hook["entry"].replace(" --force-exclude", "") for hook in repository["hooks"]}
    recipe = (ROOT / "Makefile").read_text(encoding="utf-8").partition("\ntest:")[2]
    checks = re.findall(
        r"^\t\(?\$\(BIN\)/(ruff \S+|ruff format --check|mypy)", recipe, re.MULTILINE
    )
    assert len(checks) == len(entries) == 3
    for check in checks:
        assert any(entry.startswith(f".venv/bin/{check}") for entry in entries), check


def test_the_locked_versions_install_with_the_lowest_python():
    lowest = PROJECT["requires-python"].removeprefix(">=") + ".0"
    lines = (ROOT / "requirements.lock").read_text(encoding="utf-8").splitlines()
    locked = [line.partition("==")[0] for line in lines if "==" in line]
    allowed = {name: metadata.metadata(name).get("Requires-Python") or "" for name in locked}
    assert len(allowed) > 50
    assert {n: s for n, s in allowed.items() if not SpecifierSet(s).contains(lowest)} == {}


def test_make_help_names_every_target():
    text = (ROOT / "Makefile").read_text(encoding="utf-8")
    (targets,) = re.findall(r"^\.PHONY: (.*)$", text, re.MULTILINE)
    shown = subprocess.run(
        ["make", "help"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout
    assert set(re.findall(r"^make (\S+)", shown, re.MULTILINE)) == set(targets.split())


@pytest.fixture
def description(monkeypatch):
    monkeypatch.setattr("setuptools.setup", lambda **_: None)
    return runpy.run_path(str(ROOT / "setup.py"))["description"]


def test_without_an_address_the_description_has_no_links(description):
    text = description()
    assert "unknown force over time" in text
    assert "`make over-time` draws this figure" not in text
    assert re.findall(r"\]\((?!https://)", text) == []
    assert "docs/run-file-format.md" in text


def test_with_an_address_its_links_are_absolute(description, tmp_path, monkeypatch):
    (tmp_path / "README.md").write_text("![A](docs/a.png) [b](docs/b.md) [c](https://c.org)")
    (tmp_path / "pyproject.toml").write_text(
        '[project]\nversion = "1.2"\n[project.urls]\nRepository = "https://x.org/r"\n'
    )
    monkeypatch.setitem(description.__globals__, "ROOT", tmp_path)
    assert description() == (
        "![A](https://x.org/r/raw/v1.2/docs/a.png) [b](https://x.org/r/blob/v1.2/docs/b.md) "
        "[c](https://c.org)"
    )


@pytest.mark.skipif(not (ROOT / ".git").exists(), reason="files are compared with those of git")
def test_the_distributions_are_complete(tmp_path):
    source, wheel = release_check.build(tmp_path / "dist")
    assert list(release_check.faults_of(source, wheel)) == []
