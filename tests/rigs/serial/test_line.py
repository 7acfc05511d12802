"""A line over a pseudo-terminal: requests, retries, what passes for an answer, spy and replay."""

import time

import pytest
import serial
from hypothesis import given
from hypothesis import strategies as st

from rigtool.errors import HardwareError, RecipeError
from rigtool.rigs.serial.emulators.server import Emulator
from rigtool.rigs.serial.line import DamagedReply, Line, LineLost, LineTimeout
from rigtool.rigs.serial.transport.spy import Event, Spy, read_spy
from tests.rigs.serial.emulators.faults import Fault, serve


class Echo(Emulator):
    """Answers each line with the same in capitals."""

    def __init__(self):
        self.heard = b""

    def receive(self, data):
        self.heard += data
        *lines, rest = (getattr(self, "rest", b"") + data).split(b"\n")
        self.rest = rest
        return b"".join(line.upper() + b"\r\n" for line in lines)


def same(word):
    return lambda line: line if line == word else None


def test_ask_returns_what_answers():
    with serve(Echo()) as server, Line(server.port) as line:
        assert line.ask(b"hello\n", same(b"HELLO")) == b"HELLO"
        assert line.counts.requests == 1
        assert line.counts.retries == 0
        assert line.counts.bytes_received == 7


@pytest.mark.parametrize("tcp", [False, True])
def test_damaged_and_missing_answers_are_asked_for_again(tcp):
    faults = (Fault("cut", at=0), Fault("flip", at=2), Fault("silence", at=4, duration=0.05))

    def accept(text):
        if text != b"HELLO":
            raise DamagedReply(repr(text))
        return text

    with serve(Echo(), *faults, tcp=tcp) as server, Line(server.port, timeout=0.04) as line:
        for _ in range(4):
            assert line.ask(b"hello\n", accept) == b"HELLO"
        assert line.counts.retries >= 2
        assert line.counts.timeouts + line.counts.damaged == line.counts.retries


def test_answer_to_an_older_question_is_passed_over():
    with serve(Echo(), Fault("late", at=0)) as server, Line(server.port, timeout=0.05) as line:
        with pytest.raises(LineLost):
            line.ask(b"first\n", same(b"FIRST"), retries=0)
        assert line.ask(b"second\n", same(b"SECOND")) == b"SECOND"
        assert line.counts.stray_bytes == len(b"FIRST\r\n")


def test_what_must_not_be_done_twice_is_sent_once():
    device = Echo()
    with (
        serve(device, Fault("silence")) as server,
        Line(server.port, timeout=0.03) as line,
        pytest.raises(LineLost, match="1 attempt:"),
    ):
        line.ask(b"go\n", same(b"GO"), retries=0)
    assert device.heard == b"go\n"


def test_refusals_are_not_asked_again():
    def accept(text):
        raise HardwareError("refused")

    with serve(Echo()) as server, Line(server.port) as line:
        with pytest.raises(HardwareError, match="refused"):
            line.ask(b"go\n", accept)
        assert line.counts.retries == 0


def test_reading_exactly_until_and_giving_back():
    with serve(Echo()) as server, Line(server.port, timeout=0.05) as line:
        line.write(b"abc\ndef\n")
        assert line.read_until(b"\n") == b"ABC\r\n"
        assert line.read_exactly(2) == b"DE"
        line.give_back(b"DE")
        assert line.read_exactly(5) == b"DEF\r\n"
        with pytest.raises(LineTimeout, match="3 bytes did not come"):
            line.read_exactly(3)
        assert line.read_some(0.0) == b""


@pytest.mark.parametrize("tcp", [False, True])
def test_pulled_cable_is_a_lost_line(tcp):
    with (
        serve(Echo(), Fault("pull", at=1), tcp=tcp) as server,
        Line(server.port, timeout=0.5) as line,
    ):
        line.ask(b"one\n", same(b"ONE"))
        start = time.monotonic()
        with pytest.raises(LineLost, match="cable pulled"):
            line.ask(b"two\n", same(b"TWO"))
        assert time.monotonic() - start < 0.4


@pytest.mark.parametrize(
    ("port", "message"),
    [
        ("/dev/no-such-port", "there is no such port"),
        ("socket://127.0.0.1:1", "nothing listens"),
        ("socket://127.0.0.1:none", "cannot be opened: .* give socket://HOST:PORT"),
        ("socket://", "cannot be opened: .* give socket://HOST:PORT"),
        ("/dev/null", "this is no serial port"),
        ("/tmp", "this is no serial port"),
        ("nonsense://x", "cannot be opened"),
    ],
)
def test_ports_that_cannot_be_opened(port, message):
    with pytest.raises(HardwareError, match=message):
        Line(port)


def test_port_of_another_program():
    with (
        serve(Echo()) as server,
        Line(server.port),
        pytest.raises(HardwareError, match="another program has it open"),
    ):
        Line(server.port)


def test_port_without_permission(monkeypatch):
    def refuse(*arguments, **options):
        raise serial.SerialException(13, "could not open port: [Errno 13] Permission denied")

    monkeypatch.setattr(serial, "serial_for_url", refuse)
    with pytest.raises(HardwareError, match="group of the port"):
        Line("/dev/ttyACM0")


@given(st.lists(st.tuples(st.sampled_from("<>"), st.binary(max_size=50)), max_size=8))
def test_spy_files_come_back_byte_for_byte(tmp_path_factory, said):
    path = tmp_path_factory.mktemp("spy") / "line.spy"
    events = [Event(float(n) / 7, kind, data) for n, (kind, data) in enumerate(said)]
    events.append(Event(1 / 3, "."))
    spy = Spy(path, "toy")
    for event in events:
        spy.note(event)
    spy.close()
    assert read_spy(path) == ("toy", events)


def test_replay_says_the_same_at_the_same_times(tmp_path):
    def talk(line):
        got = [line.now()]
        for word in (b"one", b"two"):
            got.append(line.ask(word + b"\n", same(word.upper())))
            got.append(line.now())
        return got

    path = tmp_path / "line.spy"
    with (
        serve(Echo(), Fault("cut", at=1)) as server,
        Line(server.port, spy=path, driver="toy", timeout=0.05) as line,
    ):
        then = talk(line)
        assert line.counts.retries == 1
    with Line(f"replay://{path}", timeout=0.05) as line:
        assert talk(line) == then
        assert line.counts.retries == 1
        with pytest.raises(HardwareError, match="the record ends here"):
            line.write(b"more")
    with (
        Line(f"replay://{path}") as line,
        pytest.raises(HardwareError, match=r"the host sent b'one\\n', now it sends b'two\\n'"),
    ):
        line.write(b"two\n")


def test_files_that_are_no_spy_files(tmp_path):
    path = tmp_path / "line.spy"
    with pytest.raises(RecipeError, match="cannot be read"):
        read_spy(path)
    path.write_text("recipe = 1\n")
    with pytest.raises(RecipeError, match="is not a file of --spy"):
        read_spy(path)
    path.write_text("# rigtool spy 1 driver=toy\n0.1 > a\nnonsense\n0.2 > b\n")
    with pytest.raises(RecipeError, match=":3: is not an event"):
        read_spy(path)
    path.write_text("# rigtool spy 1 driver=toy\n0.1 > a\n0.2 > \\x0")  # cut by a kill
    assert read_spy(path) == ("toy", [Event(0.1, ">", b"a")])
    path.write_text("# rigtool spy 3 driver=toy\n")
    with pytest.raises(RecipeError, match="version 3, this rigtool knows 2 and older"):
        read_spy(path)
    for wrong in ("0.1 force? a", "0.1 f0rce> a", "0.1  a"):
        path.write_text(f"# rigtool spy 2 driver=toy\n{wrong}\n0.2 > b\n")
        with pytest.raises(RecipeError, match=":2: is not an event"):
            read_spy(path)


OLD = "# rigtool spy 1 driver=toy\n0.01 . \n0.02 > one\\n\n0.03 < O\n0.04 < NE\\r\\n\n0.05 . \n"


def test_files_of_version_1_still_play_back(tmp_path):
    path = tmp_path / "old.spy"
    path.write_text(OLD)
    with Line(f"replay://{path}") as line:
        assert line.now() == 0.01
        assert line.ask(b"one\n", same(b"ONE")) == b"ONE"
        assert line.now() == 0.05
        with pytest.raises(HardwareError, match="holds nothing of the force gauge: it was rec"):
            Line("/dev/pts/7", beside=line, role="force")


def test_late_answers_and_lost_lines_come_again_where_they_came(tmp_path):
    """What came too late then must not answer in time now."""

    def talk(line):
        line.write(b"first\n")
        with pytest.raises(LineTimeout):
            line.read_until(b"\n")
        line.write(b"second\n")
        got = [line.read_until(b"\n"), line.read_until(b"\n")]
        with pytest.raises(LineLost, match="cable pulled") as lost:
            line.ask(b"third\n", same(b"THIRD"))
        return [*got, str(lost.value).partition(": ")[2]]

    path = tmp_path / "line.spy"
    faults = Fault("late", at=0), Fault("pull", at=2)
    with serve(Echo(), *faults) as server, Line(server.port, spy=path, timeout=0.05) as line:
        then = talk(line)
    with Line(f"replay://{path}", timeout=0.05) as line:
        assert talk(line) == then


class Hesitating(Echo):
    """Answers after a while."""

    def receive(self, data):
        self.answer, self.due = super().receive(data), time.monotonic() + 0.1
        return b""

    def idle(self):
        if getattr(self, "answer", b"") and time.monotonic() > self.due:
            answer, self.answer = self.answer, b""
            return answer
        return b""


def test_what_was_dropped_unread_then_is_not_read_now(tmp_path):
    def talk(line):
        line.write(b"first\n")
        with pytest.raises(LineTimeout):
            line.read_until(b"\n")
        line.pause(0.15)
        return line.settle(), line.ask(b"second\n", same(b"SECOND"), timeout=1.0)

    path = tmp_path / "line.spy"
    with serve(Hesitating()) as server, Line(server.port, spy=path, timeout=0.03) as line:
        then = talk(line)
    assert then == (len(b"FIRST\r\n"), b"SECOND")
    with Line(f"replay://{path}", timeout=0.03) as line:
        assert talk(line) == then


def test_a_line_that_was_lost_while_rigtool_wrote_is_lost_again(tmp_path):
    path = tmp_path / "line.spy"
    path.write_text("# rigtool spy 2 driver=odrive\n0.1 > a\n0.2 < late\n0.3 ! cable pulled\n")
    with Line(f"replay://{path}", 115200) as line:
        line.write(b"a")
        for _ in range(2):
            with pytest.raises(LineLost, match="cable pulled"):
                line.write(b"b")
