"""`suspension` on the virtual rig, and what stops it."""

import json
import math
from pathlib import Path

import pytest

from rigtool.runfile import open_run
from tests.cli.called import call
from tests.unchanged import require_unchanged

RECIPE = Path(__file__).parents[3] / "recipes" / "briaire-2006.toml"


def found(capsys, *arguments):
    code, out, err = call(capsys, "suspension", *arguments, "--json")
    assert code == 0, err
    return json.loads(out)["results"]


@pytest.mark.parametrize("stiffness", [14.5e3, 30e3])
def test_the_rigs_stiffness_is_within_its_uncertainty(tmp_path, capsys, stiffness):
    setting = f"virtual.eccentricity.spring_constant={stiffness}"
    for seed in range(4):
        path = tmp_path / f"{seed}.h5"
        results = found(capsys, RECIPE, "--seed", seed, "--set", setting, "-o", path)
        spring = results["spring_constant"]
        assert abs(spring["value"] - stiffness) < 3.5 * spring["u"]
        assert spring["u"] < 0.02 * stiffness
        assert results["eigenfrequency"]["value"] == pytest.approx(
            math.sqrt(spring["value"] / 1.025) / (2 * math.pi), rel=1e-9
        )
    again = found(capsys, path, "-o", tmp_path / "again.h5")
    assert again == results
    with open_run(path) as run:
        require_unchanged(f"suspension-{stiffness:g}", run)


def test_a_rig_whose_springs_are_not_described(tmp_path, capsys):
    text = RECIPE.read_text()
    start = text.index("[rig.suspension]")
    bare = text[:start] + text[text.index("[rig.arm]") :]
    (tmp_path / "rig.toml").write_text(bare)
    code, _, err = call(capsys, "suspension", tmp_path / "rig.toml", "-o", tmp_path / "a.h5")
    assert code == 3
    assert "[rig.suspension]" in err
    assert not (tmp_path / "a.h5").exists()


def test_weights_that_are_off_are_in_the_stiffness(tmp_path, capsys):
    true, off = 14.5e3, 0.02
    sets = (f"virtual.eccentricity.spring_constant={true}", "virtual.sensors.micrometer_error=1e-7")
    more = (f"virtual.misstated.weights={off}", f"rig.weights_relative_u={off}")
    options = [word for item in (*sets, *more) for word in ("--set", item)]
    results = found(capsys, RECIPE, *options, "-o", tmp_path / "a.h5")
    spring = results["spring_constant"]
    assert spring["value"] == pytest.approx(true / (1 + off), rel=2e-3)
    (line,) = (x for x in spring["budget"] if x["name"] == "weights")
    assert line["value"] == 1  # the weights as stated, over what they are
    assert line["u"] * line["sensitivity"] == pytest.approx(off * spring["value"], rel=1e-9)
    assert abs(spring["value"] - true) < 2 * spring["u"]
    eigen, deflection = results["eigenfrequency"], results["pretension_deflection"]
    relative = spring["u"] / spring["value"]
    assert eigen["u"] / eigen["value"] == pytest.approx(relative / 2, rel=1e-9)
    assert deflection["u"] / deflection["value"] == pytest.approx(relative, rel=1e-9)
    # k = 2 E b t^3 / a^3: the thickness of 0.5 mm to 0.01 mm counts three times (GUM 5.1.2)
    computed = results["spring_constant_computed"]
    # App. E prints 16.9 kN/m: it is 16.8 with the dimensions as they are printed
    assert computed["value"] == pytest.approx(16.9e3, rel=0.01)
    parts = (0.02, 0.1 / 40, 3 * 0.1 / 50, 3 * 0.01 / 0.5)
    assert computed["u"] / computed["value"] == pytest.approx(math.hypot(*parts), rel=1e-9)
