"""Signals read block by block are those read at once, and just as checked."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from rigtool.errors import RunFileError
from rigtool.runfile import Recording, RunWriter, open_run
from rigtool.runfile.recording import BLOCK_SAMPLES
from tests.runfile.whole_run import SPECS

SIZE = 2 * BLOCK_SAMPLES + 1234


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Recording]:
    """Two blocks and a bit, a hole near the end."""
    path: Path = tmp_path_factory.mktemp("blocks") / "run.h5"
    torque = np.random.default_rng(1).normal(size=SIZE)
    torque[-5] = np.nan
    with RunWriter(path, command="x", recordings=SPECS[1:]) as out:
        out.append("holds", {"time": np.arange(float(SIZE)), "torque": torque})
        out.finish({}, {})
    with open_run(path) as run:
        yield run.recording("holds")


@pytest.mark.parametrize(
    ("start", "stop"),
    [
        (0, 100),
        (0, BLOCK_SAMPLES),
        (BLOCK_SAMPLES - 1, BLOCK_SAMPLES + 1),
        (BLOCK_SAMPLES, 2 * BLOCK_SAMPLES),
        (7, 2 * BLOCK_SAMPLES + 9),
        (5, 5),
        (9, 3),
    ],
)
def test_blocks_join_to_what_was_asked_for(recording, start, stop):
    blocks = list(recording.blocks("torque", "time", start=start, stop=stop))
    assert all(time[-1] // BLOCK_SAMPLES == time[0] // BLOCK_SAMPLES for _, time in blocks)
    for index, name in enumerate(("torque", "time")):
        joined = np.concatenate([np.zeros(0), *(block[index] for block in blocks)])
        np.testing.assert_array_equal(joined, recording.read(name, start, max(start, stop)))


def test_without_limits_everything_is_read(recording):
    assert sum(time.size for (time,) in recording.blocks("time")) == SIZE
    assert sum(time.size for (time,) in recording.blocks("time", stop=SIZE + 7)) == SIZE


def test_a_hole_ends_the_blocks_where_it_is(recording):
    blocks = recording.blocks("torque")
    assert next(blocks)[0].size == next(blocks)[0].size == BLOCK_SAMPLES
    with pytest.raises(RunFileError, match=f"at sample {SIZE - 5}"):
        next(blocks)


def test_blocks_can_be_left_early(recording):
    for (time,) in recording.blocks("time"):
        assert time[0] == 0
        break
    assert recording.read("time", 3, 4) == 3
