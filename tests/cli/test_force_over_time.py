"""measure-force --record and --observe, as a user types them."""

import pytest

from tests.cli.called import call
from tests.experiments.virtual_runs import RECIPE, write_kt

FIXTURES = RECIPE.parents[1] / "tests" / "fixtures"


@pytest.mark.parametrize(
    ("options", "code", "message"),
    [
        (["--record", "5", "--observe", "5"], 2, "give one of them"),
        (["--record", "0"], 2, "x>0"),
        (["--record", "-3"], 2, "x>0"),
        (["--record", "nan"], 2, "nan is not a finite number"),
        (["--record", "1e9"], 2, "time_max = 3600 s"),
        (["--record", "5", "--correction", "full"], 2, "leave it out"),
        (["--observe", "x"], 2, "not a valid number"),
        (["--record", "5", "--set", "measure_force.motion.kind=path"], 3, "time_s and angle_deg"),
        (["--record", "5", "--set", "measure_force.motion.kind=walk"], 3, "strokes"),
        (["--record", "5"], 3, "was written by calibrate-kt"),
        (["--record", "5", "--stream"], 3, "was written by calibrate-kt"),
        (["--stream"], 2, "go with --record or --observe"),
        (["--every", "3"], 2, "go with --record or --observe"),
        (["--record", "5", "--every", "3"], 2, "is for --stream and --live"),
        (["--record", "5", "--stream", "--every", "0"], 2, "x>=1"),
        (["--record", "5", "--stream", "--json"], 2, "both write to stdout"),
    ],
)
def test_bad_input_ends_with_a_message_and_without_a_file(tmp_path, capsys, options, code, message):
    kt, output = write_kt(tmp_path), tmp_path / "f.h5"
    inputs = ["--kt", kt, "--tables", kt, "-o", output]
    found, _, err = call(capsys, "measure-force", RECIPE, *inputs, *options)
    assert (found, message in err) == (code, True), err
    assert not output.exists()


def test_a_stored_run_is_not_recorded(tmp_path, capsys):
    kt = write_kt(tmp_path)
    arguments = [kt, "--kt", kt, "--tables", kt, "-o", tmp_path / "f.h5", "--record", "5"]
    code, _, err = call(capsys, "measure-force", *arguments)
    assert code == 2
    assert "leave them out" in err


@pytest.mark.parametrize(
    ("stored", "options", "message"),
    [
        ("friction", ["--correction", "full"], "correction = full changes nothing"),
        ("friction", ["--set", "measure_force.measure_angle=30"], "which has no known loads"),
        ("force", ["--set", "measure_force.motion.bandwidth_hz=5"], "which has known loads"),
        ("force", ["--live-window"], "of stored runs nothing is"),
    ],
)
def test_what_a_stored_run_has_no_use_for_is_refused(tmp_path, capsys, stored, options, message):
    kt, output = write_kt(tmp_path), tmp_path / "again.h5"
    source = FIXTURES / f"{stored}.h5"
    arguments = [source, "--kt", kt, "--tables", kt, "-o", output, *options]
    code, _, err = call(capsys, "measure-force", *arguments)
    assert (code, message in err) == (2, True), err
    assert not output.exists()
