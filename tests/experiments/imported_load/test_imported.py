"""What is reported of a load model: errors at levels left out, friction, and notes on speeds."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from rigtool.errors import InsufficientDataError
from rigtool.experiments.imported_load import imported
from rigtool.experiments.imported_load.imported import (
    _friction_table,
    _level_table,
    _notes,
    _require_shown,
    _results,
)
from rigtool.experiments.imported_load.learning import LoadFriction, Validation

LEVEL = np.repeat([0, 2], 200)
AGAINST = np.tile([True, False], 200)
RANDOM = np.random.default_rng(1)
VALIDATION = Validation(
    torque=np.where(LEVEL == 0, -0.02, -0.05),
    error=RANDOM.standard_normal(400) * np.where(AGAINST, 2e-3, 1e-3) * (1 + LEVEL),
    u=np.full(400, 3e-3),
    level=LEVEL,
    against=AGAINST,
)
FRICTION = LoadFriction(np.arange(3.0), np.array([0.1, 0.2, 0.3]), np.array([0.01, 0.02, 0.02]), 4)


def learned(paces=3, strokes=1, bend=0.0):
    model = SimpleNamespace(
        scales=SimpleNamespace(low=-2.0, high=3.0, standstill=0.25),
        sides=(
            SimpleNamespace(
                factors=np.array([1.0, 1.3]), at_other_speeds=lambda share: 4 * share, bend=bend
            ),
            SimpleNamespace(
                factors=np.ones(2), at_other_speeds=lambda share: 1 + 2.4 * share, bend=bend
            ),
        ),
        strokes=np.zeros(strokes),
    )
    return SimpleNamespace(model=model, validation=VALIDATION, friction=FRICTION, paces=paces)


def test_results_are_rms_of_errors_and_mean_friction():
    found = _results(learned())
    assert found["load_levels"].value == 2
    assert found["load_friction"].value == pytest.approx(0.2)
    assert found["load_friction"].u == pytest.approx(np.sqrt((1 + 4 + 4) / 3) * 0.01)
    for name, rows in (("resisting", AGAINST), ("driving", ~AGAINST)):
        rms = np.sqrt(np.mean(VALIDATION.error[rows] ** 2))
        assert found[f"rmse_left_out_{name}"].value == pytest.approx(rms, rel=1e-12)


def test_each_level_has_its_errors_and_the_coverage_of_its_intervals():
    table = _level_table(VALIDATION)
    units = {name: column.unit for name, column in table.columns.items()}
    assert units == dict.fromkeys(units, "N m") | {"level": "1", "coverage_95": "1"}
    np.testing.assert_array_equal(table["level"], [0, 2])
    np.testing.assert_allclose(table["torque"], [-0.02, -0.05], rtol=1e-9)
    for n, level in enumerate((0, 2)):
        for name, rows in (("resisting", AGAINST), ("driving", ~AGAINST)):
            own = VALIDATION.error[(level == LEVEL) & rows]
            assert table[f"rmse_{name}"][n] == pytest.approx(np.sqrt(np.mean(own**2)), rel=1e-9)
        inside = np.abs(VALIDATION.error[level == LEVEL]) <= 1.96 * 3e-3
        assert table["coverage_95"][n] == pytest.approx(inside.mean(), abs=0.006)
    table = _friction_table(FRICTION)
    np.testing.assert_array_equal(table["dof"], [4, 4, 4])


@pytest.mark.parametrize(
    ("against", "back", "refused"),
    [(0.0152, 0.0152, False), (0.0154, 0.0152, False), (0.0152, 1.0, False), (0.0154, 1.0, True)],
)
def test_an_effort_that_does_not_show_the_load_is_refused(monkeypatch, against, back, refused):
    """Loads are within 30 mN m; half a 95 % interval is 1.96 u."""
    left_out = replace(VALIDATION, u=np.where(AGAINST, against, back))
    signals = [SimpleNamespace(effort_unit="A")]
    recording = SimpleNamespace(
        has=lambda name: True, conditions={"linear_axis": 0.0}, condition=lambda name: 0.0
    )
    monkeypatch.setattr(imported, "recordings_of", lambda runs: [recording])
    monkeypatch.setattr(imported, "read_all", lambda runs, kt, bandwidth_hz: signals)
    shown = SimpleNamespace(validation=left_out, odd=np.zeros(3))
    monkeypatch.setattr(imported, "learn_load_model", lambda signals, *, turn, prior: shown)
    if refused:
        with pytest.raises(
            InsufficientDataError, match=r"read to 30\.2 mN m .* all are within 30 "
        ):
            imported.analyse_imported([])
    else:
        _require_shown(left_out)


def test_notes_count_levels_and_speeds():
    first, wider, slow = _notes(learned(), 12)
    assert "12 recordings at 2 load levels, up to 50 mN m, position -2 to 3 rad" in first
    assert "most by 1.3;" in wider
    assert slow.startswith("below 0.25 rad/s")
    assert _notes(learned(1), 12)[-1].startswith("recorded at one speed")
    assert len(_notes(learned(1, strokes=2), 12)) == 3
    assert _notes(learned(bend=0.1), 12)[-1].startswith("learned at two loads")
    two = _notes(learned(2), 12)[-1]
    assert two.startswith("recorded at two speeds")
    assert "up to 1.6 times" in two  # a quarter of the change, midway


@pytest.mark.parametrize(("linear", "turn"), [(1.0, 0.0), (0.0, 2 * np.pi)])
def test_a_linear_axis_has_no_turn(monkeypatch, linear, turn):
    class LearnedError(Exception):
        pass

    def learn(signals, *, turn, prior):
        raise LearnedError(turn, prior)

    recording = SimpleNamespace(
        has=lambda name: True, conditions={"linear_axis": linear}, condition=lambda name: linear
    )
    signals = [SimpleNamespace(effort_unit="A")]
    monkeypatch.setattr(imported, "recordings_of", lambda runs: [recording])
    monkeypatch.setattr(imported, "read_all", lambda runs, kt, bandwidth_hz: signals)
    monkeypatch.setattr(imported, "learn_load_model", learn)
    with pytest.raises(LearnedError) as found:
        imported.analyse_imported([])
    assert found.value.args == (turn, None)


def test_intervals_hold_errors_of_either_sign():
    off = Validation(
        torque=np.ones(4),
        error=np.array([-3.0, -1.9, 1.9, 3.0]),
        u=np.ones(4),
        level=np.zeros(4, dtype=int),
        against=np.array([True, False, True, False]),
    )
    assert _level_table(off)["coverage_95"].tolist() == [0.5]
