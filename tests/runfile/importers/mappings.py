"""A mapping and a good text file for the tests of importers."""

import numpy as np

from rigtool.recipe.mapping import parse_mapping
from rigtool.runfile.importers import import_files

TEXT = """mapping = 1
[rig]
name = "bench"
encoder_counts = 4096
torque_constant = 0.045
[file]
comment = "%"
[signals]
time = { column = 1, unit = "ms" }
encoder = { column = 2, unit = "count" }
current = { column = 3, unit = "mA", offset = 2, scale = 10, sign = -1 }
"""
ROWS = 50


def columns(rows=ROWS):
    """Time, counts and a signal with all digits of a double."""
    time = np.arange(rows) * 2.0
    return time, np.arange(rows) * 7.0 - 3, np.sin(np.arange(rows)) * 0.1


def lines(rows=ROWS):
    """The same as lines of text with full precision."""
    return [
        ",".join(repr(float(value)) for value in row) for row in zip(*columns(rows), strict=True)
    ]


def mapping(text=TEXT):
    """A mapping with its text, as `import_files` takes it."""
    return parse_mapping(text), text


def take(source, output, text=TEXT, **options):
    """Import one file."""
    return import_files([str(source)], str(output), mapping(text), **options)
