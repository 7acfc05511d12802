"""Pages made from the code: commands by their help, recipes by their models, modules."""

from __future__ import annotations

import ast
import typing
from collections.abc import Iterator
from pathlib import Path

import click
from pydantic import BaseModel
from pydantic.fields import FieldInfo

import rigtool as rigtool_package
from rigtool.cli import COMMANDS, rigtool

# -- commands


def command_page(name: str) -> str:
    """Return the page of a command: its help, as the command prints it, and its options."""
    command = rigtool.get_command(click.Context(rigtool), name)
    assert command is not None
    context = click.Context(command, info_name=f"rigtool {name}")
    text = (command.help or "").replace("\b\n", "")
    usage = " ".join(["rigtool", name, *command.collect_usage_pieces(context)])
    lines = [f"# rigtool {name}", "", f"```text\n{usage}\n```", "", *_paragraphs(text)]
    lines += ["## Options", "", "| option | meaning |", "| --- | --- |"]
    for parameter in command.get_params(context):
        record = parameter.get_help_record(context)
        if record is not None and isinstance(parameter, click.Option):
            option, meaning = (_in_table(part) for part in record)
            lines.append(f"| `{option}` | {meaning} |")
    lines += ["", "## Example", "", "```sh", *examples(command), "```", ""]
    return "\n".join(lines)


def examples(command: click.Command) -> list[str]:
    """Return the lines of a command's example."""
    epilog = (command.epilog or "").splitlines()
    return [line.strip() for line in epilog if line.startswith("  ")]


def _paragraphs(text: str) -> Iterator[str]:
    for paragraph in text.split("\n\n"):
        yield " ".join(line.strip() for line in paragraph.splitlines())
        yield ""


def _in_table(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")


def command_list() -> str:
    """Return the page that lists all commands."""
    rows = [f"| [{name}]({name}.md) | {what} |" for name, what in COMMANDS.items()]
    names = "\n".join(COMMANDS)
    return "\n".join(
        [
            "# Commands",
            "",
            "In the order of use. Each page is made from the command's own `--help`.",
            "",
            "| command | what it does |",
            "| --- | --- |",
            *rows,
            "",
            f"```{{toctree}}\n:hidden:\n\n{names}\n```",
            "",
        ]
    )


# -- recipes


def recipes_page() -> str:
    """Return every table and value of a recipe, from the models that read it."""
    from rigtool.recipe import Mapping, Recipe

    parts = [
        "# Recipes",
        "",
        "A recipe is a TOML file: a rig, and what to do on it. Every value that is not given has "
        "the default below; an unknown key is refused. `--set table.key=value` changes one value "
        "for one call. Angles are in rad, torques in N m, times in s where nothing else is said.",
        "",
        *_tables(Recipe, ""),
        "## Mappings of imports",
        "",
        *_tables(Mapping, ""),
    ]
    return "\n".join(parts)


def _tables(model: type[BaseModel], path: str) -> Iterator[str]:
    below: list[tuple[str, type[BaseModel]]] = []
    rows = []
    for name, field in model.model_fields.items():
        inner = _models(field.annotation)
        where = f"{path}.{name}" if path else name
        below += [(where, one) for one in inner]
        if not inner:
            meaning = _in_table(field.description or "")
            rows.append(f"| `{name}` | {_default(field)} | {meaning} |")
    if path:
        yield f"## `[{path}]`"
        yield ""
    for paragraph in (model.__doc__ or "").strip().split("\n\n"):
        yield " ".join(paragraph.split())
        yield ""
    if rows:
        yield from ("| key | default | meaning |", "| --- | --- | --- |", *rows, "")
    for where, one in below:
        yield from _tables(one, where)


def _models(annotation: object) -> list[type[BaseModel]]:
    """Return the models that a field holds, itself or in a list, none for a plain value."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [one for part in typing.get_args(annotation) for one in _models(part)]


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "required"
    value = field.get_default(call_default_factory=True, validated_data={})
    if value is None:
        return "none"
    if isinstance(value, tuple):
        return "`[" + ", ".join(str(item) for item in value) + "]`"
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    return f'`"{value}"`' if isinstance(value, str) else f"`{value}`"


# -- modules

ROOMS = {
    "numerics": "Methods that know no experiment: arrays in, frozen dataclasses out.",
    "control": "The position loop as a model, and the table that is fed forward in it.",
    "runfile": "HDF5: writer, reader, provenance, recovery, importers, exports.",
    "rigs": "Where signals come from.",
    "experiments": "A room an experiment: procedure, numerics, results.",
    "report": "Tables, figures, one page.",
}
"""Folders of the package that others program against, from the bottom up."""


def room_page(room: str) -> str:
    """Return what is public in a folder of the package, with docstrings as they stand."""
    package = Path(rigtool_package.__file__).parent
    lines = [f"# rigtool.{room}", "", ROOMS[room], ""]
    for path in sorted((package / room).rglob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        name = ".".join(("rigtool", *path.relative_to(package).with_suffix("").parts))
        lines += [f"## {name.removesuffix('.__init__')}", "", *_quoted(tree)]
        for node in tree.body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_"):
                lines += [f"```python\n{_signature(node)}\n```", "", *_quoted(node)]
    return "\n".join(lines)


def _signature(node: ast.FunctionDef | ast.ClassDef) -> str:
    """Return the head of a function or class, and of its public methods."""
    if isinstance(node, ast.FunctionDef):
        returns = f" -> {ast.unparse(node.returns)}" if node.returns else ""
        return f"def {node.name}({ast.unparse(node.args)}){returns}"
    bases = ", ".join(ast.unparse(base) for base in node.bases)
    lines = [f"class {node.name}({bases}):" if bases else f"class {node.name}:"]
    for item in node.body:
        if isinstance(item, ast.AnnAssign):
            lines.append(f"    {ast.unparse(item.target)}: {ast.unparse(item.annotation)}")
        elif isinstance(item, ast.FunctionDef) and not item.name.startswith("_"):
            lines.append(f"    {_signature(item)}")
    return "\n".join(lines)


def _quoted(node: ast.Module | ast.FunctionDef | ast.ClassDef) -> list[str]:
    text = ast.get_docstring(node)
    return ["```text", text, "```", ""] if text else []


def room_list() -> str:
    """Return the page that lists the folders."""
    rows = [f"| [rigtool.{room}]({room}.md) | {what} |" for room, what in ROOMS.items()]
    return "\n".join(
        [
            "# Modules",
            "",
            "What is public, with the equations and sources in its docstrings. Imports point down: "
            "`analysis` knows no file, no recipe and no command.",
            "",
            "| folder | what it holds |",
            "| --- | --- |",
            *rows,
            "",
            "```{toctree}\n:hidden:\n\n" + "\n".join(ROOMS) + "\n```",
            "",
        ]
    )


# -- the site


def write(folder: Path) -> None:
    """Write the generated pages, where they changed."""
    pages = {f"commands/{name}.md": command_page(name) for name in COMMANDS}
    pages["commands/index.md"] = command_list()
    pages["recipes.md"] = recipes_page()
    pages |= {f"modules/{room}.md": room_page(room) for room in ROOMS}
    pages["modules/index.md"] = room_list()
    for name, text in pages.items():
        path = folder / name
        path.parent.mkdir(exist_ok=True)
        if not path.exists() or path.read_text() != text:
            path.write_text(text)
    for made in ("commands", "modules"):
        for path in (folder / made).glob("*.md"):
            if f"{made}/{path.name}" not in pages:
                path.unlink()


def setup(app: typing.Any) -> dict[str, bool]:
    """Write the pages before Sphinx looks for them."""
    app.connect("builder-inited", lambda app: write(Path(app.srcdir)))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
