"""The contents of a run file: channels of recordings, and tables of results."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rigtool.errors import RunFileError, UsageError
from rigtool.runfile import schema
from rigtool.signals import is_name

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr


@dataclass(frozen=True)
class Channel:
    """One recorded signal: `dtype` is u1, i4, f4 or f8 in the file; readers always get f8.

    Raises `ValueError` for another type or a name that cannot be stored.
    """

    name: str
    unit: str
    dtype: str
    description: str

    def __post_init__(self) -> None:
        _require_names("channel", [self.name])
        if self.dtype not in schema.DTYPES:
            raise ValueError(
                f"channel {self.name}: dtype {self.dtype!r} cannot be stored, use one of "
                f"{', '.join(schema.DTYPES)}"
            )


@dataclass(frozen=True)
class RecordingSpec:
    """A recording before it is made: its channels on one `time`, and under which conditions.

    `conditions` maps a name to (value, unit), e.g. `{"speed": (3.0, "rad/s")}`. A viewer plots the
    first channel other than `time`. A sample is the mean of `record_every` samples of the loop.
    What a killed run may lose are `chunk` samples. Raises `ValueError` for names or channels that
    do not fit.
    """

    name: str
    channels: tuple[Channel, ...]
    conditions: Mapping[str, tuple[float, str]] = field(default_factory=dict)
    record_every: int = 1
    chunk: int = schema.CHUNK

    def __post_init__(self) -> None:
        names = [channel.name for channel in self.channels]
        _require_names("recording", [self.name])
        _require_names("condition", self.conditions)
        if schema.TIME not in names:
            raise ValueError(f"recording {self.name}: has no channel `{schema.TIME}`")
        if len(names) < 2:
            raise ValueError(f"recording {self.name}: has nothing besides `{schema.TIME}`")
        if len(set(names)) != len(names):
            raise ValueError(f"recording {self.name}: a channel appears twice in {names}")
        if schema.CONDITIONS in names:
            raise ValueError(f"recording {self.name}: a channel cannot be called `conditions`")

    @property
    def signal(self) -> str:
        """The channel that a viewer plots."""
        return next(c.name for c in self.channels if c.name != schema.TIME)


@dataclass(frozen=True, eq=False)
class Column:
    """Values of one column, their unit and meaning. NaN stands for 'no value'."""

    values: NDArray[Any]
    unit: str
    description: str = ""

    def __init__(self, values: ArrayLike, unit: str, description: str = "") -> None:
        vars(self).update(values=_storable(np.asarray(values)), unit=unit, description=description)


def dof_column(values: ArrayLike) -> Column:
    """Return the degrees of freedom of a column `u`; infinite where they are so or not known."""
    return Column(np.asarray(values, dtype=np.float64), "1", "degrees of freedom of u")


@dataclass(frozen=True, eq=False)
class Table:
    """Columns over one or more axes.

    `axes` name 1-D columns; each other column has the shape of the axes' lengths, or of the
    leading axes. `signal` is the column to plot and has all axes. Raises ValueError otherwise.
    """

    axes: tuple[str, ...]
    columns: Mapping[str, Column]
    signal: str
    description: str

    def __post_init__(self) -> None:
        _require_names("column", self.columns)
        for name in (*self.axes, self.signal):
            if name not in self.columns:
                raise ValueError(f"a table has no column {name!r}, only {list(self.columns)}")
        if not self.axes or len(set(self.axes)) != len(self.axes):
            raise ValueError(f"the axes of a table must be different columns, got {self.axes}")
        if self.signal in self.axes:
            raise ValueError(f"the signal {self.signal!r} of a table cannot be one of its axes")
        for name in self.axes:
            if self.columns[name].values.ndim != 1:
                raise ValueError(f"axis {name!r} must be one-dimensional")
        shape = self.shape
        for name, column in self.columns.items():
            if name in self.axes:
                continue
            here = column.values.shape
            if not here or here != shape[: len(here)]:
                raise ValueError(
                    f"column {name!r} has shape {here}, the axes {self.axes} ask for {shape}"
                )
        if self.columns[self.signal].values.shape != shape:
            raise ValueError(f"the signal {self.signal!r} does not have all axes {self.axes}")
        size = sum(column.values.size for column in self.columns.values())
        if size > schema.MAX_TABLE_VALUES:
            raise ValueError(
                f"a table of {size} values is above the limit of {schema.MAX_TABLE_VALUES}: "
                "store it at fewer points"
            )

    @property
    def shape(self) -> tuple[int, ...]:
        """Lengths of the axes."""
        return tuple(self.columns[name].values.size for name in self.axes)

    def __getitem__(self, column: str) -> NDArray[Any]:
        """Return the values of a column; raises `RunFileError` where the table lacks it."""
        if column not in self.columns:
            raise RunFileError(
                f"a table has no column {column!r}, only {', '.join(self.columns)}: make this run "
                "again with this rigtool"
            )
        return self.columns[column].values

    def to_pandas(self) -> pd.DataFrame:
        """Return one row for each point of the axes; columns with fewer axes repeat.

        Units are in `attrs["units"]`.
        """
        import pandas as pd

        columns = {}
        for name, column in self.columns.items():
            if name in self.axes:
                shape = [1] * len(self.shape)
                shape[self.axes.index(name)] = -1
            else:
                shape = [*column.values.shape, *[1] * (len(self.shape) - column.values.ndim)]
            columns[name] = np.broadcast_to(column.values.reshape(shape), self.shape).ravel()
        frame = pd.DataFrame(columns)
        frame.attrs["units"] = {name: column.unit for name, column in self.columns.items()}
        return frame

    def to_xarray(self) -> xr.Dataset:
        """Return the columns over their axes; attributes `units` and `long_name` as in the file.

        Raises `UsageError` where xarray is missing.
        """
        return dataset(self.axes, self.columns)


def dataset(axes: tuple[str, ...], columns: Mapping[str, Column]) -> xr.Dataset:
    """Return columns over axes as xarray has them; `UsageError` where xarray is missing."""
    try:
        import xarray as xr
    except ImportError:
        raise UsageError(
            "to_xarray needs the package xarray, which is not installed: `pip install xarray`, or "
            "take to_pandas"
        ) from None
    variables = {
        name: xr.Variable(
            (name,) if name in axes else axes[: column.values.ndim],
            column.values,
            {"units": column.unit, "long_name": column.description},
        )
        for name, column in columns.items()
    }
    return xr.Dataset(variables)


def description_of(attributes: Mapping[str, Any]) -> str:
    """Return the description in the attributes of a channel, column or table."""
    return str(attributes.get("long_name", ""))


def _require_names(what: str, names: Iterable[str]) -> None:
    for name in names:
        if not is_name(name):
            raise ValueError(
                f"{what} name {name!r}: use letters, digits and underscores, not a digit first"
            )


def _storable(values: NDArray[Any]) -> NDArray[Any]:
    """Return the values in one of the types a file may hold."""
    if values.dtype in schema.DTYPES.values():
        return values
    if values.dtype.kind == "b":
        return values.astype(schema.DTYPES["u1"])
    if values.dtype.kind in "iu":
        limits = np.iinfo(np.int32)
        if values.size == 0 or (limits.min <= values.min() and values.max() <= limits.max):
            return values.astype(schema.DTYPES["i4"])
    if values.dtype.kind in "iuf":
        return values.astype(schema.DTYPES["f8"])
    raise ValueError(f"a column holds numbers, not {values.dtype}")
