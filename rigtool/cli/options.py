"""Options that commands share, defined once, and the headings of a help text.

A measuring command reads:

    @measuring("rigtool stribeck rig.toml --kt kt.h5 -o f.h5")
    @run_option("--kt", "run file of calibrate-kt")
    def command(sources, output, kt, options): ...

Each `Command` has the options of `OUTPUT_OPTIONS`; their values are in the `Output` that
`current_output` returns.
"""

from __future__ import annotations

import functools
import math
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from textwrap import TextWrapper
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from rigtool.cli.output import Output, echo
from rigtool.experiments.running.options import CommonOptions
from rigtool.inputs import is_recipe

if TYPE_CHECKING:
    from rigtool.experiments.procedure import Procedure
    from rigtool.runfile import Run

CommandFunction = Callable[..., Any]

FILE_ARGUMENT = click.Path()
"""Type of arguments that name a file: a shell completes them."""

OPTION_HEADINGS = {
    "How it measures and analyses": ("overrides", "seed", "dry_run"),
    "Rigs on a serial line only": ("yes", "spy"),
    "Output": (
        *("output", "overwrite", "as_json", "tables_in_json", "quiet", "verbose"),
        *("no_progress", "live", "stream", "every", "debug"),
    ),
}
"""Options by their parameter, under a heading of the help text; all other options come first."""

WRITING_OPTIONS = ("output", "plot", "spy")
"""Parameters of a command that writes a file."""


class Integer(click.IntRange):
    """An integer within bounds, under the name that a message and a help give it."""

    name = "integer"


class Number(click.FloatRange):
    """A finite number within bounds, under the name that a message and a help give it."""

    name = "number"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the number; every comparison with NaN is false, those with the bounds, too."""
        number = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{value} is not a finite number.", param, ctx)
        return number


class Command(click.Command):
    """A command with the options of `OUTPUT_OPTIONS`, and a help under headings."""

    def __init__(self, *args: Any, **settings: Any) -> None:
        super().__init__(*args, **settings)
        known = {option for parameter in self.params for option in parameter.opts}
        self.params += [option for option in OUTPUT_OPTIONS if not known & set(option.opts)]

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options into the help, under their headings."""
        for heading, records in self.grouped(ctx).items():
            with formatter.section(heading):
                formatter.write_dl(records)

    def grouped(self, ctx: click.Context) -> dict[str, list[tuple[str, str]]]:
        """Return option and meaning by heading; --overwrite only where a file is written."""
        groups: dict[str, list[tuple[str, str]]] = {
            "Options": [],
            **{h: [] for h in OPTION_HEADINGS},
        }
        writes = any(parameter.name in WRITING_OPTIONS for parameter in self.params)
        for parameter in self.get_params(ctx):
            record = parameter.get_help_record(ctx)
            if record is None or isinstance(parameter, click.Argument):
                continue
            heads = [head for head, names in OPTION_HEADINGS.items() if parameter.name in names]
            if "--help" in parameter.opts:
                heads = ["Output"]
            if writes or parameter.name != "overwrite":
                groups[heads[0] if heads else "Options"].append(record)
        return {heading: records for heading, records in groups.items() if records}


def current_output() -> Output:
    """Return how the command that runs prints."""
    return click.get_current_context().ensure_object(Output)


def example(*lines: str) -> str:
    """Return the epilog of a command's help: lines that a user can run as they are."""
    wrap = TextWrapper(74, initial_indent="  ", subsequent_indent="    ", break_on_hyphens=False)
    return "\n".join(["\b", "Example:", *(" \\\n".join(wrap.wrap(line)) for line in lines)])


def source_arguments(function: CommandFunction) -> CommandFunction:
    """Add `sources`, a tuple of one or more paths, and `output`, a path."""
    sources = click.argument(
        "sources", nargs=-1, required=True, type=FILE_ARGUMENT, metavar="SOURCE..."
    )
    return sources(output_option("RUN.h5", "Run file to write.", required=True)(function))


def output_option(
    metavar: str, what: str, *, required: bool = False
) -> Callable[[CommandFunction], CommandFunction]:
    """Add the option -o, the file or folder that the command writes; None where it is left out."""
    return click.option(
        "-o", "--output", required=required, type=FILE_ARGUMENT, metavar=metavar, help=what
    )


def run_option(
    name: str, what: str, *, required: bool = False
) -> Callable[[CommandFunction], CommandFunction]:
    """Add an option that takes one run file; its path arrives as a string or None."""
    return click.option(name, required=required, type=FILE_ARGUMENT, metavar="RUN.h5", help=what)


def _asked(name: str, value: bool) -> Callable[[click.Context, click.Parameter, bool], None]:
    """Return what notes a flag in the `Output` of the command."""

    def note(ctx: click.Context, parameter: click.Parameter, given: bool) -> None:
        if given:
            setattr(ctx.ensure_object(Output), name, value)

    return note


def _verbose(ctx: click.Context, parameter: click.Parameter, given: bool) -> None:
    """Let the steps be reported on stderr, each with the time since the start."""
    if given:
        import logging

        handler = logging.Handler()
        handler.emit = lambda record: echo(  # type: ignore[method-assign]
            f"{record.relativeCreated:7.0f} ms  {record.getMessage()}", err=True
        )
        logger = logging.getLogger("rigtool")
        logger.addHandler(handler)
        logger.setLevel(logging.INFO)
        ctx.call_on_close(lambda: logger.removeHandler(handler))
        ctx.call_on_close(lambda: logger.setLevel(logging.NOTSET))


def _flag(*names: str, callback: Callable[..., None], help: str) -> click.Option:
    return click.Option(names, is_flag=True, expose_value=False, callback=callback, help=help)


OUTPUT_OPTIONS = (
    _flag("--overwrite", callback=_asked("overwrite", True), help="Replace an output that exists."),
    _flag("--json", "as_json", callback=_asked("json", True), help="Print one JSON document."),
    _flag(
        "--no-tables",
        "tables_in_json",
        callback=_asked("tables", False),
        help="Leave tables out of what is printed.",
    ),
    _flag("-q", "--quiet", callback=_asked("quiet", True), help="Print errors only."),
    _flag("-v", "--verbose", callback=_verbose, help="Report each step, with the time, on stderr."),
    _flag("--debug", callback=lambda *_: None, help="Show tracebacks of errors."),
)


def completed(names: Callable[[str], list[str]]) -> Callable[..., list[str]]:
    """Return the completion of a value: of the names of the run file given, those that fit."""

    def complete(ctx: click.Context, parameter: click.Parameter, incomplete: str) -> list[str]:
        path = ctx.params.get("path") or (ctx.args or [""])[0]
        return [name for name in names(path) if name.startswith(incomplete)]

    return complete


def _setting_keys(ctx: click.Context, parameter: click.Parameter, incomplete: str) -> list[str]:
    """Return the keys of a recipe that begin so, for the completion of --set."""
    from rigtool.recipe import Recipe
    from rigtool.recipe.mistakes import keys_at

    table, dot, _ = incomplete.rpartition(".")
    place = table.split(".") if table else []
    ends = {True: ".", False: "="}  # of a table, of a value
    keys = {key: ends[any(keys_at(Recipe, [*place, key]))] for key in keys_at(Recipe, place)}
    whole = [f"{table}{dot}{key}{end}" for key, end in keys.items()]
    return [key for key in whole if key.startswith(incomplete)]


set_option = click.option(
    "--set",
    "overrides",
    multiple=True,
    metavar="KEY=VALUE",
    shell_complete=_setting_keys,
    help="Set a value of the recipe, e.g. rig.attachment=pulley.",
)


COMMON_OPTIONS = ("seed", "overrides", "dry_run", "yes", "spy", "live")
"""Options of measuring that are fields of `CommonOptions`."""


def common_options(function: CommandFunction) -> CommandFunction:
    """Add the options of measuring; they arrive together as `options`, a `CommonOptions`."""

    @click.option(
        "--spy",
        type=FILE_ARGUMENT,
        metavar="FILE",
        help="Log every byte on the serial line, with time stamps.",
    )
    @click.option("--live-window", "live", flag_value="window", help="Draw signals in a window.")
    @click.option(
        "--live",
        flag_value="terminal",
        help="Draw signals in the terminal while they are recorded.",
    )
    @click.option("--yes", is_flag=True, help="Move the rig without asking first.")
    @click.option("--dry-run", is_flag=True, help="Show what would move; move nothing.")
    @set_option
    @click.option(
        "--seed", type=Integer(min=0), help="Seed of the virtual rig; no other rig has one."
    )
    @click.option("--no-progress", is_flag=True, help="Draw no progress bars.")
    @functools.wraps(function)
    def collected(*args: Any, no_progress: bool, **kwargs: Any) -> Any:
        output = current_output()
        own = {name: kwargs.pop(name) for name in COMMON_OPTIONS}
        if own["live"] == "terminal" and not sys.stderr.isatty():
            raise click.UsageError(
                "--live draws at a terminal, and stderr is not a terminal: leave it out"
            )
        _state_defaults(kwargs)
        options = CommonOptions(
            progress=sys.stderr.isatty() and not output.quiet and not no_progress,
            overwrite=output.overwrite,
            **own,
        )
        return function(*args, options=options, **kwargs)

    return collected


def command_with(*examples: str) -> Callable[[CommandFunction], click.Command]:
    """Make a command of a function, with `examples` in its help."""
    return click.command(cls=Command, epilog=example(*examples))


def measuring(*examples: str) -> Callable[[CommandFunction], click.Command]:
    """Make a command of a function; adds `source_arguments` and `common_options`."""
    make = command_with(*examples)
    return lambda function: make(source_arguments(common_options(function)))


def _state_defaults(given: dict[str, Any]) -> None:
    """State what `rigtool.toml` gives to this command; imported runs need no --kt of it."""
    ctx = click.get_current_context()
    taken = {
        name: given[name]
        for name in given
        if ctx.get_parameter_source(name) is ParameterSource.DEFAULT_MAP
    }
    if "kt" in taken and _imported(given["sources"]):
        given["kt"] = None
        del taken["kt"]
    if taken:
        shown = ", ".join(
            f"{'SOURCE' if name == 'sources' else f'--{name}'} "
            f"{' '.join(value) if name == 'sources' else value}"
            for name, value in taken.items()
        )
        current_output().note(f"From rigtool.toml: {shown}")


def _imported(sources: tuple[str, ...]) -> bool:
    """Return whether the first source is a run of `rigtool import`."""
    from rigtool.runfile import open_run
    from rigtool.runfile.schema import IMPORT

    if is_recipe(sources[0]):
        return False
    with open_run(sources[0]) as run:
        return run.command == IMPORT


def run_and_print(
    procedure: Procedure,
    sources: tuple[str, ...],
    output: str,
    options: CommonOptions,
    **paths: str | None,
) -> None:
    """Run a procedure with the run files of other commands at `paths`; print its outcome."""
    from rigtool.experiments.running.session import run_command

    with open_inputs(**paths) as inputs:
        outcome = run_command(procedure, sources, output, options=options, inputs=inputs)
    current_output().outcome(outcome, output, dry=options.dry_run)


@contextmanager
def open_inputs(**paths: str | None) -> Iterator[dict[str, Run]]:
    """Open run files by the name of their option; options without a path are left out."""
    from rigtool.runfile import open_run

    with ExitStack() as stack:
        yield {
            name: stack.enter_context(open_run(path))
            for name, path in paths.items()
            if path is not None
        }
