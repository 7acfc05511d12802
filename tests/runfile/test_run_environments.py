"""File systems without locks or reservation, locked files, names of all kinds."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import h5py
import pytest

from rigtool.runfile import open_run
from tests.cli.called import call

FIXTURES = Path(__file__).parents[1] / "fixtures"
RECIPES = Path(__file__).parents[2] / "recipes"
ENOLCK, ENOSYS, EOPNOTSUPP, EAGAIN = 37, 38, 95, 11

SHIM = """
#include <errno.h>
#include <stdlib.h>
#include <sys/types.h>
int flock(int file, int what) { errno = atoi(getenv("LOCK")); return errno ? -1 : 0; }
int posix_fallocate(int file, off_t begin, off_t size) { return atoi(getenv("RESERVE")); }
int posix_fallocate64(int file, off_t begin, off_t size) { return atoi(getenv("RESERVE")); }
"""
pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="interposes functions of glibc")


@pytest.fixture(scope="module")
def shim(tmp_path_factory):
    """Compile functions that refuse what some file systems refuse."""
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler")
    folder = tmp_path_factory.mktemp("shim")
    (folder / "shim.c").write_text(SHIM)
    library = folder / "shim.so"
    subprocess.run([compiler, "-shared", "-fPIC", "-o", library, folder / "shim.c"], check=True)
    return library


def rigtool(*arguments, **environment):
    return subprocess.run(
        [sys.executable, "-m", "rigtool", *arguments],
        capture_output=True,
        env={**os.environ, **environment},
    )


def suspension(output, *more):
    return ["suspension", RECIPES / "briaire-2006.toml", "-o", output, "-q", *more]


def test_runs_are_written_and_read_without_locks_or_reservation(shim, tmp_path):
    cases = ((ENOLCK, EOPNOTSUPP), (EOPNOTSUPP, ENOSYS), (ENOSYS, 0))
    code = "import os\nfrom rigtool.cli import rigtool\n"
    for number, (lock, reserve) in enumerate(cases):
        output = tmp_path / f"{number}.h5"
        code += f"os.environ.update(LOCK='{lock}', RESERVE='{reserve}')\n"
        for line in (suspension(output), ["info", output]):
            code += f"rigtool({[str(word) for word in line]}, standalone_mode=False)\n"
    poor = {"LD_PRELOAD": str(shim), "LOCK": "0", "RESERVE": "0"}
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, env={**os.environ, **poor}
    )
    assert done.returncode == 0, done.stderr
    # each is printed by the command that measures, and by info
    assert done.stdout.count(b"spring_constant") == 2 * len(cases)


def test_a_locked_file_is_waited_for_not_restored(shim, tmp_path):
    poor = {"LD_PRELOAD": str(shim), "LOCK": str(EAGAIN), "RESERVE": "0"}
    done = rigtool("info", FIXTURES / "kt.h5", **poor)
    assert done.returncode == 3
    assert b"is locked by another program: wait until" in done.stderr
    assert b"restore" not in done.stderr


def test_a_file_that_another_program_writes_is_waited_for(tmp_path):
    path = tmp_path / "kt.h5"
    shutil.copy(FIXTURES / "kt.h5", path)
    with h5py.File(path, "r+"):
        done = rigtool("info", path)
    assert done.returncode == 3
    assert b"wait" in done.stderr
    with open_run(path):
        pass


@pytest.mark.parametrize(("length", "code"), [(250, 0), (252, 2), (300, 2)])
def test_long_names(tmp_path, capsys, length, code):
    name = "s" * (length - 3) + ".h5"
    found, _, err = call(capsys, *suspension(tmp_path / name))
    assert found == code, err
    assert ("at most 250" in err) == (code == 2)
    assert len(list(tmp_path.iterdir())) == (code == 0)


def test_names_that_are_not_utf_8_are_refused_by_name(tmp_path):
    strange = os.fsencode(tmp_path) + b"/kt\xff.h5"
    shutil.copy(FIXTURES / "kt.h5", strange)
    for arguments in (
        ["info", strange],
        ["calibrate-kt", strange, "-o", tmp_path / "o.h5"],
        suspension(strange, "--overwrite"),
        ["report", strange, "-o", tmp_path / "report"],
    ):
        done = rigtool(*arguments)
        assert done.returncode == 2, done.stderr
        assert b"kt\\udcff.h5: is not UTF-8" in done.stderr
    assert os.listdir(os.fsencode(tmp_path)) == [b"kt\xff.h5"]


def test_a_folder_with_such_a_name_is_refused_before_it_is_imported(tmp_path):
    folder = tmp_path / "measured"
    folder.mkdir()
    Path(os.fsdecode(os.fsencode(folder) + b"/a\xff.csv")).write_text("1,2\n3,4\n")
    mapping = tmp_path / "map.toml"
    mapping.write_text(
        'mapping = 1\n[rig]\nname = "b"\n[signals]\n'
        'time = { column = 1, unit = "s" }\nforce = { column = 2, unit = "N" }\n'
    )
    done = rigtool("import", folder, "--map", mapping, "-o", tmp_path / "runs")
    assert done.returncode == 2, done.stderr
    assert b"is not UTF-8" in done.stderr
    assert not (tmp_path / "runs").exists()
