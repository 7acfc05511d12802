"""Run files: HDF5 that NeXus viewers, xarray, MATLAB and h5dump open (docs/run-file-format.md)."""

from rigtool.runfile.model import Channel, Column, RecordingSpec, Table, dof_column
from rigtool.runfile.reader import Run, open_run
from rigtool.runfile.recording import Recording
from rigtool.runfile.schema import chunk_of
from rigtool.runfile.writer import RunWriter

__all__ = [
    "Channel",
    "Column",
    "Recording",
    "RecordingSpec",
    "Run",
    "RunWriter",
    "Table",
    "chunk_of",
    "dof_column",
    "open_run",
]
