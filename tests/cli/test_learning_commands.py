"""`ilc-learn` and `fft-ripple` as a user types them, where they refuse."""

from pathlib import Path

import pytest

from rigtool.cli import main
from rigtool.quantity import Quantity
from rigtool.runfile import RunWriter

RECIPE = str(Path(__file__).parents[2] / "recipes" / "briaire-2006.toml")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    found = tmp_path_factory.mktemp("commands")
    constant = {
        "torque_constant_mean": Quantity(0.0454, "N m/A", 1e-5),
        "amplifier_gain": Quantity(1.0, "1", 0.0),
    }
    for name, command in (("kt", "calibrate-kt"), ("other", "stribeck")):
        path = found / f"{name}.h5"
        with RunWriter(path, command=command) as writer:
            writer.finish(constant, {})
    return found


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["ilc-learn", RECIPE], 2, "--kt"),
        (["fft-ripple", RECIPE], 2, "--kt"),
        (["ilc-learn", RECIPE, "--kt", "kt.h5", "--implementation", "A"], 2, "give --friction"),
        (["ilc-learn", RECIPE, "--kt", "other.h5"], 3, "was written by stribeck"),
        (["ilc-learn", RECIPE, "--kt", "kt.h5", "--learning-filter", "frf"], 2, "give --plant"),
        (["ilc-learn", RECIPE, "--kt", "kt.h5", "--plant", "kt.h5"], 3, "calibrate-kt"),
        (["identify-plant", RECIPE, "--kt", "other.h5"], 3, "was written by stribeck"),
        (["fft-ripple", RECIPE, "--kt", "other.h5"], 3, "was written by stribeck"),
        (["fft-ripple", "kt.h5", "--kt", "kt.h5"], 3, "was written by calibrate-kt"),
        (
            ["ilc-learn", RECIPE, "--kt", "kt.h5", "--set", "ilc_learn.cancel_radius=0.5"],
            4,
            "must be below 1 at all frequencies",
        ),
    ],
)
def test_refusals(folder, monkeypatch, capsys, arguments, code, message):
    monkeypatch.chdir(folder)
    with pytest.raises(SystemExit) as caught:
        main([*arguments, "-o", "out.h5"])
    out, err = capsys.readouterr()
    assert caught.value.code == code, err
    assert message in err
    assert "Traceback" not in err
    assert out == ""
    assert {path.name for path in folder.iterdir()} == {"kt.h5", "other.h5"}
