import os
from dataclasses import replace
from pathlib import Path

import pytest

from rigtool.errors import RigtoolError, UsageError
from rigtool.report import folder
from rigtool.report.build import build_report
from rigtool.report.folder import write_report


@pytest.fixture
def report(make, open_all, no_figures):
    return build_report(open_all(make("measure-force", "force", folder="runs")))


def tree(path: Path) -> list[str]:
    return sorted(str(p.relative_to(path)) for p in path.rglob("*") if p.is_file())


def test_the_folder_holds_all_forms(report, tmp_path):
    write_report(report, tmp_path / "out", overwrite=False)
    names = tree(tmp_path / "out")
    assert {"index.html", "tables.txt", "figures/figure-63-force.png"} < set(names)
    for suffix in ("md", "csv", "tex"):
        assert f"tables/table-8-force.{suffix}" in names
    assert sorted(p.name for p in tmp_path.iterdir()) == ["out", "runs"]


def test_an_existing_folder_is_kept_unless_asked(report, tmp_path):
    out = tmp_path / "out"
    write_report(report, out, overwrite=False)
    with pytest.raises(UsageError, match="--overwrite"):
        write_report(report, out, overwrite=False)
    stale = out / "figures" / "figure-99.svg"
    stale.write_text("old")
    write_report(report, out, overwrite=True)
    assert not stale.exists()


def test_a_folder_with_anything_else_is_never_replaced(report, tmp_path):
    out = tmp_path / "home"
    out.mkdir()
    (out / "thesis.doc").write_text("years of work")
    with pytest.raises(UsageError, match=r"'thesis\.doc', which is no part of a report"):
        write_report(report, out, overwrite=True)
    assert (out / "thesis.doc").read_text() == "years of work"


@pytest.mark.parametrize("make_target", ["file", "link"])
def test_what_is_no_folder_is_refused(report, tmp_path, make_target):
    target = tmp_path / "out"
    if make_target == "file":
        target.write_text("mine")
    else:
        target.symlink_to(tmp_path)
    with pytest.raises(UsageError, match="is no folder"):
        write_report(report, target, overwrite=True)


def test_a_missing_parent_is_refused(report, tmp_path):
    with pytest.raises(UsageError, match="does not exist: create it first"):
        write_report(report, tmp_path / "no" / "out", overwrite=False)


def test_a_failure_leaves_the_old_folder_and_nothing_else(report, tmp_path, monkeypatch):
    out = tmp_path / "out"
    write_report(report, out, overwrite=False)
    before = {name: (out / name).read_bytes() for name in tree(out)}
    full = replace(report, remarks=(("changed", ("a note",)),))

    def refuse(*args: object) -> None:
        raise OSError(28, "the disk is full")

    monkeypatch.setattr(Path, "write_bytes", refuse)
    with pytest.raises(RigtoolError, match="the disk is full"):
        write_report(full, out, overwrite=True)
    monkeypatch.undo()
    assert {name: (out / name).read_bytes() for name in tree(out)} == before
    assert sorted(p.name for p in tmp_path.iterdir()) == ["out", "runs"]


def test_a_failing_exchange_brings_the_old_folder_back(report, tmp_path, monkeypatch):
    out = tmp_path / "out"
    write_report(report, out, overwrite=False)
    rename = Path.rename

    def refuse_new(self: Path, target: Path) -> Path:
        if self.name == "new":
            raise OSError(5, "Input/output error")
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", refuse_new)
    with pytest.raises(RigtoolError, match="Input/output error"):
        write_report(report, out, overwrite=True)
    assert (out / "index.html").exists()


def test_others_may_read_it(report, tmp_path):
    write_report(report, tmp_path / "out", overwrite=False)
    mask = os.umask(0)
    os.umask(mask)
    assert (tmp_path / "out").stat().st_mode & 0o777 == 0o777 & ~mask


def test_tables_text_is_what_the_terminal_shows(report, tmp_path):
    write_report(report, tmp_path / "out", overwrite=False)
    assert (tmp_path / "out" / "tables.txt").read_text() == folder.terminal_text(report)
