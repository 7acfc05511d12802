"""How far apart samples may be from which torque is read."""

import pytest

from rigtool.errors import InsufficientDataError
from rigtool.experiments.force_sensor.procedure_reading import require_interval


@pytest.mark.parametrize(("seconds", "refused"), [(0.01 * (1 + 5e-7), False), (0.01002, True)])
def test_samples_further_apart_than_a_hundredth_of_a_second_are_refused(seconds, refused):
    """A clock that is off by less than a part in a million does not count."""
    if refused:
        with pytest.raises(InsufficientDataError, match=r"run: a sample each 10 ms .* 10 ms at"):
            require_interval(seconds, "run")
    else:
        require_interval(seconds, "run")
