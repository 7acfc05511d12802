"""The run with everything, written once for all tests here."""

from pathlib import Path

import pytest

from tests.runfile.whole_run import SOURCE, write


@pytest.fixture(scope="session")
def run_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The run with everything, one input included; not to be changed."""
    folder = tmp_path_factory.mktemp("run")
    first = write(folder / "input.h5", size=100)
    return write(folder / "run.h5", inputs=(first,), source=SOURCE)
