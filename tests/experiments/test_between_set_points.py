"""What is said of current that flows between the samples of a drive."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from rigtool.errors import InsufficientDataError
from rigtool.experiments.between_set_points import (
    UnsampledCurrent,
    setpoint_resolution,
    unsampled_note,
)
from rigtool.experiments.ripple import procedure as fft_ripple
from rigtool.experiments.ripple.procedure import PROCEDURE as FFT_RIPPLE
from tests.experiments.virtual_runs import RECIPE, run

KT = RECIPE.parents[1] / "tests" / "fixtures" / "kt.h5"


def line(*found):
    """Return a run whose rig looked at these (speed rad/s, lacking current A, its u A)."""
    names = ("speed", "lacking_current", "u")
    reported = [dict(zip(names, item, strict=True)) | {"readings": 20} for item in found]
    return SimpleNamespace(provenance={"line": json.dumps({"between_set_points": reported})})


def test_the_largest_difference_is_reported_with_its_torque():
    (text,) = unsampled_note([line((3.0, 2e-3, 1e-4)), line((12.0, -8e-3, 1e-4))], 0.05)
    assert "up to -8 mA" in text
    assert "0.4 mN m, at 12 rad/s" in text
    assert "sample_time shorter" in text


@pytest.mark.parametrize("found", [(), [(3.0, 2e-4, 1e-4)]])
def test_nothing_is_said_of_what_is_not_seen(found):
    assert unsampled_note([line(*found), SimpleNamespace(provenance={"line": None})], 0.05) == ()


@pytest.mark.parametrize("averaged", [1, 8])
def test_the_step_of_the_current_is_found_in_means_of_several(averaged):
    """Of 1 mA, in whatever current; a number with many digits has next to none."""
    rng = np.random.default_rng(4)
    current = 0.05 + 0.02 * rng.standard_normal(4000 * averaged)

    def means(values):
        return values.reshape(-1, averaged).mean(axis=1)

    assert setpoint_resolution(means(np.round(current, 3)), averaged) == pytest.approx(
        1e-3, rel=1e-6
    )
    assert setpoint_resolution(means(current), averaged) < 1e-6
    assert setpoint_resolution(means(np.full(8 * averaged, 0.1)), averaged) == 0


def test_of_several_runs_at_a_speed_the_largest_difference_counts():
    lacking = UnsampledCurrent.of(
        [line((12.0, 1e-3, 1e-5)), line((12.1, -3e-3, 1e-5), (30.0, 1.0, 1e-3))]
    )
    assert lacking.at(12.0) == pytest.approx(-3e-3, rel=1e-4)
    assert lacking.at(20.0) == 0.0


def test_what_is_not_known_of_a_difference_counts_too():
    """Of 20 readings whose mean says nothing, their uncertainty is what samples may lack."""
    lacking = UnsampledCurrent.of([line((12.0, 1e-4, 4e-4))])
    assert lacking.at(12.0) == pytest.approx(4.123e-4, rel=1e-3)
    assert lacking.line(0.05) == pytest.approx((0.05 * 4.123e-4, 0.0), rel=1e-3)


def test_the_error_of_friction_is_a_line_over_speed():
    """What current lacks, by (2 + 0.3 v) mA, is as far off in torque."""
    speeds = (2.0, 5.0, 9.0, 20.0)
    lacking = UnsampledCurrent.of([line(*((v, (2 + 0.3 * v) * 1e-3, 1e-9) for v in speeds))])
    assert lacking.line(0.05) == pytest.approx((0.1e-3, 0.015e-3), rel=1e-6)
    twice = UnsampledCurrent.of([line((2.0, 2e-3, 1e-9), (12.0, 5e-3, 1e-9))])
    assert twice.line(0.05) == pytest.approx((0.05 * 1.4e-3, 0.05 * 0.3e-3), rel=1e-6)
    once = UnsampledCurrent.of([line((5.0, -3e-3, 4e-3)), line((5.0, -6e-3, 8e-3))])
    assert once.line(0.05) == pytest.approx((0.05 * -7.5e-3, 0.0), rel=1e-9)
    assert UnsampledCurrent.of([line((5.0, 0.0, 0.0))]).line(0.05) == (0.0, 0.0)


def test_steps_of_position_that_were_not_looked_at_are_refused():
    run = line((12.0, 1e-3, 1e-5))
    reported = json.loads(run.provenance["line"]) | {"steps_in_position": True}
    run.provenance["line"] = json.dumps(reported)
    assert UnsampledCurrent.of([run]).at(12.0) == pytest.approx(1e-3, rel=1e-4)
    with pytest.raises(InsufficientDataError, match=r"at 20 rad/s was read too rarely"):
        UnsampledCurrent.of([run]).at(20.0)


def test_ripple_says_it(tmp_path, monkeypatch):
    said = "current between set points differs"
    monkeypatch.setattr(
        fft_ripple, "unsampled_note", lambda runs, constant: (f"{said}: {constant:.3g}",)
    )
    sets = ("fft_ripple.speeds=[30]", "fft_ripple.revolutions=3", "fft_ripple.torques=[]")
    more = ("fft_ripple.power_cycles=0",)
    notes = run(FFT_RIPPLE, RECIPE, tmp_path / "ripple.h5", *sets, *more, kt=KT).notes
    (note,) = [note for note in notes if said in note]
    assert float(note.rpartition(" ")[2]) == pytest.approx(0.0455, rel=0.03)


@pytest.mark.parametrize(("stepping", "expected"), [((False, False), False), ((True, False), True)])
def test_a_drive_stepped_where_any_run_says_so(stepping, expected):
    lines = [json.dumps({"steps_in_position": one}) for one in stepping]
    runs = [SimpleNamespace(provenance={"line": one}) for one in lines]
    assert UnsampledCurrent.of(runs).stepping == expected
