"""The stored runs analysed again, with the commands as a user types them."""

import json
import math
from pathlib import Path

import pytest

from rigtool.runfile import open_run
from tests.cli.called import call

FIXTURES = Path(__file__).parent / "fixtures"
REFERENCES = json.loads((FIXTURES / "references.json").read_text())

COMMANDS = {
    "kt": ["calibrate-kt"],
    "friction": ["stribeck", "--kt", "kt.h5"],
    "ripple": ["fft-ripple", "--kt", "kt.h5"],
    "plant": ["identify-plant", "--kt", "kt.h5"],
    "tables": ["ilc-learn", "--kt", "kt.h5"],
    "turning": ["ilc-learn", "--kt", "kt.h5"],
    "force": ["measure-force", "--kt", "kt.h5", "--tables", "tables.h5"],
}


@pytest.fixture(params=COMMANDS)
def analysed(request, tmp_path, monkeypatch, capsys):
    """Run the command of a fixture on it; return the fixture's name, the JSON it printed, and the
    results that it stored."""
    command, *inputs = COMMANDS[request.param]
    output = tmp_path / "again.h5"
    monkeypatch.chdir(FIXTURES)
    line = [command, f"{request.param}.h5", *inputs, "-o", output, "--json"]
    code, out, err = call(capsys, *line)
    assert code == 0, err
    assert output.exists()
    with open_run(output) as stored:
        return request.param, json.loads(out), stored.results


def test_results_are_those_stored_beside_the_fixture(analysed):
    name, printed, stored = analysed
    for result, quantity in stored.items():
        total = math.hypot(*(line.contribution for line in quantity.budget))
        assert math.isclose(total, quantity.u or 0.0, rel_tol=1e-9), f"budget of {result}"
    expected = REFERENCES[name]
    assert set(printed["results"]) == set(expected)
    for result, reference in expected.items():
        found = printed["results"][result]
        assert found["unit"] == reference["unit"], result
        for part in ("value", "u"):
            if reference[part] is None:
                assert found[part] is None, result
                continue
            # The same signals through the same mathematics: what may differ is rounding in
            # another processor's vector units, far below the uncertainty of the result.
            slack = 0.01 * (reference["u"] or 0.0)
            assert math.isclose(found[part], reference[part], rel_tol=1e-6, abs_tol=slack), (
                f"{result}.{part}: {found[part]} against {reference[part]}"
            )


def test_fixtures_are_small():
    files = list(FIXTURES.glob("*.h5"))
    assert {file.stem for file in files} == set(COMMANDS)
    assert sum(file.stat().st_size for file in files) < 8e6
