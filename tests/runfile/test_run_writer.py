"""What happens to the output when things go wrong while it is written."""

import os
import resource
import signal
import subprocess
import sys
import textwrap
import threading
from pathlib import Path
from unittest.mock import Mock

import h5py
import numpy as np
import pytest

from rigtool.errors import InsufficientDataError, RigtoolError, UsageError
from rigtool.interrupts import Terminated, handled
from rigtool.quantity import Quantity
from rigtool.runfile import RunWriter, open_run, outputs, tree
from rigtool.runfile.outputs import own_name, require_output
from rigtool.runfile.recovery import recover
from tests.runfile.whole_run import SPECS, samples, write
from tests.thorough import thorough


def writer(path: Path, **options) -> RunWriter:
    arguments = {"command": "stribeck", "recipe": None, "recipe_text": None}
    return RunWriter(path, **(arguments | {"recordings": SPECS} | options))


def test_an_existing_output_is_refused_before_anything_happens(tmp_path):
    path = write(tmp_path / "run.h5", size=10)
    before = path.read_bytes()
    with pytest.raises(UsageError, match="--overwrite"):
        writer(path)
    assert path.read_bytes() == before
    assert os.listdir(tmp_path) == ["run.h5"]


def test_overwrite_replaces_it(tmp_path):
    path = write(tmp_path / "run.h5", size=10)
    with writer(path, recordings=(), overwrite=True) as out:
        out.finish({"answer": Quantity(42.0, "1", 1.0)}, {})
    with open_run(path) as run:
        assert list(run.results) == ["answer"]
    assert os.listdir(tmp_path) == ["run.h5"]


def test_a_failure_leaves_the_earlier_output_alone(tmp_path):
    path = write(tmp_path / "run.h5", size=10)
    before = path.read_bytes()
    with pytest.raises(ZeroDivisionError), writer(path, overwrite=True):
        raise ZeroDivisionError
    assert path.read_bytes() == before
    assert os.listdir(tmp_path) == ["run.h5"]


def test_an_earlier_output_that_a_viewer_holds_is_not_touched(tmp_path):
    path = write(tmp_path / "run.h5", size=10)
    with h5py.File(path, "r") as viewer:
        write(path, size=20, overwrite=True)
        assert viewer["entry/recordings/sweep/time"].shape == (10,)
    with open_run(path) as run:
        assert run.recording("sweep").size == 20


def test_failing_before_the_first_sample_leaves_nothing(tmp_path):
    with pytest.raises(ValueError, match="away"), writer(tmp_path / "run.h5"):
        raise ValueError("away")
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("after", ["append", "recording", "recorded"])
def test_failing_later_keeps_every_sample_and_says_so(tmp_path, after):
    path = tmp_path / "run.h5"
    signals = samples(10_000)

    def fail() -> None:
        with writer(path) as out:
            out.append("sweep", signals["sweep"])
            if after != "append":
                getattr(out, after)(*(["sweep"] if after == "recording" else []))
            raise InsufficientDataError("the sweep does not carry it")

    with pytest.raises(InsufficientDataError) as caught:
        fail()
    assert os.listdir(tmp_path) == ["run.h5.part"]
    note = "\n".join(caught.value.__notes__)
    assert "10000 samples" in note
    assert f"rigtool recover {path}.part" in note
    with h5py.File(f"{path}.part", "r") as file:
        for name, values in signals["sweep"].items():
            np.testing.assert_array_equal(file[f"entry/recordings/sweep/{name}"], values)


@pytest.mark.parametrize("by", ["recording", "recorded"])
@pytest.mark.parametrize("channel", range(4))
@pytest.mark.parametrize("how", ["signal", "error"])
def test_what_interrupts_the_last_chunk_costs_no_sample(tmp_path, monkeypatch, by, channel, how):
    path, signals = tmp_path / "run.h5", samples(10_000)["sweep"]
    real, written = tree.write_samples, []

    def interrupted(file, name, start, values):
        written.append(name)
        if len(written) == channel + 1:
            if how == "error":
                raise MemoryError
            signal.raise_signal(signal.SIGTERM)
        real(file, name, start, values)

    def record() -> None:
        with handled(), writer(path, recordings=SPECS[:1]) as out:
            out.append("sweep", signals)
            monkeypatch.setattr(tree, "write_samples", interrupted)
            getattr(out, by)(*(["sweep"] if by == "recording" else []))

    with pytest.raises(Terminated if how == "signal" else MemoryError):
        record()
    monkeypatch.undo()
    assert recover(f"{path}.part").samples == {"sweep": 10_000}
    with open_run(path) as run:
        for name, values in signals.items():
            np.testing.assert_array_equal(run.recording("sweep").read_stored(name), values)


def test_a_part_of_an_earlier_run_is_not_lost(tmp_path):
    path = tmp_path / "run.h5"
    part = tmp_path / "run.h5.part"
    part.write_bytes(b"\x89HDF\r\n\x1a\n of a rig that was taken apart")
    with pytest.raises(UsageError, match="recover"):
        writer(path)
    assert part.exists()
    write(path, size=10, overwrite=True)
    assert os.listdir(tmp_path) == ["run.h5"]


@pytest.mark.parametrize("overwrite", [False, True])
def test_somebody_elses_files_beside_the_output_stay(tmp_path, overwrite):
    path, secret = tmp_path / "run.h5", tmp_path / "secret"
    secret.write_text("keep")
    (tmp_path / "run.h5.tmp").symlink_to(secret)
    write(path, size=10)
    assert secret.read_text() == "keep"
    assert (tmp_path / "run.h5.tmp").is_symlink()
    part = tmp_path / "run.h5.part"
    part.write_text("of a browser")
    with pytest.raises(UsageError):
        writer(path, overwrite=overwrite)
    part.unlink()
    part.symlink_to(secret)
    with pytest.raises(UsageError):
        writer(path, overwrite=overwrite)
    assert secret.read_text() == "keep"


def test_a_device_is_no_output():
    with pytest.raises(UsageError, match="device"):
        writer(Path("/dev/null"), overwrite=True)


def test_a_link_to_an_output_stays_a_link(tmp_path):
    path, link = tmp_path / "run.h5", tmp_path / "latest.h5"
    write(path, size=10)
    link.symlink_to(path)
    write(link, size=20, overwrite=True)
    assert link.is_symlink()
    with open_run(path) as run:
        assert run.recording("sweep").size == 20


def test_what_a_killed_process_left_is_removed_and_nothing_else(tmp_path, monkeypatch):
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    ours = own_name(tmp_path).name
    left = tmp_path / ours.replace(f"-{os.getpid()}-", f"-{gone.pid}-")
    left.touch()
    alive = tmp_path / ours
    alive.touch()
    other = tmp_path / ".rigtool-notes"
    other.touch()
    # In a container, on a disk of both, that process may run: its name shows it.
    here = outputs._computer()
    monkeypatch.setattr(os, "readlink", lambda path: "pid:[4026532000]")
    elsewhere = tmp_path / left.name.replace(here, outputs._computer())
    elsewhere.touch()
    monkeypatch.undo()
    write(tmp_path / "run.h5", size=10)
    stay = [alive.name, other.name, elsewhere.name, "run.h5"]
    assert sorted(os.listdir(tmp_path)) == sorted(stay)


def test_a_signal_at_any_moment_keeps_every_sample_that_was_appended(tmp_path):
    """Whole blocks survive, as a prefix of what was appended, wherever the signal falls."""
    random = np.random.default_rng(5)
    block = samples(3000)["sweep"]
    for attempt in range(20):
        path = tmp_path / f"{attempt}.h5"
        blocks = []
        timer = threading.Timer(random.uniform(0, 0.06), os.kill, (os.getpid(), signal.SIGINT))

        def record(path: Path, blocks: list[int], timer: threading.Timer) -> None:
            with handled(), writer(path) as out:
                timer.start()
                while True:
                    out.append("sweep", block)
                    blocks.append(1)

        with pytest.raises(KeyboardInterrupt):
            record(path, blocks, timer)
        timer.join()
        appended = len(blocks)
        part = path.with_name(path.name + ".part")
        if not part.exists():
            assert appended <= 1
            continue
        recover(part)
        with open_run(path) as run:
            assert run.recording("sweep").size in (3000 * appended, 3000 * (appended + 1))
            stored = run.recording("sweep").read("time")
        assert np.array_equal(stored, np.resize(block["time"], stored.size))


def test_results_that_cannot_be_stored_leave_the_samples(tmp_path):
    path = tmp_path / "run.h5"
    with writer(path) as out:
        out.append("sweep", samples(100)["sweep"])
        with pytest.raises(ValueError, match="letters"):
            out.finish({"a name with spaces": Quantity(1.0, "1", 1.0)}, {})
        assert sorted(os.listdir(tmp_path)) == ["run.h5.part"]
        out.finish({"a_name_without": Quantity(1.0, "1", 1.0)}, {})
    with open_run(path) as run:
        np.testing.assert_array_equal(
            run.recording("sweep").read("time"), samples(100)["sweep"]["time"]
        )


def test_leaving_without_finish_is_a_mistake(tmp_path):
    with pytest.raises(RuntimeError, match="finish"), writer(tmp_path / "run.h5"):
        pass


def test_two_writers_of_one_output_do_not_mix(tmp_path):
    path = tmp_path / "run.h5"
    with writer(path) as first:
        first.append("sweep", samples(50)["sweep"])
        for overwrite in (False, True):
            with pytest.raises(UsageError, match="being written"):
                writer(path, overwrite=overwrite)
        first.recorded()  # what is analysed is not given up either
        with pytest.raises(UsageError, match="being written"):
            writer(path, overwrite=True)
        first.finish({}, {})
    assert os.listdir(tmp_path) == ["run.h5"]
    with open_run(path) as run:
        assert run.recording("sweep").size == 50


@pytest.mark.parametrize("links", [True, False])
@pytest.mark.parametrize("seen", [True, False])
def test_of_two_writers_that_begin_at_one_moment_one_goes_on(tmp_path, monkeypatch, seen, links):
    path = tmp_path / "run.h5"
    if not links:  # as on some file systems
        monkeypatch.setattr(os, "link", Mock(side_effect=PermissionError(1, "no links")))
    first, second = writer(path, overwrite=True), writer(path, overwrite=True)
    if not seen:  # the other one has looked before this one took the name
        monkeypatch.setattr("rigtool.runfile.storage.require_unlocked", lambda part, remove: None)
    with first:
        first.append("sweep", samples(50)["sweep"])
        with pytest.raises(UsageError, match="being written"):
            second.__enter__()
        first.finish({}, {})
    assert os.listdir(tmp_path) == ["run.h5"]
    with open_run(path) as run:
        assert run.recording("sweep").size == 50


def test_a_part_that_another_program_replaced_is_not_taken_for_ones_own(tmp_path):
    path = tmp_path / "run.h5"

    def replaced() -> None:
        with writer(path) as out:
            out.append("sweep", samples(50)["sweep"])
            out.part.unlink()
            out.part.touch()
            out.finish({}, {})

    with pytest.raises(RigtoolError, match="another program") as caught:
        replaced()
    assert "50 samples that were recorded are lost" in caught.value.__notes__[0]


@pytest.mark.parametrize(
    ("place", "message"),
    [("nowhere/run.h5", "does not exist"), ("folder", "is a folder"), ("file/run.h5", "is a file")],
)
def test_a_place_that_cannot_be_written(tmp_path, place, message):
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").touch()
    with pytest.raises(UsageError, match=message):
        writer(tmp_path / place)


def test_an_input_is_not_overwritten(tmp_path):
    path = write(tmp_path / "run.h5", size=10)
    with open_run(path) as run, pytest.raises(UsageError, match="another name"):
        writer(path, inputs=[run], overwrite=True)


def test_a_folder_that_refuses_ends_with_a_message(tmp_path, monkeypatch):
    # Root may write everywhere, so the refusal is staged.
    def refuse(*arguments: object, **options: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "open", refuse)
    with pytest.raises(RigtoolError, match="Permission denied"), writer(tmp_path / "run.h5"):
        pass
    monkeypatch.undo()
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize(
    ("block", "message"),
    [
        ({"time": np.zeros(3)}, "has channels"),
        ({"time": np.zeros(3), "torque": np.zeros(2)}, "differ in shape"),
        ({"time": np.zeros((3, 1)), "torque": np.zeros((3, 1))}, "differ in shape"),
        ({"time": np.zeros(3), "torque": np.zeros(3), "more": np.zeros(3)}, "has channels"),
    ],
)
def test_a_block_that_does_not_fit(tmp_path, block, message):
    with pytest.raises(ValueError, match=message), writer(tmp_path / "run.h5") as out:
        out.append("holds", block)


def test_a_number_that_its_type_cannot_hold(tmp_path):
    block = samples(3)["sweep"] | {"encoder": np.array([0.0, np.nan, 1.0])}
    with pytest.raises(RigtoolError, match="encoder"), writer(tmp_path / "run.h5") as out:
        out.append("sweep", block)


def test_a_recording_that_was_read_back_is_complete(tmp_path):
    with writer(tmp_path / "run.h5") as out:
        out.append("holds", samples(10)["holds"])
        assert out.recording("holds").size == 10
        with pytest.raises(RuntimeError, match="grow"):
            out.append("holds", samples(10)["holds"])
        out.finish({}, {})


FILL = textwrap.dedent(
    """
    import resource, sys
    from pathlib import Path
    from rigtool.errors import RigtoolError
    from tests.runfile.test_run_writer import writer
    from tests.runfile.whole_run import RESULTS, TABLES, samples

    limit = int(sys.argv[2])
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
    try:
        with writer(Path(sys.argv[1]), overwrite=True) as out:
            for _ in range(20):
                for name, block in samples(5000).items():
                    out.append(name, block)
            out.finish(RESULTS, TABLES)
    except RigtoolError as error:
        print(error, *getattr(error, "__notes__", ()))
    """
)


@pytest.mark.parametrize("limit", [100, 600_000, 1_000_000, *thorough(3000, 300_000, 800_000)])
def test_a_full_disk(tmp_path, limit):
    path = tmp_path / "run.h5"
    path.write_bytes(b"the earlier output")
    found = subprocess.run(
        [sys.executable, "-c", FILL, str(path), str(limit)],
        capture_output=True,
        text=True,
        cwd=Path(__file__).parents[2],
    )
    assert (found.returncode, found.stderr) == (0, "")
    assert "the disk is full" in found.stdout
    assert path.read_bytes() == b"the earlier output"
    left = set(os.listdir(tmp_path)) - {"run.h5"}
    assert left == ({"run.h5.part"} if "are kept" in found.stdout else set())
    if left:
        with h5py.File(f"{path}.part", "r") as file:
            group = file["entry/recordings"]
            total = sum(group[name]["time"].shape[0] for name in group)
            assert f"{total} samples" in found.stdout
            for name in group:
                assert np.isfinite(group[name]["time"][:]).all()
    if limit >= 600_000:
        assert left, "there was room for some samples"


def test_a_disk_with_just_enough_room(tmp_path):
    # The limit of the test above is not always hit, or it would prove nothing.
    path = tmp_path / "run.h5"
    done = subprocess.run(
        [sys.executable, "-c", FILL, str(path), str(10_000_000)],
        capture_output=True,
        text=True,
        cwd=Path(__file__).parents[2],
    )
    assert (done.returncode, done.stdout) == (0, "")
    assert resource.getrlimit(resource.RLIMIT_FSIZE)[0] == resource.RLIM_INFINITY
    assert 800_000 < path.stat().st_size < 10_000_000


def test_a_name_that_ends_in_a_slash_is_that_of_a_folder():
    with pytest.raises(UsageError, match="new/: is a folder"):
        require_output("new/", overwrite=True)


@pytest.mark.parametrize("name", ["loop", "d/" * 2100 + "x.h5"])
def test_an_output_that_leads_nowhere(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    Path("loop").symlink_to("loop")
    with pytest.raises(UsageError, match=r"leads to itself|name too long"):
        require_output(name, overwrite=True)
    assert Path("loop").is_symlink()


def test_an_output_in_a_folder_that_was_removed(tmp_path, monkeypatch):
    folder = tmp_path / "gone"
    folder.mkdir()
    monkeypatch.chdir(folder)
    folder.rmdir()
    with pytest.raises(UsageError, match="choose another folder"):
        require_output("run.h5", overwrite=False)
