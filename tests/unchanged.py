"""Outcomes of commands held against what they were: each result, each column, each note.

Tests of single numbers see what somebody thought of. Where a test has an outcome anyway, all other
numbers of it are compared as well; `make references` stores them anew.
"""

import functools
import hashlib
import json
import math
import os
import re
from pathlib import Path

import numpy as np
import pytest
import scipy.fft
import scipy.linalg

from rigtool.runfile import open_run
from tests.fixtures.make import digests

STORED = Path(__file__).parent / "fixtures" / "outcomes.json"
STORING = "STORE_OUTCOMES" in os.environ
ROUNDING = 1e-4
"""Part of the rms of a column by which it may differ: sums in another order."""
ZERO = 1e-15
"""What rounding leaves of a column that is zero, in any unit."""


def require_unchanged(name, outcome, *, alone=False):
    """Compare results, tables and notes of an outcome, or of a stored run, with the stored ones.

    Signals of the virtual rig are others where a processor rounds otherwise, or where a learned
    table changes by its rounding: a loop with an encoder amplifies that. With other rounding, or
    other signals, than those of the stored numbers nothing is compared, and a test that is there
    for this `alone` is skipped.
    """
    found = {
        "signals": signals_of(outcome),
        "results": {
            key: {
                "value": one.value,
                "u": one.u,
                "dof": None if one.dof == math.inf else one.dof,
                "unit": one.unit,
            }
            for key, one in outcome.results.items()
        },
        "tables": digests(name, outcome.tables),
        "notes": [re.sub(r"(?<!\S)/\S*/", "", note) for note in outcome.notes],
    }
    known = json.loads(STORED.read_text()) if STORED.exists() else {}
    if STORING:
        known["rounding"] = rounding()
        whole = sorted((known | {name: found}).items())
        lines = (f" {json.dumps(key)}: {json.dumps(own)}" for key, own in whole)
        STORED.write_text("{\n" + ",\n".join(lines) + "\n}\n")
        return
    if (rounding(), found["signals"]) != (known["rounding"], known[name]["signals"]):
        if alone:
            pytest.skip("other rounding or signals than those of the stored numbers")
        return
    require_results(found["results"], known[name]["results"])
    require_columns(found["tables"], known[name]["tables"])
    assert found["notes"] == known[name]["notes"]


@functools.cache
def rounding():
    """Return a digest of how this machine rounds functions, sums, products and decompositions."""
    drawn = np.random.default_rng(1)
    one, other = drawn.uniform(0.1, 3.0, (2, 257, 131))
    square = one.T @ other
    found = [
        *(function(one) for function in (np.exp, np.log, np.sin, np.cos, np.tan, np.tanh)),
        *(np.arctan2(one, other), np.hypot(one, other), one**other, one @ other[0]),
        *(one.sum(axis=0), one.sum(), one.std(), np.convolve(one[0], other[0]), np.cumsum(one)),
        *(np.interp(one, np.sort(other[0]), other[1]), np.einsum("ij,kj->ik", one, other)),
        *(np.linalg.lstsq(one, other)[0], np.linalg.svd(one)[1], scipy.linalg.qr(one)[1]),
        *(np.linalg.inv(square), scipy.linalg.cholesky(one.T @ one), scipy.fft.rfft(one)),
        [math.exp(x) + math.sin(x) + math.lgamma(x) + x**1.7 for x in one[0]],
    ]
    return hashlib.sha256(b"".join(np.asarray(part).tobytes() for part in found)).hexdigest()[:16]


def signals_of(outcome):
    """Return a digest of the signals of the virtual rig, None of those that a test made."""
    path = getattr(outcome, "path", None)
    if path is None:
        return None
    digest = hashlib.sha256()
    with open_run(path) as run:
        for recording in run.recordings.values():
            for channel in recording.channels:
                digest.update(np.ascontiguousarray(recording.read(channel.name)).tobytes())
    return digest.hexdigest()[:16]


def require_results(found, expected):
    """The same signals through the same mathematics: what may differ is rounding after a change
    of its order, far below the uncertainty of the result."""
    assert set(found) == set(expected)
    for result, reference in expected.items():
        own = found[result]
        assert own["unit"] == reference["unit"], result
        dofs = [math.inf if one["dof"] is None else one["dof"] for one in (own, reference)]
        assert math.isclose(*dofs, rel_tol=1e-3), f"dof of {result}: {dofs}"
        for part in ("value", "u"):
            if reference[part] is None:
                assert own[part] is None, result
                continue
            slack = 0.01 * (reference["u"] or 0.0)
            known = pytest.approx(reference[part], rel=1e-5, abs=slack, nan_ok=True)
            assert own[part] == known, f"{result}.{part}"


def require_columns(found, expected):
    """Compare units, types and digests of columns."""
    assert set(found) == set(expected)
    for column, (unit, kind, count, *reference) in expected.items():
        assert found[column][:3] == [unit, kind, count], column
        slack = ROUNDING * math.hypot(*reference[:2]) + ZERO
        assert found[column][3:] == pytest.approx(reference, rel=0, abs=slack), column
