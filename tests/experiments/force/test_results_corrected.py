"""Corrected loads: what is taken off, and what each line adds to the uncertainty."""

import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import chi

from rigtool.errors import InsufficientDataError
from rigtool.experiments.force import results_corrected as corrected
from rigtool.experiments.force.results import LoadReadings, LoadRow
from rigtool.experiments.load_disturbance.reading import LoadReading
from rigtool.experiments.load_disturbance.stored import RisingLoad
from rigtool.experiments.outcome import Outcome
from rigtool.quantity import Quantity, combined, error_line
from rigtool.recipe import load_recipe
from tests.experiments.virtual_runs import RECIPE

SCATTER, RIPPLE = 0.1e-3, 0.3e-3


def rows(means):
    """Return rows of applied torques that are a tenth less than the mean."""
    lines = [
        error_line("scatter", SCATTER, "N m", 9),
        error_line(corrected.ONE_ANGLE, RIPPLE, "N m"),
    ]
    return [
        LoadRow(
            float(number),
            Quantity(0.9 * mean, "N m", 0.0),
            combined(mean, "N m", lines),
            1e-3,
            1e-4,
            10.0,
            9.0,
        )
        for number, mean in enumerate(means)
    ]


def readings(values):
    none = np.empty(0)
    return [
        LoadReadings(f"load_{n}", float(n), 3, none, none, none, [], np.array(own))
        for n, own in enumerate(values)
    ]


@pytest.mark.parametrize(
    ("line", "expected"), [(corrected.ONE_ANGLE, 3e-4), ("torque constant", 5e-4)]
)
def test_friction_and_stretch_come_off_each_reading(monkeypatch, line, expected):
    """Friction of a fifth, curved: reading - zero = x + friction(x), of which stretch hid 4 %.

    What remains is ripple and the scale of the learned loads: where the calibration states its
    ripple, both have lines of their own and do not count again.
    """

    def friction(x):
        return 0.2 * np.sqrt(x**2 + 1e-6)

    def rising(tables, recipe, model, added):
        own = np.full_like(added, 3e-4)
        return RisingLoad(friction(added), own, 4 * own / 3, added / 0.96)

    monkeypatch.setattr(corrected, "rising_load", rising)
    known = SimpleNamespace(model=None, torque=0.04 / 0.96)
    monkeypatch.setattr(corrected, "corrects", lambda tables, recipe: known)
    zero, on_tendon = 2e-3, np.array([[0.01, 0.012], [0.040, 0.0436], [0.0420, 0.0422]])
    loads = readings([[zero - 1e-4, zero + 1e-4], *(zero + on_tendon + friction(on_tendon))])
    constant = combined(0.045, "N m/A", [error_line(line, 1e-4, "N m/A")])
    found, u = corrected.without_load_friction(loads, None, None, constant)
    assert found[0] is loads[0]
    for load, own in zip(found[1:], on_tendon, strict=True):
        np.testing.assert_allclose(load.values, zero + own / 0.96, rtol=1e-9)
    # 1.05 times the largest learned load is read, on average; more is not
    np.testing.assert_allclose(u, [0.0, expected, expected, np.nan], rtol=1e-9)


def test_a_correction_adds_its_u_to_that_of_the_thesis_reading():
    base, thesis = Outcome({}, {}, ("note",)), rows([0.0, 0.011, 0.022, 0.033])
    found = corrected.load_outcome(base, thesis, np.array([0.0, 2e-4, 4e-4, np.nan]), thesis)
    table = found.tables["loads"]
    u = np.hypot(math.hypot(SCATTER, RIPPLE), [0.0, 2e-4, 4e-4])
    np.testing.assert_allclose(table["mean_torque_u"][:3], u, rtol=1e-12)
    # Welch and Satterthwaite: only the scatter has degrees of freedom
    np.testing.assert_allclose(table["mean_torque_dof"][:3], 9 * (u / SCATTER) ** 4, rtol=1e-9)
    assert np.isnan(table["mean_torque"][3])
    assert found.results["loads_outside"].value == 1
    np.testing.assert_allclose(
        found.tables["loads_uncorrected"]["mean_torque_u"], math.hypot(SCATTER, RIPPLE)
    )
    with pytest.raises(InsufficientDataError, match="learn with larger loads"):
        corrected.load_outcome(base, thesis, np.array([0.0, np.nan, np.nan, np.nan]), thesis)


def reading(cycles, moment=0.05, another=0.0):
    rng = np.random.default_rng(cycles)
    quantity = combined(moment, "N m", [error_line("scatter", 2e-4, "N m", 6)])
    own = moment + 1e-3 * rng.standard_normal(cycles)
    return LoadReading(quantity, 2e-4, own, own * 1.01, another)


def test_a_note_names_another_power_up():
    unread = InsufficientDataError("not read")
    assert not list(corrected._power_up_notes([unread, reading(7, another=0.4)]))
    (note,) = corrected._power_up_notes([unread, reading(7), reading(7, another=0.6)])
    assert "without switching it off" in note


def test_a_whole_stroke_is_stated_at_the_angle_of_the_reading():
    own, sine = reading(7), math.sin(math.radians(60))
    mean = corrected._whole_quantity(own, sine, -0.01, 3e-4)
    assert mean.value == pytest.approx(0.05 * sine)
    assert mean.u == pytest.approx(math.sqrt((2e-4 * sine) ** 2 + (5e-4 * sine) ** 2 + 9e-8))
    blank = corrected.WholeRow(**vars(rows([0.0, 0.0444])[1].blank()), dead_band=2e-3)
    row = corrected._row(blank, own, sine, mean)
    assert row.mean is mean
    assert row.dead_band == 2e-3
    assert row.std_torque == pytest.approx(np.std(own.cycles, ddof=1) * sine)
    # S of normal readings is distributed as chi
    assert row.std_torque_u / row.std_torque == pytest.approx(chi.std(6) / 6**0.5, rel=0.05)
    # so many independent readings have that scatter of their mean
    assert row.std_torque / math.sqrt(row.effective_cycles) == pytest.approx(2e-4 * sine)
    assert row.cycles == 7
    assert row.angle_mean_torque == pytest.approx(np.mean(own.at_angle) * sine)
    assert row.angle_std_torque == pytest.approx(1.01 * row.std_torque)
    at_angle = np.mean(own.at_angle) * sine
    assert row.angle_error_percent == pytest.approx((at_angle - 0.9 * 0.0444) / (0.9 * 0.0444e-2))


@pytest.mark.parametrize(("moment", "inside"), [(0.0419, True), (0.0421, False)])
def test_a_load_a_twentieth_beyond_the_learned_ones_is_read(moment, inside):
    known = SimpleNamespace(torque=0.04)
    reason = corrected._outside(known, reading(4, moment))
    assert inside == (reason == "")
    assert inside or "the load is 42.1 mN m, learned were loads up to 40 mN m" in reason


def test_a_change_of_temperature_costs_the_u_of_its_coefficient():
    recordings = [
        SimpleNamespace(read=lambda name, t=degc: np.array([t - 1, t + 1])) for degc in (24.0, 28.0)
    ]
    known = {"learned_temperature": Quantity(20.0, "degC", 0.1)}
    tables = SimpleNamespace(result=lambda name, unit: known[name])
    name = "torque_constant_temperature_coefficient"
    slopes = {name: Quantity(-1.2e-3, "1/K", 2e-4)}
    kt = SimpleNamespace(results=slopes, result=lambda name, unit: slopes[name], path=Path("kt.h5"))
    found = corrected.temperature_drift(recordings, kt, tables)
    assert found.u == pytest.approx(6 * 2e-4)
    assert found.remark == (
        "the motor is +6 K from where loads were learned; its constant is corrected by -0.72 %"
    )
    kt.results = {}
    assert corrected.temperature_drift(recordings, kt, tables).u == 0


@pytest.mark.parametrize(
    ("speed", "reason"), [(0.099, True), (0.0991, False), (0.2, False), (0.2019, False)]
)
def test_speeds_within_a_hundredth_of_those_learned_are_corrected(monkeypatch, speed, reason):
    recipe, _ = load_recipe(RECIPE, (f"measure_force.speed_rev_per_s={speed}",))
    ratio = 2 * math.pi * recipe.rig.angle_ratio
    known = SimpleNamespace(speeds=(0.1 * ratio, 0.15 * ratio, 0.2 * ratio))
    assert bool(corrected.slower_than_learned(known, recipe)) == reason
    monkeypatch.setattr(corrected, "disturbance_from", lambda tables, recipe: known)
    load = changed(recipe, correction="load")
    if reason:
        with pytest.raises(InsufficientDataError, match=r"learned from 0\.1 rev/s on"):
            corrected.corrects(None, load)
    else:
        assert corrected.corrects(None, load) is known
    with pytest.raises(InsufficientDataError, match=r"loads were learned up to 0\.2 rev/s"):
        corrected.corrects(None, changed(recipe, speed_rev_per_s=0.2021))


def changed(recipe, **settings):
    force = recipe.measure_force.model_copy(update=settings)
    return recipe.model_copy(update={"measure_force": force})
