"""Where an imported shaft is, from whatever was recorded of it."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid

from rigtool.errors import RunFileError, UsageError
from rigtool.experiments.imported import (
    moves,
    place,
    position_of,
    recordings_of,
    require_one_rig,
)

TIME = 3.0 + np.cumsum(np.random.default_rng(1).uniform(0.5, 1.5, 50))
COUNTS = np.arange(50.0)
SPEED = np.sin(TIME)


def recording(*signals, name="imported", **conditions):
    known = {"time": TIME, "position": TIME**2, "encoder": COUNTS, "speed": SPEED}
    held = {"time": TIME} | {signal: known[signal] for signal in signals}
    return SimpleNamespace(
        name=name,
        path="run.h5",
        conditions=conditions,
        condition=conditions.__getitem__,
        has=held.__contains__,
        read=held.__getitem__,
    )


@pytest.mark.parametrize(
    ("given", "expected", "measured"),
    [
        (recording("position", "encoder", "speed", encoder_counts=100.0), TIME**2, True),
        (recording("encoder", "speed", encoder_counts=100.0), COUNTS * 2 * np.pi / 100, True),
        (recording("encoder", encoder_counts=100.0, linear_axis=1.0), COUNTS / 100, True),
        (recording("encoder", encoder_counts=100.0, linear_axis=0.0), COUNTS * 0.02 * np.pi, True),
        (recording("encoder", "speed"), cumulative_trapezoid(SPEED, TIME, initial=0), True),
        (recording(constant_speed=-3.0), -3.0 * (TIME - TIME[0]), False),
    ],
)
def test_the_best_that_is_known_is_the_position(given, expected, measured):
    np.testing.assert_allclose(position_of(given), expected, rtol=1e-12, atol=1e-12)
    assert moves(given) == measured


def test_a_position_that_nothing_states_is_refused():
    given = recording("encoder", name="imported_001")
    assert not moves(given)
    with pytest.raises(RunFileError, match=r"run\.h5, imported_001: the position is unknown"):
        position_of(given)
    assert place(recording()) == "run.h5"


def test_runs_of_two_rigs_are_refused():
    alike = [recording(encoder_counts=100.0, load=float(n)) for n in range(3)]
    require_one_rig(alike)
    for other in (recording(encoder_counts=200.0), recording()):
        with pytest.raises(UsageError, match="give runs of one rig"):
            require_one_rig([*alike, other])


def test_a_recording_that_is_given_twice_is_no_repeat():
    def run(path, content):
        made = recording()
        return SimpleNamespace(
            path=path,
            content_sha256=content,
            recordings_named=lambda start: [],
            recording=lambda name: made,
        )

    one, other, copy = run("a.h5", "1"), run("b.h5", "2"), run("c.h5", "1")
    assert len(recordings_of([one, other])) == 2
    with pytest.raises(UsageError, match=r"c\.h5 holds the same as a\.h5"):
        recordings_of([one, other, copy])
