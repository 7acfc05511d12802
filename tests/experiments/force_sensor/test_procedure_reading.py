"""How far apart samples may be from which torque is read."""

from types import SimpleNamespace

import numpy as np
import pytest

from rigtool.errors import InsufficientDataError
from rigtool.experiments.controller_torque import NO_ANSWER, LoopAnswer
from rigtool.experiments.force_sensor import procedure_reading
from rigtool.experiments.force_sensor.procedure_reading import read_recording, require_interval


@pytest.mark.parametrize(("seconds", "refused"), [(0.01 * (1 + 5e-7), False), (0.01002, True)])
def test_samples_further_apart_than_a_hundredth_of_a_second_are_refused(seconds, refused):
    """A clock that is off by less than a part in a million does not count."""
    if refused:
        with pytest.raises(InsufficientDataError, match=r"run: a sample each 10 ms .* 10 ms at"):
            require_interval(seconds, "run")
    else:
        require_interval(seconds, "run")


@pytest.mark.parametrize("size", [0, 1])
def test_a_recording_of_one_sample_has_nothing_and_loses_nothing(size):
    recording = SimpleNamespace(name="short", size=size)
    found = read_recording(recording, None, None, None, None)
    assert (found.name, found.parts, found.breaks, found.lost) == ("short", (), 0, 0.0)


INTERVAL, STEP = 1e-3, 4e-3
OWN = LoopAnswer(0.7, 0.01, 0.2)


class Stretches:
    """Stands for stretches: keeps what each was given, and reads all but one sample of it."""

    def __init__(self):
        self.made, self.given, self.wanted = [], [], []
        self.known = None, None

    def __call__(
        self,
        name,
        instrument,
        began,
        size,
        workers,
        *,
        commanded=False,
        loop=NO_ANSWER,
        before=None,
    ):
        assert len(workers) == 2
        assert before == self.known  # that of the stretch before
        self.known = object(), object()
        assert loop == (OWN if commanded else NO_ANSWER)
        self.made.append((name, began, size, commanded))
        self.given.append([])
        number = len(self.given) - 1

        def reading():
            own = sum(part.shape[1] for part in self.given[number])
            stretch.seconds = (own - 1) * INTERVAL
            return [f"part {number}"]

        def add(samples, setpoint=None):
            self.given[number].append(samples)
            self.wanted.append(setpoint)

        stretch = SimpleNamespace(add=add, reading=reading, seconds=0.0, known=self.known)
        return stretch


@pytest.fixture
def read(monkeypatch):
    """Read samples that come in these blocks, of which some begin behind a gap."""

    def made(blocks, size, last, moved=0.0, channels=()):
        stretches = Stretches()
        grid = SimpleNamespace(step_time=STEP)
        instrument = SimpleNamespace(count=0.01, grid=grid, interval=INTERVAL)
        monkeypatch.setattr(procedure_reading, "Stretch", stretches)
        monkeypatch.setattr(procedure_reading, "instrument_of", lambda *given: instrument)
        monkeypatch.setattr(procedure_reading, "loop_answer", lambda recipe: OWN)
        monkeypatch.setattr(procedure_reading, "unbroken_blocks", lambda *given: iter(blocks))

        def times(name, start, stop=None):
            assert name == "time"
            if start:
                return [last]
            return [5.0] if stop == 1 else INTERVAL * np.arange(100.0)

        recording = SimpleNamespace(name="own", size=size, read=times, has=channels.__contains__)
        recipe = SimpleNamespace(rig=SimpleNamespace(sample_time=125e-6))
        return read_recording(recording, recipe, None, None, None, moved), stretches

    return made


def block(first, count):
    """Return time, encoder, current and temperature."""
    return np.stack([first + INTERVAL * np.arange(count), *np.ones((3, count))])


@pytest.mark.parametrize("channels", [(), ("position_setpoint",)])
def test_stretches_between_gaps_are_read_one_by_one(read, channels):
    blocks = [
        (block(5.0, 30), True),
        (block(5.03, 20), False),
        (block(6.0, 0), True),  # too short to be analysed
        (block(7.0, 40), True),
    ]
    if channels:  # the set point comes last
        blocks = [(np.vstack([part, -part[0]]), begins) for part, begins in blocks]
    found, stretches = read(blocks, 100, 7.039, channels=channels)
    # with the time that each began at, and room for all that is left of the recording
    expected = [("own", 5.0, 100, bool(channels)), ("own", 7.0, 50, bool(channels))]
    assert stretches.made == expected
    assert [[part.shape for part in own] for own in stretches.given] == [
        [(3, 30), (3, 20)],
        [(3, 40)],
    ]
    for wanted, (part, _) in zip(stretches.wanted, (blocks[k] for k in (0, 1, 3)), strict=True):
        np.testing.assert_array_equal(wanted, -part[0] if channels else None)
    assert (found.name, found.parts, found.breaks) == ("own", ("part 0", "part 1"), 2)
    assert found.lost == pytest.approx(2.040 - 49e-3 - 39e-3)


@pytest.mark.parametrize("moved", [0.0, 0.02, -0.034])
def test_an_encoder_that_shows_too_much_is_read_less(read, moved):
    _, stretches = read([(block(5.0, 10), True)], 10, 5.009, moved)
    ((part,),) = stretches.given
    np.testing.assert_array_equal(part[0], np.full(10, 1 - round(moved / 0.01)))
    np.testing.assert_array_equal(part[1:], np.ones((2, 10)))


@pytest.mark.parametrize("moved", [0.0, 0.02])
def test_a_set_point_stays_as_far_from_the_encoder_as_the_loop_saw_it(read, moved):
    samples = np.vstack([block(5.0, 10), np.full(10, 0.5)])
    _, stretches = read([(samples, True)], 10, 5.009, moved, ("position_setpoint",))
    np.testing.assert_allclose(stretches.wanted[0], 0.5 - moved, rtol=1e-12)


@pytest.mark.parametrize(("size", "lost"), [(10, 0.0), (16, 0.0), (18, 9e-3)])
def test_what_is_lost_without_a_gap_is_more_than_steps_that_have_not_ended(read, size, lost):
    found, _ = read([(block(5.0, 10), True)], size, 5.2)
    assert found.lost == pytest.approx(lost)


def test_all_is_lost_where_nothing_is_long_enough(read):
    found, stretches = read([(block(5.0, 0), True)], 7, 5.006)
    assert (found.parts, found.breaks, stretches.made) == ((), 0, [])
    assert found.lost == pytest.approx(7e-3)
