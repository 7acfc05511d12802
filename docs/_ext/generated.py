"""Pages made from the code: commands by their help, recipes by their models, modules."""

from __future__ import annotations

import ast
import inspect
import re
import textwrap
import typing
from collections.abc import Iterator
from pathlib import Path

import click
from pydantic import BaseModel
from pydantic.fields import FieldInfo

import rigtool as rigtool_package
from rigtool.cli import COMMANDS, rigtool
from rigtool.cli.options import Command

OPTION = re.compile(r"(?<![\w`-])--?[a-z][\w-]*")
"""An option in a text, which Markdown would set as a dash."""

CODE = r"`\g<0>`"

MARKUP = re.compile(r"(`[^`]*`)|([*_<>$\[\]|#])")
"""Code, which stays, or a character that Markdown would obey."""

# -- commands


def command_page(name: str) -> str:
    """Return the page of a command: its help, as the command prints it, and its options."""
    command = rigtool.get_command(click.Context(rigtool), name)
    assert isinstance(command, Command)
    context = click.Context(command, info_name=f"rigtool {name}")
    usage = " ".join(["rigtool", name, *command.collect_usage_pieces(context)])
    lines = [
        f"# rigtool {name}",
        "",
        f"```text\n{usage}\n```",
        "",
        *_help(inspect.cleandoc(command.help or "")),
    ]
    for heading, records in command.grouped(context).items():
        lines += ["", f"## {heading}", "", "| option | meaning |", "| --- | --- |"]
        for record in records:
            option, meaning = (_in_table(part) for part in record)
            lines.append(f"| `{option}` | {OPTION.sub(CODE, meaning)} |")
    lines += ["", "## Example", "", "```sh", *examples(command), "```", ""]
    return "\n".join(lines)


def examples(command: click.Command) -> list[str]:
    """Return the lines of a command's example."""
    epilog = (command.epilog or "").splitlines()
    return [line.strip() for line in epilog if line.startswith("  ")]


def _help(text: str) -> Iterator[str]:
    """Yield the paragraphs of a help text; those that click does not wrap stay as they are."""
    for paragraph in inspect.cleandoc(text).split("\n\n"):
        if paragraph.startswith("\b\n"):
            unwrapped = paragraph.removeprefix("\b\n")
            yield f"```text\n{unwrapped}\n```"
        else:
            joined = " ".join(line.strip() for line in paragraph.splitlines())
            yield OPTION.sub(CODE, joined)
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
    from rigtool.recipe import Recipe
    from rigtool.recipe.mapping import Mapping

    parts = [
        "# Recipes",
        "",
        "A recipe is a TOML file: a rig, and what to do on it. Every value that is not given has "
        "the default below; an unknown key is refused. `--set table.key=value` changes one value "
        "for one call. Angles are in rad, torques in N m, times in s unless stated otherwise.",
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

PACKAGE = Path(rigtool_package.__file__).parent
FLOORS = ("numerics", "control", "runfile", "rigs", "experiments", "report", "api")
"""Folders of the package that others program against, from the bottom up."""


def rooms() -> list[Path]:
    """Return the package, then the floors with every folder in them: a page each."""
    inside = (sorted((PACKAGE / floor).rglob("__init__.py")) for floor in FLOORS)
    return [PACKAGE, *(path.parent for floor in inside for path in floor)]


def room_name(room: Path) -> str:
    """Return the name by which a folder of the package is imported."""
    return ".".join(("rigtool", *room.relative_to(PACKAGE).parts))


def room_page(room: Path) -> str:
    """Return what is public in the files of a folder, with docstrings as they stand."""
    lines = [f"# {room_name(room)}", ""]
    for path in sorted(room.glob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        if path.name != "__init__.py":
            lines += [f"## {room_name(room)}.{path.stem}", ""]
        lines += _described(ast.get_docstring(tree))
        for node in tree.body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_"):
                signature = f"```python\n{_signature(node)}\n```"
                lines += [signature, "", *_described(ast.get_docstring(node))]
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


def _described(text: str | None) -> Iterator[str]:
    """Yield a docstring as Markdown: indented paragraphs are equations, set as code."""
    for block in re.split(r"\n\s*\n", text or ""):
        if all(line.startswith("  ") for line in block.splitlines()):
            yield f"```text\n{textwrap.dedent(block)}\n```"
        else:
            yield re.sub(r"^(.+)\n-+$", r"**\1**\n", MARKUP.sub(_plain, block), flags=re.MULTILINE)
        yield ""


def _plain(found: re.Match[str]) -> str:
    return found[1] or f"\\{found[2]}"


def room_list() -> str:
    """Return the page that lists the folders."""
    rows = []
    for room in rooms():
        tree = ast.parse((room / "__init__.py").read_text(encoding="utf-8"))
        what = (ast.get_docstring(tree) or "").partition("\n")[0]
        rows.append(f"| [{room_name(room)}]({room_name(room)}.md) | {what} |")
    return "\n".join(
        [
            "# Modules",
            "",
            "What is public, with the equations and sources in its docstrings. Imports point down: "
            "`numerics` knows no file, no recipe and no command.",
            "",
            "| folder | what it holds |",
            "| --- | --- |",
            *rows,
            "",
            "```{toctree}\n:hidden:\n\n" + "\n".join(map(room_name, rooms())) + "\n```",
            "",
        ]
    )


# -- the site


def write(folder: Path) -> None:
    """Write the generated pages, where they changed."""
    pages = {f"commands/{name}.md": command_page(name) for name in COMMANDS}
    pages["commands/index.md"] = command_list()
    pages["recipes.md"] = recipes_page()
    pages |= {f"modules/{room_name(room)}.md": room_page(room) for room in rooms()}
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
