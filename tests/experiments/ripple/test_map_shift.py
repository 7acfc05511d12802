"""Maps around a turn: orders by least squares, and what is turned is found."""

import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rigtool.errors import InsufficientDataError, UsageError
from rigtool.experiments.ripple.imported_maps import compare_maps, read_maps
from rigtool.experiments.ripple.map_shift import highest_order, map_orders, match_maps, typical
from rigtool.experiments.ripple.orders import HIGHEST_ORDER
from rigtool.runfile import Column, Table

ORDERS = 40


def values(angle, shift=0.0, seed=1):
    random = np.random.default_rng(seed)
    amplitude, phase = random.exponential(size=20), random.uniform(-3, 3, 20)
    order = np.arange(1, 21)
    return np.cos(np.multiply.outer(angle - shift, order) + phase) @ amplitude + 3


def sampled(count=512, seed=None):
    if seed is None:
        return np.arange(count) * (2 * np.pi / count)
    random = np.random.default_rng(seed)
    return np.sort(np.arange(count) + random.uniform(-0.3, 0.3, count)) % count * 2 * np.pi / count


def test_orders_are_those_of_the_fourier_transform():
    angle = sampled()
    expected = np.fft.rfft(values(angle))[1 : ORDERS + 1] * 2 / len(angle)
    found = map_orders(angle, values(angle), ORDERS)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)


def test_orders_do_not_depend_on_where_it_was_sampled():
    angle = np.sort(sampled(seed=4))
    assert 100 < highest_order(angle) <= 256
    found = map_orders(angle, values(angle), ORDERS)
    np.testing.assert_allclose(
        found, map_orders(sampled(), values(sampled()), ORDERS), rtol=0, atol=1e-10
    )


@settings(deadline=None, max_examples=40)
@given(st.floats(-3.1, 3.1), st.integers(0, 1000))
def test_a_turned_map_is_found(shift, seed):
    angle = sampled()
    a, b = (map_orders(angle, values(angle, s, seed), ORDERS) for s in (0.0, shift))
    found = match_maps(a, b)
    assert math.remainder(found.shift - shift, 2 * math.pi) == pytest.approx(0, rel=0, abs=0.02)
    assert found.best_correlation > 0.99


def test_the_uncertainty_covers_the_scatter_of_the_shift():
    angle, random = sampled(), np.random.default_rng(5)
    found = []
    for _ in range(200):
        noisy = [values(angle, s) + random.normal(0, 0.5, len(angle)) for s in (0.0, 1.0)]
        found.append(match_maps(*(map_orders(angle, item, ORDERS) for item in noisy)))
    scatter = np.std([item.shift for item in found])
    assert np.mean([item.shift_u for item in found]) == pytest.approx(scatter, rel=0.2, abs=0)


def test_the_typical_map_is_not_the_odd_one():
    angle = sampled()
    maps = [map_orders(angle, values(angle, s), ORDERS) for s in (math.pi, 0.0, 0.001, 0.002)]
    assert typical(maps) in (1, 2, 3)


@pytest.mark.parametrize(
    ("angle", "message"),
    [
        (sampled(50), "50 angles resolve orders up to 24, 40 are needed"),
        (sampled(512)[:400], "resolve orders up to"),
        (sampled(8), "too few, 16"),
        (sampled(512)[::-1], "time does not rise|does not rise"),
    ],
)
def test_too_few_angles(angle, message):
    with pytest.raises(InsufficientDataError, match=message):
        map_orders(angle, values(angle), ORDERS)


def test_a_constant_map():
    with pytest.raises(InsufficientDataError, match="constant"):
        match_maps(np.zeros(5, complex), np.ones(5, complex))


def test_maps_are_stored_beside_the_one_that_is_like_all_others():
    """Of three, one is turned and twice as large, and one is another."""
    angle = sampled()
    made = [
        5 * values(angle, seed=2),
        values(angle),
        2 * values(angle, 0.4),
        values(angle, 0.01),
    ]
    runs = [
        SimpleNamespace(
            path=Path(f"map {n}.h5"),
            table=lambda *_, one=one, **__: Table(
                ("position",),
                {"position": Column(angle, "rad"), "torque": Column(one, "N m")},
                "torque",
                "",
            ),
        )
        for n, one in enumerate(made)
    ]
    maps = read_maps(runs)
    orders = [map_orders(angle, one, HIGHEST_ORDER) for one in made]
    np.testing.assert_allclose(maps.means, np.mean(made, axis=1))
    assert (maps.reference, maps.signal, maps.unit) == (typical(orders), "torque", "N m")
    found = compare_maps(runs)
    table, spectra = found.tables["map_comparison"], found.tables["map_spectrum"]
    against = [match_maps(orders[maps.reference], other) for other in orders]
    for name in ("correlation", "shift", "shift_u", "best_correlation", "scale"):
        np.testing.assert_allclose(table[name], [getattr(one, name) for one in against], rtol=1e-9)
    assert np.isinf(table["dof"]).all()
    np.testing.assert_allclose(spectra["amplitude"], np.abs(orders), atol=1e-12)
    turned = spectra["amplitude"] * np.exp(1j * spectra["phase"])
    np.testing.assert_allclose(turned, orders, atol=1e-12)
    np.testing.assert_array_equal(spectra["order"], 1 + np.arange(len(orders[0])))
    assert table["map"].tolist() == spectra["map"].tolist() == [0, 1, 2, 3]
    others = {n for n in range(4) if n != maps.reference}
    assert set(found.results) == {f"{w}_map_{n}" for n in others for w in ("shift", "correlation")}
    for n in others:
        shift, alike = found.results[f"shift_map_{n}"], found.results[f"correlation_map_{n}"]
        assert (shift.value, shift.u) == (against[n].shift, against[n].shift_u)
        assert alike.value == against[n].correlation
    verdicts = {note.split(":")[0]: note for note in found.notes[1:]}
    assert len(found.notes) == 4
    assert "another map" in verdicts["map 0"]
    degrees = math.degrees(0.4 if maps.reference == 1 else 0.39)
    assert "the same map, shifted by 0.06 of a turn" in verdicts["map 2"]
    assert f"{degrees:.1f} +- " in verdicts["map 2"]
    same = next(iter(others - {0, 2}))
    assert "the same map (" in verdicts[f"map {same}"]


def test_one_map_and_maps_of_other_signals_are_not_compared():
    angle = sampled()

    def run(unit):
        columns = {"position": Column(angle, "rad"), "torque": Column(values(angle), unit)}
        made = Table(("position",), columns, "torque", "")
        return SimpleNamespace(path=Path("map.h5"), table=lambda *_, **__: made)

    with pytest.raises(UsageError, match="one map cannot be compared"):
        compare_maps([run("A")])
    with pytest.raises(UsageError, match=r"torque \[A\], torque \[N m\] cannot be compared"):
        read_maps([run("A"), run("N m")])
