"""What counts as a change of an outcome: where a machine rounds alike, and where it does not."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from rigtool.quantity import Quantity, error_line
from rigtool.runfile import Column, Table
from tests import unchanged

LINE = error_line("scatter", 0.1, "N", 8.0)
FORCE = Quantity(2.0, "N", 0.1, 8.0, budget=(LINE,))


def outcome(force=FORCE, column=(1.0, 3.0, 2.0), note="at 3.1 N there is friction"):
    columns = {"row": Column(np.arange(len(column)), "1"), "force": Column(np.array(column), "N")}
    tables = {"forces": Table(("row",), columns, "force", "forces")}
    return SimpleNamespace(results={"force": force}, tables=tables, notes=[note])


@pytest.fixture
def passes(tmp_path, monkeypatch):
    """Return a function that tells whether a changed outcome passes for the stored one."""
    monkeypatch.setattr(unchanged, "STORED", tmp_path / "outcomes.json")

    def passes(rounding="same", signals=None, stored=None, **changed):
        monkeypatch.setattr(unchanged, "rounding", lambda: "same")
        for storing, given, own in (
            (True, outcome(), stored),
            (False, outcome(**changed), signals),
        ):
            monkeypatch.setattr(unchanged, "STORING", storing)
            monkeypatch.setattr(unchanged, "signals_of", lambda _, own=own: own)
            try:
                unchanged.require_unchanged("one", given)
            except AssertionError:
                return False
            monkeypatch.setattr(unchanged, "rounding", lambda: rounding)
        return True

    return passes


def forces(away):
    return {
        "value": replace(FORCE, value=2.0 + 0.1 * away),
        "u": replace(FORCE, u=0.1 * (1 + away)),
        "dof": replace(FORCE, dof=8.0 * (1 + away)),
        "budget": replace(FORCE, budget=(replace(LINE, u=0.1 * (1 + away)),)),
    }


@pytest.mark.parametrize("part", ["value", "u", "dof", "budget"])
def test_numbers_stay_as_they_are_but_for_rounding(passes, part):
    assert passes(force=forces(1e-7)[part])
    assert not passes(force=forces(1e-3)[part])


def test_columns_units_lines_and_notes_are_compared(passes):
    assert passes()
    assert not passes(column=(1.0, 2.0, 3.0))
    assert not passes(force=replace(FORCE, unit="N m"))
    assert not passes(force=replace(FORCE, budget=(replace(LINE, name="gauge"),)))
    assert not passes(force=replace(FORCE, reason="unknown"))
    assert not passes(note="at 3.2 N there is friction")


def test_signals_are_compared(passes):
    assert passes("same", "ours", "ours")
    assert not passes("same", "others", "ours")


def test_a_machine_that_rounds_otherwise_compares_nothing(passes):
    assert passes("other", "others", "ours", force=forces(6.0)["value"], note="of another signal")


def test_rounding_is_known_by_more_than_one_digit():
    name, versions = unchanged.rounding().split(" ", 1)
    assert len(name) == 16
    assert np.__version__ in versions
