"""On stored runs only settings of the analysis may change; all others are refused by name."""

import shutil
from pathlib import Path

import pytest

from rigtool.cli import main

KT = Path(__file__).parents[2] / "fixtures" / "kt.h5"


def exit_code(tmp_path, *options: str) -> int:
    path = shutil.copy(KT, tmp_path / "kt.h5")
    with pytest.raises(SystemExit) as caught:
        main(["calibrate-kt", str(path), *options, "-o", str(tmp_path / "again.h5")])
    return caught.value.code or 0


@pytest.mark.parametrize(
    "options",
    [
        ("--seed", "5"),
        ("--set", "rig.name=other"),
        ("--set", "rig.attachment=instrument"),
        ("--set", "measure_force.cycles=20"),
        ("--set", "calibrate_kt.record_every=7"),
        ("--set", "virtual.seed=7"),
    ],
)
def test_what_was_recorded_stays(tmp_path, capsys, options):
    assert exit_code(tmp_path, *options) == 2
    message = capsys.readouterr().err
    assert " ".join(options) in message
    assert "stored run" in message
    assert not (tmp_path / "again.h5").exists()


def test_a_setting_of_the_analysis_may_change(tmp_path):
    assert exit_code(tmp_path, "--set", "calibrate_kt.settle_time=0.2") == 0
