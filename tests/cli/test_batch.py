"""`rigtool batch`: lines that run as if each were a command of its own."""

import json
import os
import shlex
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import click
import pytest

import rigtool.cli as cli
from rigtool.runfile import open_run
from tests.cli.called import call

ROOT = Path(__file__).parents[2]
FIXTURES = ROOT / "tests" / "fixtures"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    shutil.copy(FIXTURES / "kt.h5", tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("SOURCE_DATE_EPOCH", raising=False)
    return tmp_path


def process(*arguments, code=None, **options):
    """Run rigtool in a process of its own, where no other thread hinders a fork."""
    begin = ["-m", "rigtool"] if code is None else ["-c", code]
    return subprocess.run(
        [sys.executable, *begin, *arguments], capture_output=True, text=True, **options
    )


LINES = """\
info kt.h5 --json --no-tables   # as a document

info 'no such.h5'
diff kt.h5 kt.h5
info kt.h5 -q
"""


def test_each_line_prints_what_it_prints_alone(folder, capsys):
    Path("lines.txt").write_text(LINES)
    found = process("batch", "lines.txt", "-j", "3")
    codes, outs, errs = zip(
        *(
            call(capsys, *words)
            for words in (
                ("info", "kt.h5", "--json", "--no-tables"),
                ("info", "no such.h5"),
                ("diff", "kt.h5", "kt.h5"),
                ("info", "kt.h5", "-q"),
            )
        ),
        strict=True,
    )
    assert codes == (0, 3, 0, 0)
    assert found.stdout == "".join(outs)
    assert found.stderr.splitlines() == [
        *"".join(errs[:2]).splitlines(),
        "lines.txt, line 3: exit code 3: info 'no such.h5'",
        *"".join(errs[2:]).splitlines(),
        "lines.txt: 3 of 4 lines done, 1 failed with exit code 3",
    ]
    assert found.returncode == 3


def test_a_run_of_a_batch_is_a_run_as_any_other(folder, capsys, monkeypatch):
    recipe = ROOT / "recipes" / "briaire-2006.toml"
    line = f"suspension {shlex.quote(str(recipe))} -o {{}}.h5 --seed 1 -q"
    Path("lines.txt").write_text(line.format("first") + "\n" + line.format("many"))
    assert process("batch", "lines.txt").returncode == 0
    monkeypatch.setattr(sys, "argv", ["rigtool", *shlex.split(line.format("one"))])
    assert call(capsys, *sys.argv[1:])[0] == 0
    with open_run("many.h5") as many, open_run("one.h5") as one:
        assert many.results == one.results
        assert many.provenance["argv"] == ["rigtool", *shlex.split(line.format("many"))]
        assert one.provenance["argv"] == sys.argv


OWN_COMMAND = """
import importlib, os, signal, sys, time
import click
import rigtool.cli as cli

@click.command()
@click.argument("name")
def command(name):
    {body}

cli.COMMANDS = {{"batch": "", "do": ""}}
found = cli.LazyGroup.get_command
cli.LazyGroup.get_command = lambda *given: command if given[-1] == "do" else found(*given)
cli.main(["batch", "-", "-j", "{jobs}"])
"""
"""A program whose command line has `batch`, and the command `do`."""


def own(body, jobs=1):
    return OWN_COMMAND.format(body=body, jobs=jobs)


def test_lines_share_imports_and_no_more():
    body = (
        "print(name in sys.modules, click.__doc__); click.__doc__ = importlib.import_module(name)"
    )
    found = process(code=own(body), input="do json.tool\ndo json.tool\n")
    document = click.__doc__
    assert found.stdout == f"False {document}\nTrue {document}\n", found.stderr


def test_a_line_that_dies_is_counted_and_ends_no_other():
    body = "os.kill(os.getpid(), signal.SIGKILL) if name == 'x' else print(name, flush=True)"
    found = process(code=own(body, jobs=2), input="do a\ndo x\ndo b")
    assert (found.returncode, found.stdout) == (137, "a\nb\n")
    assert found.stderr.splitlines() == [
        "-, line 2: exit code 137: do x",
        "-: 2 of 3 lines done, 1 failed with exit code 137",
    ]


def test_lines_have_no_input_and_end_in_any_order():
    body = "time.sleep(float(name)); print(name, repr(sys.stdin.read()))"
    found = process(code=own(body, jobs=3), input="do 0.2\ndo 0\ndo 0.1\n")
    assert found.stdout == "0.2 ''\n0 ''\n0.1 ''\n", found.stderr


def test_what_a_line_printed_before_it_was_killed_is_not_lost():
    body = "print(name); os.kill(os.getpid(), 9) if name == 'b' else None"
    found = process(code=own(body, jobs=2), input="do a\ndo b\n")
    assert (found.returncode, found.stdout) == (137, "a\nb\n"), found.stderr


@pytest.mark.parametrize("group", [False, True], ids=["batch", "terminal"])
@pytest.mark.parametrize(
    ("number", "code", "word"),
    [(signal.SIGINT, 130, "KeyboardInterrupt"), (signal.SIGTERM, 143, "Terminated")],
)
def test_signals_go_on_to_all_that_run(tmp_path, number, code, word, group):
    """Those of a terminal reach all processes by themselves, and once more by the batch: what is
    written is held until it is whole. A line asks for what a finaliser swallowed, as commands do at
    each block: one that closes a file that nobody closed drops an exception that comes in it."""
    body = """
    from rigtool.interrupts import held, raise_swallowed
    try:
        open(name, "x").close()
        for _ in range(6000):
            raise_swallowed()
            time.sleep(0.01)
    except BaseException as error:
        with held():
            print(type(error).__name__)
        raise
"""
    running = subprocess.Popen(
        [sys.executable, "-c", own(body, jobs=2)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=tmp_path,
        start_new_session=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    assert running.stdin is not None
    running.stdin.write("do a\ndo b\ndo c\n")
    running.stdin.close()
    while len(os.listdir(tmp_path)) < 2:
        assert running.poll() is None
        time.sleep(0.01)
    (os.killpg if group else os.kill)(running.pid, number)
    running.stdin = None
    printed, message = running.communicate()
    assert (running.returncode, printed) == (code, f"{word}\n{word}\n")
    assert "2 of 3 lines ended" in message
    assert sorted(os.listdir(tmp_path)) == ["a", "b"]


def test_a_signal_that_a_finaliser_swallows_ends_the_batch():
    code = """
import rigtool.cli.batch as batch

class Last:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGTERM)

batch._import_listed = lambda path: Last()
"""
    head, _, rest = own("print(name)").partition("cli.COMMANDS")
    found = process(code=f"{head}{code}cli.COMMANDS{rest}", input="do a\ndo b\n")
    assert (found.returncode, found.stdout) == (143, "a\n"), found.stderr
    assert found.stderr.splitlines() == ["terminated", "1 of 2 lines ended"]


def test_where_no_copy_can_be_made_each_line_is_a_process(folder):
    code = (
        "import rigtool.cli.batch as batch, rigtool.cli as cli\n"
        "batch.may_fork = lambda: False\n"
        "cli.main(['batch', '-', '--json', '-j', '2'])"
    )
    found = process(code=code, input="info no.h5\ninfo kt.h5 -q\n")
    assert found.returncode == 3, found.stderr
    lines = json.loads(found.stdout)["lines"]
    assert [line["exit_code"] for line in lines] == [3, 0]
    assert "no.h5: no such file" in lines[0]["stderr"]
    assert lines[1] == {"line": "info kt.h5 -q", "exit_code": 0, "stdout": "", "stderr": ""}


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("inof kt.h5", "Did you mean info?"),
        ("info", "Missing argument"),
        ("info kt.h5 --no-such", "No such option"),
        ("calibrate-kt kt.h5 -o o.h5 --seed x", "Invalid value for '--seed'"),
        ("info 'kt.h5", "No closing quotation: correct the line"),
        ("info \xff", "byte 5 of the line is not UTF-8; give a text, saved in UTF-8"),
        ("info \0", "NUL"),
        ("info --help", "asks for no help"),
        ("rigtool info a.h5", "without `rigtool`"),
        ("--version", "begins with a command"),
        ("batch lines.txt", "other than batch"),
    ],
)
def test_a_wrong_line_is_refused_before_any_runs(folder, capsys, line, message):
    text = f"export kt.h5 -o out.csv\n\n{line}\n"
    Path("lines.txt").write_bytes(text.encode("latin-1"))
    with pytest.raises(SystemExit) as end:
        cli.main(["batch", "lines.txt"])
    printed = capsys.readouterr()
    assert (end.value.code, printed.out) == (2, "")
    assert "lines.txt, line 3: " in printed.err
    assert message in printed.err
    assert sorted(os.listdir()) == ["kt.h5", "lines.txt"]


@pytest.mark.parametrize(("name", "message"), [("no.txt", "no.txt"), (".", "is a folder")])
def test_a_file_that_is_none(folder, capsys, name, message):
    with pytest.raises(SystemExit) as end:
        cli.main(["batch", name])
    assert (end.value.code, message in capsys.readouterr().err) == (2, True)
