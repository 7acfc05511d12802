"""More draws of what one draw shows already: part of `make attack`, not of `make test`."""

from collections.abc import Iterable
from typing import Any

import pytest


def first_of(values: Iterable[Any]) -> list[Any]:
    """Return values for `parametrize`, or `params`, of which `make test` tries the first alone."""
    first, *more = values
    return [first, *(pytest.param(value, marks=pytest.mark.thorough) for value in more)]
