"""`rigtool report` as a user types it."""

import json

import pytest

from tests.cli.called import call


@pytest.fixture
def runs(make, no_figures):
    return [make("calibrate-kt"), make("measure-force")]


def test_tables_on_stdout_the_rest_on_stderr(runs, tmp_path, capsys):
    code, out, err = call(capsys, "report", *runs, "-o", tmp_path / "out")
    assert code == 0
    assert out == (tmp_path / "out" / "tables.txt").read_text()
    assert out.startswith("Table 8. ")
    wrote = "report, index.html with"
    assert err.startswith(f"Written: {tmp_path / 'out'}: {wrote}")
    assert err.count("\n") == 1


def test_json(runs, tmp_path, capsys):
    code, out, _ = call(capsys, "report", *runs, "-o", tmp_path / "out", "--json")
    document = json.loads(out)
    assert code == 0
    rows = document["tables"]["table-8-measure-force"]["rows"]
    assert rows[2]["applied_force"] == 1.0
    assert rows[2]["mean_torque"] == pytest.approx(22.4e-3, rel=1e-12)
    assert rows[2]["mean_torque_published"] == pytest.approx(22.4e-3, rel=1e-12)
    assert rows[2]["mean_torque_u"] == pytest.approx(1e-4, rel=1e-12)
    assert document["results"]["results-calibrate-kt"]["rows"][0]["result"] == "torque_constant"
    assert document["warnings"] == []


def test_quiet_prints_nothing(runs, tmp_path, capsys):
    assert call(capsys, "report", *runs, "-o", tmp_path / "out", "-q") == (0, "", "")


def test_warnings_go_to_stderr(make, no_figures, tmp_path, capsys):
    other = make("calibrate-kt", sets=("rig.name=other",))
    code, _, err = call(capsys, "report", other, make("measure-force"), "-o", tmp_path / "out")
    assert code == 0
    assert "Warning: These runs come from 2 rigs" in err


def test_bad_input_leaves_nothing(runs, tmp_path, capsys):
    out = tmp_path / "out"
    before = sorted(path.name for path in tmp_path.iterdir())
    (broken := tmp_path / "broken.h5").write_bytes(b"\x89HDF\r\n\x1a\n")
    for arguments, expected, message in (
        ((tmp_path / "no.h5",), 3, "no such file"),
        ((broken,), 3, "broken.h5"),
        ((runs[0], runs[0]), 2, "given twice"),
        ((), 2, "Missing argument"),
    ):
        code, stdout, err = call(capsys, "report", *arguments, "-o", out)
        assert (code, stdout) == (expected, "")
        assert message in err
    broken.unlink()
    assert sorted(path.name for path in tmp_path.iterdir()) == before


def test_an_existing_folder_needs_overwrite(runs, tmp_path, capsys):
    out = tmp_path / "out"
    assert call(capsys, "report", *runs, "-o", out)[0] == 0
    code, _, err = call(capsys, "report", *runs, "-o", out)
    assert code == 2
    assert "--overwrite" in err
    assert call(capsys, "report", *runs, "-o", out, "--overwrite")[0] == 0
