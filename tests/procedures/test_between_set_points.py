"""What is said of current that flows between the samples of a drive."""

import json
from types import SimpleNamespace

import pytest
from virtual_runs import RECIPE, run

from rigtool.procedures import fft_ripple
from rigtool.procedures.between_set_points import remark

KT = RECIPE.parents[1] / "tests" / "fixtures" / "kt.h5"


def line(*found):
    """Return a run whose rig looked at these (speed rad/s, lacking current A, its u A)."""
    names = ("speed", "lacking_current", "u")
    told = [dict(zip(names, item, strict=True)) | {"readings": 20} for item in found]
    return SimpleNamespace(provenance={"line": json.dumps({"between_set_points": told})})


def test_the_largest_difference_is_told_with_its_torque():
    (text,) = remark([line((3.0, 2e-3, 1e-4)), line((12.0, -8e-3, 1e-4))], 0.05)
    assert "up to -8 mA" in text
    assert "0.4 mN m, at 12 rad/s" in text
    assert "sample_time shorter" in text


@pytest.mark.parametrize("found", [(), [(3.0, 2e-4, 1e-4)]])
def test_nothing_is_said_of_what_is_not_seen(found):
    assert remark([line(*found), SimpleNamespace(provenance={"line": None})], 0.05) == ()


def test_ripple_says_it(tmp_path, monkeypatch):
    said = "current between set points differs"
    monkeypatch.setattr(fft_ripple, "remark", lambda runs, constant: (f"{said}: {constant:.3g}",))
    sets = ("fft_ripple.speeds=[30]", "fft_ripple.revolutions=3", "fft_ripple.torques=[]")
    more = ("fft_ripple.power_cycles=0",)
    notes = run(fft_ripple, RECIPE, tmp_path / "ripple.h5", *sets, *more, kt=KT).notes
    (note,) = [note for note in notes if said in note]
    assert float(note.rpartition(" ")[2]) == pytest.approx(0.0455, rel=0.03)
