"""A short part of `make attack`: no traceback, crash, hang, large memory or different result."""

import pytest

from tests.attack.__main__ import attack
from tests.attack.kinds import KINDS

ROUNDS = {"kills": 1, "signals": 1, "damaged files": 1, "malicious files": 1, "edited tables": 2}
"""Attacks of the kinds that take long; the others have three."""


@pytest.mark.parametrize("kind", KINDS)
def test_nothing_is_seen_that_must_not_be(tmp_path, kind):
    assert attack(tmp_path, 7, kinds={kind: KINDS[kind]}, rounds=ROUNDS.get(kind, 3)) == []
