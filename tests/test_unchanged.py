"""What counts as a change of an outcome: on the same processor, on another one, and its signals."""

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
    """Return a function that tells whether an outcome is that of a processor and its signals."""
    monkeypatch.setattr(unchanged, "STORED", tmp_path / "outcomes.json")

    def passes(processor="same", signals=None, stored=None, **changed):
        monkeypatch.setattr(unchanged, "processor", lambda: "same")
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
            monkeypatch.setattr(unchanged, "processor", lambda: processor)
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
@pytest.mark.parametrize(("processor", "least"), [("same", 1e-3), ("another", 1e-2)])
def test_signals_of_a_test_leave_numbers_as_they_are_but_for_rounding(
    passes, processor, least, part
):
    assert passes(processor, force=forces(1e-7)[part])
    assert not passes(processor, force=forces(least)[part])


def test_columns_units_lines_and_notes_are_compared(passes):
    assert passes()
    assert not passes(column=(1.0, 2.0, 3.0))
    assert not passes(force=replace(FORCE, unit="N m"))
    assert not passes(force=replace(FORCE, budget=(replace(LINE, name="gauge"),)))
    assert not passes(force=replace(FORCE, reason="unknown"))
    assert not passes(note="at 3.2 N there is friction")


def test_on_the_same_processor_signals_are_compared(passes):
    assert passes("same", "ours", "ours")
    assert not passes("same", "others", "ours")


def test_a_virtual_rig_on_another_processor_changes_numbers_by_scatter(passes):
    def alike(**changed):
        return passes("another", "others", "ours", **changed)

    assert alike(force=forces(4.0)["value"], column=(1.0, 9.0, 2.0))
    assert alike(note="at 2.9e-1 N there is friction")
    assert alike(force=forces(3.9)["u"])
    assert not alike(force=forces(6.0)["value"])
    assert not alike(force=forces(4.1)["u"])
    assert not alike(force=forces(-0.81)["u"])
    assert not alike(force=replace(FORCE, budget=(replace(LINE, name="gauge"),)))
    assert not alike(note="there is friction")
