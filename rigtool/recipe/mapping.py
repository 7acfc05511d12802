"""Mappings: the meaning of the columns of a foreign file, in TOML.

    value = sign * (scale * raw + offset), in `unit`, then turned into SI

A mapping states what the file does not: the knowledge of the person who measured.
"""

import math
import re
from pathlib import Path
from typing import ClassVar, Literal, Self

from pydantic import Field, field_validator, model_validator

from rigtool.errors import RecipeError
from rigtool.recipe.base import Section
from rigtool.recipe.load import parse_toml, read_document, validate
from rigtool.recipe.units import DATE, RATED, UNITS, ZEROS, require_unit, unit_name
from rigtool.signals import SIGNALS, is_name

MAPPING_VERSION = 1

CONSTANT_SPEED = "constant_speed"
"""Condition that states the speed of a recording without position or speed, rad/s."""

RIG_CONDITIONS = {
    "encoder_counts": "count",
    "torque_constant": "N m/A",
    "torque_constant_u": "N m/A",
    "rated_torque": "N m",
    "inertia": "kg m2",
    "arm_length": "m",
    "gear_ratio": "1",
    "reference_relative_u": "1",
    "linear_axis": "1",
}
"""Conditions of all recordings of an import that describe the rig, and their units."""


class ImportedRig(Section):
    """Properties of the rig, as far as the person who measured knows them."""

    LARGEST_COUNT: ClassVar[int] = 2**40

    name: str = Field(min_length=1, description="which rig this is")
    axis: Literal["rotary", "linear"] = Field("rotary", description="rad and N m, or m and N")
    encoder_counts: int | None = Field(
        None, ge=1, description="quad counts a turn, or a metre on a linear axis"
    )
    torque_constant: float | None = Field(None, gt=0, description="N m/A, of the data sheet")
    torque_constant_u: float | None = Field(
        None, gt=0, description="standard uncertainty of it, N m/A"
    )
    rated_torque: float | None = Field(
        None, gt=0, description="nominal torque of the motor, N m, for torque in percent"
    )
    inertia: float | None = Field(None, gt=0, description="on the motor shaft, kg m2")
    arm_length: float | None = Field(
        None, gt=0, description="between the shaft and the force sensor on it, m"
    )
    gear_ratio: float | None = Field(
        None, ge=-1e6, le=1e6, description="turns of the motor for one turn of the output"
    )
    reference_relative_u: float | None = Field(
        None, gt=0, lt=1, description="standard uncertainty of the sensor's calibration, relative"
    )

    @model_validator(mode="after")
    def _fits_axis(self) -> Self:
        if self.gear_ratio == 0:
            raise ValueError("gear_ratio 0: give turns of the motor for one turn of the output")
        if self.axis == "linear" and self.torque_constant is not None:
            raise ValueError(
                f"torque_constant {self.torque_constant:g} N m/A has no meaning on a linear axis, "
                'where current makes force: take it out, or set axis = "rotary"'
            )
        return self

    @property
    def linear_axis(self) -> float | None:
        """One for a linear axis, as a condition of its recordings."""
        return 1.0 if self.axis == "linear" else None


class FileLayout(Section):
    """How the file is written. Binary files use `variable` and `sampling_rate_hz` only."""

    delimiter: str | None = Field(
        None,
        min_length=1,
        max_length=10,
        description='one character, or "whitespace"; default: the one that the lines show',
    )
    comment: str | None = Field(
        None, min_length=1, description="begins what is left out, to the end of the line"
    )
    decimal: Literal[".", ","] | None = Field(
        None, description="decimal mark; default: the one that the lines show"
    )
    header_lines: int | None = Field(
        None,
        ge=0,
        description="lines before the numbers, comments not counted; one of them names the "
        "columns. Default: all lines before the first number",
    )
    variable: str | None = Field(
        None, description="which matrix of the file holds columns given by number"
    )
    sampling_rate_hz: float | None = Field(
        None, gt=0, description="where no signal is the time, Hz"
    )

    @model_validator(mode="after")
    def _delimiter_is_known(self) -> Self:
        if self.delimiter is None:
            return self
        if len(self.delimiter) > 1 and self.delimiter != "whitespace":
            raise ValueError('delimiter must be one character, or "whitespace"')
        if self.delimiter == self.decimal:
            raise ValueError(f"{self.decimal!r} cannot be both delimiter and decimal mark")
        return self


class Signal(Section):
    """One column: its place in the file, and its conversion to SI."""

    column: int | str = Field(description="number from 1, or name")
    unit: str = Field(description="of scale*raw + offset")
    scale: float = Field(1.0, ge=-1e15, le=1e15, description="for the raw value")
    offset: float = Field(0.0, ge=-1e15, le=1e15, description="added after scaling, in `unit`")
    sign: Literal[1, -1] = Field(1, description="-1 where the sensor counts the other way")
    time: int | str | None = Field(
        None, description="column of its own time, in the unit of `time`, where it has one"
    )
    nanoseconds: int | str | None = Field(
        None, description="column of nanoseconds, to be added to a time in s"
    )
    counts_per_turn: float | None = Field(
        None, gt=0, description="turns counts into rad; per metre on a linear axis, into m"
    )
    wraps_at: float | None = Field(
        None, gt=0, description="raw value at which the counter starts again from zero"
    )
    description: str = Field("", description="what it is, for names without a fixed meaning")

    @field_validator("unit")
    @classmethod
    def _unit_is_known(cls, unit: str) -> str:
        return require_unit(unit, [RATED])

    @model_validator(mode="after")
    def _makes_sense(self) -> Self:
        for column in (self.column, self.time, self.nanoseconds):
            if isinstance(column, int) and column < 1:
                raise ValueError(f"columns are counted from 1, got {column}")
        if self.scale == 0:
            raise ValueError("scale 0 leaves nothing of the signal")
        if self.counts_per_turn is not None and self.unit not in ("count", "count/s"):
            raise ValueError('counts_per_turn goes with unit = "count" or "count/s"')
        if self.nanoseconds is not None and (self.unit, self.scale) != ("s", 1.0):
            raise ValueError('nanoseconds go with whole seconds: unit = "s", no scale')
        return self


MAX_CONDITIONS = 100
"""Of a mapping: each pattern may take 0.2 s."""

MAX_PATTERN = 1000
"""Characters of a pattern, which is for the name of a file."""

MAX_REPEATS = 3
"""Repeats in a pattern: n of them may take the length of a file's name to the power n + 1."""

_ATOM = re.compile(r"\\.|\[\^?\]?(?:\\.|[^\]\\])*\]", re.DOTALL)


def require_quick(pattern: str) -> None:
    """Raise ValueError for a regular expression that may backtrack without end."""
    if len(pattern) > MAX_PATTERN:
        raise ValueError(f"pattern has {len(pattern)} characters, at most {MAX_PATTERN} are read")
    plain = _ATOM.sub("x", pattern)
    if re.search(r"\)[*+{]", plain):
        raise ValueError("pattern repeats a group, which may take for ever: repeat a character")
    repeats = len(re.findall(r"[*+{]", plain)) + len(re.findall(r"(?<![(*+?}])\?", plain))
    if repeats > MAX_REPEATS:
        raise ValueError(f"pattern has {repeats} repeats, at most {MAX_REPEATS} are matched")


class Condition(Section):
    """A condition: contained in a name, in a column by which the file is split, or stated."""

    name: str = Field(description="of the condition, e.g. compensation")
    unit: str = Field("1", description="of the number, turned into SI where it is a known unit")
    of: Literal["file", "folder"] = Field("file", description="whose name contains it")
    pattern: str | None = Field(
        None, description="regular expression for that name, of a file without ending"
    )
    column: int | str | None = Field(
        None, description="number or name: the file is split where its value changes"
    )
    value: float | None = Field(None, description="number for all files")
    values: dict[str, float] | None = Field(
        None, description="number for the text found; without it the text is the number"
    )

    @model_validator(mode="after")
    def _is_one(self) -> Self:
        if sum(given is not None for given in (self.pattern, self.column, self.value)) != 1:
            raise ValueError("give one of `pattern`, `column` and `value`")
        if not is_name(self.name):
            raise ValueError("name: use letters, digits and underscores, not a digit first")
        if self.name == CONSTANT_SPEED and self.si_unit != "rad/s":
            raise ValueError(f"{CONSTANT_SPEED} is a speed: give its unit, e.g. rpm")
        if isinstance(self.column, int) and self.column < 1:
            raise ValueError(f"columns are counted from 1, got {self.column}")
        if self.pattern is not None:
            self._require_one_group(self.pattern)
        return self

    @staticmethod
    def _require_one_group(pattern: str) -> None:
        require_quick(pattern)
        try:
            groups = re.compile(pattern).groups
        except re.error as error:
            raise ValueError(f"pattern is no regular expression: {error}") from None
        if groups != 1:
            raise ValueError(f"pattern needs one pair of parentheses, has {groups}")

    @property
    def si_unit(self) -> str:
        """SI unit of `unit`; a unit that is not known stays."""
        return UNITS.get(unit_name(self.unit), (1.0, self.unit))[1]

    def si(self, value: float) -> tuple[float, str]:
        """Return a number in `unit` in its SI unit, and that unit."""
        unit = unit_name(self.unit)
        return value * UNITS.get(unit, (1.0, ""))[0] + ZEROS.get(unit, 0.0), self.si_unit


class Map(Section):
    """A file without time: values around a turn, at equal steps or with their angles."""

    signal: str = Field(description="name, e.g. current")
    unit: str = Field(description="of the values")
    missing: float | None = Field(None, description="value where nothing was sampled")
    column: int | str | None = Field(None, description="of the values, in a file with several")
    angle: Signal | None = Field(None, description="column of the angles; default: equal steps")

    @field_validator("unit")
    @classmethod
    def _unit_is_known(cls, unit: str) -> str:
        return require_unit(unit)

    @model_validator(mode="after")
    def _is_known(self) -> Self:
        if self.angle is not None and self.column is None:
            raise ValueError("a map with a column of angles needs `column`, that of the values")
        angle = self.angle
        if angle is not None and angle.counts_per_turn is None and UNITS[angle.unit][1] != "rad":
            raise ValueError("angle: give an angle, or counts with counts_per_turn")
        if not is_name(self.signal):
            raise ValueError("signal: use letters, digits and underscores, not a digit first")
        return self


class Mapping(Section):
    """A whole mapping file."""

    mapping: Literal[1]
    files: str | None = Field(
        None,
        min_length=1,
        max_length=200,
        description="names of the files that it is for, with * and ? for any characters",
    )
    rig: ImportedRig
    file: FileLayout = FileLayout()
    signals: dict[str, Signal] = Field(default_factory=dict)
    conditions: tuple[Condition, ...] = Field((), max_length=MAX_CONDITIONS)
    map: Map | None = None

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        if self.map is not None and self.signals:
            raise ValueError("a file is a [map] or has [signals], not both")
        if self.map is not None and any(item.column is not None for item in self.conditions):
            raise ValueError("a map is not split: give conditions by `pattern` or `value`")
        for name, signal in self.signals.items():
            if not is_name(name) or name == "conditions":
                raise ValueError(f"signal name {name!r}: use letters, digits and underscores")
            if signal.unit == RATED and self.rig.rated_torque is None:
                raise ValueError(f"signal {name}: its unit needs rated_torque in [rig]")
            found, needed = self.unit(name), self.fixed_unit(name)
            if needed not in (None, found):
                names = ", ".join(n for n in SIGNALS if self.fixed_unit(n) == found)
                raise ValueError(
                    f"signal {name} on a {self.rig.axis} axis is in {needed}, this is in {found}: "
                    f"correct its unit, or its name; in {found}: {names or 'names of your own'}"
                )
        if self.signals and ("time" in self.signals) == (self.file.sampling_rate_hz is not None):
            raise ValueError("give either a signal `time` or sampling_rate_hz in [file]")
        if self.own_times and "time" not in self.signals:
            raise ValueError("a column of its own time needs a signal `time`, whose unit it has")
        if self.signals and set(self.signals) == {"time"}:
            raise ValueError("there is no signal besides time")
        return self

    @property
    def own_times(self) -> list[int | str]:
        """Columns of times of single signals."""
        return [signal.time for signal in self.signals.values() if signal.time is not None]

    @property
    def columns(self) -> list[int | str]:
        """Columns of the signals, of their own times, and of conditions."""
        signals = [signal.column for signal in self.signals.values()]
        signals += [s.nanoseconds for s in self.signals.values() if s.nanoseconds is not None]
        found = [item.column for item in self.conditions if item.column is not None]
        return list(dict.fromkeys([*signals, *self.own_times, *found]))

    @property
    def words(self) -> dict[int | str, dict[str, float]]:
        """Numbers for the texts of columns that hold conditions as text."""
        return {
            item.column: item.values
            for item in self.conditions
            if item.column is not None and item.values is not None
        }

    @property
    def dates(self) -> set[int | str]:
        """Columns of dates or clock times."""
        found = {signal.column for signal in self.signals.values() if signal.unit == DATE}
        return found | set(self.own_times) if found else found

    def fixed_unit(self, name: str) -> str | None:
        """Return the unit that a name has by its fixed meaning, None for other names."""
        if name not in SIGNALS:
            return None
        return SIGNALS[name][0 if self.rig.axis == "rotary" else 1]

    def unit(self, name: str) -> str:
        """Return the SI unit of a signal in the run file."""
        signal = self.signals[name]
        if signal.unit == RATED:
            return "N m"
        turned = "rad" if self.rig.axis == "rotary" else "m"
        found = UNITS[signal.unit][1]
        return found if signal.counts_per_turn is None else found.replace("count", turned)

    def factor(self, name: str) -> float:
        """Return the SI value of one `unit` of a signal."""
        signal = self.signals[name]
        if signal.unit == RATED:
            assert self.rig.rated_torque is not None
            return self.rig.rated_torque / 100
        if signal.counts_per_turn is not None:
            turn = 2 * math.pi if self.rig.axis == "rotary" else 1.0
            return turn / signal.counts_per_turn
        return UNITS[signal.unit][0]

    def zero(self, name: str) -> float:
        """Return what 0 of the unit of a signal is in its SI unit."""
        return ZEROS.get(self.signals[name].unit, 0.0)

    def description(self, name: str) -> str:
        """Return the description of a signal."""
        return self.signals[name].description or SIGNALS.get(name, ("", "", name))[2]


def load_mapping(path: str | Path) -> tuple[Mapping, str]:
    """Read a mapping file and return it with its text; `RecipeError` with every mistake's line."""
    text = read_document(path, "mapping", "recipe import/mis-tool")
    return parse_mapping(text, str(path)), text


def parse_mapping(text: str, name: str = "mapping") -> Mapping:
    """Turn the text of a mapping into its model; `name` stands in messages.

    Raises `RecipeError` with every mistake and its line.
    """
    data = parse_toml(text, name)
    if data.get("mapping") != MAPPING_VERSION:
        raise RecipeError(
            f"{name}: is TOML but not a mapping of this rigtool: it needs "
            f"`mapping = {MAPPING_VERSION}` at its top"
        )
    return validate(Mapping, data, text, name, "mapping")
