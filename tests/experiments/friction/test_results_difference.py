"""The ratio of two changes of one curve: its uncertainty against the scatter of many draws."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np

from rigtool.experiments.friction.results_difference import add_curve_difference

SPEED = np.array([1.0, 2, 4, 8, 16, -1, -2, -4, -8, -16])
U = 0.05


class Found(SimpleNamespace):
    """Results that are kept as they are added."""

    def add(self, name, estimate, unit, dof=None):
        self.results[name] = estimate


def curve(torque, u):
    """Return a run of `stribeck` that holds this curve alone."""
    table = {
        "speed": SPEED,
        "torque": torque,
        "u": np.full(len(SPEED), u),
        "dof": np.full(len(SPEED), 4.0),
    }
    columns = {name: SimpleNamespace(values=values, unit="N m") for name, values in table.items()}
    holds = type("Holds", (dict,), {"columns": columns})(table)
    return SimpleNamespace(
        path=Path("a.h5"),
        tables={"holds": holds},
        table=lambda *_, **__: holds,
        require_command=lambda _: None,
    )


def ratio(random):
    """Return the ratio of 2 N m of added friction to 1 N m, and its standard uncertainty."""
    noise = U * random.standard_normal(len(SPEED))
    twice = curve(2 * np.sign(SPEED) + noise, U)
    found = Found(results={}, tables=twice.tables, notes=[])
    base, once = curve(0 * SPEED, 1e-6), curve(np.sign(SPEED), 1e-6)
    add_curve_difference(found, base, once)
    return found.results["ratio_of_differences"]


def test_the_uncertainty_of_a_ratio_is_that_of_a_mean():
    """Known changes of one size: the ratio is the mean of as many values, u / sqrt(n)."""
    random = np.random.default_rng(1)
    found = [ratio(random) for _ in range(200)]
    values, us = (np.array([getattr(one, name) for one in found]) for name in ("value", "u"))
    np.testing.assert_allclose(np.std(values), U / 10**0.5, rtol=0.1)
    # scatter beyond u raises u, scatter below it does not lower it
    np.testing.assert_allclose(us.min(), U / 10**0.5, rtol=1e-3)
    assert us.max() < 2 * U / 10**0.5


def test_differences_have_the_degrees_of_freedom_of_both_curves():
    """Equal uncertainties of 4 degrees of freedom each: 8 by Welch and Satterthwaite."""
    found = Found(
        results={}, tables={"holds": curve(2 * np.sign(SPEED), U).tables["holds"]}, notes=[]
    )
    add_curve_difference(found, curve(np.sign(SPEED), U), None)
    columns = found.tables["hold_differences"].columns
    np.testing.assert_allclose(columns["u"].values, U * 2**0.5)
    np.testing.assert_allclose(columns["dof"].values, 8.0)
