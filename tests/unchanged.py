"""Outcomes of commands held against what they were: each result, each column, each note.

Tests of single numbers see what somebody thought of. Where a test has an outcome anyway, all other
numbers of it are compared as well; `make references` stores them anew.

A loop with an encoder amplifies rounding, so that signals of the virtual rig, and what is learned
from them, are others on another processor. On the processor of the stored numbers nothing may
change, not even a signal; on another one, outcomes of signals that a test makes differ by its
rounding, and those of the virtual rig by as much as they scatter.
"""

import functools
import hashlib
import json
import math
import os
import re
from pathlib import Path

import llvmlite.binding
import numba
import numpy as np
import pytest
import scipy

from rigtool.runfile import open_run
from tests.fixtures.make import digests

STORED = Path(__file__).parent / "fixtures" / "outcomes.json"
STORING = "STORE_OUTCOMES" in os.environ
ROUNDING = 1e-5
"""Part of an uncertainty, of degrees of freedom, and of the rms of a column, by which the same
mathematics differs on another processor: 1e-6 and less in twelve analyses of stored runs by numpy
and OpenBLAS as for the oldest one."""
ZERO = 1e-15
"""What rounding leaves of a column that is zero, in any unit."""
SEARCHED = 1e-3
"""Such a part where a search ends elsewhere by the rounding of another processor."""
SCATTER, FACTOR = 5.0, 5.0
"""Uncertainties by which values differ, and the factor on these, with other signals."""


def require_unchanged(name, outcome):
    """Compare results, tables and notes of an outcome, or of a stored run, with the stored ones."""
    found = {
        "processor": processor(),
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
    known, rounding = stored[name], SEARCHED
    if found["processor"] == known["processor"]:
        assert found["signals"] == known["signals"], "signals; where it is meant: make references"
        rounding = ROUNDING
    elif found["signals"] is not None:
        require_alike(found, known)
        return
    require_results(found["results"], known["results"], rounding)
    require_columns(found["tables"], known["tables"], rounding)
    assert found["notes"] == known["notes"]


@functools.cache
def processor():
    """Return a digest of what decides how numbers are rounded."""
    features = sorted(llvmlite.binding.get_host_cpu_features().items())
    versions = np.__version__, scipy.__version__, numba.__version__
    text = repr((llvmlite.binding.get_host_cpu_name(), features, versions))
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def require_alike(found, known):
    """Compare what other signals of the same rig leave as it is, or change by scatter."""
    assert set(found["results"]) == set(known["results"])
    for result, reference in known["results"].items():
        own = found["results"][result]
        for part in ("unit", "reason", "lines"):
            assert own[part] == reference[part], f"{part} of {result}"
        assert (own["u"] is None) == (reference["u"] is None), result
        if own["u"] and (reference["dof"] or math.inf) > 2:  # of fewer, u says nothing
            assert 1 / FACTOR < own["u"] / reference["u"] < FACTOR, f"u of {result}"
            slack = SCATTER * reference["u"]
            assert own["value"] == pytest.approx(reference["value"], abs=slack, nan_ok=True), result
    columns = [
        {column: own[:2] for column, own in tables.items()}
        for tables in (found["tables"], known["tables"])
    ]
    assert columns[0] == columns[1]
    words = [[re.sub(r"[-+\d.e]*\d", "", note) for note in one["notes"]] for one in (found, known)]
    assert words[0] == words[1]


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


def require_results(found, expected, rounding=ROUNDING):
    """Compare results: the same signals through the same mathematics differ by rounding."""
    assert set(found) == set(expected)
    for result, reference in expected.items():
        own = found[result]
        for part in ("unit", "reason", "lines"):
            assert own.get(part) == reference.get(part), f"{part} of {result}"
        dofs = [math.inf if one["dof"] is None else one["dof"] for one in (own, reference)]
        assert math.isclose(*dofs, rel_tol=rounding), f"dof of {result}: {dofs}"
        for part in ("value", "u"):
            if reference[part] is None:
                assert own[part] is None, result
                continue
            slack = rounding * (reference["u"] or abs(reference["value"]))
            known = pytest.approx(reference[part], rel=ROUNDING, abs=slack, nan_ok=True)
            assert own[part] == known, f"{result}.{part}"
        if "budget" in reference:
            known = pytest.approx(reference["budget"], rel=rounding, abs=slack)
            assert own["budget"] == known, f"budget of {result}"


def require_columns(found, expected, rounding=ROUNDING):
    """Compare units, types and digests of columns."""
    assert set(found) == set(expected)
    for column, (unit, kind, count, *reference) in expected.items():
        assert found[column][:3] == [unit, kind, count], column
        slack = rounding * math.hypot(*reference[:2]) + ZERO
        assert found[column][3:] == pytest.approx(reference, rel=0, abs=slack), column
