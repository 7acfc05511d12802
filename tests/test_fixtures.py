"""The stored runs analysed again, with the commands as a user types them."""

import json
import math

import pytest

from rigtool.runfile import open_run
from tests.cli.called import call
from tests.fixtures.make import AGAIN, HERE, RESULTS, STEPS, TABLES, digests
from tests.fixtures.make import line as command_line

REFERENCES = json.loads(RESULTS.read_text())
COLUMNS = json.loads(TABLES.read_text())
ROUNDING = 1e-4
"""Part of the rms of a column by which it may differ on another processor."""
ZERO = 1e-15
"""What rounding leaves of a column that is zero, in any unit."""


@pytest.fixture(params=AGAIN)
def analysed(request, tmp_path, monkeypatch, capsys):
    """Run a command on stored signals; return its name, the JSON it printed, the results that it
    stored, and digests of the columns of its tables."""
    output = tmp_path / "again.h5"
    monkeypatch.chdir(HERE)
    line = [*command_line(request.param, tmp_path), "-o", output, "--json"]
    code, out, err = call(capsys, *line)
    assert code == 0, err
    assert output.exists()
    with open_run(output) as stored:
        found = digests(request.param, stored.tables)
        return request.param, json.loads(out), stored.results, found


def test_results_are_those_stored_beside_the_fixture(analysed):
    name, printed, stored, columns = analysed
    for result, quantity in stored.items():
        total = math.hypot(*(line.contribution for line in quantity.budget))
        if name.startswith("imported") and not quantity.budget:
            continue
        assert math.isclose(total, quantity.u or 0.0, rel_tol=1e-9), f"budget of {result}"
    expected = REFERENCES[name]
    assert set(printed["results"]) == set(expected)
    for result, reference in expected.items():
        found = printed["results"][result]
        assert found["unit"] == reference["unit"], result
        dofs = [math.inf if one["dof"] is None else one["dof"] for one in (found, reference)]
        assert math.isclose(*dofs, rel_tol=1e-3), f"dof of {result}: {dofs}"
        for part in ("value", "u"):
            if reference[part] is None:
                assert found[part] is None, result
                continue
            # The same signals through the same mathematics: what may differ is rounding in
            # another processor's vector units, far below the uncertainty of the result.
            slack = 0.01 * (reference["u"] or 0.0)
            assert math.isclose(found[part], reference[part], rel_tol=1e-5, abs_tol=slack), (
                f"{result}.{part}: {found[part]} against {reference[part]}"
            )
    expected = {key: own for key, own in COLUMNS.items() if key.split()[0] == name}
    assert set(columns) == set(expected)
    for column, (unit, kind, count, *reference) in expected.items():
        assert columns[column][:3] == [unit, kind, count], column
        slack = ROUNDING * math.hypot(*reference[:2]) + ZERO
        assert columns[column][3:] == pytest.approx(reference, rel=0, abs=slack), column


def test_fixtures_are_small():
    files = list(HERE.glob("*.h5"))
    assert {file.stem for file in files} == set(STEPS)
    assert sum(file.stat().st_size for file in files) < 8e6
