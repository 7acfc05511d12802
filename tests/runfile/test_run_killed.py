"""An acquisition that is killed at any moment loses nothing that it had synced."""

import bisect
import itertools
import json
import mmap
import os
import random
import shutil
import signal
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TextIO

import h5py
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import rigtool.cli as cli
from rigtool.errors import RigtoolError, RunFileError, UsageError
from rigtool.runfile import RunWriter, chunk_of, open_run, writer
from rigtool.runfile.recovery import recover
from tests.runfile.whole_run import SPECS, samples, write
from tests.thorough import first_of, thorough

ROOT = Path(__file__).parents[2]
RECIPE, FIXTURES = ROOT / "recipes" / "briaire-2006.toml", ROOT / "tests" / "fixtures"

# Short, but each with several recordings of more than a chunk.
COMMANDS = {
    "stribeck": (
        "stribeck.hold_speeds=[5, 12, 30]",
        "stribeck.hold_revolutions=1",
        "stribeck.hold_time=0.1",
        "stribeck.sweep_time=3",
        "stribeck.breakaway_positions=3",
        "stribeck.radial_force=0",
        "stribeck.record_every=4",
    ),
    "ilc-learn": (
        "ilc_learn.moves=6",
        "ilc_learn.speeds_rev_per_s=[3, 6]",
        "ilc_learn.low_speeds_rev_per_s=[]",
    ),
    "measure-force": (
        "measure_force.forces=[0.25]",
        "measure_force.cycles=3",
        "measure_force.extra_cycles=1",
        "measure_force.speed_rev_per_s=0.4",
        "measure_force.record_every=4",
    ),
}


def command_line(command: str, output: Path) -> list[str]:
    inputs = ["--kt", str(FIXTURES / "kt.h5")]
    if command == "measure-force":
        inputs += ["--tables", str(FIXTURES / "tables.h5")]
    sets = [item for value in COMMANDS[command] for item in ("--set", value)]
    line = [command, str(RECIPE), "-o", str(output), *inputs, *sets]
    return [*line, "--seed", "3", "-q", "--overwrite"]


def call(line: list[str]) -> int:
    """Run a command in this process; return its exit code."""
    before = signal.getsignal(signal.SIGTERM)
    try:
        cli.main(line)
    except SystemExit as end:
        return end.code if isinstance(end.code, int) else 1
    finally:
        signal.signal(signal.SIGTERM, before)


def report_syncs(log: int) -> None:
    """Let every writer report the samples of each recording to `log` after each sync."""
    sync = RunWriter._sync

    def reporting(self: RunWriter, force: bool = False) -> None:
        before = self._synced
        sync(self, force)
        if self._synced != before:
            counts = {name: stream.written for name, stream in self._streams.items()}
            os.write(log, json.dumps(counts).encode() + b"\n")

    RunWriter._sync = reporting  # type: ignore[method-assign]
    # The virtual rig is a thousand times faster than a real one, which syncs every chunk.
    writer.SYNC_INTERVAL = 0.0


@dataclass(frozen=True)
class Acquisition:
    """What a command did: exit code (minus the signal), samples at each sync, and when it was."""

    code: int
    synced: list[dict[str, int]]
    times: list[float]


def acquire(line: list[str], kill_after: int | None = None, pause: float = 0.0) -> Acquisition:
    """Run a command in a process of its own; kill it `pause` s after so many syncs, if reported.

    A fork has everything imported and compiled: what is left to kill is the acquisition.
    """
    begin = time.perf_counter()
    reading, log = os.pipe()
    child = os.fork()
    if child == 0:
        code = 99
        try:
            os.close(reading)
            report_syncs(log)
            code = call(line)
        finally:
            os._exit(code)
    os.close(log)
    lines, times = [], []

    def read(stream: TextIO) -> None:
        for text in stream:
            lines.append(text)
            times.append(time.perf_counter() - begin)
            if len(lines) == kill_after:
                return

    with os.fdopen(reading) as stream:
        if kill_after != 0:
            read(stream)
        if kill_after is not None:
            time.sleep(pause)
            os.kill(child, signal.SIGKILL)
            kill_after = None
            read(stream)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    times.append(time.perf_counter() - begin)
    return Acquisition(code, [json.loads(text) for text in lines if text.endswith("\n")], times)


def recovered(part: Path, output: Path, capsys: pytest.CaptureFixture[str]) -> dict[str, int]:
    """Run `rigtool recover`; return how many samples it says that it brought back."""
    code = call(["recover", str(part), "-o", str(output), "--overwrite"])
    said = capsys.readouterr()
    if code == 3:  # killed before a chunk was whole
        assert "nothing to recover" in said.err
        return {}
    assert code == 0, said.err
    assert "damaged" not in said.err
    counts = (line.removesuffix(" samples").rpartition(": ") for line in said.out.splitlines())
    return {name: int(count) for name, _, count in counts}


def require_beginning(path: Path, counts: dict[str, int], whole: Path) -> None:
    """Each recording must hold the first `counts` samples of that of the whole run."""
    with open_run(path) as found, open_run(whole) as expected:
        assert {name: item.size for name, item in found.recordings.items()} == counts
        for name, recording in found.recordings.items():
            for channel in recording.channels:
                np.testing.assert_array_equal(
                    recording.read_stored(channel.name),
                    expected.recordings[name].read_stored(channel.name, 0, counts[name]),
                )


@pytest.mark.parametrize("kills", first_of([4, 36]))
@pytest.mark.parametrize("command", ["stribeck", *thorough("ilc-learn", "measure-force")])
def test_a_command_killed_at_any_moment(tmp_path, capsys, command, kills):
    path, back, whole = (tmp_path / name for name in ("run.h5", "back.h5", "whole.h5"))
    part = Path(f"{path}.part")
    assert call(command_line(command, whole)) == 0  # imports and compiles
    undisturbed = acquire(command_line(command, whole))
    assert undisturbed.code == 0
    syncs = undisturbed.times[:-1]
    with open_run(whole) as run:
        content = run.content_sha256
    earlier = (FIXTURES / "kt.h5").read_bytes()
    luck = random.Random(20061)
    outcomes = {"finished": 0, "recovered": 0, "nothing": 0}
    for _ in range(kills):
        part.unlink(missing_ok=True)
        path.write_bytes(earlier)
        moment = luck.uniform(syncs[0] / 2, undisturbed.times[-1])
        passed = bisect.bisect(syncs, moment)
        killed = acquire(command_line(command, path), passed, moment - ([0.0, *syncs][passed]))
        witness = killed.synced[-1] if killed.synced else {}
        if path.read_bytes() != earlier:
            with open_run(path) as run:
                assert run.content_sha256 == content
            outcomes["finished"] += 1
            continue
        assert killed.code == -signal.SIGKILL
        counts = recovered(part, back, capsys) if part.exists() else {}
        assert all(counts.get(name, 0) >= count for name, count in witness.items())
        if counts:
            require_beginning(back, counts, whole)
        outcomes["recovered" if counts else "nothing"] += 1
    # Some moments are in the middle of it, or the test would prove little.
    assert outcomes["recovered"] >= max(1, kills // 6), outcomes


def interrupted(path: Path, size: int = 10_000, recordings=SPECS) -> Path:
    def stop() -> None:
        arguments = {"command": "stribeck", "recipe": None, "recipe_text": "[rig]\n", "seed": 5}
        with RunWriter(path, recordings=recordings, **arguments, argv=["rigtool", "a b"]) as out:
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
    with h5py.File(part, "r") as file:
        chunk = file["entry/recordings/sweep/encoder"].id.get_chunk_info(1)
    data = bytearray(part.read_bytes())
    data[chunk.byte_offset + 5] ^= 0xFF
    part.write_bytes(data)
    found = recover(part)
    assert found.samples == {"sweep": 8192, "holds": 0}
    assert found.lost == 20_000 - 8192


@pytest.mark.parametrize(("chunk", "whole"), [(64, 960), (256, 768), (8192, 0)])
def test_a_killed_run_loses_less_than_a_chunk(tmp_path, chunk, whole):
    """Killed at sample 1000, as by SIGKILL: nothing is closed, nothing written any more."""
    slow = [replace(spec, chunk=chunk) for spec in SPECS]
    writer = RunWriter(tmp_path / "run.h5", command="stribeck", recordings=slow)
    with writer as out:
        block = samples(1000)["sweep"]
        for start in range(0, 1000, 50):
            out.append("sweep", {name: part[start : start + 50] for name, part in block.items()})
        out._sync(force=True)
        left = Path(shutil.copy(out.part, tmp_path / "left.h5.part"))
        out.finish({}, {})
    if not whole:
        with pytest.raises(RunFileError, match="holds no sample that is whole"):
            recover(left)
        return
    assert recover(left).samples == {"sweep": whole, "holds": 0}
    with open_run(tmp_path / "left.h5") as run:
        for name, values in block.items():
            found = run.recording("sweep").read_stored(name)
            np.testing.assert_array_equal(found, values[:whole])


def snapshots(path: Path, recordings, size: int) -> list[tuple[bytes, int]]:
    """Return the part after each sync, with the samples of each recording that it must hold."""
    found = []
    arguments = {"command": "stribeck", "recipe": None, "recipe_text": None}
    with RunWriter(path, recordings=recordings, **arguments) as out:
        for start in range(0, size, recordings[0].chunk):
            for spec in recordings:
                block = {name: part[:size] for name, part in samples(size)["sweep"].items()}
                stop = start + spec.chunk
                out.append(spec.name, {name: part[start:stop] for name, part in block.items()})
            out._sync(force=True)
            found.append((out.part.read_bytes(), start + recordings[0].chunk))
        out.finish({}, {})
    return found


def test_a_write_that_stops_between_two_pages_costs_nothing_synced(tmp_path):
    """A kernel ends the write of a killed process between two pages of memory."""
    names = [f"sweep_{index}" for index in range(6)]
    recordings = [replace(SPECS[0], name=name, chunk=64) for name in names]
    part, back = tmp_path / "torn.h5.part", tmp_path / "torn.h5"
    parts = snapshots(tmp_path / "run.h5", recordings, 64 * 8)
    for (before, count), (after, _) in itertools.pairwise(parts):
        for rest in (0, 1):
            # Every other page is new: halved is whatever HDF5 rewrote across an edge between two.
            torn = bytearray(before)
            for start in range(rest * mmap.PAGESIZE, len(before), 2 * mmap.PAGESIZE):
                torn[start : start + mmap.PAGESIZE] = after[start : start + mmap.PAGESIZE]
            torn = torn[: len(before)]
            assert before != torn != after
            part.write_bytes(torn)
            found = recover(part, back, overwrite=True).samples
            assert all(found[name] >= count for name in names), (rest, count)


def test_recovering_stops_at_damage_in_a_small_chunk(tmp_path):
    slow = [replace(spec, chunk=256) for spec in SPECS]
    part = interrupted(tmp_path / "run.h5", 20_000, recordings=slow)
    with h5py.File(part, "r") as file:
        chunk = file["entry/recordings/sweep/encoder"].id.get_chunk_info(50)
    data = bytearray(part.read_bytes())
    data[chunk.byte_offset + 5] ^= 0xFF
    part.write_bytes(data)
    assert recover(part).samples == {"sweep": 50 * 256, "holds": 0}


@given(st.floats(0.01, 1e5))
def test_a_chunk_is_about_a_second(rate):
    chunk = chunk_of(rate)
    assert chunk & (chunk - 1) == 0
    assert 32 <= chunk <= 8192
    assert chunk < 2 * max(rate, 16.01)
    assert chunk >= min(rate, 8192)


def test_recovering_does_not_overwrite(tmp_path):
    part = interrupted(tmp_path / "run.h5")
    write(tmp_path / "run.h5", size=10, overwrite=True)
    part = interrupted(tmp_path / "other.h5")
    before = (tmp_path / "run.h5").read_bytes()
    with pytest.raises(UsageError, match="exists already"):
        recover(part, tmp_path / "run.h5")
    with pytest.raises(UsageError, match="is an input"):
        recover(part, part, overwrite=True)
    assert (tmp_path / "run.h5").read_bytes() == before


def test_a_failure_while_recovering_leaves_what_was_there(tmp_path, monkeypatch):
    part = interrupted(tmp_path / "run.h5")
    before = part.read_bytes()

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(RunWriter, "finish", full)
    with pytest.raises(RigtoolError, match="disk is full"):
        recover(part)
    assert os.listdir(tmp_path) == ["run.h5.part"]
    assert part.read_bytes() == before


def test_what_cannot_be_recovered(tmp_path):
    path = write(tmp_path / "run.h5", size=10)
    with pytest.raises(RunFileError, match="is a finished run"):
        recover(path, tmp_path / "b.h5")
    with pytest.raises(UsageError, match="by -o"):
        recover(path)
    with pytest.raises(RunFileError, match="no such file"):
        recover(tmp_path / "run.h5.part", overwrite=True)
    (tmp_path / "x.h5.part").write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(500))
    with pytest.raises(RunFileError, match=r"x\.h5\.part"):
        recover(tmp_path / "x.h5.part")
    assert sorted(os.listdir(tmp_path)) == ["run.h5", "x.h5.part"]
