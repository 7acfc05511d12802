"""Maps of the turn: friction stays out, cogging stays in."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rigtool.control.lookup_table import LookupTable
from rigtool.errors import UsageError
from rigtool.experiments.deploy.position_map import TURN, position_map
from tests.experiments.deploy.periodic_tables import FRICTION, cogging, turning


def test_both_directions_leave_cogging_alone():
    table, u = turning(noise=1e-4)
    found = position_map(table, u, 2.0)
    np.testing.assert_allclose(found.values, cogging(table.position), rtol=0, atol=4e-4)
    assert found.both_directions
    assert abs(found.mean) < 1e-5
    assert abs(found.values.mean()) < 1e-15
    # The mean of two, each with u: GUM 5.1.2
    np.testing.assert_allclose(found.u, 1e-4 / np.sqrt(2), rtol=1e-9, atol=0)


def test_one_direction_keeps_friction_in_its_mean():
    table, u = turning(speeds=(2.0,))
    found = position_map(table, u, None)
    assert not found.both_directions
    assert found.mean == pytest.approx(FRICTION, rel=1e-9, abs=0)
    np.testing.assert_allclose(found.values, cogging(table.position), rtol=0, atol=1e-12)


def test_backward_alone_says_so():
    table, u = turning(speeds=(-2.0,))
    assert position_map(table, u, 2.0).speed == -2.0


@given(angle=st.floats(-50, 50), start=st.floats(-3, 3))
def test_values_are_periodic_and_near_the_truth(angle, start):
    table, u = turning(start=start)
    found = position_map(table, u, 2.0)
    at = found.at(np.array([angle, angle + TURN]))
    assert at[0] == pytest.approx(at[1], rel=0, abs=1e-15)
    # A chord lies within h^2/8 of the curve, times its largest second derivative.
    bound = (TURN / 4000) ** 2 / 8 * (0.4e-3 + 49 * 0.8e-3 + 784 * 0.2e-3)
    assert at[0] == pytest.approx(cogging(angle), rel=0, abs=bound + 1e-15)


def test_scaled_changes_the_unit_of_all():
    table, u = turning(noise=1e-4, speeds=(2.0,))
    found = position_map(table, u, None)
    halved = found.scaled(0.5)
    np.testing.assert_allclose(halved.values, found.values / 2, rtol=1e-12, atol=0)
    np.testing.assert_allclose(halved.u, found.u / 2, rtol=1e-12, atol=0)
    assert halved.mean == found.mean / 2


@pytest.mark.parametrize(
    ("speed", "message"),
    [
        (None, r"holds 2 speeds.*--speed.* 2 rad/s"),
        (7.0, r"--speed 7: was learned forward up to 6 rad/s and backward up to 6"),
        (0.0, "above zero"),
        (-2.0, "above zero"),
        (float("nan"), "above zero"),
    ],
)
def test_a_speed_that_was_not_learned_is_refused(speed, message):
    with pytest.raises(UsageError, match=message):
        position_map(*turning(), speed)


def test_a_part_of_the_turn_is_no_map():
    table, u = turning()
    part = LookupTable(
        table.position[:900], table.speed, table.torque[:, :900], table.low_speed, table.amplitude
    )
    with pytest.raises(UsageError, match=r"0 to 80.91 deg, not a whole turn.*implementation A"):
        position_map(part, u[:, :900], 2.0)


def test_another_period_is_no_turn():
    table, u = turning()
    half = LookupTable(
        table.position / 2,
        table.speed,
        table.torque,
        table.low_speed,
        table.amplitude,
        period=TURN / 2,
    )
    with pytest.raises(UsageError, match=r"repeats after 3\.14159"):
        position_map(half, u, 2.0)


@given(st.floats(-7, 7), st.floats(-7, 7), st.sampled_from([1, -1]), st.floats(-3, 3))
def test_an_encoder_that_sits_elsewhere_sees_the_same_map(position, offset, sign, start):
    table, u = turning(start=start)
    turn = position_map(table, u, 2.0)
    seen = turn.by_encoder(sign, offset)
    found = seen.at(np.array([sign * position + offset]))
    np.testing.assert_allclose(found, turn.at(np.array([position])), rtol=0, atol=1e-14)
