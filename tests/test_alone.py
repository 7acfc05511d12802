"""The lock that processes of the tests share."""

import sqlite3
import subprocess
import sys
from pathlib import Path

import pytest

import tests.alone
from tests.alone import alone

HOLDER = """
import sys
from pathlib import Path
from tests.alone import alone
with alone(Path(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.read()
"""


@pytest.mark.real_time
def test_a_lock_is_free_when_its_process_is_killed(tmp_path, monkeypatch):
    path = tmp_path / "lock"
    command = [sys.executable, "-c", HOLDER, path]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    root = Path(__file__).parents[1]
    with subprocess.Popen(command, cwd=root, **pipes) as holder:
        assert holder.stdout.readline() == b"held\n"
        monkeypatch.setattr(tests.alone, "PATIENCE", 0.0)
        with pytest.raises(sqlite3.OperationalError, match="locked"), alone(path):
            pass
        holder.kill()
    with alone(path):
        pass
