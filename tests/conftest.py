"""No test asks how long something takes: tests of lines run in emulated time.

The few marked `real_time` use the system's own clock, ports and processes, and assert only what
holds on a machine that stalls as well.
"""

import gc
import os
import signal
from importlib.metadata import version

# The tests' matrices are small: threads of BLAS only wait for each other, and for other workers.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# Sums round alike on all processors with AVX2: wider vector units add in another order. Their names
# in numpy 2.4 are those of levels; an unknown name is a warning.
os.environ.setdefault("OPENBLAS_CORETYPE", "Haswell")
os.environ.setdefault(
    "NPY_DISABLE_CPU_FEATURES",
    "X86_V4 AVX512_ICL AVX512_SPR"
    if tuple(map(int, version("numpy").split(".")[:2])) >= (2, 4)
    else "AVX512F AVX512CD AVX512_SKX AVX512_CLX AVX512_CNL AVX512_ICL",
)

import pytest
from hypothesis import Phase, settings

# In SI units a variance may be 1e-12: by default, pytest.approx takes any number that small for any
# other. A relative tolerance is one, unless zero is expected.
type(pytest.approx(1.0)).DEFAULT_ABSOLUTE_TOLERANCE = property(
    lambda one: 0.0 if one.expected else 1e-12
)

# Imports make many objects and no garbage; until all tests are collected, nothing looks for some.
gc.disable()

# No power fails during tests: nothing waits for the disk, but each handle must be one.
os.fsync = os.fstat

# A job in the background of a script ignores Ctrl-C and Ctrl-\, and so would every program that it
# starts.
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGQUIT, signal.SIG_DFL)

# The same few examples at each run; many others with `pytest --hypothesis-profile luck`.
settings.register_profile("luck", deadline=None, max_examples=200)
settings.register_profile("any machine", deadline=None, derandomize=True, max_examples=30)
settings.load_profile("any machine")
settings.register_profile("first failure", phases=[Phase.explicit, Phase.generate])


def pytest_collection_finish():
    """Let the collector of garbage look at what tests make, not at all that was imported."""
    gc.collect()
    gc.freeze()
    gc.enable()
    gc.set_threshold(20_000, 10, 10)


def pytest_collection_modifyitems(items):
    """Put the longest tests first: no process is alone with one of them in the end."""
    items.sort(key=lambda item: item.path.name != "test_pages.py")


@pytest.fixture(autouse=True)
def trees_are_read_once(request, monkeypatch):
    """Except in tests/runfile, which is about reading."""
    if "tests/runfile/" not in request.node.nodeid:
        from tests import read_once

        monkeypatch.setattr(read_once.tree, "read_tree", read_once.read_tree_once)


@pytest.fixture(autouse=True)
def staircases_are_fitted_once(request, monkeypatch):
    """Except in tests/experiments/torque_constant, which is about fitting."""
    if "tests/experiments/torque_constant/" not in request.node.nodeid:
        from tests import fitted_once

        monkeypatch.setattr(fitted_once.temperature_fit, "fit_staircases", fitted_once.fit_once)


@pytest.fixture
def world(request, monkeypatch):
    """The emulated time in which a test runs; None where the test is in real time."""
    if request.node.get_closest_marker("real_time"):
        yield None
        return
    from tests.rigs.serial.emulated_time import emulated_time

    with emulated_time(monkeypatch) as world:
        yield world
