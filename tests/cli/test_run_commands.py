"""recover, verify, diff and export, as a user types them."""

import os

import pytest

from rigtool.runfile import RunWriter
from tests.cli.called import call
from tests.runfile.whole_run import SPECS, samples, write


def interrupted(path):
    def stop():
        with RunWriter(path, command="x", recordings=SPECS) as out:
            out.append("sweep", samples(123)["sweep"])
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stop()


def test_recover(tmp_path, capsys):
    interrupted(tmp_path / "a.h5")
    code, out, err = call(capsys, "recover", tmp_path / "a.h5.part")
    assert code == 0
    assert out == "sweep: 123 samples\nholds: 0 samples\n"
    assert f"Written: {tmp_path / 'a.h5'}" in err
    assert call(capsys, "recover", tmp_path / "a.h5.part")[0] == 2
    assert call(capsys, "recover", tmp_path / "a.h5.part", "--overwrite")[0] == 0
    assert call(capsys, "recover", tmp_path / "a.h5", "-o", tmp_path / "b.h5")[0] == 3
    assert sorted(os.listdir(tmp_path)) == ["a.h5", "a.h5.part"]


def test_what_is_left_of_a_run_is_named(tmp_path, capsys):
    interrupted(path := tmp_path / "a.h5")
    remedy = f"`rigtool recover {path}.part` brings back its signals"
    for words in (("recover",), ("recover", "-o", tmp_path / "b.h5"), ("info",)):
        code, _, err = call(capsys, *words, path)
        assert (code, remedy in err) == (3, True), err
    code, _, err = call(capsys, "recover", tmp_path / "no.h5")
    assert (code, "no.h5: no such file" in err) == (3, True), err
    assert os.listdir(tmp_path) == ["a.h5.part"]


def test_verify(tmp_path, capsys):
    raw = write(tmp_path / "raw.h5", size=100)
    last = write(tmp_path / "last.h5", inputs=(raw,), recordings=())
    code, out, err = call(capsys, "verify", last)
    assert (code, err) == (0, "")
    assert out == f"{last}: ok: stribeck\n  {raw}: ok: stribeck\n"
    raw.write_bytes(b"")
    code, out, err = call(capsys, "verify", last)
    assert code == 3
    assert f"  {raw}: BROKEN: is empty" in out
    assert f"broken: {raw}" in err


def test_diff(tmp_path, capsys):
    a, b = write(tmp_path / "a.h5", size=100), write(tmp_path / "b.h5", size=101)
    assert call(capsys, "diff", a, a) == (0, "", "no difference\n")
    code, out, err = call(capsys, "diff", a, b)
    assert (code, err) == (1, "")
    assert out.splitlines()[0] == "recordings/sweep: 100 samples | 101"
    assert call(capsys, "diff", a, tmp_path / "c.h5")[0] == 3
    assert call(capsys, "diff", a, b, "--rtol", "-1")[0] == 2
    for number in ("nan", "inf"):
        code, out, err = call(capsys, "diff", a, b, "--rtol", number)
        assert (code, out) == (2, "")
        assert f"{number} is not a finite number" in err


def test_export(tmp_path, capsys):
    path = write(tmp_path / "a.h5", size=100)
    csv = tmp_path / "a.csv"
    assert call(capsys, "export", path, "--part", "holds", "-o", csv, "-q") == (0, "", "")
    assert csv.read_text().splitlines()[0] == "time [s],torque [N m]"
    assert len(csv.read_text().splitlines()) == 101
    assert call(capsys, "export", path, "--part", "holds", "-o", csv)[0] == 2
    assert call(capsys, "export", path, "-o", tmp_path / "a.parquet")[0] == 2
    parquet = tmp_path / "holds.parquet"
    wrote = f"Written: {parquet}: holds of {path}\n"
    assert call(capsys, "export", path, "--part", "holds", "-o", parquet) == (0, "", wrote)
    assert call(capsys, "export", path, "-o", tmp_path / "a.xlsx")[0] == 2
