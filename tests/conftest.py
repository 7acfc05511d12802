"""Tests in real time run one after the other, and again where the machine stalls.

They wait more than they compute: beside them another process passes all the others. Where the
machine stalls, rigtool rightly ends the motion.
"""

import signal

import pytest

# A job in the background of a script ignores Ctrl-C, and so would every program that it starts.
signal.signal(signal.SIGINT, signal.default_int_handler)

REAL_TIME = (
    "rigs/serial/",
    "cli/test_serial_commands",
    "experiments/deploy/test_procedure",
    "experiments/live/test_",
    "test_extending",
)


def pytest_collection_modifyitems(items):
    for item in items:
        where = item.path.as_posix()
        if any(name in where for name in REAL_TIME) or "deploy" in item.name:
            # Random inputs that fail are to be seen, not drawn anew.
            if not hasattr(getattr(item, "function", None), "hypothesis"):
                item.add_marker(pytest.mark.flaky(reruns=2))
            item.add_marker(pytest.mark.xdist_group("real time"))
