"""Functions are compiled where nothing can be kept, too."""

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


def test_numba_is_imported_with_the_first_call():
    code = (
        "import sys\n"
        "import rigtool.experiments.force_filter.kalman\n"
        "from rigtool.rigs.virtual.kernel import _bristle\n"
        "print('numba' in sys.modules, _bristle(0.5, 0.0, 0.1), 'numba' in sys.modules)"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert found.stdout == "False 0.5 True\n", found.stderr
