"""Names, version and limits of the run file, which `docs/run-file-format.md` describes.

A change here also changes that document, its version history and `VERSION`. A new minor version
adds elements that older readers may ignore; older readers refuse a new major version.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

SCHEMA = "rigtool-run"
VERSION = (1, 2)

ENTRY = "entry"
RECORDINGS = "recordings"
TABLES = "tables"
RESULTS = "results"
PROVENANCE = "provenance"
CONDITIONS = "conditions"
INPUTS = "inputs"
TIME = "time"

IMPORT = "import"
"""Command that made an imported run."""

IMPORTED = "imported"
"""Its one recording; of several parts, the beginning of their names."""

MAP = "map"
"""Its table, where it is a map of the turn."""

BUDGET = ("name", "value", "unit", "u", "dof", "sensitivity")
"""Fields of `Component`: each is an attribute `budget_FIELD` of a result, one value a line."""

BUDGET_TEXTS = ("name", "unit")

CHUNK = 8192
"""Most samples in a chunk of a signal: one second at 8 kHz."""

SMALLEST_CHUNK = 32
"""Fewest samples in a chunk; both are powers of two, so that blocks end where chunks do."""

DTYPES: dict[str, np.dtype[Any]] = {name: np.dtype(f"<{name}") for name in ("u1", "i4", "f4", "f8")}
"""The only numeric types in a file; others crash or confuse one reader or another."""

DEFLATE_LEVEL = 1
"""Chunks are shuffled, packed by deflate and checked by Fletcher's sum."""

LIBVER = ("v110", "v110")
"""`latest` would mean HDF5 2.0, which h5dump 1.10 and MATLAB cannot read."""

PAGE_SETTINGS: dict[str, Any] = {"fs_strategy": "page", "fs_page_size": 4096}
"""With these settings no object smaller than a page crosses the edge of a page ("paged
aggregation", H5Pset_file_space_strategy). A kernel stops the write of a killed process between two
pages of memory: a header that HDF5 rewrites in place is then the old one or the new one, never half
of each."""


def chunk_of(rate_hz: float) -> int:
    """Return the samples of a chunk of about a second: a killed run loses one chunk."""
    samples = 2 ** math.ceil(math.log2(max(rate_hz, 1.0)))
    return min(max(samples, SMALLEST_CHUNK), CHUNK)


# Limits of what a file may claim, checked from its headers before anything is read.
MAX_SAMPLES = 2**31
MAX_CHUNK_BYTES = 2**24
MAX_TABLE_VALUES = 2**24
MAX_MEMBERS = 10_000
MAX_ATTRIBUTE_VALUES = 10_000
MAX_OBJECTS = 100_000
"""Groups, datasets and attributes together."""
MAX_SAMPLE_BYTES, MAX_EXPANSION = 2**30, 100
"""Bytes of all samples together, and times the size of the file where that is more."""
MAX_TEXT_BYTES = 2**26
"""Of all texts together."""
MAX_COMPRESSION = 1100
"""Deflate cannot shrink by more than 1032; a dataset that claims more is not in the file."""

LARGEST_NUMBER = 1e30
"""Largest sample, result or entry of a table that a command computes with, in SI units: far beyond
any rig, and its powers stay numbers."""


def version_text() -> str:
    """Return the version of the schema that this rigtool writes."""
    return f"{VERSION[0]}.{VERSION[1]}"
