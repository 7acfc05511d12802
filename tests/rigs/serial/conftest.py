"""Tests of lines run in emulated time, unless they are marked `real_time`."""

import pytest


@pytest.fixture(autouse=True)
def time_is_emulated(world):
    """Whatever is asked for."""
