"""`rigtool batch`: many command lines, by one process that imports everything once.

On Linux each line runs in a forked copy of this process, with a memory of its own. What a line had
to import is imported here as well, for the copies that follow. On other systems, and where another
thread runs that a copy would miss, each line is a process that starts from nothing.
"""

from __future__ import annotations

import gc
import importlib
import os
import shlex
import signal
import sys
from collections import Counter
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from rigtool.cli.options import FILE_ARGUMENT, Integer, command_with, current_output
from rigtool.cli.output import Output, echo
from rigtool.errors import RigtoolError, UsageError
from rigtool.escapes import is_text
from rigtool.inputs import open_input
from rigtool.interrupts import Terminated, begin_anew, held, may_fork, raise_swallowed

if TYPE_CHECKING:
    from multiprocessing.process import BaseProcess

STREAMS = {"stdout": 1, "stderr": 2}


class Line(NamedTuple):
    """A command line: its place, as a message names it, and its arguments."""

    place: str
    words: list[str]


@command_with("rigtool batch lines.txt -j 2")
@click.argument("file", type=FILE_ARGUMENT)
@click.option(
    "-j",
    "--jobs",
    type=Integer(min=1),
    default=1,
    show_default=True,
    help="Lines that run side by side; none may need the output of another then.",
)
def command(file: str, jobs: int) -> None:
    """Run many commands, one a line of a file, by one process.

    FILE holds command lines as for a shell, without `rigtool`; - takes them from stdin. A # begins
    a comment. All lines are checked for mistakes of usage before the first one runs. What a line
    prints appears whole, in the order of the file. A line that fails ends no other one; the exit
    code is that of the first line that fails.
    """
    import tempfile

    lines, to = read_lines(file), current_output()
    with tempfile.TemporaryDirectory(prefix="rigtool-") as folder:
        batch = Batch(lines, Path(folder), to)
        batch.run(jobs)
    to.document(lines=batch.documents)
    failed = Counter(code for code in batch.codes if code)
    counts = [f"{count} failed with exit code {code}" for code, count in failed.items()]
    to.note(", ".join([f"{file}: {batch.codes.count(0)} of {len(lines)} lines done", *counts]))
    click.get_current_context().exit(next(iter(failed), 0))


def read_lines(file: str) -> list[Line]:
    """Return the command lines of a file; `UsageError` for the first that is wrong."""
    if file == "-":
        data = sys.stdin.buffer.read()
    else:
        with open_input(file, UsageError, pipe=True) as stream:
            data = stream.read()
    lines = []
    for number, text in enumerate(data.split(b"\n"), 1):
        place = f"{file}, line {number}"
        try:
            words = shlex.split(text.decode(), comments=True)
            if words:
                _require_usage(words)
                lines.append(Line(place, words))
        except click.ClickException as error:
            raise UsageError(f"{place}: {error.format_message()}") from None
        except RigtoolError as error:
            raise UsageError(f"{place}: {error}") from None
        except UnicodeDecodeError as error:
            byte = f"byte {error.start} of the line is not UTF-8"
            raise UsageError(f"{place}: {byte}; give a text, saved in UTF-8") from None
        except ValueError as error:  # an open quote
            raise UsageError(f"{place}: {error}: correct the line") from None
    return lines


def _require_usage(words: list[str]) -> None:
    """Raise what the command line raises for these arguments before their command begins."""
    from rigtool.cli import rigtool

    first = words[0]
    if first.startswith("-") or first in ("batch", "rigtool") or {"-h", "--help"} & set(words):
        raise UsageError(
            "a line begins with a command other than batch, without `rigtool`, and asks for no help"
        )
    if not all(map(is_text, words)):
        raise UsageError("holds a NUL: correct the line")
    parent = click.Context(rigtool, info_name="rigtool", obj=Output())
    name, found, rest = rigtool.resolve_command(parent, words)
    assert found is not None
    with found.make_context(name, rest, parent=parent):
        pass


class Batch:
    """Lines that run; `codes` and `documents` are those of the lines that are printed."""

    def __init__(self, lines: list[Line], folder: Path, to: Output) -> None:
        self.codes: list[int] = []
        self.documents: list[dict[str, Any]] = []
        self._lines, self._folder, self._to = lines, folder, to
        self._running: dict[int, BaseProcess] = {}
        self._ended: dict[int, int] = {}

    def run(self, jobs: int) -> None:
        """Run all lines; Ctrl-C and SIGTERM go on to those that run, and end the batch."""
        from multiprocessing.connection import wait

        waiting = iter(range(len(self._lines)))
        try:
            while len(self.codes) < len(self._lines):
                raise_swallowed()
                for index in islice(waiting, jobs - len(self._running)):
                    self._start(index)
                wait([process.sentinel for process in self._running.values()])
                for index in self._reap():
                    _import_listed(self._folder / f"{index}.modules")
                self._print()
        except BaseException as error:
            self._end(signal.SIGINT if isinstance(error, KeyboardInterrupt) else signal.SIGTERM)
            with suppress(OSError):
                self._print()
            error.add_note(f"{len(self.codes)} of {len(self._lines)} lines ended")
            raise

    def _start(self, index: int) -> None:
        import multiprocessing

        context: Any = multiprocessing.get_context("fork" if may_fork() else "spawn")
        stem = str(self._folder / str(index))
        with held():  # no signal between a process and its place among those that run
            process = context.Process(target=_perform, args=(self._lines[index].words, stem))
            process.start()
            self._running[index] = process

    def _reap(self) -> list[int]:
        """Return the lines that have ended, and take in their codes."""
        with held():
            done = [index for index, process in self._running.items() if not process.is_alive()]
            for index in done:
                code = self._running.pop(index).exitcode or 0
                self._ended[index] = code if code >= 0 else 128 - code  # as shells count signals
        return done

    def _print(self) -> None:
        """Print the lines that ended, in their order, up to the first that has not."""
        while (index := len(self.codes)) in self._ended:
            code, line = self._ended.pop(index), self._lines[index]
            self.codes.append(code)
            printed = {}
            for name in STREAMS:
                path = self._folder / f"{index}.{name}"
                printed[name] = path.read_bytes() if path.exists() else b""
                path.unlink(missing_ok=True)
            if self._to.json:
                texts = {name: data.decode(errors="replace") for name, data in printed.items()}
                self.documents.append({"line": shlex.join(line.words), "exit_code": code, **texts})
                continue
            for name, data in printed.items():
                click.echo(data, nl=False, err=name == "stderr")
            if code:
                echo(f"{line.place}: exit code {code}: {shlex.join(line.words)}", err=True)

    def _end(self, number: int) -> None:
        """Pass a signal on to all that run, and each further one, until they have ended."""
        from multiprocessing.connection import wait

        while self._running:
            with suppress(KeyboardInterrupt, Terminated):
                for process in self._running.values():
                    assert process.pid is not None
                    os.kill(process.pid, number)
                while self._running:
                    wait([process.sentinel for process in self._running.values()])
                    self._reap()


def _perform(words: list[str], stem: str) -> None:
    """Run a command line in this process, which ends with its exit code."""
    from rigtool.cli import main

    begin_anew()
    for name, number in STREAMS.items():
        before = getattr(sys, name)
        path = Path(f"{stem}.{name}")
        # By lines: a signal that comes once more, on the way out, ends a process where it is.
        stream = path.open("w", buffering=1, encoding=before.encoding, errors=before.errors)
        os.dup2(stream.fileno(), number)  # what libraries in C print, too
        setattr(sys, name, stream)
    sys.argv = ["rigtool", *words]  # a run file states it
    known = set(sys.modules)
    try:
        main(words)
    finally:
        names = [name for name in sys.modules if name not in known]
        Path(f"{stem}.modules").write_text("\n".join(names), encoding="utf-8")


def _import_listed(path: Path) -> None:
    """Import modules whose names a file lists, so that further copies begin with them."""
    names = path.read_text(encoding="utf-8").split() if path.exists() else []
    for name in names:
        with suppress(Exception):  # some are made by others, and cannot be imported
            importlib.import_module(name)
    if names:
        gc.freeze()  # or each copy's collector would write to, and so copy, what all share
