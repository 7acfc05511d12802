"""The stored runs analysed again, with the commands as a user types them."""

import json
import math

import pytest

from rigtool.runfile import open_run
from tests import unchanged
from tests.cli.called import call
from tests.fixtures.make import AGAIN, HERE, RESULTS, STEPS, TABLES, digests
from tests.fixtures.make import line as command_line
from tests.unchanged import require_columns, require_results

REFERENCES = json.loads(RESULTS.read_text())
COLUMNS = json.loads(TABLES.read_text())


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
    slack = unchanged.slack_of(json.loads(unchanged.STORED.read_text())["kt"]["rounding"])
    require_results(printed["results"], REFERENCES[name], slack)
    own = {key: column for key, column in COLUMNS.items() if key.split()[0] == name}
    require_columns(columns, own, slack)


def test_fixtures_are_small():
    files = list(HERE.glob("*.h5"))
    assert {file.stem for file in files} == set(STEPS)
    assert sum(file.stat().st_size for file in files) < 8e6
