"""Options that commands share, defined once.

A measuring command reads:

    @click.command(epilog=example("rigtool stribeck recipes/briaire-2006.toml --kt kt.h5 -o f.h5"))
    @source_arguments
    @run_option("--kt", "run file of calibrate-kt")
    @common_options
    def command(sources, output, kt, options): ...
"""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, Any, Literal

import click

from rigtool.escapes import terminal
from rigtool.experiments.running.options import CommonOptions

if TYPE_CHECKING:
    from rigtool.experiments.procedure import Procedure
    from rigtool.runfile import Run

Function = Callable[..., Any]


def echo(text: str, *, err: bool = False, nl: bool = True) -> None:
    """Print text on stdout or stderr; control characters in it cannot steer the terminal."""
    click.echo(terminal(text), err=err, nl=nl)


def example(*lines: str) -> str:
    """Return the epilog of a command's help: lines that a user can run as they are."""
    return "\n".join(["\b", "Example:", *(f"  {line}" for line in lines)])


def source_arguments(function: Function) -> Function:
    """Add `sources`, a tuple of one or more paths, and `output`, a path."""
    function = click.option(
        "-o", "--output", required=True, metavar="RUN.h5", help="Run file to write."
    )(function)
    return click.argument("sources", nargs=-1, required=True, metavar="SOURCE...")(function)


def run_option(name: str, what: str, *, required: bool = False) -> Callable[[Function], Function]:
    """Add an option that takes one run file; its path arrives as a string or None."""
    return click.option(name, required=required, metavar="RUN.h5", help=what)


debug_option = click.option(
    "--debug", is_flag=True, expose_value=False, help="Show tracebacks of errors."
)
json_option = click.option("--json", "as_json", is_flag=True, help="Print results as JSON.")
quiet_option = click.option("-q", "--quiet", is_flag=True, help="Print errors only.")
overwrite_option = click.option("--overwrite", is_flag=True, help="Replace an output that exists.")


def common_options(function: Function) -> Function:
    """Add the shared options; they arrive together as `options`, a `CommonOptions`."""

    @debug_option
    @click.option(
        "--spy", metavar="FILE", help="Log every byte on the serial line, with time stamps."
    )
    @click.option("--live-window", "live", flag_value="window", help="Draw signals in a window.")
    @click.option(
        "--live",
        flag_value="terminal",
        help="Draw signals in the terminal while they are recorded.",
    )
    @click.option("--yes", is_flag=True, help="Move a rig on a serial line without asking first.")
    @click.option("--dry-run", is_flag=True, help="Show what would move; move nothing.")
    @click.option(
        "--set",
        "overrides",
        multiple=True,
        metavar="KEY=VALUE",
        help="Set a value of the recipe, e.g. rig.attachment=pulley.",
    )
    @click.option("--seed", type=click.IntRange(min=0), help="Seed of the virtual rig.")
    @overwrite_option
    @click.option("--no-progress", is_flag=True, help="Draw no progress bars.")
    @quiet_option
    @json_option
    @functools.wraps(function)
    def collected(
        *args: Any,
        as_json: bool,
        quiet: bool,
        no_progress: bool,
        overwrite: bool,
        seed: int | None,
        overrides: tuple[str, ...],
        dry_run: bool,
        yes: bool,
        spy: str | None,
        live: Literal["terminal", "window"] | None,
        **kwargs: Any,
    ) -> Any:
        if live == "terminal" and not sys.stderr.isatty():
            raise click.UsageError("--live draws at a terminal, and stderr is none: leave it out")
        options = CommonOptions(
            json=as_json,
            quiet=quiet,
            progress=sys.stderr.isatty() and not quiet and not no_progress,
            overwrite=overwrite,
            seed=seed,
            overrides=overrides,
            dry_run=dry_run,
            yes=yes,
            spy=spy,
            live=live,
        )
        return function(*args, options=options, **kwargs)

    return collected


def run_and_print(
    procedure: Procedure,
    sources: tuple[str, ...],
    output: str,
    options: CommonOptions,
    **paths: str | None,
) -> None:
    """Run a procedure with the run files of other commands at `paths`; print its outcome."""
    from rigtool.cli.printing import print_outcome
    from rigtool.experiments.running.session import run_command

    with open_inputs(**paths) as inputs:
        outcome = run_command(procedure, sources, output, options=options, inputs=inputs)
    print_outcome(outcome, output, options)


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
