"""Which parts of imported motions are holds, and the motions that the command asks for."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from rigtool.errors import InsufficientDataError, UsageError
from rigtool.experiments.friction import imported, procedure
from rigtool.experiments.friction.imported import _stretches
from rigtool.experiments.friction.results import Findings, Scale, _add_directions
from rigtool.experiments.friction.results_difference import (
    _minus,
    _ratio,
    add_curve_difference,
    require_different,
)
from rigtool.quantity import Quantity
from rigtool.recipe import load_recipe
from tests.experiments.friction.test_results_difference import Found
from tests.experiments.virtual_runs import RECIPE


class Moved:
    """An imported recording of a position."""

    def __init__(self, speed, step=0.01, **more):
        speed = np.asarray(speed, dtype=float)
        position = np.append(0.0, np.cumsum(speed) * step)
        self.channels = {"time": step * np.arange(len(position)), "position": position, **more}
        self.name = "moved"

    def has(self, name):
        return name in self.channels

    def read(self, name):
        return self.channels[name]


def steps(*levels, count=200):
    return np.repeat(levels, count)


def test_one_speed_once_it_has_settled_is_a_hold():
    """Speeds of five parts of the second half differ by less than a quarter from their mean."""
    run_up = np.linspace(0, 5.0, 300)
    whole = [(0, 1001)]
    assert _stretches(Moved([*run_up, *steps(5.0, count=700)])) == whole
    for swing, held in ((0.2, True), (0.3, False)):
        speed = np.full(1000, 5.0)
        speed[500:600] *= 1 - swing * 1.25  # the mean of five parts falls by a fifth of it
        found = _stretches(Moved(speed))
        assert (found == whole) == held
    # a motion that is uneven at first and even later is one; the other way around is none
    late = np.append(np.linspace(0, 12, 500), steps(5.0, count=500))
    assert _stretches(Moved(late)) == whole
    assert _stretches(Moved(late[::-1])) != whole


@pytest.mark.parametrize(("net", "held"), [(0.07, False), (0.13, True)])
def test_an_oscillation_makes_no_progress(net, held):
    """A tenth of the way at least, in parts of whole periods."""
    time = 0.01 * np.arange(2000)
    speed = 3.0 * (np.pi / 2 * np.cos(2 * np.pi * 2 * time) + 1.0 * net)
    found = _stretches(Moved(speed))
    assert (found == [(0, 2001)]) == held


def test_a_staircase_has_a_stretch_for_each_speed_that_is_not_standstill():
    speed = steps(2.0, 5.0, 0.0, -3.0, 8.0, count=400)
    found = _stretches(Moved(speed))
    assert len(found) == 4
    for (a, b), first in zip(found, (0, 400, 1200, 1600), strict=True):
        assert abs(a - first) <= 11
        assert abs(b - first - 400) <= 11
    # by the set point of speed the edges are those of the samples
    asked = Moved(speed, speed_setpoint=np.append(speed, speed[-1]))
    assert [a for a, _ in _stretches(asked)] == [0, 400, 1200, 1600]
    assert_allclose([b for _, b in _stretches(asked)], [400, 800, 1600, 2000], atol=1)


@pytest.mark.parametrize(("part", "held"), [(0.8e-3, 4), (1.5e-3, 0)])
def test_set_points_within_a_thousandth_of_the_highest_are_one_speed(part, held):
    """Beside standstill: rounding of what a drive reports is no step."""
    speed = steps(2.0, 5.0, 0.0, -3.0, 8.0, count=400)
    asked = np.append(speed, 8.0) + 8.0 * part * (np.arange(2001) % 2)
    assert len(_stretches(Moved(speed, speed_setpoint=asked))) == held


@pytest.mark.parametrize(("ratio", "one"), [(0.55, True), (0.45, False)])
def test_speeds_within_a_factor_of_two_are_one_with_its_scatter(ratio, one):
    """Where the last half is even: a staircase of a speed and its half is two holds."""
    speed = np.append(steps(5.0 * ratio, count=500), steps(5.0, count=700))
    found = _stretches(Moved(speed))
    assert (found == [(0, 1201)]) == one
    assert len(found) == (1 if one else 2)


@pytest.mark.parametrize(("ratio", "one"), [(0.51, True), (0.49, False)])
def test_the_speed_of_a_short_stretch_is_that_of_its_own_samples(ratio, one):
    """Of 16 samples each counts: a fifteenth of their time."""
    speed = np.append(np.full(16, 5.0 * ratio), steps(5.0, count=900))
    found = _stretches(Moved(speed, speed_setpoint=np.append(speed, 5.0)))
    assert (found == [(0, 917)]) == one


@pytest.mark.parametrize(("share", "held"), [(0.42, False), (0.6, True)])
def test_plateaus_fill_half_of_the_time(share, held):
    count = round(2000 * share / 4)
    parts = [np.full(count, level) for level in (2.0, 6.0, 3.0, 9.0)]
    wild = np.random.default_rng(1).uniform(-9, 9, 2000 - 4 * count)
    found = _stretches(Moved(np.concatenate([*parts, np.repeat(wild[::5], 5)[: len(wild)]])))
    assert bool(found) == held


@pytest.mark.parametrize(("share", "held"), [(0.4, False), (0.6, True)])
def test_a_set_point_of_position_holds_speeds_in_half_of_its_samples(share, held):
    """Standstill, a hundredth of the highest speed, is no hold."""
    size = 2000
    speed = np.full(size, 0.008 * 5)
    speed[: round(share * size)] = 5.0
    own = Moved(speed)
    own.channels["position_setpoint"] = own.read("position")
    assert _stretches(own) == ([(0, size + 1)] if held else [])
    time = own.read("time")
    for rate, even in ((0.5e-3, True), (5e-3, False)):  # of the highest speed, a second
        own.channels["position_setpoint"] = 5 * time + 0.5 * 5 * rate * time**2
        assert bool(_stretches(own)) == even


# -- motions of the command


def settings(*sets):
    return load_recipe(RECIPE, tuple(f"stribeck.{one}" for one in sets))[0].stribeck


def plateaus(profile):
    """Return speed and duration of what is held."""
    time, speed = np.array(profile.times), np.array(profile.speeds)
    held = np.diff(speed) == 0
    return [*zip(speed[1:][held].tolist(), np.diff(time)[held].tolist(), strict=True)]


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_holds_last_for_whole_turns_and_their_time(direction):
    own = settings("hold_speeds=[5.0, 1.0, 20.0]", "hold_revolutions=3", "hold_time=4")
    profile = procedure.hold_profile(own, direction)
    expected = []
    for speed in (1.0, 5.0, 20.0):
        turns = max(3, math.ceil(4 * speed / (2 * math.pi)))
        expected.append((direction * speed, 1.0 + turns * 2 * math.pi / speed))
    assert_allclose(plateaus(profile), expected)
    # from speed to speed as fast as to the highest in a second
    slopes = np.abs(np.diff(profile.speeds) / np.diff(profile.times))
    assert_allclose(slopes[slopes > 0], own.speed_max)
    assert profile.speeds[0] == profile.speeds[-1] == 0.0


@pytest.mark.parametrize(
    ("speeds", "chosen"),
    [([0.5, 1.0, 2.0, 3.0, 4.0, 5.0, 9.0], [1.0, 2.0, 3.0, 4.0]), ([0.3, 0.9, 0.6], [0.9])],
)
def test_loaded_holds_go_to_and_fro_at_the_lowest_speeds_that_slide(speeds, chosen):
    own = settings(f"hold_speeds={speeds}", "hold_revolutions=2")
    expected = [(sign * v, 1.0 + 4 * math.pi / v) for v in chosen for sign in (1, -1)]
    assert_allclose(plateaus(procedure.loaded_profile(own)), expected)


def test_a_sweep_goes_from_full_speed_backwards_to_full_speed():
    own = settings("speed_max=20", "sweep_time=30")
    profile = procedure.sweep_profile(own)
    assert_allclose(profile.times, [0, 1, 31, 32])
    assert_allclose(profile.speeds, [0, -20, 20, 0])


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_each_position_is_approached_in_the_direction_of_its_ramp(direction):
    """From 0.2 rad at least, by the nearest turn; where the shaft is far enough, at once."""
    for angle, target in ((7.0, 0.5), (-1.0, 2.0), (0.1, 0.15), (12.0, -3.0)):
        moves, shaft = [], procedure._Shaft(angle=angle)
        rig = SimpleNamespace(move_by=moves.append)
        procedure._go_to(rig, shaft, target, direction)
        end = angle + sum(moves)
        assert math.remainder(end - target, 2 * math.pi) == pytest.approx(0.0, abs=1e-9)
        assert direction * moves[-1] >= 0.2 - 1e-9
        assert abs(end - angle) <= math.pi + 1e-9
        if len(moves) == 2:
            assert direction * moves[-1] == pytest.approx(0.2)
            assert direction * (end - angle) < 0.2


def test_a_ramp_leaves_the_shaft_where_its_last_count_is():
    blocks = [
        {"encoder": np.array([100.0, 101.0])},
        {"encoder": np.array([])},
        {"encoder": np.array([140.0])},
    ]
    rig = SimpleNamespace(perform=lambda task: iter(blocks))
    seen, shaft = [], procedure._Shaft()
    recorder = SimpleNamespace(
        channel_names=lambda name: ("encoder",), append=lambda name, values: seen.append(values)
    )
    procedure._record_ramp(rig, None, recorder, "breakaway", shaft, 4000)
    assert shaft.angle == pytest.approx(40 * 2 * math.pi / 4000)
    assert shaft.origin == 100.0
    assert len(seen) == 3


# -- directions and differences


def test_directions_without_scatter_have_none_in_their_mean():
    found = Findings(Scale(Quantity(0.05, "N m/A", 0.0)))
    _add_directions(found, "friction", {1: (2e-3, 0.0), -1: (4e-3, 0.0)}, "N m", {1: 9, -1: 9})
    assert found.results["friction"].value == pytest.approx(3e-3)
    assert found.results["friction"].u == 0
    assert found.results["friction_negative"].u == 0


SPEED = np.array([1.0, 2, 4, 8, 16, 24, -1, -2, -4, -8, -16, -24])


def test_differences_are_taken_at_speeds_within_a_hundredth():
    other = SPEED * np.where(np.arange(12) % 2, 1.009, 1.011)
    one = 0 * SPEED + 1
    found = _minus((SPEED, 3 * SPEED, 0.3 * one, 9 * one), (other, SPEED, 0.4 * one, 16 * one))
    assert_allclose(found[0], SPEED[1::2])
    assert_allclose(found[1], 2 * SPEED[1::2])
    assert_allclose(found[2], 0.5)
    assert_allclose(found[3], 0.5**4 / (0.3**4 / 9 + 0.4**4 / 16))  # GUM G.4.1


@pytest.mark.parametrize("scatter", [0.3, 3.0])
def test_a_difference_is_the_weighted_line_of_its_signs_and_speeds(scatter):
    rng = np.random.default_rng(2)
    u = rng.uniform(0.02, 0.05, 12)
    torque = 2 * np.sign(SPEED) + 0.1 * SPEED + 0.3 + scatter * u * rng.standard_normal(12)
    columns, dof = {"torque": SimpleNamespace(values=torque, unit="N m")}, np.full(12, 4.0)
    own = type("Holds", (dict,), {"columns": columns})(speed=SPEED, torque=torque, u=u, dof=dof)
    base = type("Holds", (dict,), {"columns": columns})(speed=SPEED, torque=0 * u, u=0 * u, dof=dof)
    against = SimpleNamespace(
        path="a.h5",
        tables={"holds": base},
        table=lambda *_, **__: base,
        require_command=lambda _: None,
    )
    found = Found(results={}, tables={"holds": own}, notes=[])
    add_curve_difference(found, against, None)
    design = np.column_stack([np.sign(SPEED), SPEED, np.ones(12)]) / u[:, None]
    covariance = np.linalg.inv(design.T @ design)
    line = covariance @ design.T @ (torque / u)
    left = torque / u - design @ line
    excess = max(1.0, left @ left / 9)
    assert (excess > 1) == (scatter > 1)
    names = ("coulomb_friction", "viscous_friction", "friction_offset")
    for name, value, square in zip(names, line, np.diag(covariance) * excess, strict=True):
        assert found.results[f"{name}_difference"] == pytest.approx((value, math.sqrt(square)))
    table = found.tables["hold_differences"]
    assert_allclose(table["model"], design @ line * u, rtol=1e-9)
    assert_allclose(table["difference"], torque)
    for count, enough in ((6, True), (5, False)):
        part = np.r_[:3, 6 : 3 + count]
        few = type("Holds", (dict,), {"columns": columns})(
            speed=SPEED[part], torque=torque[part], u=u[part], dof=dof[part]
        )
        again = Found(results={}, tables={"holds": few}, notes=[])
        if enough:
            add_curve_difference(again, against, None)
            continue
        with pytest.raises(InsufficientDataError, match=r"5 speeds are common.*6 are needed"):
            add_curve_difference(again, against, None)


def test_errors_that_differences_share_are_taken_off_their_ratio():
    """Over many draws the ratio is right, where plain least squares leans towards one."""
    rng, found, plain = np.random.default_rng(3), [], []
    u = 0.16
    for _ in range(400):
        base, other, mine = u * rng.standard_normal((3, 12))
        curves = [
            (SPEED, level * np.sign(SPEED) + noise, np.full(12, u), np.full(12, 4.0))
            for level, noise in ((3.0, mine), (0.0, base), (1.0, other))
        ]
        found.append(_ratio(*curves))
        x, y = curves[2][1] - curves[1][1], curves[0][1] - curves[1][1]
        plain.append(x @ y / (x @ x))
    values = np.array([one.value for one in found])
    assert np.median(values) == pytest.approx(3.0, rel=0.02)
    assert np.median(plain) < 2.92
    assert np.mean([one.u for one in found]) == pytest.approx(values.std(), rel=0.25)
    assert found[0].dof == 11


def test_a_run_is_not_compared_with_itself():
    one, other = (SimpleNamespace(content_sha256=name) for name in "ab")
    require_different([one], other, None)
    require_different([one], None, one)
    for given in (([one], one, None), ([one], other, other), ([one, other], other, None)):
        with pytest.raises(UsageError, match="given twice"):
            require_different(*given)


@pytest.mark.parametrize(
    ("moved", "compared", "refused"),
    [(True, False, False), (False, False, True), (True, True, True)],
)
def test_holds_that_are_too_few_leave_the_dynamics_of_the_motion(
    moved, compared, refused, monkeypatch
):
    """A comparison needs the holds."""
    own = Moved(steps(5.0, count=400))
    effort = SimpleNamespace(relative_u=0.01, origin="given", name="torque", unit="N m")

    def few(*given):
        raise InsufficientDataError("two speeds")

    for name, value in {
        "recordings_of": lambda runs: [own],
        "require_one_rig": lambda recordings: None,
        "effort_of": lambda recording, kt: effort,
        "is_linear": lambda recording: False,
        "_add_holds": few,
        "_moved": lambda *given: moved,
        "require_different": lambda *given: None,
    }.items():
        monkeypatch.setattr(imported, name, value)
    other = SimpleNamespace(content_sha256="b") if compared else None
    if refused:
        with pytest.raises(InsufficientDataError, match="two speeds"):
            imported.analyse_imported([None], against=other)
        return
    notes = imported.analyse_imported([None], against=other).notes
    assert notes == ("torque is given", "by the dynamics of the motion: two speeds")
