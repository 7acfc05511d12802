"""The command line as a whole: codes, messages, help, speed of start."""

import io
import json
import os
import re
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import click
import pytest

import rigtool.cli as cli
from rigtool.cli.options import (
    Command,
    common_options,
    current_output,
    example,
    open_inputs,
    source_arguments,
)
from rigtool.errors import (
    HardwareError,
    InsufficientDataError,
    RecipeError,
    RigtoolError,
    RunFileError,
    UsageError,
)
from tests.cli.called import exit_code

ROOT = Path(__file__).parents[2]


def run(*arguments: str, **options) -> subprocess.CompletedProcess[str]:
    """Run rigtool as a user does."""
    return subprocess.run(
        [sys.executable, "-m", "rigtool", *arguments], capture_output=True, text=True, **options
    )


def call(monkeypatch, error: BaseException | None, *arguments: str) -> int:
    """Run `main` with a command that raises this error."""

    @click.command()
    @click.option("--debug", is_flag=True, expose_value=False)
    def command() -> None:
        if error is not None:
            raise error

    monkeypatch.setattr(cli, "COMMANDS", {"fail": "Fail."})
    monkeypatch.setattr(cli.LazyGroup, "get_command", lambda *_: command)
    return exit_code("fail", *arguments)


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (None, 0),
        (RigtoolError("disk full"), 1),
        (UsageError("no"), 2),
        (RecipeError("no"), 3),
        (RunFileError("no"), 3),
        (InsufficientDataError("no"), 4),
        (HardwareError("no"), 5),
        (ZeroDivisionError("no"), 1),
        (OSError(28, "No space left on device"), 1),
        (MemoryError(), 1),
        (KeyboardInterrupt(), 130),
        (cli.Terminated(), 143),
        (click.UsageError("no"), 2),
        (click.exceptions.Exit(3), 3),
    ],
)
def test_exit_codes(monkeypatch, capsys, error, code):
    assert call(monkeypatch, error) == code
    found = capsys.readouterr()
    assert found.out == ""
    assert "Traceback" not in found.err


def test_a_message_says_what_its_notes_say(monkeypatch, capsys):
    error = RigtoolError("kt.h5: the disk is full")
    error.add_note("42 samples are kept")
    call(monkeypatch, error)
    assert capsys.readouterr().err == "Error: kt.h5: the disk is full\n42 samples are kept\n"


def test_interrupts_say_what_is_kept(monkeypatch, capsys):
    error = KeyboardInterrupt()
    error.add_note("42 samples are kept")
    call(monkeypatch, error)
    assert capsys.readouterr().err.split("\n")[-3:] == ["interrupted", "42 samples are kept", ""]


def test_a_mistake_of_ours_names_debug_and_debug_shows_it(monkeypatch, capsys):
    assert call(monkeypatch, ZeroDivisionError("by nought")) == 1
    message = capsys.readouterr().err
    assert "internal error, run with --debug" in message
    assert "by nought" in message
    assert call(monkeypatch, ZeroDivisionError("by nought"), "--debug") == 1
    assert "Traceback" in capsys.readouterr().err


@pytest.mark.parametrize("name", list(cli.COMMANDS))
def test_every_command_has_help_with_a_runnable_example(name):
    command = cli.rigtool.get_command(click.Context(cli.rigtool), name)
    assert command is not None
    text = command.get_help(click.Context(command, info_name=name))
    assert max(map(len, text.splitlines())) <= 80
    examples = re.findall(rf"^ +rigtool {name} \S.*$", text.replace("\\\n", ""), re.MULTILINE)
    assert examples, f"the help of {name} has no example"
    for line in examples:
        # It parses: the options exist and the required ones are there.
        command.make_context(name, line.split()[2:])
    assert cli.COMMANDS[name] == command.get_short_help_str(limit=200)


def test_every_module_of_a_command_is_registered():
    room = ROOT / "rigtool" / "cli"
    modules = {path.stem for path in (*room.glob("*.py"), *room.glob("stored/*.py"))}
    helpers = {"__init__", "defaults", "options", "output"}
    found = {cli.module_name(name).rpartition(".")[2] for name in cli.COMMANDS}
    assert found == {name for name in modules - helpers if not name.startswith("_")}


def test_help_lists_the_commands_and_imports_none():
    code = (
        "import sys, rigtool.cli\n"
        "try: rigtool.cli.main(['--help'])\n"
        "except SystemExit: pass\n"
        "heavy = {'numpy', 'h5py', 'pydantic', 'scipy', 'numba', 'pandas', 'matplotlib'}\n"
        "print(sorted(heavy & set(sys.modules)), file=sys.stderr)"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert found.stderr.strip() == "[]"
    for name, text in cli.COMMANDS.items():
        assert re.search(rf"^  {name} +{re.escape(text[:30])}", found.stdout, re.MULTILINE)


def test_version():
    found = run("--version")
    assert re.fullmatch(r"rigtool, version \d+\.\d+\.\d+\n", found.stdout)


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["no-such-command"], 2, "No such command"),
        (["info"], 2, "Missing argument"),
        (["report", "a.h5"], 2, "Missing option '-o' / '--output'. Folder to write."),
        (["info", "no.h5"], 3, "no.h5: no such file"),
        (["info", "x", "--no-such-option"], 2, "No such option"),
        (["-q", "info", "x"], 2, "options of a command follow it, as in `rigtool info -q`"),
    ],
)
def test_what_a_user_may_get_wrong(tmp_path, arguments, code, message):
    found = run(*arguments, cwd=tmp_path)
    assert found.returncode == code
    assert found.stdout == ""
    assert message in found.stderr
    assert "Traceback" not in found.stderr


RECORD = """
import sys, time
import numpy as np
import rigtool.cli as cli
from rigtool.runfile import RunWriter
from tests.runfile.whole_run import SPECS, samples
import click

@click.command()
def command():
    with RunWriter(
        sys.argv[1], command="x", recordings=SPECS
    ) as out:
        out.append("holds", samples(100)["holds"])
        print("recording", flush=True)
        time.sleep(30)

cli.COMMANDS = {"record": "Record."}
cli.LazyGroup.get_command = lambda *_: command
cli.main(["record"])
"""


@pytest.mark.parametrize(
    ("number", "code", "word"), [(signal.SIGTERM, 143, "terminated"), (signal.SIGINT, 130, "int")]
)
def test_a_signal_closes_the_file_and_says_so(tmp_path, number, code, word):
    path = tmp_path / "run.h5"
    process = subprocess.Popen(
        [sys.executable, "-c", RECORD, str(path)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=ROOT,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "recording\n"
    time.sleep(0.1)
    process.send_signal(number)
    _, message = process.communicate(timeout=20)
    assert process.returncode == code
    assert word in message
    assert "100 samples that were recorded are kept in" in message
    assert os.listdir(tmp_path) == ["run.h5.part"]


def test_a_closed_stderr_changes_nothing(tmp_path, monkeypatch):
    recipe = str(ROOT / "recipes" / "briaire-2006.toml")
    monkeypatch.setattr(sys, "stderr", None)
    with pytest.raises(SystemExit) as end:
        cli.main(["suspension", recipe, "--dry-run", "-o", str(tmp_path / "run.h5")])
    with sys.stderr as nowhere:
        assert nowhere.name == os.devnull
    assert end.value.code == 0


def test_options_arrive_together():
    found = {}

    @click.command(cls=Command, epilog=example("rigtool x a.toml -o a.h5"))
    @source_arguments
    @common_options
    def command(sources, output, options) -> None:
        found.update(sources=sources, output=output, options=options, to=current_output())

    arguments = ["a.toml", "-o", "x.h5", "--set", "rig.name=b", "--set", "c=1", "--seed", "3"]
    command.main([*arguments, "--json", "-q", "--overwrite"], standalone_mode=False)
    assert found["sources"] == ("a.toml",)
    assert found["output"] == "x.h5"
    options = found["options"]
    assert options.overrides == ("rig.name=b", "c=1")
    assert (options.seed, options.overwrite, options.progress) == (3, True, False)
    assert (found["to"].json, found["to"].quiet) == (True, True)
    assert "Example:\n    rigtool x a.toml -o a.h5" in command.get_help(click.Context(command))


def test_a_name_in_a_message_of_usage_cannot_steer_the_terminal(capsys):
    with pytest.raises(SystemExit, match="2"):
        cli.main(["info", "kt.h5", "evil\x1b]0;title\a.h5"])
    err = capsys.readouterr().err
    assert "Usage: rigtool info" in err
    assert r"(evil\x1b]0;title\x07.h5)" in err


@pytest.mark.parametrize(
    ("arguments", "terminal", "drawn"),
    [([], True, True), (["-q"], True, False), (["--no-progress"], True, False), ([], False, False)],
)
def test_progress_only_on_a_terminal(monkeypatch, arguments, terminal, drawn):
    found = []

    @click.command(cls=Command)
    @common_options
    def command(options) -> None:
        found.append(options.progress)

    monkeypatch.setattr(sys.stderr, "isatty", lambda: terminal)
    command.main(arguments, standalone_mode=False)
    assert found == [drawn]


def test_inputs_that_were_not_given_are_left_out(tmp_path):
    with open_inputs(kt=None, friction=None) as inputs:
        assert inputs == {}
    with (
        pytest.raises(RunFileError, match="no such file"),
        open_inputs(kt=str(tmp_path / "kt.h5")),
    ):
        pass


def test_json_is_strict():
    from rigtool.cli.output import JSON_VERSION, Output, quantity_document
    from rigtool.quantity import Quantity

    results = {
        "a": Quantity(float("nan"), "N m", reason="too short"),
        "b": Quantity(1.0, "1", 0.5, float("inf")),
    }
    shown = {name: quantity_document(quantity) for name, quantity in results.items()}
    text = Output().text({"results": shown})
    assert json.loads(text)["schema"] == JSON_VERSION

    def refuse(name: str) -> None:
        raise AssertionError(name)

    found = json.loads(text, parse_constant=refuse)["results"]
    assert found["a"] == {
        "value": None,
        "unit": "N m",
        "u": None,
        "dof": None,
        "reason": "too short",
    }
    assert found["b"] == {"value": 1.0, "unit": "1", "u": 0.5, "dof": None}


def test_streams_that_take_nothing_change_no_exit_code(monkeypatch):
    """A log on a full disk ends no measurement, and an error keeps its code."""
    full = io.StringIO()
    monkeypatch.setattr(full, "write", partial(_refuse, OSError(28, "No space left on device")))
    monkeypatch.setattr(sys, "stderr", full)
    assert call(monkeypatch, None) == 0
    cli.echo("a note", err=True)
    monkeypatch.setattr(sys, "stdout", full)
    assert call(monkeypatch, RecipeError("rig.toml: is bad")) == 3
    assert call(monkeypatch, None, "--json") == 2  # this command has no such option
    with pytest.raises(OSError, match="No space"):
        cli.echo("a result")


def _refuse(error, text):
    raise error


@pytest.mark.parametrize("error", [MemoryError(), ImportError("libx.so: no segment"), OSError(5)])
def test_what_the_machine_refuses_has_a_remedy(error, monkeypatch, capsys):
    assert call(monkeypatch, error) == 1
    assert re.match(r"Error: .+: .+", capsys.readouterr().err)
