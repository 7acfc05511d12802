"""Figures drawn by two processes are those that one draws."""

import os
import subprocess
import sys
import threading
from functools import partial

import pytest

from rigtool.report.figures import side_by_side

BOTH_WAYS = """
import os
from functools import partial
from rigtool.report.figures import side_by_side, style

side_by_side._may_fork = lambda: True  # on one core as well
forks, fork = [], os.fork
os.fork = lambda: forks.append(1) or fork()

def drawn(number):
    return style.render_figure(style.one_panel("x", f"y{number}")[0])

figures = [partial(drawn, number) for number in range(4)]
own = []
by = [lambda n=n: (n, os.getpid(), own.append(n)) for n in range(500)]
with style.styled():
    alone = [draw() for draw in figures]
    assert side_by_side.draw_all(figures) == alone and len(forks) == 1
    numbers, processes, _ = zip(*side_by_side.draw_all(by))
    assert numbers == tuple(range(500))
    others = [process for process in processes if process != os.getpid()]
    assert len(own) + len(others) <= 501  # at most one is drawn by both
    side_by_side._draw_and_exit = lambda figures, taken, sender: os._exit(1)
    assert side_by_side.draw_all(figures) == alone and len(forks) == 3
    take_all = lambda figures, taken, sender: taken.write(b"1" * 4) and os._exit(1)
    side_by_side._draw_and_exit = take_all
    assert side_by_side.draw_all(figures) == alone and len(forks) == 4
try:
    os.wait()
except ChildProcessError:
    print("no process is left")
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork")
def test_two_processes_draw_what_one_draws_also_where_the_second_ends_early():
    done = subprocess.run(
        [sys.executable, "-c", BOTH_WAYS], capture_output=True, text=True, check=False
    )
    assert done.stdout == "no process is left\n", done.stderr
    assert done.stderr == ""


def test_a_process_with_threads_is_not_forked(monkeypatch):
    monkeypatch.setattr(side_by_side, "_second_process", None)  # a fork would fail
    done = threading.Event()
    thread = threading.Thread(target=done.wait)
    thread.start()
    try:
        figures = [partial(int, number) for number in range(6)]
        assert side_by_side.draw_all(figures) == list(range(6))
    finally:
        done.set()
        thread.join()
