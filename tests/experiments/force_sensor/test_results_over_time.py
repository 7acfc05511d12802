"""Tables of torque over time: contacts in time and size, errors against a reference."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from rigtool.experiments.force_filter.motion_states import State
from rigtool.experiments.force_model.contacts import Contact
from rigtool.experiments.force_sensor.events import events
from rigtool.experiments.force_sensor.results_over_time import TorqueRows, over_time_tables, peak
from rigtool.experiments.force_sensor.results_recordings import _events

STEP, EVERY, ROWS = 5e-3, 5, 400


def expected_largest(count):
    """Return the mean of the largest of normal values of deviation 1, by draws."""
    draws = np.random.default_rng(5).standard_normal((200_000, count))
    return draws.max(axis=1).mean()


def rows(name, began, contacts=(), reference=False, outside=slice(0)):
    """Return rows whose torque rises evenly, 5 mN m in all, with u that falls."""
    states = np.full(ROWS, State.AGAINST, dtype=np.int32)
    states[outside] = State.OUTSIDE
    states[-40:] = State.STILL
    torque = np.linspace(0, 5e-3, ROWS)
    u = np.linspace(0.4e-3, 0.2e-3, ROWS)
    off = 0.3e-3 * np.sin(np.arange(ROWS))
    return TorqueRows(
        name, STEP, began + STEP * np.arange(ROWS), torque, u, states,
        reference=torque + off if reference else None, contacts=contacts, every=EVERY,
    )  # fmt: skip


def test_contacts_are_in_the_time_of_the_bench_with_their_torque():
    contacts = (Contact(503, 520, 748), Contact(1000, 1010, 1100))
    given = [rows("a", 10.0, contacts[:1]), rows("b", 50.0, contacts[1:])]
    for own in given:
        own.torque[-10:] = 0.0
    table = _events(list(enumerate(given)))["events"]
    assert table["recording"].tolist() == [0, 1]
    for row, own in enumerate(given):
        (event,) = events(own)
        for name, place in (
            ("start", event.start[0]),
            ("start_u", event.start[1]),
            ("found", event.found / EVERY),
            ("end", event.end[0]),
            ("end_u", event.end[1]),
        ):
            began = 0.0 if name.endswith("_u") else own.time[0]
            assert table[name][row] == pytest.approx(began + STEP * place, abs=1e-9)
        inside = np.zeros(ROWS, dtype=bool)
        inside[event.rows] = True
        assert table["mean"][row] == pytest.approx(own.torque[inside].mean(), rel=1e-9)
        assert table["mean_u"][row] == pytest.approx(own.u[inside].mean(), rel=1e-9)
        # the interval farthest from zero: torque rises and u falls
        assert table["peak"][row] == own.torque[inside].max()
        assert table["peak_u"][row] == own.u[inside].min()
    outside = np.where(np.arange(ROWS) < 90, State.AGAINST, State.OUTSIDE)
    hidden = replace(given[0], states=outside)
    assert _events([(0, hidden)]) == {}


@pytest.mark.parametrize(
    ("outside", "unknown", "bound"),
    [
        ([], [], False),
        ([slice(100, 110)], ["start", "peak"], True),
        ([slice(300, 330)], ["end", "peak"], True),
        ([slice(0, 120), slice(290, 400)], ["start", "end", "peak"], False),
        ([slice(200, 203)], ["peak", "mean", "rms"], True),
        ([slice(0, 20), slice(350, 360)], [], False),
    ],
)
def test_what_a_row_without_a_value_cuts_is_a_bound(outside, unknown, bound):
    """What the largest torque was there nobody knows; begin and end of the recording are no part of
    its peak."""
    own = rows("a", 0.0, (Contact(560, 570, 1400),))
    own = replace(own, torque=np.repeat([0.0, 5e-3, 0.0], [110, 190, 100]))
    for each in outside:
        own.states[each] = State.OUTSIDE
    table = _events([(0, own)])["events"]
    assert table.shape == (1,)
    for name in ("start", "end", "peak", "mean", "rms"):
        assert np.isinf(table[f"{name}_u"][0]) == (name in unknown), name
        assert np.isfinite(table[name][0])
    result = over_time_tables([own], 5e-3, 30.0)[0]["peak_torque"]
    assert (result.u is None) == bound


@pytest.mark.parametrize("numbers", [[0, 0], [0, 1]])
def test_a_peak_beside_a_gap_is_a_bound_and_one_at_the_end_of_a_recording_is_none(numbers):
    parts = [rows("a", 0.0), rows("a", 3.0)]
    result = over_time_tables(parts, 5e-3, 30.0, numbers=numbers, lost=1.0)[0]["peak_torque"]
    assert (result.u is None) == (numbers == [0, 0])


def test_an_event_of_a_force_that_swings_has_its_size_and_its_half_waves():
    own = rows("a", 0.0, (Contact(500, 510, 749), Contact(760, 770, 1250)))
    swing = 5e-3 * np.sin(2 * np.pi * np.arange(ROWS) / 50)
    own = replace(own, torque=swing, u=np.full(ROWS, 0.2e-3))
    table = _events([(0, own)])["events"]
    assert table["half_waves"].tolist() == [6]
    inside = own.torque[events(own)[0].rows]
    rms = np.sqrt(np.mean(inside**2))
    assert table["rms"][0] == pytest.approx(rms, rel=1e-9)
    # all errors alike, by the sign of the torque at the worst
    assert table["rms_u"][0] == pytest.approx(np.mean(np.abs(inside)) * 0.2e-3 / rms, rel=1e-9)
    # the largest of six half waves is one whose error has its sign
    assert table["peak_u"][0] == pytest.approx(
        0.2e-3 * math.hypot(1, expected_largest(6)), rel=0.02
    )


def test_errors_are_those_against_the_reference_by_state():
    own = rows("a", 0.0, reference=True, outside=slice(0, 100))
    results, tables = over_time_tables([own], 5e-3, 30.0)
    error = own.torque - own.reference
    known = own.states != State.OUTSIDE
    moving = known & (own.states != State.STILL)
    for name, among in (("rmse", known), ("rmse_moving", moving)):
        assert results[name].value == pytest.approx(np.sqrt(np.mean(error[among] ** 2)))
    covered = np.abs(error) <= 1.96 * own.u
    assert results["coverage_95"].value == pytest.approx(covered[known].mean(), abs=0.005)
    table = next(t for t in tables.values() if t.axes == ("band", "state"))
    lower = table["band"]
    upper = np.append(lower[1:], np.inf)
    for b in range(len(lower)):
        for s, state in enumerate(table["state"]):
            among = known & (own.states == state)
            size = np.abs(own.reference)
            among &= (size >= lower[b]) & (size < upper[b])
            if among.any():
                assert table["rmse"][b, s] == pytest.approx(np.sqrt(np.mean(error[among] ** 2)))
                assert table["bias"][b, s] == pytest.approx(error[among].mean())
                assert table["coverage_95"][b, s] == pytest.approx(covered[among].mean(), abs=0.05)
                assert table["share"][b, s] == pytest.approx(among.sum() / known.sum())


def test_what_never_moves_has_no_error_while_it_moves():
    own = rows("a", 0.0, reference=True)
    results, _ = over_time_tables([replace(own, states=np.full(ROWS, State.STILL))], 5e-3, 30.0)
    assert "rmse" in results
    assert "rmse_moving" not in results


def test_the_table_has_the_interval_of_each_row():
    own = rows("a", 3.0, outside=slice(7, 9))
    table = over_time_tables([own], 5e-3, 30.0)[1]["force"]
    np.testing.assert_allclose(table["time"], own.time)
    valid = own.states != State.OUTSIDE
    np.testing.assert_allclose(table["torque"][valid], own.torque[valid])
    assert np.isnan(table["torque"][~valid]).all()
    half = (table["high"] - table["low"])[valid] / 2
    np.testing.assert_allclose(half, 1.96 * own.u[valid], rtol=1e-3)
    np.testing.assert_allclose((table["high"] + table["low"])[valid] / 2, own.torque[valid])


def test_a_reference_that_is_never_known_judges_nothing():
    own = rows("a", 0.0, reference=True)
    never = replace(own, reference=np.full(ROWS, np.nan))
    results, tables = over_time_tables([never], 5e-3, 30.0)
    assert set(tables) == {"force"}
    assert set(results) == {"valid_share", "peak_torque", "mean_torque"}
    assert "force_accuracy" in over_time_tables([own, never], 5e-3, 30.0)[1]


def test_a_peak_holds_the_largest_torque_of_a_push_that_stays():
    rng, u, found = np.random.default_rng(5), 0.4e-3, []
    kept = np.exp(-STEP / 0.05)
    for _ in range(300):
        noise = rng.normal(0.0, u, ROWS) * np.sqrt(1 - kept**2)
        errors = lfilter([1.0], [1.0, -kept], noise)
        value, own = peak(-20e-3 + errors, np.full(ROWS, u))
        found.append((value + 20e-3) / own)
    assert np.mean(np.abs(found) < 1.96) > 0.93
    assert np.std(found) < 1.0


def test_a_peak_may_be_that_of_rows_of_larger_uncertainty():
    torque, u = np.full(9, 10e-3), np.full(9, 0.1e-3)
    torque[4], u[4] = 13e-3, 2e-3
    value, own = peak(torque, u)
    assert value == 10e-3
    alike = 0.1e-3 * math.hypot(1, expected_largest(2))
    assert own == pytest.approx(math.hypot(alike, 3e-3 / math.sqrt(3)), rel=1e-4)
