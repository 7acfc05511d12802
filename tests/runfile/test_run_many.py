"""Many runs at once: all can be read in any order, and one that was replaced is refused."""

import os
import shutil
import threading
from contextlib import ExitStack
from pathlib import Path

import h5py
import numpy as np
import pytest

from rigtool.errors import RunFileError
from rigtool.runfile import Run, open_run
from rigtool.runfile.opened import MAX_OPEN
from tests.runfile.whole_run import SPECS, samples

COUNT = 3 * MAX_OPEN
RECORDING = SPECS[0].name


def copies(run_path: Path, folder: Path) -> list[Path]:
    return [Path(shutil.copy(run_path, folder / f"{n:02d}.h5")) for n in range(COUNT)]


def open_files() -> int:
    return int(h5py.h5f.get_obj_count(h5py.h5f.OBJ_ALL, h5py.h5f.OBJ_FILE))


@pytest.fixture
def opened(run_path, tmp_path):
    with ExitStack() as stack:
        yield [stack.enter_context(open_run(path)) for path in copies(run_path, tmp_path)]


def read(run: Run) -> None:
    wanted = samples()[RECORDING]
    for channel, values in wanted.items():
        found = run.recording(RECORDING).read_stored(channel)
        np.testing.assert_array_equal(found, values)


def test_few_are_kept_open_and_all_can_be_read_in_any_order(opened):
    before = open_files()
    assert before <= MAX_OPEN
    for number in np.random.default_rng(1).integers(0, COUNT, 4 * COUNT):
        read(opened[number])
        assert open_files() <= MAX_OPEN


def test_threads_may_read_different_runs(opened):
    failed = []

    def work(part: list[Run]) -> None:
        try:
            for run in part:
                read(run)
        except Exception as error:
            failed.append(error)

    threads = [threading.Thread(target=work, args=(opened[n::3],)) for n in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not failed


def test_closing_leaves_nothing_open(run_path, tmp_path):
    before = open_files()
    with ExitStack() as stack:
        for path in copies(run_path, tmp_path):
            read(stack.enter_context(open_run(path)))
    assert open_files() == before


@pytest.mark.parametrize("how", ["replaced", "changed", "overwritten", "gone"])
def test_a_file_that_is_not_the_same_any_more_is_refused(run_path, tmp_path, how):
    paths = copies(run_path, tmp_path)
    with ExitStack() as stack:
        runs = [stack.enter_context(open_run(path)) for path in paths]
        first = paths[0]  # shut since, so many were opened after it
        if how == "replaced":
            os.replace(shutil.copy(run_path, tmp_path / "new.h5"), first)
        elif how == "changed":
            with h5py.File(first, "r+", locking=False) as file:
                file.attrs["more"] = 1.0
        elif how == "overwritten":  # the same file with the same size
            first.write_bytes(first.read_bytes())
        else:
            first.unlink()
        with pytest.raises(RunFileError, match="no such file" if how == "gone" else "replaced"):
            read(runs[0])
        read(runs[1])
