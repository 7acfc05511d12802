"""Imported strokes: when u widens or nothing is stated, by numbers that a made model gives."""

import math
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from rigtool.errors import InsufficientDataError, UsageError
from rigtool.experiments.force import imported
from rigtool.experiments.force.imported import Measured, of_this_zero
from rigtool.experiments.force_filter.motion_states import State
from rigtool.experiments.imported_load.loop import StrokeLoop
from rigtool.experiments.imported_load.model import TorqueEstimate
from rigtool.runfile import Column, Table

TABLES = SimpleNamespace(path=Path("tables.h5"))
SCALES = SimpleNamespace(low=2.0, high=12.0, torque=0.06, standstill=0.05)
ROWS = 400


@dataclass(frozen=True)
class Way:
    """As much of a path as is read: to and fro over the learned stroke, 2 to 12 rad."""

    position: np.ndarray
    speed: np.ndarray
    regular: np.ndarray
    time: np.ndarray

    def moved(self, by):
        return replace(self, position=self.position + by)


@dataclass(frozen=True)
class Signals:
    path: Way
    effort: np.ndarray
    effort_unit: str
    output_speed: np.ndarray
    place: np.ndarray
    reference: np.ndarray | None

    @property
    def sensor(self):
        return self.reference


def run(torque=0.03, low=2.0, high=12.0, apart=0.0, noisier=1.0, seed=1):
    """Return a run whose torque depends on the position: three strokes, the last row at rest."""
    phase = np.linspace(0, 3, ROWS)
    share = np.abs(np.mod(phase + 1, 2) - 1)
    position = low + (high - low) * share
    speed = np.where(np.mod(phase, 2) < 1, 2.0, -2.0)
    path = Way(position, speed, np.ones(ROWS, dtype=bool), 5.0 + 0.01 * np.arange(ROWS))
    noise = 1e-3 * np.random.default_rng(seed).standard_normal(ROWS)
    signals = Signals(path, np.zeros(ROWS), "A", 0.2 * speed, share, np.full(ROWS, torque) + noise)
    return signals, apart, noisier


def model(recordings=6, offset=0.1, elsewhere=1.0, between=1.0, change=None):
    """Torque is 3 mN m per rad from the learned end, beyond 13 rad none."""

    def estimate(path, apart=0.0, noisier=1.0):
        states = np.where(path.speed > 0, State.AGAINST, State.WITH).astype(np.int32)
        states[path.position > 13.0] = State.OUTSIDE
        states[-1] = State.STILL
        torque = np.where(states == State.OUTSIDE, np.nan, 3e-3 * (path.position - 2.0))
        u = np.where(states == State.OUTSIDE, np.nan, 1e-3)
        compared = np.where(path.speed > 0, apart / 2, -apart / 2)
        return TorqueEstimate(torque, u, states, compared, noisier)

    return SimpleNamespace(
        scales=SCALES,
        direction=1,
        bandwidth_hz=5.0,
        place=lambda path: (path.position - 2.0) / 10.0,
        read=lambda signals: estimate(signals.path),
        estimate=estimate,
        elsewhere=lambda path: path.position.min() > 2.5,
        paces=SimpleNamespace(change=lambda pace: 0.5 if change is None else change.pop()),
        sides=[
            SimpleNamespace(elsewhere=1.0, at_other_speeds=lambda share: 1 + share * (between - 1)),
            SimpleNamespace(elsewhere=elsewhere, at_other_speeds=lambda share: 1.0),
        ],
        loop=StrokeLoop(np.zeros(20), np.full(20, 0.2), offset, recordings),
    )


def measured(own, *runs):
    return [Measured(s, own.estimate(s.path, apart, noisier)) for s, apart, noisier in runs]


@pytest.mark.parametrize(("by", "back"), [(0.04, 0.0), (1.0, -1.0), (-1.0, 1.0), (1.5, -1.5)])
def test_u_holds_what_another_zero_of_the_encoder_changes(by, back):
    own = model()
    given = measured(own, run(low=2.0 + by, high=12.0 + by))
    (found,), notes = of_this_zero(given, own)
    if not back:
        assert found is given[0]
        assert notes == []
        return
    moving = np.isfinite(given[0].estimate.moving)
    # 3 mN m per rad, also where one of the two has no value
    expected = math.hypot(1e-3, 3e-3 * back)
    np.testing.assert_allclose(found.estimate.u[moving], expected, rtol=0.02)
    assert found.estimate.u[-1] == 1e-3  # of a dead band
    left = float(notes[0].split("learned one by ")[1].split()[0])
    assert left == pytest.approx(abs(back), rel=0.02)


@pytest.mark.parametrize(("high", "refused"), [(12.0, False), (15.0, False), (17.5, True)])
def test_a_way_of_which_a_quarter_was_not_learned_is_refused(high, refused):
    own = model()
    given = measured(own, run(high=high))
    if refused:
        with pytest.raises(InsufficientDataError, match="% of the way is beyond the stroke"):
            imported._require_stroke(given, own, TABLES)
    else:
        imported._require_stroke(given, own, TABLES)


def limits(recordings, level, runs):
    """Limits of the median and of the mean of runs that share a quarter of their variance."""
    t = stats.t.interval(level, recordings - 1)[1]
    independent = 1 / (0.25 + 0.75 / runs)
    median = math.sqrt(stats.f.ppf(level, independent, recordings - 1))
    return median, t * math.sqrt(0.25 + 0.75 / runs + 1 / recordings)


def widened(offsets, recordings=6, noisier=1.0):
    """Return by how much u widens for runs with these offsets, in standard deviations."""
    own = model(recordings)
    given = measured(own, *(run(apart=0.1 * o * noisier, noisier=noisier) for o in offsets))
    found, notes = imported._of_this_mounting(given, own, TABLES)
    factors = [
        after.estimate.u[5] / before.estimate.u[5]
        for before, after in zip(given, found, strict=True)
    ]
    return factors, notes


def test_runs_that_disagree_by_chance_keep_their_u():
    one, _ = limits(6, 0.95, 1)
    factors, notes = widened([0.5, -0.5, 0.9 * one, -0.9 * one])
    np.testing.assert_allclose(factors, 1.0, rtol=1e-12)
    most = limits(6, 0.99, 4)
    assert f"refused beyond {most[0]:.2g} and {most[1]:.2g} times" in notes[0]
    assert len(notes) == 1


def test_a_run_that_disagrees_more_has_a_wider_u():
    one, _ = limits(6, 0.95, 1)
    factors, notes = widened([0.5, -0.5, -1.1 * one])
    np.testing.assert_allclose(factors, [1.0, 1.0, 1.1 * one], rtol=1e-6)
    assert notes[1].startswith(f"u of 1 runs is wider, up to {1.1 * one:.2g} times")
    # noise of the effort makes strokes disagree as much
    assert widened([0.5, -0.5, -1.1 * one], noisier=3.0)[0] == pytest.approx(factors)


def test_runs_that_disagree_in_one_sense_widen_all():
    _, doubted = limits(6, 0.95, 4)
    _, refused = limits(6, 0.99, 4)
    together = (doubted + refused) / 2
    factors, notes = widened([together] * 4)
    np.testing.assert_allclose(factors, math.hypot(1, together), rtol=1e-6)
    assert f"disagree {together:.2g} times" in notes[0]
    with pytest.raises(
        InsufficientDataError, match=f"disagree {1.01 * refused:.1f} .* in one sense"
    ):
        widened([1.01 * refused] * 4)


def test_runs_that_all_disagree_are_refused():
    """Where none is beyond the limit of one run, and they do not disagree in one sense, too."""
    most, _ = limits(6, 0.99, 4)
    one, _ = limits(6, 0.99, 1)
    assert 1.01 * most < one
    message = f"disagree {1.01 * most:.1f} times as much as"
    with pytest.raises(InsufficientDataError, match=message):
        widened([1.01 * most, -1.01 * most] * 2)
    # half of them alone is not typical
    assert max(widened([1.01 * one, -1.01 * one, 0.1, 0.1, 0.1])[0]) == pytest.approx(1.01 * one)


def test_runs_that_all_disagree_a_little_have_a_wider_u():
    doubted, refused = (limits(6, level, 4)[0] for level in (0.95, 0.99))
    typical = (doubted + min(refused, limits(6, 0.95, 1)[0])) / 2
    factors, notes = widened([typical, -typical] * 2)
    np.testing.assert_allclose(factors, typical, rtol=1e-6)
    assert notes[1].startswith("u of 4 runs is wider")
    np.testing.assert_allclose(widened([0.99 * doubted, -0.99 * doubted] * 2)[0], 1.0, rtol=1e-9)


@pytest.mark.parametrize("offset", [5.5, 21.0])
def test_a_load_that_changes_is_no_other_mounting_but_widens_u(offset):
    """The torque of the third stroke, and so the loop, is by the load: u holds the whole of that,
    which another mounting may be; what no load explains is refused."""
    own = model()
    (given,) = measured(own, run())
    path = given.signals.path
    third = (path.speed > 0) & (np.arange(ROWS) > ROWS // 2)
    compared = 0.1 * (np.where(path.speed > 0, offset - 2.0, 0.0) + 4.0 * third)
    run_of = Measured(given.signals, replace(given.estimate, compared=compared))
    shown = math.sqrt(1 + 2 * 2.0**2 * (1 / 2 + 1))
    refused, _ = limits(6, 0.99, 1)
    if offset / shown > refused:
        with pytest.raises(InsufficientDataError, match="strokes to and fro disagree 5"):
            imported._of_this_mounting([run_of], own, TABLES)
        return
    (found,), notes = imported._of_this_mounting([run_of], own, TABLES)
    assert offset > refused  # of a load that does not change
    assert found.estimate.u[5] / given.estimate.u[5] == pytest.approx(
        math.hypot(1, offset), rel=0.1
    )
    assert "their load changes" in notes[1]


def test_one_direction_is_not_compared():
    own = model()
    signals, *_ = run()
    one_way = replace(signals.path, speed=np.abs(signals.path.speed))
    given = [Measured(replace(signals, path=one_way), own.estimate(one_way))]
    found, (note,) = imported._of_this_mounting(given, own, TABLES)
    assert found[0] is given[0]
    assert "cannot be checked" in note


def test_samples_without_a_value_are_counted():
    own = model(elsewhere=1.7)
    signals, *_ = run(high=14.0)
    wild = np.ones(ROWS, dtype=bool)
    wild[:7] = False
    odd = replace(signals, path=replace(signals.path, regular=wild))
    far, *_ = run(low=3.0)
    given = [
        Measured(odd, own.estimate(odd.path, noisier=1.3)),
        Measured(far, own.estimate(far.path)),
    ]
    outside = int(np.sum(signals.path.position[:-1] > 13))
    notes = imported._require_inside(given, own)
    assert notes[0].startswith(f"{outside} of {2 * ROWS} samples are outside")
    assert notes[1].startswith("2 samples are near standstill (below 0.05 rad/s)")
    assert "strokes of 1 runs are at places" in notes[2]
    assert "up to 1.7 times" in notes[2]
    assert notes[3].startswith("u of 1 runs is wider, up to 1.3 times")
    assert notes[4].startswith("7 samples of 1 runs belong to a transient")
    plain = measured(own, run())
    assert len(imported._require_inside(plain, own)) == 2
    none = np.full(ROWS, State.OUTSIDE, dtype=np.int32)
    lost = [replace(plain[0], estimate=replace(plain[0].estimate, states=none))]
    with pytest.raises(InsufficientDataError, match=r"up to 60 mN m\), or at rest"):
        imported._require_inside(lost, own)


def test_results_are_medians_of_what_is_moving_and_what_is_not():
    own = model()
    (given,) = measured(own, run())
    u = np.linspace(1e-3, 2e-3, ROWS)
    rows = imported._reading(replace(given, estimate=replace(given.estimate, u=u)))
    assert rows.step_time == pytest.approx(0.01)
    found = imported._own_results(rows, own)
    assert found["torque_u_median"].value == pytest.approx(np.median(u[:-1]))
    # a rectangle of half width sqrt(3) u
    assert found["dead_band"].value == pytest.approx(2 * math.sqrt(3) * 2e-3)
    assert found["bandwidth"].value == 5.0


def test_the_sensor_judges_fast_strokes():
    """In each direction the root of the mean square; speeds count by the sense of the load."""
    own = model()
    own.direction = -1
    (given,) = measured(own, run())
    slow = np.abs(given.signals.path.position - 7.0) > 4.0
    speed = np.where(slow, 0.2, 0.3) * np.sign(given.signals.path.speed)
    given = replace(given, signals=replace(given.signals, output_speed=speed))
    results, tables, notes = imported._judged([given], own)
    error = given.estimate.torque - given.signals.reference
    for name, chosen in (("closing", -speed > 0.25), ("opening", speed > 0.25)):
        expected = np.sqrt(np.mean(error[chosen & given.estimate.inside] ** 2))
        assert results[f"rmse_{name}"].value == pytest.approx(expected, rel=1e-9)
    assert tables["loads"].shape == (1,)
    assert notes == []
    column = Column(np.zeros(ROWS), "N m")
    table = Table(("time",), {"time": column, "torque": column}, "torque", "made")
    moved = imported._with_motion(table, [given], -1)
    np.testing.assert_array_equal(moved["speed"], -speed)
    np.testing.assert_array_equal(moved["position"], given.signals.path.position)
    still = replace(given, signals=replace(given.signals, output_speed=speed / 2))
    results, tables, notes = imported._judged([still], own)
    assert np.isnan(results["rmse_closing"].value)
    assert tables == {}
    assert "there is no table of loads" in notes[-1]


@pytest.mark.parametrize(("scale", "shown"), [(-1.0, "-1 "), (1e3, "1e+03"), (1.4, None)])
def test_a_sensor_of_another_sign_or_unit_is_noted(scale, shown):
    own = model()
    (given,) = measured(own, run())
    reference = scale * np.nan_to_num(given.estimate.moving)
    given = replace(given, signals=replace(given.signals, reference=reference))
    (*_, notes) = imported._judged([given], own)
    noted = [note for note in notes if "see to its sign" in note]
    assert len(noted) == (shown is not None)
    assert all(f"reference_torque is {shown}" in note for note in noted)


def test_runs_that_were_learned_from_are_named():
    tables = SimpleNamespace(provenance={"inputs": [{"content_sha256": n} for n in "abc"]})
    runs = [SimpleNamespace(path=Path(f"{n}.h5"), content_sha256=n) for n in "xbc"]
    (note,) = imported._also_learned(runs, tables)
    assert note.startswith("the tables were learned from 2 of these runs (b.h5, ...)")
    assert imported._also_learned(runs[:1], tables) == []


def test_tables_of_another_rig_are_refused():
    runs = [SimpleNamespace(rig="bench")]
    imported._require_learned_here(runs, SimpleNamespace(rig="bench", path="t.h5"))
    for other in ("another", None):
        with pytest.raises(UsageError, match=r"was learned on .* the runs are of bench"):
            imported._require_learned_here(runs, SimpleNamespace(rig=other, path="t.h5"))


def test_speeds_that_were_not_learned_are_noted():
    signals, *_ = run()
    said = []
    for between in (1.0, 1.8):
        own = model(between=between)
        notes = imported._require_inside([Measured(signals, own.estimate(signals.path))], own)
        said.append([note for note in notes if "speeds of which none was learned" in note])
    assert said[0] == []
    assert "up to 1.4 times" in said[1][0]


def test_the_note_is_of_the_speed_farthest_from_the_learned_ones():
    own = model(between=1.8, change=[0.2, 0.0, 0.5])
    given = measured(own, run(), run(), run())
    notes = imported._require_inside(given, own)
    assert sum("strokes of 2 runs have speeds of" in n and "1.4 times" in n for n in notes) == 1
