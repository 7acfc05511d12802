"""More draws of what one draw shows already: part of `make attack`, not of `make test`."""

from collections.abc import Iterable
from typing import Any

import pytest


def thorough(*values: Any) -> list[Any]:
    """Return values, or tuples of them, for `parametrize` that `make test` leaves out."""
    marks = pytest.mark.thorough
    return [pytest.param(*(v if isinstance(v, tuple) else (v,)), marks=marks) for v in values]


def first_of(values: Iterable[Any]) -> list[Any]:
    """Return values for `parametrize`, or `params`, of which `make test` tries the first alone."""
    first, *more = values
    return [first, *thorough(*more)]
