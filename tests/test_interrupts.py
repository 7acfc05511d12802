"""Interrupts: none is swallowed, and none falls into a block that is held."""

import os
import signal
import subprocess
import sys
import time
import weakref

import pytest

from rigtool.interrupts import SIGNALS, Terminated, handled, held, raise_swallowed

KINDS = [(signal.SIGINT, KeyboardInterrupt), (signal.SIGTERM, Terminated)]
KINDS += [(signal.SIGQUIT, Terminated)]


def send(number):
    os.kill(os.getpid(), number)


class Thing:
    pass


@pytest.mark.parametrize(("number", "error"), KINDS)
def test_a_signal_in_a_weakref_callback_is_raised_by_the_next_check(number, error, capsys):
    thing = Thing()
    reference = weakref.ref(thing, lambda _: send(number))
    with handled():
        del thing  # Python drops what the callback raises
        assert reference() is None
        with pytest.raises(error):
            raise_swallowed()
        raise_swallowed()  # once is enough
    assert capsys.readouterr().err == ""


def test_signals_that_come_together_leave_the_way_out_whole():
    done = []

    def end():
        try:
            send(signal.SIGINT)
        finally:
            send(signal.SIGTERM)
            done.append("tidied")

    with pytest.raises(KeyboardInterrupt), handled():
        end()
    assert done == ["tidied"]


def test_signals_that_keep_coming_end_a_way_out_that_hangs():
    def hang():
        try:
            send(signal.SIGINT)
        finally:
            for _ in range(500):
                time.sleep(0.02)
                send(signal.SIGTERM)

    with pytest.raises(Terminated), handled():
        hang()


@pytest.mark.parametrize(("number", "error"), KINDS)
def test_a_signal_waits_until_what_is_held_is_done(number, error):
    done = []

    def write():
        with held():
            with held():
                send(number)
                done.append("inner")
            done.append("outer")
        done.append("never")

    with handled(), pytest.raises(error):
        write()
    assert done == ["inner", "outer"]


def test_what_is_held_waits_outside_the_command_line_too():
    """As in a notebook, where nothing has installed the handlers."""
    done = []

    def write():
        with held():
            send(signal.SIGINT)
            done.append("whole")
        done.append("never")

    with pytest.raises(KeyboardInterrupt):
        write()
    assert done == ["whole"]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_an_interrupt_that_arrived_is_not_raised_again_while_things_are_closed():
    closed = []

    def run():
        try:
            send(signal.SIGTERM)
        finally:
            with held():
                closed.append("file")
            closed.append("line")

    with handled(), pytest.raises(Terminated):
        run()
    assert closed == ["file", "line"]


def test_ignored_signals_stay_ignored_and_handlers_come_back():
    before = signal.signal(signal.SIGTERM, signal.SIG_IGN)
    hook = sys.unraisablehook
    try:
        with handled():
            send(signal.SIGTERM)
            raise_swallowed()
        assert signal.getsignal(signal.SIGTERM) is signal.SIG_IGN
        assert sys.unraisablehook is hook
    finally:
        signal.signal(signal.SIGTERM, before)


@pytest.mark.parametrize(("number", "error"), KINDS)
@pytest.mark.parametrize("noted", ["interrupt", "other"])
def test_an_interrupt_that_became_another_error_is_an_interrupt(number, error, noted):
    def leave():
        try:
            send(number)
        except BaseException as interrupt:  # as a compiled function does on its way out, or click
            other = SystemError("returned a result with an exception set")
            {"interrupt": interrupt, "other": other}[noted].add_note("samples are kept")
            raise other from interrupt

    with pytest.raises(error) as caught, handled():
        leave()
    assert caught.value.__notes__ == ["samples are kept"]
    with pytest.raises(SystemError), handled():  # without a signal it stays what it is
        raise SystemError


@pytest.mark.parametrize(("number", "error"), KINDS)
def test_a_signal_while_another_is_swallowed_prints_nothing(number, error):
    class Arguments(int):
        exc_type = property(signal.raise_signal)  # in the frame of the hook; gives no type

    with handled():
        with pytest.raises(TypeError):
            sys.unraisablehook(Arguments(number))
        with pytest.raises(error):
            raise_swallowed()


def test_a_signal_while_handlers_are_put_back_leaves_none_behind(monkeypatch):
    before = {number: signal.getsignal(number) for number in SIGNALS}
    put, sent = signal.signal, []

    def interrupted(number, handler):
        if not sent:
            sent.append(number)
            send(signal.SIGINT)
        return put(number, handler)

    with handled():
        monkeypatch.setattr(signal, "signal", interrupted)
    assert sent
    assert {number: signal.getsignal(number) for number in SIGNALS} == before


def test_a_copy_takes_a_signal_that_comes_while_it_begins():
    code = """
import signal
from rigtool.interrupts import begin_anew, handled, held

put = signal.signal

def interrupted(number, handler):
    if number == signal.SIGINT:
        signal.raise_signal(signal.SIGTERM)
    return put(number, handler)

with handled(), held():
    signal.signal = interrupted
    begin_anew()
"""
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (found.returncode, found.stderr) == (-signal.SIGTERM, "")
