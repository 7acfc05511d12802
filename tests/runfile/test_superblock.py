"""Remains of a run, damaged as well: brought back unchanged as far as they go, or refused."""

import os
import random
import signal
from pathlib import Path

import numpy as np
import pytest

from rigtool.errors import RunFileError
from rigtool.runfile import RunWriter, open_run
from rigtool.runfile.recovery import recover
from rigtool.runfile.superblock import CHECKSUM, SUPERBLOCK_SIZE, metadata_checksum
from tests.runfile.test_run_damaged import cut, flipped, flipped_in_headers, overwritten, swapped
from tests.runfile.whole_run import SPECS, samples

FILES = 60
COUNT = 20_000


@pytest.fixture(scope="module")
def part(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What a writer leaves that is killed after some whole chunks."""
    path = tmp_path_factory.mktemp("killed") / "run.h5"
    child = os.fork()
    if child == 0:
        with RunWriter(path, command="x", recordings=SPECS) as out:
            for name in ("sweep", "holds"):
                out.append(name, samples(COUNT)[name])
            out._sync(force=True)
            os.kill(os.getpid(), signal.SIGKILL)
    os.waitpid(child, 0)
    return Path(f"{path}.part")


def test_the_checksum_is_the_published_one():
    """Values that lookup3.c states itself."""
    assert metadata_checksum(b"") == 0xDEADBEEF
    assert metadata_checksum(b"Four score and seven years ago") == 0x17770551


def test_the_checksum_is_that_of_hdf5(part):
    start = part.read_bytes()[:SUPERBLOCK_SIZE]
    assert metadata_checksum(start[:CHECKSUM]) == int.from_bytes(start[CHECKSUM:], "little")


def test_remains_come_back_and_stay_as_they_are(part, tmp_path):
    before = part.read_bytes()
    found = recover(part, tmp_path / "back.h5")
    assert (found.samples, found.lost) == ({"sweep": 16384, "holds": 16384}, 0)
    assert part.read_bytes() == before


def test_damaged_remains(part, tmp_path):
    """None of them hangs either: HDF5 would wait for a writer to mend what is damaged."""
    good, expected = part.read_bytes(), samples(COUNT)
    kinds = [flipped, flipped_in_headers, overwritten, cut, swapped]
    damaged, back = tmp_path / "run.h5.part", tmp_path / "back.h5"
    refused = 0
    for seed in range(FILES):
        data = bytearray(good)
        kinds[seed % len(kinds)](data, random.Random(seed))
        damaged.write_bytes(data)
        try:
            recover(damaged, back, overwrite=True)
        except RunFileError as error:
            assert str(damaged) in str(error)  # noqa: PT017
            refused += 1
            continue
        with open_run(back) as run:
            for name, recording in run.recordings.items():
                for channel in recording.channels:
                    np.testing.assert_array_equal(
                        recording.read_stored(channel.name),
                        expected[name][channel.name][: recording.size],
                    )
    assert 0 < refused < FILES / 2
