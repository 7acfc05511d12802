"""Stored orders with their u and dof, beside the law of propagation line by line."""

import math
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from rigtool.control.position_loop import position_loop
from rigtool.errors import InsufficientDataError
from rigtool.experiments.ripple.orders import HIGHEST_ORDER, LoopRipple, coefficients, spectrum
from rigtool.experiments.ripple.results import (
    INERTIA_U,
    LOWEST_FOLLOWED,
    comparison_results,
    comparison_table,
    condition_tables,
    loop_note,
    revolutions_table,
    ripple_results,
    varying_note,
)
from rigtool.experiments.ripple.shared_scatter import shared_floor
from rigtool.experiments.ripple.varying_speed import uneven_orders
from rigtool.quantity import Quantity, combined, error_line
from rigtool.recipe import load_recipe
from tests.experiments.ripple.fine import FINE
from tests.experiments.virtual_runs import RECIPE

POSITIONS = 500
ANGLE = 2 * np.pi * (np.arange(POSITIONS) + 0.5) / POSITIONS


def ripple(amplitudes, turns, noise=1e-4, seed=1):
    rng = np.random.default_rng(seed)
    wave = sum(a * np.cos(k * ANGLE + 0.3 * k) for k, a in amplitudes.items())
    torque = wave + noise * rng.standard_normal((turns, POSITIONS))
    return LoopRipple(
        torque, FINE, np.ones_like(torque), np.zeros(HIGHEST_ORDER), 0.0, np.zeros(HIGHEST_ORDER)
    )


def moved(own, recipe, speed):
    """Return a ripple with the motion that the loop lets it make: the motor's is 1/T of what the
    loop asks for, and the rest of that accelerates the inertia."""
    order = np.arange(1, HIGHEST_ORDER + 1)
    response = position_loop(**recipe.rig.loop_design).complementary_sensitivity.response(
        order * speed / (2 * np.pi)
    )
    asked = coefficients(own.waveforms, HIGHEST_ORDER, FINE)
    held = np.exp(-0.5j * order * speed * recipe.rig.sample_time)
    part = np.pi * order / POSITIONS
    gained = asked * held * (1 - 1 / response) / (1j * order) * np.sinc(part / np.pi)
    energy = np.real(gained @ np.exp(1j * np.outer(order, ANGLE)))
    inertia = recipe.rig.nominal_inertia
    square = speed**2 + 2 * energy.mean(axis=0) / inertia
    taken = 2 * np.pi / POSITIONS / np.sqrt(square)
    less = (energy - energy.mean(axis=0)) / (inertia * square)
    return replace(own, durations=taken * (1 - less))


@pytest.fixture(scope="module")
def stored():
    recipe, _ = load_recipe(RECIPE, ())
    speeds = [2 * math.pi * n for n in (0.5, 6.31)]  # no whole number of counts a sample
    made = [ripple({2: 2e-3, 7: 0.5e-3}, 12), ripple({2: 1e-3, 7: 0.5e-3}, 11, seed=2)]
    made = [moved(own, recipe, v) for own, v in zip(made, speeds, strict=True)]
    made[0] = replace(made[0], distorted=np.full(HIGHEST_ORDER, 2e-5))
    recordings = [
        SimpleNamespace(name=str(n), condition=lambda name, v=v: v) for n, v in enumerate(speeds)
    ]
    constants = {
        "0": Quantity(0.05, "N m/A", 1e-3, 4.0),
        "1": Quantity(0.045, "N m/A", 2e-4, reason=None),
    }
    tables = condition_tables("speed", "speed", "rad/s", recordings, made, constants, recipe)
    loop = position_loop(**recipe.rig.loop_design).complementary_sensitivity
    return made, speeds, constants, loop, tables


def test_orders_are_those_of_the_motor_with_a_budget_each(stored):
    made, speeds, constants, loop, tables = stored
    recipe, _ = load_recipe(RECIPE, ())
    table = tables["speed_spectrum"]
    assert table["speed"].tolist() == speeds
    for row, (own, speed) in enumerate(zip(made, speeds, strict=True)):
        asked = spectrum(own, HIGHEST_ORDER)
        response = loop.response(asked.order * speed / (2 * math.pi))
        np.testing.assert_allclose(table["loop_gain"][row], np.abs(response), rtol=1e-9)
        seen = np.abs(response) >= LOWEST_FOLLOWED
        np.testing.assert_array_equal(np.isfinite(table["amplitude"][row]), seen)
        constant = constants[str(row)]
        for k in (1, 2, 7):
            amplitude = asked.amplitude[k - 1] / abs(response[k - 1])
            assert table["amplitude"][row][k - 1] == pytest.approx(amplitude, rel=1e-9)
            # a set point is held for a sample: its torque acts half a sample later
            held = k * speed * recipe.rig.sample_time / 2
            turned = asked.phase[k - 1] - np.angle(response[k - 1]) - held
            assert math.remainder(table["phase"][row][k - 1] - turned, 2 * math.pi) == (
                pytest.approx(0, abs=1e-9)
            )
            # both parts of the amplitude scatter, of as many turns but one
            parts = [
                error_line(
                    "scatter",
                    asked.u[k - 1] / abs(response[k - 1]),
                    "N m",
                    2 * (len(own.waveforms) - 1),
                ),
                error_line("T", amplitude * abs(1 - response[k - 1]) * INERTIA_U, "N m"),
                error_line("amplifier", own.distorted[k - 1], "N m"),
                error_line("speed", uneven_orders(own, HIGHEST_ORDER)[k - 1], "N m"),
                error_line(
                    "constant", amplitude * constant.u / constant.value, "N m", constant.dof
                ),
            ]
            expected = combined(amplitude, "N m", parts)
            assert table["u"][row][k - 1] == pytest.approx(expected.u, rel=1e-6)
            assert table["dof"][row][k - 1] == pytest.approx(expected.dof, rel=1e-6)


def test_few_turns_have_the_scatter_of_the_orders_around():
    recipe, _ = load_recipe(RECIPE, ())
    own = moved(ripple({2: 2e-3}, 2), recipe, 2 * math.pi * 0.01)
    constant = Quantity(0.045, "N m/A", 1e-9, reason=None)
    recording = SimpleNamespace(name="0", condition=lambda name: 2 * math.pi * 0.01)
    tables = condition_tables(
        "speed", "speed", "rad/s", [recording], [own], {"0": constant}, recipe
    )
    table = tables["speed_spectrum"]
    asked = spectrum(own, HIGHEST_ORDER)
    floor, dof = shared_floor(asked.order, asked.noise_floor / table["loop_gain"][0], 2)
    assert np.median(dof) > 10
    np.testing.assert_allclose(table["noise_floor"][0], floor, rtol=1e-9)
    np.testing.assert_allclose(table["dof"][0][10:], dof[10:], rtol=0.01)


def test_waveforms_are_means_over_the_turns(stored):
    made, _, _, _, tables = stored
    means = [np.mean(own.waveforms, axis=0) for own in made]
    np.testing.assert_allclose(tables["speed_waveforms"]["torque"], means, atol=1e-15)
    single = revolutions_table(ripple({2: 1e-3}, 103))
    assert single["torque"].shape == (100, POSITIONS)


def test_the_strongest_orders_and_the_distance_to_the_next():
    found = ripple_results([ripple({2: 2e-3, 7: 0.5e-3}, 6), ripple({3: 1e-3, 5: 0.8e-3}, 6)])
    lowest, highest = (found[f"strongest_order_{name}_speed"] for name in ("lowest", "highest"))
    assert (lowest.value, highest.value) == (2, 3)
    assert "25 %" in lowest.reason
    assert "80 %" in highest.reason
    assert found["repeatable_rms"].value == pytest.approx(
        math.sqrt((2e-3**2 + 0.5e-3**2) / 2), rel=0.01
    )
    assert found["non_repeatable_rms"].value == pytest.approx(1e-4, rel=0.05)


def test_the_power_up_that_changed_most_is_stated():
    names = ("correlation", "correlation_u", "shift", "shift_u", "dof")
    made = [
        SimpleNamespace(**dict(zip(names, own, strict=True)))
        for own in ((0.9, 0.01, 0.2, 0.02, 3.0), (0.4, 0.05, -0.6, 0.03, 5.0))
    ]
    found = comparison_results(made)
    assert (found["power_cycle_correlation"].value, found["power_cycle_correlation"].u) == (
        0.4,
        0.05,
    )
    assert (found["power_cycle_shift"].value, found["power_cycle_shift"].u) == (-0.6, 0.03)
    assert found["power_cycle_shift"].dof == 5
    assert comparison_results([]) == {}


@pytest.mark.parametrize("fastest", [0.01, 2.0, 7.0])
def test_the_note_names_the_last_order_that_the_loop_follows(fastest):
    recipe, _ = load_recipe(RECIPE, ())
    loop = position_loop(**recipe.rig.loop_design).complementary_sensitivity
    order = 1
    while (
        order <= HIGHEST_ORDER
        and abs(loop.response(np.array([order * fastest]))[0]) >= LOWEST_FOLLOWED
    ):
        order += 1
    assert loop_note(recipe, fastest).endswith(f"above order {order - 1}")


def test_tables_of_power_ups_and_of_single_turns_hold_their_numbers():
    names = ("correlation", "shift", "best_correlation", "scale")
    rows = [(0.9, 0.2, 0.95, 1.1), (0.4, -0.6, 0.7, 0.8)]
    found = comparison_table(
        [SimpleNamespace(**dict(zip(names, row, strict=True))) for row in rows]
    )
    assert found["power_cycle"].tolist() == [1, 2]
    assert {found.columns[name].unit for name in names} == {"1", "rad"}
    assert found.columns["shift"].unit == "rad"
    np.testing.assert_array_equal([found[name] for name in names], np.transpose(rows))
    own = ripple({2: 1e-3}, 3)
    single = revolutions_table(own)
    assert single["revolution"].tolist() == [0, 1, 2]
    np.testing.assert_allclose(single["position"], ANGLE)
    np.testing.assert_array_equal(single["torque"], own.waveforms)


def test_floors_of_the_scatter_are_those_of_the_motor(stored):
    made, speeds, _, loop, tables = stored
    table = tables["speed_spectrum"]
    for row, (own, speed) in enumerate(zip(made, speeds, strict=True)):
        asked = spectrum(own, HIGHEST_ORDER)
        gain = np.abs(loop.response(asked.order * speed / (2 * math.pi)))
        np.testing.assert_array_equal(table["order"], asked.order)
        seen = gain >= LOWEST_FOLLOWED
        expected = np.where(seen, asked.noise_floor / gain, np.nan)
        np.testing.assert_allclose(table["noise_floor"][row], expected, rtol=1e-9)


def test_what_the_loop_asks_for_holds_the_ripple_and_accelerates_the_inertia():
    """A speed of 3 rad/s that swings by 0.4: orders 4 and 20 of the ripple alone are the motor's,
    beside those of the torque that swings it, as uncertain as the inertia, and as torque may change
    with the speed."""
    recipe, _ = load_recipe(RECIPE, ())
    inertia, samples = recipe.rig.nominal_inertia, 200 * POSITIONS
    fine = (np.arange(samples) + 0.5) * 2 * np.pi / samples
    speed = 3.0 * (1 + 0.4 * np.cos(4 * fine) + 0.1 * np.cos(20 * fine))
    slope = -3.0 * (1.6 * np.sin(4 * fine) + 2.0 * np.sin(20 * fine))
    swings = (inertia * speed * slope).reshape(POSITIONS, -1).mean(axis=1)
    taken = (2 * np.pi / samples / speed).reshape(POSITIONS, -1).sum(axis=1)
    own = ripple({4: 1e-3, 20: 0.2e-3}, 12, noise=1e-7)
    made = replace(
        own,
        waveforms=own.waveforms + swings,
        durations=np.tile(taken, (12, 1)),
        friction_change=0.3e-3,
    )
    turning = SimpleNamespace(name="0", condition=lambda name: 3.0)
    constants = {"0": Quantity(0.05, "N m/A", 0.0)}
    tables = condition_tables("speed", "speed", "rad/s", [turning], [made], constants, recipe)
    found = tables["speed_spectrum"]
    amplitude = found["amplitude"][0]
    # points are taken for the means over cells that waveforms hold
    assert amplitude[3] == pytest.approx(1e-3 / np.sinc(4 / POSITIONS), rel=0.01)
    assert amplitude[19] == pytest.approx(0.2e-3 / np.sinc(20 / POSITIONS), rel=0.01)
    assert np.delete(amplitude, [3, 19]).max() < 0.01e-3
    local = taken.mean() / taken - 1
    parts = swings * INERTIA_U, made.mean * local / math.sqrt(3), made.friction_change * local
    orders = np.abs(np.fft.rfft(parts))[:, 1:101] * 2 / POSITIONS
    for order in (4, 8, 16, 20, 24):
        u = np.linalg.norm(orders[:, order - 1])
        assert found["u"][0][order - 1] == pytest.approx(u, rel=0.05)


def test_a_place_where_the_rotor_dwells_is_as_uncertain_as_cells_resolve_it():
    """A cell that takes three times as long: what it does to orders is not known from cells."""
    recipe, _ = load_recipe(RECIPE, ())
    taken = np.full((12, POSITIONS), 2 * np.pi / 3.0 / POSITIONS)
    turning = SimpleNamespace(name="0", condition=lambda name: 3.0)
    constants = {"0": Quantity(0.05, "N m/A", 0.0)}

    def u(durations):
        made = replace(ripple({4: 1e-3}, 12, noise=1e-7), durations=durations)
        tables = condition_tables("speed", "speed", "rad/s", [turning], [made], constants, recipe)
        return tables["speed_spectrum"]["u"][0]

    dwelling = taken * np.where(np.arange(POSITIONS) == 90, 3.0, 1.0)
    energy = recipe.rig.nominal_inertia * 3.0**2 / 2
    lost = energy * np.array([1 - 1 / 9, 2 * (1 - 1 / 4)])  # one cell, or two of twice the time
    changed = 40 * np.abs(np.diff(lost))[0] * 2 / POSITIONS
    assert u(taken)[39] < 0.01 * changed
    assert u(dwelling)[39] == pytest.approx(changed, rel=0.1)


def test_steps_of_the_encoder_are_part_of_the_floor_with_t_taken_off():
    """Twice what scatter shows in what the loop asks for."""
    recipe, _ = load_recipe(RECIPE, ())
    made, speed = ripple({3: 1e-3}, 12, noise=1e-5), 3.0
    slow = SimpleNamespace(name="0", condition=lambda name: speed)
    constants = {"0": Quantity(0.05, "N m/A", 0.0)}

    def table(own):
        return condition_tables("speed", "speed", "rad/s", [slow], [own], constants, recipe)[
            "speed_spectrum"
        ]

    without = table(made)
    floor = without["noise_floor"][0]
    shown = table(replace(made, steps=2 * floor * without["loop_gain"][0]))
    np.testing.assert_allclose(shown["noise_floor"][0], math.sqrt(5) * floor, rtol=1e-3)
    # scatter is a fifth of the variance: of the floor alone, 25 times its degrees of freedom
    assert shown["dof"][0, 79] == pytest.approx(25 * without["dof"][0, 79], rel=0.03)


def swinging(part):
    """Return how long a rotor takes for its cells whose speed is 1 + part*cos(time), twice a
    turn."""
    time = np.linspace(0.0, 1.0, 20001)
    angle = time + part * np.sin(4 * np.pi * time) / (4 * np.pi)
    passed = np.interp(np.linspace(0.0, 1.0, POSITIONS + 1), angle, time)
    return np.tile(np.diff(passed), (3, 1))


def test_a_rotor_that_sticks_and_slips_has_no_ripple_and_the_others_have():
    """Time for each angle goes with 1/speed: its mean is 1, its mean square 1/sqrt(1 - part^2)."""
    recipe, _ = load_recipe(RECIPE, ())
    names, parts = ["slow", "swings", "sways", "fast"], [0.88, 0.85, 0.1, 0.01]
    made = [replace(ripple({2: 1e-3}, 3), durations=swinging(part)) for part in parts]
    recordings = [
        SimpleNamespace(name=name, condition=lambda _, v=v: v)
        for v, name in enumerate(names, start=1)
    ]
    constants = dict.fromkeys(names, Quantity(0.045, "N m/A", 1e-9, reason=None))
    tables = condition_tables("speed", "speed", "rad/s", recordings, made, constants, recipe)
    spectra = tables["speed_spectrum"]
    for column in ("amplitude", "noise_floor", "u"):
        assert np.isfinite(spectra[column][:, 1]).tolist() == [False, True, True, True]
    sticks, varies = varying_note(recordings, made)
    assert sticks.startswith("slow: the rotor sticks and slips")
    stated = re.search(r"of swings by (\d+) %, sways by (\d+) %: amplitudes", varies)
    for found, part in zip(stated.groups(), parts[1:3], strict=True):
        square = 1 / math.sqrt(1 - part**2) - 1
        assert int(found) == pytest.approx(100 * math.sqrt(square), rel=0.03)
    assert varying_note(recordings[3:], made[3:]) == []
    assert len(varying_note(recordings[::3], made[::3])) == 1
    with pytest.raises(InsufficientDataError, match=r"slow: the rotor sticks .* turn faster"):
        varying_note(recordings[:1], made[:1])
