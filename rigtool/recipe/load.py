"""Reading recipes; all mistakes are reported at once, each with its line."""

import json
import os
import tomllib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Self, TypeVar

from pydantic import BaseModel, ValidationError, model_validator
from pydantic_core import InitErrorDetails

from rigtool.errors import RecipeError, UsageError
from rigtool.inputs import open_input
from rigtool.recipe import commands
from rigtool.recipe.base import Section
from rigtool.recipe.mistakes import described_mistakes
from rigtool.recipe.rig import RigDescription
from rigtool.recipe.serial import Serial
from rigtool.recipe.virtual import Sine, Virtual

Document = TypeVar("Document", bound=Section)

RECIPE_VERSION = 1

MAX_BYTES = 2**18
"""Of a recipe or mapping."""

MAX_DOTS = 1000
"""In a line of it: of numbers and of keys with parts."""

MAX_DEPTH = 20
"""Tables and lists within each other."""

AVERAGED = (
    ("calibrate_kt",),
    ("stribeck",),
    ("fft_ripple",),
    ("ilc_learn", "loads"),
    ("ilc_learn", "turning"),
    ("measure_force",),
)
"""Tables whose default of `record_every` averages over a time: other loops average as long."""


class Recipe(Section):
    """A recipe: the rig, parameters of the virtual rig, and settings of the commands."""

    recipe: int
    rig: RigDescription
    virtual: Virtual | None = None
    serial: Serial | None = None
    calibrate_kt: commands.CalibrateKt = commands.CalibrateKt()
    stribeck: commands.Stribeck = commands.Stribeck()
    fft_ripple: commands.FftRipple = commands.FftRipple()
    identify_plant: commands.IdentifyPlant = commands.IdentifyPlant()
    suspension: commands.Suspension = commands.Suspension()
    ilc_learn: commands.IlcLearn = commands.IlcLearn()
    measure_force: commands.MeasureForce = commands.MeasureForce()
    requirements: commands.Requirements = commands.Requirements()

    @model_validator(mode="before")
    @classmethod
    def _averages_as_long(cls, data: object) -> object:
        rig = data.get("rig") if isinstance(data, dict) else None
        interval = rig.get("sample_time") if isinstance(rig, dict) else None
        if not isinstance(interval, int | float) or not interval > 0:
            return data  # as the fields report, or as by default
        usual = RigDescription.model_fields["sample_time"].default
        for tables in AVERAGED:
            data = _with_record_every(data, cls, tables, usual / interval)
        return data

    @model_validator(mode="after")
    def _has_its_source(self) -> Self:
        if self.rig.source == "serial" and self.serial is None:
            raise ValueError(
                'rig.source is "serial" and there is no table [serial]: add one with driver, port '
                "and [serial.limits]"
            )
        return self

    @model_validator(mode="after")
    def _loop_follows_contacts(self) -> Self:
        highest = 0.1 / self.rig.sample_time
        for contact in self.virtual.contact if self.virtual is not None else ():
            if isinstance(contact, Sine) and contact.frequency_hz[1] > highest:
                raise ValueError(
                    f"virtual.contact: frequency_hz {contact.frequency_hz[1]:g} Hz is above a "
                    f"tenth of the loop's rate, {highest:g} Hz: lower it"
                )
        return self

    @property
    def line(self) -> Serial:
        """The table [serial], which the recipe of a rig on a line has."""
        assert self.serial is not None, "the rig is on no line"
        return self.serial

    @property
    def highest_current(self) -> float:
        """The lowest of the limits of current, A: of the amplifier, and of a rig on a line."""
        own = self.rig.current_limit
        return min(own, self.line.limits.current) if self.rig.source == "serial" else own

    def resolved(self) -> str:
        """Return the recipe with all defaults filled in, as canonical JSON."""
        return json.dumps(self.model_dump(mode="json"), sort_keys=True)


def _with_record_every(
    data: Any, model: type[BaseModel], tables: tuple[str, ...], factor: float
) -> Any:
    """Return tables of a recipe with a default of `record_every` that is `factor` times as large.

    What is no table is left to the fields to report.
    """
    if not isinstance(data, dict):
        return data
    if not tables:
        usual = model.model_fields["record_every"].default
        every = min(max(usual * factor, 1), Section.LARGEST_COUNT)
        return {"record_every": round(every)} | data
    inner: Any = model.model_fields[tables[0]].annotation
    table = data.get(tables[0], {})
    return data | {tables[0]: _with_record_every(table, inner, tables[1:], factor)}


def load_recipe(path: str | Path, overrides: Sequence[str] = ()) -> tuple[Recipe, str]:
    """Read a recipe file and return it with its text, verbatim.

    `overrides` are `key=value` strings with dotted keys, as the option `--set` takes them.
    Raises `RecipeError` with every mistake and its line.
    """
    text = read_document(path, "recipe", "recipe briaire-2006")
    return parse_recipe(text, str(path), overrides), text


def parse_recipe(text: str, name: str = "recipe", overrides: Sequence[str] = ()) -> Recipe:
    """Turn the text of a recipe into its model; `name` stands in messages.

    Raises `RecipeError` with every mistake and its line.
    """
    data = parse_toml(text, name)
    _require_recipe(data, name)
    for override in overrides:
        _apply_override(data, override)
    return validate(Recipe, data, text, name, "recipe", overrides)


def read_document(path: str | Path, kind: str, example: str, *, pipe: bool = True) -> str:
    """Return the text of a recipe or mapping; `RecipeError` where the file cannot be read.

    A `pipe` is read to its end, once.
    """
    if not os.path.lexists(path):
        raise RecipeError(f"{path}: no such {kind}; `rigtool {example}` shows one")
    try:
        with open_input(path, RecipeError, pipe=pipe) as file:
            data = file.read(MAX_BYTES + 1)
        text = data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise RecipeError(
            f"{path}: is no {kind}: byte {error.start} is not UTF-8; give a text, saved in UTF-8"
        ) from None
    if len(data) > MAX_BYTES:
        raise RecipeError(f"{path}: is larger than {MAX_BYTES} bytes: it is no {kind}")
    return text.replace("\r\n", "\n")


def parse_toml(text: str, name: str) -> dict[str, Any]:
    """Return the tables of a TOML text; `RecipeError` where it is not valid, or beyond limits."""
    # The parser needs the square of the parts of a key.
    if any(line.count(".") > MAX_DOTS for line in text.splitlines()):
        raise RecipeError(f"{name}: a line has more than {MAX_DOTS} dots: divide it")
    try:
        data = tomllib.loads(text)
    except RecursionError:
        raise RecipeError(f"{name}: is nested more than {MAX_DEPTH} deep: flatten it") from None
    except ValueError as error:  # also for an integer with more digits than Python reads
        raise RecipeError(f"{name}: is not valid TOML: {error}") from None
    waiting: list[tuple[Any, int]] = [(data, 0)]
    while waiting:
        value, depth = waiting.pop()
        if depth > MAX_DEPTH:
            raise RecipeError(f"{name}: is nested more than {MAX_DEPTH} deep: flatten it")
        if isinstance(value, int) and not -(2**63) <= value < 2**63:
            raise RecipeError(f"{name}: an integer is beyond the 64 bits of TOML: correct it")
        if isinstance(value, dict | list):
            parts = value.values() if isinstance(value, dict) else value
            waiting += [(part, depth + 1) for part in parts]
    return data


def validate(
    model: type[Document],
    data: dict[str, Any],
    text: str,
    name: str,
    kind: str,
    overrides: Sequence[str] = (),
) -> Document:
    """Return the model of a TOML `text`; `RecipeError` lists all mistakes with their lines."""
    try:
        found = model.model_validate(data)
        _require_read(data, found)
        return found
    except ValidationError as error:
        raise RecipeError(
            described_mistakes(error, model, text, data, name, kind, overrides)
        ) from None


def _require_read(given: object, found: object) -> None:
    if misread := list(_misread(given, found)):
        raise ValidationError.from_exception_data("", misread)


def _misread(
    given: object, found: object, place: tuple[str | int, ...] = ()
) -> Iterator[InitErrorDetails]:
    """Yield where true or false was given for a number: pydantic reads them as 1 and 0."""
    if isinstance(given, bool) and not isinstance(found, bool):
        yield InitErrorDetails(type="float_type", loc=place, input=given)
    elif isinstance(given, dict):
        for key, part in given.items():
            read = found[key] if isinstance(found, dict) else getattr(found, key)
            yield from _misread(part, read, (*place, key))
    elif isinstance(given, list) and isinstance(found, tuple | list):
        for number, (part, read) in enumerate(zip(given, found, strict=True)):
            yield from _misread(part, read, (*place, number))


def recipe_from_resolved(text: str) -> Recipe:
    """Turn the resolved JSON that a run file keeps back into a recipe.

    Raises `RecipeError` where it does not fit this version.
    """
    try:
        return Recipe.model_validate_json(text)
    except ValidationError as error:
        raise RecipeError(
            f"the recipe stored in the run file does not fit this version of rigtool: "
            f"{error.errors()[0]['msg']}"
        ) from None


def override_recipe(recipe: Recipe, overrides: Sequence[str]) -> Recipe:
    """Return a recipe with `key=value` overrides applied; raises `RecipeError` as `load_recipe`."""
    data = recipe.model_dump()
    for override in overrides:
        _apply_override(data, override)
    return validate(Recipe, data, "", "recipe", "recipe", overrides)


def _require_recipe(data: dict[str, Any], name: str) -> None:
    version = data.get("recipe")
    if version is None or "rig" not in data:
        raise RecipeError(
            f"{name}: is TOML but not a recipe of rigtool: it needs `recipe = {RECIPE_VERSION}` "
            "at its top and a table [rig]"
        )
    if version != RECIPE_VERSION:
        raise RecipeError(
            f"{name}: recipe version {version!r}, this rigtool reads version {RECIPE_VERSION}"
        )


def _apply_override(data: dict[str, Any], override: str) -> None:
    key, equals, value = override.partition("=")
    if not equals or not all(part.strip() for part in key.split(".")):
        raise UsageError(f"--set {override!r}: expected key=value, e.g. rig.attachment=pulley")
    *tables, last = key.strip().split(".")
    if len(tables) > MAX_DEPTH:
        raise UsageError(f"--set {key[:40]!r}...: a key has at most {MAX_DEPTH} parts")
    try:
        parsed = parse_toml(f"value = {value}", "--set")["value"]
    except RecipeError as error:
        if "is not valid TOML" not in str(error):
            raise
        parsed = value.strip()  # a bare word is a string
    target = data
    for table in tables:
        target = target.setdefault(table, {})
        if not isinstance(target, dict):
            raise UsageError(f"--set {override!r}: {table!r} is a value, not a table")
    target[last] = parsed
