"""How far apart samples may be from which torque is read."""

from types import SimpleNamespace

import pytest

from rigtool.errors import InsufficientDataError
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
