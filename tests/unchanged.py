"""Outcomes of commands held against what they were: each result, each column, each note.

Tests of single numbers see what somebody thought of. Where a test has an outcome anyway, all other
numbers of it are compared as well; `make references` stores them anew.

A loop with an encoder amplifies rounding, so that signals of the virtual rig, and what is learned
from them, are others on a machine that rounds otherwise. There nothing is compared. Elsewhere
nothing may change, not even a signal. `tests/conftest.py` sets vector units that all processors
with AVX2 have.
"""

import functools
import hashlib
import json
import math
import os
import re
from pathlib import Path

import numba
import numpy as np
import pytest
import scipy.fft
import scipy.linalg

from rigtool.runfile import open_run
from tests.fixtures.make import digests

STORED = Path(__file__).parent / "fixtures" / "outcomes.json"
STORING = "STORE_OUTCOMES" in os.environ
ROUNDING = 1e-5
"""Part of an uncertainty, of degrees of freedom, and of the rms of a column, by which the same
mathematics in another order differs: 1e-6 and less in twelve analyses of stored runs by numpy and
OpenBLAS as for the oldest processor."""
ZERO = 1e-15
"""What rounding leaves of a column that is zero, in any unit."""
OTHERWISE = 1e-4
"""Such a part where a machine rounds otherwise: searches end elsewhere."""


def require_unchanged(name, outcome):
    """Compare results, tables and notes of an outcome, or of a stored run, with the stored ones."""
    found = {
        "rounding": rounding(),
        "signals": signals_of(outcome),
        "results": {
            key: {
                "value": one.value,
                "u": one.u,
                "dof": None if one.dof == math.inf else one.dof,
                "unit": one.unit,
                "reason": one.reason,
                "lines": [f"{line.name}, {line.unit}" for line in one.budget],
                "budget": [
                    number for line in one.budget for number in (line.contribution, line.dof or 0.0)
                ],
            }
            for key, one in outcome.results.items()
        },
        "tables": digests(name, outcome.tables),
        "notes": [re.sub(r"(?<!\S)/\S*/", "", note) for note in outcome.notes],
    }
    stored = json.loads(STORED.read_text()) if STORED.exists() else {}
    if STORING:
        whole = sorted((stored | {name: found}).items())
        lines = (f" {json.dumps(key)}: {json.dumps(own)}" for key, own in whole)
        STORED.write_text("{\n" + ",\n".join(lines) + "\n}\n")
        return
    known = stored[name]
    if found["rounding"] != known["rounding"]:
        return
    assert found["signals"] == known["signals"], "signals; where it is meant: make references"
    require_results(found["results"], known["results"])
    require_columns(found["tables"], known["tables"])
    assert found["notes"] == known["notes"]


@functools.cache
def rounding():
    """Return a digest of how this machine rounds functions, sums, products and decompositions."""
    drawn = np.random.default_rng(1)
    one, other = drawn.uniform(0.1, 3.0, (2, 257, 131))
    square = one.T @ other
    functions = np.exp, np.log, np.sin, np.cos, np.tan, np.tanh, np.sqrt
    found = [
        *(function(one) for function in functions),
        *(np.arctan2(one, other), np.hypot(one, other), one**other, one @ other[0]),
        *(one.sum(axis=0), one.sum(), one.std(), np.convolve(one[0], other[0]), np.cumsum(one)),
        *(np.interp(one, np.sort(other[0]), other[1]), np.einsum("ij,kj->ik", one, other)),
        *(np.linalg.lstsq(one, other)[0], np.linalg.svd(one)[1], scipy.linalg.qr(one)[1]),
        *(np.linalg.inv(square), scipy.linalg.cholesky(one.T @ one), scipy.fft.rfft(one)),
        [math.exp(x) + math.sin(x) + math.lgamma(x) + x**1.7 for x in one[0]],
        numba.njit(_chaos)(one[0], other[0]),
    ]
    digest = hashlib.sha256(b"".join(np.asarray(part).tobytes() for part in found))
    versions = np.__version__, scipy.__version__, numba.__version__
    return f"{digest.hexdigest()[:16]} {versions}"


def _chaos(one, other):
    """Return values that amplify the rounding of compiled arithmetic, as a loop does."""
    x, y, found = 0.3, 0.1, np.empty(len(one))
    for i in range(len(one)):
        x, y = math.sin(x * one[i] + y) * 1.3, math.exp(-y * y) * other[i] - x * y + math.tanh(x)
        found[i] = x * other[i] + y * one[i] + math.atan2(x, y) + abs(x) ** 1.7
    return found


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


def slack_of(stored):
    """Return the part by which numbers may differ from those that were stored with a rounding."""
    return ROUNDING if rounding() == stored else OTHERWISE


def require_results(found, expected, part_of=ROUNDING):
    """Compare results: the same signals through the same mathematics differ by rounding."""
    assert set(found) == set(expected)
    for result, reference in expected.items():
        own = found[result]
        for part in ("unit", "reason", "lines"):
            assert own.get(part) == reference.get(part), f"{part} of {result}"
        dofs = [math.inf if one["dof"] is None else one["dof"] for one in (own, reference)]
        assert math.isclose(*dofs, rel_tol=part_of), f"dof of {result}: {dofs}"
        for part in ("value", "u"):
            if reference[part] is None:
                assert own[part] is None, result
                continue
            slack = part_of * (reference["u"] or abs(reference["value"]))
            known = pytest.approx(reference[part], rel=ROUNDING, abs=slack, nan_ok=True)
            assert own[part] == known, f"{result}.{part}"
        if "budget" in reference:
            known = pytest.approx(reference["budget"], rel=part_of, abs=slack)
            assert own["budget"] == known, f"budget of {result}"


def require_columns(found, expected, part_of=ROUNDING):
    """Compare units, types and digests of columns."""
    assert set(found) == set(expected)
    for column, (unit, kind, count, *reference) in expected.items():
        assert found[column][:3] == [unit, kind, count], column
        slack = part_of * math.hypot(*reference[:2]) + ZERO
        assert found[column][3:] == pytest.approx(reference, rel=0, abs=slack), column
