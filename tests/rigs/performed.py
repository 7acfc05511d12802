"""Signals of a task, whole."""

import numpy as np

from rigtool.rigs.operator import Operator


def perform(rig, task):
    """Let a rig perform a task; return its signals by channel."""
    blocks = list(rig.perform(task))
    return {name: np.concatenate([block[name] for block in blocks]) for name in blocks[0]}


def require_replayed(rig_of, served, task, folder):
    """Perform a task on a served device and from the record of its line: the signals are alike.

    `rig_of` makes a rig of a port and an operator.
    """
    path, signals = folder / "line.spy", []
    with served as server:
        for port, spy in ((server.port, str(path)), (f"replay://{path}", None)):
            operator = Operator(say=lambda text: None, present=False, yes=True, spy=spy)
            with rig_of(port, operator=operator) as rig:
                signals.append(perform(rig, task))
    for name, values in signals[0].items():
        np.testing.assert_array_equal(signals[1][name], values)
