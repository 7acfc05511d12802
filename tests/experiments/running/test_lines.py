"""Lines of JSON to a reader that is quick, slow, stuck or gone."""

import json
import os
import threading

import numpy as np
import pytest

from rigtool.experiments.running import lines as module
from rigtool.experiments.running.lines import MAX_WAITING_BLOCKS, JsonLines


@pytest.fixture
def pipe():
    """A reader's and a writer's end, unbuffered."""
    reader, writer = os.pipe()
    with open(reader, "rb") as source, open(writer, "wb", buffering=0) as out:
        yield source, out


def rows(first, count=2):
    number = np.arange(first, first + count)
    return {"time": number * 0.1, "torque": np.where(number % 2, np.nan, 1e-3), "state": number}


def test_each_row_is_a_line_of_strict_json(pipe):
    source, out = pipe
    lines = JsonLines(out, waits=True)
    lines.show("a", rows(0, 3))
    lines.show("a", rows(3, 0))
    lines.close()
    out.close()
    assert [json.loads(line) for line in source] == [
        {"time": 0.0, "torque": 1e-3, "state": 0},
        {"time": 0.1, "torque": None, "state": 1},
        {"time": 0.2, "torque": 1e-3, "state": 2},
    ]
    assert lines.missed == 0


def test_a_reader_that_is_gone_disturbs_nobody(pipe):
    source, out = pipe
    source.close()
    lines = JsonLines(out, waits=True)
    for number in range(3 * MAX_WAITING_BLOCKS):
        lines.show("a", rows(number))
    lines.close()
    assert lines.missed == 6 * MAX_WAITING_BLOCKS


def test_a_stuck_reader_is_not_waited_for_on_a_physical_rig(pipe, monkeypatch):
    monkeypatch.setattr(module, "CLOSING_TIME", 0.1)
    source, out = pipe
    lines, total = JsonLines(out, waits=False), 5000
    for number in range(total):
        lines.show("a", rows(10 * number, 10))
    lines.close()  # the pipe is full: the thread hangs in it
    first = lines.missed
    assert 0 < first < 10 * total
    assert json.loads(source.readline()) == {"time": 0.0, "torque": 1e-3, "state": 0}
    source.close()
    lines._thread.join(5)
    assert not lines._thread.is_alive()


def test_a_slow_reader_of_a_virtual_rig_gets_every_line(pipe):
    source, out = pipe
    lines, total, got = JsonLines(out, waits=True), 2000, []
    reader = threading.Thread(target=lambda: got.extend(source))
    producer = threading.Thread(
        target=lambda: [lines.show("a", rows(number, 10)) for number in range(total)]
    )
    producer.start()
    producer.join(0.3)
    assert producer.is_alive()  # the pipe and all that may wait is full
    reader.start()
    producer.join()
    lines.close()
    out.close()
    reader.join()
    assert len(got) == 10 * total
    assert lines.missed == 0


def test_an_interrupt_does_not_wait_for_a_stuck_reader(pipe):
    source, out = pipe
    lines = JsonLines(out, waits=True)
    for number in range(MAX_WAITING_BLOCKS):
        lines.show("a", rows(100 * number, 100))
    lines.close(at_once=True)
    assert lines._thread.is_alive()
    source.close()
    lines._thread.join(5)
    assert not lines._thread.is_alive()
    assert lines.missed > 0
