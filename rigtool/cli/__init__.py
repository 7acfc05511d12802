"""The command line: `rigtool COMMAND`. Each command's module is imported when it is called."""

from __future__ import annotations

import atexit
import gc
import importlib
import io
import keyword
import os
import re
import sys
import traceback
from collections.abc import Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, NoReturn

import click

from rigtool.cli.output import Output, echo
from rigtool.errors import RigtoolError, UsageError, did_you_mean, refusal
from rigtool.escapes import is_text
from rigtool.interrupts import Terminated, handled

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
"""For numpy and scipy, which are imported later. rigtool's matrices are small: more threads would
only wait in busy loops, and rounding would depend on the number of cores."""
os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
"""Or pydantic looks through the metadata of all installed packages for plugins of its own."""

BLOCK_BYTES = 32 * 2**20
"""glibc keeps freed memory of at most this size: a block of samples, soon needed again."""

COMMANDS = {
    "recipe": "Copy a recipe that comes with rigtool, to change it.",
    "calibrate-kt": "Find the torque constant against temperature.",
    "stribeck": "Find Coulomb, viscous, static and breakaway friction.",
    "fft-ripple": "Measure torque ripple by order, speed and torque.",
    "identify-plant": "Measure the frequency response; fit inertia and friction.",
    "ilc-learn": "Learn the disturbance that repeats with position and speed.",
    "measure-force": "Measure known loads, or force over time, from current.",
    "suspension": "Measure leaf springs; compute what eccentric pulleys do.",
    "report": "Write tables, figures and one page from any run files.",
    "info": "Show the contents of a run file.",
    "plot": "Draw a table, a signal or a figure of a run.",
    "diff": "Show where two runs differ.",
    "verify": "Check run files and everything they were made from.",
    "recover": "Make a run file from the remains of an interrupted run.",
    "import": "Make run files from data that other programs recorded.",
    "export": "Write a run, or a learned table, for other programs.",
    "deploy": "Store a learned table in a drive that adds it by itself.",
    "devices": "List serial ports and the devices that answer on them.",
    "target-emulator": "Serve a recipe's virtual rig over the host-target link.",
    "batch": "Run many commands, one a line of a file, by one process.",
    "config": "Show the defaults that rigtool.toml states for this folder.",
}
"""Commands in the order of use, each with the first line of its help. The command itself is the
object `command` in the module that `module_name` names."""

HEADINGS = {
    "recipe": "Measure and analyse",
    "report": "Stored runs",
    "import": "Exchange with other programs and drives",
    "devices": "At the bench",
    "batch": "Many commands",
}
"""Headings in the help, each by the first command below it."""

STORED_RUN_COMMANDS = ("plot", "recover", "verify", "diff", "export")
"""Commands on stored runs, whose modules are in a room of their own."""

COMMAND_ENTRY_POINTS = "rigtool.commands"
"""Group of the entry points with which other packages add commands: each a `click.Command`."""


def module_name(command: str) -> str:
    """Return the module of a command: underscores for hyphens, one behind a word of Python."""
    name = command.replace("-", "_")
    if command in STORED_RUN_COMMANDS:
        return f"stored.{name}"
    return f"{name}_" if keyword.iskeyword(name) else name


class LazyGroup(click.Group):
    """Lists commands without importing them: `rigtool --help` needs click only."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse what stands before the command; an option that belongs behind it is named."""
        given = list(args)
        try:
            return super().parse_args(ctx, args)
        except click.NoSuchOption as error:
            name = next((text for text in given if text in self.list_commands(ctx)), "COMMAND")
            raise click.UsageError(
                f"No such option '{error.option_name}' before the command: options of a command "
                f"follow it, as in `rigtool {name} {error.option_name}`.",
                ctx,
            ) from None

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names in the order of use, then those of other packages."""
        return [*COMMANDS, *_added()]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import and return a command, None where there is none of this name.

        Raises `RigtoolError` for a command of another package that cannot be used.
        """
        if cmd_name in COMMANDS:
            module = importlib.import_module(f"rigtool.cli.{module_name(cmd_name)}")
            return module.command
        added = _added()
        if cmd_name not in added:
            return None
        from rigtool.plugins import load_entry_point

        return load_entry_point(added[cmd_name], click.Command)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the command among the arguments; a misspelt one gets a suggestion.

        Defaults of `rigtool.toml` are looked up for this command alone, and not for its help.
        """
        try:
            found = super().resolve_command(ctx, args)
            ctx.ensure_object(Output).command = found[0]
            if found[0] is not None and not {"-h", "--help"} & set(args):
                from rigtool.cli.defaults import defaults_of

                ctx.default_map = {found[0]: defaults_of(found[0])}
            return found
        except click.UsageError as error:
            hint = did_you_mean(args[0], self.list_commands(ctx))
            raise click.UsageError(
                f"{error.message} {hint[:1].upper()}{hint[1:]}".rstrip(), ctx
            ) from None

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the list of commands into the help."""
        from rigtool.plugins import summary

        heading = "Commands"
        groups: dict[str, dict[str, str]] = {heading: {}}
        for name, what in COMMANDS.items():
            heading = HEADINGS.get(name, heading)
            groups.setdefault(heading, {})[name] = what
        groups["Commands of other packages"] = {n: summary(e) for n, e in _added().items()}
        width = max(len(name) for group in groups.values() for name in group)
        for heading, group in groups.items():
            if group:
                with formatter.section(heading):
                    formatter.write_dl([(f"{name:{width}}", what) for name, what in group.items()])


def _added() -> dict[str, EntryPoint]:
    """Return the commands of other packages by name; those of rigtool cannot be replaced."""
    from rigtool.plugins import plugins

    return plugins(COMMAND_ENTRY_POINTS, frozenset(COMMANDS))


@click.group(
    cls=LazyGroup,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog="\b\nExample:\n  rigtool recipe briaire-2006 -o rig.toml\n"
    "  rigtool calibrate-kt rig.toml -o kt.h5\n  rigtool info kt.h5",
)
@click.version_option(package_name="rigtool", prog_name="rigtool")
@click.option("--debug", is_flag=True, expose_value=False, help="Show tracebacks of errors.")
def rigtool() -> None:
    """Turn a motor, an encoder and a current amplifier into a force sensor.

    Commands measure on the rig of a recipe (.toml) or analyse stored runs (.h5) again. Data go to
    stdout, everything else to stderr.

    Exit codes: 0 done; 1 failed while running; 2 usage; 3 bad recipe or run file; 4 the data do
    not support the result; 5 hardware; 130 interrupted (Ctrl-C); 143 terminated (SIGTERM).

    With --json each command prints one JSON document on stdout, also for an error.
    """


OBJECTS_BETWEEN_COLLECTIONS = 20_000
"""New objects after which Python looks for cycles of garbage: by default 700, which took a
twentieth of the start of a command, as imports make many objects and no garbage."""


def main(argv: Sequence[str] | None = None) -> NoReturn:
    """Run the command line and exit with its code; errors become messages on stderr."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    _open_closed_streams()
    output = Output(json="--json" in arguments)
    _keep_memory_of_blocks()
    gc.set_threshold(OBJECTS_BETWEEN_COLLECTIONS)
    # At exit nothing is garbage any more: a last search took up to a fifth of a command's time.
    atexit.register(gc.freeze)
    try:
        _require_text(arguments)
        with handled():
            code = rigtool.main(arguments, prog_name="rigtool", standalone_mode=False, obj=output)
    except BaseException as error:
        if "--debug" in arguments:
            traceback.print_exc()
        sys.exit(_report(error, output))
    sys.exit(code if isinstance(code, int) else 0)


def _open_closed_streams() -> None:
    """Let standard streams that are closed lead nowhere: the next file that is opened would get
    their number, and take what a library writes to them."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: SIM115


def _require_text(arguments: Sequence[str]) -> None:
    """Raise `UsageError` for a name that is no text: no run file could state its origin.

    numpy, too, reads the date that a run may be given, and fails at one that is no number.
    """
    for argument in arguments:
        if not is_text(argument):
            raise UsageError(f"{argument}: is not UTF-8, or holds a NUL: give another name")
    if not re.fullmatch(r"-?[0-9]+", epoch := os.environ.get("SOURCE_DATE_EPOCH", "0"), re.ASCII):
        raise UsageError(f"SOURCE_DATE_EPOCH={epoch!r}: is no number of seconds: unset it")


def _keep_memory_of_blocks() -> None:
    """Let the C library keep the memory of a block of samples for the next block.

    By default glibc returns each block to the kernel and fetches it again page by page, which takes
    a tenth of the time of an analysis. Other C libraries are left alone.
    """
    import ctypes

    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):
        return
    m_trim_threshold, m_mmap_threshold = -1, -3  # of malloc.h
    mallopt(m_mmap_threshold, BLOCK_BYTES)
    mallopt(m_trim_threshold, 4 * BLOCK_BYTES)


def _report(error: BaseException, output: Output) -> int:
    """Write an error to stderr, and as JSON where that was asked for; return the exit code."""
    if isinstance(error, SystemExit):
        return error.code if isinstance(error.code, int) else 1
    if isinstance(error, click.Abort) and error.__cause__ is not None:  # click's name for Ctrl-C
        error = error.__cause__
    if isinstance(error, click.MissingParameter) and isinstance(error.param, click.Option):
        error = click.MissingParameter(error.param.help, error.ctx, error.param)
    code, message = _described(error)
    notes = getattr(error, "__notes__", ())
    with suppress(OSError):  # nobody may be there to read it: the code says it too
        if isinstance(error, click.ClickException):
            error.show(shown := io.StringIO())
            echo(shown.getvalue(), err=True, nl=False)
        else:
            for line in (message, *notes):
                echo(line, err=True)
    with suppress(OSError):
        if output.json and not output.printed:
            what = {"exit_code": code, "message": message.removeprefix("Error: ")}
            echo(output.text({"error": what, "notes": list(notes)}))
    return code


def _described(error: BaseException) -> tuple[int, str]:
    """Return the exit code of an error and its message."""
    if isinstance(error, click.ClickException):
        return error.exit_code, error.format_message()
    if isinstance(error, click.Abort | KeyboardInterrupt):
        return 130, "interrupted"
    if isinstance(error, Terminated):
        return 143, "terminated"
    if isinstance(error, RigtoolError):
        return error.exit_code, f"Error: {error}"
    if isinstance(error, OSError):  # e.g. stdout leads to a full disk
        return 1, f"Error: {error.filename or 'stdout, or the system'}: {refusal(error)}"
    if isinstance(error, MemoryError):
        return 1, "Error: no memory is left: close other programs, or take shorter recordings"
    if isinstance(error, ImportError):
        return 1, f"Error: a library cannot be loaded: {error}: install it again, or free memory"
    what = f"{type(error).__name__}: {error}"
    return 1, f"internal error, run with --debug to see where: {what}"
