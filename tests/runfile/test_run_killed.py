"""A writer that is killed at any moment loses nothing that it had synced."""

import json
import os
import random
import signal
import time
from pathlib import Path

import numpy as np
import pytest

from rigtool.errors import RunFileError, UsageError
from rigtool.runfile import RunWriter, open_run, writer
from rigtool.runfile.recovery import recover
from tests.runfile.whole_run import RESULTS, SPECS, TABLES, samples, write

BLOCKS = 10
KILLS = 55


def acquire(path: Path, log: int) -> None:
    """Record blocks and finish; write the samples by recording to `log` after each sync."""

    class Logged(RunWriter):
        def _sync(self, force: bool = False) -> None:
            before = self._synced
            super()._sync(force)
            if self._synced != before:
                counts = {name: stream.written for name, stream in self._streams.items()}
                os.write(log, json.dumps(counts).encode() + b"\n")

    block = samples(5000)
    with Logged(
        path, command="x", recipe=None, recipe_text=None, recordings=SPECS, overwrite=True
    ) as out:
        for _ in range(BLOCKS):
            for name in ("sweep", "holds"):
                out.append(name, block[name])
        out.finish(RESULTS, TABLES)


def acquire_and_kill(path: Path, syncs: int | None, pause: float = 0.0) -> list[dict[str, int]]:
    """Run `acquire` in a process of its own and kill it some time after so many syncs.

    Returns what each sync had written. With `syncs` None it is left alone.
    """
    reading, log = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            os.close(reading)
            acquire(path, log)
        finally:
            os._exit(0)
    os.close(log)
    lines = []
    with os.fdopen(reading) as stream:
        if syncs is not None:
            lines = [stream.readline() for _ in range(syncs)]
            time.sleep(pause)
            os.kill(child, signal.SIGKILL)
        lines += stream.readlines()
    os.waitpid(child, 0)
    return [json.loads(line) for line in lines if line.endswith("\n")]


def check_samples(path: Path, synced: dict[str, int]) -> int:
    expected = {
        name: {key: np.tile(values, BLOCKS) for key, values in block.items()}
        for name, block in samples(5000).items()
    }
    with open_run(path) as run:
        for name, recording in run.recordings.items():
            assert recording.size >= synced.get(name, 0)
            for channel, values in expected[name].items():
                np.testing.assert_array_equal(recording.read(channel), values[: recording.size])
        return sum(recording.size for recording in run.recordings.values())


def test_killed_at_any_moment(tmp_path, monkeypatch):
    monkeypatch.setattr(writer, "SYNC_INTERVAL", 0.0)
    path = tmp_path / "run.h5"
    begin = time.perf_counter()
    total_syncs = len(acquire_and_kill(path, None))
    step = (time.perf_counter() - begin) / total_syncs
    earlier = path.read_bytes()
    luck = random.Random(20061)
    outcomes = {"finished": 0, "recovered": 0, "nothing": 0}
    for _ in range(KILLS):
        path.write_bytes(earlier)
        inode = path.stat().st_ino
        logged = acquire_and_kill(path, luck.randint(0, total_syncs), luck.uniform(0, 2 * step))
        synced = logged[-1] if logged else {}
        if path.stat().st_ino != inode:
            assert check_samples(path, {}) == 2 * 5000 * BLOCKS
            outcomes["finished"] += 1
        else:
            assert path.read_bytes() == earlier
            if any(synced.values()):
                found = recover(f"{path}.part", tmp_path / "back.h5", overwrite=True)
                assert found.lost == 0
                total = check_samples(tmp_path / "back.h5", synced)
                assert total == sum(found.samples.values())
                outcomes["recovered"] += 1
            else:
                outcomes["nothing"] += 1
    assert sum(outcomes.values()) == KILLS
    # Most moments are in the middle of it, or the test would prove little.
    assert outcomes["recovered"] >= KILLS // 2, outcomes


def interrupted(path: Path, size: int = 10_000) -> Path:
    def stop() -> None:
        arguments = {"command": "stribeck", "recipe": None, "recipe_text": "[rig]\n", "seed": 5}
        with RunWriter(path, recordings=SPECS, **arguments, argv=["rigtool", "a b"]) as out:
            out.append("sweep", samples(size)["sweep"])
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stop()
    return Path(f"{path}.part")


def test_recovering_keeps_where_the_run_came_from(tmp_path):
    part = interrupted(tmp_path / "run.h5")
    found = recover(part)
    assert found.output == tmp_path / "run.h5"
    assert found.samples == {"sweep": 10_000, "holds": 0}
    assert sorted(os.listdir(tmp_path)) == ["run.h5", "run.h5.part"]
    with open_run(found.output) as run:
        assert run.command == "stribeck"
        assert run.provenance["argv"] == ["rigtool", "a b"]
        assert run.provenance["recipe"] == "[rig]\n"
        assert run.provenance["seed"] == "5"
        assert run.notes == ("recovered 10000 samples of a run that was interrupted",)
        assert run.recording("sweep").condition("speed") == 3.0
        np.testing.assert_array_equal(
            run.recording("sweep").read("current"), samples(10_000)["sweep"]["current"]
        )


def test_recovering_stops_at_damage(tmp_path):
    part = interrupted(tmp_path / "run.h5", 20_000)
    import h5py

    with h5py.File(part, "r") as file:
        chunk = file["entry/recordings/sweep/encoder"].id.get_chunk_info(1)
    data = bytearray(part.read_bytes())
    data[chunk.byte_offset + 5] ^= 0xFF
    part.write_bytes(data)
    found = recover(part)
    assert found.samples == {"sweep": 8192, "holds": 0}
    assert found.lost == 20_000 - 8192


def test_recovering_does_not_overwrite(tmp_path):
    part = interrupted(tmp_path / "run.h5")
    write(tmp_path / "run.h5", size=10, overwrite=True)
    part = interrupted(tmp_path / "other.h5")
    before = (tmp_path / "run.h5").read_bytes()
    with pytest.raises(UsageError, match="exists already"):
        recover(part, tmp_path / "run.h5")
    with pytest.raises(UsageError, match="is what is to be recovered"):
        recover(part, part, overwrite=True)
    assert (tmp_path / "run.h5").read_bytes() == before


def test_a_failure_while_recovering_leaves_what_was_there(tmp_path, monkeypatch):
    part = interrupted(tmp_path / "run.h5")
    before = part.read_bytes()

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(RunWriter, "finish", full)
    with pytest.raises(OSError, match="No space left"):
        recover(part)
    assert os.listdir(tmp_path) == ["run.h5.part"]
    assert part.read_bytes() == before


def test_what_cannot_be_recovered(tmp_path):
    path = write(tmp_path / "run.h5", size=10)
    with pytest.raises(RunFileError, match="is a finished run"):
        recover(path, tmp_path / "b.h5")
    with pytest.raises(UsageError, match="with -o"):
        recover(path)
    (tmp_path / "x.h5.part").write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(500))
    with pytest.raises(RunFileError, match=r"x\.h5\.part"):
        recover(tmp_path / "x.h5.part")
    assert sorted(os.listdir(tmp_path)) == ["run.h5", "x.h5.part"]
