"""Commands and importers of other packages, found by the entry points of installed metadata."""

import importlib
import os
import subprocess
import sys

import pytest

from rigtool import plugins
from rigtool.errors import RigtoolError

SOURCE = '''
import click
import numpy as np
from rigtool.recipe.mapping import Mapping
from rigtool.runfile.importers.raw import Importer, Raw

@click.command()
def heat():
    """Show heat."""
    click.echo("hot")

def read(path, mapping, skip_bad):
    count = len(path.read_bytes()) - 4
    columns = {"t": np.arange(count) * 1.0, "i": np.ones(count)}
    signals = {"time": {"column": "t", "unit": "ms"}, "current": {"column": "i", "unit": "mA"}}
    filled = mapping.model_dump() | {"signals": signals}
    raw = Raw(columns, np.arange(count), np.arange(count) + 1, "sample")
    return raw, Mapping.model_validate(filled), ["by acme"]

acme = Importer(lambda path: path.read_bytes()[:4] == b"acme", read, (".acm",))
fails = Importer(lambda path: 1 / 0, read)
text = "no command"
'''


@pytest.fixture
def install(tmp_path, monkeypatch):
    """Return a function that installs a package with entry points, as far as metadata go."""
    site = tmp_path / "site"
    site.mkdir()
    (site / "acme_rig.py").write_text(SOURCE)
    monkeypatch.syspath_prepend(str(site))

    def write(points, name="acme-rig"):
        info = site / f"{name.replace('-', '_')}-1.0.dist-info"
        info.mkdir()
        head = f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\nSummary: Acme's own.\n"
        (info / "METADATA").write_text(head)
        (info / "entry_points.txt").write_text(points)
        importlib.invalidate_caches()
        plugins.plugins.cache_clear()
        plugins.load_all.cache_clear()
        return site

    yield write
    plugins.plugins.cache_clear()
    plugins.load_all.cache_clear()
    sys.modules.pop("acme_rig", None)


def run(site, *arguments):
    environment = os.environ | {"PYTHONPATH": str(site)}
    return subprocess.run(
        [sys.executable, "-W", "error", "-m", "rigtool", *arguments],
        env=environment,
        capture_output=True,
        text=True,
    )


def test_a_command_is_listed_without_being_imported_and_runs(install):
    site = install("[rigtool.commands]\nheat = acme_rig:heat\nbroken = acme_missing:command\n")
    listed = run(site, "--help")
    assert f"Commands of other packages:\n  {'broken':17}Acme's own. [acme-rig]\n" in listed.stdout
    assert f"  {'heat':17}Acme's own. [acme-rig]" in listed.stdout
    assert listed.stderr == ""
    assert run(site, "heat").stdout == "hot\n"


def test_without_other_packages_the_help_has_no_section_for_them(tmp_path):
    assert "other packages" not in run(tmp_path, "--help").stdout


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("acme_missing:command", "cannot be imported: ModuleNotFoundError: No module named"),
        ("acme_rig:nothing", "cannot be imported: AttributeError"),
        ("acme_rig:text", "is of type str, but must be Command"),
    ],
)
def test_a_broken_command_is_one_line_with_its_name(install, value, message):
    done = run(install(f"[rigtool.commands]\nheat = {value}\n"), "heat")
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.startswith(f"Error: command heat of acme-rig {message}")
    assert done.stderr.count("\n") == 1


def test_a_command_cannot_replace_one_of_rigtool(install):
    done = run(install("[rigtool.commands]\ninfo = acme_rig:heat\n"), "info", "--help")
    assert "Show the contents of a run file" in done.stdout
    assert done.stderr == ""
    done = run(install("[rigtool.commands]\ninfo = acme_rig:heat\n", "other"), "--help")
    assert done.stderr.splitlines() == [
        "Warning: command info of acme-rig is left out: rigtool has one of that name",
        "Warning: command info of other is left out: rigtool has one of that name",
    ]


def test_of_two_packages_with_one_name_the_first_is_taken(install, caplog):
    install("[rigtool.commands]\nheat = acme_rig:heat\n")
    install("[rigtool.commands]\nheat = acme_rig:text\n", "zeta")
    assert plugins.plugins("rigtool.commands")["heat"].value == "acme_rig:heat"
    assert caplog.messages == [
        "Warning: command heat of zeta is left out: acme-rig has one of that name"
    ]


def test_an_importer_reads_files_alone_and_from_a_folder(install, tmp_path):
    site = install("[rigtool.importers]\nacme = acme_rig:acme\n")
    (tmp_path / "data").mkdir()
    for name in ("a.acm", "b.acm"):
        (tmp_path / "data" / name).write_bytes(b"acme" + bytes(50))
    single = run(site, "import", str(tmp_path / "data" / "a.acm"), "-o", str(tmp_path / "a.h5"))
    assert single.stderr.splitlines() == [
        f"Written: {tmp_path / 'a.h5'}: run of import, 50 samples",
        "Note: a.h5: by acme",
    ]
    run(site, "import", str(tmp_path / "data"), "-o", str(tmp_path / "runs"))
    assert sorted(path.name for path in (tmp_path / "runs").iterdir()) == ["a.h5", "b.h5"]


def test_a_broken_importer_costs_a_warning_and_no_import(install, tmp_path):
    names = "gone = acme_missing:x\nfails = acme_rig:fails\nacme = acme_rig:acme\n"
    site = install(f"[rigtool.importers]\n{names}")
    source = tmp_path / "a.acm"
    source.write_bytes(b"acme" + bytes(50))
    done = run(site, "import", str(source), "-q", "-o", str(tmp_path / "a.h5"))
    assert (done.returncode, done.stdout) == (0, "")
    assert (tmp_path / "a.h5").is_file()
    (line,) = done.stderr.splitlines()
    assert line.startswith("Warning: importer gone of acme-rig cannot be imported: ")
    source.write_bytes(b"else" + bytes(50))
    done = run(site, "import", str(source), "-q", "-o", str(tmp_path / "b.h5"))
    assert done.returncode == 3
    assert f"Warning: importer fails fails at {source}: ZeroDivisionError" in done.stderr
    assert "Traceback" not in done.stderr


def test_what_a_package_raises_at_import_becomes_one_message(install, capsys):
    site = install("[rigtool.importers]\nquits = acme_quits:x\n")
    (site / "acme_quits.py").write_text("import sys\nprint(1)\nsys.exit('two\\nlines')\n")
    (entry,) = plugins.plugins("rigtool.importers").values()
    with pytest.raises(RigtoolError, match=r"^importer quits of acme-rig .*SystemExit: two lines"):
        plugins.load_entry_point(entry, object)
    assert capsys.readouterr() == ("", "1\n")  # stdout may be a document of JSON
