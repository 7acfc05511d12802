"""Mistakes in a recipe or mapping, all at once: where each is, and what is expected there."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from typing import Any, get_args

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from rigtool.errors import did_you_mean

EXPECTATIONS = {
    "float_type": "must be a number",
    "float_parsing": "must be a number",
    "finite_number": "must be a finite number",
    "int_type": "must be a whole number",
    "int_parsing": "must be a whole number",
    "int_from_float": "must be a whole number",
    "bool_type": "must be true or false",
    "bool_parsing": "must be true or false",
    "string_type": "must be a text",
    "model_type": "must be a table of keys",
    "dict_type": "must be a table of keys",
    "list_type": "must be a list",
    "tuple_type": "must be a list",
    "literal_error": "must be {expected}",
    "greater_than": "must be above {gt:g}",
    "greater_than_equal": "must be at least {ge:g}",
    "less_than": "must be below {lt:g}",
    "less_than_equal": "must be at most {le:g}",
    "string_too_short": "must not be empty",
    "string_too_long": "takes {max_length} characters at most",
    "too_short": "needs {min_length} values at least",
    "too_long": "takes {max_length} values at most",
    "union_tag_not_found": "needs a key {discriminator}",
    "union_tag_invalid": "has the {discriminator} '{tag}', must be one of {expected_tags}",
}
"""What is expected, by the type of pydantic's error; fields are those of its context."""

WITHOUT_VALUE = ("missing", "extra_forbidden", "union_tag_not_found", "union_tag_invalid")
"""Errors that show the value themselves, or have none."""

LONGEST_VALUE = 60
"""Characters of a value in a message."""

LONGEST_LIST = 4
"""Keys of other tables in a message."""


def described_mistakes(
    error: ValidationError,
    model: type[BaseModel],
    text: str,
    data: object,
    name: str,
    kind: str,
    overrides: Sequence[str],
) -> str:
    """Return all mistakes in a TOML `text` with their lines; `kind` is recipe or mapping.

    `model` is what the `data` of the text were read as, `overrides` are the `key=value` of `--set`.
    """
    lines = _line_numbers(text)
    set_keys = {override.partition("=")[0].strip() for override in overrides}
    mistakes: dict[str, None] = {}  # a number that stands for both ends of a range is one mistake
    for item in error.errors():
        place = _as_given(item["loc"], data)
        path = tuple(part for part in place if isinstance(part, str))
        # tables contradict each other: the mistake concerns the whole recipe
        dotted = ".".join(str(part) for part in place) if path else kind
        given = any(".".join(path[:end]) in set_keys for end in range(1, len(path) + 1))
        where = f"{name}, --set" if given else _where(name, path, lines)
        mistakes[f"{where}: {dotted}: {_message(item, model)}{_meaning(model, place)}"] = None
    count = len(mistakes)
    head = f"{name}: {count} mistake{'s' if count > 1 else ''} in the {kind}"
    return "\n  ".join([head, *mistakes])


def _as_given(place: Sequence[int | str], data: object) -> tuple[int | str, ...]:
    """Return a place of an error without the index of a range that was given as one number."""
    for number, part in enumerate(place):
        if isinstance(data, dict):
            data = data.get(part, data)  # the tag of a table in a list is no key
        elif isinstance(data, list):
            data = data[part] if isinstance(part, int) and part < len(data) else None
        elif isinstance(data, int | float) and isinstance(part, int):
            return tuple(place[:number])
    return tuple(place)


def _message(item: ErrorDetails, model: type[BaseModel]) -> str:
    if item["type"] == "missing":
        return "is missing; add it"
    if item["type"] == "extra_forbidden":
        key, known = str(item["loc"][-1]), set(keys_at(model, item["loc"][:-1]))
        if key in known:
            return "is a key of another kind of this table; remove it, or choose that kind"
        keys = dict.fromkeys(_dotted_keys(model))
        elsewhere = [dotted for dotted in keys if dotted.endswith(f".{key}")]
        otherwise = f"did you mean {' or '.join(elsewhere[:LONGEST_LIST])}?" if elsewhere else ""
        remedy = did_you_mean(key, known, otherwise or "remove it or correct its spelling")
        return f"is not a key that this table knows; {remedy}"
    message = item["msg"].removeprefix("Value error, ")
    if item["type"] in EXPECTATIONS:
        message = EXPECTATIONS[item["type"]].format(**item.get("ctx", {}))
        message = message.replace(" 1 values", " 1 value")
    if item["type"] in WITHOUT_VALUE or isinstance(item["input"], dict) or ", got " in message:
        return message
    value = repr(item["input"])
    shown = value if len(value) <= LONGEST_VALUE else f"{value[:LONGEST_VALUE]}..."
    return f"{message}, got {shown}"


def _meaning(model: type[BaseModel], place: Sequence[int | str]) -> str:
    """Return in brackets what a key means, and its unit; nothing for a table or an unknown key."""
    last = max((index for index, part in enumerate(place) if isinstance(part, str)), default=0)
    tables = _tables_at(model, place[:last])
    own = [table for table in tables if last and _is_of_kind(table, place[last - 1])]
    for table in own or tables:
        field = table.model_fields.get(str(place[last])) if place else None
        if field is not None and field.description:
            return f" ({field.description})"
    return ""


def _is_of_kind(table: type[BaseModel], tag: int | str) -> bool:
    """Return whether a table's errors have this tag, the value of its key that states its kind."""
    return any(tag in get_args(field.annotation) for field in table.model_fields.values())


def keys_at(model: type[BaseModel], place: Sequence[int | str]) -> Iterator[str]:
    """Yield the keys of the tables that may stand at a place."""
    for table in _tables_at(model, place):
        yield from table.model_fields


def _tables_at(model: type[BaseModel], place: Sequence[int | str]) -> list[type[BaseModel]]:
    """Return the tables that may stand at a place."""
    models = [model]
    for part in place:
        if isinstance(part, str):
            fields = [m.model_fields[part] for m in models if part in m.model_fields]
            if fields:  # else the tag of a table in a list
                models = [found for field in fields for found in _models_in(field.annotation)]
    return models


def _dotted_keys(model: type[BaseModel], above: str = "") -> Iterator[str]:
    """Yield every key of the tables below a model, as `table.key`."""
    for name, field in model.model_fields.items():
        yield f"{above}{name}"
        for found in _models_in(field.annotation):
            yield from _dotted_keys(found, f"{above}{name}.")


def _models_in(annotation: Any) -> Iterator[type[BaseModel]]:
    """Yield the tables within an annotation: its own, or those that a union or list holds."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for argument in get_args(annotation):
        yield from _models_in(argument)


def _where(name: str, path: tuple[str, ...], lines: dict[tuple[str, ...], int]) -> str:
    # A missing key has no line: name the line of the closest table around it.
    while path and path not in lines:
        path = path[:-1]
    return f"{name}:{lines[path]}" if path in lines else name


_TABLE = re.compile(r"^\s*\[\[?([^\]]+)\]\]?\s*(#.*)?$")
_KEY = re.compile(r"^\s*([A-Za-z0-9_.\-\"']+)\s*=")


def _line_numbers(text: str) -> dict[tuple[str, ...], int]:
    """Map each table and key of a TOML text to its line, counted from 1."""
    found: dict[tuple[str, ...], int] = {}
    table: tuple[str, ...] = ()
    for number, line in enumerate(text.splitlines(), start=1):
        if match := _TABLE.match(line):
            table = tuple(part.strip().strip("\"'") for part in match[1].split("."))
            found.setdefault(table, number)
        elif match := _KEY.match(line):
            path = (*table, *(part.strip("\"'") for part in match[1].split(".")))
            found.setdefault(path, number)
    return found
