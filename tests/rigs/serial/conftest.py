"""Tests of lines run in emulated time, unless they are marked `real_time`."""

import pytest

from rigtool.rigs.serial.hosted import loop


@pytest.fixture(autouse=True)
def time_is_emulated(world):
    """Whatever is asked for."""


@pytest.fixture
def short_blocks(monkeypatch):
    """Twenty blocks of samples a second."""
    monkeypatch.setattr(loop, "BLOCK_TIME", 0.05)
