"""One process at a time: a lock that ends with its process, also where that is killed."""

import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

PATIENCE = 600.0
"""Seconds to wait for who has the lock: ten times what anything takes under it."""


@contextmanager
def alone(path: Path) -> Iterator[None]:
    """Hold the lock of a path that all processes name; sqlite knows how each system locks."""
    with closing(sqlite3.connect(path, timeout=PATIENCE, isolation_level=None)) as lock:
        lock.execute("BEGIN EXCLUSIVE")
        yield
