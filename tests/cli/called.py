"""A command line, run in this process as the program runs it."""

import signal

import pytest

import rigtool.cli as cli


def exit_code(*arguments: object) -> int:
    before = signal.getsignal(signal.SIGTERM)
    try:
        with pytest.raises(SystemExit) as caught:
            cli.main([str(argument) for argument in arguments])
    finally:
        signal.signal(signal.SIGTERM, before)
    assert isinstance(caught.value.code, int)
    return caught.value.code


def call(capsys, *arguments: object) -> tuple[int, str, str]:
    """Return the exit code, and what is written to stdout and stderr."""
    code = exit_code(*arguments)
    found = capsys.readouterr()
    assert "Traceback" not in found.err
    return code, found.out, found.err
