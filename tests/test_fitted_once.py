"""The copies of slopes that tests get instead of fitting staircases again."""

from dataclasses import dataclass

import numpy as np

from tests import fitted_once


@dataclass
class Plateaus:
    current: np.ndarray


def test_plateaus_of_the_same_numbers_are_fitted_once(monkeypatch):
    fitted = []
    monkeypatch.setattr(fitted_once, "_slopes", {})
    monkeypatch.setattr(
        fitted_once, "fit_staircases", lambda one: fitted.append(one) or [one.current.sum()]
    )
    for _ in range(2):
        found = fitted_once.fit_once(Plateaus(np.arange(3.0)))
        assert found == [3.0]
        found.append("changed by its user")
    assert fitted_once.fit_once(Plateaus(np.arange(4.0))) == [6.0]
    assert len(fitted) == 2
