"""Functions are compiled where nothing can be kept, too."""

import importlib
import subprocess
import sys

import pytest
from numba.core import caching, config

from rigtool.errors import UsageError
from rigtool.numerics.compiled import compiled


def twice(value):
    return 2 * value


def test_without_a_place_for_machine_code(monkeypatch):
    def none(cls, *arguments):
        return None

    for locator in caching._CacheLocator.__subclasses__():
        monkeypatch.setattr(locator, "from_function", classmethod(none))
    assert compiled(twice)(21) == 42


def test_an_environment_that_keeps_numba_from_compiling(monkeypatch):
    monkeypatch.setattr(config, "DISABLE_JIT", 1)
    with pytest.raises(UsageError, match="NUMBA_DISABLE_JIT"):
        compiled(twice)(21)


CALLER = """
from called import LIMIT, inner
from rigtool.numerics.compiled import compiled
import others

@compiled
def outer(value):
    return inner(value) + LIMIT + others.ADDED
"""
CALLED = """
from rigtool.numerics.compiled import compiled
LIMIT = {limit}

@compiled
def inner(value):
    return {factor} * value
"""


def test_machine_code_follows_what_was_changed_in_other_files(tmp_path, monkeypatch):
    # numba looks at the file of the function alone
    (tmp_path / "caller.py").write_text(CALLER)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path / "kept"))

    def called(factor, limit, added):
        (tmp_path / "called.py").write_text(CALLED.format(factor=factor, limit=limit))
        (tmp_path / "others.py").write_text(f"ADDED = {added}")
        for name in ("caller", "called", "others"):
            monkeypatch.delitem(sys.modules, name, raising=False)
        found = importlib.import_module("caller").outer(100)
        return found, len(list(tmp_path.rglob("caller.outer*.nbi")))

    assert called(2, 1, 5000) == (5201, 1)
    assert called(3, 1, 5000) == (5301, 2)
    assert called(3, 4, 5000) == (5304, 3)
    assert called(3, 4, 6000) == (6304, 4)
    assert called(2, 1, 5000) == (5201, 4)


def test_numba_is_imported_with_the_first_call():
    code = (
        "import sys\n"
        "import rigtool.experiments.force_filter.kalman\n"
        "from rigtool.rigs.virtual.kernel import _bristle\n"
        "print('numba' in sys.modules, _bristle(0.5, 0.0, 0.1), 'numba' in sys.modules)"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert found.stdout == "False 0.5 True\n", found.stderr
