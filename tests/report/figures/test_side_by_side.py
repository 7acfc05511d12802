"""Figures drawn by two processes are those that one draws."""

import os
import subprocess
import sys
import threading

import pytest

from rigtool.report.figures import side_by_side

BOTH_WAYS = """
import os
from rigtool.report.figures import side_by_side, style

side_by_side._may_fork = lambda: True  # on one core as well
forks, fork = [], os.fork
os.fork = lambda: forks.append(1) or fork()

def drawn(draw):
    figures = [style.one_panel("x", f"y{number}")[0] for number in range(5)]
    return draw(figures)

with style.styled():
    alone = drawn(lambda figures: [style.render(figure) for figure in figures])
    assert drawn(side_by_side.render_all) == alone and len(forks) == 1
    side_by_side._draw_and_exit = lambda figures, sender: os._exit(1)
    assert drawn(side_by_side.render_all) == alone and len(forks) == 2
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
    monkeypatch.setattr(side_by_side, "render", lambda figure: figure)
    monkeypatch.setattr(side_by_side, "_second_process", None)  # a fork would fail
    done = threading.Event()
    thread = threading.Thread(target=done.wait)
    thread.start()
    try:
        assert side_by_side.render_all(list(range(6))) == list(range(6))
    finally:
        done.set()
        thread.join()
