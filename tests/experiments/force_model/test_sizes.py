"""Sizes of a rig from its records, and where the search for a tendon begins."""

import math
from dataclasses import replace

import numpy as np
import pytest

from rigtool.errors import InsufficientDataError
from rigtool.experiments.force_model.learning import _showing_tendon, _start, sizes_of
from rigtool.experiments.force_model.model import Known, Sizes
from rigtool.experiments.force_model.records import Record
from rigtool.quantity import STANDARD_GRAVITY

SIZE = 1000
PHASE = 2 * np.pi * np.arange(SIZE) / SIZE
KNOWN = Known(0.85, 1.18, 2e-5)


def record(friction=5e-3, ripple=1e-3, moment=0.0, reach=1.3, size=SIZE):
    """Strokes of 2 s whose torque is friction and ripple; the current is another one at turns."""
    phase = 2 * np.pi * np.arange(size) / size
    angle = reach - reach * np.cos(phase)
    way = np.sign(np.sin(phase))
    torque = way * friction + way * ripple * np.sqrt(2) * np.cos(8 * phase) + 3e-4
    trusted = np.abs(np.sin(phase)) > 0.3
    current = np.where(trusted, torque, 3 * torque) / 0.05
    return Record(2.0 / size, angle, current, trusted, 0.05, moment, 0.0, 3, np.empty((3, 0)))


def test_sizes_are_medians_of_strokes_without_load_and_the_largest_of_all():
    records = [record(5e-3, 4e-3), record(6e-3, 2e-3), record(9e-3, 1.5e-3), record(1.0, 1.0, 0.05)]
    found = sizes_of(records)
    assert found.friction == pytest.approx(6e-3, rel=0.04)
    assert found.ripple == pytest.approx(2e-3, rel=0.1)
    assert found.load == 0.05
    assert found.current == pytest.approx(max(np.abs(r.current).max() for r in records))
    assert found.speed == pytest.approx(1.3 * math.pi, rel=1e-3)


def test_strokes_in_one_direction_show_no_friction():
    one_way = record()
    one_way = replace(one_way, trusted=one_way.trusted & (np.sin(PHASE) > 0))
    with pytest.raises(InsufficientDataError, match="without load slides in both directions"):
        sizes_of([one_way, record(moment=0.02)])


def test_the_tendon_shows_in_the_largest_load_and_in_equal_strokes_without_one():
    free, slow = record(), record(size=2 * SIZE)
    small, large = record(moment=0.01), record(moment=0.05)
    found = _showing_tendon([free, slow, small, large])
    assert [any(one is other for other in found) for one in (free, slow, small, large)] == [
        True,
        False,
        False,
        True,
    ]


@pytest.mark.parametrize(("load", "expected"), [(0.06, 0.06), (0.0, 5e-3 * 1.18)])
def test_the_search_begins_at_a_stretch_of_the_tendon(load, expected):
    """A damping ratio of a tenth under the load's own inertia, 70 Hz of the bare output."""
    found = _start(Sizes(5e-3, 1e-3, load, 1.0, 20.0), KNOWN, 1e-3, 4e-3, 0.2)
    assert found.bearing_length == 4e-3
    assert found.housing_length == pytest.approx(24e-3)
    stiffness = expected / 0.2
    assert found.stiffness == pytest.approx(stiffness)
    inertia = expected / 0.02 / STANDARD_GRAVITY * 0.02**2
    assert found.damping / (2 * math.sqrt(stiffness * inertia)) == pytest.approx(0.1)
    hertz = math.sqrt(stiffness / found.grasper_inertia) / (2 * math.pi)
    assert hertz == pytest.approx(70.0)
    assert found.stribeck_speed == pytest.approx(2 * 160 * 1e-3)  # twice that of sliding
    assert found.load_onset < expected / 10
    assert found.tip_length == pytest.approx(6e-3)
    assert found.tip_friction == pytest.approx(0.5e-3)
