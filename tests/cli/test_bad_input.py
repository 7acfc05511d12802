"""Every command against input that cannot be right: a message, the exit code, and no output."""

import os
import shutil
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import h5py
import numpy as np
import pytest

from rigtool.cli import main
from rigtool.errors import RecipeError
from rigtool.recipe.load import read_document

ROOT = Path(__file__).parents[2]
FIXTURES = ROOT / "tests" / "fixtures"
RECIPE = ROOT / "recipes" / "briaire-2006.toml"

COMMANDS = {
    "calibrate-kt": ("kt", []),
    "stribeck": ("friction", ["--kt", "kt.h5"]),
    "fft-ripple": ("ripple", ["--kt", "kt.h5"]),
    "identify-plant": ("plant", ["--kt", "kt.h5"]),
    "ilc-learn": ("tables", ["--kt", "kt.h5"]),
    "measure-force": ("force", ["--kt", "kt.h5", "--tables", "tables.h5"]),
}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Work beside a recipe and a calibration."""
    shutil.copy(FIXTURES / "kt.h5", tmp_path)
    shutil.copy(RECIPE, tmp_path / "rig.toml")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def refused(capsys):
    """Return a function that runs a line which must fail; it gives the code and the message."""

    def run(arguments):
        capsys.readouterr()
        with pytest.raises(SystemExit) as stop:
            main(arguments)
        out, err = capsys.readouterr()
        assert out == ""
        assert "Traceback" not in err
        assert "internal error" not in err
        assert not Path("out.h5").exists()
        return stop.value.code, err

    return run


@pytest.fixture(params=COMMANDS)
def command(request, folder, refused):
    """Return a function that runs one command on a source; it gives the code and the message."""
    fixture, inputs = COMMANDS[request.param]
    for name in {f"{fixture}.h5", *inputs[1::2]}:
        shutil.copy(FIXTURES / name, folder)

    def run(source, *more, output="out.h5"):
        return refused([request.param, str(source), *inputs, "-o", output, *more])

    run.name = request.param
    run.fixture = f"{fixture}.h5"
    return run


def test_recipe_with_four_mistakes(command, folder):
    text = (folder / "rig.toml").read_text()
    for right, wrong in {
        "encoder_counts = 4000": "encoder_counts = -4",
        "sample_time = 125e-6": 'sample_time = "fast"',
        "moves = 20": "movs = 20",
        "viscous_friction = 5.33e-5 ": "viscous_friction = -1 ",
    }.items():
        assert text.count(right) == 1
        text = text.replace(right, wrong)
    (folder / "rig.toml").write_text(text)
    code, message = command("rig.toml")
    assert code == 3
    assert "4 mistakes" in message
    for key in ("encoder_counts", "sample_time", "movs", "viscous_friction"):
        number = next(i for i, line in enumerate(text.splitlines(), 1) if line.startswith(key))
        assert f"rig.toml:{number}: " in message, key


def test_recipe_of_another_kind(command):
    code, message = command(ROOT / "pyproject.toml")
    assert (code, "not a recipe of rigtool" in message) == (3, True)


@pytest.mark.parametrize("name", ["none.toml", "none.h5"])
def test_missing_file(command, name):
    code, message = command(name)
    assert code == 3
    assert name in message


def test_file_that_is_not_hdf5(command, folder):
    (folder / "text.h5").write_text("time;torque\n0;1\n")
    code, message = command("text.h5")
    assert (code, "not an HDF5 file" in message) == (3, True)


def test_truncated_file(command, folder):
    whole = (folder / command.fixture).read_bytes()
    (folder / "cut.h5").write_bytes(whole[: len(whole) // 2])
    code, message = command("cut.h5")
    assert (code, "cut.h5" in message) == (3, True)


def test_file_of_a_newer_schema(command, folder):
    with h5py.File(folder / command.fixture, "r+") as file:
        file.attrs["schema_version"] = np.bytes_("99.0")
    code, message = command(command.fixture)
    assert code == 3
    assert "schema version 99.0" in message


def test_run_of_another_command(command, folder):
    other = "kt.h5" if command.name != "calibrate-kt" else "ripple.h5"
    shutil.copy(FIXTURES / other, folder)
    code, message = command(other)
    assert code == 3
    assert command.name in message


def test_run_without_signals(command, folder):
    # Results of a re-analysis hold no signals of their own: there is nothing to analyse in them.
    _, inputs = COMMANDS[command.name]
    with pytest.raises(SystemExit) as stop:
        main([command.name, command.fixture, *inputs, "-o", "bare.h5", "-q"])
    assert stop.value.code == 0
    code, message = command("bare.h5")
    assert code == 3
    assert "recording" in message


def test_output_that_exists_is_kept(command, folder):
    (folder / "there.h5").write_bytes(b"mine")
    code, message = command("rig.toml", output="there.h5")
    assert (code, "--overwrite" in message) == (2, True)
    assert (folder / "there.h5").read_bytes() == b"mine"


def test_a_run_is_not_named_as_a_recipe(folder, refused):
    code, message = refused(["calibrate-kt", "rig.toml", "-o", "kt.toml"])
    assert code == 2
    assert "kt.toml: .toml is for recipes" in message
    assert not Path("kt.toml").exists()


@pytest.mark.parametrize("output", ["nowhere/out.h5", "kt.h5/out.h5"])
def test_output_folder_that_cannot_be_written(command, output):
    code, message = command("rig.toml", output=output)
    assert code == 2
    assert "folder" in message


def test_a_run_against_itself(folder, refused):
    for name in ("friction.h5", "kt.h5"):
        shutil.copy(FIXTURES / name, folder)
    line = "stribeck friction.h5 --kt kt.h5 --against friction.h5 -o out.h5"
    code, message = refused(line.split())
    assert (code, "one run is given twice" in message) == (2, True)


def test_unknown_setting(command):
    code, message = command("rig.toml", "--set", "rig.colour=red")
    assert code == 3
    assert "rig.colour" in message


@pytest.mark.parametrize(
    ("setting", "reason"),
    [
        ("rig.name=another", "briaire-2006"),
        ("rig.encoder_counts=2000", "encoder"),
        ("rig.attachment=pulley", "instrument"),
    ],
)
def test_tables_learned_elsewhere(folder, refused, setting, reason):
    shutil.copy(FIXTURES / "tables.h5", folder)
    line = ["measure-force", "rig.toml", "--kt", "kt.h5", "--tables", "tables.h5"]
    code, message = refused([*line, "-o", "out.h5", "--set", setting])
    assert code == 3
    assert reason in message


def test_full_disk(folder, refused):
    resource = pytest.importorskip("resource")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, hard))
    try:
        code, message = refused(["calibrate-kt", "rig.toml", "-o", "out.h5"])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert code == 1
    assert "out.h5" in message


def test_a_run_too_short_for_its_analysis(command, folder):
    """A thousand samples of each recording, in a file that is otherwise sound."""
    from rigtool.runfile import RunWriter, open_run

    with open_run(command.fixture) as run:
        specs = [
            _shortened(recording) for recording in run.recordings.values() if recording.size > 0
        ]
        with RunWriter(
            "short.h5",
            command=run.command,
            recipe=run.recipe,
            recipe_text="",
            recordings=[spec for spec, _ in specs],
        ) as writer:
            for spec, block in specs:
                writer.append(spec.name, block)
            writer.finish({}, {})
    code, message = command("short.h5")
    assert code == 4, message
    assert len(message) > 20


def _shortened(recording):
    from rigtool.runfile import RecordingSpec

    conditions = {name: (q.value, q.unit) for name, q in recording.conditions.items()}
    spec = RecordingSpec(recording.name, recording.channels, conditions)
    count = min(100, recording.size)
    return spec, {name: recording.read(name, 0, count) for name in recording.units}


def test_nan_in_a_signal(command, folder):
    from rigtool.runfile import RunWriter, open_run

    with open_run(command.fixture) as run:
        specs = []
        for recording in run.recordings.values():
            spec, _ = _shortened(recording)
            block = {name: recording.read(name) for name in recording.units}
            block["current_setpoint"][len(block["time"]) // 2] = np.nan
            specs.append((spec, block))
        with RunWriter(
            "nan.h5",
            command=run.command,
            recipe=run.recipe,
            recipe_text="",
            recordings=[spec for spec, _ in specs],
        ) as writer:
            for spec, block in specs:
                writer.append(spec.name, block)
            writer.finish({}, {})
    code, message = command("nan.h5")
    assert code == 3, message
    assert "current_setpoint" in message


def test_a_controller_faster_than_the_loop_is_a_bad_recipe(tmp_path, capsys):
    recipe = Path(__file__).parents[2] / "recipes" / "briaire-2006.toml"
    line = ["calibrate-kt", str(recipe), "--set", "rig.sample_time=0.005", "-o"]
    with pytest.raises(SystemExit) as caught:
        main([*line, str(tmp_path / "a.h5")])
    code, err = caught.value.code, capsys.readouterr().err
    assert code == 3
    assert "half the sampling rate" in err
    assert not list(tmp_path.iterdir())


PATHS = {
    "too long": lambda folder: "a/" * 2100,
    "long name": lambda folder: "a" * 300,
    "NUL": lambda folder: "a\0b",
    "below a file": lambda folder: "rig.toml/x",
    "circle": lambda folder: _link(folder / "circle", folder / "circle"),
    "pipe": lambda folder: os.mkfifo(folder / "pipe") or "pipe",
    "device": lambda folder: "/dev/zero",
    "folder": lambda folder: folder,
    "cannot be read": lambda folder: _link(folder / "memory", Path("/proc/self/mem")),
}


def _link(path, target):
    path.symlink_to(target)
    return path


@pytest.mark.parametrize("kind", PATHS)
def test_paths_of_every_kind_are_refused(kind, folder, refused):
    """One place opens inputs: no pipe is waited for, and each refusal has the same exit code."""
    path = str(PATHS[kind](folder))
    lines = [["info", path], ["recover", path, "-o", "out.h5"]]
    if kind != "pipe":
        lines.append(["import", "rig.toml", "--map", path, "-o", "out.h5"])
    for line in lines:
        code, message = refused(line)
        assert code == (2 if kind == "NUL" else 3)
        assert message.count(": ") >= 2  # what was given, what is wrong, what helps
        assert kind not in ("pipe", "device") or "a device or a pipe" in message
    if kind not in ("folder", "NUL"):
        assert refused(["import", path, "-o", "out.h5"])[0] == 3
    with pytest.raises(RecipeError):
        read_document(path, "recipe", "recipes/", pipe=False)


@pytest.fixture
def pipe():
    """Return what gives the name of a pipe that holds a text, as `<(...)` of a shell does."""
    ends = []

    def holding(text):
        reader, writer = os.pipe()
        ends.append(reader)
        os.write(writer, text.encode())
        os.close(writer)
        return f"/dev/fd/{reader}"

    yield holding
    for end in ends:
        os.close(end)


def test_recipes_and_mappings_come_through_pipes(folder, pipe, refused):
    dry = ["calibrate-kt", pipe(RECIPE.read_text("utf-8")), "--dry-run", "-o", "out.h5"]
    with pytest.raises(SystemExit, match="0"):
        main(dry)
    Path("i.csv").write_text("time,current\n" + "".join(f"{n},{n}\n" for n in range(9)))
    mapping = (
        'mapping = 1\n[rig]\nname = "x"\n[signals.time]\ncolumn = "time"\nunit = "s"\n'
        '[signals.current]\ncolumn = "current"\nunit = "A"\n'
    )
    with pytest.raises(SystemExit, match="0"):
        main(["import", "i.csv", "--map", pipe(mapping), "-o", "imported.h5"])
    assert Path("imported.h5").exists()
    code, message = refused(["calibrate-kt", pipe("x = 1\n" * 9000), "-o", "again.h5"])
    assert (code, "Cannot overwrite a value" in message) == (3, True)
    assert not Path("again.h5").exists()


def test_a_pipe_that_never_ends_is_refused(folder, refused):
    reader, writer = os.pipe()
    with ThreadPoolExecutor(1) as worker:
        writing = worker.submit(_write_for_ever, writer)
        code, message = refused(["calibrate-kt", f"/dev/fd/{reader}", "-o", "out.h5"])
        os.close(reader)
        with pytest.raises(BrokenPipeError):
            writing.result()
    os.close(writer)
    assert (code, "is larger than 262144 bytes" in message) == (3, True)


def _write_for_ever(end):
    while True:
        os.write(end, b"# nothing\n" * 1000)


@pytest.mark.parametrize("output", ["", ".", "/", "a" * 300, "a/" * 2100])
def test_outputs_that_are_no_file(output, folder, refused):
    for line in (["calibrate-kt", "kt.h5"], ["report", "kt.h5"], ["import", "rig.toml"]):
        code, _ = refused([*line, "-o", output])
        assert code in (2, 3)
