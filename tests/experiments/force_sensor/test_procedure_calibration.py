"""A calibration other than that of the tables: what of it counts, and what it adds to u."""

from dataclasses import replace
from types import SimpleNamespace

import pytest

from rigtool.experiments.force_model.stored import CONSTANT, MODEL_PREFIX, OFFSET
from rigtool.experiments.force_sensor.procedure_calibration import changes, with_zero_of
from rigtool.quantity import Quantity
from rigtool.runfile import RunWriter, open_run
from tests.experiments.force_model.test_stored import MODEL

THEN = {
    MODEL_PREFIX + CONSTANT: Quantity(0.045, "N m/A", 2e-5),
    MODEL_PREFIX + OFFSET: Quantity(1e-3, "A", reason="that of the calibration"),
}


@pytest.fixture
def both(tmp_path):
    """Return a function that makes tables, and a calibration of a constant and a zero."""

    def made(constant, zero=1e-3, then=THEN):
        found = []
        results = {
            "torque_constant_mean": Quantity(constant, "N m/A", 2e-5),
            "amplifier_gain": Quantity(1.0, "1", 0.0),
            "amplifier_offset": Quantity(zero, "A", 2e-6),
        }
        for name, own in (("ilc-learn", then), ("calibrate-kt", results)):
            with RunWriter(tmp_path / f"{name}.h5", command=name, overwrite=True) as writer:
                writer.finish(own, {})
            found.append(open_run(tmp_path / f"{name}.h5"))
        return found

    return made


def test_the_same_calibration_adds_nothing(both):
    tables, kt = both(0.045 + 4e-5, 1e-3 + 3e-6)
    assert changes(tables, kt, MODEL) == (0.0, 0.0, [])


def test_another_torque_constant_is_a_share_of_the_torque(both):
    by, share, (note,) = changes(*both(0.045 * 1.04), MODEL)
    assert (by, share) == (0.0, pytest.approx(0.04 / 1.04))
    assert "+3.85 %" in note


def test_a_zero_that_moved_is_taken_and_may_have_moved_again(both):
    tables, kt = both(0.045, 21e-3)
    by, share, (note,) = changes(tables, kt, MODEL)
    moved = 20e-3 * 0.045 * MODEL.learned.known.torque_factor
    assert (by, share) == (pytest.approx(moved, rel=1e-3), 0.0)
    assert "moved by 20 mA" in note
    assert with_zero_of(MODEL, kt).drive.offset == 21e-3


def test_tables_that_state_no_constant_are_not_compared(both):
    assert changes(*both(0.05, then={}), MODEL) == (0.0, 0.0, [])


def test_a_calibration_without_a_zero_leaves_that_of_the_tables():
    assert with_zero_of(MODEL, SimpleNamespace(results={})) is MODEL
    known = replace(MODEL.learned.known, offset=0.0)
    other = replace(MODEL, learned=replace(MODEL.learned, known=known))
    assert with_zero_of(other, SimpleNamespace(results={})).drive.offset == 0.0
